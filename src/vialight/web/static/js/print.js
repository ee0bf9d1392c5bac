// One run on the page: its live state and pictures, its history, and orders to its print.

import { Curves } from "./curves.js";
import { Channel, Refused, getBinary, getJson, post } from "./connection.js";
import { Freshness } from "./freshness.js";
import { Machine } from "./machine.js";
import { CameraView, PatternView } from "./optics.js";
import { Projections } from "./projections.js";
import { Results } from "./runs.js";
import { Slices } from "./slices.js";
import { Stop } from "./stop.js";
import { SurfaceView } from "./surface.js";
import { Timeline } from "./timeline.js";
import { $, STATES, duration, element, millimetres, number, write } from "./text.js";

export class PrintPage {
  // `onLockedOut` is called where the server no longer knows this page.
  constructor(onLockedOut) {
    this.onLockedOut = onLockedOut;
    this.projections = new Projections({
      density: $("projections-density"), cured: $("projections-cured"), reference: $("projections-reference") });
    this.slices = new Slices();
    this.surface = new SurfaceView($("surface-canvas"), $("surface-ramp"));
    this.curves = new Curves($("charts"));
    this.camera = new CameraView($("camera-canvas"), $("camera-caption"));
    this.pattern = new PatternView($("pattern-canvas"), $("pattern-caption"));
    this.machine = new Machine();
    this.results = new Results();
    this.timeline = new Timeline((moment) => this.lookBack(moment), () => this.lookAtNewest());
    this.stop = new Stop((order) => this.order(order), () => this.stopPaths());
    this.freshness = new Freshness(this);
    this.channels = {};
    this.orderNumber = 0;
    window.addEventListener("resize", () => this.redraw());
    $("extend-button").addEventListener("click", () => {
      const turns = Number($("extend-turns").value);
      this.ask({ do: "extend", turns }, `Extended by ${number(turns)} turns.`);
    });
    for (const choice of document.querySelectorAll("input[name=mode]")) {
      choice.addEventListener("change", () => this.ask({ do: "mode", mode: choice.value }, `Mode ${choice.value}.`));
    }
  }

  leave() {
    for (const channel of Object.values(this.channels)) channel.close();
    this.channels = {};
    this.run = null;
    this.slices.reset(null);
  }

  // The page's parts must be in sight: what is drawn takes its size from there.
  enter(run, stopPort) {
    this.leave();
    this.run = run;
    this.stopPort = stopPort;
    $("run-name").textContent = [this.run.name, this.run.part].filter(Boolean).join(" \u00b7 ");
    document.title = `${this.run.name} \u2013 vialight`;
    Object.assign(this, {
      message: null, receivedAt: performance.now(), changed: null, logCount: 0, isFetchingLog: false, hasMoment: false });
    for (const part of [this.projections, this.surface, this.timeline, this.stop]) part.reset();
    this.slices.reset(`/api/runs/${run.key}`);
    this.camera.reset(this.run.camera);
    this.pattern.reset(this.run.projector);
    $("log").replaceChildren();
    this.results.show(this.run, true);
    this.curves.show([], this.run.speed_deg_s);
    this.getReference();
    const takers = {
      state: (message) => this.takeState(message),
      images: (message) => this.takeImage(message),
      surface: (message) => this.takeSurface(message),
    };
    for (const [name, take] of Object.entries(takers)) {
      this.channels[name] = new Channel(`/ws/${run.key}/${name}`, take, (channel) => this.connectionChanged(channel));
    }
  }

  stopPaths() {
    const path = `/api/runs/${this.run.key}/stop`;
    return this.stopPort ? [path, `${location.protocol}//${location.hostname}:${this.stopPort}${path}`] : [path];
  }

  async getReference() {
    const { run } = this;
    try {
      const ghost = await getBinary(`/api/runs/${run.key}/reference`);
      if (this.run === run) this.surface.showReference(ghost);
    } catch { /* a run without a reference has none to show */ }
  }

  // A session that is no longer good shows as sockets that are refused.
  async connectionChanged(channel) {
    if (channel.isOpen || channel.isOver || this.isAsking) return;
    this.isAsking = true;
    try {
      this.stopPort = (await getJson("/api/session")).stop_port;
    } catch (error) {
      if (error instanceof Refused && error.status === 401 && this.run) {
        this.leave();
        this.onLockedOut(error.message);
      }
    } finally {
      this.isAsking = false;
    }
  }

