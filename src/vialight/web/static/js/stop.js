// Stop: one press, by three ways at once, and not done before the print itself says that the projector shows black.

import { Refused, post } from "./connection.js";
import { $, number } from "./text.js";

const AGAIN_MS = 400;
const GIVE_UP_MS = 10000;
const CANNOT_TELL = 503;

export class Stop {
  // `order(order)` sends by the socket; `paths()` is where the plain requests go: the page's port and Stop's own.
  constructor(order, paths) {
    Object.assign(this, { order, paths, pressedAt: null });
    this.button = $("stop-button");
    this.answer = $("stop-answer");
    this.button.addEventListener("click", () => this.press());
  }

  reset() {
    this.pressedAt = null;
    this.isAnswered = false;
    clearInterval(this.timer);
    this.answer.textContent = "";
    this.button.textContent = "Stop";
    delete this.button.dataset.state;
  }

  press() {
    if (this.pressedAt !== null && !this.isConfirmed) return this.send();
    this.pressedAt = performance.now();
    this.isConfirmed = false;
    this.isAnswered = false;
    this.fault = "";
    this.button.textContent = "Stopping\u2026";
    this.answer.textContent = "";
    this.send();
    clearInterval(this.timer);
    this.timer = setInterval(() => this.again(), AGAIN_MS);
    return undefined;
  }

  send() {
    this.order({ do: "stop" });
    const pressed = this.pressedAt;
    const presses = this.paths().map((path) => post(path, undefined, 3000));
    Promise.any(presses).then(() => {
      if (pressed === this.pressedAt) this.isAnswered = true;
    }, ({ errors }) => {
      // What the server says is told before what the network does; that nothing is known before that nothing runs.
      const refused = errors.filter((error) => error instanceof Refused);
      const worst = refused.find((error) => error.status === CANNOT_TELL) ?? refused[0];
      this.fault = worst?.message ?? "the server cannot be reached";
    });
  }

  // A stop that was not confirmed is sent again, and said to be open.
  again() {
    const sinceMs = performance.now() - this.pressedAt;
    if (sinceMs < 900) return;
    if (!this.isAnswered) this.send();
    const why = this.fault || "the projector still shows light";
    this.answer.textContent = `Not confirmed for ${number(sinceMs / 1000, 0)} s: ${why}. If in doubt, switch off at the printer.`;
    if (sinceMs > GIVE_UP_MS) {
      clearInterval(this.timer);
      this.button.textContent = "Stop";
      this.pressedAt = null;
    }
  }

  // `status` is what the print reports; null where it is over.  While it cannot be told whether it is, Stop stays.
  see(isLive, status, isUnsure) {
    if (isUnsure) {
      this.button.disabled = false;
      if (this.pressedAt === null) this.button.textContent = "Stop";
      return;
    }
    this.button.disabled = !isLive;
    const isBlack = !isLive || (status !== null && status.pattern === null && status.state !== "printing");
    const isObeyed = this.isAnswered || !isLive || ["after", "finishing"].includes(status?.state);
    if (this.pressedAt !== null && !this.isConfirmed && isBlack && isObeyed) {
      this.isConfirmed = true;
      clearInterval(this.timer);
      const seconds = (performance.now() - this.pressedAt) / 1000;
      performance.mark("stopped", { detail: { seconds } });
      this.button.textContent = "Stopped";
      this.button.dataset.state = "confirmed";
      this.answer.textContent = `The projector shows black, ${number(seconds)} s after the press.`;
    }
    if (this.pressedAt === null) this.button.textContent = isLive ? "Stop" : "Not printing";
    if (!isLive && this.isConfirmed) this.button.textContent = "Stopped";
    if (this.isConfirmed && isLive && status?.pattern != null) this.reset(); // printing again, by an extension
  }
}
