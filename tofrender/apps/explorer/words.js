/** Numbers, times and pixels as texts. */

import { SPEED_OF_LIGHT } from "./recording.js";

export function clamp(value, low, high) {
  return Math.max(low, Math.min(high, value));
}

export function nanoseconds(opl) {
  return (1e9 * opl) / SPEED_OF_LIGHT;
}

/** A number in a few digits. */
export function short(value, digits = 3) {
  if (!Number.isFinite(value)) return "–";
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1e-4 && size < 1e5) return signed(Number(value.toPrecision(digits)));
  const [front, power] = value.toExponential(digits - 1).split("e");
  return `${signed(Number(front))}·10${raised(power)}`;
}

/** A number's text with a minus sign. */
export function signed(text) {
  return String(text).replace("-", "−");
}

export function raised(power) {
  return String(Math.round(power)).replace(/./g, (sign) => RAISED[sign]);
}

const RAISED = Object.fromEntries([..."-0123456789"].map((sign, k) => [sign, "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"[k]]));

export function hertz(frequency) {
  return frequency >= 1e9 ? `${short(frequency / 1e9, 4)} GHz` : `${short(frequency / 1e6, 4)} MHz`;
}

/** Digits after the point that tell steps of this size apart. */
export function digits(step) {
  return clamp(1 - Math.floor(Math.log10(step)), 0, 9);
}

/** Time and path length of a bin, with digits that tell bins apart. */
export function when(recording, bin) {
  const opl = recording.center(bin);
  const meters = `${opl.toFixed(digits(recording.width))} m`;
  if (recording.isVolume) return meters;
  return `${nanoseconds(opl).toFixed(digits(nanoseconds(recording.width)))} ns  ·  ${meters}`;
}

/** A path length as time, or a depth in a volume. */
export function lengthText(recording, opl) {
  return recording.isVolume ? `${short(opl, 4)} m` : `${short(nanoseconds(opl), 4)} ns`;
}

/** Coordinates of a pixel in the whole film, or in a volume; of a block, those of all its pixels. */
export function named(recording, pixel) {
  const [x, y] = recording.place(pixel);
  const { grid, geometry } = recording.about;
  if (recording.isVolume) {
    const at = ([start, size], k) => short(start + (k + grid.step / 2) * size);
    return `x ${at(geometry.x, x)} m, y ${at(geometry.y, y)} m`;
  }
  if (grid.step === 1) return `(${x}, ${y})`;
  const [columns, rows] = recording.block(pixel).map((ends) => ends.join("–"));
  return `(${columns}, ${rows})`;
}
