// The measured surface in 3-D, coloured by its deviation, the reference as a ghost around it, and a plane that cuts.
//
// Here is what the user does and reads; scene.js draws it.

import * as THREE from "../vendor/three.module.min.js";
import { OrbitControls } from "../vendor/OrbitControls.js";
import { deviation as COLOURS, drawRamp, roundUp } from "./colours.js";
import { $, number, signed } from "./text.js";

const AXES = { x: [-1, 0, 0], y: [0, -1, 0], z: [0, 0, -1] };
const START = new THREE.Vector3(1, -1.5, 1).normalize();

export class SurfaceView {
  constructor(canvas, ramp) {
    Object.assign(this, { canvas, ramp, isPlaced: false, canDraw: true });
    [this.solidBox, this.ghostBox] = [new THREE.Box3(), new THREE.Box3()];
    this.camera = new THREE.PerspectiveCamera(35, 4 / 3, 0.1, 1000);
    this.camera.up.set(0, 0, 1);
    this.camera.position.copy(START).multiplyScalar(50);
    this.begin();
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.addEventListener("change", () => this.look());
    new ResizeObserver(() => this.look()).observe(canvas);
    this.listen();
  }

  begin() {
    if (!this.canvas.transferControlToOffscreen) {
      this.failed();
      return;
    }
    this.artist = new Worker(new URL("scene.js", import.meta.url), { type: "module" });
    this.artist.onmessage = ({ data }) => this[data.hear](data);
    const canvas = this.canvas.transferControlToOffscreen();
    this.artist.postMessage({ do: "begin", canvas }, [canvas]);
  }

  failed() {
    this.tell("This browser has no WebGL for it: the surface cannot be shown.");
    this.canDraw = false;
  }

  // A message of the server is handed over, not copied: who calls needs its arrays no more.
  draw(what, given = {}) {
    const arrays = Object.values(given.message?.arrays ?? {});
    const memory = new Set(arrays.map((array) => array.values.buffer));
    if (this.canDraw) this.artist.postMessage({ do: what, ...given }, [...memory]);
  }

  listen() {
    $("ghost").addEventListener("change", () => this.showGhost());
    $("limit").addEventListener("change", () => this.paint());
    $("clip-axis").addEventListener("change", () => this.clip());
    $("clip-at").addEventListener("input", () => this.clip());
    $("surface-reset").addEventListener("click", () => this.place());
    this.canvas.addEventListener("keydown", (event) => this.press(event));
    let down = null;
    this.canvas.addEventListener("pointerdown", (event) => { down = [event.clientX, event.clientY]; });
    this.canvas.addEventListener("pointerup", (event) => {
      if (down && Math.hypot(event.clientX - down[0], event.clientY - down[1]) < 5) this.read(event);
    });
  }

  reset() {
    this.isPlaced = false;
    this.header = null;
    this.hasGhost = false;
    this.solidBox.makeEmpty();
    this.ghostBox.makeEmpty();
    $("surface-numbers").textContent = "";
    this.tell("No surface yet.");
    this.draw("reset");
  }

  showReference(message) {
    this.ghostBox = boxOf(message.header);
    this.hasGhost = true;
    this.draw("showReference", { message });
    this.showGhost();
    if (!this.isPlaced) this.place();
  }

  showGhost() {
    this.draw("showGhost", { isWanted: Boolean(this.hasGhost) && $("ghost").checked });
  }

  show(message) {
    this.header = message.header;
    const isEmpty = !message.arrays.faces.values.length;
    const coarser = message.header.simplified ? "Shown coarser than it was measured." : "";
    this.tell(isEmpty ? "Nothing has gelled yet." : coarser);
    this.draw("show", { message, limitMm: this.limitMm() });
    this.solidBox = isEmpty ? new THREE.Box3() : boxOf(message.header);
    if (!isEmpty) {
      this.drawScale();
      if (!this.isPlaced) this.place();
    }
    this.clip();
  }

  tell(text) {
    if (this.canDraw) $("surface-notice").textContent = text;
  }

  // What the colours end at: the user's choice, or the 99 % quantile in steps of 1, 2, 5.
  limitMm() {
    return Number($("limit").value) || roundUp(this.header?.limit_mm ?? 0.1);
  }

  paint() {
    this.drawScale();
    this.draw("paint", { limitMm: this.limitMm() });
  }

