// Where the camera looks from: it keeps everything in the picture until a person takes hold of it.

import * as THREE from "./vendor/three.module.min.js";
import { easedShare } from "./format.js";

const FROM = new THREE.Vector3(-0.55, -1.25, 0.75).normalize(); // from south-south-west and above: north is away
const MARGIN = 1.12;
const LEAST_RADIUS_M = 8;
// Of a belief, the points next to the swarm: at the start it may fill the whole sky.
const BELIEF_SHARE = 0.8;
// Of the path, where the swarm has just been.
const RECENT_STEPS = 10;
const STILL = 0.002;

export class Framing {
  constructor(camera, controls) {
    this.camera = camera;
    this.controls = controls;
    this.isHeld = false; // by a person
    this.isCloseUp = false;
    this.isFirst = true;
    this.goal = new THREE.Sphere(new THREE.Vector3(), 60);
    this.now = this.goal.clone();
    this.direction = FROM.clone();
    this.stepMs = performance.now();
    this.apply();
  }

  release() {
    this.isHeld = true;
  }

  reset(isCloseUp) {
    this.isHeld = false;
    this.isCloseUp = isCloseUp;
    this.direction.copy(FROM);
  }

  // What must be in the picture.
  include(frame) {
    const box = this.isCloseUp ? boxOf(swarm(frame)) : everything(frame, RECENT_STEPS);
    if (box.isEmpty()) return;
    box.getBoundingSphere(this.goal);
    this.goal.radius = Math.max(this.goal.radius, LEAST_RADIUS_M);
    if (this.isFirst) this.now.copy(this.goal);
    this.isFirst = false;
  }

  // One step towards the goal; returns whether there is still some way to go.
  step() {
    const nowMs = performance.now();
    const easing = easedShare(nowMs - this.stepMs);
    this.stepMs = nowMs;
    if (this.isHeld) return false;
    this.now.center.lerp(this.goal.center, easing);
    this.now.radius += (this.goal.radius - this.now.radius) * easing;
    this.apply();
    const left = this.now.center.distanceTo(this.goal.center) + Math.abs(this.now.radius - this.goal.radius);
    return left > STILL * this.goal.radius;
  }

  middleM(frame) {
    const box = everything(frame);
    return box.isEmpty() ? [0, 0, 0] : box.getCenter(new THREE.Vector3()).toArray();
  }

  // The least of these steps with which so many lines reach beyond everything.
  gridStepM(frame, stepsM, lines) {
    const box = everything(frame);
    const extent = box.isEmpty() ? LEAST_RADIUS_M : box.getSize(new THREE.Vector3()).length();
    return stepsM.find((stepM) => stepM * lines >= 1.6 * extent) ?? stepsM.at(-1);
  }

  apply() {
    const halfHeight = THREE.MathUtils.degToRad(this.camera.fov / 2);
    const half = Math.min(halfHeight, Math.atan(Math.tan(halfHeight) * this.camera.aspect));
    const distance = (MARGIN * this.now.radius) / Math.sin(half);
    this.controls.target.copy(this.now.center);
    this.camera.position.copy(this.now.center).addScaledVector(this.direction, distance);
    this.camera.lookAt(this.now.center);
  }
}

function boxOf(points) {
  return new THREE.Box3().setFromPoints(points.filter(Boolean).map((point) => new THREE.Vector3(...point)));
}

function swarm(frame) {
  return [...frame.trackers.map((tracker) => tracker.position_m), frame.center_m];
}

function everything(frame, steps = Infinity) {
  const box = boxOf([...swarm(frame), frame.target_m, ...frame.path_m.slice(-Math.min(steps, frame.path_m.length))]);
  nearestPart(frame).forEach((point) => box.expandByPoint(point));
  return box;
}

function nearestPart(frame) {
  if (!frame.belief_m || !frame.center_m) return [];
  const center = new THREE.Vector3(...frame.center_m);
  const points = frame.belief_m.map((point) => new THREE.Vector3(...point));
  points.sort((one, other) => one.distanceToSquared(center) - other.distanceToSquared(center));
  return points.slice(0, Math.ceil(BELIEF_SHARE * points.length));
}
