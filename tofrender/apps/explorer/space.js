/**
 * A volume in front of its relay wall: where its voxels are, and ellipsoids of a path length. Points
 * are meters in the wall's frame: x along its columns, y along its rows, z into the hidden scene.
 */

const EYE = 4; // distance of the eye from the middle, in radii of what is shown
const MOST = 150_000; // voxels that are drawn

/** What is there: the volume and, from a capture, its wall, laser spots and origins of the legs. */
export class Space {
  constructor(recording, volume) {
    const { geometry, grid } = volume.about;
    this.layer = volume.light;
    const [width, height] = [volume.light.width, volume.light.height];
    const along = ([first, size], count) => [first, size * grid.step, count];
    const depth = [volume.start, volume.width, volume.count];
    /** Along x, y and z: edge of the first voxel, size of a voxel, count. */
    this.box = [along(geometry.x, width), along(geometry.y, height), depth];
    /** Low and high end of each axis. */
    this.ends = this.box.map(([first, size, count]) => [first, first + size * count].sort((a, b) => a - b));
    this.up = -Math.sign(geometry.y[1]);
    this.handed = geometry.handed;
    const [[left, right], [low, high]] = this.ends;
    const { wall, spots, origins } = recording.about.parts;
    this.recording = recording;
    this.hasCapture = Boolean(wall);
    this.wall = wall
      ? pointsOf(recording.part("wall"))
      : [low, high].flatMap((y) => [left, right].map((x) => [x, y, 0]));
    this.columns = wall ? recording.about.grid.width : 2;
    this.spots = spots ? pointsOf(recording.part("spots")) : [];
    this.origins = origins && pointsOf(recording.part("origins"));
  }

  /** The point of the wall that a pixel of a capture looks at, of a block its middle. */
  point([column, row]) {
    const { grid } = this.recording.about;
    const [x, y] = [[column, grid.width], [row, grid.height]].map(([k, size]) =>
      Math.min(size - 1, k * grid.step + (grid.step >> 1)),
    );
    return this.wall[y * this.columns + x];
  }

  /**
   * Points of the chosen pixels and, of a capture, the ellipsoid {foci, length, width} [m] that light
   * of the bin comes from, else the `plane` of the bin.
   */
  chosen({ bin, laser, pixels, active }) {
    const z = this.recording.center(bin);
    const middle = (k, axis) => this.box[axis][0] + (k + 0.5) * this.box[axis][1];
    if (!this.hasCapture) return { points: pixels.map(([x, y]) => [middle(x, 0), middle(y, 1), z]), plane: z };
    const points = pixels.map((pixel) => this.point(pixel));
    if (!points.length) return { points };
    const sensor = points[active];
    const spot = this.spots[laser] ?? sensor;
    const [from, to] = this.origins ?? [spot, sensor];
    const length = z - distance(from, spot) - distance(sensor, to);
    return { points, ellipsoid: { foci: [spot, sensor], length, width: this.recording.width } };
  }

  /** Centers and codes of voxels from a fraction of the largest on; the brightest if too many. */
  voxels(threshold) {
    const { layer, box } = this;
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
    return { threshold, codes, points, above, cut: layer.values[least], most: layer.values[top] };
  }
}

/** A perspective view: `across` and `tilt` [rad] are 0 where x is to the right and up is up. */
export class Eye {
  constructor({ ends, up, handed }, { across, tilt, zoom }, width, height) {
    const [sin, cos, rise, level] = [Math.sin(across), Math.cos(across), Math.sin(tilt), Math.cos(tilt)];
    this.right = [cos, 0, handed * sin];
    this.above = [sin * rise, up * level, -handed * cos * rise];
    this.near = [-sin * level, up * rise, handed * cos * level];
    const [x, y, [, deep]] = ends;
    this.middle = [(x[0] + x[1]) / 2, (y[0] + y[1]) / 2, deep / 2];
    this.radius = Math.hypot(x[1] - x[0], y[1] - y[0], deep) / 2;
    this.scale = (0.5 * zoom * Math.min(width, height)) / this.radius;
    [this.x, this.y] = [width / 2, height / 2];
    /** Whether the hidden scene is nearer than the wall. */
    this.beforeWall = this.middle[2] + EYE * this.radius * this.near[2] > 0;
  }

  /** Place of a point on the canvas [px]. */
  project(point) {
    const from = point.map((each, k) => each - this.middle[k]);
    const scale = this.scale * this.grown(dot(this.near, from));
    return [this.x + scale * dot(this.right, from), this.y - scale * dot(this.above, from)];
  }

  /** By how much things are larger that are so much nearer [m] than the middle. */
  grown(near) {
    return EYE / Math.max(0.1, EYE - near / this.radius); // Lines may pass the eye
  }
}

/** Rings and meridians of the half of an ellipsoid that is on the scene's side of its foci. */
export function ellipsoidLines({ foci: [a, b], length }, count = 9, steps = 48) {
  const [long, apart] = [length / 2, distance(a, b) / 2];
  if (!(long > apart)) return [];
  const wide = Math.sqrt(long * long - apart * apart);
  const along = apart > 1e-9 ? b.map((each, k) => (each - a[k]) / (2 * apart)) : [1, 0, 0];
  const size = Math.hypot(along[0], along[1]);
  const out = [0, 1].map((k) => (-along[2] * along[k]) / size).concat(size);
  const side = [along[1] * out[2] - along[2] * out[1], along[2] * out[0] - along[0] * out[2]];
  side.push(along[0] * out[1] - along[1] * out[0]);
  const at = (theta, phi) => {
    const ring = Math.sin(theta);
    const [u, v, w] = [long * ring * Math.cos(phi), wide * ring * Math.sin(phi), wide * Math.cos(theta)];
    return along.map((each, k) => (a[k] + b[k]) / 2 + u * each + v * side[k] + w * out[k]);
  };
  const parts = Array.from({ length: steps + 1 }, (_, k) => k / steps);
  return Array.from({ length: count }, (_, k) => [
    parts.map((part) => at((Math.PI * (k + 1)) / (2 * count), 2 * Math.PI * part)),
    parts.map((part) => at(Math.PI * (part - 0.5), (Math.PI * k) / count)),
  ]).flat();
}

export function distance(a, b) {
  return Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
}

function dot(a, b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

function pointsOf(flat) {
  return Array.from({ length: flat.length / 3 }, (_, k) => [...flat.subarray(3 * k, 3 * k + 3)]);
}
