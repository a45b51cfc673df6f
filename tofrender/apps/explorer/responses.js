/** Responses and phasors of the chosen pixels: curves, tables and what is read out. */

import { fill, lineSwatch, make } from "../ui/parts.js";
import { canvasOf, hasPixels } from "./frame.js";
import { removePixel } from "./input.js";
import { largestOfCells, paintMap } from "./paint.js";
import { colorOf, dotsOf, drawCurves, drawMap, drawPhasors } from "./plot.js";
import { SPEED_OF_LIGHT, combinedRange } from "./recording.js";
import { STOKES } from "./stokes.js";
import { hertz, named, nanoseconds, raised, short, signed, when } from "./words.js";

const DASHES = [[4, 2], [1, 2], [8, 2, 2, 2], [2, 4], [10, 4], [1, 5]]; // of bounce orders
const MOST_CURVES = 200; // that are remembered
const RATE_DECADES = 4; // of the colors of light by rates

/** What pixels show of an explorer: its now, recording, parts, set. */
export class Responses {
  constructor(explorer) {
    this.explorer = explorer;
    this.forget();
  }

  /** Drop what was computed of a laser, or of unwarped time. */
  forget() {
    this.known = new Map();
  }

  /** The response of a pixel: luminance or one channel, with its standard error, or polarization. */
  curve([column, row], k = -1) {
    const { now, recording } = this.explorer;
    const name = `${column} ${row} ${now.channel} ${now.stokes}`;
    if (!this.known.has(name)) {
      if (this.known.size > MOST_CURVES) this.known.clear();
      const pixel = row * recording.light.width + column;
      const weights = recording.weights.map((weight, c) =>
        now.channel === "luminance" ? weight : Number(String(c) === now.channel),
      );
      const { parts, of } = STOKES[now.stokes];
      const components = parts.map((part) => recording.response(pixel, weights, recording.stokes[part]));
      const values = components[0].map((_, bin) => of(...components.map((each) => each[bin])));
      const found = { values, components };
      if (parts.length === 1) {
        const layer = recording.stokes[parts[0]];
        found.resolution = recording.response(pixel, weights, layer, layer.resolutions);
      }
      if (recording.errors && now.stokes === "S0") found.errors = recording.response(pixel, weights, recording.errors);
      found.orders = recording.orders.map((layer) => ({
        name: layer.name,
        values: recording.response(pixel, weights, layer),
      }));
      this.known.set(name, found);
    }
    const [x, y] = recording.place([column, row]);
    const block = recording.block([column, row]);
    return { ...this.known.get(name), x, y, block, style: Math.max(0, k), dots: recording.about.counts };
  }

  /** Curves of all chosen pixels. */
  curves() {
    return this.explorer.now.pixels.map((pixel, k) => this.curve(pixel, k));
  }

  /** Light along the rows of the chosen pixels, for a film with a single time bin. */
  profiles() {
    const { now, recording } = this.explorer;
    const columns = Array.from({ length: recording.light.width }, (_, column) => column);
    const profiles = now.pixels.map(([, row], style) => {
      const rowCurves = columns.map((column) => this.curve([column, row]));
      const values = rowCurves.map((curve) => curve.values[0]);
      const errors = rowCurves[0].errors && rowCurves.map((curve) => curve.errors[0]);
      return { values, errors, style };
    });
    const axis = { start: recording.place([0, 0])[0] - 0.5, width: recording.about.grid.step, count: columns.length };
    const chosen = now.pixels[now.active];
    return { axis, profiles, mark: { bin: chosen?.[0] } };
  }

  /** Phasors of all chosen pixels. */
  phasors() {
    const { now, recording } = this.explorer;
    return now.pixels.map(([column, row], style) => {
      const pixel = row * recording.light.width + column;
      return { ...recording.phasor(pixel, now.frequency), style };
    });
  }

  // --------------------------------------------------------------------------------- drawing

  draw(dark, ink) {
    const { hasTimes, hasPhasors, rates } = this.explorer.recording;
    if (hasTimes) this.drawCurves(dark, ink);
    if (hasPhasors) this.drawPhasors(dark, ink);
    if (rates) this.drawRates(ink);
  }