  drawScale() {
    const limit = this.limitMm();
    const sign = "\u2212";
    drawRamp(this.ramp, COLOURS, `${sign}${limit} mm, missing`, `+${limit} mm, too much`, "0");
    const ends = [`${sign}${limit} mm, blue, material is missing`, `+${limit} mm, red`];
    this.ramp.setAttribute("aria-label", `Deviation from ${ends.join(" to ")}`);
  }

  bounds() {
    return this.ghostBox.clone().union(this.solidBox);
  }

  place() {
    const box = this.bounds();
    if (box.isEmpty()) return;
    this.isPlaced = true;
    box.getCenter(this.controls.target);
    const distance = 1.06 * this.distanceFor(box);
    this.camera.position.copy(this.controls.target).addScaledVector(START, distance);
    [this.camera.near, this.camera.far] = [distance / 100, distance * 10];
    this.camera.updateProjectionMatrix();
    this.controls.update();
    this.look();
  }

  // How far the camera must be to have all corners of a box in its picture.
  distanceFor(box) {
    const turn = new THREE.Matrix4().lookAt(START, new THREE.Vector3(), this.camera.up).invert();
    const rise = Math.tan(THREE.MathUtils.degToRad(this.camera.fov / 2));
    const centre = box.getCenter(new THREE.Vector3());
    let farthest = 0;
    for (let corner = 0; corner < 8; corner += 1) {
      const at = new THREE.Vector3(...["x", "y", "z"].map((axis, bit) => box[corner >> bit & 1 ? "max" : "min"][axis]));
      at.sub(centre).applyMatrix4(turn);
      farthest = Math.max(farthest, at.z + Math.max(Math.abs(at.x) / this.camera.aspect, Math.abs(at.y)) / rise);
    }
    return farthest;
  }

  clip() {
    const axis = $("clip-axis").value;
    const box = this.bounds();
    $("clip-at").disabled = !axis;
    if (!axis || box.isEmpty()) {
      $("clip-value").textContent = "";
      this.draw("clip", { normal: null });
      return;
    }
    const share = Number($("clip-at").value) / 1000;
    const at = box.min[axis] + share * (box.max[axis] - box.min[axis]);
    $("clip-value").textContent = `${axis} = ${number(at)} mm`;
    this.draw("clip", { normal: AXES[axis], constant: at });
  }

  press(event) {
    const turns = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    const zoom = { "+": 0.87, "=": 0.87, "-": 1.15 }[event.key];
    if (!turns && !zoom) return;
    event.preventDefault();
    const offset = this.camera.position.clone().sub(this.controls.target);
    const up = new THREE.Quaternion().setFromUnitVectors(this.camera.up, new THREE.Vector3(0, 1, 0));
    const place = new THREE.Spherical().setFromVector3(offset.applyQuaternion(up));
    if (turns) {
      place.theta += turns[0] * 0.15;
      place.phi += turns[1] * 0.15;
      place.makeSafe();
    }
    place.radius *= zoom ?? 1;
    offset.setFromSpherical(place).applyQuaternion(up.invert());
    this.camera.position.copy(this.controls.target).add(offset);
    this.controls.update();
    this.look();
  }

  // Ask for the deviation where the user clicked.
  read(event) {
    const area = this.canvas.getBoundingClientRect();
    const [across, down] = [(event.clientX - area.left) / area.width, (event.clientY - area.top) / area.height];
    this.draw("read", { right: 2 * across - 1, up: 1 - 2 * down });
  }

  found({ deviationMm, pointMm }) {
    this.tell(`${signed(deviationMm)} mm at (${pointMm.map((value) => number(value, 1)).join(", ")}) mm`);
  }

  // Show what the camera sees now, once before the browser's next picture.
  look() {
    if (this.isLooking) return;
    this.isLooking = true;
    requestAnimationFrame(() => {
      this.isLooking = false;
      const { clientWidth: width, clientHeight: height } = this.canvas;
      if (!width || !height) return;
      this.camera.aspect = width / height;
      const { position, quaternion, fov, aspect, near, far } = this.camera;
      this.draw("look", {
        position: position.toArray(), quaternion: quaternion.toArray(), fov, aspect, near, far,
        size: { width, height, ratio: Math.min(window.devicePixelRatio || 1, 2) } });
    });
  }
}

// What a surface's header says of its extent.
function boxOf({ low_mm: low, extent_mm: extent }) {
  const corner = new THREE.Vector3(...low);
  return new THREE.Box3(corner, corner.clone().add(new THREE.Vector3(...extent)));
}
