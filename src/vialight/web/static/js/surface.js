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
      this.renderer = new THREE.WebGLRenderer({ canvas, antialias: !isSoftware() });
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
      color: 0xd5def0, transparent: true, opacity: 0.22, depthWrite: false, side: THREE.DoubleSide }));
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
    const coarser = message.header.simplified ? "Shown coarser than it was measured." : "";
    this.tell(isEmpty ? "Nothing has gelled yet." : coarser);
    if (!isEmpty) {
      this.swap(this.solid, message);
      this.solid.geometry.computeBoundingBox();
      this.paint();
      if (!this.isPlaced) this.place();
    }
    this.clip();
  }

  tell(text) {
    $("surface-notice").textContent = text;
  }

  // Colour the vertices; the scale is the user's, or follows the 99 % quantile in steps of 1, 2, 5.
  paint() {
    const limit = Number($("limit").value) || roundUp(this.header?.limit_mm ?? 0.1);
    const sign = "\u2212";
    drawRamp(this.ramp, COLOURS, `${sign}${limit} mm, missing`, `+${limit} mm, too much`, "0");
    const ends = [`${sign}${limit} mm, blue, material is missing`, `+${limit} mm, red`];
    this.ramp.setAttribute("aria-label", `Deviation from ${ends.join(" to ")}`);
    if (!this.header || !this.solid?.geometry.attributes.position) return;
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
    box.getCenter(this.controls.target);
    const distance = 1.06 * this.distanceFor(box);
    this.camera.position.copy(this.controls.target).addScaledVector(START, distance);
    [this.camera.near, this.camera.far] = [distance / 100, distance * 10];
    this.camera.updateProjectionMatrix();
    this.controls.update();
    this.ask();
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
    const across = (event.clientX - area.left) / area.width;
    const down = (event.clientY - area.top) / area.height;
    const caster = new THREE.Raycaster();
    caster.setFromCamera(new THREE.Vector2(2 * across - 1, 1 - 2 * down), this.camera);
    const isCut = this.solid.material.clippingPlanes;
    const isSeen = ({ point }) => !isCut || this.plane.distanceToPoint(point) >= 0;
    const hit = caster.intersectObject(this.solid).find(isSeen);
    if (!hit) return;
    const value = this.deviation[hit.face.a] * this.header.deviation_unit_mm;
    const place = ["x", "y", "z"].map((axis) => number(hit.point[axis], 1)).join(", ");
    this.tell(`${signed(value)} mm at (${place}) mm`);
  }

  // Draw once, when the browser is about to show the next picture; but never before the graphics processor is done with
  // the last one and has rested as long, so that a slow one does not hold up the rest of the page.
  ask() {
    if (!this.renderer || this.isAsked) return;
    this.isAsked = true;
    this.wait(() => requestAnimationFrame(() => {
      this.isAsked = false;
      this.draw();
    }));
  }

  wait(then) {
    const context = this.renderer.getContext();
    if (this.fence) {
      const state = context.clientWaitSync(this.fence, 0, 0);
      if (state === context.TIMEOUT_EXPIRED && !context.isContextLost()) {
        setTimeout(() => this.wait(then), 15);
        return;
      }
      context.deleteSync(this.fence);
      this.fence = null;
      this.restUntil = 2 * performance.now() - this.drawnAt;
    }
    const restMs = Math.min((this.restUntil ?? 0) - performance.now(), 2000);
    if (restMs > 20) setTimeout(then, restMs);
    else then();
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
    this.drawnAt = performance.now();
    this.renderer.render(this.scene, this.camera);
    const context = this.renderer.getContext();
    this.fence = context.fenceSync(context.SYNC_GPU_COMMANDS_COMPLETE, 0);
    context.flush();
  }
}

// Whether there is no graphics processor: smooth edges are then too dear.
function isSoftware() {
  const context = document.createElement("canvas").getContext("webgl2");
  const about = context?.getExtension("WEBGL_debug_renderer_info");
  const name = about ? context.getParameter(about.UNMASKED_RENDERER_WEBGL) : "";
  context?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software/i.test(name);
}

// Vertex colours are linear light to three.js.
const LINEAR = Uint8Array.from({ length: 256 }, (_, level) => {
  const value = level / 255;
  return Math.round(255 * (value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4));
});
