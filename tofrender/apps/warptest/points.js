/**
 * Points of a warp and the grid that it bends, in the plane or on the sphere.
 *
 * Data: `points` and `lines`, float32 with one coordinate after the other (NaN ends a line), and
 * their domain: `dimensions`, `low`, `high`, `labels`, `down`, `upper_only`, `alt`. Directions in 2D
 * have the azimuth to the right and the cosine of the polar angle upwards.
 */

import { colorOf, sharp, ticks } from "../explorer/plot.js";
import { clamp, signed } from "../explorer/words.js";
import { follow, inkOf, isDark } from "../ui/parts.js";

const TURN = [-0.6, 0.42]; // azimuth and elevation of the view [rad]
const KEYS = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] };
const ANGLES = ["−π", "−π/2", "0", "π/2", "π"].map((text, k) => [(k / 2 - 1) * Math.PI, text]);

export class Points {
  constructor(canvas, redraw) {
    this.canvas = canvas;
    this.turn = [...TURN];
    const move = (dx, dy) => {
      const [azimuth, elevation] = this.turn;
      this.turn = [azimuth + dx, clamp(elevation + dy, -Math.PI / 2, Math.PI / 2)];
      redraw();
    };
    follow(canvas, {
      down: (event) => this.shown?.solid && { at: [event.clientX, event.clientY] },
      move: (event, held) => {
        move(0.01 * (event.clientX - held.at[0]), 0.01 * (event.clientY - held.at[1]));
        held.at = [event.clientX, event.clientY];
      },
    });
    canvas.addEventListener("dblclick", () => {
      this.turn = [...TURN];
      redraw();
    });
    canvas.addEventListener("keydown", (event) => {
      if (!this.shown?.solid || !(event.key in KEYS)) return;
      move(...KEYS[event.key]);
      event.preventDefault();
    });
  }

  /** Draw data; `shown` is {points, grid, solid}. */
  draw(data, shown) {
    const { canvas } = this;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (width < 10 || height < 10) return;
    this.shown = shown;
    this.pen = sharp(canvas);
    this.ink = inkOf(canvas);
    this.pen.fillStyle = this.ink.text;
    const colors = [0, 1].map((k) => colorOf(k, isDark(canvas)));
    const points = columns(data.points, data.dimensions);
    const lines = columns(data.lines, data.dimensions);
    canvas.style.cursor = shown.solid ? "grab" : "default";
    canvas.setAttribute("aria-label", data.alt);
    Object.assign(canvas.dataset, {
      count: points[0].length,
      view: shown.solid ? "3D" : "2D",
      grid: shown.grid ? lines[0].length : 0,
      first: points.map((axis) => axis[0]?.toPrecision(5) ?? "").join(" "),
    });
    const seen = shown.solid ? this.sphere(data, width, height) : this.plane(data, width, height);
    const places = ([x, y, z]) => Array.from(x, (each, i) => seen.project(each, y[i], z?.[i]));
    const [dots, grid] = [shown.points ? places(points) : [], shown.grid ? places(lines) : []];
    for (const { side, alpha } of seen.layers) {
      this.dots(dots, side, colors[0], alpha);
      this.lines(grid, side, seen.joins, colors[1], alpha);
    }
  }

  // ---------------------------------------------------------------------------------- the plane

  plane(data, width, height) {
    const { pen } = this;
    const unrolled = data.dimensions === 3;
    const low = unrolled ? [-Math.PI, data.upper_only ? 0 : -1] : data.low;
    const high = unrolled ? [Math.PI, 1] : data.high;
    const labels = unrolled ? ["φ [rad]", "cos θ"] : data.labels;
    let [left, top, wide, tall] = [58, 14, width - 74, height - 62];
    if (!unrolled) {
      const side = Math.min(wide, tall);
      left += (wide - side) / 2;
      [wide, tall] = [side, side];
    }
    const up = (y) => (y - low[1]) / (high[1] - low[1]);
    const place = (x, y) => [
      left + (wide * (x - low[0])) / (high[0] - low[0]),
      top + tall * (data.down ? up(y) : 1 - up(y)),
    ];
    const numbers = (axis) => ticks(low[axis], high[axis], 4).map((v) => [v, signed(Number(v.toPrecision(3)))]);
    pen.strokeStyle = this.ink.line;
    pen.strokeRect(left, top, wide, tall);
    const write = (text, x, y) => pen.fillText(text, x, y);
    Object.assign(pen, { textAlign: "center", textBaseline: "middle" });
    for (const [value, text] of unrolled ? ANGLES : numbers(0)) write(text, place(value, 0)[0], top + tall + 14);
    write(labels[0], left + wide / 2, top + tall + 34);
    pen.textAlign = "right";
    for (const [value, text] of numbers(1)) write(text, left - 8, place(0, value)[1]);
    pen.textAlign = "center";
    pen.rotate(-Math.PI / 2);
    write(labels[1], -top - tall / 2, left - 44);
    pen.rotate(Math.PI / 2);
    const jump = unrolled ? wide / 2 : wide / 4; // Lines do not join both ends of the azimuth
    const joins = (p, q) => Math.abs(p[0] - q[0]) < jump && Math.abs(p[1] - q[1]) < jump;
    const project = (x, y, z) => (unrolled ? place(Math.atan2(y, x), z) : place(x, y));
    return { project, joins, layers: [{ side: () => true, alpha: 0.8 }] };
  }

