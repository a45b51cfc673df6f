/**
 * What an explorer shows: codes of light, their axes, and sums over them. Nothing of a page in here.
 *
 * The bins of a layer are codes (laser, bin, channel, row, column) of one byte: 0 is nothing, any
 * other q stands for least * ratio^(q - 1); in layers with a sign, 128 + q is negative. Lengths are
 * meters of optical path.
 */

export const SPEED_OF_LIGHT = 299_792_458; // m/s

const MOST_RANGES = 4096; // of the highest frequency, that are searched for a depth

/** Codes and the values that they stand for. */
class Layer {
  constructor(about, codes, whole = false) {
    const { name, bins, channels, height, width, least, ratio, signed } = about;
    Object.assign(this, { name, bins, channels, height, width });
    this.pixels = height * width;
    this.codes = about.packed ? unpacked(about, codes) : codes;
    const size = (q) => q && least * ratio ** (q - 1);
    const value = (q) => (whole ? Math.round(size(q)) : size(q)); // Counts are whole numbers
    this.values = Float32Array.from({ length: 256 }, (_, q) =>
      signed && q >= 128 ? -value(q - 128) : value(q),
    );
    /** Largest error of the value of each code; smaller values than `least` have the code 0. */
    this.resolutions = this.values.map((size, q) => {
      const error = q === 0 ? least : Math.abs(size) * (Math.sqrt(ratio) - 1);
      return whole ? (error < 0.5 ? 0 : error + 0.5) : error;
    });
  }

  /** Where the codes of a bin's channel begin. */
  at(bin, channel) {
    return (bin * this.channels + channel) * this.pixels;
  }
}

/** Codes from those that say how far each is from the one before it, and colors from green. */
function unpacked({ pictures, bins, channels, height, width }, steps) {
  const codes = new Uint8Array(steps.length);
  const pixels = height * width;
  const stride = channels * pixels;
  let at = 0;
  for (let picture = 0; picture < pictures; picture++) {
    const first = picture * bins * stride;
    for (let place = first; place < first + stride; place++) {
      let code = 0;
      for (let bin = 0; bin < bins; bin++, at++) {
        code += steps[at];
        codes[place + bin * stride] = code;
      }
    }
  }
  if (channels < 3) return codes;
  for (let from = 0; from < codes.length; from += stride) {
    for (let i = from; i < from + pixels; i++) {
      codes[i] += codes[i + pixels];
      codes[i + 2 * pixels] += codes[i + pixels];
    }
  }
  return codes;
}

/** All that Python has sent, in the order of time and with a laser chosen. */
export class Recording {
  constructor({ header, bytes }) {
    this.about = header;
    this.bytes = bytes;
    this.light = this.layer(header.light);
    this.steady = header.steady && this.layer(header.steady);
    this.errors = header.errors && this.layer(header.errors);
    this.orders = header.orders.map((about) => this.layer(about));
    this.stokes = [this.light, ...header.stokes.map((about) => this.layer(about))];
    this.rates = header.rates && this.layer(header.rates);
    this.distances = header.parts.distance && this.part("distance");
    this.weights = header.weights;
    this.isVolume = header.kind === "volume";
    this.hasTimes = !header.frequencies;
    this.hasOneBin = this.hasTimes && !this.isVolume && header.axis.count === 1;
    this.hasPhasors = !this.isVolume && (header.axis.count > 1 || !this.hasTimes);
    this.laser = 0;
    this.unwarped = false;
    this.chosen();
  }

  /** A part of the bytes by its name; numbers of four bytes are copied to where they may stand. */
  part(name) {
    const { type, offset, length } = this.about.parts[name];
    const { buffer, byteOffset } = this.bytes;
    if (type === "u1") return new Uint8Array(buffer, byteOffset + offset, length);
    return new Float32Array(buffer.slice(byteOffset + offset, byteOffset + offset + 4 * length));
  }

  layer(about) {
    const whole = this.about.counts && about.part === "light" && this.about.grid.step === 1;
    return new Layer(about, this.part(about.part), whole);
  }

