// How the chase has ended: a card that stays.

import { NOTHING, clock, hasEnded, number, setText } from "./format.js";

const TITLES = { reached: "Target reached", lost: "Ended: target not reached", aborted: "Aborted" };

export class ResultCard {
  constructor(card) {
    this.card = card;
    this.parts = Object.fromEntries(
      ["title", "reason", "figures"].map((name) => [name, card.querySelector(`#result-${name}`)]),
    );
  }

  draw(frame) {
    this.card.hidden = !hasEnded(frame);
    if (this.card.hidden) return;
    this.card.dataset.state = frame.state;
    setText(this.parts.title, TITLES[frame.state]);
    setText(this.parts.reason, frame.reason || NOTHING);
    const after = frame.ended_s === null ? "" : ` in ${clock(frame.ended_s)}`;
    const truth = distanceToTruthM(frame);
    const told = truth === null ? "" : `; the simulated target is ${number(truth)} m from the centre`;
    setText(this.parts.figures, `${frame.movements} movements${after}${told}.`);
  }
}

// How far the centre is from where a simulation has the target; null of real ones.
export function distanceToTruthM(frame) {
  if (!frame.target_m || !frame.center_m) return null;
  return Math.hypot(...frame.target_m.map((one, axis) => one - frame.center_m[axis]));
}
