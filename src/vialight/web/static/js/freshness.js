// What is said when something is away or old; what is worst comes first.

import { $, number } from "./text.js";

const OLD_S = 1;
const LOOK_MS = 200;
const INTERRUPTED = "interrupted";
const PICTURED = ["printing", "dark", "after"];

export function say(level, text = "") {
  const banner = $("banner");
  banner.hidden = level === null;
  if (level !== null) banner.dataset.level = level;
  if (banner.textContent !== text) banner.textContent = text;
}

export class Freshness {
  // `page` has the newest message, when it came, the channels and the timeline.
  constructor(page) {
    this.page = page;
    setInterval(() => {
      if (page.run) say(...this.verdict());
    }, LOOK_MS);
  }

  verdict() {
    const { channels, message, receivedAt, run, timeline } = this.page;
    const sinceS = (performance.now() - receivedAt) / 1000;
    const refused = Object.values(channels).find((channel) => !channel.isOpen && channel.why);
    if (refused) return ["lost", `No connection: ${refused.why}.`];
    if (sinceS > OLD_S) {
      const switchOff = message?.live ? " Stop may not get through: use the switch at the printer." : "";
      return ["lost", `No connection to the server for ${number(sinceS, 0)} s: what you see is old.${switchOff}`];
    }
    if (!message) return [null];
    if (message.unsure) return ["lost", `What you see may be old: ${message.unsure}.`];
    if (message.fault && !message.live) return ["warn", `Some of this run is not shown: ${message.fault}.`];
    return message.live ? this.ofLive(message, sinceS, timeline) : this.ofOver(run);
  }

  ofLive({ status, ages_s: ages }, sinceS, timeline) {
    if (ages.status + sinceS > OLD_S) {
      const text = `The print has said nothing for ${number(ages.status + sinceS, 0)} s: what you see is old.`;
      return ["lost", text];
    }
    if (ages.snapshot + sinceS > OLD_S && PICTURED.includes(status?.state)) {
      return ["warn", `The pictures are ${number(ages.snapshot + sinceS, 0)} s old; the print itself goes on.`];
    }
    if (timeline.isBack) {
      return ["note", "You are looking back; the print goes on. \u201cBack to live\u201d returns to it."];
    }
    return [null];
  }

  ofOver(run) {
    if (run.state === INTERRUPTED) {
      const text = "The process that prints has ended without finishing: check the printer. What it recorded is here.";
      return ["lost", text];
    }
    return run.fault ? ["warn", `Some of this run cannot be read: ${run.fault}.`] : [null];
  }
}
