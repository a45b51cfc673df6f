/**
 * A volume of voxels in front of its relay wall, which the reader turns. Points are metres in the
 * wall's frame: x along its columns, y along its rows, z into the hidden scene.
 */

import { follow, make } from "../ui/parts.js";
import { sharp, short, signed } from "./plot.js";

const EYE = 4; // distance of the eye from the middle, in radii of what is shown
const MOST = 250_000; // voxels that are drawn
const RASTER = 200_000; // pixels that voxels are drawn with
const DEPTHS = 4096; // steps of depth by which voxels are sorted
const CORNERS = [0, 1, 2, 3, 4, 5, 6, 7].map((bits) => [bits & 1, (bits >> 1) & 1, bits >> 2]);
const SPEED = 0.01; // radians that a drag of one pixel turns
const REACH = 24; // px, from a tap to a point of the wall
export const FRONT = { across: -0.5, tilt: 0.35, zoom: 1 };

/** A perspective view: `across` and `tilt` [rad] are 0 where x is to the right and up is up. */
export class Eye {
  constructor({ low, high, up, handed }, { across, tilt, zoom }, width, height) {
    const [sin, cos, rise, level] = [Math.sin(across), Math.cos(across), Math.sin(tilt), Math.cos(tilt)];
    this.right = [cos, 0, handed * sin];
    this.above = [sin * rise, up * level, -handed * cos * rise];
    this.near = [-sin * level, up * rise, handed * cos * level];
    this.middle = low.map((least, k) => (least + high[k]) / 2);
    this.radius = Math.hypot(...low.map((least, k) => high[k] - least)) / 2;
    this.scale = (0.55 * zoom * Math.min(width, height)) / this.radius;
    [this.x, this.y] = [width / 2, height / 2];
  }

  /** Place on the canvas [px], and how near it is [m] before the middle. */
  project(point) {
    const from = point.map((each, k) => each - this.middle[k]);
    const near = dot(this.near, from);
    const scale = this.scale * this.grown(near);
    return [this.x + scale * dot(this.right, from), this.y - scale * dot(this.above, from), near];
  }

  grown(near) {
    return EYE / (EYE - near / this.radius);
  }

  /** Whether the hidden scene is nearer than the wall. */
  get beforeWall() {
    return this.middle[2] + EYE * this.radius * this.near[2] > 0;
  }
}

/** Centres and codes of the voxels from a fraction of the largest value on; the brightest if many. */
export function brightest(layer, box, threshold) {
  const counts = new Float64Array(256);
  for (const code of layer.codes) counts[code]++;
  const top = Math.max(1, counts.findLastIndex((count) => count > 0));
  let least = layer.values.findIndex((value, code) => code && value >= threshold * layer.values[top]);
  if (least < 0) least = top;
  let count = counts.subarray(least).reduce((sum, each) => sum + each, 0);
  const above = count;
  while (count > MOST && least < top) count -= counts[least++];
  const [codes, points] = [new Uint8Array(count), new Float32Array(3 * count)];
  for (let i = 0, to = 0; to < count; i++) {
    if (layer.codes[i] < least) continue;
    codes[to] = layer.codes[i];
    const row = Math.floor(i / layer.width);
    [i % layer.width, row % layer.height, Math.floor(row / layer.height)].forEach((k, axis) => {
      points[3 * to + axis] = box[axis][0] + (k + 0.5) * box[axis][1];
    });
    to++;
  }
  return { codes, points, above, cut: layer.values[least], most: layer.values[top] };
}

/** Colour and opacity of each code: bytes of red, green and blue, and a part. */
function inks(layer, { cut, most }, { gain, gamma, map }) {
  const table = new Float32Array(4 * 256);
  layer.values.forEach((value, code) => {
    const level = Math.round(255 * Math.min(1, (gain * value) / most) ** (1 / gamma));
    for (let k = 0; k < 3; k++) table[4 * code + k] = map ? map[3 * level + k] : level;
    table[4 * code + 3] = 0.15 + 0.6 * Math.min(1, Math.max(0, (value - cut) / (most - cut || 1)));
  });
  return table;
}

/** Path length over a point and from one focus to the other. */
export function pathOver(point, [a, b]) {
  return distance(point, a) + distance(point, b);
}

