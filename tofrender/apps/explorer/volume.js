/** The view of a volume that the reader turns. */

import { follow, make } from "../ui/parts.js";
import { colorOf, sharp } from "./plot.js";
import { ellipsoidLines, Eye } from "./space.js";
import { clamp, short } from "./words.js";

const VOXEL = 8; // largest half width and height of a voxel [px]; larger ones are made smooth
const DEPTHS = 4096; // steps of depth by which voxels are sorted
const TURN = 0.01; // radians, by a drag of one pixel
const REACH = 24; // px, from a tap to a point of the wall
const [BLUE, DIM] = [[90, 200, 255], "rgb(200 210 230 / 30%)"];
const CORNERS = [0, 1, 2, 3, 4, 5, 6, 7].map((bits) => [bits & 1, (bits >> 1) & 1, bits >> 2]);

/** Where the view is at first. */
export const FRONT = { across: -0.5, tilt: 0.35, zoom: 1 };

/** An element with a canvas; `set({across, tilt, zoom})` is called for turns by drag, wheel, keys. */
export class VolumeView {
  constructor(set) {
    this.canvas = make("canvas", { role: "img" });
    const says = "Volume; arrow keys turn it, plus and minus zoom, 0 goes back";
    this.element = make("div", { className: "volume", tabIndex: 0, role: "group", "aria-label": says });
    this.element.append(this.canvas);
    this.haze = make("canvas");
    const turn = (across, down) => {
      const { view } = this.scene;
      const tilt = clamp(view.tilt + down, -Math.PI / 2, Math.PI / 2);
      set({ across: view.across + across, tilt });
    };
    const zoom = (factor) => set({ zoom: clamp(this.scene.view.zoom * factor, 0.5, 5) });
    follow(this.element, {
      down: ({ clientX, clientY }) => {
        this.element.focus({ preventScroll: true });
        this.dragged = 0;
        return [clientX, clientY];
      },
      move: ({ clientX, clientY }, held) => {
        const [across, down] = [clientX - held[0], clientY - held[1]];
        this.dragged += Math.hypot(across, down);
        held.splice(0, 2, clientX, clientY);
        turn(TURN * across, TURN * down);
      },
    });
    const wheel = (event) => {
      if (!this.element.matches(":focus")) return; // The page scrolls
      event.preventDefault();
      zoom(Math.exp(-event.deltaY / 500));
    };
    this.element.addEventListener("wheel", wheel, { passive: false });
    this.element.addEventListener("keydown", (event) => {
      const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
      const { key } = event;
      if (event.ctrlKey || event.metaKey || event.altKey || (event.shiftKey && key in steps)) return;
      if (key in steps) turn(...steps[key].map((step) => 0.1 * step));
      else if (["+", "=", "-"].includes(key)) zoom(key === "-" ? 1 / 1.1 : 1.1);
      else if (key === "0") set(FRONT);
      else return;
      event.preventDefault();
      event.stopPropagation();
    });
  }

  /** Number of the wall's point that was clicked or tapped, -1 if none was. */
  tapped(event) {
    if (this.dragged > 4) return -1;
    const { left, top } = this.canvas.getBoundingClientRect();
    const away = this.scene.space.wall.map((point) => {
      const [x, y] = this.eye.project(point);
      return Math.hypot(left + x - event.clientX, top + y - event.clientY);
    });
    const nearest = away.reduce((best, each, k) => (each < away[best] ? k : best), 0);
    return away[nearest] < REACH ? nearest : -1;
  }

  /**
   * Draw a scene {space, voxels, view, look, points, plane, ellipsoid}: a Space, its `voxels` and
   * what it says is `chosen`, view {across, tilt, zoom, laser, active}, look {gain, gamma, map}.
   */
  draw(scene) {
    this.scene = scene;
    const pen = sharp(this.canvas);
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const { space } = scene;
    const eye = (this.eye = new Eye(space, scene.view, width, height));
    Object.assign(pen, { fillStyle: "#000", lineWidth: 1, textAlign: "left", textBaseline: "alphabetic" });
    pen.fillRect(0, 0, width, height); // Black, in files too
    if (eye.beforeWall) drawWall(pen, eye, space);
    drawBox(pen, eye, space.ends, true);
    this.splat();
    pen.drawImage(this.haze, 0, 0, width, height);
    drawBox(pen, eye, space.ends, false);
    if (!eye.beforeWall) drawWall(pen, eye, space);
    pen.strokeStyle = `rgb(${BLUE.join(" ")} / 50%)`;
    if (scene.plane !== undefined) {
      const [[left, right], [low, high]] = space.ends;
      const corners = [[left, low], [right, low], [right, high], [left, high], [left, low]];
      strokeLine(pen, eye, corners.map(([x, y]) => [x, y, scene.plane]));
    }
    if (scene.ellipsoid) {
      for (const line of ellipsoidLines(scene.ellipsoid)) strokeLine(pen, eye, line);
    }
    drawSpots(pen, eye, scene);
  }

