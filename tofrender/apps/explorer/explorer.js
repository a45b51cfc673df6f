/**
 * An explorer of light in time. `mount(element, {header, bytes})` shows what Python's
 * `contents_of` has made and returns a handle:
 *
 * - `setData(data)` shows other data, in the same view if they have the same pixels and bins,
 * - `set({bin, view, pixels, gate, frequency, exposure, ...})` changes the view,
 * - `state()` returns the view and the numbers that it shows,
 * - `addPaths(list)` takes in paths that `askPaths` was asked for, as `plain_paths` of Python,
 * - `destroy()` removes the explorer.
 *
 * Below a capture with its volume is an explorer of the volume alone. Options: `level` of the
 * title's heading (2); `linked`, whether the page's address has the view; `askPaths(pixel, range)`,
 * which asks for the paths of a pixel of the film with lengths in a range [m].
 */

import { inkOf, isDark, make, watchLook } from "../ui/parts.js";
import { layout, makeParts, showControls, SPEEDS } from "./controls.js";
import { showMarkers, showPicture } from "./frame.js";
import { listen, pressed } from "./input.js";
import { keepLinked } from "./link.js";
import { Paths } from "./paths.js";
import { Pictures, viewsOf } from "./pictures.js";
import { STYLES } from "./plot.js";
import { largest, Recording, SPEED_OF_LIGHT } from "./recording.js";
import { Responses } from "./responses.js";
import { saveButtons } from "./save.js";
import { FRONT } from "./volume.js";
import { clamp, nanoseconds } from "./words.js";

export function mount(element, data, options = {}) {
  const explorer = new Explorer(element, data, options);
  const { volume } = data.header;
  const below = volume && new Explorer(element, { header: volume, bytes: data.bytes }, {});
  const handle = {
    setData: (next) => explorer.open(next),
    set: explorer.set,
    state: () => explorer.state(),
    addPaths: (list) => explorer.addPaths(list),
    destroy: () => [explorer, below].forEach((each) => each?.destroy()),
  };
  element.explorer = handle;
  return handle;
}

/**
 * `now` is what is shown, `recording` the data, `parts` the elements of the page. All changes go
 * through `set`, and `draw` shows them.
 */
class Explorer {
  constructor(element, data, { level = 2, linked = false, askPaths = null }) {
    Object.assign(this, { level, isLinked: linked, askPaths });
    this.element = element;
    this.root = make("section", { className: "tof-app tof-explorer", "data-lm-suppress-shortcuts": "true" });
    element.append(this.root);
    this.set = (changes) => this.change(changes);
    this.stopped = new AbortController();
    const { signal } = this.stopped;
    this.root.addEventListener("keydown", (event) => pressed(this, event), { signal });
    this.open(data);
    watchLook(this.root, () => this.draw(), signal);
    if (linked) keepLinked(this, signal);
  }

  destroy() {
    this.now.playing = false;
    this.stopped.abort();
    cancelAnimationFrame(this.asked);
    this.root.remove();
    delete this.element.explorer;
  }

  open(data) {
    const { header } = data;
    const shape = JSON.stringify([header.kind, header.axis, header.grid]);
    const kept = shape === this.shape ? this.now : null;
    this.shape = shape;
    this.recording = new Recording(data);
    this.pictures = new Pictures(this.recording);
    this.responses = new Responses(this);
    const lists = kept && this.askPaths ? this.paths.lists : header.paths;
    this.paths = new Paths(lists, this.level + 1, this.askPaths);
    this.now = opening(this.recording, this.pictures.white);
    this.parts = makeParts(this.recording, this.now, this.set);
    this.parts.saves = saveButtons(this);
    this.root.setAttribute("aria-label", `Explorer of ${header.title}`);
    this.root.replaceChildren(...layout(this.parts, this.recording, this.level));
    this.parts.frame.insertBefore(this.paths.lines, this.parts.markers);
    this.root.querySelector(".right > .panel").after(this.paths.element);
    listen(this);
    this.set({});
    this.first = structuredClone(this.now); // As links leave out
    if (kept) this.set({ laser: kept.laser, unwarped: kept.unwarped });
    if (kept) this.set(kept);
  }

