// The three axes in the corner of the picture, turned as the scene is.

import * as THREE from "./vendor/three.module.min.js";
import { label, polyline, setPoints } from "./shapes.js";
import { onThemeChange, themeColor } from "./theme.js";

const SIZE_PX = 100;
const AXES = [["E", [1, 0, 0], "orange"], ["N", [0, 1, 0], "green"], ["U", [0, 0, 1], "blue"]];

export class CompassRose {
  constructor() {
    this.scene = new THREE.Scene();
    this.camera = new THREE.OrthographicCamera(-1.5, 1.5, 1.5, -1.5, 0.1, 10);
    this.camera.up.set(0, 0, 1);
    this.addAxes();
    onThemeChange(() => {
      this.scene.clear();
      this.addAxes();
    });
  }

  addAxes() {
    for (const [name, direction, colorName] of AXES) {
      const color = themeColor(colorName);
      const line = polyline(color, 1);
      setPoints(line, [[0, 0, 0], direction]);
      const letter = label(name, color);
      letter.position.set(...direction).multiplyScalar(1.28);
      letter.center.set(0.5, 0.5);
      letter.scale.setScalar(0.62);
      this.scene.add(line, letter);
    }
  }

  render(renderer, camera, target) {
    this.camera.position.copy(camera.position).sub(target).setLength(5);
    this.camera.lookAt(0, 0, 0);
    const size = renderer.getSize(new THREE.Vector2());
    renderer.setViewport(size.x - SIZE_PX - 6, 4, SIZE_PX, SIZE_PX);
    renderer.clearDepth();
    renderer.render(this.scene, this.camera);
    renderer.setViewport(0, 0, size.x, size.y);
  }
}
