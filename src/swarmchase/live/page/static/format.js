// Numbers as people read them, and the few names that all parts of the page share.

export const TRACKER_SIDES = ["east", "west", "north", "south", "up", "down"];

// A tracker that has not been heard for so long is stale; so is everything when no frame has come for so long.
export const STALE_S = 1.0;

const EASING_MS = 80;
const LONGEST_STEP_MS = 500;
const REDUCED_MOTION = window.matchMedia("(prefers-reduced-motion: reduce)");

export const NOTHING = "–";

export function number(value, digits = 1) {
  if (value === null || value === undefined) return NOTHING;
  const text = value.toFixed(digits);
  return Number(text) === 0 ? text.replace("-", "") : text.replace("-", "−");
}

export function age(seconds) {
  if (seconds === null || seconds === undefined) return NOTHING;
  return seconds < 100 ? `${seconds.toFixed(1)} s` : `${Math.round(seconds)} s`;
}

export function share(value) {
  return value === null || value === undefined ? NOTHING : `${Math.round(100 * value)} %`;
}

export function metres(point, digits = 1) {
  return point ? point.map((coordinate) => number(coordinate, digits)).join(", ") : NOTHING;
}

// 75.31 -> 1:15.3
export function clock(seconds) {
  const tenths = Math.max(0, Math.round(seconds * 10));
  const minutes = Math.floor(tenths / 600);
  return `${minutes}:${String(Math.floor((tenths % 600) / 10)).padStart(2, "0")}.${tenths % 10}`;
}

// An age of the frame, seen some seconds after the frame was made.
export function agedBy(seconds, extraS) {
  return seconds === null || seconds === undefined ? null : seconds + extraS;
}

// Why a tracker's data must not be taken for the present: "waiting", "lost", "silent", "stale"; else empty.
export function staleness(tracker, extraS) {
  if (tracker.condition === "expected") return "waiting";
  if (tracker.is_lost) return "lost";
  if (tracker.is_silent) return "silent";
  const ages = [tracker.position_age_s, tracker.rssi_age_s].map((one) => agedBy(one, extraS));
  return ages.some((one) => one === null || one > STALE_S) ? "stale" : "";
}

// 45 -> 045° NE
export function bearing(degrees) {
  const points = ["N", "NE", "E", "SE", "S", "SW", "W", "NW"];
  const whole = Math.round(degrees) % 360;
  return `${String(whole).padStart(3, "0")}° ${points[Math.round(whole / 45) % 8]}`;
}

// States after which nothing is commanded any more.
export function hasEnded(frame) {
  return frame.ended_s !== null || ["reached", "aborted"].includes(frame.state);
}

// What severity looks like without its colour; the word is for those who do not see the sign.
export const SIGNS = { info: "·", success: "✓", warning: "⚠", critical: "✖" };

// A list item that says how much it matters, with a sign and a word.
export function severeItem(severity, ...content) {
  const item = document.createElement("li");
  item.dataset.severity = severity;
  const sign = document.createElement("span");
  sign.className = "sign";
  sign.setAttribute("aria-hidden", "true");
  sign.textContent = SIGNS[severity] ?? SIGNS.info;
  const word = document.createElement("span");
  word.className = "unseen";
  word.textContent = severity === "info" ? "" : `${severity}: `;
  item.append(sign, word, ...content);
  return item;
}

// How much of the way to its goal a view goes in this time: as fast where few pictures are made as where many are.
export function easedShare(elapsedMs) {
  if (REDUCED_MOTION.matches) return 1;
  return 1 - Math.exp(-Math.min(elapsedMs, LONGEST_STEP_MS) / EASING_MS);
}

export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}
