// What is wrong now, and what the link has turned away. The service decides what that is; here it is only shown.

import { setText, severeItem } from "./format.js";

export class Alarms {
  constructor(list, rejected) {
    this.list = list;
    this.rejected = rejected;
    this.items = new Map(); // by severity and tracker and the beginning of the text: what stays is not spoken again
    this.none = severeItem("none", "no alarms");
    this.list.replaceChildren(this.none);
  }

  draw(frame) {
    this.drawAlarms(frame.alarms);
    const reasons = Object.entries(frame.rejected);
    const total = reasons.reduce((sum, [, count]) => sum + count, 0);
    const parts = reasons.map(([reason, count]) => `${reason} ${count}`).join(", ");
    this.rejected.dataset.any = String(total > 0);
    setText(this.rejected, total > 0 ? `rejected since the start ${total}: ${parts}` : "rejected 0");
  }

  drawAlarms(alarms) {
    const now = new Map();
    for (const alarm of alarms) {
      const key = [alarm.severity, alarm.tracker, alarm.text.split(":")[0]].join(" ");
      const item = this.items.get(key) ?? addedItem(alarm);
      setText(item.lastChild, alarm.text);
      now.set(key, item);
    }
    const isSame = [...now.keys()].join() === [...this.items.keys()].join();
    if (!isSame) this.list.replaceChildren(...(now.size ? now.values() : [this.none]));
    this.items = now;
  }
}

function addedItem(alarm) {
  const text = document.createElement("span");
  const item = severeItem(alarm.severity, text);
  if (alarm.tracker !== null) item.dataset.tracker = alarm.tracker;
  return item;
}