  takeState({ header }) {
    if (header.kind === "answer") return; // the plain request, which is sent with it, tells more
    const wasLive = this.message?.live;
    this.message = header;
    this.receivedAt = performance.now();
    const { live, status } = header;
    const canStop = live && status?.state !== "replay";
    this.stop.see(canStop, status, header.unsure !== null && status?.state !== "replay");
    this.tellState();
    this.timeline.setLive(live);
    $("orders").hidden = !canStop;
    if (wasLive && !live) this.timeline.toNewest();
    if (header.changed !== this.changed) this.renew(header.changed);
    this.getCurves(header.counts);
    this.getLog(header.counts.log);
  }

  // What lies in the run's folder has changed: results may have come.
  async renew(changed) {
    const isFirst = this.changed === null;
    this.changed = changed;
    const { run } = this;
    if (!isFirst) {
      const renewed = await getJson(`/api/runs/${run.key}`).catch(() => null);
      if (!renewed || this.run !== run) return;
      this.run = renewed;
      this.camera.overlay = renewed.camera;
      this.pattern.projector = renewed.projector;
      if (!this.surface.hasGhost) this.getReference();
    }
    this.results.show(this.run, this.message.live);
    this.tellState();
  }

  async getCurves(counts) {
    const { run, timeline } = this;
    const isKnown = counts.moments === timeline.rows.length && counts.surfaces === timeline.surfaces.length;
    if (timeline.isFetching || isKnown) return;
    timeline.isFetching = true;
    try {
      const given = await getJson(`/api/runs/${run.key}/curves/${timeline.rows.length}`);
      if (this.run?.key !== run.key) return;
      timeline.add(given);
      this.curves.show(timeline.rows, run.speed_deg_s, timeline.cursorS);
      if (!this.message.live && !this.hasMoment) this.timeline.toNewest();
    } catch { /* asked again with the next state */ } finally {
      timeline.isFetching = false;
    }
  }

  async getLog(count) {
    if (this.isFetchingLog || count <= this.logCount) return;
    this.isFetchingLog = true;
    const { run } = this;
    try {
      const events = await getJson(`/api/runs/${run.key}/log/${this.logCount}`);
      if (this.run?.key !== run.key) return;
      this.logCount += events.length;
      const list = $("log");
      const isAtEnd = list.scrollTop + list.clientHeight >= list.scrollHeight - 8;
      list.append(...events.map(logLine));
      while (list.children.length > 500) list.firstChild.remove();
      if (isAtEnd) list.scrollTop = list.scrollHeight;
    } catch { /* asked again with the next state */ } finally {
      this.isFetchingLog = false;
    }
  }

  takeImage(message) {
    const { header, arrays } = message;
    if (header.kind === "reference") this.projections.show(message);
    else if (!this.timeline.isBack) {
      if (header.kind === "camera") this.camera.show(message);
      else if (header.kind === "pattern") this.pattern.show(message);
      else if (header.kind === "snapshot") {
        this.projections.show(message);
        this.slices.voxelMm = header.voxel_mm;
        this.machine.snapshot = header;
      } else this.slices.show(arrays, null, false);
    }
  }

  takeSurface(message) {
    if (this.timeline.isBack) return;
    this.surface.show(message);
    this.tellSurface(message.header);
  }

  tellSurface(header) {
    $("surface-numbers").textContent = `RMSE ${millimetres(header.rmse_mm)}, back ${millimetres(header.reverse_rmse_mm)}, `
      + `IoU ${number(header.iou, 3)}, volume ${number(header.cured_volume_mm3, 1)} mm\u00b3, at ${number(header.time_s, 1)} s`;
  }

  // Show a moment of the history: one at a time, and only the last that was asked for.
  async lookBack(moment) {
    this.wanted = moment;
    if (this.isLooking) return;
    this.isLooking = true;
    const { run } = this;
    try {
      while (this.wanted !== null && this.run === run) {
        const row = this.timeline.rows[this.wanted];
        this.wanted = null;
        await this.showMoment(run, row);
      }
    } catch (error) {
      $("moment-label").textContent = error instanceof Refused ? error.message : "cannot be fetched";
    } finally {
      this.isLooking = false;
    }
  }

