// What has happened, the newest first; and what of it is spoken to those who do not look.

import { clock, setText, severeItem } from "./format.js";

export class Events {
  constructor(list, spoken, spokenAlarm) {
    this.list = list;
    this.spoken = spoken;
    this.spokenAlarm = spokenAlarm;
    this.shown = "";
  }

  draw(frame) {
    const now = JSON.stringify(frame.events);
    if (now === this.shown) return;
    this.shown = now;
    this.list.replaceChildren(...[...frame.events].reverse().map(addedItem));
    this.list.parentElement.scrollTop = 0;
  }

  // frame: the newest of a live chase. What had happened before this page was opened is not news to it.
  speak(frame) {
    const last = frame.events.at(-1);
    const key = last && `${frame.epoch} ${last.time_s} ${last.text}`;
    if (this.spokenKey !== undefined && key !== this.spokenKey && last) {
      setText(last.severity === "critical" ? this.spokenAlarm : this.spoken, last.text);
    }
    this.spokenKey = key ?? "";
  }
}

function addedItem(event) {
  const time = document.createElement("time");
  time.textContent = clock(event.time_s);
  return severeItem(event.severity, time, ` ${event.text}`);
}
