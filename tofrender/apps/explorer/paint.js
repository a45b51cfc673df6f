/** From linear light and from maps of numbers to the pixels of a picture. */

const STEPS = 65_536; // of a tone curve
const CELL = 8; // pixels of the hatch where nothing is known

/** Bytes of (i / STEPS)^(1 / gamma). */
export function toneCurve(gamma) {
  const curve = new Uint8ClampedArray(STEPS);
  for (let i = 0; i < STEPS; i++) curve[i] = 255 * (i / (STEPS - 1)) ** (1 / gamma);
  return curve;
}

/** The value below which a part of what is lit is, of some pixels of planes; 1 if all is dark. */
export function white(planes, part = 0.995) {
  const lit = [];
  for (const plane of planes) {
    const stride = Math.max(1, Math.floor(plane.length / 20_011));
    for (let i = 0; i < plane.length; i += stride) if (plane[i] > 0) lit.push(plane[i]);
  }
  return Float32Array.from(lit).sort()[Math.floor(part * (lit.length - 1))] || 1;
}

/** The same of all bins of a layer, from how often each code is there. */
export function whiteOfAll(layer, part = 0.995) {
  const counts = new Float64Array(256);
  const stride = Math.max(1, Math.floor(layer.codes.length / 4_000_003));
  for (let i = 0; i < layer.codes.length; i += stride) counts[layer.codes[i]]++;
  let left = part * counts.slice(1).reduce((sum, count) => sum + count, 0);
  for (let code = 1; code < 256; code++) {
    left -= counts[code];
    if (left <= 0 && counts[code]) return layer.values[code];
  }
  return 1;
}

/** Light as bytes (red, green, blue, opaque): 1 / gain is shown as white. */
export function paintLight(planes, { gain, curve, weights, map, hatch, width }) {
  const [first] = planes;
  const bytes = new Uint8ClampedArray(4 * first.length);
  const scale = gain * (STEPS - 1);
  const byte = (value) => curve[Math.min(STEPS - 1, Math.round(scale * value))];
  for (let i = 0, to = 0; i < first.length; i++, to += 4) {
    bytes[to + 3] = 255;
    if (hatch?.[i]) {
      bytes.fill(hatched(i, width), to, to + 3);
    } else if (planes.length === 3 && !weights) {
      bytes[to] = byte(first[i]);
      bytes[to + 1] = byte(planes[1][i]);
      bytes[to + 2] = byte(planes[2][i]);
    } else {
      let light = 0;
      for (let c = 0; c < planes.length; c++) light += (weights?.[c] ?? 1) * planes[c][i];
      const level = byte(light);
      bytes[to] = map ? map[3 * level] : level;
      bytes[to + 1] = map ? map[3 * level + 1] : level;
      bytes[to + 2] = map ? map[3 * level + 2] : level;
    }
  }
  return bytes;
}

/** Numbers as colors of a map from `low` to `high`; a hatch where there is none. */
export function paintMap(values, { low, high, map, width }) {
  const bytes = new Uint8ClampedArray(4 * values.length);
  const scale = 255 / (high - low || 1);
  for (let i = 0, to = 0; i < values.length; i++, to += 4) {
    bytes[to + 3] = 255;
    if (Number.isNaN(values[i])) {
      bytes.fill(hatched(i, width), to, to + 3);
      continue;
    }
    const level = 3 * Math.max(0, Math.min(255, Math.round(scale * (values[i] - low))));
    bytes[to] = map[level];
    bytes[to + 1] = map[level + 1];
    bytes[to + 2] = map[level + 2];
  }
  return bytes;
}

/**
 * Reduce values of some columns and rows to at most so many cells.
 *
 * Each cell has the largest value that it covers, so that no bright row or column is lost.
 */
export function largestOfCells(values, [width, height], [mostColumns, mostRows]) {
  const columns = Math.min(width, mostColumns);
  const rows = Math.min(height, mostRows);
  const cells = new Float64Array(columns * rows).fill(-Infinity);
  const ends = (cell, cellCount, count) => [
    Math.floor((cell * count) / cellCount),
    Math.ceil(((cell + 1) * count) / cellCount),
  ];
  for (let row = 0; row < rows; row++) {
    const [top, below] = ends(row, rows, height);
    for (let column = 0; column < columns; column++) {
      const [left, beside] = ends(column, columns, width);
      let largest = -Infinity;
      for (let y = top; y < below; y++) {
        for (let x = left; x < beside; x++) largest = Math.max(largest, values[y * width + x]);
      }
      cells[row * columns + column] = largest;
    }
  }
  return { cells, columns, rows };
}

/** Least and largest number, those of the outermost hundredth left out. */
export function range(values, outermost = 0.01) {
  const known = Float32Array.from(values)
    .filter((value) => !Number.isNaN(value))
    .sort();
  if (!known.length) return [0, 1];
  const at = (part) => known[Math.round(part * (known.length - 1))];
  return [at(outermost), at(1 - outermost)];
}

function hatched(i, width) {
  return (Math.floor(i / width) + (i % width)) % CELL < CELL / 2 ? 108 : 148;
}
