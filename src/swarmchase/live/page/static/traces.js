// The six RSSI traces of the last window.

import uPlot from "./vendor/uPlot.esm.js";
import { STALE_COLOR, TRACKER_COLORS, age, agedBy, setText, staleness } from "./format.js";

const GRID = { stroke: "#1f2a36", width: 1 };
const AXIS = { stroke: "#93a3b5", grid: GRID, ticks: { ...GRID, size: 4 }, font: "11px system-ui, sans-serif" };
const LEAST_RANGE_DB = 10;

export class Traces {
  constructor(container, key) {
    this.container = container;
    this.stale = TRACKER_COLORS.map(() => "");
    this.samplingHz = 1;
    this.keys = TRACKER_COLORS.map((color, index) => addKey(key, color, index));
    this.plot = new uPlot(this.options(), [[], [], [], [], [], [], []], container);
    new ResizeObserver(() => this.resize()).observe(container);
  }

  setInfo(info) {
    this.samplingHz = info.sampling_hz || 1;
  }

  // isStale: the whole page is.
  draw(frame, extraS, isStale) {
    frame.trackers.forEach((tracker, index) => {
      const stale = staleness(tracker, extraS) || (isStale ? "stale" : "");
      this.stale[index] = stale;
      drawKey(this.keys[index], index, stale, agedBy(tracker.rssi_age_s, extraS));
    });
    const length = Math.max(...frame.trackers.map((tracker) => tracker.rssi_dbm.length));
    const seconds = Array.from({ length }, (_, index) => (index - length + 1) / this.samplingHz);
    this.plot.setData([seconds, ...frame.trackers.map((tracker) => padded(tracker.rssi_dbm, length))]);
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.container;
    if (width > 0 && height > 0) this.plot.setSize({ width, height });
  }

  options() {
    const series = TRACKER_COLORS.map((color, index) => ({
      stroke: () => (this.stale[index] ? STALE_COLOR : color),
      width: 1.5,
      points: { show: false },
    }));
    return {
      width: 300,
      height: 150,
      padding: [8, 10, 0, 0],
      cursor: { show: false },
      legend: { show: false },
      scales: {
        x: { time: false, range: (_plot, low, high) => (high > low ? [low, high] : [-1, 0]) },
        y: { range: levelRange },
      },
      axes: [
        { ...AXIS, size: 26, values: (_plot, splits) => splits.map((split) => `${split} s`.replace("-", "−")) },
        { ...AXIS, size: 42, incrs: [1, 2, 5, 10, 20, 50], values: (_plot, splits) => splits.map((split) => String(split).replace("-", "−")) },
      ],
      series: [{}, ...series],
    };
  }
}

function levelRange(_plot, low, high) {
  if (low === null || high === null) return [-100, -40];
  const middle = (low + high) / 2;
  const half = Math.max(high - low + 2, LEAST_RANGE_DB) / 2;
  return [middle - half, middle + half];
}

// The newest samples are last: what is missing of the window is missing in front.
function padded(levels, length) {
  return [...new Array(length - levels.length).fill(null), ...levels];
}

function addKey(list, color, index) {
  const item = document.createElement("li");
  item.dataset.trace = index;
  item.style.setProperty("--color", color);
  const text = document.createElement("span");
  item.append(document.createElement("i"), text);
  list.append(item);
  return { item, text };
}

function drawKey({ item, text }, index, stale, ageS) {
  item.dataset.stale = stale;
  const since = ageS === null ? "" : ` ${age(ageS)}`;
  setText(text, stale ? `${index} ${stale}${since}` : String(index));
}
