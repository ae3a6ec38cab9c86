// What the controller has found out about the radio, in words.

import { number, TRACKER_SIDES } from "./format.js";

// Receivers' offsets below this are not worth a word.
const SMALL_DB = 0.5;

export function channelInWords(channel) {
  const parts = [`power ${signed(channel.power_db)} dB`, `exponent ${number(channel.exponent)}`];
  if (channel.fading_db !== null) parts.push(`fading ${number(channel.fading_db)} dB`);
  if (channel.shadowing_db > 0) parts.push(`shadowing ${number(channel.shadowing_db)} dB`);
  channel.left_out.forEach((why, tracker) => {
    if (why) parts.push(`${TRACKER_SIDES[tracker]} ${why}`);
  });
  const off = channel.offset_db.map((offsetDb, tracker) => [offsetDb, tracker]);
  const worth = off.filter(([offsetDb, tracker]) => Math.abs(offsetDb) >= SMALL_DB && !channel.left_out[tracker]);
  if (worth.length) {
    parts.push(`off by ${worth.map(([offsetDb, tracker]) => `${TRACKER_SIDES[tracker]} ${signed(offsetDb)}`).join(", ")} dB`);
  }
  return parts.join(" · ");
}

function signed(value) {
  return (value > 0 ? "+" : "") + number(value);
}
