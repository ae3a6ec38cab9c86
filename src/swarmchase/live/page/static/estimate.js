// Where the controller takes the target to be, in words.

import { bearing, number } from "./format.js";

export function estimateInWords(frame) {
  const estimate = frame.estimate;
  if (!estimate) {
    return frame.decision ? "this controller does not say where it thinks the target is" : "no decision yet";
  }
  const plusMinus = estimate.radius_m === null ? "(it does not say how sure it is)" : `± ${number(estimate.radius_m)} m`;
  const up = Math.round(estimate.elevation_deg);
  const height = up === 0 ? "level" : `${Math.abs(up)}° ${up > 0 ? "up" : "down"}`;
  return `${number(estimate.distance_m)} m ${plusMinus}, bearing ${bearing(estimate.bearing_deg)}, ${height}`;
}