  change(changes) {
    const { now, recording } = this;
    Object.assign(now, changes);
    now.laser = clamp(Math.round(now.laser), 0, recording.about.lasers - 1);
    if ("laser" in changes || "unwarped" in changes) {
      const before = recording.start + recording.typicalWay;
      recording.choose(now);
      this.pictures.forget();
      this.responses.forget();
      const later = (before - recording.start - recording.typicalWay) / recording.width;
      now.bin += later;
      now.gate = { ...now.gate, first: now.gate.first + later };
    }
    const { frequencies } = recording.about;
    if (frequencies && !frequencies.includes(now.frequency)) [now.frequency] = frequencies;
    const last = recording.count - 1;
    now.bin = clamp(Math.round(now.bin), 0, last);
    now.gate.count = clamp(Math.round(now.gate.count), 1, recording.count);
    now.gate.first = clamp(Math.round(now.gate.first), 0, recording.count - now.gate.count);
    now.pixels = now.pixels.slice(0, STYLES.length).map(([column, row]) => [
      clamp(Math.round(column), 0, recording.light.width - 1),
      clamp(Math.round(row), 0, recording.light.height - 1),
    ]);
    now.active = clamp(now.active, 0, Math.max(0, now.pixels.length - 1));
    if (changes.view === "phasor" || changes.view === "gate") now.playing = false;
    if (changes.playing) this.play();
    this.draw();
  }

  /** What is shown, with the numbers behind it. */
  state() {
    const { now, recording, responses } = this;
    return {
      ...structuredClone(now),
      opl: recording.center(now.bin),
      ns: nanoseconds(recording.center(now.bin)),
      bins: recording.count,
      start: recording.start,
      gain: this.gain,
      milliseconds: this.milliseconds,
      curves: responses.curves().map(plainCurve),
      rows: recording.hasOneBin ? responses.profiles() : null,
      paths: this.paths.lists,
      phasors: recording.hasPhasors ? responses.phasors() : [],
    };
  }

  play() {
    cancelAnimationFrame(this.playing);
    let last = performance.now();
    const next = (time) => {
      if (!this.now.playing) return;
      const pause = 1000 / SPEEDS[this.now.speed];
      const steps = Math.floor((time - last) / pause);
      if (steps > 0) {
        last += steps * pause;
        const forward = Math.min(steps, 4); // Rather slow than jumping
        this.set({ bin: (this.now.bin + forward) % this.recording.count });
      }
      this.playing = requestAnimationFrame(next);
    };
    if (this.now.view !== "space") this.now.view = "light";
    this.playing = requestAnimationFrame(next);
  }

  /** Draw before the screen is shown next, once however often it is asked for. */
  draw() {
    cancelAnimationFrame(this.asked);
    this.asked = requestAnimationFrame(() => {
      const begun = performance.now();
      this.drawNow();
      this.milliseconds = performance.now() - begun;
    });
  }

  drawNow() {
    const { now, parts, recording, root } = this;
    const dark = isDark(this.element);
    root.classList.toggle("dark", dark);
    showControls(parts, recording, now);
    const picture = this.pictures.of(now);
    if (picture.gain) this.gain = picture.gain;
    showPicture(parts, picture, now.smooth);
    const isPlain = now.stokes === "S0";
    for (const [part, works] of [
      [parts.exposure, picture.gain],
      [parts.gamma, picture.gain],
      [parts.colors, picture.gain && isPlain],
      [parts.stokes, ["light", "gate", "total"].includes(now.view)],
    ]) {
      part.classList.toggle("idle", !works);
      part.inert = !works;
    }
    const [, name] = viewsOf(recording).find(([view]) => view === now.view);
    const { canvas } = picture.scene ? parts.space : parts;
    canvas.setAttribute("aria-label", `${name} of ${recording.about.title}, ${picture.says}`);
    showMarkers(parts, recording, now, dark);
    this.responses.draw(dark, inkOf(root));
    this.showPaths();
    this.tell(null);
    this.shown?.();
  }

