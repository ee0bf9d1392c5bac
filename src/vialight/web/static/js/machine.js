// How the machine is doing, and the mode that it works in.

import { $, NONE, bytes, duration, facts, number } from "./text.js";

const SHORT_OF_DISK_S = 600;
const MISSED_SHARE = 0.1;

// Rows about the calibration: nothing where there is no doubt of it.
function doubts(told = []) {
  return told.map((doubt) => ["Doubtful", doubt, "bad"]);
}

export class Machine {
  // `status` is what the print reports; null where none runs: then `printed` is what the run says of its print.
  show(status, printed) {
    if (!status) {
      facts($("machine-facts"), [
        ["Frames", printed.frames === undefined ? NONE : `${printed.frames} recorded, ${printed.frames_missed} missed`],
        ["Light was on", `${duration(printed.lit_s)}, ${number(printed.lit_turns, 1)} turns`],
        ["Ended by", printed.ended_by ?? NONE],
        ["Fault", printed.fault ?? "none"],
        ...doubts(printed.doubts),
      ]);
      return;
    }
    const { snapshot } = this;
    const { frames, missed, disk_free_bytes: free, disk_left_s: left } = status;
    facts($("machine-facts"), [
      ["Frames", `${frames} recorded, ${missed} missed`, missed > MISSED_SHARE * frames ? "bad" : ""],
      ["Rate", snapshot ? `${number(snapshot.frame_rate_hz, 1)} frames/s` : NONE],
      ["Latency", snapshot?.latency_s != null ? `${number(snapshot.latency_s * 1000, 0)} ms from frame to snapshot` : NONE],
      ["Older than a turn", snapshot ? `${number(snapshot.provisional_share * 100, 0)} % of rays` : NONE],
      ["Disk", `${bytes(free)} free, lasts ${duration(left)}`, left !== null && left < SHORT_OF_DISK_S ? "bad" : ""],
      ["Mode", status.mode],
      ...doubts(status.doubts),
      ...Object.entries(status.devices).map(([name, health]) => [name, health, health === "ok" ? "" : "bad"]),
    ]);
    const choice = document.querySelector(`input[name=mode][value="${CSS.escape(status.mode)}"]`);
    if (choice && !choice.checked && !this.isChanging) choice.checked = true;
  }
}