/** Lines on the ellipsoid of a path length around two foci, clipped to the scene's side. */
export function ellipsoidLines({ foci: [a, b], length }, lines = 12, steps = 72) {
  const long = length / 2;
  const apart = distance(a, b) / 2;
  if (!(long > apart)) return [];
  const wide = Math.sqrt(long * long - apart * apart);
  const along = apart > 1e-9 ? b.map((each, k) => (each - a[k]) / (2 * apart)) : [1, 0, 0];
  const out = unit([0, 0, 1].map((each, k) => each - along[2] * along[k]));
  const side = cross(out, along);
  const at = (theta, phi) => {
    const [u, v, w] = [long * Math.cos(theta), wide * Math.sin(theta) * Math.cos(phi), wide * Math.sin(theta) * Math.sin(phi)];
    return along.map((each, k) => (a[k] + b[k]) / 2 + u * each + v * side[k] + w * out[k]);
  };
  const line = (point) => clipped(Array.from({ length: steps + 1 }, (_, k) => point(k / steps)));
  const turns = Array.from({ length: lines }, (_, k) => (Math.PI * (k + 0.5)) / lines);
  return [
    ...turns.flatMap((theta) => line((part) => at(theta, 2 * Math.PI * part))),
    ...turns.flatMap((phi) => line((part) => at(2 * Math.PI * part, phi))),
  ];
}

/** The parts of a line where z >= 0. */
function clipped(points) {
  const parts = [[]];
  points.forEach((point, k) => {
    const before = points[k - 1];
    if (before && before[2] < 0 !== point[2] < 0) {
      const part = before[2] / (before[2] - point[2]);
      const edge = before.map((each, axis) => each + part * (point[axis] - each));
      if (point[2] < 0) parts.at(-1).push(edge);
      else parts.push([edge]);
    }
    if (point[2] >= 0) parts.at(-1).push(point);
  });
  return parts.filter((part) => part.length > 1);
}

/**
 * An element with a canvas; `changed` is told of turns, `tapped` of points of the wall's grid.
 *
 * `draw` is given {layer, box, up, handed, wall, look, threshold, view, lasers, marks, ellipsoid}:
 * box    [x, y, z] of the voxels, each [first edge, size of a voxel, count]
 * up     1 or -1: where y is up; `handed` 1 or -1: of x, up and z
 * wall   {points, rows, columns}: x, y, z of its grid
 * look   {gain, gamma, map, smooth}
 * view   {across, tilt, zoom}
 * marks  [{point, colour, text}], chosen points of the wall
 * ellipsoid {foci, length, width} or null
 */
export class VolumeView {
  constructor({ changed, tapped }) {
    this.canvas = make("canvas", { role: "img" });
    const says = "Volume; arrow keys turn it, plus and minus zoom, 0 goes back";
    this.element = make("div", { className: "volume", tabIndex: 0, role: "group", "aria-label": says });
    this.element.append(this.canvas);
    this.haze = make("canvas");
    this.known = {};
    const turn = (across, tilt) => changed(turned(this.scene.view, across, tilt));
    const zoom = (factor) => changed({ ...this.scene.view, zoom: this.scene.view.zoom * factor });
    follow(this.element, {
      down: (event) => {
        this.element.focus({ preventScroll: true });
        this.dragged = 0;
        return { x: event.clientX, y: event.clientY };
      },
      move: (event, held) => {
        const [across, down] = [event.clientX - held.x, event.clientY - held.y];
        this.dragged += Math.hypot(across, down);
        Object.assign(held, { x: event.clientX, y: event.clientY });
        turn(SPEED * across, SPEED * down);
      },
    });
    this.element.addEventListener("click", (event) => {
      const point = this.dragged < 5 && this.pointUnder(event);
      if (point) tapped(point);
    });
    this.element.addEventListener("wheel", (event) => {
      if (!this.element.matches(":focus")) return; // Pages scroll
      event.preventDefault();
      zoom(Math.exp(-event.deltaY / 500));
    }, { passive: false });
    this.element.addEventListener("keydown", (event) => {
      const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
      if (event.ctrlKey || event.metaKey || event.altKey || event.shiftKey && event.key in steps) return;
      if (event.key in steps) turn(...steps[event.key].map((step) => 0.1 * step));
      else if ("+=-".includes(event.key)) zoom(event.key === "-" ? 1 / 1.1 : 1.1);
      else if (event.key === "0") changed(FRONT);
      else return;
      event.preventDefault();
      event.stopPropagation();
    });
  }

  /** Column and row of the wall's point under a pointer, null if there is none. */
  pointUnder(event) {
    const { left, top } = this.canvas.getBoundingClientRect();
    const { points, columns } = this.scene.wall;
    let [best, least] = [null, REACH];
    for (let i = 0; 3 * i < points.length; i++) {
      const [x, y] = this.eye.project([...points.subarray(3 * i, 3 * i + 3)]);
      const away = Math.hypot(left + x - event.clientX, top + y - event.clientY);
      if (away < least) [best, least] = [[i % columns, Math.floor(i / columns)], away];
    }
    return best;
  }

