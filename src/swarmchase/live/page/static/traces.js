// The six RSSI traces of the last window, told apart by their dashes and the numbers at their ends, too.

import uPlot from "./vendor/uPlot.esm.js";
import { TRACKER_SIDES, age, agedBy, setText, staleness } from "./format.js";
import { onThemeChange, themeColor, trackerColor } from "./theme.js";

const FONT = "11px system-ui, sans-serif";
const LABEL_FONT = "700 12px system-ui, sans-serif";
const LABEL_PX = 13;
const LEAST_RANGE_DB = 10;
const DASHES = [[], [9, 4], [2, 3], [12, 3, 2, 3], [5, 3], [12, 3, 2, 3, 2, 3]];
const SVG = "http://www.w3.org/2000/svg";

export class Traces {
  constructor(container, key) {
    this.container = container;
    this.stale = TRACKER_SIDES.map(() => "");
    this.samplingHz = 1;
    this.keys = TRACKER_SIDES.map((_, index) => addKey(key, index));
    this.plot = new uPlot(this.options(), [[], [], [], [], [], [], []], container);
    new ResizeObserver(() => this.resize()).observe(container);
    onThemeChange(() => this.plot.redraw());
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

  color(index) {
    return this.stale[index] ? themeColor("faint") : trackerColor(index);
  }

  options() {
    const series = TRACKER_SIDES.map((_, index) => ({
      stroke: () => this.color(index),
      width: 1.5,
      dash: DASHES[index],
      points: { show: false },
    }));
    const lines = { stroke: () => themeColor("line"), width: 1 };
    const axis = { stroke: () => themeColor("dim"), grid: lines, ticks: { ...lines, size: 4 }, font: FONT };
    return {
      width: 300,
      height: 150,
      padding: [8, 22, 0, 0],
      cursor: { show: false },
      legend: { show: false },
      scales: {
        x: { time: false, range: (_plot, low, high) => (high > low ? [low, high] : [-1, 0]) },
        y: { range: levelRange },
      },
      axes: [
        { ...axis, size: 26, values: (_plot, splits) => splits.map((split) => `${split} s`.replace("-", "−")) },
        { ...axis, size: 42, incrs: [1, 2, 5, 10, 20, 50], values: (_plot, splits) => splits.map((split) => String(split).replace("-", "−")) },
      ],
      series: [{}, ...series],
      hooks: { draw: [(plot) => this.drawNumbers(plot)] },
    };
  }

  // Each trace's number at the height of its newest level, moved apart where they would hide one another.
  drawNumbers(plot) {
    const ends = TRACKER_SIDES.map((_, index) => ({ index, level: plot.data[index + 1]?.findLast((one) => one !== null) }))
      .filter(({ level }) => level !== undefined)
      .map(({ index, level }) => ({ index, y: plot.valToPos(level, "y", true) }))
      .sort((one, other) => one.y - other.y);
    const ratio = window.devicePixelRatio;
    const low = plot.bbox.top + plot.bbox.height;
    ends.forEach((end, place) => (end.y = Math.max(end.y, place ? ends[place - 1].y + LABEL_PX * ratio : plot.bbox.top)));
    ends.reverse().forEach((end, place) => (end.y = Math.min(end.y, place ? ends[place - 1].y - LABEL_PX * ratio : low)));
    const { ctx } = plot;
    ctx.save();
    ctx.font = LABEL_FONT.replace("12px", `${12 * ratio}px`);
    ctx.textBaseline = "middle";
    for (const { index, y } of ends) {
      ctx.fillStyle = this.color(index);
      ctx.fillText(String(index), plot.bbox.left + plot.bbox.width + 6 * ratio, y);
    }
    ctx.restore();
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

function addKey(list, index) {
  const item = document.createElement("li");
  item.dataset.trace = index;
  item.style.setProperty("--color", `var(--tracker-${index})`);
  const line = document.createElementNS(SVG, "svg");
  line.setAttribute("viewBox", "0 0 30 4");
  line.setAttribute("aria-hidden", "true");
  const stroke = document.createElementNS(SVG, "line");
  for (const [name, value] of Object.entries({ x1: 0, x2: 30, y1: 2, y2: 2, "stroke-dasharray": DASHES[index].join(" ") })) {
    stroke.setAttribute(name, value);
  }
  line.append(stroke);
  const text = document.createElement("span");
  item.append(line, text);
  list.append(item);
  return { item, text };
}

function drawKey({ item, text }, index, stale, ageS) {
  item.dataset.stale = stale;
  const since = ageS === null ? "" : ` ${age(ageS)}`;
  setText(text, stale ? `${index} ${stale}${since}` : String(index));
}
