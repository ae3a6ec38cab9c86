// The flight from above, north up: who is where, where the target is believed to be, and how far that is.

import { TRACKER_SIDES, bearing, easedShare, number, staleness } from "./format.js";
import { onThemeChange, themeColor, trackerColor } from "./theme.js";

const ROUND = [1, 2, 5];
const FONT = "11px system-ui, sans-serif";
const BOLD = "700 11px system-ui, sans-serif";
// Of the map's shorter side, left free around what must be in it.
const MARGIN = 0.1;
const LEAST_HALF_M = 6;
// What is further than this many times the target's distance need not be in the picture.
const FARTHEST = 3;
const RECENT_POINTS = 20;
const RINGS = 3;
// So far the arrow of a velocity reaches.
const ARROW_S = 4;
const TRACKER_PX = 5;
const LEAST_SPACING_WITH_NAMES_PX = 16;
const ELLIPSE_POINTS = 48;
const STILL = 0.003;

export class MapView {
  constructor(container) {
    this.container = container;
    this.canvas = document.createElement("canvas");
    container.append(this.canvas);
    this.context = this.canvas.getContext("2d");
    this.isCloseUp = false;
    this.goal = { east: 0, north: 0, half: 60 };
    this.now = null;
    this.stepMs = performance.now();
    onThemeChange(() => this.request());
    new ResizeObserver(() => this.request()).observe(container);
  }

  setInfo(info) {
    this.info = info;
    this.request();
  }

  look(isCloseUp) {
    this.isCloseUp = isCloseUp;
    if (this.frame) this.draw(this.frame);
  }

  draw(frame) {
    this.frame = frame;
    this.include(frame);
    this.container.setAttribute("aria-label", inWords(frame));
    this.request();
  }

  // What must be in the picture.
  include(frame) {
    const points = this.isCloseUp ? swarm(frame) : everything(frame);
    if (!points.length) return;
    const [low, high] = [Math.min, Math.max].map((of) => [0, 1].map((axis) => of(...points.map((point) => point[axis]))));
    const half = Math.max(LEAST_HALF_M, (high[0] - low[0]) / 2, (high[1] - low[1]) / 2);
    this.goal = { east: (low[0] + high[0]) / 2, north: (low[1] + high[1]) / 2, half };
    this.now ??= { ...this.goal };
  }

  request() {
    this.pending ??= requestAnimationFrame(() => {
      this.pending = null;
      if (this.step()) this.request();
      this.paint();
    });
  }

  // Nearer to the goal; returns whether there is still some way to go.
  step() {
    const nowMs = performance.now();
    const easing = easedShare(nowMs - this.stepMs);
    this.stepMs = nowMs;
    if (!this.now) return false;
    let left = 0;
    for (const what of ["east", "north", "half"]) {
      this.now[what] += (this.goal[what] - this.now[what]) * easing;
      left = Math.max(left, Math.abs(this.goal[what] - this.now[what]));
    }
    return left > STILL * this.goal.half;
  }

  paint() {
    const { clientWidth: width, clientHeight: height } = this.container;
    if (!width || !height || !this.now || !this.frame) return;
    const ratio = Math.min(window.devicePixelRatio, 2);
    const [pixelsWide, pixelsHigh] = [Math.round(width * ratio), Math.round(height * ratio)];
    if (this.canvas.width !== pixelsWide) this.canvas.width = pixelsWide;
    if (this.canvas.height !== pixelsHigh) this.canvas.height = pixelsHigh;
    const { context, frame } = this;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    this.size = { width, height };
    this.perM = ((1 - 2 * MARGIN) * Math.min(width, height)) / (2 * this.now.half);
    this.paintRings(frame);
    this.paintFence();
    this.paintTracks(frame);
    this.paintEstimate(frame);
    this.paintTarget(frame);
    this.paintInterception(frame);
    frame.trackers.forEach((tracker, index) => this.paintTracker(tracker, index, frame));
    this.paintCenter(frame);
    this.paintNorth();
    this.paintScale();
  }

  at([east, north]) {
    return [
      this.size.width / 2 + (east - this.now.east) * this.perM,
      this.size.height / 2 - (north - this.now.north) * this.perM,
    ];
  }

  line(points, color, { width = 1.5, dash = [], closed = false, fill = null, opacity = 1 } = {}) {
    if (points.length < 2) return;
    const { context } = this;
    context.save();
    context.globalAlpha = opacity;
    context.beginPath();
    points.forEach((point) => context.lineTo(...this.at(point)));
    if (closed) context.closePath();
    if (fill) {
      context.fillStyle = fill;
      context.fill();
    }
    context.globalAlpha = 1;
    context.setLineDash(dash);
    context.strokeStyle = color;
    context.lineWidth = width;
    context.stroke();
    context.restore();
  }

