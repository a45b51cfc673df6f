/**
 * An explorer of light in time. `mount(element, {header, bytes})` shows what Python's
 * `contents_of` has made and returns a handle:
 *
 * - `setData(data)` shows other data, in the same view if they have the same pixels and bins,
 * - `set({bin, view, pixels, gate, frequency, exposure, ...})` changes the view,
 * - `state()` returns the view and the numbers that it shows,
 * - `destroy()` removes the explorer.
 */

import {
  choices,
  fill,
  follow,
  isDark,
  lineSwatch,
  list,
  make,
  slider,
  tick,
} from "../ui/parts.js";
import { paintLight, paintMap, range, toneCurve, white, whiteOfAll } from "./picture.js";
import { Axes, drawCurves, drawPhasors, short, signed, STYLES } from "./plot.js";
import { largest, largestAcross, phasorParts, Recording, SPEED_OF_LIGHT } from "./recording.js";

const NEAR = 14; // px, of a marker or a gate's edge
const DASHES = [[4, 2], [1, 2], [8, 2, 2, 2], [2, 4], [10, 4], [1, 5]]; // of bounce orders
const SPEEDS = { "½": 10, 1: 20, 2: 40, 4: 80 }; // bins a second

export function mount(element, data) {
  const explorer = new Explorer(element, data);
  const handle = {
    setData: (next) => explorer.open(next),
    set: (changes) => explorer.set(changes),
    state: () => explorer.state(),
    destroy: () => explorer.destroy(),
  };
  element.explorer = handle;
  return handle;
}