  /** Draw voxels, the nearest first, until pixels are opaque; those on the ellipsoid are blue. */
  splat() {
    const { eye, haze } = this;
    const { space, voxels: { codes, points } } = this.scene;
    const half = (axis) => eye.scale * space.box.reduce((sum, [, size], k) => sum + Math.abs(size * axis[k]) / 2, 0);
    const [wide, tall] = [half(eye.right), half(eye.above)];
    const fine = Math.min(1, VOXEL / (wide + tall));
    const [width, height] = [eye.x, eye.y].map((middle) => Math.max(1, Math.round(2 * middle * fine)));
    const places = new Float32Array(3 * codes.length);
    const depths = new Uint16Array(codes.length);
    const starts = new Uint32Array(DEPTHS + 1);
    const [[rx, ry, rz], [ax, ay, az]] = [eye.right, eye.above];
    const [[nx, ny, nz], [mx, my, mz]] = [eye.near, eye.middle];
    for (let k = 0; k < codes.length; k++) {
      const [x, y, z] = [points[3 * k] - mx, points[3 * k + 1] - my, points[3 * k + 2] - mz];
      const near = x * nx + y * ny + z * nz;
      const grown = fine * eye.grown(near);
      places[3 * k] = fine * eye.x + eye.scale * grown * (x * rx + y * ry + z * rz);
      places[3 * k + 1] = fine * eye.y - eye.scale * grown * (x * ax + y * ay + z * az);
      places[3 * k + 2] = grown;
      depths[k] = ((1 - near / eye.radius) / 2) * (DEPTHS - 1);
      starts[depths[k] + 1]++;
    }
    for (let k = 0; k < DEPTHS; k++) starts[k + 1] += starts[k];
    const order = new Uint32Array(codes.length);
    for (let k = 0; k < codes.length; k++) order[starts[depths[k]]++] = k;
    const inks = inksOf(this.scene);
    const isOn = onEllipsoid(this.scene);
    const light = new Float32Array(4 * width * height);
    for (const k of order) {
      const grown = places[3 * k + 2];
      const [left, right] = covered(places[3 * k], wide * grown, width);
      const [top, bottom] = covered(places[3 * k + 1], tall * grown, height);
      const ink = isOn(points[3 * k], points[3 * k + 1], points[3 * k + 2]) ? 4 * 256 : 4 * codes[k];
      for (let row = top; row < bottom; row++) {
        const end = 4 * (row * width + right);
        for (let to = 4 * (row * width + left); to < end; to += 4) {
          const part = (1 - light[to + 3]) * inks[ink + 3];
          if (part < 0.004) continue;
          light[to] += part * inks[ink];
          light[to + 1] += part * inks[ink + 1];
          light[to + 2] += part * inks[ink + 2];
          light[to + 3] += part;
        }
      }
    }
    const bytes = new Uint8ClampedArray(light.length);
    light.forEach((each, to) => {
      bytes[to] = to % 4 === 3 ? 255 * each : each / (light[to | 3] || 1);
    });
    Object.assign(haze, { width, height });
    haze.getContext("2d").putImageData(new ImageData(bytes, width, height), 0, 0);
  }
}

/** Red, green, blue [bytes] and opacity of each code, and of what is on the ellipsoid. */
function inksOf({ space, voxels: { cut, most }, look: { gain, gamma, map } }) {
  const inks = new Float32Array(4 * 257);
  space.layer.values.forEach((value, code) => {
    const level = Math.round(255 * Math.min(1, gain * value) ** (1 / gamma));
    for (let k = 0; k < 3; k++) inks[4 * code + k] = map[3 * level + k];
    inks[4 * code + 3] = most > cut ? 0.15 + 0.6 * clamp((value - cut) / (most - cut), 0, 1) : 0.75;
  });
  inks.set([...BLUE, 0.8], 4 * 256);
  return inks;
}

