// A chase in flight: how the swarm closes in, and how the belief has come to be what it is.

import uPlot from "./vendor/uPlot.esm.js";
import { NOTHING, bearing, metres, number, setText, share } from "./format.js";
import { onThemeChange, themeColor } from "./theme.js";

const FONT = "11px system-ui, sans-serif";
const LEAST_RADIUS_M = 0.5;
const TRACK_S = 60;
const STEPS_M = [0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000];
const MOST_SPLITS = 5;

export class PursuitPanel {
  constructor(panel) {
    this.panel = panel;
    this.parts = Object.fromEntries(
      ["target", "closing", "to-go", "intercept", "within", "within-what", "followed", "followed-what", "followed-row", "changed"].map((name) => [name, panel.querySelector(`#pursuit-${name}`)]),
    );
    this.chart = panel.querySelector("#belief-chart");
    this.plot = new uPlot(options(), [[], [], []], this.chart);
    this.shown = "";
    new ResizeObserver(() => this.resize()).observe(this.chart);
    onThemeChange(() => this.plot.redraw());
  }

  setInfo(info) {
    this.panel.hidden = !info.is_in_flight;
    setText(this.parts["within-what"], `belief within ${number(info.success_radius_m, 0)} m`);
  }

  draw(frame) {
    if (this.panel.hidden) return;
    const { interception, estimate, track } = frame;
    setText(this.parts.target, velocityInWords(estimate?.velocity_mps));
    setText(this.parts.closing, interception ? `${number(interception.closing_mps)} m/s` : NOTHING);
    setText(this.parts["to-go"], interception?.time_to_go_s ? `${number(interception.time_to_go_s)} s` : NOTHING);
    setText(this.parts.intercept, interception?.position_m ? `${metres(interception.position_m, 0)} m` : NOTHING);
    setText(this.parts.within, share(frame.share_within));
    this.parts["followed-row"].hidden = !frame.following;
    if (frame.following) {
      setText(this.parts["followed-what"], `followed within ${number(frame.following.within_m, 0)} m`);
      setText(this.parts.followed, `${share(frame.following.share)} of ${number(frame.following.seconds, 0)} s`);
    }
    setText(this.parts.changed, frame.decision?.changed ? `Flown otherwise: ${frame.decision.changed}.` : "");
    this.drawChart(track);
  }

  drawChart(track) {
    const key = `${track.time_s.length} ${track.time_s.at(-1)}`;
    if (key === this.shown) return;
    this.shown = key;
    const lastS = track.time_s.at(-1) ?? 0;
    const seconds = track.time_s.map((timeS) => timeS - lastS);
    const radiusM = track.radius_m.map((one) => (one === null ? null : Math.max(one, LEAST_RADIUS_M)));
    this.plot.setData([seconds, radiusM, track.share_within.map((one) => (one === null ? null : 100 * one))]);
    const last = track.radius_m.at(-1);
    const now = last === null || last === undefined ? "no belief" : `95 % within ${number(last)} m, ${share(track.share_within.at(-1))} within the success radius`;
    this.chart.setAttribute("aria-label", `The belief over the last minute; now ${now}`);
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.chart;
    if (width > 0 && height > 0) this.plot.setSize({ width, height });
  }
}

export function velocityInWords(velocityMps) {
  if (!velocityMps) return NOTHING;
  const [east, north, up] = velocityMps;
  const course = `${number(Math.hypot(east, north))} m/s towards ${bearing(((Math.atan2(east, north) * 180) / Math.PI + 360) % 360)}`;
  const climb = Math.abs(up) < 0.5 ? "" : `, ${up > 0 ? "climbs" : "sinks"} ${number(Math.abs(up))} m/s`;
  return course + climb;
}

function options() {
  const lines = { stroke: () => themeColor("line"), width: 1 };
  const axis = { stroke: () => themeColor("dim"), grid: lines, ticks: { ...lines, size: 4 }, font: FONT };
  return {
    width: 300,
    height: 110,
    padding: [8, 0, 0, 0],
    cursor: { show: false },
    legend: { show: false },
    scales: {
      x: { time: false, range: () => [-TRACK_S, 0] },
      m: { distr: 3, range: (_plot, low, high) => radiusRange(low, high) },
      percent: { range: () => [0, 100] },
    },
    axes: [
      { ...axis, size: 24, values: (_plot, splits) => splits.map((split) => `${split} s`.replace("-", "−")) },
      { ...axis, scale: "m", size: 54, splits: (plot) => roundSplits(plot.scales.m.min, plot.scales.m.max), filter: (_plot, splits) => splits, values: (_plot, splits) => splits.map((split) => `${split} m`) },
      { ...axis, scale: "percent", side: 1, size: 46, grid: { show: false }, splits: () => [0, 50, 100], values: (_plot, splits) => splits.map((split) => `${split} %`) },
    ],
    series: [
      {},
      { scale: "m", stroke: () => themeColor("belief"), width: 2, points: { show: false } },
      { scale: "percent", stroke: () => themeColor("green"), width: 1.5, dash: [5, 3], points: { show: false } },
    ],
  };
}

// From one of the steps to another one, with at least two between them.
function radiusRange(low, high) {
  if (low === null || high === null) return [1, 100];
  const from = Math.max(0, STEPS_M.findLastIndex((step) => step <= low));
  const to = STEPS_M.findIndex((step) => step >= high);
  return [STEPS_M[from], STEPS_M[Math.max(from + 3, to < 0 ? STEPS_M.length - 1 : to)] ?? STEPS_M.at(-1)];
}

// Those of the steps that are between, and no more of them than have room.
function roundSplits(low, high) {
  const within = STEPS_M.filter((step) => step >= low && step <= high);
  return within.length <= MOST_SPLITS ? within : within.filter((step) => Number.isInteger(Math.log10(step)));
}
