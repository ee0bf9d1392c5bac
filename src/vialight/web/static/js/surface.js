// The measured surface in 3-D, coloured by its deviation, the reference as a ghost around it, and a plane that cuts.

import * as THREE from "../vendor/three.module.min.js";
import { OrbitControls } from "../vendor/OrbitControls.js";
import { deviation as COLOURS, drawRamp, roundUp } from "./colours.js";
import { $, number, signed } from "./text.js";

const AXES = { x: new THREE.Vector3(-1, 0, 0), y: new THREE.Vector3(0, -1, 0), z: new THREE.Vector3(0, 0, -1) };
const START = new THREE.Vector3(1, -1.5, 1).normalize();

export class SurfaceView {
  constructor(canvas, ramp) {
    Object.assign(this, { canvas, ramp, limitMm: null, isPlaced: false, cut: 0.5 });
    try {
      this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
    } catch {
      $("surface-notice").textContent = "This browser has no WebGL: the surface cannot be shown.";
      return;
    }
    this.renderer.localClippingEnabled = true;
    this.renderer.setClearColor(0x0b0e13);
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(35, 4 / 3, 0.1, 1000);
    this.camera.up.set(0, 0, 1);
    this.camera.position.copy(START).multiplyScalar(50);
    const light = new THREE.DirectionalLight(0xffffff, 1.6);
    light.position.set(-0.3, 0.6, 1);
    this.camera.add(light);
    this.scene.add(this.camera, new THREE.HemisphereLight(0xffffff, 0x667088, 1.7));
    this.plane = new THREE.Plane(AXES.z.clone(), 0);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.addEventListener("change", () => this.ask());
    this.solid = this.mesh(new THREE.MeshLambertMaterial({ vertexColors: true, side: THREE.DoubleSide }));
    this.ghost = this.mesh(new THREE.MeshLambertMaterial({
      color: 0xb9c6dc, transparent: true, opacity: 0.16, depthWrite: false, side: THREE.DoubleSide }));
    this.ghost.renderOrder = 1;
    new ResizeObserver(() => this.ask()).observe(canvas);
    this.listen();
  }

  mesh(material) {
    const made = new THREE.Mesh(new THREE.BufferGeometry(), material);
    made.visible = false;
    made.frustumCulled = false;
    this.scene.add(made);
    return made;
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
    if (!this.renderer) return;
    this.isPlaced = false;
    this.header = null;
    this.solid.visible = this.ghost.visible = false;
    this.hasGhost = false;
    $("surface-numbers").textContent = "";
    $("surface-notice").textContent = "No surface yet.";
    this.ask();
  }

  geometry({ header, arrays }) {
    const { values } = arrays.vertices;
    const points = new Float32Array(values.length);
    const [low, extent] = [header.low_mm, header.extent_mm.map((size) => size / 65535)];
    for (let index = 0; index < points.length; index += 3) {
      points[index] = low[0] + values[index] * extent[0];
      points[index + 1] = low[1] + values[index + 1] * extent[1];
      points[index + 2] = low[2] + values[index + 2] * extent[2];
    }
    const made = new THREE.BufferGeometry();
    made.setAttribute("position", new THREE.BufferAttribute(points, 3));
    made.setAttribute("normal", new THREE.BufferAttribute(arrays.normals.values, 3, true));
    made.setIndex(new THREE.BufferAttribute(arrays.faces.values, 1));
    return made;
  }

  swap(mesh, message) {
    mesh.geometry.dispose();
    mesh.geometry = this.geometry(message);
  }

  showReference(message) {
    if (!this.renderer) return;
    this.swap(this.ghost, message);
    this.ghost.geometry.computeBoundingBox();
    this.hasGhost = true;
    this.showGhost();
    if (!this.isPlaced) this.place();
  }

  showGhost() {
    this.ghost.visible = Boolean(this.hasGhost) && $("ghost").checked;
    this.ask();
  }

  show(message) {
    if (!this.renderer) return;
    this.header = message.header;
    this.deviation = message.arrays.deviation?.values ?? null;
    const isEmpty = !message.arrays.faces.values.length;
    this.solid.visible = !isEmpty;
    $("surface-notice").textContent = isEmpty ? "Nothing has gelled yet."
      : message.header.simplified ? "Shown coarser than it was measured." : "";
    if (!isEmpty) {
      this.swap(this.solid, message);
      this.solid.geometry.computeBoundingBox();
      this.paint();
      if (!this.isPlaced) this.place();
    }
    this.clip();
  }