class Explorer {
  constructor(element, data) {
    this.element = element;
    this.root = make("section", { className: "tof-app tof-explorer", "data-lm-suppress-shortcuts": "true" });
    element.append(this.root);
    this.stopped = new AbortController();
    const { signal } = this.stopped;
    this.root.addEventListener("keydown", (event) => this.pressed(event), { signal });
    const redraw = () => this.draw();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw, { signal });
    this.sizes = new ResizeObserver(redraw);
    this.themes = new MutationObserver(redraw);
    for (const watched of [document.body, document.documentElement]) {
      this.themes.observe(watched, { attributes: true });
    }
    this.open(data);
  }

  destroy() {
    this.now.playing = false;
    this.stopped.abort();
    this.sizes.disconnect();
    this.themes.disconnect();
    cancelAnimationFrame(this.asked);
    this.root.remove();
    delete this.element.explorer;
  }

  // ------------------------------------------------------------------------------- what is shown

  open(data) {
    const { header } = data;
    const shape = JSON.stringify([header.kind, header.axis, header.grid]);
    const kept = shape === this.shape ? this.now : null;
    this.shape = shape;
    this.recording = new Recording(data);
    this.about = header;
    this.isVolume = header.kind === "volume";
    this.curves = new Map();
    this.forget();
    const limit = SPEED_OF_LIGHT / (2 * header.axis.width);
    this.now = {
      view: "light",
      bin: 0,
      playing: false,
      speed: "1",
      exposure: 0,
      gamma: 2.2,
      colours: this.isVolume ? "false" : "colour",
      smooth: header.grid.step > 1,
      pixels: [],
      active: 0,
      channel: "luminance",
      log: false,
      gate: { first: 0, count: 1 },
      frequency: Math.min(50e6, limit / 2),
      phasor: "depth",
      laser: 0,
      unwarped: false,
    };
    this.white = whiteOfAll(this.recording.light);
    this.now.bin = this.brightestBin();
    this.now.gate = this.firstGate();
    this.now.pixels = this.tellingPixels();
    this.build();
    this.set(kept ? { laser: kept.laser, unwarped: kept.unwarped } : {});
    if (kept) this.set(kept);
  }

  /** Drop what was computed of a laser, or of unwarped time. */
  forget() {
    this.curves.clear();
    this.known = {};
  }

  /** Change what is shown: the one way in, for the page's parts and for others. */
  set(changes) {
    const { now, recording } = this;
    Object.assign(now, changes);
    if ("laser" in changes || "unwarped" in changes) {
      const before = recording.start + recording.typicalWay;
      recording.choose(now);
      this.forget();
      const later = (before - recording.start - recording.typicalWay) / recording.width;
      now.bin += later;
      now.gate = { ...now.gate, first: now.gate.first + later };
    }
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
    const { now, recording } = this;
    return {
      ...structuredClone(now),
      opl: recording.centre(now.bin),
      ns: nanoseconds(recording.centre(now.bin)),
      bins: recording.count,
      start: recording.start,
      gain: this.gain,
      milliseconds: this.milliseconds,
      curves: now.pixels.map((pixel, k) => plainCurve(this.curve(pixel, k))),
      phasors: this.isVolume ? [] : this.phasors(),
    };
  }

  /** The bin whose picture is brightest as it is shown. */
  brightestBin() {
    const { light, about } = this.recording;
    const shown = light.values.map((value) => Math.min(1, value / this.white) ** (1 / 2.2));
    let [best, most] = [0, -1];
    for (let bin = 0; bin < about.axis.count; bin++) {
      let sum = 0;
      const stop = light.at(bin + 1, 0);
      for (let at = light.at(bin, 0); at < stop; at++) sum += shown[light.codes[at]];
      if (sum > most) [best, most] = [bin, sum];
    }
    return best;
  }

  firstGate() {
    const count = Math.max(1, Math.round(this.recording.count / 12));
    return { first: this.now.bin - Math.floor(count / 2), count };
  }

  /** A bright pixel, and one as bright as half of them. */
  tellingPixels() {
    const { light } = this.recording;
    const total = this.isVolume ? largest(light) : this.luminance(this.recording.gate(0, this.recording.count));
    const order = Array.from(total.keys()).filter((i) => total[i] > 0);
    order.sort((a, b) => total[a] - total[b]);
    const found = (this.isVolume ? [1] : [0.93, 0.5]).map((part) => order[Math.floor(part * (order.length - 1))] ?? 0);
    return [...new Set(found)].map((i) => [i % light.width, Math.floor(i / light.width)]);
  }

  luminance(planes) {
    return planes[0].map((_, i) =>
      planes.reduce((sum, plane, c) => sum + this.recording.weights[c] * plane[i], 0),
    );
  }

  // ------------------------------------------------------------------------------------ the page

  build() {
    const { about, isVolume, recording } = this;
    const set = (changes) => this.set(changes);
    this.parts = {};
    const { parts } = this;
    parts.views = choices("Picture", this.views(), (view) => set({ view }));
    parts.canvas = make("canvas", { className: "tof-picture", role: "img" });
    parts.markers = make("div", { className: "markers", "aria-hidden": "true" });
    parts.frame = make("div", {
      className: "frame",
      tabIndex: 0,
      role: "group",
      "aria-label": "Picture; arrow keys move the chosen pixel, Enter adds one, Delete removes it",
    });
    parts.frame.append(parts.canvas, parts.markers);
    parts.bar = make("div", { className: "bar" });
    parts.assumes = make("p", { className: "assumes" });
    parts.readout = make("p", { className: "readout" });
    parts.play = make("button", { type: "button", className: "play" });
    parts.play.addEventListener("click", () => set({ playing: !this.now.playing }));
    parts.time = slider(isVolume ? "Depth" : "Time", {
      ...{ min: 0, max: recording.count - 1, step: 1, value: 0 },
      say: (bin) => this.when(bin),
      moved: (bin) => set({ bin, playing: false }),
    });
    parts.speed = list("Speed", Object.keys(SPEEDS).map((each) => [each, `${each}×`]), (speed) =>
      set({ speed }),
    );
    parts.gateStart = slider("Opens", {
      ...{ min: 0, max: recording.count - 1, step: 1, value: 0 },
      say: (first) => `${this.length(recording.start + first * recording.width)}`,
      moved: (first) => set({ gate: { ...this.now.gate, first } }),
    });
    parts.gateWidth = slider("Width", {
      ...{ min: 1, max: recording.count, step: 1, value: 1 },
      say: (count) => `${this.length(count * recording.width)}`,
      moved: (count) => set({ gate: { ...this.now.gate, count } }),
    });
    parts.exposure = slider("Exposure", {
      ...{ min: -8, max: 8, step: 0.1, value: 0 },
      say: (stops) => `${stops > 0 ? "+" : ""}${signed(stops.toFixed(1))} EV`,
      moved: (exposure) => set({ exposure }),
    });
    parts.gamma = slider("Gamma", {
      ...{ min: 1, max: 5, step: 0.1, value: 2.2 },
      say: (gamma) => gamma.toFixed(1),
      moved: (gamma) => set({ gamma }),
    });
    const colours = [["colour", "as rendered"], ["grey", "grey"], ["false", "false colour"]];
    parts.colours = list("Colours", recording.weights.length === 3 ? colours : colours.slice(1), (each) =>
      set({ colours: each }),
    );
    parts.smooth = tick("Smooth", (smooth) => set({ smooth }));
    parts.unwarped = tick("Without the camera segment", (unwarped) => set({ unwarped }));
    parts.unwarped.hidden = !recording.distances;
    parts.laser = slider("Lit point", {
      ...{ min: 0, max: about.lasers - 1, step: 1, value: 0 },
      say: (laser) => `${laser + 1} of ${about.lasers}`,
      moved: (laser) => set({ laser }),
    });
    parts.laser.hidden = about.lasers < 2;
    const channels = [["luminance", "luminance"], ["0", "red"], ["1", "green"], ["2", "blue"]];
    parts.channel = list("Of", channels, (channel) => set({ channel }));
    parts.channel.hidden = recording.weights.length < 3;
    parts.log = tick("Logarithmic", (log) => set({ log }));
    parts.plot = make("canvas", { className: "plot", role: "img" });
    parts.legend = make("p", { className: "legend" });
    parts.pixels = make("table");
    parts.phasorView = choices("Phasor", PHASORS, (phasor) => set({ phasor, view: "phasor" }));
    const limit = Math.log10(SPEED_OF_LIGHT / (2 * about.axis.width));
    parts.frequency = slider("Frequency", {
      ...{ min: Math.min(6, limit - 1), max: limit, step: 0.001, value: Math.log10(this.now.frequency) },
      say: (power) => hertz(10 ** power),
      title: "Modulation frequency of the light",
      moved: (power) => set({ frequency: 10 ** power }),
    });
    parts.plane = make("canvas", { className: "plane", role: "img" });
    parts.phasors = make("table");
    parts.spoken = make("div", { className: "spoken", role: "status" });
    this.root.setAttribute("aria-label", `Explorer of ${about.title}`);
    this.root.replaceChildren(...this.layout());
    this.listen();
    this.sizes.disconnect();
    this.sizes.observe(this.root);
  }

  views() {
    if (this.isVolume) {
      return [
        ["light", "Slice", "At one depth"],
        ["front", "Front", "Largest value along the depth"],
        ["side", "Side", "Largest value along x"],
        ["top", "Top", "Largest value along y"],
        ["peak", "Depth", "Depth of the largest value"],
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
    return views.filter(([view]) => view !== "depth" || this.about.depth);
  }

  layout() {
    const { about, parts } = this;
    const panel = (title, ...children) =>
      make("section", { className: "panel", "aria-label": title }, ...children);
    parts.transport = make("div", { className: "transport" }, parts.play, parts.time, parts.speed);
    parts.gates = make("div", { className: "transport" }, parts.gateStart, parts.gateWidth);
    const look = make("div", { className: "look" });
    look.append(parts.exposure, parts.gamma, parts.colours, parts.smooth, parts.unwarped, parts.laser);
    const left = make("div", { className: "left" });
    left.append(parts.views, parts.frame, parts.bar, parts.assumes, parts.readout);
    left.append(parts.transport, parts.gates, look);
    const heading = (title, ...more) => make("div", { className: "heading" }, make("h3", {}, title), ...more);
    const response = panel(
      this.isVolume ? "Along the depth" : "Response",
      heading(this.isVolume ? "Along the depth" : "Response of pixels", parts.channel, parts.log),
      ...[parts.plot, parts.legend, parts.pixels],
    );
    const plane = make("div", { className: "beside" }, parts.plane, parts.phasors);
    const phasor = panel("Phasors", heading("Phasors", parts.phasorView), parts.frequency, plane);
    phasor.hidden = this.isVolume;
    const right = make("div", { className: "right" }, response, phasor);
    const told = make("dl");
    for (const [name, value] of about.facts) {
      told.append(make("dt", {}, name), make("dd", {}, value));
    }
    const notes = make("ul", {}, ...about.notes.map((note) => make("li", {}, note)));
    const more = make("details", {}, make("summary", {}, "Contents and precision"), notes);
    more.append(told, make("p", {}, KEYS));
    const [, size] = about.facts[0];
    const header = make("header", {}, make("h2", {}, about.title), make("p", {}, size));
    return [header, make("div", { className: "stage" }, left, right), more, parts.spoken];
  }

  listen() {
    const { parts } = this;
    follow(parts.frame, {
      down: (event) => this.grab(event),
      move: (event, held) => this.drag(event, held),
      tap: (event) => this.addPixel(this.under(event)),
    });
    parts.frame.addEventListener("pointermove", (event) => this.tell(this.under(event)));
    parts.frame.addEventListener("pointerleave", () => this.tell(null));
    parts.frame.addEventListener("keydown", (event) => this.pressedInPicture(event));
    follow(parts.plot, {
      down: (event) => this.grabInPlot(event),
      move: (event, held) => this.dragInPlot(event, held),
    });
  }

  // --------------------------------------------------------------------------------- the reader

  /** Column and row under a pointer, as fractions of the light's pixels. */
  under(event) {
    const { left, top, width, height } = this.parts.frame.getBoundingClientRect();
    const { light } = this.recording;
    const column = Math.floor(((event.clientX - left) / width) * light.width);
    const row = Math.floor(((event.clientY - top) / height) * light.height);
    return [clamp(column, 0, light.width - 1), clamp(row, 0, light.height - 1)];
  }

  get hasPixels() {
    return !["side", "top"].includes(this.now.view);
  }

  /** The number of a marker near a pointer, -1 if there is none. */
  markerAt(event) {
    const { left, top, width, height } = this.parts.frame.getBoundingClientRect();
    const { light } = this.recording;
    const away = this.now.pixels.map(([column, row]) =>
      Math.hypot(
        left + ((column + 0.5) / light.width) * width - event.clientX,
        top + ((row + 0.5) / light.height) * height - event.clientY,
      ),
    );
    const nearest = away.indexOf(Math.min(...away));
    return away[nearest] <= NEAR ? nearest : -1;
  }

  grab(event) {
    if (!this.hasPixels) return null;
    const found = this.markerAt(event);
    this.parts.frame.focus({ preventScroll: true });
    if (found >= 0) {
      this.set({ active: found });
      return { marker: found };
    }
    if (event.pointerType === "touch") return null; // It may be to scroll: a tap adds
    this.addPixel(this.under(event));
    return { marker: this.now.active };
  }

  drag(event, { marker }) {
    const pixels = [...this.now.pixels];
    pixels[marker] = this.under(event);
    this.set({ pixels, active: marker });
  }

  addPixel(pixel) {
    const { pixels, active } = this.now;
    if (pixels.length < STYLES.length) {
      this.set({ pixels: [...pixels, pixel], active: pixels.length });
    } else {
      this.set({ pixels: pixels.map((each, k) => (k === active ? pixel : each)) });
    }
  }

  removePixel(number) {
    this.set({ pixels: this.now.pixels.filter((_, k) => k !== number), active: number - 1 });
  }

  grabInPlot(event) {
    const { gate, view } = this.now;
    const axes = new Axes(this.parts.plot, this.recording);
    const x = event.clientX - this.parts.plot.getBoundingClientRect().left;
    const bin = axes.bin(x);
    if (view !== "gate") {
      this.set({ bin, view: this.isVolume ? view : "light", playing: false });
      return { what: "time" };
    }
    const edges = [gate.first, gate.first + gate.count].map((k) => axes.x(axes.start + k * axes.width));
    const away = edges.map((edge) => Math.abs(edge - x));
    if (Math.min(...away) <= NEAR) {
      return { what: "edge", other: away[0] < away[1] ? gate.first + gate.count : gate.first };
    }
    if (x < edges[0] || x > edges[1]) this.set({ gate: { ...gate, first: bin - Math.floor(gate.count / 2) } });
    return { what: "gate", ahead: bin - this.now.gate.first };
  }

  dragInPlot(event, { what, other, ahead }) {
    const axes = new Axes(this.parts.plot, this.recording);
    const x = event.clientX - this.parts.plot.getBoundingClientRect().left;
    const { gate } = this.now;
    if (what === "time") {
      this.set({ bin: axes.bin(x) });
    } else if (what === "gate") {
      this.set({ gate: { ...gate, first: axes.bin(x) - ahead } });
    } else {
      const edge = clamp(Math.round((axes.opl(x) - axes.start) / axes.width), 0, axes.count);
      const first = Math.min(edge, other);
      this.set({ gate: { first, count: Math.max(1, Math.abs(edge - other)) } });
    }
  }

  pressed(event) {
    const { key, target, shiftKey } = event;
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const own = target.matches("input, select");
    if (own) event.stopPropagation(); // Notebooks have other uses for arrows
    const { bin, gate, playing, view } = this.now;
    const steps = { ArrowLeft: -1, ArrowRight: 1, Home: -Infinity, End: Infinity };
    if (key === " " && !target.matches("button, select, summary, input[type=checkbox]")) {
      this.set({ playing: !playing });
    } else if (key in steps && !own) {
      const step = steps[key] * (shiftKey ? 10 : 1);
      if (view === "gate") this.set({ gate: { ...gate, first: gate.first + step } });
      else this.set({ bin: bin + step, playing: false });
      this.speak();
    } else return;
    event.preventDefault();
    event.stopPropagation();
  }

  pressedInPicture(event) {
    const { pixels, active } = this.now;
    const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    const far = event.shiftKey ? 10 : 1;
    if (event.key in steps && pixels.length) {
      const [across, down] = steps[event.key];
      const [column, row] = pixels[active];
      const moved = [column + far * across, row + far * down];
      this.set({ pixels: pixels.map((each, k) => (k === active ? moved : each)) });
    } else if (event.key === "Enter") {
      const { width, height } = this.recording.light;
      const [column, row] = pixels[active] ?? [width / 2, height / 2];
      this.addPixel([column + Math.round(width / 16), row]);
    } else if (event.key === "Delete" || event.key === "Backspace") {
      this.removePixel(active);
    } else if (/^[1-6]$/.test(event.key)) {
      this.set({ active: Number(event.key) - 1 });
    } else return;
    this.speak();
    event.preventDefault();
    event.stopPropagation();
  }

  play() {
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
      requestAnimationFrame(next);
    };
    if (this.now.view !== "light") this.now.view = "light";
    requestAnimationFrame(next);
  }

  // ----------------------------------------------------------------------------------- drawing

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
    const { now, parts, root } = this;
    const dark = isDark(this.element);
    root.classList.toggle("dark", dark);
    for (const name of ["exposure", "gamma", "colours", "smooth", "unwarped", "laser", "channel", "log"]) {
      parts[name].set(now[name]);
    }
    parts.views.set(now.view);
    parts.speed.set(now.speed);
    parts.phasorView.set(now.view === "phasor" ? now.phasor : "");
    parts.frequency.set(Math.log10(now.frequency));
    parts.time.limit(this.recording.count - 1);
    parts.time.set(now.bin);
    parts.gateStart.limit(this.recording.count - now.gate.count);
    parts.gateStart.set(now.gate.first);
    parts.gateWidth.limit(this.recording.count);
    parts.gateWidth.set(now.gate.count);
    parts.play.setAttribute("aria-label", now.playing ? "Pause" : "Play");
    parts.play.classList.toggle("playing", now.playing);
    parts.transport.hidden = now.view === "gate";
    parts.gates.hidden = now.view !== "gate";
    this.drawPicture();
    this.drawMarkers(dark);
    this.drawResponses(dark);
    if (!this.isVolume) this.drawPhasors(dark);
    this.tell(null);
  }

  drawPicture() {
    const { parts, now, about } = this;
    const picture = this.picture();
    const { width, height, bytes } = picture;
    const { canvas, frame } = parts;
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    canvas.getContext("2d").putImageData(new ImageData(bytes, width, height), 0, 0);
    frame.style.aspectRatio = `${picture.aspect ?? width / height}`;
    frame.classList.toggle("smooth", now.smooth);
    const isLight = picture.map === undefined;
    for (const part of [parts.exposure, parts.gamma, parts.colours]) {
      part.classList.toggle("idle", !isLight);
    }
    this.drawBar(picture);
    const name = this.views().find(([view]) => view === now.view)[1];
    canvas.setAttribute("aria-label", `${name} of ${about.title}, ${picture.says}`);
    parts.assumes.textContent = picture.assumes ?? "";
    parts.assumes.hidden = !picture.assumes;
  }

  /** Bytes, width and height of what is to be seen, and what it says. */
  picture() {
    const { now, recording, known, isVolume } = this;
    const of = { light: recording.light, width: recording.light.width };
    switch (now.view) {
      case "total":
        known.total ??= recording.total();
        known.totalWhite ??= white(known.total);
        return this.lit(known.total, known.totalWhite, recording.steady ?? of.light, "at all times");
      case "gate": {
        const { first, count } = now.gate;
        const planes = recording.gate(first, count);
        const says = `what arrives from ${this.length(this.edge(first))} to ${this.length(this.edge(first + count))}`;
        return this.lit(planes, white(planes), of.light, says);
      }
      case "peak":
      case "depth":
        return this.peaks(now.view === "depth");
      case "phasor":
        return this.phasorPicture();
      case "front":
        known.front ??= largest(of.light);
        return this.lit([known.front], this.white, of.light, "largest along the depth");
      case "side":
      case "top":
        return this.across(now.view);
      default: {
        const planes = recording.frame(now.bin);
        const where = isVolume ? "at a depth of" : "at";
        return this.lit(planes, this.white, of.light, `${where} ${this.when(now.bin)}`);
      }
    }
  }

  lit(planes, brightest, { width, height }, says) {
    const { now, recording } = this;
    if (this.curveOf !== now.gamma) {
      this.curveOf = now.gamma;
      this.toneCurve = toneCurve(now.gamma);
    }
    this.gain = 2 ** now.exposure / brightest;
    const map = now.colours === "false" ? recording.part("map false") : null;
    const bytes = paintLight(planes, {
      ...{ gain: this.gain, curve: this.toneCurve, map, width },
      weights: now.colours === "colour" ? null : recording.weights,
      hatch: this.hatch(width, height),
    });
    return { bytes, width, height, says, scale: map && { map, high: 1 / this.gain, gamma: now.gamma } };
  }

  peaks(isDepth) {
    const { recording, about, isVolume } = this;
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

  phasorPicture() {
    const { now, recording, known } = this;
    const { width, height } = recording.light;
    if (known.phasorsAt !== now.frequency) {
      known.phasorsAt = now.frequency;
      known.phasors = recording.phasors(now.frequency);
    }
    const { re, im } = known.phasors;
    const values = re.map((_, i) => {
      const parts = phasorParts(re[i], im[i], now.frequency);
      return parts.amplitude > 0 ? parts[now.phasor] : NaN;
    });
    const wrapped = SPEED_OF_LIGHT / (2 * now.frequency);
    const limits = {
      amplitude: [0, range(values, 0.005)[1], ""],
      phase: [-Math.PI, Math.PI, "rad"],
      depth: [0, wrapped, "m"],
    };
    const [low, high, unit] = limits[now.phasor];
    const maps = { amplitude: "map false", phase: "map phase", depth: "map distance" };
    const map = recording.part(maps[now.phasor]);
    const assumes = {
      amplitude: `|P| of P = Σ L exp(+i 2π f OPL / c), at ${hertz(now.frequency)}.`,
      phase: `Phase of P = Σ L exp(+i 2π f OPL / c), at ${hertz(now.frequency)}.`,
      depth: `Depth = c (phase mod 2π) / 4π f, which wraps at c / 2f = ${short(wrapped)} m. ` +
        "It assumes that light source and camera coincide, and a single bounce.",
    }[now.phasor];
    const bytes = paintMap(values, { low, high, map, width });
    return { bytes, width, height, says: hertz(now.frequency), assumes, map, low, high, unit };
  }

  across(view) {
    const { recording, about, known } = this;
    known[view] ??= largestAcross(recording.light, view);
    const { bins } = recording.light;
    const isSide = view === "side";
    const [width, height] = isSide ? [bins, recording.light.height] : [recording.light.width, bins];
    const along = about.geometry[isSide ? "y" : "x"];
    const deep = recording.count * recording.width;
    const long = Math.abs(along[1]) * about.grid[isSide ? "height" : "width"];
    const picture = this.lit([known[view]], this.white, { width, height }, "largest value");
    const assumes = isSide
      ? `Left to right: ${this.length(recording.start)} to ${this.length(recording.start + deep)} from the wall.`
      : `Top to bottom: ${this.length(recording.start)} to ${this.length(recording.start + deep)} from the wall.`;
    return { ...picture, aspect: isSide ? deep / long : long / deep, assumes };
  }

  /** Where nothing is known, for a picture of this size. */
  hatch(width, height) {
    if (!this.about.parts.hatch) return null;
    const { grid } = this.about;
    if (height * width > grid.height * grid.width) return null;
    const full = this.recording.part("hatch");
    const step = Math.ceil(grid.width / width);
    return Uint8Array.from(
      { length: width * height },
      (_, i) => full[Math.floor(i / width) * step * grid.width + (i % width) * step],
    );
  }

  drawBar({ map, low, high, unit, scale }) {
    const { bar } = this.parts;
    const colours = map ?? scale?.map;
    bar.hidden = !colours;
    if (!colours) return;
    const strip = make("canvas", { width: 256, height: 1 });
    const bytes = new Uint8ClampedArray(1024).fill(255);
    for (let i = 0; i < 256; i++) bytes.set(colours.subarray(3 * i, 3 * i + 3), 4 * i);
    strip.getContext("2d").putImageData(new ImageData(bytes, 256, 1), 0, 0);
    const parts = [0, 0.25, 0.5, 0.75, 1];
    const says = parts.map((part) =>
      map ? short(low + part * (high - low)) : short(part ** scale.gamma * scale.high, 2),
    );
    says[4] += unit ? ` ${unit}` : "";
    bar.replaceChildren(strip, make("div", {}, ...says.map((each) => make("span", {}, each))));
  }

  drawMarkers(dark) {
    const { now, recording, about, parts } = this;
    const { width, height } = recording.light;
    const place = (element, column, row) => {
      element.style.left = `${(100 * (column + 0.5)) / width}%`;
      element.style.top = `${(100 * (row + 0.5)) / height}%`;
      return element;
    };
    const markers = now.pixels.map(([column, row], k) => {
      const marker = make("div", { className: k === now.active ? "marker active" : "marker" }, String(k + 1));
      marker.style.setProperty("--own", colourOf(k, dark));
      return place(marker, column, row);
    });
    const { step } = about.grid;
    const lasers = (about.geometry.lasers ?? []).map(([column, row], k) => {
      const laser = make("div", { className: k === now.laser ? "laser active" : "laser" });
      return place(laser, (column + 0.5) / step - 0.5, (row + 0.5) / step - 0.5);
    });
    parts.markers.replaceChildren(...(this.hasPixels ? [...lasers, ...markers] : []));
  }

  /** The response of a pixel: luminance or one channel, and its standard error. */
  curve([column, row], k = -1) {
    const { now, recording } = this;
    const name = `${column} ${row} ${now.channel}`;
    if (!this.curves.has(name)) {
      if (this.curves.size > 200) this.curves.clear();
      const pixel = row * recording.light.width + column;
      const weights = recording.weights.map((weight, c) =>
        now.channel === "luminance" ? weight : Number(String(c) === now.channel),
      );
      const found = { values: recording.response(pixel, weights), pixel };
      if (recording.errors) found.errors = recording.response(pixel, weights, recording.errors);
      found.orders = recording.orders.map((layer) => ({
        name: layer.name,
        values: recording.response(pixel, weights, layer),
      }));
      this.curves.set(name, found);
    }
    const [x, y] = this.place([column, row]);
    return { ...this.curves.get(name), x, y, style: Math.max(0, k) };
  }

  /** Coordinates of a pixel in the whole film; of a block of pixels, those of its first one. */
  place([column, row]) {
    const { first, step } = this.about.grid;
    return [first[0] + column * step, first[1] + row * step];
  }

  named(pixel) {
    const [x, y] = this.place(pixel);
    const { step } = this.about.grid;
    if (this.isVolume) {
      const { geometry } = this.about;
      const at = ([start, size], k) => short(start + (k + step / 2) * size);
      return `x ${at(geometry.x, x)} m, y ${at(geometry.y, y)} m`;
    }
    return step === 1 ? `(${x}, ${y})` : `(${x}–${x + step - 1}, ${y}–${y + step - 1})`;
  }

  drawResponses(dark) {
    const { now, parts, recording, about, isVolume } = this;
    const curves = now.pixels.map((pixel, k) => this.curve(pixel, k));
    const active = curves[now.active];
    const orders = (active?.orders ?? []).map(({ values }, k) => ({
      ...{ values, style: active.style, faint: DASHES[k % DASHES.length] },
    }));
    const marks = now.view === "gate" ? { gate: now.gate } : { bin: now.bin };
    const what = recording.unwarped ? about.axis.what.replace("included", "left out") : about.axis.what;
    const words = isVolume
      ? { quantity: about.quantity, below: `${what} [m]`, inMetres: true }
      : { quantity: about.quantity, below: "time [ns]", above: `${what} [m]` };
    const narrow = parts.plot.clientWidth < 480;
    if (narrow && words.above) words.above = "optical path length [m]";
    const ink = this.ink();
    drawCurves(parts.plot, recording, [...orders, ...curves], marks, words, { log: now.log, dark, ink });
    parts.plot.setAttribute("aria-label", `${words.quantity} over ${words.below} of ${this.spoken()}`);
    this.drawLegend(active, dark);
    const shown = isVolume ? "here" : now.view === "gate" ? "in the gate" : "now";
    const rows = curves.map(({ values }, k) => {
      const peak = values.indexOf(values.reduce((a, b) => Math.max(a, b), 0));
      const light = now.view === "gate"
        ? values.slice(now.gate.first, now.gate.first + now.gate.count).reduce((a, b) => a + b, 0)
        : values[now.bin];
      const at = recording.centre(peak);
      const when = isVolume ? [`${short(at, 4)} m`] : [`${short(nanoseconds(at), 4)} ns`, `${short(at, 4)} m`];
      return [this.chip(k, dark), this.named(now.pixels[k]), short(light), ...when, this.cross(k)];
    });
    const headings = isVolume
      ? ["", "column", shown, "brightest at", ""]
      : ["", "pixel", shown, "peak time", "peak path", ""];
    fill(parts.pixels, [headings, ...rows]);
  }

  /** What thin lines and bars are. */
  drawLegend(active, dark) {
    const { parts, recording, now } = this;
    const words = recording.errors ? ["Bars and bands are one standard error."] : [];
    if (active?.orders.length) words.push(`Thin lines are parts of pixel ${now.active + 1}:`);
    const keys = (active?.orders ?? []).map(({ name }, k) => {
      const swatch = lineSwatch(DASHES[k % DASHES.length], colourOf(active.style, dark));
      return make("span", { className: "key" }, swatch, name);
    });
    parts.legend.hidden = !words.length;
    parts.legend.replaceChildren(words.join(" "), ...keys);
  }

  phasors() {
    const { now, recording } = this;
    return now.pixels.map(([column, row], style) => {
      const pixel = row * recording.light.width + column;
      return { ...recording.phasor(pixel, now.frequency), style };
    });
  }

  drawPhasors(dark) {
    const { now, parts } = this;
    const phasors = this.phasors();
    drawPhasors(parts.plane, phasors, { dark, ink: this.ink() });
    const rows = phasors.map(({ amplitude, phase, depth }, k) => [
      ...[this.chip(k, dark), short(amplitude), `${signed(phase.toFixed(3))} rad`, `${depth.toFixed(3)} m`],
    ]);
    const ambiguous = `depth (below ${short(SPEED_OF_LIGHT / (2 * now.frequency))} m)`;
    fill(parts.phasors, [["", "amplitude", "phase", ambiguous], ...rows]);
    const said = phasors.map(({ phase }, k) => `${k + 1}: ${signed(phase.toFixed(2))} rad`).join(", ");
    parts.plane.setAttribute("aria-label", `Phasors of pixels in their plane, phases ${said}`);
  }

  chip(k, dark) {
    const chip = make("button", { type: "button", className: "chip", title: `Choose pixel ${k + 1}` }, String(k + 1));
    chip.style.setProperty("--own", colourOf(k, dark));
    chip.classList.toggle("active", k === this.now.active);
    chip.addEventListener("click", () => this.set({ active: k }));
    return chip;
  }

  cross(k) {
    const cross = make("button", { type: "button", className: "cross", "aria-label": `Remove pixel ${k + 1}` }, "×");
    cross.addEventListener("click", () => this.removePixel(k));
    return cross;
  }

  /** Say what is under the pointer, or of the chosen pixel. */
  tell(pixel) {
    const { now, recording, parts, about } = this;
    const at = pixel ?? now.pixels[now.active];
    if (!at || !this.hasPixels) {
      parts.readout.textContent = "";
      return;
    }
    const [column, row] = at;
    const i = row * recording.light.width + column;
    const words = [this.named(at)];
    if (about.parts.points) {
      const points = recording.part("points");
      const [x, y] = [column * about.grid.step, row * about.grid.step];
      const from = 3 * (y * about.grid.width + x);
      words.push(`wall (${Array.from(points.slice(from, from + 3), (each) => short(each)).join(", ")}) m`);
    }
    const response = this.curve(at).values;
    words.push(`${short(response[now.bin])} at ${this.when(now.bin)}`);
    if (this.about.geometry.mode === "confocal") words.push("each point is lit by itself");
    parts.readout.textContent = words.join("  ·  ");
    parts.readout.dataset.pixel = String(i);
  }

  speak() {
    this.parts.spoken.textContent = this.spoken();
  }

  spoken() {
    const { now } = this;
    const pixels = now.pixels.map((pixel, k) => {
      const { values } = this.curve(pixel, k);
      return `pixel ${k + 1} ${this.named(pixel)}, ${short(values[now.bin])}`;
    });
    return [this.when(now.bin), ...pixels].join("; ");
  }

  ink() {
    const style = getComputedStyle(this.root);
    const names = ["line", "grid", "soft", "accent", "band"];
    return Object.fromEntries(names.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
  }

  // ------------------------------------------------------------------------------------- words

  edge(bin) {
    return this.recording.start + bin * this.recording.width;
  }

  /** Time and path length of a bin, with digits that tell bins apart. */
  when(bin) {
    const { recording, isVolume } = this;
    const opl = recording.centre(bin);
    const digits = (step) => clamp(1 - Math.floor(Math.log10(step)), 0, 9);
    const metres = `${opl.toFixed(digits(recording.width))} m`;
    if (isVolume) return metres;
    return `${nanoseconds(opl).toFixed(digits(nanoseconds(recording.width)))} ns  ·  ${metres}`;
  }

  length(opl) {
    return this.isVolume ? `${short(opl, 4)} m` : `${short(nanoseconds(opl), 4)} ns`;
  }
}

const PHASORS = [["depth", "Depth"], ["phase", "Phase"], ["amplitude", "Amplitude"]];
const KEYS =
  "Keys: ← → a step in time (Shift: ten), Home and End the first and the last, Space plays. In the " +
  "picture: arrows move the chosen pixel (Shift: ten), 1 to 6 choose, Enter adds, Delete removes. " +
  "Click to add a pixel, drag to move it; drag in the curves to move time or the gate.";

/** A curve with arrays that JSON can hold. */
function plainCurve({ values, errors, orders, ...more }) {
  return {
    ...more,
    values: Array.from(values),
    errors: errors && Array.from(errors),
    orders: orders.map(({ name, values: own }) => ({ name, values: Array.from(own) })),
  };
}

function colourOf(k, dark) {
  return dark ? STYLES[k].dark : STYLES[k].colour;
}

function clamp(value, low, high) {
  return Math.max(low, Math.min(high, value));
}

function nanoseconds(opl) {
  return (1e9 * opl) / SPEED_OF_LIGHT;
}

function hertz(frequency) {
  return frequency >= 1e9 ? `${short(frequency / 1e9, 4)} GHz` : `${short(frequency / 1e6, 4)} MHz`;
}
