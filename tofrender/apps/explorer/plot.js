/** Curves over path length with axes in meters and nanoseconds, and phasors in their plane. */

import { SPEED_OF_LIGHT } from "./recording.js";
import { raised, signed } from "./words.js";

/** Okabe and Ito's colors that show on white and on black, and dashes for those who see none. */
export const STYLES = [
  { color: "#0072b2", dark: "#56b4e9", dash: [] },
  { color: "#d55e00", dark: "#e69f00", dash: [7, 3] },
  { color: "#009e73", dark: "#2cc295", dash: [2, 3] },
  { color: "#b3558c", dark: "#dd8fb8", dash: [9, 3, 2, 3] },
  { color: "#8a6d00", dark: "#f0e442", dash: [5, 2] },
  { color: "#555555", dark: "#c8c8c8", dash: [1, 2] },
];

export function colorOf(k, dark) {
  return dark ? STYLES[k].dark : STYLES[k].color;
}

const MARGIN = { left: 64, right: 14, top: 40, bottom: 38 };
const DECADES = 4; // of a logarithmic axis
const FONT = "12px system-ui, sans-serif";

/** Numbers with one, two or five in front that cut a range into about `count` parts. */
export function ticks(low, high, count) {
  const rough = (high - low) / Math.max(1, count);
  if (!(rough > 0)) return [low];
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((factor) => factor * power >= rough);
  const found = [];
  for (let k = Math.ceil(low / step); k * step <= high * (1 + 1e-12); k++) found.push(k * step);
  return found;
}

/** Where bins lie on a plot's canvas. */
export class Axes {
  constructor(canvas, { start, width, count }) {
    const { clientWidth, clientHeight } = canvas;
    this.left = MARGIN.left;
    this.right = Math.max(clientWidth - MARGIN.right, this.left + 1);
    this.top = MARGIN.top;
    this.bottom = clientHeight - MARGIN.bottom;
    Object.assign(this, { start, width, count });
    this.stop = start + count * width;
  }

  x(opl) {
    return this.left + ((opl - this.start) / (this.stop - this.start)) * (this.right - this.left);
  }

  /** The path length at a place, which may be out of range. */
  opl(x) {
    return this.start + ((x - this.left) / (this.right - this.left)) * (this.stop - this.start);
  }

  /** The bin at a place, the nearest one if it is out of range. */
  bin(x) {
    const bin = Math.floor((this.opl(x) - this.start) / this.width);
    return Math.max(0, Math.min(this.count - 1, bin));
  }
}

/**
 * Draw responses.
 *
 * @param curves {values, errors, style, faint, dots} each; `style` is an index of STYLES.
 * @param marks {bin} or {gate: {first, count}}: what is shown now.
 * @param words {quantity, below, above}: titles of axes; `below` counts in ns unless `inMeters`.
 * @param range of values, if it is known beforehand.
 */
export function drawCurves(canvas, axis, curves, marks, words, { log, range, dark, ink }) {
  const pen = sharp(canvas);
  const axes = new Axes(canvas, axis);
  const extreme = (of) => curves.reduce((most, { values }) => values.reduce((a, b) => of(a, b || 0), most), 0);
  const top = (extreme(Math.max) || (extreme(Math.min) ? 0 : 1)) * (log ? 2 : 1.06);
  const [low, high] = range ?? [log ? top / 10 ** DECADES : 1.06 * extreme(Math.min), top];
  const y = (value) => {
    const part = log ? Math.log(Math.max(value, low) / low) / Math.log(high / low) : (value - low) / (high - low);
    return axes.bottom - part * (axes.bottom - axes.top);
  };
  drawMarks(pen, axes, marks, ink);
  drawGrid(pen, axes, y, { low, high, log }, words, ink);
  pen.save();
  pen.beginPath();
  pen.rect(axes.left, axes.top - 2, axes.right - axes.left, axes.bottom - axes.top + 3);
  pen.clip();
  for (const curve of curves) drawCurve(pen, axes, y, curve, dark);
  pen.restore();
}

