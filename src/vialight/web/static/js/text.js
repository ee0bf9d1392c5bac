// Words and numbers for people.  Everything that comes from files is put in as text, never as markup.

export const $ = (id) => document.getElementById(id);

export function element(name, properties = {}, ...children) {
  const made = document.createElement(name);
  Object.assign(made, properties);
  made.append(...children);
  return made;
}

const MINUS = "\u2212";
export const NONE = "\u2013";

export function number(value, digits = 2) {
  if (value === null || value === undefined || !Number.isFinite(value)) return NONE;
  return value.toFixed(digits).replace("-", MINUS);
}

export function signed(value, digits = 3) {
  return (value > 0 ? "+" : "") + number(value, digits);
}

export function millimetres(value) {
  return value === null || value === undefined ? NONE : `${number(value, Math.abs(value) < 0.1 ? 3 : 2)} mm`;
}

export function duration(seconds) {
  if (seconds === null || seconds === undefined || !Number.isFinite(seconds)) return NONE;
  const whole = Math.max(0, Math.round(seconds));
  if (whole < 60) return `${whole} s`;
  const [hours, minutes] = [Math.floor(whole / 3600), Math.floor(whole % 3600 / 60)];
  return hours ? `${hours} h ${minutes} min` : `${minutes} min ${String(whole % 60).padStart(2, "0")} s`;
}

export function bytes(count) {
  if (count === null || count === undefined) return NONE;
  return count >= 1e9 ? `${number(count / 1e9, 1)} GB` : `${number(count / 1e6, 0)} MB`;
}

export const STATES = {
  preflight: "Checking the machine", background: "Recording the background", printing: "Printing",
  dark: "Light held off by a fault", after: "Light off, watching what still cures", finishing: "Finishing",
  replay: "Replaying a recording", done: "Done", failed: "Failed", unknown: "No state recorded",
  interrupted: "Interrupted: its process has ended without finishing", unreadable: "Cannot be read",
  uncertain: "It cannot be told whether it is printing",
};

// A list of terms; rows are [term, text] or [term, text, "bad"].
export function facts(list, rows) {
  while (list.children.length > 2 * rows.length) list.lastChild.remove();
  while (list.children.length < 2 * rows.length) list.append(element(list.children.length % 2 ? "dd" : "dt"));
  rows.forEach(([term, text, level = ""], index) => {
    write(list.children[2 * index], term);
    const value = list.children[2 * index + 1];
    write(value, text);
    if ((value.dataset.level ?? "") !== level) value.dataset.level = level;
  });
}

// Change a text only where it differs: what is written again is laid out again.
export function write(target, text) {
  if (target.textContent !== text) target.textContent = text;
}
