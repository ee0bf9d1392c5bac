// The page's frame: who may see it, the list of runs, and one run.

import { Refused, getJson, post } from "./connection.js";
import { say } from "./freshness.js";
import { PrintPage } from "./print.js";
import { showRuns } from "./runs.js";
import { $ } from "./text.js";

const VIEWS = ["login", "runs", "print"];

class Frame {
  constructor() {
    this.print = new PrintPage((why) => this.lockedOut(`${why}.`));
    window.addEventListener("hashchange", () => this.route());
    $("to-runs").addEventListener("click", () => { location.hash = ""; });
    $("login-form").addEventListener("submit", (event) => {
      event.preventDefault();
      this.login($("token").value.trim());
    });
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
      const session = await getJson("/api/session");
      if (given.has("run") || session.single) await this.enter(given.get("run"), session);
      else await this.list();
    } catch (error) {
      this.print.leave();
      if (error instanceof Refused && error.status === 401) this.view("login");
      else if (error instanceof Refused) location.hash = ""; // no such run (any more)
      else {
        say("lost", "The server cannot be reached.");
        setTimeout(() => this.route(), 1000);
      }
    }
  }

  async enter(key, session) {
    const run = await getJson(`/api/runs/${encodeURIComponent(key ?? (await getJson("/api/runs"))[0].key)}`);
    this.view("print");
    $("to-runs").hidden = session.single;
    this.print.enter(run, session.stop_port);
  }

  async list() {
    this.print.leave();
    await showRuns();
    this.view("runs");
    document.title = "Runs \u2013 vialight";
  }

  async login(token) {
    try {
      await post("/api/session", { token });
      $("login-answer").textContent = "";
      $("token").value = "";
      await this.route();
    } catch (error) {
      this.lockedOut(error instanceof Refused ? `Not let in: ${error.message}.` : "The server cannot be reached.");
    }
  }

  lockedOut(why) {
    this.print.leave();
    this.view("login");
    $("login-answer").textContent = why;
  }

  view(name) {
    for (const other of VIEWS) $(other).hidden = other !== name;
    $("bar").hidden = $("timeline").hidden = name !== "print";
    say(null);
  }
}

new Frame().route();