  choose({ laser = this.laser, unwarped = this.unwarped }) {
    this.laser = laser;
    this.unwarped = unwarped && Boolean(this.distances);
    this.chosen();
  }

  /** Bins, where the first one starts, and by how much each pixel's own ones are ahead. */
  chosen() {
    const { start, width, count } = this.about.axis;
    Object.assign(this, { start, width, count });
    if (!this.unwarped) return;
    const bins = Array.from(this.distances, (distance) => distance / width);
    const first = Math.ceil(Math.max(...bins));
    this.start -= first * width;
    this.count += first - Math.floor(Math.min(...bins));
    this.ahead = Float32Array.from(bins, (bin) => bin - first);
  }

  // ------------------------------------------------------------------------------------ bins

  /** Path length at a bin's center. */
  center(bin) {
    return this.edge(bin + 0.5);
  }

  /** Path length where a bin begins. */
  edge(bin) {
    return this.start + bin * this.width;
  }

  /** About how much of path lengths is the way to the camera, which is in them unless unwarped. */
  get typicalWay() {
    if (this.unwarped || !this.distances) return 0;
    return -this.distances.reduce((sum, each) => sum + each, 0) / this.distances.length;
  }

  /** The sum of `count` bins, a plane for each channel. */
  gate(first, count, layer = this.light) {
    const planes = newPlanes(layer);
    for (let bin = first; bin < Math.min(first + count, this.count); bin++) this.add(planes, bin, layer);
    return planes;
  }

  /** The pixel at such coordinates. */
  at([x, y]) {
    const { first, step, down } = this.about.grid;
    return [Math.floor((x - first[0]) / step), Math.floor((down * (y - first[1])) / step)];
  }

  /** Channels of planes as one. */
  luminance(planes) {
    const { weights } = this;
    return planes[0].map((_, i) => planes.reduce((sum, plane, c) => sum + weights[c] * plane[i], 0));
  }

  /** All light: what was measured without bins where that is known, else their sum. */
  total() {
    if (!this.steady) return this.gate(0, this.count);
    const planes = newPlanes(this.steady);
    planes.forEach((plane, channel) => {
      const from = this.steady.at(this.laser, channel); // A picture of each frame
      for (let i = 0; i < plane.length; i++) {
        plane[i] = this.steady.values[this.steady.codes[from + i]];
      }
    });
    return planes;
  }

  /** Add a bin's light. */
  add(planes, bin, layer) {
    if (this.unwarped) return this.addUnwarped(planes, bin, layer);
    const { codes, values } = layer;
    const own = this.laser * this.about.axis.count + bin;
    planes.forEach((plane, channel) => {
      const from = layer.at(own, channel);
      for (let i = 0; i < plane.length; i++) plane[i] += values[codes[from + i]];
    });
  }

  /** The same where each pixel's bins begin at its own time: linear between two of them. */
  addUnwarped(planes, bin, layer) {
    const { codes, values, pixels, channels } = layer;
    const { ahead } = this;
    const last = this.about.axis.count - 1;
    const stride = channels * pixels;
    const base = layer.at(this.laser * this.about.axis.count, 0);
    planes.forEach((plane, channel) => {
      for (let i = 0; i < pixels; i++) {
        const place = bin + ahead[i];
        const early = Math.floor(place);
        const share = place - early;
        const from = base + early * stride + channel * pixels + i;
        if (early >= 0 && early <= last) plane[i] += (1 - share) * values[codes[from]];
        if (early >= -1 && early < last) plane[i] += share * values[codes[from + stride]];
      }
    });
  }

  // ----------------------------------------------------------------------------------- pixels

  /** Coordinates of a pixel in the whole film; of a block of pixels, those of its first one. */
  place([column, row]) {
    const { first, step, down } = this.about.grid;
    return [first[0] + column * step, first[1] + down * row * step];
  }

  /** First and last column, and least and largest row, of the block of pixels that is averaged. */
  block(pixel) {
    const { first, step, down, width, height } = this.about.grid;
    const [column, row] = pixel.map((each) => each * step + step - 1);
    const [x, y] = this.place(pixel);
    const [right, end] = [first[0] + Math.min(column, width - 1), first[1] + down * Math.min(row, height - 1)];
    return [[x, right], [Math.min(y, end), Math.max(y, end)]];
  }

