/** The picture of each view: bytes, size and what they say. */

import { paintLight, paintMap, range, toneCurve, white, whiteOfAll } from "./paint.js";
import { largest, largestAcross, phasorParts, Recording, SPEED_OF_LIGHT } from "./recording.js";
import { distance, Space } from "./space.js";
import { STOKES } from "./stokes.js";
import { hertz, lengthText, short, when } from "./words.js";

const BAR = [0, 0.25, 0.5, 0.75, 1]; // where a color bar has numbers
const TURNING = ["space", "3D", "The volume before its wall, to be turned"];

/** Views of a recording: what `view` is called, its label, and what it shows. */
export function viewsOf({ about, count, isVolume }) {
  if (isVolume) {
    return [
      ["light", "Slice", "At one depth"],
      ["front", "Front", "Largest value along the depth"],
      ["side", "Side", "Largest value along x"],
      ["top", "Top", "Largest value along y"],
      ["peak", "Depth", "Depth of the largest value"],
      TURNING,
    ];
  }
  const phasor = ["phasor", "Phasor", "Measurement of a camera with modulated light"];
  if (about.frequencies) return [phasor];
  const light = ["light", "Light", "At one time"];
  const total = ["total", "All time", "The steady picture"];
  if (about.axis.count === 1) return about.steady ? [light, total] : [light];
  const views = [
    light,
    ["gate", "Gate", "Light that arrives between two times"],
    total,
    ["peak", "Peak time", "Time of the brightest bin of each pixel"],
    ["depth", "Depth", "Half the path length of the brightest bin"],
    phasor,
  ];
  if (about.volume) views.unshift(TURNING);
  return views.filter(([view]) => view !== "depth" || about.depth);
}

/**
 * Makes pictures of a recording. `of(now)` returns {bytes, width, height, says} and, where they
 * apply, aspect, assumes, hatched (what is), bar {map, says}, and gain (1 / gain is white); of the
 * view "space" a scene instead of bytes.
 */
export class Pictures {
  constructor(recording) {
    this.recording = recording;
    this.white = whiteOfAll(recording.light);
    const { about: { volume: header }, bytes } = recording;
    const volume = recording.isVolume ? recording : header && new Recording({ header, bytes });
    this.space = volume && new Space(recording, volume);
    this.forget();
  }

  /** Drop what was computed of a laser, or of unwarped time. */
  forget() {
    this.known = {};
  }

  of(now) {
    const { recording, known } = this;
    const { light, steady, count } = recording;
    switch (now.view) {
      case "total": {
        known.total ??= recording.total();
        known.totalWhite ??= white(known.total, 0.95); // Lamps are brighter by far
        const isSteady = steady && now.stokes === "S0";
        const sums = (layer) => (isSteady ? known.total : recording.gate(0, count, layer));
        return this.lit(now, sums, known.totalWhite, isSteady ? steady : light, "at all times");
      }
      case "gate": {
        const { first, count: bins } = now.gate;
        const planes = recording.gate(first, bins);
        const sums = (layer) => (layer === light ? planes : recording.gate(first, bins, layer));
        const [from, to] = [first, first + bins].map((bin) => lengthText(recording, recording.edge(bin)));
        return this.lit(now, sums, white(planes), light, `what arrives from ${from} to ${to}`);
      }
      case "peak":
      case "depth":
        return this.peaks(now.view === "depth");
      case "phasor":
        return this.phasor(now);
      case "front":
        known.front ??= largest(light);
        return this.lit(now, () => [known.front], this.white, light, "largest along the depth");
      case "space":
        return this.turning(now);
      case "side":
      case "top":
        return this.across(now);
      default: {
        const says = `${recording.isVolume ? "at a depth of" : "at"} ${when(recording, now.bin)}`;
        return this.lit(now, (layer) => recording.gate(now.bin, 1, layer), this.white, light, says);
      }
    }
  }

