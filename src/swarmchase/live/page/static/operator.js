// What the operator can say, and the care that it is said on purpose.
//
// Hold is said by one press, or the key H: it harms nothing. Abort is said by one press that lasts, on the button or the
// key A. Start and Target reached ask once more.

import { hasEnded, setText } from "./format.js";

// A button that has just got another meaning, or just been armed, ignores the second half of a double click.
const TOO_SOON_MS = 400;
const ARMED_MS = 4000;
const TOLD_MS = 3000;
const LASTING_MS = 500; // as in page.css

const LABELS = { start: "Start", hold: "Hold", resume: "Resume" };

export class Operator {
  // say(word) returns whether the word has left.
  constructor(root, say) {
    this.root = root;
    this.say = say;
    this.said = root.querySelector("#said");
    this.now = root.querySelector("#now");
    this.hold = root.querySelector("#hold");
    this.changedMs = 0;
    this.start = new ConfirmedButton(root.querySelector("#start"), "Start", "Confirm start", () => this.tell("start"));
    this.hold.addEventListener("click", () => {
      if (performance.now() - this.changedMs > TOO_SOON_MS) this.tell(this.hold.dataset.word);
    });
    onKey("h", () => !this.root.hidden && !this.hold.disabled && this.isUnderWay && this.tell("hold"));
    this.abort = new LastingButton(root.querySelector("#abort"), "a", {
      act: () => this.tell("abort"),
      tooShort: () => this.note("keep pressing to abort"),
    });
    const reached = root.querySelector("#reached");
    this.reached = new ConfirmedButton(reached, "Target reached", "Confirm reached", () => this.tell("reached"));
  }

  // frame: the newest of a live chase; null in a replay. isPast: the page shows an earlier moment.
  draw(frame, isConnected, isPast) {
    this.root.hidden = frame === null;
    if (frame === null) return;
    this.isUnderWay = frame.state !== "idle" && !hasEnded(frame);
    const isIdle = frame.state === "idle";
    const word = holdWord(frame);
    if (this.hold.dataset.word !== word) {
      this.hold.dataset.word = word;
      this.changedMs = performance.now();
      setText(this.hold.firstElementChild, LABELS[word]);
      this.hold.querySelector("kbd").hidden = word !== "hold";
    }
    this.start.button.hidden = !isIdle;
    this.hold.hidden = isIdle;
    this.start.enable(isConnected && isIdle);
    this.hold.disabled = !(isConnected && (frame.state === "reached" || this.isUnderWay));
    this.reached.enable(isConnected && this.isUnderWay);
    this.abort.enable(isConnected && frame.state !== "aborted");
    this.now.hidden = !isPast;
    setText(this.now, `now: ${frame.state}`);
  }

  tell(word) {
    this.note(this.say(word) ? `sent: ${word}` : `not sent: ${word}`);
  }

  note(text) {
    setText(this.said, text);
    clearTimeout(this.toldTimer);
    this.toldTimer = setTimeout(() => setText(this.said, ""), TOLD_MS);
  }
}

// Who holds for another cause can be made to hold until the operator resumes; who has reached can be sent on.
function holdWord(frame) {
  const isHeld = frame.state === "holding" && frame.reason.includes("the operator holds");
  return isHeld || frame.state === "reached" ? "resume" : "hold";
}

// A key by itself, where nobody types.
function isKey(event, key) {
  const isTyped = event.target instanceof Element && event.target.matches("input:not([type=range]), select, textarea");
  return event.key.toLowerCase() === key && !event.ctrlKey && !event.altKey && !event.metaKey && !isTyped;
}

function onKey(key, act) {
  document.addEventListener("keydown", (event) => {
    if (isKey(event, key) && !event.repeat) act();
  });
}

// Acts once it has been pressed for a while: by a pointer, by its key, or by Enter or the space bar on it.
class LastingButton {
  constructor(button, key, { act, tooShort }) {
    this.button = button;
    this.act = act;
    this.tooShort = tooShort;
    this.stop();
    const isOwn = (event) => isKey(event, key) || (event.target === button && ["Enter", " "].includes(event.key));
    button.addEventListener("pointerdown", (event) => event.button === 0 && this.press());
    for (const end of ["pointerup", "pointerleave", "pointercancel"]) {
      button.addEventListener(end, () => this.release());
    }
    button.addEventListener("contextmenu", (event) => event.preventDefault());
    document.addEventListener("keydown", (event) => {
      if (!isOwn(event)) return;
      event.preventDefault();
      if (!event.repeat) this.press();
    });
    document.addEventListener("keyup", (event) => isOwn(event) && this.release());
    window.addEventListener("blur", () => this.release());
    // A click without a pointer is a screen reader's or a switch's, which cannot press for a while.
    button.addEventListener("click", (event) => event.detail === 0 && event.pointerType === "" && this.act());
  }

  enable(isEnabled) {
    this.button.disabled = !isEnabled;
    if (!isEnabled) this.stop();
  }

  press() {
    if (this.button.disabled || this.button.closest("[hidden]") || this.timer !== null) return;
    this.button.dataset.pressed = "true";
    this.timer = setTimeout(() => {
      this.stop();
      this.act();
    }, LASTING_MS);
  }

  release() {
    if (this.timer === null) return;
    this.stop();
    this.tooShort();
  }

  stop() {
    clearTimeout(this.timer);
    this.timer = null;
    this.button.dataset.pressed = "false";
  }
}

class ConfirmedButton {
  constructor(button, label, question, act) {
    this.button = button;
    this.label = label;
    this.question = question;
    this.act = act;
    this.disarm();
    button.addEventListener("click", () => this.click());
  }

  enable(isEnabled) {
    this.button.disabled = !isEnabled;
    if (!isEnabled) this.disarm();
  }

  click() {
    if (this.armedMs === null) {
      this.armedMs = performance.now();
      this.arm(true, this.question);
      this.timer = setTimeout(() => this.disarm(), ARMED_MS);
    } else if (performance.now() - this.armedMs > TOO_SOON_MS) {
      this.disarm();
      this.act();
    }
  }

  disarm() {
    clearTimeout(this.timer);
    this.armedMs = null;
    this.arm(false, this.label);
  }

  arm(isArmed, label) {
    this.button.dataset.armed = String(isArmed);
    this.button.setAttribute("aria-pressed", String(isArmed));
    setText(this.button, label);
  }
}
