// The page: what is shown, from which of the server's messages, and what is said when they stay away.

import { Curves } from "./curves.js";
import { Channel, Refused, getBinary, getJson, post } from "./connection.js";
import { CameraView, PatternView } from "./optics.js";
import { MiddlePlanes, Projections } from "./projections.js";
import { Results, showRuns } from "./runs.js";
import { Stop } from "./stop.js";
import { SurfaceView } from "./surface.js";
import { Timeline } from "./timeline.js";
import { $, NONE, STATES, bytes, duration, element, facts, millimetres, number } from "./text.js";

const OLD_S = 1;
const VIEWS = ["login", "runs", "print"];

class Page {
  constructor() {
    this.projections = new Projections({
      density: $("projections-density"), cured: $("projections-cured"), reference: $("projections-reference") });
    this.planes = new MiddlePlanes($("planes"), $("planes-ramp"), $("planes-kind"));
    this.surface = new SurfaceView($("surface-canvas"), $("surface-ramp"));
    this.curves = new Curves($("charts"));
    this.camera = new CameraView($("camera-canvas"), $("camera-caption"));
    this.pattern = new PatternView($("pattern-canvas"), $("pattern-caption"));
    this.results = new Results();
    this.timeline = new Timeline((number_) => this.lookBack(number_), () => this.lookAtNewest());
    this.stop = new Stop((order) => this.order(order), () => `/api/runs/${this.run.key}/stop`);
    this.channels = {};
    this.orderNumber = 0;
    this.listen();
  }

  listen() {
    window.addEventListener("hashchange", () => this.route());
    window.addEventListener("resize", () => this.redraw());
    $("to-runs").addEventListener("click", () => { location.hash = ""; });
    $("login-form").addEventListener("submit", (event) => {
      event.preventDefault();
      this.login($("token").value.trim());
    });
    $("extend-button").addEventListener("click", () => {
      const turns = Number($("extend-turns").value);
      this.ask({ do: "extend", turns }, `Extended by ${number(turns)} turns.`);
    });
    for (const choice of document.querySelectorAll("input[name=mode]")) {
      choice.addEventListener("change", () => this.ask({ do: "mode", mode: choice.value }, `Mode ${choice.value}.`));
    }
    setInterval(() => this.tellAge(), 200);
  }

  // Where to go: a token to be let in with, a run, or the list.
  async route() {
    const given = new URLSearchParams(location.hash.slice(1));
    if (given.has("token")) {
      history.replaceState(null, "", location.pathname); // the token stays neither in sight nor in the history
      await this.login(given.get("token"));
      return;
    }
    try {
      this.session = await getJson("/api/session");
    } catch (error) {
      this.leave();
      if (error instanceof Refused && error.status === 401) this.view("login");
      else {
        this.say("lost", "The server cannot be reached.");
        setTimeout(() => this.route(), 1000);
      }
      return;
    }
    const key = given.get("run");
    if (key || this.session.single) await this.enter(key ?? (await getJson("/api/runs"))[0].key);
    else {
      this.leave();
      await showRuns();
      this.view("runs");
    }
  }

  async login(token) {
    try {
      await post("/api/session", { token });
      $("login-answer").textContent = "";
      $("token").value = "";
      await this.route();
    } catch (error) {
      this.view("login");
      $("login-answer").textContent = error instanceof Refused ? `Not let in: ${error.message}.` : "The server cannot be reached.";
    }
  }

  view(name) {
    for (const other of VIEWS) $(other).hidden = other !== name;
    $("bar").hidden = $("timeline").hidden = name !== "print";
    if (name !== "print") this.say(null);
  }

  leave() {
    for (const channel of Object.values(this.channels)) channel.close();
    this.channels = {};
    this.run = null;
  }