  draw(scene) {
    this.scene = scene;
    const { canvas } = this;
    const pen = sharp(canvas);
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    const { layer, threshold } = scene;
    if (this.known.layer !== layer || this.known.threshold !== threshold) {
      this.known = { layer, threshold, ...brightest(layer, scene.box, threshold) };
    }
    const ends = scene.box.map(([first, size, count]) => [first, first + size * count].sort((a, b) => a - b));
    const [low, high] = [0, 1].map((end) => ends.map((each) => each[end]));
    this.eye = new Eye({ ...scene, low: [low[0], low[1], 0], high }, scene.view, width, height);
    const { eye } = this;
    const wall = () => drawWall(pen, eye, scene);
    if (eye.beforeWall) wall();
    drawBox(pen, eye, ends, true);
    this.splat(Math.min(1, Math.sqrt(RASTER / (width * height))));
    pen.imageSmoothingEnabled = scene.look.smooth;
    pen.drawImage(this.haze, 0, 0, width, height);
    drawBox(pen, eye, ends, false);
    if (!eye.beforeWall) wall();
    pen.lineWidth = 1;
    pen.strokeStyle = "rgb(90 200 255 / 55%)";
    for (const line of scene.ellipsoid ? ellipsoidLines(scene.ellipsoid) : []) stroke(pen, eye, line);
    drawSpots(pen, eye, scene);
  }

  /** Draw voxels, the nearest first, until pixels are opaque; those on the ellipsoid in its colour. */
  splat(fine) {
    const { eye, scene, known, haze } = this;
    const [width, height] = [eye.x, eye.y].map((half) => Math.max(1, Math.round(2 * half * fine)));
    if (haze.width !== width || haze.height !== height) Object.assign(haze, { width, height });
    const table = inks(scene.layer, known, scene.look);
    const { codes, points } = known;
    const places = new Float32Array(3 * codes.length);
    const depths = new Uint16Array(codes.length);
    const starts = new Uint32Array(DEPTHS + 1);
    const scale = fine * eye.scale;
    const [[rx, ry, rz], [ax, ay, az], [nx, ny, nz], [mx, my, mz]] = [eye.right, eye.above, eye.near, eye.middle];
    for (let k = 0; k < codes.length; k++) {
      const [x, y, z] = [points[3 * k] - mx, points[3 * k + 1] - my, points[3 * k + 2] - mz];
      const near = x * nx + y * ny + z * nz;
      const grown = eye.grown(near);
      places[3 * k] = fine * eye.x + scale * grown * (x * rx + y * ry + z * rz);
      places[3 * k + 1] = fine * eye.y - scale * grown * (x * ax + y * ay + z * az);
      places[3 * k + 2] = grown;
      depths[k] = ((1 - near / eye.radius) / 2) * (DEPTHS - 1);
      starts[depths[k] + 1]++;
    }
    for (let k = 0; k < DEPTHS; k++) starts[k + 1] += starts[k];
    const order = new Uint32Array(codes.length);
    for (let k = 0; k < codes.length; k++) order[starts[depths[k]]++] = k;
    const half = (axis) => scale * scene.box.reduce((sum, [, size], k) => sum + Math.abs(size * axis[k]) / 2, 0);
    const [wide, tall] = [half(eye.right), half(eye.above)];
    const light = new Float32Array(4 * width * height);
    for (const k of order) {
      const [x, y, grown] = [places[3 * k], places[3 * k + 1], places[3 * k + 2]];
      const [left, right] = covered(x, wide * grown, width);
      const [top, bottom] = covered(y, tall * grown, height);
      const ink = 4 * codes[k];
      for (let row = top; row < bottom; row++) {
        const end = 4 * (row * width + right);
        for (let to = 4 * (row * width + left); to < end; to += 4) {
          const part = (1 - light[to + 3]) * table[ink + 3];
          if (part < 0.004) continue;
          light[to] += part * table[ink];
          light[to + 1] += part * table[ink + 1];
          light[to + 2] += part * table[ink + 2];
          light[to + 3] += part;
        }
      }
    }
    const bytes = new Uint8ClampedArray(light.length);
    for (let to = 0; to < bytes.length; to += 4) {
      const part = light[to + 3];
      if (!part) continue;
      for (let k = 0; k < 3; k++) bytes[to + k] = light[to + k] / part;
      bytes[to + 3] = 255 * part;
    }
    haze.getContext("2d").putImageData(new ImageData(bytes, width, height), 0, 0);
  }
}

