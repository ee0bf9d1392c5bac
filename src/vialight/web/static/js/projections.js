// Images of the object: sum projections, slices, gel times; all to one scale, with scale bars.

import { cividis, drawRamp, fit, roundUpFinely } from "./colours.js";
import { element, number } from "./text.js";

const PLANES = ["xy", "xz", "yz"];
const NAMES = { xy: "XY, from above", xz: "XZ, along y", yz: "YZ, along x" };
const EMPTY = [11, 14, 19];

// One image in 255 levels (0: none), row 0 at the bottom.
export class Picture {
  constructor(parent, plane, what) {
    this.name = `${what}, ${NAMES[plane]}`;
    this.canvas = element("canvas", { title: NAMES[plane] });
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", this.name);
    this.source = document.createElement("canvas");
    this.plane = plane;
    parent.append(this.canvas);
  }

  // `widest` is how many mm the widest picture beside this one shows: it fills the column.
  draw(image, voxelMm, low, high, widestMm, colours = cividis) {
    Object.assign(this, { image, voxelMm, low, high, widestMm, colours });
    const [rows, columns] = image.shape;
    const share = columns * voxelMm / widestMm;
    this.canvas.style.width = `${Math.min(100, 100 * share)}%`;
    this.canvas.style.aspectRatio = `${columns} / ${rows}`;
    this.colour(rows, columns);
    this.show();
  }

  colour(rows, columns) {
    const { image, low, high, colours } = this;
    if (this.source.width !== columns || this.source.height !== rows) {
      [this.source.width, this.source.height] = [columns, rows];
      this.pixels = null;
    }
    const table = new Uint32Array(256);
    table[0] = 0xff000000 | EMPTY[2] << 16 | EMPTY[1] << 8 | EMPTY[0];
    for (let level = 1; level < 256; level += 1) {
      const value = image.low + (level - 1) / 254 * (image.high - image.low);
      const place = 3 * Math.round(255 * Math.min(1, Math.max(0, (value - low) / Math.max(high - low, 1e-12))));
      table[level] = 0xff000000 | colours[place + 2] << 16 | colours[place + 1] << 8 | colours[place];
    }
    const context = this.source.getContext("2d", { willReadFrequently: true });
    this.pixels ??= context.createImageData(columns, rows);
    const words = new Uint32Array(this.pixels.data.buffer);
    for (let row = 0; row < rows; row += 1) {
      const from = (rows - 1 - row) * columns;
      const to = row * columns;
      for (let column = 0; column < columns; column += 1) words[to + column] = table[image.values[from + column]];
    }
    context.putImageData(this.pixels, 0, 0);
  }

  clear() {
    const { context, width, height } = fit(this.canvas);
    context.clearRect(0, 0, width, height);
  }

  show() {
    const { context, width, height } = fit(this.canvas);
    context.imageSmoothingQuality = "high";
    context.drawImage(this.source, 0, 0, width, height);
    const perMm = width / (this.image.shape[1] * this.voxelMm);
    scaleBar(context, perMm, height);
    context.font = "600 11px system-ui, 'DejaVu Sans', sans-serif";
    context.fillStyle = "#ffffffcc";
    context.textAlign = "right";
    context.textBaseline = "top";
    context.fillText(this.plane.toUpperCase(), width - 6, 5);
  }
}

export function scaleBar(context, perMm, height) {
  const length = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20].find((mm) => mm * perMm >= 28) ?? 20;
  context.strokeStyle = "#ffffff";
  context.lineWidth = 3;
  context.beginPath();
  context.moveTo(8, height - 8);
  context.lineTo(8 + length * perMm, height - 8);
  context.stroke();
  context.font = "11px system-ui, 'DejaVu Sans', sans-serif";
  context.fillStyle = "#ffffff";
  context.textAlign = "left";
  context.textBaseline = "bottom";
  context.fillText(`${length} mm`, 8, height - 12);
}

// The nine sum projections.
export class Projections {
  constructor(columns) {
    this.pictures = {};
    this.ramps = {};
    this.scale = { density: 0, reference: 0 };
    for (const [kind, parent] of Object.entries(columns)) {
      this.pictures[kind] = {};
      const what = parent.querySelector("h3").textContent;
      for (const plane of PLANES) this.pictures[kind][plane] = new Picture(parent, plane, what);
      this.ramps[kind] = element("canvas", { className: "ramp" });
      this.ramps[kind].setAttribute("role", "img");
      parent.append(this.ramps[kind]);
    }
  }

  // Forget the scales: another run, or another print.
  reset() {
    this.scale = { density: 0, reference: 0 };
    this.last = {};
    for (const ofKind of Object.values(this.pictures)) for (const picture of Object.values(ofKind)) picture.clear();
    this.grid = null;
  }

  show({ header, arrays }) {
    if (header.voxel_mm) this.grid = { voxelMm: header.voxel_mm };
    this.last = { ...this.last, ...arrays };
    const known = Object.keys(this.pictures).filter((kind) => arrays[`${kind}_xy`]);
    const { voxelMm } = this.grid;
    const any = (plane) => this.last[`density_${plane}`] ?? this.last[`reference_${plane}`];
    const widest = Math.max(...PLANES.map((plane) => any(plane)?.shape[1] ?? 1)) * voxelMm;
    for (const kind of known) {
      const [low, high] = this.range(kind, arrays);
      for (const plane of PLANES) {
        this.pictures[kind][plane].draw(arrays[`${kind}_${plane}`], voxelMm, low, high, widest);
      }
      const unit = kind === "density" ? "counts" : "mm of path";
      const text = kind === "density" ? number(high, 0) : number(high, high < 1 ? 2 : 0);
      drawRamp(this.ramps[kind], cividis, "0", text, unit);
      this.ramps[kind].setAttribute("aria-label", `Colours from 0 to ${text} ${unit}`);
    }
  }

  // Thresholded print and reference share a scale; all scales only grow, so that colours keep their meaning.
  range(kind, arrays) {
    const of = kind === "density" ? "density" : "reference";
    const high = roundUpFinely(Math.max(...PLANES.map((plane) => arrays[`${kind}_${plane}`].high)));
    this.scale[of] = Math.max(this.scale[of], high);
    return [0, this.scale[of]];
  }

  redraw() {
    if (this.grid && this.last) this.show({ header: {}, arrays: this.last });
  }
}