/** Whether a voxel is on the ellipsoid, to half a bin and half a voxel. */
function onEllipsoid({ space, ellipsoid }) {
  if (!ellipsoid) return () => false;
  const { foci: [a, b], length, width } = ellipsoid;
  const off = width / 2 + Math.max(...space.box.map(([, size]) => Math.abs(size)));
  const way = (x, y, z, focus) => Math.sqrt((x - focus[0]) ** 2 + (y - focus[1]) ** 2 + (z - focus[2]) ** 2);
  return (x, y, z) => Math.abs(way(x, y, z, a) + way(x, y, z, b) - length) < off;
}

/** First pixel and the one after the last that a voxel covers; one if it is smaller. */
function covered(middle, half, size) {
  const first = Math.round(middle - half);
  const end = Math.max(first + 1, Math.round(middle + half));
  return [Math.max(0, first), Math.min(size, end)];
}

/** The wall with some lines of its grid. */
function drawWall(pen, eye, { wall, columns }) {
  const some = (count) => {
    const lines = Math.min(count, 9);
    return Array.from({ length: lines }, (_, k) => Math.round((k * (count - 1)) / Math.max(1, lines - 1)));
  };
  const [across, down] = [some(columns), some(wall.length / columns)];
  const grid = down.map((row) => across.map((column) => wall[row * columns + column]));
  const turned = across.map((_, k) => grid.map((line) => line[k]));
  pen.fillStyle = "rgb(200 210 230 / 13%)";
  pen.strokeStyle = DIM;
  strokeLine(pen, eye, [...grid[0], ...turned.at(-1), ...grid.at(-1).toReversed(), ...turned[0].toReversed()]);
  pen.fill();
  for (const line of [...grid, ...turned]) strokeLine(pen, eye, line);
}

/** Edges of the volume behind it; or those before it, with the range of each axis. */
function drawBox(pen, eye, ends, isBehind) {
  const far = eye.near.map((each) => (each > 0 ? 0 : 1));
  pen.strokeStyle = DIM;
  pen.fillStyle = "rgb(255 255 255 / 75%)";
  [0, 1, 2].forEach((axis) => {
    const edges = CORNERS.filter((at) => !at[axis]).map((at) => [at, at.with(axis, 1)]);
    const isFar = (edge) => edge.some((at) => at.every((end, k) => end === far[k]));
    const lines = edges.filter((edge) => isFar(edge) === isBehind);
    const places = lines.map((edge) => edge.map((at) => at.map((end, k) => ends[k][end])));
    for (const line of places) strokeLine(pen, eye, line);
    if (isBehind) return;
    const upright = axis === 1; // To its left there is room, below the others
    const middles = places.map(([a, b]) => eye.project(a.map((each, k) => (each + b[k]) / 2)));
    const [x, y] = middles.sort((a, b) => (upright ? a[0] - b[0] : b[1] - a[1]))[0];
    const says = `${"xyz"[axis]} ${ends[axis].map((end) => short(end)).join(" to ")} m`;
    const { width } = pen.measureText(says);
    pen.fillText(says, Math.max(4, x - (upright ? width + 8 : width / 2)), y + (upright ? 4 : 18));
  });
}

/** Laser spots, and chosen points with their numbers. */
function drawSpots(pen, eye, { space, points, view: { laser, active } }) {
  space.spots.forEach((spot, k) => {
    const [x, y] = eye.project(spot);
    const size = k === laser ? 6 : 3;
    pen.beginPath();
    for (const [right, down] of [[-size, 0], [0, -size], [size, 0], [0, size]]) pen.lineTo(x + right, y + down);
    pen.closePath();
    pen.fillStyle = k === laser ? "#ff4d3d" : "rgb(255 255 255 / 55%)";
    pen.strokeStyle = k === laser ? "#fff" : "#000";
    pen.fill();
    pen.stroke();
  });
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  points.forEach((point, k) => {
    pen.beginPath();
    pen.arc(...eye.project(point), 9, 0, 2 * Math.PI);
    pen.fillStyle = colorOf(k, true);
    pen.strokeStyle = "#fff";
    pen.lineWidth = k === active ? 2.5 : 1;
    pen.fill();
    pen.stroke();
    pen.fillStyle = "#000";
    pen.fillText(k + 1, ...eye.project(point));
  });
}

function strokeLine(pen, eye, points) {
  pen.beginPath();
  for (const point of points) pen.lineTo(...eye.project(point));
  pen.stroke();
}
