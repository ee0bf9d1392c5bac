// Slices through the volume wherever one wants them, or mean gel times.
//
// Middle planes come by themselves with every surface, and with every moment of the history.  Others are asked for: once a
// second while it prints, and when a slider moves.

import { cividis, drawRamp, roundUpFinely } from "./colours.js";
import { Refused, getBinary } from "./connection.js";
import { Picture } from "./projections.js";
import { $, element, number } from "./text.js";

const ACROSS = { xy: "z", xz: "y", yz: "x" };
const PLANES = Object.keys(ACROSS);

export class Slices {
  constructor() {
    this.select = $("planes-kind");
    this.pictures = {};
    this.sliders = {};
    this.answers = {};
    for (const plane of PLANES) {
      const axis = ACROSS[plane];
      this.pictures[plane] = new Picture($(`plane-${plane}`), plane, "Slice");
      this.answers[axis] = element("output");
      this.sliders[axis] = element("input", { type: "range", min: 0, max: 1000, value: 500, disabled: true });
      this.sliders[axis].setAttribute("aria-label", `Slice across ${axis}`);
      this.sliders[axis].addEventListener("input", () => this.move());
      $(`plane-${plane}`).append(element("label", { className: "slider" }, this.sliders[axis], this.answers[axis]));
    }
    this.select.addEventListener("change", () => this.redraw());
    $("planes-middle").addEventListener("click", () => this.toMiddle());
    this.reset(null);
  }

  // `address` of the run; null: none.
  reset(address) {
    Object.assign(this, { address, middle: {}, asked: null, isAway: false, isWanted: false, isBack: false });
    for (const picture of Object.values(this.pictures)) picture.clear();
    for (const slider of Object.values(this.sliders)) slider.value = 500;
    this.enable();
    if (address) this.fetch();
  }

  // Middle planes and gel times, as they come.  A moment of the history has no other slices.
  show(arrays, voxelMm, isBack) {
    for (const [name, image] of Object.entries(arrays)) if (/^(slice|gel)_/.test(name)) this.middle[name] = image;
    if (voxelMm) this.voxelMm = voxelMm;
    this.isBack = isBack;
    this.enable();
    if (!isBack && (this.isAway || !this.asked)) this.fetch();
    this.redraw();
  }

  move() {
    this.isAway = true;
    this.fetch();
  }

  toMiddle() {
    for (const slider of Object.values(this.sliders)) slider.value = 500;
    this.isAway = false;
    this.fetch();
  }

  enable() {
    const isPossible = Boolean(this.asked) && !this.isBack && this.select.value === "slice";
    for (const slider of Object.values(this.sliders)) slider.disabled = !isPossible;
    $("planes-middle").disabled = !isPossible;
  }

  // One at a time, and again where the sliders have moved meanwhile.
  async fetch() {
    this.isWanted = true;
    if (this.isFetching) return;
    this.isFetching = true;
    const { address } = this;
    try {
      while (this.isWanted && this.address === address) {
        this.isWanted = false;
        const place = ["x", "y", "z"].map((axis) => this.sliders[axis].value).join("/");
        const { header, arrays } = await getBinary(`${address}/slices/${place}`);
        if (this.address !== address) return;
        Object.assign(this, { asked: arrays, atMm: header.at_mm, askedVoxelMm: header.voxel_mm });
        $("planes-notice").textContent = "";
        this.enable();
        this.redraw();
      }
    } catch (error) {
      if (this.isAway) $("planes-notice").textContent = error instanceof Refused ? error.message : "cannot be fetched";
    } finally {
      this.isFetching = false;
    }
  }

  redraw() {
    this.enable();
    const kind = this.select.value;
    const isAsked = kind === "slice" && this.asked && !this.isBack && (this.isAway || !this.middle.slice_xy);
    const given = isAsked ? this.asked : this.middle;
    const voxelMm = isAsked ? this.askedVoxelMm : this.voxelMm;
    for (const [axis, answer] of Object.entries(this.answers)) {
      answer.textContent = kind === "gel" ? `mean along ${axis}` : isAsked ? `${axis} = ${number(this.atMm[axis], 2)} mm` : "middle";
    }
    if (!given[`${kind}_xy`] || !voxelMm) return;
    const images = PLANES.map((plane) => given[`${kind}_${plane}`]);
    const widest = Math.max(...images.map((image) => image.shape[1])) * voxelMm;
    const isGel = kind === "gel";
    const low = isGel ? images[0].low : 0;
    const high = isGel ? images[0].high : roundUpFinely(Math.max(...images.map((image) => image.high)));
    PLANES.forEach((plane, index) => this.pictures[plane].draw(images[index], voxelMm, low, high, widest));
    const unit = isGel ? "lit seconds at gelation" : "counts per mm";
    drawRamp($("planes-ramp"), cividis, number(low, 0), number(high, 0), unit);
    $("planes-ramp").setAttribute("aria-label", `Colours from ${number(low, 0)} to ${number(high, 0)} ${unit}`);
  }
}