  /**
   * What a pixel sees in each bin.
   *
   * Channels are weighted and added; standard errors likewise, as if channels erred together. The
   * table has the value of each code, or its largest error.
   */
  response(pixel, weights = this.weights, layer = this.light, table = layer.values) {
    const own = new Float64Array(this.about.axis.count);
    const first = this.laser * own.length;
    for (let bin = 0; bin < own.length; bin++) {
      for (let channel = 0; channel < layer.channels; channel++) {
        const code = layer.codes[layer.at(first + bin, channel) + pixel];
        own[bin] += weights[channel] * table[code];
      }
    }
    if (!this.unwarped) return own;
    return Float64Array.from({ length: this.count }, (_, bin) => {
      const place = bin + this.ahead[pixel];
      const early = Math.floor(place);
      const share = place - early;
      return (1 - share) * (own[early] ?? 0) + share * (own[early + 1] ?? 0);
    });
  }

  /** Light of a pixel, or of all of them, by rate of change and bin; the highest rate first. */
  byRates(pixel) {
    const { bins, codes, pixels, values } = this.rates;
    const { count } = this.about.rateAxis;
    const [first, last] = pixel === undefined ? [0, pixels] : [pixel, pixel + 1];
    return Float64Array.from({ length: count * bins }, (_, i) => {
      const from = this.rates.at((count - 1 - Math.floor(i / bins)) * bins + (i % bins), 0);
      return codes.subarray(from + first, from + last).reduce((sum, code) => sum + values[code], 0);
    });
  }

  /** When each pixel is brightest, as path length; NaN where it is dark. */
  peaks(withWay) {
    const [height, width] = this.about.peaks;
    const peaks = this.part("peaks").slice(this.laser * height * width, (this.laser + 1) * height * width);
    if (!this.unwarped || withWay) return peaks;
    const step = width === this.light.width ? 1 : this.about.grid.step;
    return peaks.map((opl, i) => {
      const row = Math.floor(Math.floor(i / width) / step);
      const column = Math.floor((i % width) / step);
      return opl - this.distances[row * this.light.width + column];
    });
  }

  // ---------------------------------------------------------------------------------- phasors

  /** P = sum of L exp(+i 2 pi f opl / c) over bin centers: planes of its real and imaginary parts. */
  phasors(frequency) {
    if (this.about.frequencies) {
      const from = this.about.frequencies.indexOf(frequency) * this.light.pixels;
      const [re, im] = ["I", "Q"].map((name) => this.part(name).subarray(from, from + this.light.pixels));
      return { re, im };
    }
    const { codes, pixels } = this.light;
    const re = new Float32Array(pixels);
    const im = new Float32Array(pixels);
    const tables = this.weights.map((weight) => this.light.values.map((value) => weight * value));
    const scale = this.about.perMeter ? this.about.axis.width : 1;
    const turn = (2 * Math.PI * frequency) / SPEED_OF_LIGHT;
    for (let bin = 0; bin < this.about.axis.count; bin++) {
      const opl = this.about.axis.start + (bin + 0.5) * this.about.axis.width;
      const cos = scale * Math.cos(turn * opl);
      const sin = scale * Math.sin(turn * opl);
      tables.forEach((table, channel) => {
        const from = this.light.at(this.laser * this.about.axis.count + bin, channel);
        for (let i = 0; i < pixels; i++) {
          const light = table[codes[from + i]];
          re[i] += cos * light;
          im[i] += sin * light;
        }
      });
    }
    if (this.unwarped) this.distances.forEach((distance, i) => rotate(re, im, i, -turn * distance));
    return { re, im };
  }

