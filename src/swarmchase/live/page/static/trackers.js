// One row a tracker: how it is, and how old and how complete is what it says.

import { NOTHING, TRACKER_SIDES, age, agedBy, metres, number, setText, share, staleness } from "./format.js";

const COLUMNS = {
  mode: "mode", status: "status", position: "E N U, m", level: "level", battery: "battery", gps: "GPS", heading: "heading",
  "rssi-age": "RSSI age", "position-age": "pos. age", loss: "loss", missing: "missing",
};
const HEALTH = ["battery", "gps", "heading"];
const HIGH_SHARE = 0.2;
const LOW_PERCENT = 25;
// Of MAVLink's GPS_FIX_TYPE; below the fourth a place in space is not known.
const FIXES = ["none", "none", "2D", "3D", "DGPS", "RTK float", "RTK", "static", "PPP"];
const LEAST_FIX = 3;

export class TrackerTable {
  constructor(table) {
    this.table = table;
    this.rows = TRACKER_SIDES.map((side, index) => addRow(table.tBodies[0], side, index));
  }

  draw(frame, extraS) {
    this.table.dataset.health = String(frame.trackers.some((tracker) => tracker.health));
    frame.trackers.forEach((tracker, index) => drawRow(this.rows[index], tracker, extraS));
  }
}

function addRow(body, side, index) {
  const row = body.insertRow();
  row.setAttribute("role", "row");
  row.dataset.tracker = index;
  row.dataset.stale = "";
  const name = document.createElement("th");
  name.scope = "row";
  name.setAttribute("role", "rowheader");
  row.append(name);
  const swatch = document.createElement("span");
  swatch.className = "swatch";
  swatch.style.setProperty("--color", `var(--tracker-${index})`);
  swatch.textContent = index;
  name.append(swatch, side);
  const cells = {};
  for (const [column, title] of Object.entries(COLUMNS)) {
    cells[column] = row.insertCell();
    cells[column].setAttribute("role", "cell");
    cells[column].dataset.column = column;
    cells[column].dataset.title = title;
    if (HEALTH.includes(column)) cells[column].classList.add("health");
    if (!["mode", "status"].includes(column)) cells[column].classList.add("number");
  }
  cells.position.classList.add("wide");
  return { row, cells, detail: addDetail(body) };
}

// What does not fit in a column, where there is anything to say.
function addDetail(body) {
  const row = body.insertRow();
  row.className = "detail";
  row.hidden = true;
  row.setAttribute("role", "row");
  const cell = row.insertCell();
  cell.setAttribute("role", "cell");
  cell.colSpan = 1 + Object.keys(COLUMNS).length;
  return { row, cell };
}

function drawRow({ row, cells, detail }, tracker, extraS) {
  const stale = staleness(tracker, extraS);
  const { status, isTrouble } = statusOf(tracker, stale);
  row.dataset.stale = stale;
  setText(cells.mode, tracker.mode ?? NOTHING);
  cells.mode.classList.toggle("warning", tracker.mode === "manual");
  setText(cells.status, status);
  cells.status.classList.toggle("trouble", isTrouble);
  setText(cells.position, metres(tracker.position_m));
  const level = tracker.rssi_dbm.findLast((one) => one !== null);
  setText(cells.level, level === undefined ? NOTHING : `${number(level)} dBm`);
  setText(cells["rssi-age"], age(agedBy(tracker.rssi_age_s, extraS)));
  setText(cells["position-age"], age(agedBy(tracker.position_age_s, extraS)));
  setText(cells.loss, share(tracker.loss_share));
  cells.loss.classList.toggle("warning", (tracker.loss_share ?? 0) > HIGH_SHARE);
  setText(cells.missing, share(tracker.missing_share));
  cells.missing.classList.toggle("warning", tracker.missing_share > HIGH_SHARE && stale !== "waiting");
  drawHealth(cells, tracker.health);
  const more = details(tracker);
  detail.row.hidden = more === "";
  setText(detail.cell, more);
}

function drawHealth(cells, health) {
  const percent = health?.battery_percent ?? null;
  setText(cells.battery, percent === null ? NOTHING : `${percent} %`);
  cells.battery.classList.toggle("warning", percent !== null && percent < LOW_PERCENT);
  const fix = health?.gps_fix ?? null;
  const satellites = health?.satellites ?? null;
  setText(cells.gps, fix === null ? NOTHING : satellites === null ? FIXES[fix] : `${FIXES[fix]} ${satellites}`);
  cells.gps.classList.toggle("warning", fix !== null && fix < LEAST_FIX);
  const headingDeg = health?.heading_deg ?? null;
  setText(cells.heading, headingDeg === null ? NOTHING : `${String(Math.round(headingDeg) % 360).padStart(3, "0")}°`);
}

function statusOf(tracker, stale) {
  if (stale === "waiting") return { status: stale, isTrouble: false };
  if (stale === "" && tracker.condition === "left out") return { status: "left out", isTrouble: true };
  return { status: stale || "ok", isTrouble: stale !== "" };
}

function details(tracker) {
  const dropped = Object.entries(tracker.dropped).map(([reason, count]) => `${count} ${reason}`);
  const parts = [
    tracker.left_out && `left out: ${tracker.left_out}`,
    dropped.length && `samples dropped: ${dropped.join(", ")}`,
    ...tracker.notices.map(({ severity, text }) => `says (${severity}): ${text}`),
  ];
  return parts.filter(Boolean).join("; ");
}