/** Draw an image over path length and what lies between `low` and `high`. */
export function drawMap(canvas, axis, { low, high }, image, words, ink) {
  const pen = sharp(canvas);
  const axes = new Axes(canvas, axis);
  const tall = axes.bottom - axes.top;
  drawGrid(pen, axes, (value) => axes.bottom - ((value - low) / (high - low)) * tall, { low, high }, words, ink);
  pen.imageSmoothingEnabled = false;
  pen.drawImage(image, axes.left, axes.top, axes.right - axes.left, tall);
}

/** How many columns and rows of dots a map has in a canvas. */
export function dotsOf(canvas) {
  const ratio = globalThis.devicePixelRatio || 1;
  const axes = new Axes(canvas, { start: 0, width: 1, count: 1 });
  return [axes.right - axes.left, axes.bottom - axes.top].map((size) => Math.max(1, Math.floor(ratio * size)));
}

function drawMarks(pen, axes, { bin, gate }, ink) {
  const edge = (k) => axes.x(axes.start + k * axes.width);
  if (gate) {
    const [left, right] = [edge(gate.first), edge(gate.first + gate.count)];
    pen.fillStyle = ink.band;
    pen.fillRect(left, axes.top, right - left, axes.bottom - axes.top);
    pen.fillStyle = ink.accent;
    for (const x of [left, right]) {
      pen.fillRect(x - 1, axes.top, 2, axes.bottom - axes.top);
      pen.fillRect(x - 3, (axes.top + axes.bottom) / 2 - 12, 6, 24);
    }
  } else if (bin !== undefined) {
    const x = edge(bin + 0.5);
    pen.fillStyle = ink.accent;
    pen.fillRect(x - 0.75, axes.top, 1.5, axes.bottom - axes.top);
    pen.beginPath();
    pen.moveTo(x - 5, axes.top - 6);
    pen.lineTo(x + 5, axes.top - 6);
    pen.lineTo(x, axes.top + 1);
    pen.fill();
  }
}

function drawGrid(pen, axes, y, { low, high, log }, words, ink) {
  const rows = log ? decades(low, high) : ticks(low, high, 4);
  const most = Math.max(high, -low);
  const power = log || (most >= 0.1 && most < 1e4) ? 0 : 3 * Math.floor(Math.log10(most) / 3);
  pen.lineWidth = 1;
  pen.strokeStyle = ink.grid;
  pen.fillStyle = ink.soft;
  pen.textAlign = "right";
  pen.textBaseline = "middle";
  for (const value of rows) {
    line(pen, axes.left, y(value), axes.right, y(value));
    const text = log ? `10${raised(Math.log10(value))}` : plain(value / 10 ** power);
    pen.fillText(text, axes.left - 7, y(value));
  }
  pen.strokeStyle = ink.line;
  line(pen, axes.left, axes.bottom, axes.right, axes.bottom);
  if (low < 0) line(pen, axes.left, y(0), axes.right, y(0));
  line(pen, axes.left, axes.top, axes.right, axes.top);
  pen.textAlign = "center";
  const count = (axes.right - axes.left) / 90;
  const nanoseconds = 1e9 / SPEED_OF_LIGHT;
  const below = words.inMeters ? 1 : nanoseconds;
  pen.textBaseline = "top";
  for (const value of ticks(axes.start * below, axes.stop * below, count)) {
    line(pen, axes.x(value / below), axes.bottom, axes.x(value / below), axes.bottom + 4);
    pen.fillText(plain(value), axes.x(value / below), axes.bottom + 6);
  }
  pen.fillText(words.below, (axes.left + axes.right) / 2, axes.bottom + 22);
  if (words.above) {
    pen.textBaseline = "bottom";
    for (const value of ticks(axes.start, axes.stop, count)) {
      line(pen, axes.x(value), axes.top, axes.x(value), axes.top - 4);
      pen.fillText(plain(value), axes.x(value), axes.top - 6);
    }
    pen.fillText(words.above, (axes.left + axes.right) / 2, axes.top - 22);
  }
  pen.save();
  pen.translate(13, (axes.top + axes.bottom) / 2);
  pen.rotate(-Math.PI / 2);
  pen.textBaseline = "middle";
  pen.fillText(power ? words.quantity.replace("[", `[10${raised(power)} `) : words.quantity, 0, 0);
  pen.restore();
}