  async enter(key) {
    this.leave();
    try {
      this.run = await getJson(`/api/runs/${key}`);
    } catch {
      location.hash = "";
      return;
    }
    this.view("print");
    $("to-runs").hidden = this.session.single;
    $("run-name").textContent = this.run.name;
    document.title = `${this.run.name} \u2013 vialight`;
    Object.assign(this, { message: null, receivedAt: performance.now(), changed: null, logCount: 0, isFetchingLog: false,
      hasMoment: false });
    for (const part of [this.projections, this.planes, this.surface, this.timeline, this.stop]) part.reset();
    this.camera.reset(this.run.camera);
    this.pattern.reset(this.run.projector);
    $("log").replaceChildren();
    this.results.show(this.run, true);
    this.curves.show([], this.run.speed_deg_s);
    this.getReference();
    for (const [name, take] of [["state", (message) => this.takeState(message)], ["images", (message) => this.takeImage(message)],
      ["surface", (message) => this.takeSurface(message)]]) {
      this.channels[name] = new Channel(`/ws/${key}/${name}`, take, (channel) => this.connectionChanged(channel));
    }
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
      await getJson("/api/session");
    } catch (error) {
      if (error instanceof Refused && error.status === 401 && this.run) {
        this.leave();
        this.view("login");
        $("login-answer").textContent = `${error.message}.`;
      }
    } finally {
      this.isAsking = false;
    }
  }

  takeState({ header }) {
    if (header.kind === "answer") {
      this.answers?.(header);
      return;
    }
    const wasLive = this.message?.live;
    this.message = header;
    this.receivedAt = performance.now();
    const { live, status } = header;
    this.stop.see(live, status);
    this.tellState();
    this.timeline.setLive(live);
    $("orders").hidden = !live;
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
    if (timeline.isFetching || (counts.moments === timeline.rows.length && counts.surfaces === timeline.surfaces.length)) return;
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
    if (header.kind === "camera") this.camera.show(message);
    else if (header.kind === "pattern") this.pattern.show(message);
    else if (header.kind === "reference") this.projections.show(message);
    else if (!this.timeline.isBack) {
      if (header.kind === "snapshot") {
        this.projections.show(message);
        this.planes.voxelMm = header.voxel_mm;
        this.snapshot = header;
      } else this.planes.show(arrays);
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
    this.planes.show(pictures.arrays, pictures.header.voxel_mm);
    this.curves.show(this.timeline.rows, run.speed_deg_s, this.timeline.cursorS);
    const surface = this.timeline.surfaceAt(row.number);
    if (this.wanted !== null || surface === null) return;
    const shape = await getBinary(`/api/runs/${run.key}/surfaces/${surface}`);
    if (this.run !== run || this.isLiveNow()) return;
    this.surface.show(shape);
    this.tellSurface(row);
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
    if ($("run-state").textContent !== text) $("run-state").textContent = text;
    $("run-state").dataset.state = state;
    const figures = live && status ? [
      ["Turn", number(status.turn, 1)], ["Elapsed", duration(status.time_s)], ["Light on", duration(status.lit_s)],
      ["Remaining", duration(status.remaining_s)],
    ] : this.ended();
    facts2($("figures"), figures);
    this.tellMachine(live ? status : null);
  }

  ended() {
    const last = this.timeline.rows[this.timeline.rows.length - 1];
    const placed = this.run.metrics.as_placed;
    return [["RMSE", millimetres(placed?.rmse_mm ?? last?.rmse_mm)], ["IoU", number(placed?.iou ?? last?.iou, 3)],
      ["Light on", duration(last?.lit_s)]];
  }

  tellMachine(status) {
    if (!status) {
      facts($("machine-facts"), [["State", "not running"]]);
      return;
    }
    const latency = this.snapshot ? `${number(this.snapshot.latency_s * 1000, 0)} ms from frame to snapshot` : NONE;
    const provisional = this.snapshot ? `${number(this.snapshot.provisional_share * 100, 0)} % of rays` : NONE;
    facts($("machine-facts"), [
      ["Frames", `${status.frames} recorded, ${status.missed} missed`, status.missed > 0.1 * status.frames ? "bad" : ""],
      ["Rate", this.snapshot ? `${number(this.snapshot.frame_rate_hz, 1)} frames/s` : NONE],
      ["Latency", latency],
      ["Older than a turn", provisional],
      ["Disk", `${bytes(status.disk_free_bytes)} free, lasts ${duration(status.disk_left_s)}`, status.disk_left_s < 600 ? "bad" : ""],
      ["Mode", status.mode],
      ...Object.entries(status.devices).map(([name, health]) => [name, health, health === "ok" ? "" : "bad"]),
    ]);
    const choice = document.querySelector(`input[name=mode][value="${CSS.escape(status.mode)}"]`);
    if (choice && !choice.checked && !this.isChanging) choice.checked = true;
  }

  // What is said when something is away or old; what is worst comes first.
  tellAge() {
    if (!this.run) return;
    const sinceS = (performance.now() - this.receivedAt) / 1000;
    const closed = Object.values(this.channels).find((channel) => !channel.isOpen);
    if (closed?.why) return this.say("lost", `No connection: ${closed.why}.`);
    if (sinceS > OLD_S) {
      const switchOff = this.message?.live ? " Stop may not get through: use the switch at the printer." : "";
      return this.say("lost", `No connection to the server for ${number(sinceS, 0)} s: what you see is old.${switchOff}`);
    }
    if (!this.message) return this.say(null);
    const { live, status, ages_s: ages } = this.message;
    if (!live && ["preflight", "background", "printing", "dark", "after", "finishing"].includes(this.run.state)) {
      return this.say("lost", "The process that prints has ended without finishing: check the printer. What it recorded is here.");
    }
    if (live && ages.status + sinceS > OLD_S) {
      return this.say("lost", `The print has said nothing for ${number(ages.status + sinceS, 0)} s: what you see is old.`);
    }
    if (live && ages.snapshot !== undefined && ages.snapshot + sinceS > OLD_S && ["printing", "dark", "after"].includes(status?.state)) {
      return this.say("warn", `The pictures are ${number(ages.snapshot + sinceS, 0)} s old; the print itself goes on.`);
    }
    if (live && this.timeline.isBack) {
      return this.say("note", "You are looking back; the print goes on. \u201cNewest\u201d returns to it.");
    }
    return this.say(null);
  }

  say(level, text = "") {
    const banner = $("banner");
    banner.hidden = level === null;
    if (level !== null) banner.dataset.level = level;
    if (banner.textContent !== text) banner.textContent = text;
  }

  order(order) {
    this.orderNumber += 1;
    return this.channels.state?.send({ order, id: this.orderNumber });
  }

  async ask(order, done) {
    this.isChanging = true;
    $("order-answer").textContent = "\u2026";
    try {
      await post(`/api/runs/${this.run.key}/orders`, order);
      $("order-answer").textContent = done;
    } catch (error) {
      $("order-answer").textContent = error instanceof Refused ? error.message : "The server cannot be reached.";
    } finally {
      this.isChanging = false;
    }
  }

  redraw() {
    if (!this.run) return;
    this.projections.redraw();
    this.planes.redraw();
    this.camera.redraw();
    this.pattern.redraw();
    this.surface.paint?.();
    this.curves.show(this.timeline.rows, this.run.speed_deg_s, this.timeline.cursorS);
  }
}

function facts2(list, rows) {
  const items = rows.map(([term, text]) => element("div", {}, element("dt", { textContent: term }), element("dd", { textContent: text })));
  list.replaceChildren(...items);
}

function logLine(event) {
  const { time_s: time, event: name, message, wall_s: _, ...rest } = event;
  const details = Object.entries(rest).map(([key, value]) => `${key} ${typeof value === "object" ? JSON.stringify(value) : value}`).join(", ");
  const text = [name, message, details].filter(Boolean).join(": ");
  return element("li", {}, element("span", { textContent: time === undefined ? "" : `${number(time, 1)} s` }),
    element("span", { textContent: text }));
}

new Page().route();
