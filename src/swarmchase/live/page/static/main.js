// Puts the page together. What is drawn follows from one frame alone, be it of now, of the past, or of a recording.

import { STALE_S, hasEnded, metres, number, setText } from "./format.js";
import { showConnection, showInfo, showState } from "./header.js";
import { Alarms } from "./alarms.js";
import { channelInWords } from "./channel.js";
import { DecisionPanel } from "./decision.js";
import { estimateInWords } from "./estimate.js";
import { Events } from "./events.js";
import { Operator } from "./operator.js";
import { MapView } from "./map.js";
import { Preflight } from "./preflight.js";
import { PursuitPanel } from "./pursuit.js";
import { ResultCard, distanceToTruthM } from "./result.js";
import { ServiceSocket } from "./socket.js";
import { Timeline } from "./timeline.js";
import { Traces } from "./traces.js";
import { TrackerTable } from "./trackers.js";

// The token has become a cookie: it must not stay where it is seen, copied and remembered.
if (location.search) history.replaceState(null, "", location.pathname);

const AGES_MS = 200;
// A page that has just been opened waits so long for its first frame before that is worth a word.
const FIRST_FRAME_MS = 3000;
const openedMs = performance.now();
const $ = (id) => document.getElementById(id);

let info = null;
let newest = null; // frame
let newestMs = null; // when it was made, by this page's clock
let shown = null; // frame: the newest, or a past one
let isConnected = false;

const trackers = new TrackerTable($("trackers"));
const traces = new Traces($("traces"), $("traces-key"));
const decision = new DecisionPanel($("decision"), $("decision-number"), $("decision-note"));
const alarms = new Alarms($("alarms"), $("rejected"));
const events = new Events($("events"), $("spoken"), $("spoken-alarm"));
const map = new MapView($("map"));
const pursuit = new PursuitPanel($("pursuit-panel"));
const result = new ResultCard($("result"));
const scene = await openScene();

const socket = new ServiceSocket({
  connected(nowConnected) {
    isConnected = nowConnected;
    if (nowConnected) timeline.restart();
    drawClock();
  },
  info(message) {
    info = message;
    showInfo(info);
    [timeline, traces, decision, pursuit, map, scene].forEach((part) => part?.setInfo(info));
    $("decision-panel").hidden = info.is_in_flight;
    if (shown) draw();
  },
  frame(message) {
    takeNewest(message);
    timeline.setRange(message.first_s, message.last_s, newest.events);
    if (timeline.isFollowing) show(newest);
    if (info?.is_live) events.speak(newest);
    drawClock();
  },
  past(message) {
    if (!timeline.isFollowing) show(message.frame);
    timeline.answered();
    drawClock();
  },
});
const operator = new Operator($("operator"), (word) => socket.send({ word }));
const preflight = new Preflight($("preflight-panel"), (word) => socket.send({ word }));
const timeline = new Timeline($("timeline"), {
  seek: (seconds) => socket.send({ seek: seconds }),
  follow: () => {
    if (newest) show(newest);
    drawClock();
  },
});
$("reset-view").addEventListener("click", () => look(false));
$("close-up").addEventListener("click", () => look($("close-up").getAttribute("aria-pressed") !== "true"));
setInterval(() => {
  drawClock();
  if (shown && isFollowing()) drawAges();
}, AGES_MS);

async function openScene() {
  try {
    const { Scene } = await import("./scene.js");
    return new Scene($("scene"));
  } catch (error) {
    console.warn(`no picture: ${error.message}`);
    $("scene-missing").hidden = false;
    return null;
  }
}

// Both views find their place by themselves: to see everything, or the swarm alone.
function look(isCloseUp) {
  $("close-up").setAttribute("aria-pressed", String(isCloseUp));
  scene?.look(isCloseUp);
  map.look(isCloseUp);
}

function isFollowing() {
  return info?.is_live && timeline.isFollowing;
}

function takeNewest({ frame, age_s: ageS }) {
  // Another epoch is another chase: its times begin again, so a past moment of the old one means nothing in it.
  if (newest && frame.epoch !== newest.epoch && info.is_live) timeline.goLive();
  newest = frame;
  newestMs = performance.now() - 1000 * ageS;
}

function silentS() {
  return newestMs === null ? null : (performance.now() - newestMs) / 1000;
}

function isStale() {
  return (info === null || info.is_live) && !(isConnected && newestMs !== null && silentS() < STALE_S);
}

function show(frame) {
  shown = frame;
  draw();
}

function draw() {
  document.body.dataset.timeS = shown.time_s;
  document.body.dataset.epoch = shown.epoch;
  if (!info?.is_in_flight) decision.draw(shown);
  pursuit.draw(shown);
  map.draw(shown);
  alarms.draw(shown);
  events.draw(shown);
  result.draw(shown);
  preflight.draw(shown, info?.is_live ?? false);
  setText($("estimate"), estimateInWords(shown));
  $("channel-figure").hidden = !shown.channel;
  if (shown.channel) setText($("channel"), channelInWords(shown.channel));
  scene?.draw(shown);
  setText($("center"), `${metres(shown.center_m)} m`);
  setText($("spacing"), `${number(shown.spacing_m)} m`);
  drawDistance();
  drawAges();
}

function drawDistance() {
  const distanceM = distanceToTruthM(shown);
  $("distance-figure").hidden = distanceM === null;
  $("key-target").hidden = !shown.target_m;
  $("key-belief").hidden = !shown.belief_m;
  $("key-intercept").hidden = !shown.interception?.position_m;
  $("key-fence").hidden = !info?.fence_m;
  if (distanceM !== null) setText($("distance"), `${number(distanceM)} m`);
}

// What grows older between two frames.
function drawAges() {
  // After the end nothing more is to come: what is shown is how it ended.
  const grows = isFollowing() && !(isStale() && hasEnded(shown));
  const extraS = grows ? silentS() : 0;
  trackers.draw(shown, extraS);
  traces.draw(shown, extraS, grows && isStale());
}

function drawClock() {
  const isLive = info === null || info.is_live;
  const isWaiting = newestMs === null && performance.now() - openedMs < FIRST_FRAME_MS;
  showConnection({ isLive, isConnected, isWaiting, silentS: silentS(), isStale: isStale(), frame: newest });
  // All of one moment. The buttons act on the present, and say what it is while the past is looked at.
  if (shown) showState(shown);
  operator.draw(isLive ? newest : null, isConnected, !timeline.isFollowing);
}
