// The state of the chase and the figures beside it.

import { NOTHING, age, clock, hasEnded, number, setText } from "./format.js";

const $ = (id) => document.getElementById(id);
// Spoken once, not at every movement.
const SPOKEN = { sampling: "under way", moving: "under way", pursuing: "under way" };

export function showInfo(info) {
  const about = [info.controller, info.sampling_hz && `${info.sampling_hz} Hz`, info.version && `v${info.version}`];
  setText($("title"), info.title || about.filter(Boolean).join(" · "));
  $("title").title = [info.title, ...about].filter(Boolean).join(" · ");
}

export function showState(frame) {
  $("state").dataset.state = frame.state;
  $("state").dataset.epoch = frame.epoch;
  setText($("state-name"), frame.state);
  setText($("reason"), frame.reason || NOTHING);
  $("reason").title = frame.reason;
  setText($("spoken-state"), SPOKEN[frame.state] ?? frame.state);
  setText($("movements"), String(frame.movements));
  setText($("chase-time"), clock(frame.time_s));
  const latency = frame.decision_latency_ms;
  setText($("latency"), latency === null ? NOTHING : `${number(latency, latency < 10 ? 1 : 0)} ms`);
  document.title = `${frame.state} · swarmchase`;
}

// What the data are: a recording, fresh, or old. A chase that has ended, or has not been seen yet, is no trouble.
export function showConnection({ isLive, isConnected, isWaiting, silentS, isStale, frame }) {
  const connection = !isLive ? "replay" : !isConnected ? "none" : isStale ? "stale" : "live";
  const isOver = isStale && frame !== null && hasEnded(frame);
  document.body.dataset.connection = connection;
  document.body.dataset.stale = String(isStale && !isOver && !isWaiting);
  const words = { replay: "replay", none: isOver ? "ended" : isWaiting ? "waiting" : "no link", stale: age(silentS), live: "live" };
  setText($("connection"), words[connection]);
  $("banner").hidden = !isStale || isWaiting;
  $("banner").dataset.severity = isOver ? "info" : "critical";
  if (!isStale || isWaiting) return;
  const why = isConnected ? "the service sends nothing" : "not connected, trying again";
  const since = silentS === null ? "No data yet" : `No data for ${age(silentS)}`;
  const text = isOver ? "The chase has ended, and the service sends no more. This is how it ended." : `${since}: ${why}. What is shown is old.`;
  setText($("banner"), text);
}
