// What the scene is made of.

import * as THREE from "./vendor/three.module.min.js";
import { themeColor } from "./theme.js";

const LABEL_PX = 64;
const CIRCLE_POINTS = 48;

// Lines between pairs of points.
export function segments(color, opacity, isDashed = false) {
  return withoutCulling(new THREE.LineSegments(new THREE.BufferGeometry(), lineMaterial(color, opacity, isDashed)));
}

export function polyline(color, opacity) {
  return withoutCulling(new THREE.Line(new THREE.BufferGeometry(), lineMaterial(color, opacity)));
}

// Round points, so many pixels wide.
export function dots(color, sizePx, opacity) {
  const size = sizePx * Math.min(window.devicePixelRatio, 2);
  const material = new THREE.PointsMaterial({
    color, size, sizeAttenuation: false, transparent: true, opacity, depthWrite: false, map: discTexture(),
  });
  return withoutCulling(new THREE.Points(new THREE.BufferGeometry(), material));
}

export function setPoints(object, points) {
  const geometry = object.geometry;
  const position = geometry.getAttribute("position");
  if (position?.count === points.length && points.length > 0) {
    points.forEach((point, index) => position.setXYZ(index, ...point));
    position.needsUpdate = true;
    return;
  }
  geometry.dispose();
  object.geometry = new THREE.BufferGeometry();
  object.geometry.setAttribute("position", new THREE.Float32BufferAttribute(points.flat(), 3));
}

export function disc(color) {
  return new THREE.Sprite(new THREE.SpriteMaterial({ color, map: discTexture(), depthTest: false }));
}

// A ball of radius 1 that one sees through, with a circle about each axis; its matrix is set by the scene.
export function ball(color) {
  const skin = new THREE.MeshBasicMaterial({ color, transparent: true, opacity: 0.09, depthWrite: false });
  const group = new THREE.Group();
  group.add(withoutCulling(new THREE.Mesh(new THREE.SphereGeometry(1, 32, 20), skin)));
  const turn = (index) => [Math.cos, Math.sin].map((of) => of((2 * Math.PI * index) / CIRCLE_POINTS));
  for (const axis of [0, 1, 2]) {
    const circle = polyline(color, 0.5);
    setPoints(circle, Array.from({ length: CIRCLE_POINTS + 1 }, (_, index) => turn(index).toSpliced(axis, 0, 0)));
    group.add(circle);
  }
  group.matrixAutoUpdate = false;
  return group;
}

// Turned to the camera by the scene.
export function ring(color) {
  const material = new THREE.MeshBasicMaterial({ color, transparent: true, opacity: 0.75, side: THREE.DoubleSide });
  return new THREE.Mesh(new THREE.RingGeometry(0.42, 0.5, 28), material);
}

// One metre wide: two arms, four rotors, a body.
export function quadcopter(color) {
  const material = new THREE.MeshStandardMaterial({ color, roughness: 0.6, transparent: true });
  const group = new THREE.Group();
  group.add(new THREE.Mesh(new THREE.SphereGeometry(0.17, 16, 12), material));
  for (const angle of [Math.PI / 4, -Math.PI / 4]) {
    const arm = new THREE.Mesh(new THREE.BoxGeometry(0.78, 0.07, 0.07), material);
    arm.rotation.z = angle;
    group.add(arm);
  }
  for (const [x, y] of [[1, 1], [1, -1], [-1, 1], [-1, -1]]) {
    const rotor = new THREE.Mesh(new THREE.TorusGeometry(0.2, 0.045, 8, 20), material);
    rotor.position.set(0.28 * x, 0.28 * y, 0.05);
    group.add(rotor);
  }
  return group;
}

// Text that faces the camera, a little above what it names.
export function label(text, color) {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = LABEL_PX;
  const context = canvas.getContext("2d");
  context.font = `700 ${0.72 * LABEL_PX}px system-ui, sans-serif`;
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.lineWidth = 10;
  context.lineJoin = "round";
  context.strokeStyle = themeColor("ground");
  context.strokeText(text, LABEL_PX / 2, LABEL_PX / 2);
  context.fillStyle = color;
  context.fillText(text, LABEL_PX / 2, LABEL_PX / 2);
  const sprite = new THREE.Sprite(new THREE.SpriteMaterial({ map: texture(canvas), depthTest: false }));
  sprite.center.set(0.5, -0.45);
  sprite.renderOrder = 2;
  return sprite;
}

let sharedDisc = null;

function discTexture() {
  if (sharedDisc) return sharedDisc;
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = LABEL_PX;
  const context = canvas.getContext("2d");
  context.fillStyle = "#ffffff";
  context.arc(LABEL_PX / 2, LABEL_PX / 2, LABEL_PX / 2 - 2, 0, 2 * Math.PI);
  context.fill();
  sharedDisc = texture(canvas);
  return sharedDisc;
}

function texture(canvas) {
  const made = new THREE.CanvasTexture(canvas);
  made.colorSpace = THREE.SRGBColorSpace;
  return made;
}

function lineMaterial(color, opacity, isDashed = false) {
  const look = { color, transparent: true, opacity, depthWrite: false };
  return isDashed ? new THREE.LineDashedMaterial({ ...look, dashSize: 4, gapSize: 3 }) : new THREE.LineBasicMaterial(look);
}

// The bounds of what moves are not kept, so nothing may be left out by them.
function withoutCulling(object) {
  object.frustumCulled = false;
  return object;
}
