// What draws the surface, in a thread of its own: a slow graphics processor, or none, holds up nothing else on the page.
//
// Told by surface.js what to draw, each message being `{ do: NAME, ... }` of `Scene`'s methods; answers with what was
// found where the user clicked, or that it cannot draw.

import * as THREE from "../vendor/three.module.min.js";
import { deviation as COLOURS } from "./colours.js";

class Scene {
  constructor(canvas) {
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: !isSoftware() });
    this.renderer.localClippingEnabled = true;
    this.renderer.setClearColor(0x0b0e13);
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera();
    const light = new THREE.DirectionalLight(0xffffff, 1.6);
    light.position.set(-0.3, 0.6, 1);
    this.camera.add(light);
    this.scene.add(this.camera, new THREE.HemisphereLight(0xffffff, 0x667088, 1.7));
    this.solid = this.mesh(new THREE.MeshLambertMaterial({ vertexColors: true, side: THREE.DoubleSide }));
    this.ghost = this.mesh(new THREE.MeshLambertMaterial({
      color: 0xd5def0, transparent: true, opacity: 0.22, depthWrite: false, side: THREE.DoubleSide }));
    this.ghost.renderOrder = 1;
    this.size = { width: 0, height: 0, ratio: 1 };
  }

  mesh(material) {
    const made = new THREE.Mesh(new THREE.BufferGeometry(), material);
    made.visible = false;
    made.frustumCulled = false;
    this.scene.add(made);
    return made;
  }

  // Where the eye is, and how large the picture.
  look({ position, quaternion, fov, aspect, near, far, size }) {
    this.camera.position.fromArray(position);
    this.camera.quaternion.fromArray(quaternion);
    Object.assign(this.camera, { fov, aspect, near, far });
    this.camera.updateProjectionMatrix();
    this.size = size;
  }

  reset() {
    this.header = null;
    this.solid.visible = this.ghost.visible = false;
  }

  showReference({ message }) {
    this.swap(this.ghost, message);
  }

  showGhost({ isWanted }) {
    this.ghost.visible = isWanted;
  }

  show({ message, limitMm }) {
    this.header = message.header;
    this.deviation = message.arrays.deviation?.values ?? null;
    this.solid.visible = message.arrays.faces.values.length > 0;
    if (!this.solid.visible) return;
    this.swap(this.solid, message);
    this.paint({ limitMm });
  }

  swap(mesh, { header, arrays }) {
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
    mesh.geometry.dispose();
    mesh.geometry = made;
  }

  // Colour the vertices.
  paint({ limitMm }) {
    if (!this.header || !this.solid.geometry.attributes.position) return;
    const count = this.solid.geometry.attributes.position.count;
    const colours = new Uint8Array(3 * count).fill(190);
    if (this.deviation) {
      const scale = this.header.deviation_unit_mm / limitMm * 127.5;
      for (let index = 0; index < count; index += 1) {
        const level = 3 * Math.round(Math.min(255, Math.max(0, 127.5 + this.deviation[index] * scale)));
        colours[3 * index] = LINEAR[COLOURS[level]];
        colours[3 * index + 1] = LINEAR[COLOURS[level + 1]];
        colours[3 * index + 2] = LINEAR[COLOURS[level + 2]];
      }
    }
    this.solid.geometry.setAttribute("color", new THREE.BufferAttribute(colours, 3, true));
  }

  // Cut at a plane, or at none.
  clip({ normal, constant }) {
    this.plane = normal ? new THREE.Plane(new THREE.Vector3(...normal), constant) : null;
    for (const mesh of [this.solid, this.ghost]) mesh.material.clippingPlanes = this.plane ? [this.plane] : null;
  }

  // Find the deviation at a place in the picture, from -1 to 1.
  read({ right, up }) {
    if (!this.solid.visible || !this.deviation) return;
    const caster = new THREE.Raycaster();
    caster.setFromCamera(new THREE.Vector2(right, up), this.camera);
    const isSeen = ({ point }) => !this.plane || this.plane.distanceToPoint(point) >= 0;
    const hit = caster.intersectObject(this.solid).find(isSeen);
    if (!hit) return;
    const deviationMm = this.deviation[hit.face.a] * this.header.deviation_unit_mm;
    postMessage({ hear: "found", deviationMm, pointMm: hit.point.toArray() });
  }

  // Draw once, when the browser is about to show the next picture; but never before the graphics processor is done with
  // the last one and has rested as long: where it is this processor, others need it too.
  ask() {
    if (this.isAsked) return;
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
    const { width, height, ratio } = this.size;
    if (!width || !height) return;
    const { canvas } = this.renderer.getContext();
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      this.renderer.setPixelRatio(ratio);
      this.renderer.setSize(width, height, false);
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
  const context = new OffscreenCanvas(1, 1).getContext("webgl2");
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

let scene = null;

onmessage = ({ data }) => {
  if (data.do === "begin") {
    try {
      scene = new Scene(data.canvas);
    } catch {
      postMessage({ hear: "failed" });
    }
  } else if (scene) {
    scene[data.do](data);
    if (data.do !== "read") scene.ask();
  }
};
