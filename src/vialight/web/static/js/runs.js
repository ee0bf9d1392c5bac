// The list of runs, and the results of a finished one.

import { getJson, post } from "./connection.js";
import { $, NONE, STATES, element, facts, millimetres, number } from "./text.js";

export async function showRuns() {
  const runs = await getJson("/api/runs");
  $("runs-empty").hidden = runs.length > 0;
  $("runs-list").replaceChildren(...runs.map(card));
}

function card(run) {
  const picture = run.has_thumbnail
    ? element("img", { src: `/api/runs/${run.key}/thumbnail`, alt: `The print ${run.name}`, loading: "lazy" })
    : element("span", { className: "no-picture", textContent: "no picture yet" });
  const state = element("p", { textContent: STATES[run.state] ?? run.state });
  state.dataset.state = run.state;
  const results = [run.rmse_mm == null ? null : `RMSE ${millimetres(run.rmse_mm)}`,
    run.iou == null ? null : `IoU ${number(run.iou, 3)}`,
    run.passed == null ? null : run.passed ? "within tolerance" : "out of tolerance"].filter(Boolean).join(", ");
  const link = element("a", { href: `#run=${run.key}` }, picture, element("strong", { textContent: run.name }),
    element("p", { textContent: run.part ?? "" }), state, element("p", { textContent: results }),
    ...(run.fault ? [element("p", { className: "fault", textContent: `Cannot be read: ${run.fault}` })] : []),
    element("p", { textContent: new Date(run.started).toLocaleString("en-GB") }));
  return element("li", {}, link);
}

const FILES = { "report.html": "Report, to keep", "surface.stl": "Surface, STL", "deviation.ply": "Deviation, PLY",
  "reference.stl": "Reference, STL", "metrics.json": "Metrics, JSON", "reconstruction.json": "Reconstruction, JSON",
  "run.json": "Run, JSON", "log.jsonl": "Log, JSON lines" };

export class Results {
  constructor() {
    $("timelapse-button").addEventListener("click", () => this.makeTimelapse());
  }

  show(run, isLive) {
    this.run = run;
    clearTimeout(this.timer);
    const placed = run.metrics.as_placed;
    $("results").hidden = isLive && !placed;
    const rows = placed ? [
      ["RMSE, print to reference", millimetres(placed.rmse_mm)],
      ["RMSE, reference to print", millimetres(placed.reverse_rmse_mm)],
      ["IoU", number(placed.iou, 3)],
      ["Volume error", placed.volume_error_percent == null ? NONE : `${number(placed.volume_error_percent, 1)} %`],
    ] : [["Measured", isLive ? "not yet" : "nothing: there is no surface"]];
    facts($("results-numbers"), rows);
    const files = run.files.filter((name) => FILES[name]).map((name) => element("a", {
      href: `/api/runs/${run.key}/files/${name}`, textContent: FILES[name] }));
    const report = run.files.includes("report.html") ? [element("a", {
      href: `/api/runs/${run.key}/report`, target: "_blank", rel: "noopener", textContent: "Open the report" })] : [];
    $("results-links").replaceChildren(...report, ...files);
    $("timelapse-button").hidden = run.surfaces < 2;
    $("timelapse-answer").textContent = "";
    if (run.surfaces >= 2) this.askTimelapse();
  }

  path() {
    return `/api/runs/${this.run.key}/timelapse`;
  }

  async makeTimelapse() {
    try {
      this.tell(await post(this.path()));
    } catch (error) {
      $("timelapse-answer").textContent = error.message;
    }
  }

  async askTimelapse() {
    try {
      this.tell(await getJson(this.path()));
    } catch { /* the banner tells that the server is away */ }
  }

  tell(state) {
    const answer = $("timelapse-answer");
    if (state.state === "drawing") {
      answer.textContent = state.total ? `drawing, ${state.done} of ${state.total}` : "drawing";
      this.timer = setTimeout(() => this.askTimelapse(), 700);
    } else if (state.state === "failed") answer.textContent = state.error;
    else if (state.state === "done") {
      answer.replaceChildren(element("a", { href: `${this.path()}.mp4`, textContent: "Time-lapse, MP4" }));
    }
  }
}
