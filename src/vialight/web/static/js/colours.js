// Colour maps that stay apart for colour-blind people: cividis for amounts, blue-white-red for deviations.

// Every fifth of the 256 colours of cividis (Nunez, Anderton, Renslow 2018), as Matplotlib has them.
const CIVIDIS = ("00224e002656002a5f002d68003070083370163770203a6f273e6e2e416d34456c3a486c3f4c6c444f6c49536c4e566c535a6d575d6d" +
  "5c616e60646f656870696b716d6f727272747676767a7a787e7d788381798885788d8878928c789690779b9476a09875a59c74aaa073" +
  "afa471b5a86fbaac6dbfb06bc4b468c9b965cfbd62d4c15fdac65bdfca57e5cf52ead34cf0d846f6dd3ffce236fee838")
  .match(/.{6}/g).map((colour) => [0, 2, 4].map((at) => parseInt(colour.slice(at, at + 2), 16)));
// The same stops as in vialight/report/colours.py.
const DEVIATION = [[24, 52, 148], [92, 134, 226], [255, 255, 255], [235, 112, 92], [160, 16, 32]];

function ramp(stops) {
  const colours = new Uint8ClampedArray(256 * 3);
  for (let level = 0; level < 256; level += 1) {
    const place = level / 255 * (stops.length - 1);
    const below = Math.min(Math.floor(place), stops.length - 2);
    for (let channel = 0; channel < 3; channel += 1) {
      const [from, to] = [stops[below][channel], stops[below + 1][channel]];
      colours[3 * level + channel] = from + (to - from) * (place - below);
    }
  }
  return colours;
}

export const cividis = ramp(CIVIDIS);
export const deviation = ramp(DEVIATION);
export const grey = ramp([[0, 0, 0], [255, 255, 255]]);

// The next of 1, 2 or 5 times a power of ten.
export function roundUp(value) {
  if (!(value > 0)) return 1e-3;
  const power = 10 ** Math.floor(Math.log10(value) + 1e-9);
  return [1, 2, 5, 10].map((step) => step * power).find((step) => step >= value * (1 - 1e-9));
}

// The same in finer steps, for amounts: a picture should use most of its colours.
export function roundUpFinely(value) {
  if (!(value > 0)) return 1e-3;
  const power = 10 ** Math.floor(Math.log10(value) + 1e-9);
  return [1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10].map((step) => step * power).find((step) => step >= value * (1 - 1e-9));
}

// A colour bar with its ends named.
export function drawRamp(canvas, colours, low, high, unit) {
  const { context, width, height } = fit(canvas);
  context.clearRect(0, 0, width, height);
  for (let x = 0; x < width; x += 1) {
    const level = 3 * Math.round(x / Math.max(width - 1, 1) * 255);
    context.fillStyle = `rgb(${colours[level]} ${colours[level + 1]} ${colours[level + 2]})`;
    context.fillRect(x, 0, 1.5, 10);
  }
  context.font = "12px system-ui, 'DejaVu Sans', sans-serif";
  context.fillStyle = "#9aa5b8";
  context.textBaseline = "top";
  context.textAlign = "left";
  context.fillText(low, 0, 14);
  context.textAlign = "right";
  context.fillText(high, width, 14);
  context.textAlign = "center";
  context.fillText(unit, width / 2, 14);
}

// Match a canvas to its place on the screen; drawing is then in CSS pixels.  Small pictures that change often are drawn
// by the processor: the graphics processor has the surface to draw.
export function fit(canvas) {
  const scale = window.devicePixelRatio || 1;
  const width = canvas.clientWidth || 1;
  const height = canvas.clientHeight || 1;
  if (canvas.width !== Math.round(width * scale) || canvas.height !== Math.round(height * scale)) {
    canvas.width = Math.round(width * scale);
    canvas.height = Math.round(height * scale);
  }
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.setTransform(scale, 0, 0, scale, 0, 0);
  return { context, width, height };
}
