// Marks of what has happened on the slider of time, and the way from one to the next.

import { clock } from "./format.js";

// An event this near to the moment that is shown is the one that is looked at.
const SAME_S = 0.06;
const MARKED = ["success", "warning", "critical"];

export class EventMarks {
  // seek(seconds): show that moment.
  constructor(root, seek) {
    this.root = root;
    this.seek = seek;
    this.place = root.querySelector("#marks");
    this.before = root.querySelector("#event-before");
    this.after = root.querySelector("#event-after");
    this.timesS = [];
    this.key = "";
    this.before.addEventListener("click", () => this.go(-1));
    this.after.addEventListener("click", () => this.go(1));
  }

  // events: of the newest frame, which knows all; the range is the slider's.
  setEvents(events, firstS, lastS) {
    const last = events.at(-1);
    const key = `${events.length} ${last?.time_s} ${last?.text} ${firstS} ${lastS}`;
    if (key === this.key) return;
    this.key = key;
    const shown = events.filter((event) => event.time_s >= firstS && event.time_s <= lastS);
    this.timesS = [...new Set(shown.map((event) => event.time_s))];
    const marked = shown.filter((event) => MARKED.includes(event.severity) || event.text.includes("->"));
    this.place.replaceChildren(...marked.map((event) => addedMark(event, firstS, lastS)));
    this.draw(this.timeS ?? lastS);
  }

  draw(timeS) {
    this.timeS = timeS;
    this.before.disabled = this.next(-1) === undefined;
    this.after.disabled = this.next(1) === undefined;
  }

  next(direction) {
    if (direction < 0) return this.timesS.findLast((one) => one < this.timeS - SAME_S);
    return this.timesS.find((one) => one > this.timeS + SAME_S);
  }

  go(direction) {
    const timeS = this.next(direction);
    if (timeS !== undefined) this.seek(timeS);
  }
}

function addedMark(event, firstS, lastS) {
  const mark = document.createElement("i");
  mark.dataset.severity = event.severity;
  mark.title = `${clock(event.time_s)} ${event.text}`;
  mark.style.setProperty("--at", (event.time_s - firstS) / Math.max(lastS - firstS, 1e-9));
  return mark;
}
