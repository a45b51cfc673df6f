/** The picture of each view: bytes, size and what they say. */

import { paintLight, paintMap, range, toneCurve, white, whiteOfAll } from "./paint.js";
import { largest, largestAcross, phasorParts, Recording, SPEED_OF_LIGHT } from "./recording.js";
import { distance, Space } from "./space.js";
import { hertz, lengthText, short, when } from "./words.js";

const TURNING = ["space", "3D", "The volume before its wall, to be turned"];

/** Views of a recording: what `view` is called, its label, and what it shows. */
export function viewsOf({ about, isVolume }) {
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
  const views = [
    ["light", "Light", "At one time"],
    ["gate", "Gate", "Light that arrives between two times"],
    ["total", "All time", "The steady picture"],
    ["peak", "Peak time", "Time of the brightest bin of each pixel"],
    ["depth", "Depth", "Half the path length of the brightest bin"],
    ["phasor", "Phasor", "Measurement of a camera with modulated light"],
  ];
  if (about.volume) views.unshift(TURNING);
  return views.filter(([view]) => view !== "depth" || about.depth);
}

/**
 * Makes pictures of a recording. `of(now)` returns {bytes, width, height, says} and, where they
 * apply, aspect, assumes, gain (1 / gain is white), and map, low, high, unit or scale of a bar; of
 * the view "space" a scene instead of bytes.
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
    const { light } = recording;
    switch (now.view) {
      case "total":
        known.total ??= recording.total();
        known.totalWhite ??= white(known.total);
        return this.lit(now, known.total, known.totalWhite, recording.steady ?? light, "at all times");
      case "gate": {
        const { first, count } = now.gate;
        const planes = recording.gate(first, count);
        const [from, to] = [first, first + count].map((bin) => lengthText(recording, recording.edge(bin)));
        return this.lit(now, planes, white(planes), light, `what arrives from ${from} to ${to}`);
      }
      case "peak":
      case "depth":
        return this.peaks(now.view === "depth");
      case "phasor":
        return this.phasor(now);
      case "front":
        known.front ??= largest(light);
        return this.lit(now, [known.front], this.white, light, "largest along the depth");
      case "space":
        return this.turning(now);
      case "side":
      case "top":
        return this.across(now);
      default: {
        const where = recording.isVolume ? "at a depth of" : "at";
        const says = `${where} ${when(recording, now.bin)}`;
        return this.lit(now, recording.frame(now.bin), this.white, light, says);
      }
    }
  }

  lit(now, planes, brightest, { width, height }, says) {
    const { recording } = this;
    if (this.curveOf !== now.gamma) {
      this.curveOf = now.gamma;
      this.toneCurve = toneCurve(now.gamma);
    }
    const gain = 2 ** now.exposure / brightest;
    const map = now.colours === "false" ? recording.part("map false") : null;
    const bytes = paintLight(planes, {
      ...{ gain, curve: this.toneCurve, map, width },
      weights: now.colours === "colour" ? null : recording.weights,
      hatch: this.hatch(width, height),
    });
    return { bytes, width, height, says, gain, scale: map && { map, high: 1 / gain, gamma: now.gamma } };
  }

  peaks(isDepth) {
    const { recording } = this;
    const { about, isVolume } = recording;
    const [height, width] = about.peaks;
    const factor = isVolume ? 1 : isDepth ? 0.5 : 1e9 / SPEED_OF_LIGHT;
    const values = recording.peaks(isDepth).map((opl) => factor * opl);
    const [low, high] = range(values);
    const map = recording.part("map distance");
    const unit = isVolume || isDepth ? "m" : "ns";
    const says = `${short(low)} to ${short(high)} ${unit}`;
    const assumes = isDepth
      ? `Depth = path length of the brightest bin / 2. It assumes ${about.depth}.`
      : isVolume
        ? "Distance of the brightest voxel from the wall; hatched where it is weak."
        : "Centre of the bin in which each pixel is brightest.";
    const bytes = paintMap(values, { low, high, map, width });
    return { bytes, width, height, says, assumes, map, low, high, unit };
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
    const limits = {
      amplitude: [0, range(values, 0.005)[1], ""],
      phase: [-Math.PI, Math.PI, "rad"],
      depth: [0, wrapped, "m"],
    };
    const [low, high, unit] = limits[phasor];
    const maps = { amplitude: "map false", phase: "map phase", depth: "map distance" };
    const map = recording.part(maps[phasor]);
    const assumes = {
      amplitude: `|P| of P = Σ L exp(+i 2π f OPL / c), at ${hertz(frequency)}.`,
      phase: `Phase of P = Σ L exp(+i 2π f OPL / c), at ${hertz(frequency)}.`,
      depth: `Depth = c (phase mod 2π) / 4π f, which wraps at c / 2f = ${short(wrapped)} m. ` +
        "It assumes that light source and camera coincide, and a single bounce.",
    }[phasor];
    const bytes = paintMap(values, { low, high, map, width });
    return { bytes, width, height, says: hertz(frequency), assumes, map, low, high, unit };
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
    const picture = this.lit(now, [known[now.view]], this.white, { width, height }, "largest value");
    const [from, to] = [0, deep].map((more) => lengthText(recording, recording.start + more));
    const assumes = `${isSide ? "Left to right" : "Top to bottom"}: ${from} to ${to} from the wall.`;
    return { ...picture, aspect: isSide ? deep / long : long / deep, assumes };
  }

  turning(now) {
    const { recording, space, known } = this;
    if (known.voxels?.threshold !== now.threshold) known.voxels = space.voxels(now.threshold);
    const { above, codes, most } = known.voxels;
    const map = recording.part("map false");
    const look = { gain: 2 ** now.exposure, gamma: now.gamma, map };
    const scene = { space, look, voxels: known.voxels, view: now, ...space.chosen(now) };
    const says = `voxels from ${short(100 * now.threshold)} % of the largest on: ${above}`;
    const words = [`V${says.slice(1)}${codes.length < above ? `, shown are the ${codes.length} largest` : ""}.`];
    if (scene.ellipsoid) {
      const { foci: [spot, point], length } = scene.ellipsoid;
      const from = spot === point ? "From the wall point and back" : "From the lit to the wall point";
      const where = length > distance(spot, point) ? "over the blue surface" : "which is too short";
      words.push(`${from}: ${short(length, 4)} m, ${where}.`);
    }
    const scale = { map, high: most / look.gain, gamma: now.gamma };
    return { scene, says, assumes: words.join(" "), scale };
  }

  /** Where nothing is known, for a picture of this size. */
  hatch(width, height) {
    const { about } = this.recording;
    if (!about.parts.hatch) return null;
    const { grid } = about;
    if (height * width > grid.height * grid.width) return null;
    const full = this.recording.part("hatch");
    const step = Math.ceil(grid.width / width);
    return Uint8Array.from(
      { length: width * height },
      (_, i) => full[Math.floor(i / width) * step * grid.width + (i % width) * step],
    );
  }
}