function turned(view, across, tilt) {
  const most = Math.PI / 2;
  return { ...view, across: view.across + across, tilt: Math.max(-most, Math.min(most, view.tilt + tilt)) };
}

/** First pixel and the one after the last that a voxel covers, one at least if it is in sight. */
function covered(middle, half, size) {
  const first = Math.round(middle - half);
  const end = Math.max(first + 1, Math.round(middle + half));
  return [Math.max(0, first), Math.min(size, end)];
}

function drawWall(pen, eye, { wall: { points, rows, columns } }) {
  const at = (row, column) => [...points.subarray(3 * (row * columns + column)).subarray(0, 3)];
  const some = (count) => {
    const lines = Math.min(count, 9);
    return Array.from({ length: lines }, (_, k) => Math.round((k * (count - 1)) / Math.max(1, lines - 1)));
  };
  const [down, across] = [some(rows), some(columns)];
  const edge = [
    ...across.map((column) => at(0, column)),
    ...down.map((row) => at(row, columns - 1)),
    ...across.map((column) => at(rows - 1, column)).reverse(),
    ...down.map((row) => at(row, 0)).reverse(),
  ];
  pen.fillStyle = "rgb(200 210 230 / 13%)";
  pen.strokeStyle = "rgb(200 210 230 / 30%)";
  pen.lineWidth = 1;
  stroke(pen, eye, edge);
  pen.fill();
  for (const row of down) stroke(pen, eye, across.map((column) => at(row, column)));
  for (const column of across) stroke(pen, eye, down.map((row) => at(row, column)));
}

/** Edges of the volume's frame behind it or before it, with the range of each axis. */
function drawBox(pen, eye, ends, behind) {
  const far = eye.near.map((each) => (each > 0 ? 0 : 1));
  pen.strokeStyle = "rgb(255 255 255 / 35%)";
  pen.fillStyle = "rgb(255 255 255 / 75%)";
  pen.lineWidth = 1;
  const corner = (at) => at.map((end, axis) => ends[axis][end]);
  [0, 1, 2].forEach((axis) => {
    const edges = CORNERS.filter((at) => !at[axis]).map((at) => [at, at.with(axis, 1)]);
    for (const edge of edges) {
      const isBehind = edge.some((at) => at.every((end, k) => end === far[k]));
      if (isBehind === behind) stroke(pen, eye, edge.map(corner));
    }
    if (behind) return;
    const middles = edges.map((edge) => edge.map((at) => eye.project(corner(at))));
    const low = (edge) => edge[0][1] + edge[1][1] + (axis === 1 ? -1e3 * (edge[0][0] + edge[1][0]) : 0);
    const [a, b] = middles.sort((one, two) => low(two) - low(one))[0];
    const [left, right] = ends[axis].map((end) => signed(short(end)));
    pen.textAlign = axis === 1 ? "right" : "center";
    pen.fillText(`${"xyz"[axis]} ${left} to ${right} m`, (a[0] + b[0]) / 2 - (axis === 1 ? 8 : 0), (a[1] + b[1]) / 2 + (axis === 1 ? 4 : 18));
  });
}

function drawSpots(pen, eye, { lasers, marks }) {
  pen.lineWidth = 1.5;
  for (const { point, active } of lasers) {
    const [x, y] = eye.project(point);
    const size = active ? 6 : 3;
    pen.beginPath();
    for (const [across, down] of [[-size, 0], [0, -size], [size, 0], [0, size]]) pen.lineTo(x + across, y + down);
    pen.closePath();
    pen.fillStyle = active ? "#ff4d3d" : "rgb(255 255 255 / 55%)";
    pen.strokeStyle = active ? "#fff" : "#000";
    pen.fill();
    pen.stroke();
  }
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  for (const { point, colour, text, active } of marks) {
    const [x, y] = eye.project(point);
    pen.beginPath();
    pen.arc(x, y, 9, 0, 2 * Math.PI);
    pen.fillStyle = colour;
    pen.strokeStyle = "#fff";
    pen.lineWidth = active ? 2.5 : 1;
    pen.fill();
    pen.stroke();
    pen.fillStyle = "#000";
    pen.fillText(text, x, y + 0.5);
  }
}

function stroke(pen, eye, points) {
  pen.beginPath();
  for (const point of points) pen.lineTo(...eye.project(point).slice(0, 2));
  pen.stroke();
}

function dot(a, b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

function cross(a, b) {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

function unit(vector) {
  const length = Math.hypot(...vector);
  return vector.map((each) => each / length);
}

function distance(a, b) {
  return Math.hypot(...a.map((each, k) => each - b[k]));
}
