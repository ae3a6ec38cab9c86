// Which moment is shown: the newest of a live chase, a past one, or the next of a replay.

import { EventMarks } from "./event_marks.js";
import { clock } from "./format.js";

const PLAY_STEP_MS = 100;

export class Timeline {
  // seek(seconds): ask the service for the frame of that time; follow(): show the newest again.
  constructor(root, { seek, follow }) {
    this.seek = seek;
    this.follow = follow;
    this.slider = root.querySelector("#slider");
    this.shownTime = root.querySelector("#shown-time");
    this.playButton = root.querySelector("#play");
    this.rate = root.querySelector("#rate");
    this.rateLabel = root.querySelector("#rate-label");
    this.liveButton = root.querySelector("#live");
    this.marks = new EventMarks(root, (timeS) => this.goTo(timeS));
    this.isLive = true;
    this.isFollowing = true;
    this.isPlaying = false;
    this.firstS = 0;
    this.lastS = 0;
    this.timeS = null;
    // One question at a time: while an answer is awaited, only the newest wish is kept.
    this.isAsking = false;
    this.wishS = null;
    this.slider.addEventListener("input", () => this.goTo(Number(this.slider.value)));
    this.liveButton.addEventListener("click", () => this.goLive());
    this.playButton.addEventListener("click", () => (this.isPlaying ? this.pause() : this.play()));
    setInterval(() => this.step(), PLAY_STEP_MS);
  }

  setInfo(info) {
    this.isLive = info.is_live;
    this.isFollowing = info.is_live && this.isFollowing;
    this.liveButton.hidden = !info.is_live;
    this.playButton.hidden = info.is_live;
    this.rateLabel.hidden = info.is_live;
  }

  // A new connection: what was asked on the old one will not be answered.
  restart() {
    this.isAsking = false;
    if (!this.isFollowing && this.timeS !== null) this.ask(this.timeS);
  }

  // events: all until lastS.
  setRange(firstS, lastS, events) {
    this.firstS = firstS;
    this.lastS = lastS;
    this.slider.min = firstS;
    this.slider.max = lastS;
    this.slider.disabled = !(lastS > firstS);
    if (this.isFollowing) {
      this.timeS = lastS;
    } else if (this.timeS === null) {
      this.timeS = firstS;
      this.ask(firstS);
      this.play();
    }
    this.marks.setEvents(events, firstS, lastS);
    this.draw();
  }

  goTo(timeS) {
    if (this.isLive) this.isFollowing = false;
    else if (timeS < this.lastS) this.lastStepMs = performance.now();
    this.timeS = timeS;
    this.ask(timeS);
    this.draw();
  }

  goLive() {
    this.isFollowing = true;
    this.wishS = null;
    this.timeS = this.lastS;
    this.follow();
    this.draw();
  }

  play() {
    if (this.timeS >= this.lastS) this.timeS = this.firstS;
    this.isPlaying = true;
    this.lastStepMs = performance.now();
    this.draw();
  }

  pause() {
    this.isPlaying = false;
    this.draw();
  }

  step() {
    if (!this.isPlaying) return;
    const nowMs = performance.now();
    const elapsedS = ((nowMs - this.lastStepMs) / 1000) * Number(this.rate.value);
    this.lastStepMs = nowMs;
    const timeS = Math.min(this.lastS, this.timeS + elapsedS);
    if (timeS >= this.lastS) this.isPlaying = false;
    this.goTo(timeS);
  }

  ask(timeS) {
    this.wishS = timeS;
    if (this.isAsking) return;
    this.isAsking = this.seek(timeS);
    if (this.isAsking) this.wishS = null;
  }

  // The answer has come.
  answered() {
    this.isAsking = false;
    if (this.wishS !== null) this.ask(this.wishS);
  }

  draw() {
    if (this.timeS === null) return;
    this.slider.value = this.timeS;
    this.marks.draw(this.timeS);
    document.body.dataset.past = String(this.isLive && !this.isFollowing);
    this.liveButton.setAttribute("aria-pressed", String(this.isFollowing));
    this.playButton.setAttribute("aria-pressed", String(this.isPlaying));
    this.playButton.textContent = this.isPlaying ? "Pause" : "Play";
    const bold = document.createElement("b");
    bold.textContent = clock(this.timeS);
    const isPast = this.isLive && !this.isFollowing;
    const beside = isPast ? ` PAST, ${clock(this.lastS - this.timeS)} ago` : this.isLive ? " newest" : ` of ${clock(this.lastS)}`;
    this.shownTime.replaceChildren(bold, beside);
  }
}