  // Readable over whatever is below.
  text(text, [x, y], color, { font = FONT, align = "center" } = {}) {
    const { context } = this;
    context.font = font;
    context.textAlign = align;
    context.textBaseline = "middle";
    context.lineWidth = 3;
    context.lineJoin = "round";
    context.strokeStyle = themeColor("horizon");
    context.strokeText(text, x, y);
    context.fillStyle = color;
    context.fillText(text, x, y);
  }

  // Round distances from the centre.
  paintRings(frame) {
    if (!frame.center_m) return;
    const { context } = this;
    const stepM = roundBelow((0.42 * Math.min(this.size.width, this.size.height)) / this.perM / (RINGS - 1));
    const [x, y] = this.at(frame.center_m);
    for (let ring = 1; ring <= RINGS; ring++) {
      context.strokeStyle = themeColor("grid");
      context.lineWidth = 1;
      context.beginPath();
      context.arc(x, y, ring * stepM * this.perM, 0, 2 * Math.PI);
      context.stroke();
      this.text(`${ring * stepM} m`, [x, y + ring * stepM * this.perM], themeColor("dim"));
    }
  }

  paintFence() {
    const fence = this.info?.fence_m;
    if (!fence) return;
    const [[west, south], [east, north]] = [fence.low, fence.high];
    const corners = [[west, south], [east, south], [east, north], [west, north]];
    this.line(corners, themeColor("faint"), { dash: [5, 4], closed: true });
  }

  paintTracks(frame) {
    this.line(frame.path_m, themeColor("bright"), { width: 1.5 });
    this.line(frame.track.target_m.filter(Boolean), themeColor("belief"), { dash: [4, 3] });
  }

  paintEstimate({ estimate, belief_m: beliefM }) {
    if (!estimate) return;
    const color = themeColor("belief");
    const ellipse = estimate.region ? ellipseOf(estimate.region) : null;
    if (ellipse) this.line(ellipse, color, { closed: true, fill: color, opacity: 0.16 });
    else beliefM?.forEach((point) => this.dot(this.at(point), 1.5, color));
    this.dot(this.at(estimate.position_m), 3.5, color);
    if (estimate.velocity_mps) this.arrow(estimate.position_m, estimate.velocity_mps, color);
  }

  paintTarget({ target_m: targetM }) {
    if (!targetM) return;
    const color = themeColor("target");
    const [x, y] = this.at(targetM);
    const { context } = this;
    context.fillStyle = color;
    context.beginPath();
    for (const [dx, dy] of [[0, -6], [6, 0], [0, 6], [-6, 0]]) context.lineTo(x + dx, y + dy);
    context.fill();
    context.strokeStyle = color;
    context.lineWidth = 1;
    context.beginPath();
    context.arc(x, y, Math.max(1, (this.info?.success_radius_m ?? 0) * this.perM), 0, 2 * Math.PI);
    context.stroke();
  }

  paintInterception({ interception, center_m: centerM }) {
    if (!interception?.position_m || !centerM) return;
    const color = themeColor("orange");
    this.line([centerM, interception.position_m], color, { width: 1, dash: [2, 4] });
    const [x, y] = this.at(interception.position_m);
    const { context } = this;
    context.strokeStyle = color;
    context.lineWidth = 2;
    context.beginPath();
    for (const [dx, dy] of [[-5, -5], [5, 5], [-5, 5], [5, -5]]) (dx < 0 ? context.moveTo : context.lineTo).call(context, x + dx, y + dy);
    context.stroke();
    const within = x > 0 && y > 0 && x < this.size.width && y < this.size.height;
    if (within) this.text(`${number(interception.time_to_go_s, 0)} s`, [x, y - 13], color, { font: BOLD });
  }

  paintTracker(tracker, index, frame) {
    if (!tracker.position_m) return;
    const isOut = staleness(tracker, 0) !== "" || tracker.condition === "left out";
    const color = isOut ? themeColor("faint") : trackerColor(index);
    if (frame.center_m) this.line([frame.center_m, tracker.position_m], color, { width: 1 });
    const [x, y] = this.at(tracker.position_m);
    this.dot([x, y], TRACKER_PX, color);
    const headingDeg = tracker.health?.heading_deg ?? null;
    if (headingDeg !== null) this.nose([x, y], headingDeg, color);
    if ((frame.spacing_m ?? 0) * this.perM < LEAST_SPACING_WITH_NAMES_PX) return;
    // Up and down lie over one another from above.
    const [dx, dy] = { up: [9, -9], down: [9, 10] }[TRACKER_SIDES[index]] ?? [0, -12];
    this.text(String(index), [x + dx, y + dy], color, { font: BOLD });
  }

  nose([x, y], headingDeg, color) {
    const angle = (headingDeg * Math.PI) / 180;
    const { context } = this;
    context.strokeStyle = color;
    context.lineWidth = 2;
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(x + 2.2 * TRACKER_PX * Math.sin(angle), y - 2.2 * TRACKER_PX * Math.cos(angle));
    context.stroke();
  }

