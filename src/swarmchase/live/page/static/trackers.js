// One row a tracker: how it is, and how old and how complete is what it says.

import { NOTHING, TRACKER_COLORS, TRACKER_SIDES, age, agedBy, metres, number, setText, share, staleness } from "./format.js";

const COLUMNS = ["mode", "status", "position", "level", "rssi-age", "position-age", "loss", "missing"];
const HIGH_SHARE = 0.2;

export class TrackerTable {
  constructor(table) {
    this.rows = TRACKER_COLORS.map((color, index) => addRow(table.tBodies[0], color, index));
  }

  draw(frame, extraS) {
    frame.trackers.forEach((tracker, index) => drawRow(this.rows[index], tracker, extraS));
  }
}

function addRow(body, color, index) {
  const row = body.insertRow();
  row.dataset.tracker = index;
  row.dataset.stale = "";
  const name = row.insertCell();
  const swatch = document.createElement("span");
  swatch.className = "swatch";
  swatch.style.setProperty("--color", color);
  swatch.textContent = index;
  name.append(swatch, TRACKER_SIDES[index]);
  const cells = {};
  for (const column of COLUMNS) {
    cells[column] = row.insertCell();
    cells[column].dataset.column = column;
    if (!["mode", "status"].includes(column)) cells[column].classList.add("number");
  }
  cells.position.classList.add("wide");
  return { row, cells };
}

function drawRow({ row, cells }, tracker, extraS) {
  const stale = staleness(tracker, extraS);
  row.dataset.stale = stale;
  setText(cells.mode, tracker.mode ?? NOTHING);
  cells.mode.classList.toggle("warning", tracker.mode === "manual");
  setText(cells.status, stale || "ok");
  cells.status.classList.toggle("trouble", stale !== "");
  setText(cells.position, metres(tracker.position_m));
  const level = tracker.rssi_dbm.findLast((one) => one !== null);
  setText(cells.level, level === undefined ? NOTHING : `${number(level)} dBm`);
  setText(cells["rssi-age"], age(agedBy(tracker.rssi_age_s, extraS)));
  setText(cells["position-age"], age(agedBy(tracker.position_age_s, extraS)));
  setText(cells.loss, share(tracker.loss_share));
  cells.loss.classList.toggle("warning", (tracker.loss_share ?? 0) > HIGH_SHARE);
  setText(cells.missing, share(tracker.missing_share));
  cells.missing.classList.toggle("warning", tracker.missing_share > HIGH_SHARE);
}