  addPaths(list) {
    this.paths.add(list);
    this.draw();
  }

  /** Show the paths of the chosen pixel, with lengths of what is shown; none while it plays. */
  showPaths() {
    const { now, recording } = this;
    const chosen = now.playing ? null : now.pixels[now.active];
    const shown = { light: { first: now.bin, count: 1 }, gate: now.gate };
    const { first, count } = shown[now.view] ?? { first: 0, count: recording.count };
    const way = chosen && recording.unwarped ? recording.distances[chosen[1] * recording.light.width + chosen[0]] : 0;
    const range = [first, first + count].map((bin) => recording.edge(bin) + way);
    this.paths.show(chosen && recording.place(chosen), range, recording.about.grid);
  }

  tell(pixel) {
    this.responses.tell(pixel);
  }

  speak() {
    this.parts.spoken.textContent = this.responses.spoken();
  }
}

/** What an explorer shows first. */
function opening(recording, brightest) {
  const { about, count, isVolume } = recording;
  const limit = SPEED_OF_LIGHT / (2 * about.axis.width);
  const bin = isVolume ? largestSlice(recording) : brightestBin(recording, brightest);
  const gate = Math.max(1, Math.round(count / 12));
  return {
    view: about.frequencies ? "phasor" : about.volume ? "space" : "light",
    ...FRONT,
    threshold: 0.2,
    bin,
    playing: false,
    speed: "1",
    exposure: 0,
    gamma: 2.2,
    colors: isVolume ? "false" : recording.weights.length === 3 ? "color" : "gray",
    smooth: about.grid.step > 1,
    pixels: about.paths.length ? about.paths.map(({ pixel }) => recording.at(pixel)) : tellingPixels(recording),
    active: 0,
    channel: "luminance",
    stokes: "S0",
    log: false,
    gate: { first: bin - Math.floor(gate / 2), count: gate },
    frequency: about.frequencies?.[0] ?? Math.min(50e6, limit / 2),
    phasor: "depth",
    laser: 0,
    unwarped: false,
  };
}

/** The bin whose picture is brightest as it is shown. */
function brightestBin({ light, about }, brightest) {
  const shown = light.values.map((value) => Math.min(1, value / brightest) ** (1 / 2.2));
  let [best, most] = [0, -1];
  for (let bin = 0; bin < about.axis.count; bin++) {
    let sum = 0;
    const stop = light.at(bin + 1, 0);
    for (let at = light.at(bin, 0); at < stop; at++) sum += shown[light.codes[at]];
    if (sum > most) [best, most] = [bin, sum];
  }
  return best;
}

/** The slice with the largest voxel. */
function largestSlice({ light }) {
  const largestOf = (bin) => light.codes.subarray(light.at(bin, 0), light.at(bin + 1, 0)).reduce((a, b) => Math.max(a, b));
  const most = Array.from({ length: light.bins }, (_, bin) => largestOf(bin));
  return most.indexOf(Math.max(...most));
}

/** A bright pixel, and one as bright as half of them. */
function tellingPixels(recording) {
  const { light, isVolume } = recording;
  const total = isVolume ? largest(light) : recording.luminance(recording.gate(0, recording.count));
  const order = Array.from(total.keys()).filter((i) => total[i] > 0);
  order.sort((a, b) => total[a] - total[b]);
  const found = (isVolume ? [1] : [0.93, 0.5]).map((part) => order[Math.floor(part * (order.length - 1))] ?? 0);
  return [...new Set(found)].map((i) => [i % light.width, Math.floor(i / light.width)]);
}

/** A curve with arrays that JSON can hold. */
function plainCurve({ values, errors, orders, components, ...more }) {
  return {
    ...more,
    values: Array.from(values),
    errors: errors && Array.from(errors),
    orders: orders.map(({ name, values: own }) => ({ name, values: Array.from(own) })),
  };
}