  paintCenter({ center_m: centerM }) {
    if (centerM) this.dot(this.at(centerM), 3.5, themeColor("bright"));
  }

  dot([x, y], radius, color) {
    const { context } = this;
    context.fillStyle = color;
    context.beginPath();
    context.arc(x, y, radius, 0, 2 * Math.PI);
    context.fill();
  }

  arrow(fromM, velocityMps, color) {
    const toM = fromM.map((one, axis) => one + ARROW_S * velocityMps[axis]);
    const [[x, y], [toX, toY]] = [this.at(fromM), this.at(toM)];
    const length = Math.hypot(toX - x, toY - y);
    if (length < 8) return;
    this.line([fromM, toM], color, { width: 2 });
    const angle = Math.atan2(toY - y, toX - x);
    const { context } = this;
    context.fillStyle = color;
    context.beginPath();
    context.moveTo(toX, toY);
    for (const side of [-1, 1]) context.lineTo(toX - 9 * Math.cos(angle + side * 0.45), toY - 9 * Math.sin(angle + side * 0.45));
    context.fill();
  }

  paintNorth() {
    const { context } = this;
    const color = themeColor("green");
    const [x, top] = [18, 14];
    context.fillStyle = color;
    context.beginPath();
    for (const [dx, dy] of [[0, 0], [5, 13], [0, 10], [-5, 13]]) context.lineTo(x + dx, top + dy);
    context.fill();
    this.text("N", [x, top + 21], color, { font: BOLD });
  }

  paintScale() {
    const { width, height } = this.size;
    const lengthM = roundBelow((0.3 * width) / this.perM);
    const [right, y] = [width - 12, height - 10];
    const left = right - lengthM * this.perM;
    const { context } = this;
    context.strokeStyle = themeColor("text");
    context.lineWidth = 1.5;
    context.beginPath();
    for (const x of [left, right]) {
      context.moveTo(x, y - 4);
      context.lineTo(x, y + 4);
    }
    context.moveTo(left, y);
    context.lineTo(right, y);
    context.stroke();
    this.text(`${lengthM} m`, [(left + right) / 2, y - 10], themeColor("text"));
  }
}

// The greatest of 1, 2, 5, 10, 20 ... that is no more than this.
function roundBelow(length) {
  const power = 10 ** Math.floor(Math.log10(length));
  const found = ROUND.findLast((one) => one * power <= length * (1 + 1e-9)) ?? 1;
  return Number((found * power).toPrecision(1));
}

function swarm(frame) {
  return [...frame.trackers.map((tracker) => tracker.position_m), frame.center_m].filter(Boolean);
}

function everything(frame) {
  const { center_m: centerM, estimate, target_m: targetM, interception } = frame;
  const points = [...swarm(frame), ...frame.path_m.slice(-RECENT_POINTS)];
  if (targetM) points.push(targetM);
  if (!estimate || !centerM) return points;
  points.push(estimate.position_m);
  const reachM = FARTHEST * Math.max(LEAST_HALF_M, distance(estimate.position_m, centerM));
  const more = [interception?.position_m, ...(estimate.region ? ellipseOf(estimate.region) : [])];
  return [...points, ...more.filter((point) => point && distance(point, centerM) < reachM)];
}

function distance([east, north], [otherEast, otherNorth]) {
  return Math.hypot(east - otherEast, north - otherNorth);
}

// The shadow of the ellipsoid m + A u, |u| <= 1, on the ground: m + A2 u with the first two rows of A. Its edge is where
// A2 turns a circle to: of A2 A2' = L L', L (cos, sin).
export function ellipseOf({ center_m: [east, north], half_axes_m: axes }) {
  const sum = (one, other) => axes.reduce((total, axis) => total + axis[one] * axis[other], 0);
  const first = Math.sqrt(sum(0, 0));
  const cross = first > 0 ? sum(0, 1) / first : 0;
  const second = Math.sqrt(Math.max(0, sum(1, 1) - cross * cross));
  return Array.from({ length: ELLIPSE_POINTS }, (_, index) => {
    const angle = (2 * Math.PI * index) / ELLIPSE_POINTS;
    return [east + first * Math.cos(angle), north + cross * Math.cos(angle) + second * Math.sin(angle)];
  });
}

function inWords({ center_m: centerM, estimate, interception }) {
  if (!centerM) return "Map: nobody is there yet";
  const where = estimate
    ? `the target is believed ${number(estimate.distance_m, 0)} m away, bearing ${bearing(estimate.bearing_deg)}`
    : "it is not said where the target is believed to be";
  const met = interception?.time_to_go_s ? `, to be met in ${number(interception.time_to_go_s, 0)} s` : "";
  return `Map, north up: ${where}${met}`;
}