  async showMoment(run, row) {
    const pictures = await getBinary(`/api/runs/${run.key}/moments/${row.number}`);
    if (this.run !== run || this.isLiveNow()) return;
    this.hasMoment = true;
    if (!this.projections.last?.reference_xy) {
      const reference = await getBinary(`/api/runs/${run.key}/reference-sums`).catch(() => null);
      if (reference) this.projections.show(reference);
    }
    this.projections.show(pictures);
    this.slices.show(pictures.arrays, pictures.header.voxel_mm, this.timeline.isBack);
    this.curves.show(this.timeline.rows, run.speed_deg_s, this.timeline.cursorS);
    await this.showRecorded(run, row);
    const surface = this.timeline.surfaceAt(row.number);
    if (this.wanted !== null || surface === null) return;
    const shape = await getBinary(`/api/runs/${run.key}/surfaces/${surface}`);
    if (this.run !== run || this.isLiveNow()) return;
    this.surface.show(shape);
    this.tellSurface(row);
    if (surface !== row.number) this.surface.tell(`Surface of frame ${surface}; the next one was kept later.`);
  }

  // What camera and projector saw and showed then; a run that was moved may have left that behind.
  async showRecorded(run, row) {
    const of = (what) => getBinary(`/api/runs/${run.key}/moments/${row.number}/${what}`).catch(() => null);
    const [picture, pattern] = await Promise.all([of("camera"), of("pattern")]);
    if (this.run !== run || this.isLiveNow()) return;
    if (picture) this.camera.show(picture);
    if (pattern) this.pattern.show(pattern);
  }

  isLiveNow() {
    return this.message?.live && !this.timeline.isBack;
  }

  lookAtNewest() {
    this.curves.show(this.timeline.rows, this.run.speed_deg_s, null);
    if (!this.message?.live && this.timeline.rows.length) this.lookBack(this.timeline.rows.length - 1);
  }

  tellState() {
    const { live, status } = this.message;
    const state = live && status ? status.state : live ? "preflight" : this.run.state;
    const label = STATES[state] ?? state;
    const text = live && status?.message ? `${label}: ${status.message}` : label;
    write($("run-state"), text);
    if ($("run-state").dataset.state !== state) $("run-state").dataset.state = state;
    const figures = live && status ? [
      ["Turn", number(status.turn, 1)], ["Elapsed", duration(status.time_s)],
      ["Light on", duration(status.lit_s)], ["Remaining", duration(status.remaining_s)],
    ] : this.ended();
    const list = $("figures");
    while (list.children.length > figures.length) list.lastChild.remove();
    while (list.children.length < figures.length) list.append(element("div", {}, element("dt"), element("dd")));
    figures.forEach(([term, value], index) => {
      write(list.children[index].firstChild, term);
      write(list.children[index].lastChild, value);
    });
    this.machine.show(live ? status : null, this.run.printed);
  }

  ended() {
    const last = this.timeline.rows[this.timeline.rows.length - 1];
    const placed = this.run.metrics.as_placed;
    return [["RMSE", millimetres(placed?.rmse_mm ?? last?.rmse_mm)], ["IoU", number(placed?.iou ?? last?.iou, 3)],
      ["Light on", duration(last?.lit_s)]];
  }

  order(order) {
    this.orderNumber += 1;
    return this.channels.state?.send({ order, id: this.orderNumber });
  }

  async ask(order, done) {
    this.machine.isChanging = true;
    $("order-answer").textContent = "\u2026";
    try {
      await post(`/api/runs/${this.run.key}/orders`, order);
      $("order-answer").textContent = done;
    } catch (error) {
      $("order-answer").textContent = error instanceof Refused ? error.message : "The server cannot be reached.";
    } finally {
      this.machine.isChanging = false;
    }
  }

  redraw() {
    if (!this.run) return;
    this.projections.redraw();
    this.slices.redraw();
    this.camera.redraw();
    this.pattern.redraw();
    this.surface.paint();
    this.curves.show(this.timeline.rows, this.run.speed_deg_s, this.timeline.cursorS);
  }
}

function logLine(event) {
  const { time_s: time, event: name, message, wall_s: _, ...rest } = event;
  const word = (value) => (typeof value === "object" ? JSON.stringify(value) : value);
  const details = Object.entries(rest).map(([key, value]) => `${key} ${word(value)}`).join(", ");
  const by = rest.by && !message?.includes(rest.by) ? ` (${rest.by})` : "";
  const text = message ? `${message}${by}` : [name, details].filter(Boolean).join(": ");
  const when = time === undefined ? "" : `${number(time, 1)} s`;
  return element("li", {}, element("span", { textContent: when }), element("span", { textContent: text }));
}