function drawCurve(pen, axes, y, { values, errors, style, faint, dots }, dark) {
  pen.strokeStyle = pen.fillStyle = colorOf(style, dark);
  const middle = (bin) => axes.x(axes.start + (bin + 0.5) * axes.width);
  if (errors) drawErrors(pen, middle, y, values, errors);
  if (dots) return values.forEach((value, bin) => pen.fillRect(middle(bin) - 1.5, y(value) - 1.5, 3, 3));
  pen.globalAlpha = faint ? 0.75 : 1;
  pen.lineWidth = faint ? 1 : 1.75;
  pen.lineJoin = "round";
  pen.setLineDash(faint ? faint : STYLES[style].dash);
  pen.beginPath();
  values.forEach((value, bin) => {
    if (!Number.isFinite(value)) return;
    const [before, after] = [values[bin - 1], values[bin + 1]].map(Number.isFinite);
    if (before) pen.lineTo(middle(bin), y(value));
    else pen.moveTo(middle(bin), y(value));
    if (!before && !after) pen.fillRect(middle(bin) - 2.5, y(value) - 2.5, 5, 5);
  });
  pen.stroke();
  pen.setLineDash([]);
  pen.globalAlpha = 1;
}

/** One standard error up and down: bars where they have room, else a band. */
function drawErrors(pen, middle, y, values, errors) {
  const spacing = middle(1) - middle(0);
  pen.lineWidth = 1;
  if (spacing >= 5) {
    pen.globalAlpha = 0.8;
    values.forEach((value, bin) => {
      if (!errors[bin]) return;
      const [x, high, low] = [middle(bin), y(value + errors[bin]), y(value - errors[bin])];
      line(pen, x, high, x, low);
      line(pen, x - 2, high, x + 2, high);
      line(pen, x - 2, low, x + 2, low);
    });
  } else {
    pen.globalAlpha = 0.25;
    pen.beginPath();
    values.forEach((value, bin) => pen.lineTo(middle(bin), y(value + errors[bin])));
    for (let bin = values.length - 1; bin >= 0; bin--) {
      pen.lineTo(middle(bin), y(values[bin] - errors[bin]));
    }
    pen.fill();
  }
  pen.globalAlpha = 1;
}

/** Draw phasors {re, im, style} as arrows in a circle as large as the longest of them. */
export function drawPhasors(canvas, phasors, { dark, ink }) {
  const pen = sharp(canvas);
  const { clientWidth: width, clientHeight: height } = canvas;
  const radius = Math.min(width, height) / 2 - 20;
  const [x, y] = [width / 2, height / 2];
  pen.strokeStyle = ink.grid;
  for (const part of [0.5, 1]) {
    pen.beginPath();
    pen.arc(x, y, part * radius, 0, 2 * Math.PI);
    pen.stroke();
  }
  line(pen, x - radius, y, x + radius, y);
  line(pen, x, y - radius, x, y + radius);
  pen.fillStyle = ink.soft;
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  pen.fillText("I", x + radius + 10, y);
  pen.fillText("Q", x, y - radius - 10);
  const longest = Math.max(...phasors.map(({ amplitude }) => amplitude), 0) || 1;
  for (const { amplitude, phase, style } of phasors) {
    const length = (amplitude / longest) * radius;
    const tip = [x + length * Math.cos(phase), y - length * Math.sin(phase)];
    pen.strokeStyle = pen.fillStyle = colorOf(style, dark);
    pen.lineWidth = 2;
    pen.setLineDash(STYLES[style].dash);
    line(pen, x, y, ...tip);
    pen.setLineDash([]);
    pen.beginPath();
    pen.arc(...tip, 4, 0, 2 * Math.PI);
    pen.fill();
  }
}

/** A canvas as fine as the screen, wiped. */
export function sharp(canvas) {
  const ratio = globalThis.devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth * ratio, canvas.clientHeight * ratio].map(Math.round);
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  pen.font = FONT;
  return pen;
}

function line(pen, x0, y0, x1, y1) {
  pen.beginPath();
  pen.moveTo(x0, y0);
  pen.lineTo(x1, y1);
  pen.stroke();
}

function decades(low, high) {
  const found = [];
  for (let k = Math.ceil(Math.log10(low)); 10 ** k <= high; k++) found.push(10 ** k);
  return found;
}

function plain(value) {
  return signed(Number(value.toPrecision(6)));
}
