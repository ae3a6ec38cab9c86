// The last decision: what speaks for each choice, and which was taken.

import { number, setText, share } from "./format.js";

const AXES = ["spacing", "east", "north", "up"];
const SAME_M = 1e-6;
// Shares are rounded to this.
const SAME_SHARE = 1e-3;

export class DecisionPanel {
  constructor(container, numberLabel, note) {
    this.container = container;
    this.numberLabel = numberLabel;
    this.changed = note.firstElementChild;
    this.why = note.lastElementChild;
    this.rows = [];
  }

  setInfo(info) {
    const displacement = info.displacement_choices_m ?? [];
    const choices = [info.spacing_choices_m ?? [], displacement, displacement, displacement];
    this.container.replaceChildren();
    this.rows = AXES.map((axis, index) => addRow(this.container, axis, choices[index], index > 0));
  }

  draw(frame) {
    const decision = frame.decision;
    const shares = decision?.choice_share ?? null;
    const values = decision ? [decision.spacing_m, ...decision.displacement_m] : [null, null, null, null];
    const against = this.rows.filter((row, index) => {
      drawRow(row, values[index], shares?.[index] ?? null, index > 0);
      return row.isAgainstMost;
    });
    setText(this.numberLabel, decision ? what(decision) : "none yet");
    const changed = decision?.changed ? `Flown otherwise: ${decision.changed}.` : "";
    const without = decision && shares === null ? "This controller does not say what speaks for each choice." : "";
    const why = against.length ? whyAgainst(against.map((row) => row.axis), Boolean(frame.belief_m)) : "";
    setText(this.changed, changed);
    setText(this.why, [without, shares && meaning(Boolean(frame.belief_m)), why].filter(Boolean).join(" "));
  }
}

function what(decision) {
  return decision.movement ? `movement ${decision.movement}; what is taken is outlined` : "not carried out";
}

function meaning(isBelief) {
  return isBelief ? "Bars: what each choice is expected to save of the way." : "Bars: how probable each choice is.";
}

// A policy is drawn from, and may take what has less than the most. A belief is not, but for two that are nearly the same.
function whyAgainst(axes, isBelief) {
  const because = isBelief
    ? "nothing was heard, or choices are nearly the same"
    : "choices are drawn by chance with these probabilities";
  return `Not the longest bar at ${axes.join(", ")}: ${because}.`;
}

function signed(value, isSigned) {
  return (isSigned && value > 0 ? "+" : "") + number(value, Number.isInteger(value) ? 0 : 1);
}

function addRow(container, axis, choicesM, isSigned) {
  const name = document.createElement("span");
  name.className = "axis";
  name.textContent = axis;
  const bars = document.createElement("div");
  bars.className = "bars";
  bars.dataset.axis = axis;
  bars.setAttribute("role", "list");
  bars.setAttribute("aria-label", `choices of ${axis}, metres`);
  const cells = choicesM.map((choiceM) => {
    const bar = document.createElement("div");
    bar.className = "bar";
    bar.setAttribute("role", "listitem");
    const fill = document.createElement("span");
    fill.className = "fill";
    const label = document.createElement("span");
    label.textContent = signed(choiceM, isSigned);
    const part = document.createElement("span");
    part.className = "share";
    const taken = document.createElement("span");
    taken.className = "unseen";
    bar.append(fill, label, part, taken);
    bars.append(bar);
    return { bar, part, taken, choiceM };
  });
  const value = document.createElement("span");
  value.className = "value";
  container.append(name, bars, value);
  return { axis, cells, value, isAgainstMost: false };
}

function drawRow(row, chosenM, shares, isSigned) {
  let chosenShare = null;
  row.cells.forEach(({ bar, part, taken, choiceM }, index) => {
    const isChosen = chosenM !== null && Math.abs(choiceM - chosenM) < SAME_M;
    bar.dataset.chosen = String(isChosen);
    bar.style.setProperty("--share", shares ? (shares[index] ?? 0) : 0);
    setText(part, shares ? share(shares[index]) : "");
    setText(taken, isChosen ? " taken" : "");
    if (isChosen && shares) chosenShare = shares[index];
  });
  row.isAgainstMost = chosenShare !== null && chosenShare < Math.max(...shares) - SAME_SHARE;
  setText(row.value, chosenM === null ? "" : `${signed(chosenM, isSigned)} m`);
}