  drawCurves(dark, ink) {
    const { now, parts, recording } = this.explorer;
    const { about, isVolume } = recording;
    const curves = this.curves();
    const { name, unit, range, of } = STOKES[now.stokes];
    const active = curves[now.active];
    const orders = (active?.orders ?? []).map(({ values }, k) => ({
      ...{ values, style: active.style, faint: about.counts ? [] : DASHES[k % DASHES.length] },
    }));
    const marks = now.view === "gate" ? { gate: now.gate } : { bin: now.bin };
    const what = recording.unwarped ? about.axis.what.replace("included", "left out") : about.axis.what;
    const component = now.stokes === "S0" ? about.quantity : `${now.stokes}: ${about.quantity}`;
    const quantity = range ? `${name}${unit && ` [${unit}]`}` : component;
    const words = isVolume
      ? { quantity, below: `${what} [m]`, inMeters: true }
      : { quantity, below: "time [ns]", above: `${what} [m]` };
    const narrow = parts.plot.clientWidth < 480;
    if (narrow && words.above) words.above = "optical path length [m]";
    const log = now.log && now.stokes === "S0";
    if (recording.hasOneBin) {
      const { axis, profiles, mark } = this.profiles();
      const along = { quantity, below: "pixel x", inMeters: true };
      drawCurves(parts.plot, axis, profiles, mark, along, { log, range, dark, ink });
      parts.plot.setAttribute("aria-label", `${quantity} over ${along.below}: ${this.spoken()}`);
    } else {
      drawCurves(parts.plot, recording, [...orders, ...curves], marks, words, { log, range, dark, ink });
      parts.plot.setAttribute("aria-label", `${words.quantity} over ${words.below} of ${this.spoken()}`);
    }
    this.showLegend(active, dark);
    const shown = isVolume ? "here" : now.view === "gate" ? "in the gate" : "now";
    const [from, to] = now.view === "gate" ? [now.gate.first, now.gate.first + now.gate.count] : [now.bin, now.bin + 1];
    const rows = curves.map(({ components }, k) => {
      const sizes = components[0].map(Math.abs);
      const peak = sizes.indexOf(sizes.reduce((a, b) => Math.max(a, b)));
      const light = of(...components.map((each) => each.subarray(from, to).reduce((a, b) => a + b)));
      const at = recording.center(peak);
      const times = isVolume ? [`${short(at, 4)} m`] : [`${short(nanoseconds(at), 4)} ns`, `${short(at, 4)} m`];
      return [this.chip(k, dark), named(recording, now.pixels[k]), short(light), ...times, this.cross(k)];
    });
    const headings = isVolume
      ? ["", "column", shown, "brightest at", ""]
      : ["", "pixel", shown, "peak time", "peak path", ""];
    fill(parts.pixels, [headings, ...rows]);
  }

  /** Show what thin lines and bars are. */
  showLegend(active, dark) {
    const { parts, recording, now } = this.explorer;
    const words = recording.errors ? ["Bars and bands are one standard error."] : [];
    const { counts } = recording.about;
    if (active?.orders.length) {
      words.push(`${counts ? "Dots are counts, the line is of" : "Thin lines are parts of"} pixel ${now.active + 1}:`);
    }
    const keys = (active?.orders ?? []).map(({ name }, k) => {
      const swatch = lineSwatch(counts ? [] : DASHES[k % DASHES.length], colorOf(active.style, dark));
      return make("span", { className: "key" }, swatch, name);
    });
    parts.legend.hidden = !words.length;
    parts.legend.replaceChildren(words.join(" "), ...keys);
  }

  drawPhasors(dark, ink) {
    const { now, parts, recording } = this.explorer;
    const phasors = this.phasors();
    drawPhasors(parts.plane, phasors, { dark, ink });
    const { frequencies } = recording.about;
    const hasSeveral = frequencies?.length > 1;
    const rows = phasors.map(({ amplitude, phase, depth, unwrapped }, k) => [
      ...[this.chip(k, dark), short(amplitude), `${signed(phase.toFixed(3))} rad`, `${depth.toFixed(3)} m`],
      ...(hasSeveral ? [Number.isFinite(unwrapped) ? `${unwrapped.toFixed(3)} m` : "none"] : []),
    ]);
    const heads = [`depth (below ${short(SPEED_OF_LIGHT / (2 * now.frequency))} m)`];
    if (hasSeveral) heads.push(`unwrapped (below ${short(combinedRange(frequencies))} m)`);
    fill(parts.phasors, [["", "amplitude", "phase", ...heads], ...rows]);
    const said = phasors.map(({ phase }, k) => `${k + 1}: ${signed(phase.toFixed(2))} rad`).join(", ");
    parts.plane.setAttribute("aria-label", `Phasors of pixels in their plane, phases ${said}`);
  }

