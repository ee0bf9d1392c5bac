// The camera's own picture with the vial where the rig has it, and the pattern that is projected.

import { fit } from "./colours.js";
import { number } from "./text.js";

const EDGE = "#ffd76a";
const AXIS = "#8fb0ff";

function grey(source, image, level) {
  const [rows, columns] = image.shape;
  [source.width, source.height] = [columns, rows];
  const context = source.getContext("2d", { willReadFrequently: true });
  const pixels = context.createImageData(columns, rows);
  const words = new Uint32Array(pixels.data.buffer);
  const table = Uint32Array.from({ length: 256 }, (_, index) => {
    const shade = level(index);
    return 0xff000000 | shade << 16 | shade << 8 | shade;
  });
  for (let index = 0; index < words.length; index += 1) words[index] = table[image.values[index]];
  context.putImageData(pixels, 0, 0);
}

export class CameraView {
  constructor(canvas, caption) {
    Object.assign(this, { canvas, caption, source: document.createElement("canvas"), overlay: null });
  }

  reset(overlay) {
    this.overlay = overlay;
    this.header = null;
    this.caption.textContent = "The camera's picture comes while it prints.";
    const { context, width, height } = fit(this.canvas);
    context.clearRect(0, 0, width, height);
  }

  show({ header, arrays }) {
    this.header = header;
    // A gentle curve: the glow of young gel is dim.
    grey(this.source, arrays.counts, (level) => Math.round(255 * Math.sqrt(Math.max(level - 1, 0) / 254)));
    this.redraw();
    const legend = this.overlay?.edge_columns ? "yellow: the vial's edges, blue: the axis, as the rig has them"
      : this.overlay ? "blue: the axis, as the rig has it" : "the run holds no rig";
    const angle = ((header.angle_deg % 360) + 360) % 360;
    this.caption.textContent = `Frame ${header.frame}, stage at ${number(angle, 0)}\u00b0; ${legend}`;
  }

  redraw() {
    if (!this.header) return;
    this.canvas.style.aspectRatio = `${this.header.columns} / ${this.header.rows}`;
    const { context, width, height } = fit(this.canvas);
    context.drawImage(this.source, 0, 0, width, height);
    if (!this.overlay) return;
    const place = (column) => (column + 0.5) / this.header.columns * width;
    const line = (x0, y0, x1, y1, colour, dash) => {
      context.setLineDash(dash);
      context.strokeStyle = colour;
      context.lineWidth = 1.5;
      context.beginPath();
      context.moveTo(x0, y0);
      context.lineTo(x1, y1);
      context.stroke();
    };
    for (const column of this.overlay.edge_columns ?? []) line(place(column), 0, place(column), height, EDGE, []);
    const axis = place(this.overlay.axis_column);
    line(axis, 0, axis, height, AXIS, [8, 5]);
    const row = (this.overlay.optical_row + 0.5) / this.header.rows * height;
    line(axis - 9, row, axis + 9, row, AXIS, []);
    context.setLineDash([]);
  }
}

export class PatternView {
  constructor(canvas, caption) {
    Object.assign(this, { canvas, caption, source: document.createElement("canvas") });
  }

  reset(projector) {
    this.projector = projector;
    this.message = null;
    this.caption.textContent = "The pattern comes while it prints.";
    const { context, width, height } = fit(this.canvas);
    context.clearRect(0, 0, width, height);
  }

  show(message) {
    this.message = message;
    // Most levels of a pattern are low: shown as they are, they look black.
    if (message.arrays.levels) grey(this.source, message.arrays.levels, (level) => Math.round(Math.sqrt(255 * level)));
    this.redraw();
    const { index, angle_deg: angle } = message.header;
    this.caption.textContent = index === null ? "The projector shows black."
      : `The projector shows pattern ${index} (${number(angle, 0)}\u00b0), here brightened.`;
  }

  redraw() {
    if (!this.message) return;
    const { header, arrays } = this.message;
    const [rows, columns] = arrays.levels?.shape ?? [0, 0];
    const image = this.projector ?? { columns: columns * header.step || 16, rows: rows * header.step || 9 };
    this.canvas.style.aspectRatio = `${image.columns} / ${image.rows}`;
    const { context, width, height } = fit(this.canvas);
    context.fillStyle = "#000";
    context.fillRect(0, 0, width, height);
    if (!arrays.levels) return;
    const scale = width / image.columns;
    context.drawImage(this.source, header.first_column * scale, header.first_row * scale,
      columns * header.step * scale, rows * header.step * scale);
  }
}
