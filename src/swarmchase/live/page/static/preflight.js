// What must be right before the start: a list of checks, and the word that overrides them.

import { setText, severeItem } from "./format.js";

const WORD = "override";

export class Preflight {
  // say(word) returns whether the word has left.
  constructor(panel, say) {
    this.panel = panel;
    this.list = panel.querySelector("#preflight");
    this.form = panel.querySelector("#override-form");
    this.typed = panel.querySelector("#override-word");
    this.button = panel.querySelector("#override");
    this.shown = "";
    this.typed.addEventListener("input", () => this.allow());
    this.form.addEventListener("submit", (event) => {
      event.preventDefault();
      if (!this.button.disabled && say(WORD)) this.typed.value = "";
      this.allow();
    });
    this.allow();
  }

  // isLive: words have an effect.
  draw(frame, isLive) {
    this.panel.hidden = !["idle", "connecting"].includes(frame.state) || frame.preflight.length === 0;
    this.form.hidden = !isLive || !frame.preflight.some((check) => check.passed === false);
    const now = JSON.stringify(frame.preflight);
    if (now === this.shown) return;
    this.shown = now;
    this.list.replaceChildren(...frame.preflight.map(addedItem));
    const passed = frame.preflight.filter((check) => check.passed).length;
    setText(this.panel.querySelector("#preflight-count"), `${passed} of ${frame.preflight.length} passed`);
  }

  allow() {
    this.button.disabled = this.typed.value.trim().toLowerCase() !== WORD;
  }
}

function addedItem({ name, passed, text, tracker }) {
  const about = tracker === null ? name : `tracker ${tracker}, ${name}`;
  const word = passed === null ? "not known yet" : passed ? "passed" : "failed";
  const item = severeItem(passed === null ? "info" : passed ? "success" : "warning", `${about}: ${text || word}`);
  item.querySelector(".unseen").textContent = `${word}: `;
  item.dataset.passed = String(passed);
  return item;
}
