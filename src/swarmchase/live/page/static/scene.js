// The swarm in space: x east, y north, z up, all in metres. Drawn only when something has changed.

import * as THREE from "./vendor/three.module.min.js";
import { OrbitControls } from "./vendor/OrbitControls.js";
import { TRACKER_SIDES, setText, staleness } from "./format.js";
import { Framing } from "./framing.js";
import { CompassRose } from "./compass_rose.js";
import { onThemeChange, themeColor, trackerColor } from "./theme.js";
import { ball, disc, dots, label, polyline, quadcopter, ring, segments, setPoints } from "./shapes.js";

const FIELD_OF_VIEW_DEG = 40;
// A tracker is as wide as this on the screen, or less where the swarm is far away; then it loses its name, too.
const WIDEST_TRACKER_PX = 26;
const NARROWEST_TRACKER_PX = 12;
const TRACKER_PER_SPACING = 0.75;
const LEAST_SPACING_WITH_NAMES_PX = 24;
const NAME_PX = 17;
const CENTER_PX = 11;
const TARGET_PX = 17;
const INTERCEPT_PX = 26;
// So far the arrow of a velocity reaches.
const ARROW_S = 4;
const GRID_LINES = 24;
const GRID_STEPS_M = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000];

// Where a picture takes longer, the rest of the page gets as much time as it takes.
const SLOW_MS = 50;
const LONGEST_REST_MS = 150;

