// Small charts over the print's time: what was measured, turns along the top.

import { fit, roundUp } from "./colours.js";
import { NONE, element, number } from "./text.js";

const MARGIN = { left: 46, right: 12, top: 20, bottom: 22 };

function ticks(low, high, most) {
  const rough = (high - low) / most;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((candidate) => candidate >= rough);
  const found = [];
  for (let value = Math.ceil(low / step - 1e-9) * step; value <= high + 1e-9 * step; value += step) found.push(value);
  return { found, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
}

function roundDown(value) {
  const power = 10 ** Math.floor(Math.log10(value) + 1e-9);
  return Number(([5, 2, 1].find((step) => step * power <= value * (1 + 1e-9)) * power).toPrecision(3));
}

// Ticks of a logarithmic axis: 1, 2, 5 where there is room.
function decades(low, high) {
  const found = [];
  for (let power = Math.floor(Math.log10(low) + 1e-9); 10 ** power <= high; power += 1) {
    for (const step of [1, 2, 5]) found.push(Number((step * 10 ** power).toPrecision(3)));
  }
  const inside = found.filter((value) => value >= low * 0.999 && value <= high * 1.001);
  return { found: inside.length > 5 ? inside.filter((value) => /^[0.]*10*$/.test(String(value))) : inside };
}

class Chart {
  // `series`: [{ key, name, colour, dash, scale }]; `band`: the key of a standard deviation around the first.
  constructor(parent, { title, unit, series, band = null, fromZero = true, isLog = false }) {
    Object.assign(this, { title, unit, series, band, fromZero, isLog, rows: [] });
    this.canvas = element("canvas");
    this.canvas.setAttribute("role", "img");
    this.readout = element("p");
    parent.append(element("div", {}, element("h3", { textContent: `${title}, ${unit}` }), this.canvas, this.readout));
    this.canvas.addEventListener("pointermove", (event) => {
      this.pointer = event.offsetX;
      this.draw();
    });
    this.canvas.addEventListener("pointerleave", () => {
      this.pointer = null;
      this.draw();
    });
  }

  update(rows, degreesPerSecond, cursorS) {
    Object.assign(this, { rows, degreesPerSecond, cursorS });
    this.draw();
  }

  draw() {
    const { context, width, height } = fit(this.canvas);
    context.clearRect(0, 0, width, height);
    context.font = "11px system-ui, 'DejaVu Sans', sans-serif";
    const values = this.rows.flatMap((row) => this.series.flatMap(({ key }) => {
      const around = this.band && row[this.band] !== null ? Math.min(row[this.band], Math.abs(row[key])) : 0;
      return row[key] === null ? [] : [row[key] - around, row[key] + around];
    }));
    if (!values.length) {
      context.fillStyle = "#9aa5b8";
      context.textAlign = "center";
      context.fillText("not known yet", width / 2, height / 2);
      this.say(null);
      return;
    }
    const { low, high } = this.range(values);
    const end = Math.max(this.rows[this.rows.length - 1].time_s, this.rows[0].time_s + 1);
    const start = Math.min(this.rows[0].time_s, end - 1);
    const x = (time) => MARGIN.left + (time - start) / (end - start) * (width - MARGIN.left - MARGIN.right);
    const place = this.isLog ? (value) => Math.log10(Math.max(value, low)) : (value) => value;
    const perUnit = (height - MARGIN.top - MARGIN.bottom) / (place(high) - place(low));
    const y = (value) => height - MARGIN.bottom - (place(value) - place(low)) * perUnit;
    this.axes(context, { x, y, start, end, low, high, width, height });
    if (this.band) this.drawBand(context, x, y);
    for (const line of this.series) this.drawLine(context, line, x, y);
    const pointed = (this.pointer - MARGIN.left) / (width - MARGIN.left - MARGIN.right);
    const marked = this.pointer != null ? start + pointed * (end - start) : this.cursorS;
    if (marked != null) {
      const row = this.nearest(marked);
      context.strokeStyle = "#e4e8ef88";
      context.beginPath();
      context.moveTo(x(row.time_s), MARGIN.top);
      context.lineTo(x(row.time_s), height - MARGIN.bottom);
      context.stroke();
      this.say(row);
    } else this.say(this.rows[this.rows.length - 1]);
  }

  // A logarithmic axis ends at whole steps of 1, 2, 5, and shows what is large without hiding what is small.
  range(values) {
    if (this.isLog) {
      const known = values.filter((value) => value > 0);
      return { low: roundDown(Math.min(...known)), high: roundUp(Math.max(...known) * 1.001) };
    }
    const low = this.fromZero ? Math.min(0, ...values) : Math.min(...values);
    const high = Math.max(...values);
    return { low, high: high > low ? high : low + 1 };
  }

  axes(context, { x, y, start, end, low, high, width, height }) {
    context.lineWidth = 1;
    context.fillStyle = "#9aa5b8";
    const vertical = this.isLog ? decades(low, high) : ticks(low, high, 4);
    context.textAlign = "right";
    context.textBaseline = "middle";
    for (const value of vertical.found) {
      context.strokeStyle = "#2a3240";
      context.beginPath();
      context.moveTo(MARGIN.left, y(value));
      context.lineTo(width - MARGIN.right, y(value));
      context.stroke();
      context.fillText(this.isLog ? String(value) : number(value, vertical.digits), MARGIN.left - 5, y(value));
    }
    const along = ticks(start, end, Math.max(2, width / 90));
    context.textAlign = "center";
    context.textBaseline = "top";
    const name = ({ found, digits }, index, unit) => number(found[index], digits) + (index === found.length - 1 ? unit : "");
    along.found.forEach((time, index) => {
      context.fillText(name(along, index, " s"), Math.min(x(time), width - 14), height - MARGIN.bottom + 5);
    });
    if (!this.degreesPerSecond) return;
    const perTurn = 360 / this.degreesPerSecond;
    const turns = ticks(start / perTurn, end / perTurn, Math.max(2, width / 110));
    context.textBaseline = "bottom";
    turns.found.forEach((turn, index) => {
      context.fillText(name(turns, index, " turns"), Math.min(x(turn * perTurn), width - 24), MARGIN.top - 5);
    });
  }

  drawLine(context, { key, colour, dash = [] }, x, y) {
    context.strokeStyle = colour;
    context.lineWidth = 2;
    context.setLineDash(dash);
    context.beginPath();
    let isDown = false;
    for (const row of this.rows) {
      if (row[key] === null) {
        isDown = false;
      } else {
        context[isDown ? "lineTo" : "moveTo"](x(row.time_s), y(row[key]));
        isDown = true;
      }
    }
    context.stroke();
    context.setLineDash([]);
  }

  drawBand(context, x, y) {
    const { key, colour } = this.series[0];
    const known = this.rows.filter((row) => row[key] !== null && row[this.band] !== null);
    context.fillStyle = `${colour}33`;
    context.beginPath();
    const around = (row) => Math.min(row[this.band], Math.abs(row[key]));
    known.forEach((row) => context.lineTo(x(row.time_s), y(row[key] + around(row))));
    known.reverse().forEach((row) => context.lineTo(x(row.time_s), y(row[key] - around(row))));
    context.fill();
  }

  nearest(time) {
    const off = (row) => Math.abs(row.time_s - time);
    return this.rows.reduce((best, row) => (off(row) < off(best) ? row : best));
  }

  say(row) {
    const words = this.series.map(({ key, name, digits = 3 }, index) => {
      const isBand = index === 0 && this.band && row?.[this.band] != null;
      return row && `${name} ${number(row[key], digits)}${isBand ? ` \u00b1 ${number(row[this.band], 1)}` : ""}`;
    });
    const text = row === null ? NONE : `${number(row.time_s, 0)} s: ${words.join(", ")}`;
    if (this.readout.textContent !== text) this.readout.textContent = text;
    this.canvas.setAttribute("aria-label", `${this.title} over time; ${text} ${this.unit}`);
  }
}

export class Curves {
  constructor(parent) {
    this.charts = [
      new Chart(parent, { title: "RMSE", unit: "mm", isLog: true, series: [
        { key: "rmse_mm", name: "print to reference", colour: "#8fb0ff" },
        { key: "reverse_rmse_mm", name: "reference to print", colour: "#ffd76a", dash: [6, 4] }] }),
      new Chart(parent, { title: "IoU", unit: "share", series: [{ key: "iou", name: "IoU", colour: "#8fb0ff" }] }),
      new Chart(parent, { title: "Cured volume", unit: "mm\u00b3", series: [
        { key: "cured_volume_mm3", name: "volume", colour: "#8fb0ff", digits: 1 }] }),
      new Chart(parent, { title: "Predicted end of light", unit: "lit s", fromZero: false, band: "sigma_s", series: [
        { key: "stop_s", name: "stop at", colour: "#8fb0ff", digits: 1 },
        { key: "lit_s", name: "lit so far", colour: "#ffd76a", dash: [6, 4], digits: 1 }] }),
    ];
  }

  show(rows, degreesPerSecond, cursorS) {
    const known = rows.filter((row) => row.time_s !== null);
    for (const chart of this.charts) chart.update(known, degreesPerSecond, cursorS);
  }
}