  /** Light, or what polarized light is shown by; `sums(layer)` has planes of these values. */
  lit(now, sums, brightest, { width, height }, says) {
    const { recording } = this;
    const gain = 2 ** now.exposure / brightest;
    const hatch = this.hatch(width, height);
    const size = { width, height, says, hatched: hatch && recording.about.hatched };
    if (now.stokes !== "S0") return { ...size, ...this.polarized(now, sums, gain, hatch, width) };
    if (this.curveOf !== now.gamma) {
      this.curveOf = now.gamma;
      this.toneCurve = toneCurve(now.gamma);
    }
    const map = now.colors === "false" ? recording.part("map false") : null;
    const bytes = paintLight(sums(recording.light), {
      ...{ gain, curve: this.toneCurve, map, hatch, width },
      weights: now.colors === "color" ? null : recording.weights,
    });
    const bar = map && { map, says: BAR.map((part) => short(part ** now.gamma / gain, 2)) };
    return { ...size, bytes, gain, bar };
  }

  polarized(now, sums, gain, hatch, width) {
    const { recording } = this;
    const { name, parts, of, ...look } = STOKES[now.stokes];
    const planes = parts.map((k) => recording.luminance(sums(recording.stokes[k])));
    const values = planes[0].map((_, i) => (hatch?.[i] ? NaN : of(...planes.map((plane) => plane[i]))));
    const assumes = `${name[0].toUpperCase()}${name.slice(1)}.`;
    if (look.range) {
      const [low, high] = look.range;
      const map = recording.part(look.map);
      const hatched = [recording.about.hatched, "no light or no polarization"].filter(Boolean).join(", or ");
      const bytes = paintMap(values, { low, high, map, width });
      return { bytes, assumes, hatched, bar: mapBar(map, low, high, look.unit) };
    }
    const map = recording.part("map signed");
    const toned = values.map((value) => Math.sign(value) * Math.min(1, gain * Math.abs(value)) ** (1 / now.gamma));
    const says = BAR.map((part) => 2 * part - 1).map((part) =>
      short((Math.sign(part) * Math.abs(part) ** now.gamma) / gain, 2),
    );
    return { bytes: paintMap(toned, { low: -1, high: 1, map, width }), assumes, gain, bar: { map, says } };
  }

  peaks(isDepth) {
    const { recording } = this;
    const { about, isVolume } = recording;
    const [height, width] = about.peaks;
    const factor = isVolume ? 1 : isDepth ? 0.5 : 1e9 / SPEED_OF_LIGHT;
    const values = recording.peaks(isDepth).map((opl) => factor * opl);
    const [low, high] = range(values);
    const unit = isVolume || isDepth ? "m" : "ns";
    const assumes = isDepth
      ? `Depth = path length of the brightest bin / 2. It assumes ${about.depth}.`
      : isVolume
        ? "Distance of the brightest voxel from the wall."
        : "Center of the bin in which each pixel is brightest.";
    const dark = values.some(Number.isNaN) ? (isVolume ? "too weak" : "no light") : "";
    const hatched = [about.hatched, dark].filter(Boolean).join(", or ");
    return { ...this.mapped(values, width, { low, high, unit, map: "map distance" }), height, assumes, hatched };
  }

  /** Numbers as a picture in the colors of a map. */
  mapped(values, width, { low, high, unit, map: name }) {
    const map = this.recording.part(name);
    const says = `${short(low)} to ${short(high)} ${unit}`;
    return { bytes: paintMap(values, { low, high, map, width }), width, says, bar: mapBar(map, low, high, unit) };
  }

