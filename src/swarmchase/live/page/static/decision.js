// The last decision: what speaks for each choice, and which was taken.

import { number, setText, share } from "./format.js";

const AXES = ["spacing", "east", "north", "up"];
const SAME_M = 1e-6;

export class DecisionPanel {
  constructor(container, numberLabel, note) {
    this.container = container;
    this.numberLabel = numberLabel;
    this.note = note;
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
    this.rows.forEach((row, index) => drawRow(row, values[index], shares?.[index] ?? null, index > 0));
    setText(this.numberLabel, decision ? `movement ${decision.movement}` : "none yet");
    const changed = decision?.changed ? `Changed: ${decision.changed}` : "";
    const without = decision && shares === null ? "Shares of the choices: this controller gives none." : "";
    this.note.dataset.changed = String(changed !== "");
    setText(this.note, [changed, without].filter(Boolean).join(" "));
  }
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
  const cells = choicesM.map((choiceM) => {
    const bar = document.createElement("div");
    bar.className = "bar";
    const label = document.createElement("span");
    label.textContent = signed(choiceM, isSigned);
    const part = document.createElement("span");
    part.className = "share";
    bar.append(label, part);
    bars.append(bar);
    return { bar, part, choiceM };
  });
  const value = document.createElement("span");
  value.className = "value";
  container.append(name, bars, value);
  return { cells, value };
}

function drawRow({ cells, value }, chosenM, shares, isSigned) {
  cells.forEach(({ bar, part, choiceM }, index) => {
    bar.dataset.chosen = String(chosenM !== null && Math.abs(choiceM - chosenM) < SAME_M);
    bar.style.setProperty("--share", shares ? (shares[index] ?? 0) : 0);
    setText(part, shares ? share(shares[index]) : "");
  });
  setText(value, chosenM === null ? "" : `${signed(chosenM, isSigned)} m`);
}