  /** The phasor of one pixel. */
  phasor(pixel, frequency) {
    const { frequencies } = this.about;
    if (frequencies) {
      const partsOf = (each) => {
        const { re, im } = this.phasors(each);
        return phasorParts(re[pixel], im[pixel], each);
      };
      if (frequencies.length < 2) return partsOf(frequency);
      return { ...partsOf(frequency), unwrapped: unwrapped(frequencies.map(partsOf), frequencies) };
    }
    const turn = (2 * Math.PI * frequency) / SPEED_OF_LIGHT;
    const scale = this.about.perMeter ? this.width : 1;
    let re = 0;
    let im = 0;
    this.response(pixel).forEach((light, bin) => {
      re += scale * light * Math.cos(turn * this.center(bin));
      im += scale * light * Math.sin(turn * this.center(bin));
    });
    return phasorParts(re, im, frequency);
  }
}

/** Range of depths [m] that frequencies [Hz] tell apart together: c / 2 over their common divisor. */
export function combinedRange(frequencies) {
  const divisor = (a, b) => (b < 0.5 ? a : divisor(b, a % b));
  return SPEED_OF_LIGHT / (2 * frequencies.map(Math.round).reduce((a, b) => divisor(a, b)));
}

/**
 * The depth [m] that explains phases at several frequencies best, NaN if there is none.
 *
 * Each range of the highest frequency has one candidate, the depth at which this frequency's phase
 * fits. The other phases get the whole turns that are nearest to the candidate. The weights are those
 * of `tofrender.unwrap`. The result is the weighted mean of the candidate that disagrees least.
 */
export function unwrapped(parts, frequencies) {
  const highest = frequencies.indexOf(Math.max(...frequencies));
  const ranges = frequencies.map((frequency) => SPEED_OF_LIGHT / (2 * frequency));
  const count = Math.round(combinedRange(frequencies) / ranges[highest]);
  const weights = frequencies.map((frequency, k) => (frequency * parts[k].amplitude) ** 2);
  const total = weights.reduce((sum, weight) => sum + weight, 0);
  if (!(total > 0) || count > MOST_RANGES) return NaN;
  let best = { depth: NaN, error: Infinity };
  for (let turn = 0; turn < count; turn++) {
    const candidate = parts[highest].depth + turn * ranges[highest];
    const depths = parts.map(({ depth }, k) => depth + ranges[k] * Math.round((candidate - depth) / ranges[k]));
    const mean = depths.reduce((sum, depth, k) => sum + weights[k] * depth, 0) / total;
    const error = depths.reduce((sum, depth, k) => sum + weights[k] * (depth - mean) ** 2, 0) / total;
    if (error < best.error) best = { depth: mean, error };
  }
  return best.depth;
}

/** Amplitude, phase in (-pi, pi] and depth in [0, c / 2f). */
export function phasorParts(re, im, frequency) {
  const phase = Math.atan2(im, re);
  const turns = phase / (2 * Math.PI);
  const depth = ((turns - Math.floor(turns)) * SPEED_OF_LIGHT) / (2 * frequency);
  return { amplitude: Math.hypot(re, im), phase, depth };
}

/** Each pixel's largest value over all bins, of a layer with one channel. */
export function largest(layer) {
  const plane = new Float32Array(layer.pixels);
  for (let bin = 0; bin < layer.bins; bin++) {
    const from = layer.at(bin, 0);
    for (let i = 0; i < plane.length; i++) {
      plane[i] = Math.max(plane[i], layer.values[layer.codes[from + i]]);
    }
  }
  return plane;
}

/** Largest values along rows ("top": bin, column) or along columns ("side": row, bin). */
export function largestAcross(layer, side) {
  const { bins, height, width } = layer;
  const plane = new Float32Array(bins * (side === "top" ? width : height));
  for (let bin = 0; bin < bins; bin++) {
    for (let row = 0; row < height; row++) {
      for (let column = 0; column < width; column++) {
        const value = layer.values[layer.codes[layer.at(bin, 0) + row * width + column]];
        const to = side === "top" ? bin * width + column : row * bins + bin;
        plane[to] = Math.max(plane[to], value);
      }
    }
  }
  return plane;
}

function newPlanes(layer) {
  return Array.from({ length: layer.channels }, () => new Float32Array(layer.pixels));
}

function rotate(re, im, i, angle) {
  const [cos, sin] = [Math.cos(angle), Math.sin(angle)];
  [re[i], im[i]] = [re[i] * cos - im[i] * sin, re[i] * sin + im[i] * cos];
}