export class Scene {
  // Throws where the browser has no WebGL.
  constructor(container) {
    this.container = container;
    this.renderer = new THREE.WebGLRenderer({ antialias: true, alpha: true });
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    this.renderer.autoClear = false;
    container.append(this.renderer.domElement);
    this.camera = new THREE.PerspectiveCamera(FIELD_OF_VIEW_DEG, 1, 0.1, 20000);
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, this.renderer.domElement);
    this.restsUntilMs = 0;
    this.framing = new Framing(this.camera, this.controls);
    this.rose = new CompassRose();
    this.scene = new THREE.Scene();
    this.addObjects();
    onThemeChange(() => this.repaint());
    this.controls.addEventListener("change", () => this.request());
    this.controls.addEventListener("start", () => this.framing.release());
    new ResizeObserver(() => this.resize()).observe(container);
  }

  // All anew, in other colours.
  repaint() {
    this.scene.clear();
    this.addObjects();
    this.gridKey = null;
    if (this.info) this.setInfo(this.info);
    if (this.frame) this.draw(this.frame);
  }

  setInfo(info) {
    this.info = info;
    const fence = info.fence_m;
    this.fence.visible = Boolean(fence);
    if (fence) setPoints(this.fence, boxEdges(fence.low, fence.high));
    if (fence) this.fence.computeLineDistances();
    this.successRadiusM = info.success_radius_m || 1;
    this.request();
  }

  // Let the camera find its place by itself: to see everything, or the swarm alone.
  look(isCloseUp) {
    this.framing.reset(isCloseUp);
    if (this.frame) this.framing.include(this.frame);
    this.request();
  }

  draw(frame) {
    this.frame = frame;
    frame.trackers.forEach((tracker, index) => this.drawTracker(index, tracker, frame.center_m));
    place(this.center, frame.center_m);
    setPoints(this.path, frame.path_m);
    setPoints(this.steps, frame.path_m);
    setPoints(this.belief, frame.belief_m ?? []);
    this.drawEstimate(frame);
    this.drawTarget(frame.target_m);
    this.drawGround(frame);
    this.framing.include(frame);
    this.request();
  }

  addLights() {
    this.scene.add(new THREE.HemisphereLight("#ffffff", "#56677a", 2.6));
    const sun = new THREE.DirectionalLight("#ffffff", 1.4);
    sun.position.set(-2, -3, 6);
    this.scene.add(sun);
  }

  addObjects() {
    this.addLights();
    const [bright, faint] = [themeColor("bright"), themeColor("faint")];
    this.grid = segments(themeColor("grid"), 0.75);
    this.plumbs = segments(themeColor("plumb"), 0.45);
    this.fence = segments(faint, 0.6, true);
    this.path = polyline(bright, 0.8);
    this.steps = dots(bright, 5, 0.9);
    this.belief = dots(themeColor("belief"), 5, 0.5);
    this.track = polyline(themeColor("belief"), 0.9);
    this.region = ball(themeColor("belief"));
    this.velocity = new THREE.ArrowHelper(new THREE.Vector3(1, 0, 0), new THREE.Vector3(), 1, themeColor("belief"));
    this.intercept = label("×", themeColor("orange"));
    this.intercept.center.set(0.5, 0.5);
    this.course = segments(themeColor("orange"), 0.7, true);
    this.center = disc(bright);
    this.trackers = TRACKER_SIDES.map((_, index) => this.addTracker(trackerColor(index), index));
    this.target = new THREE.Mesh(
      new THREE.OctahedronGeometry(0.5),
      new THREE.MeshStandardMaterial({ color: themeColor("target"), emissive: "#7a1515", flatShading: true, transparent: true }),
    );
    this.success = new THREE.Mesh(
      new THREE.SphereGeometry(1, 14, 8),
      new THREE.MeshBasicMaterial({ color: themeColor("target"), wireframe: true, transparent: true, opacity: 0.25 }),
    );
    this.scene.add(this.grid, this.plumbs, this.fence, this.path, this.steps, this.belief, this.center);
    this.scene.add(this.track, this.region, this.velocity, this.intercept, this.course);
    this.scene.add(this.target, this.success);
    // After the belief's points, which would hide them: these write no depth.
    for (const object of [this.target, ...this.trackers.map((one) => one.body)]) {
      object.traverse((part) => (part.renderOrder = 1));
    }
    this.fence.visible = false;
  }

  addTracker(color, index) {
    const tracker = {
      color,
      body: quadcopter(color),
      setPoint: ring(color),
      arm: segments(color, 0.75),
      lead: segments(color, 0.4),
      names: { fresh: label(String(index), color), stale: label(String(index), themeColor("faint")) },
    };
    this.scene.add(tracker.body, tracker.setPoint, tracker.arm, tracker.lead);
    this.scene.add(tracker.names.fresh, tracker.names.stale);
    return tracker;
  }

  drawTracker(index, tracker, centerM) {
    const parts = this.trackers[index];
    const position = tracker.position_m;
    const isStale = staleness(tracker, 0) !== "";
    const color = isStale ? themeColor("faint") : parts.color;
    for (const part of [parts.body, parts.setPoint, parts.arm, parts.lead]) {
      part.traverse((one) => one.material?.color.set(color));
    }
    place(parts.body, position);
    place(parts.setPoint, tracker.set_point_m);
    place(parts.names.fresh, isStale ? null : position);
    place(parts.names.stale, isStale ? position : null);
    setPoints(parts.arm, position && centerM ? [centerM, position] : []);
    setPoints(parts.lead, position && tracker.set_point_m ? [position, tracker.set_point_m] : []);
  }

  drawEstimate({ estimate, track, interception, center_m: centerM }) {
    const region = estimate?.region ?? null;
    this.region.visible = region !== null;
    if (region) this.region.matrix.makeBasis(...region.half_axes_m.map((axis) => new THREE.Vector3(...axis))).setPosition(...region.center_m);
    setPoints(this.track, track.target_m.filter(Boolean));
    this.velocity.visible = Boolean(estimate?.velocity_mps);
    if (this.velocity.visible) turnArrow(this.velocity, estimate.position_m, estimate.velocity_mps);
    const metM = interception?.position_m;
    place(this.intercept, metM);
    setPoints(this.course, metM && centerM ? [centerM, metM] : []);
    if (metM) this.course.computeLineDistances();
  }

  drawTarget(targetM) {
    place(this.target, targetM);
    place(this.success, targetM);
    this.success.scale.setScalar(this.successRadiusM ?? 1);
  }

  // The plane of height 0 under everything, and what is above which place of it.
  drawGround(frame) {
    const step = this.framing.gridStepM(frame, GRID_STEPS_M, GRID_LINES);
    const middle = this.framing.middleM(frame).map((coordinate) => Math.round(coordinate / step) * step);
    const key = JSON.stringify([step, middle]);
    if (key !== this.gridKey) {
      this.gridKey = key;
      setPoints(this.grid, gridLines(middle, step));
      setText(document.getElementById("grid-step"), `${step} m`);
    }
    const high = [frame.center_m, frame.target_m].filter(Boolean);
    setPoints(this.plumbs, high.flatMap((point) => [point, [point[0], point[1], 0]]));
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.container;
    if (width === 0 || height === 0) return;
    this.renderer.setSize(width, height);
    this.restsUntilMs = 0; // that has emptied the picture
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.request();
  }

  request() {
    this.pending ??= requestAnimationFrame(() => {
      this.pending = null;
      const beganMs = performance.now();
      if (beganMs < this.restsUntilMs) {
        this.request();
        return;
      }
      this.render();
      // Without a graphics chip a picture takes long, and the next moment comes only when it is done.
      requestAnimationFrame(() => {
        const nowMs = performance.now();
        if (nowMs - beganMs > SLOW_MS) this.restsUntilMs = nowMs + Math.min(nowMs - beganMs, LONGEST_REST_MS);
      });
    });
  }

  render() {
    if (this.framing.step()) this.request();
    this.keepSizes();
    this.renderer.clear();
    this.renderer.render(this.scene, this.camera);
    this.rose.render(this.renderer, this.camera, this.controls.target);
  }

  // Markers are as large on the screen from near as from afar.
  keepSizes() {
    const height = this.container.clientHeight || 1;
    const perPixel = (2 * Math.tan(THREE.MathUtils.degToRad(FIELD_OF_VIEW_DEG / 2))) / height;
    const pixelM = (object) => perPixel * this.camera.position.distanceTo(object.position);
    const spacingPx = this.center.visible ? (this.frame?.spacing_m ?? 0) / pixelM(this.center) : Infinity;
    const widest = Math.min(WIDEST_TRACKER_PX, TRACKER_PER_SPACING * spacingPx);
    const trackerPx = Math.max(NARROWEST_TRACKER_PX, widest);
    this.center.scale.setScalar(CENTER_PX * pixelM(this.center) * (trackerPx / WIDEST_TRACKER_PX));
    this.target.scale.setScalar(TARGET_PX * pixelM(this.target));
    this.intercept.scale.setScalar(INTERCEPT_PX * pixelM(this.intercept));
    const namePx = spacingPx < LEAST_SPACING_WITH_NAMES_PX ? 0 : NAME_PX;
    for (const { body, setPoint, names } of this.trackers) {
      body.scale.setScalar(trackerPx * pixelM(body));
      setPoint.scale.setScalar(0.8 * trackerPx * pixelM(setPoint));
      setPoint.quaternion.copy(this.camera.quaternion);
      for (const name of [names.fresh, names.stale]) name.scale.setScalar(namePx * pixelM(name));
    }
  }
}

function place(object, point) {
  object.visible = Boolean(point);
  if (point) object.position.set(...point);
}

function turnArrow(arrow, fromM, velocityMps) {
  const way = new THREE.Vector3(...velocityMps).multiplyScalar(ARROW_S);
  const length = Math.max(way.length(), 0.01);
  arrow.position.set(...fromM);
  arrow.setDirection(way.clone().divideScalar(length));
  arrow.setLength(length, 0.25 * length, 0.15 * length);
}

function boxEdges([west, south, low], [east, north, high]) {
  const corners = [[west, south], [east, south], [east, north], [west, north]];
  return corners.flatMap((corner, index) => {
    const next = corners[(index + 1) % 4];
    return [[...corner, low], [...next, low], [...corner, high], [...next, high], [...corner, low], [...corner, high]];
  });
}

function gridLines([east, north], step) {
  const reach = (GRID_LINES / 2) * step;
  return Array.from({ length: GRID_LINES + 1 }, (_, index) => index * step - reach).flatMap((offset) => [
    [east - reach, north + offset, 0],
    [east + reach, north + offset, 0],
    [east + offset, north - reach, 0],
    [east + offset, north + reach, 0],
  ]);
}