  // Colour the vertices; the scale is the user's, or follows the 99 % quantile in steps of 1, 2, 5.
  paint() {
    const limit = Number($("limit").value) || roundUp(this.header?.limit_mm ?? 0.1);
    const sign = "\u2212";
    drawRamp(this.ramp, COLOURS, `${sign}${limit} mm, missing`, `+${limit} mm, too much`, "0");
    this.ramp.setAttribute("aria-label", `Deviation from ${sign}${limit} mm, blue, material is missing, to +${limit} mm, red`);
    if (!this.header || !this.solid.geometry.attributes.position) return;
    const count = this.solid.geometry.attributes.position.count;
    const colours = new Uint8Array(3 * count).fill(190);
    if (this.deviation) {
      const scale = this.header.deviation_unit_mm / limit * 127.5;
      for (let index = 0; index < count; index += 1) {
        const level = 3 * Math.round(Math.min(255, Math.max(0, 127.5 + this.deviation[index] * scale)));
        colours[3 * index] = LINEAR[COLOURS[level]];
        colours[3 * index + 1] = LINEAR[COLOURS[level + 1]];
        colours[3 * index + 2] = LINEAR[COLOURS[level + 2]];
      }
    }
    this.solid.geometry.setAttribute("color", new THREE.BufferAttribute(colours, 3, true));
    this.ask();
  }

  bounds() {
    const box = new THREE.Box3();
    for (const mesh of [this.ghost, this.solid]) if (mesh.geometry.boundingBox) box.union(mesh.geometry.boundingBox);
    return box;
  }

  place() {
    const box = this.bounds();
    if (box.isEmpty()) return;
    this.isPlaced = true;
    const radius = box.getSize(new THREE.Vector3()).length() / 2;
    const distance = 1.12 * radius / Math.sin(THREE.MathUtils.degToRad(this.camera.fov / 2));
    box.getCenter(this.controls.target);
    this.camera.position.copy(this.controls.target).addScaledVector(START, distance);
    [this.camera.near, this.camera.far] = [distance / 100, distance * 10];
    this.camera.updateProjectionMatrix();
    this.controls.update();
    this.ask();
  }

  clip() {
    if (!this.renderer) return;
    const axis = $("clip-axis").value;
    $("clip-at").disabled = !axis;
    for (const mesh of [this.solid, this.ghost]) mesh.material.clippingPlanes = axis ? [this.plane] : null;
    const box = this.bounds();
    if (axis && !box.isEmpty()) {
      const share = Number($("clip-at").value) / 1000;
      const at = box.min[axis] + share * (box.max[axis] - box.min[axis]);
      this.plane.normal.copy(AXES[axis]);
      this.plane.constant = at;
      $("clip-value").textContent = `${axis} = ${number(at)} mm`;
    } else $("clip-value").textContent = "";
    this.ask();
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
    this.ask();
  }

  // Tell the deviation where the user clicked.
  read(event) {
    if (!this.solid.visible || !this.deviation) return;
    const area = this.canvas.getBoundingClientRect();
    const at = new THREE.Vector2((event.clientX - area.left) / area.width * 2 - 1, 1 - (event.clientY - area.top) / area.height * 2);
    const caster = new THREE.Raycaster();
    caster.setFromCamera(at, this.camera);
    const isCut = this.solid.material.clippingPlanes;
    const hit = caster.intersectObject(this.solid).find(({ point }) => !isCut || this.plane.distanceToPoint(point) >= 0);
    if (!hit) return;
    const value = this.deviation[hit.face.a] * this.header.deviation_unit_mm;
    const place = ["x", "y", "z"].map((axis) => number(hit.point[axis], 1)).join(", ");
    $("surface-notice").textContent = `${signed(value)} mm at (${place}) mm`;
  }

  // Draw once, when the browser is about to show the next picture.
  ask() {
    if (!this.renderer || this.isAsked) return;
    this.isAsked = true;
    requestAnimationFrame(() => {
      this.isAsked = false;
      this.draw();
    });
  }

  draw() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    if (this.canvas.width !== Math.round(width * ratio) || this.canvas.height !== Math.round(height * ratio)) {
      this.renderer.setPixelRatio(ratio);
      this.renderer.setSize(width, height, false);
      this.camera.aspect = width / height;
      this.camera.updateProjectionMatrix();
    }
    this.renderer.render(this.scene, this.camera);
  }
}

// Vertex colours are linear light to three.js.
const LINEAR = Uint8Array.from({ length: 256 }, (_, level) => {
  const value = level / 255;
  return Math.round(255 * (value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4));
});