  phasor({ frequency, phasor }) {
    const { recording, known } = this;
    const { width, height } = recording.light;
    if (known.phasorsAt !== frequency) {
      known.phasorsAt = frequency;
      known.phasors = recording.phasors(frequency);
    }
    const { re, im } = known.phasors;
    const values = re.map((_, i) => {
      const parts = phasorParts(re[i], im[i], frequency);
      return parts.amplitude > 0 ? parts[phasor] : NaN;
    });
    const wrapped = SPEED_OF_LIGHT / (2 * frequency);
    const look = {
      amplitude: { low: 0, high: range(values, 0.005)[1], unit: "", map: "map false" },
      phase: { low: -Math.PI, high: Math.PI, unit: "rad", map: "map phase" },
      depth: { low: 0, high: wrapped, unit: "m", map: "map distance" },
    }[phasor];
    const assumes = {
      amplitude: `|P| of P = Σ L exp(+i 2π f OPL / c), at ${hertz(frequency)}.`,
      phase: `Phase of P = Σ L exp(+i 2π f OPL / c), at ${hertz(frequency)}.`,
      depth: `Depth = c (phase mod 2π) / 4π f, at ${hertz(frequency)}, which wraps at c / 2f = ` +
        `${short(wrapped)} m. It assumes that light source and camera coincide, and a single bounce.`,
    }[phasor];
    const hatched = values.some(Number.isNaN) && "no light";
    return { ...this.mapped(values, width, look), height, says: hertz(frequency), assumes, hatched };
  }

  across(now) {
    const { recording, known } = this;
    const { about, light } = recording;
    known[now.view] ??= largestAcross(light, now.view);
    const isSide = now.view === "side";
    const [width, height] = isSide ? [light.bins, light.height] : [light.width, light.bins];
    const along = about.geometry[isSide ? "y" : "x"];
    const deep = recording.count * recording.width;
    const long = Math.abs(along[1]) * about.grid[isSide ? "height" : "width"];
    const picture = this.lit(now, () => [known[now.view]], this.white, { width, height }, "largest value");
    const [from, to] = [0, deep].map((more) => lengthText(recording, recording.start + more));
    const assumes = `${isSide ? "Left to right" : "Top to bottom"}: ${from} to ${to} from the wall.`;
    return { ...picture, aspect: isSide ? deep / long : long / deep, assumes };
  }

  turning(now) {
    const { recording, space, known } = this;
    const { threshold, exposure, gamma } = now;
    if (known.voxels?.threshold !== threshold) known.voxels = space.voxels(threshold);
    const { above, codes, most } = known.voxels;
    const look = { gain: 2 ** exposure / most, gamma, map: recording.part("map false") };
    const scene = { space, look, voxels: known.voxels, view: now, ...space.chosen(now) };
    const says = `voxels ≥ ${short(100 * threshold)} % of the largest: ${above}`;
    const words = [`V${says.slice(1)}${codes.length < above ? `, the ${codes.length} largest are shown` : ""}.`];
    if (scene.ellipsoid) {
      const { foci: [spot, point], length } = scene.ellipsoid;
      const way = spot === point ? "from the wall point and back" : "from the lit to the wall point";
      const where = length > distance(spot, point) ? "Blue: paths" : "Nothing has paths";
      words.push(`${where} of ${short(length, 4)} m ${way}.`);
    }
    const bar = { map: look.map, says: BAR.map((part) => short(part ** gamma / look.gain, 2)) };
    const at = `${when(recording, now.bin)}, ${says}`;
    return { scene, says: at, assumes: words.join(" "), gain: look.gain, bar };
  }

  /** Where some pixel of a block is not known, for a picture of this size; null if all are. */
  hatch(width, height) {
    const { about } = this.recording;
    const { grid } = about;
    if (!about.parts.hatch || height * width > grid.height * grid.width) return null;
    const step = Math.ceil(grid.width / width);
    const found = new Uint8Array(width * height);
    this.recording.part("hatch").forEach((unknown, i) => {
      const row = Math.floor(i / grid.width / step);
      if (unknown) found[row * width + Math.floor((i % grid.width) / step)] = 1;
    });
    return found;
  }
}

function mapBar(map, low, high, unit) {
  const says = BAR.map((part) => short(low + part * (high - low)));
  return { map, says: [...says.slice(0, -1), `${says.at(-1)} ${unit}`] };
}
