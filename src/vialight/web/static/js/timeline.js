// The history of a print as a line to scrub along.

import { $, number } from "./text.js";

export class Timeline {
  constructor(onLook, onNewest) {
    Object.assign(this, { onLook, onNewest, slider: $("moment"), isLive: false });
    this.reset();
    this.slider.addEventListener("input", () => {
      const at = Number(this.slider.value);
      if (this.isLive && at >= this.rows.length - 1) this.toNewest();
      else this.look(at);
    });
    $("to-live").addEventListener("click", () => this.toNewest());
  }

  reset() {
    Object.assign(this, { rows: [], surfaces: [], isBack: false, at: null, isFetching: false });
    this.slider.max = 0;
    this.slider.value = 0;
    this.label();
  }

  setLive(isLive) {
    this.isLive = isLive;
    if (!this.isBack) this.label();
  }

  get cursorS() {
    return this.at === null ? null : this.rows[this.at].time_s;
  }

  add({ start, columns, rows, surfaces }) {
    this.rows.length = start;
    for (const row of rows) this.rows.push(Object.fromEntries(columns.map((name, index) => [name, row[index]])));
    this.surfaces = surfaces;
    this.slider.max = Math.max(this.rows.length - 1, 0);
    if (!this.isBack) this.slider.value = this.slider.max;
    this.label();
  }

  look(at) {
    this.at = at;
    this.isBack = true;
    this.slider.value = at;
    this.label();
    this.onLook(at);
  }

  toNewest() {
    this.isBack = false;
    this.at = null;
    this.slider.value = this.slider.max;
    this.label();
    this.onNewest();
  }

  // The newest surface that was there at a moment.
  surfaceAt(number_) {
    return this.surfaces.filter((surface) => surface <= number_).pop() ?? null;
  }

  label() {
    const row = this.rows[this.at ?? this.rows.length - 1];
    const end = this.isLive ? "live, " : "end, ";
    const text = row ? `${this.at === null ? end : ""}${number(row.time_s, 1)} s, frame ${row.number}` : "no history yet";
    $("moment-label").textContent = text;
    this.slider.setAttribute("aria-valuetext", text);
    $("to-live").textContent = this.isLive ? "Back to live" : "To the end";
    $("to-live").disabled = this.at === null;
  }
}