  /** The range-velocity map of the active pixel, or of all pixels if none is chosen. */
  drawRates(ink) {
    const { now, parts, recording } = this.explorer;
    const { axis, rateAxis } = recording.about;
    const chosen = now.pixels[now.active];
    const pixel = chosen && chosen[1] * recording.light.width + chosen[0];
    const dots = dotsOf(parts.rates);
    const key = `rates ${pixel} ${dots}`;
    if (!this.known.has(key)) {
      const light = recording.byRates(pixel);
      const top = Math.log10(light.reduce((a, b) => Math.max(a, b)) || 1);
      // The canvas may have fewer dots than there are bins
      const { cells, columns, rows } = largestOfCells(light, [axis.count, rateAxis.count], dots);
      const look = { low: top - RATE_DECADES, high: top, map: recording.part("map false"), width: columns };
      this.known.set(key, { top, image: canvasOf(paintMap(cells.map(Math.log10), look), columns, rows) });
    }
    const { top, image } = this.known.get(key);
    const range = { start: axis.start / 2, width: axis.width / 2, count: axis.count };
    const [low, high] = [0, rateAxis.count].map((bin) => (rateAxis.start + bin * rateAxis.width) / 2);
    const words = { quantity: "velocity, half the rate [m/s]", below: "range, half the path length [m]", inMeters: true };
    drawMap(parts.rates, range, { low, high }, image, words, ink);
    const of = chosen ? `Pixel ${named(recording, chosen)}` : "All pixels";
    parts.ratesOf.textContent = `${of}: up to ${short(10 ** top)}, black below 10${raised(-RATE_DECADES)} of that.`;
    parts.rates.setAttribute("aria-label", `Light over range and velocity. ${parts.ratesOf.textContent}`);
  }

  chip(k, dark) {
    const chip = make("button", { type: "button", className: "chip", title: `Choose pixel ${k + 1}` }, String(k + 1));
    chip.style.setProperty("--own", colorOf(k, dark));
    chip.classList.toggle("active", k === this.explorer.now.active);
    chip.addEventListener("click", () => this.explorer.set({ active: k }));
    return chip;
  }

  cross(k) {
    const cross = make("button", { type: "button", className: "cross", "aria-label": `Remove pixel ${k + 1}` }, "×");
    cross.addEventListener("click", () => removePixel(this.explorer, k));
    return cross;
  }

  // ----------------------------------------------------------------------------------- words

  /** Say what is under the pointer, or of the chosen pixel. */
  tell(pixel) {
    const { now, recording, parts } = this.explorer;
    const { about } = recording;
    const at = pixel ?? now.pixels[now.active];
    if (!at || !hasPixels(now)) {
      parts.readout.textContent = "";
      return;
    }
    const [column, row] = at;
    const words = [named(recording, at)];
    if (about.parts.points) {
      const points = recording.part("points");
      const [x, y] = [column * about.grid.step, row * about.grid.step];
      const from = 3 * (y * about.grid.width + x);
      words.push(`wall (${Array.from(points.slice(from, from + 3), (each) => short(each)).join(", ")}) m`);
    }
    words.push(this.measured(at));
    if (about.geometry.mode === "confocal") words.push("each point is lit by itself");
    parts.readout.textContent = words.join("  ·  ");
  }

  /** Time and the light of the chosen pixels. */
  spoken() {
    const { now, recording } = this.explorer;
    const pixels = now.pixels.map((pixel, k) => `pixel ${k + 1} ${named(recording, pixel)}, ${this.measured(pixel)}`);
    return pixels.join("; ");
  }

  /** What a pixel measures now. */
  measured([column, row]) {
    const { now, recording } = this.explorer;
    if (recording.hasTimes) return `${short(this.curve([column, row]).values[now.bin])} at ${when(recording, now.bin)}`;
    const { amplitude, phase } = recording.phasor(row * recording.light.width + column, now.frequency);
    return `amplitude ${short(amplitude)}, phase ${signed(phase.toFixed(3))} rad at ${hertz(now.frequency)}`;
  }
}
