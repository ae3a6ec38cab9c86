// What the operator can say, and the care that it is said on purpose.

import { setText } from "./format.js";

const UNDER_WAY = ["connecting", "sampling", "moving", "holding"];
// A button that has just got another meaning, or just been armed, ignores the second half of a double click.
const TOO_SOON_MS = 400;
const ARMED_MS = 3000;
const TOLD_MS = 3000;

const LABELS = { start: "Start", hold: "Hold", resume: "Resume" };

export class Operator {
  // say(word) returns whether the word has left.
  constructor(root, say) {
    this.root = root;
    this.say = say;
    this.said = root.querySelector("#said");
    this.hold = root.querySelector("#hold");
    this.changedMs = 0;
    this.hold.addEventListener("click", () => {
      if (performance.now() - this.changedMs > TOO_SOON_MS) this.tell(this.hold.dataset.word);
    });
    this.abort = new ConfirmedButton(root.querySelector("#abort"), "Abort", "Confirm abort", () => this.tell("abort"));
    const reached = root.querySelector("#reached");
    this.reached = new ConfirmedButton(reached, "Target reached", "Confirm reached", () => this.tell("reached"));
  }

  // frame: the newest of a live chase; null in a replay.
  draw(frame, isConnected) {
    this.root.hidden = frame === null;
    if (frame === null) return;
    const word = holdWord(frame);
    if (this.hold.dataset.word !== word) {
      this.hold.dataset.word = word;
      this.changedMs = performance.now();
      setText(this.hold, LABELS[word]);
    }
    const canHold = frame.state === "idle" || frame.state === "reached" || UNDER_WAY.includes(frame.state);
    this.hold.disabled = !(isConnected && canHold);
    this.reached.enable(isConnected && UNDER_WAY.includes(frame.state));
    this.abort.enable(isConnected && frame.state !== "aborted");
  }

  tell(word) {
    const text = this.say(word) ? `sent: ${word}` : `not sent: ${word}`;
    setText(this.said, text);
    clearTimeout(this.toldTimer);
    this.toldTimer = setTimeout(() => setText(this.said, ""), TOLD_MS);
  }
}

// Who holds for another cause can be made to hold until the operator resumes; who has reached can be sent on.
function holdWord(frame) {
  if (frame.state === "idle") return "start";
  const isHeld = frame.state === "holding" && frame.reason.includes("the operator holds");
  return isHeld || frame.state === "reached" ? "resume" : "hold";
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
      this.button.dataset.armed = "true";
      setText(this.button, this.question);
      this.timer = setTimeout(() => this.disarm(), ARMED_MS);
    } else if (performance.now() - this.armedMs > TOO_SOON_MS) {
      this.disarm();
      this.act();
    }
  }

  disarm() {
    clearTimeout(this.timer);
    this.armedMs = null;
    this.button.dataset.armed = "false";
    setText(this.button, this.label);
  }
}
