// What the operator should know besides.

import { setText } from "./format.js";

export class Notices {
  constructor(alarms, rejected) {
    this.alarms = alarms;
    this.rejected = rejected;
    this.shown = null;
  }

  draw(frame) {
    this.drawAlarms(frame.alarms);
    const reasons = Object.entries(frame.rejected);
    const total = reasons.reduce((sum, [, count]) => sum + count, 0);
    const parts = reasons.map(([reason, count]) => `${reason} ${count}`).join(", ");
    this.rejected.dataset.any = String(total > 0);
    setText(this.rejected, total > 0 ? `rejected ${total}: ${parts}` : "rejected 0");
  }

  drawAlarms(alarms) {
    const now = JSON.stringify(alarms);
    if (now === this.shown) return;
    this.shown = now;
    const items = (alarms.length ? alarms : ["no alarms"]).map((text) => {
      const item = document.createElement("li");
      item.textContent = text;
      item.classList.toggle("none", alarms.length === 0);
      return item;
    });
    this.alarms.replaceChildren(...items);
  }
}