  // --------------------------------------------------------------------------------- the sphere

  sphere({ upper_only: half }, width, height) {
    const { pen } = this;
    const [azimuth, elevation] = this.turn;
    const radius = 0.5 * Math.min(width, height) - 34;
    const [cx, cy] = [width / 2, height / 2 + (half ? 0.3 * radius * Math.cos(elevation) : 0)];
    const [ca, sa, ce, se] = [azimuth, elevation].flatMap((angle) => [Math.cos(angle), Math.sin(angle)]);
    // x to the right, y away, z up, seen from the front and above; the third number is the nearness
    const project = (x, y, z) => {
      const away = sa * x + ca * y;
      return [cx + radius * (ca * x - sa * y), cy - radius * (ce * z + se * away), se * z - ce * away];
    };
    const far = 0.3 * radius;
    const joins = (p, q) => Math.hypot(p[0] - q[0], p[1] - q[1]) < far;
    const layers = [
      { side: (p) => p[2] < 0, alpha: 0.25 },
      { side: (p) => p[2] >= 0, alpha: 0.85 },
    ];
    const ring = (at, turns = 1) => {
      const places = Array.from({ length: 97 }, (_, k) => project(...at((2 * Math.PI * turns * k) / 96)));
      for (const { side, alpha } of layers) this.lines(places, side, joins, this.ink.line, alpha);
    };
    ring((t) => [Math.cos(t), Math.sin(t), 0]);
    if (half) {
      ring((t) => [Math.cos(t), 0, Math.sin(t)], 0.5);
      ring((t) => [0, Math.cos(t), Math.sin(t)], 0.5);
    } else {
      pen.strokeStyle = this.ink.line;
      pen.beginPath();
      pen.arc(cx, cy, radius, 0, 2 * Math.PI);
      pen.stroke();
    }
    Object.assign(pen, { textAlign: "center", textBaseline: "middle" });
    for (const [name, end] of Object.entries({ x: [1, 0, 0], y: [0, 1, 0], z: [0, 0, 1] })) {
      const [from, to, text] = [1, 1.16, 1.25].map((far) => project(...end.map((v) => far * v)));
      this.lines([from, to], () => true, () => true, this.ink.text, from[2] < -0.05 ? 0.45 : 1);
      pen.fillText(name, text[0], text[1]);
    }
    return { project, joins, layers };
  }

  // ------------------------------------------------------------------------------------ strokes

  dots(places, side, color, alpha) {
    const { pen } = this;
    const radius = Math.max(0.7, Math.min(3.2, 70 / Math.sqrt(places.length)));
    pen.fillStyle = color;
    pen.globalAlpha = alpha;
    for (const [x, y] of places.filter(side)) {
      pen.beginPath();
      if (radius > 1.2) pen.arc(x, y, radius, 0, 2 * Math.PI);
      else pen.rect(x - radius, y - radius, 2 * radius, 2 * radius);
      pen.fill();
    }
    pen.globalAlpha = 1;
  }

  lines(places, side, joins, color, alpha) {
    const { pen } = this;
    pen.strokeStyle = color;
    pen.globalAlpha = alpha;
    pen.beginPath();
    for (let i = 1, at = -1; i < places.length; i++) {
      if (!side(places[i]) || !joins(places[i], places[i - 1])) continue;
      if (at !== i - 1) pen.moveTo(places[i - 1][0], places[i - 1][1]);
      pen.lineTo(places[i][0], places[i][1]);
      at = i;
    }
    pen.stroke();
    pen.globalAlpha = 1;
  }
}

function columns(bytes, dimensions) {
  const all = new Float32Array(bytes);
  const count = all.length / dimensions;
  return Array.from({ length: dimensions }, (_, k) => all.subarray(k * count, (k + 1) * count));
}
