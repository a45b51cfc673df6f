/**
 * Two pictures, A and B: side by side at a divider, one after the other, and their difference.
 *
 * Data: `pictures`, float32 planes of both; `width`, `height`, `weights` of channels; `names`;
 * `curves`, float32 over the clock of the chosen pixel. State: `clock` {start, width, count} of films,
 * `scenes` of the course with their techniques, `files` [index, name] if there are more than two, `rows`
 * of numbers, `white`, `message`.
 */

import { canvasOf, stripOf } from "../explorer/frame.js";
import { paintLight, paintMap, range, toneCurve } from "../explorer/paint.js";
import { Axes, colorOf, drawCurves, sharp, STYLES } from "../explorer/plot.js";
import { clamp, short, signed, when } from "../explorer/words.js";
import { live } from "../ui/app.js";
import { button, choices, fill, follow, group, inkOf, isDark, lineSwatch, list, make, slider, tell, terms, tick } from "../ui/parts.js";
import { Zoom } from "./zoom.js";

const VIEWS = [
  ["divider", "Divider", "A to the left of a divider, B to the right"],
  ["a", "A"],
  ["b", "B"],
  ["difference", "B − A", "Of luminance"],
  ["relative", "Relative", "2 (B − A) / (|A| + |B|), of luminance"],
];
const CHANNELS = ["red", "green", "blue"];
const KEYS =
  "Keys: F or Space shows A and B in turns, D their difference, R the relative difference; " +
  "← → move the divider, + − 0 zoom. " +
  "Wheel or pinch to zoom, drag to move, click to choose a pixel.";

class Comparison {
  constructor({ model, root, draw, choose }) {
    Object.assign(this, { model, root, redraw: draw, choose });
    this.now = { view: "divider", divider: 0.5, exposure: 0, log: false, playing: false };
    this.zoom = new Zoom();
    this.curve = toneCurve(2.2);
    this.map = new Uint8Array(model.state.colors);
    this.show = (changes) => {
      Object.assign(this.now, changes);
      draw();
    };
    root.append(...this.layout());
    this.listen();
  }

  layout() {
    const { model, show, choose } = this;
    const { scenes, files, clock } = model.state;
    this.views = choices("Show", VIEWS, (view) => show({ view }));
    this.canvas = make("canvas", { role: "img" });
    this.tags = ["A", "B"].map((side) => make("span", { className: `tag ${side}` }));
    this.frame = make("div", { className: "frame", tabIndex: 0, role: "group", "aria-label": `Pictures. ${KEYS}` });
    this.frame.append(this.canvas, ...this.tags);
    this.bar = group("bar", stripOf(this.map), (this.scale = group("")));
    const percent = (at) => `${Math.round(100 * at)} %`;
    const moved = (divider) => show({ divider, view: "divider" });
    this.divider = slider("Divider", { step: 0.005, say: percent, moved });
    const stops = (exposure) => `${exposure > 0 ? "+" : ""}${signed(exposure)} EV`;
    const exposures = { min: -10, max: 10, step: 0.25, say: stops };
    this.exposure = slider("Exposure", { ...exposures, moved: (exposure) => show({ exposure }) });
    const zooms = [["−", 0.5, "Smaller"], ["+", 2, "Larger"], ["Fit", 0, "Whole picture"]].map(([text, factor, title]) =>
      Object.assign(button(text, () => this.zoomBy(factor)), { title, ariaLabel: title }),
    );
    const left = group("left", this.views, this.frame, this.bar);
    if (clock) left.append(make("fieldset", {}, this.transport(clock)));
    left.append(this.divider, group("row", this.exposure, group("row", ...zooms)));
    this.message = make("div", { role: "status" });
    this.numbers = make("dl");
    this.at = make("h2");
    this.values = make("table");
    const right = group("left", this.message, group("heading", make("h2", {}, "Difference")), this.numbers);
    if (scenes) right.prepend(make("fieldset", {}, this.course(scenes)));
    if (files) right.prepend(make("fieldset", {}, this.choiceOf(files)));
    right.append(group("heading", this.at), this.values);
    if (clock) {
      this.plot = make("canvas", { className: "plot", role: "img" });
      this.log = tick("Logarithmic", (log) => show({ log }));
      this.keys = ["A", "B"].map((side, k) => group("key", lineSwatch(STYLES[k].dash, "currentColor"), side));
      right.append(group("heading", make("h2", {}, "Response of the pixel"), ...this.keys, this.log), this.plot);
      const to = (event) => {
        const x = event.clientX - this.plot.getBoundingClientRect().left;
        choose({ step: new Axes(this.plot, clock).bin(x) });
        return true;
      };
      follow(this.plot, { down: to, move: to });
    }
    const header = make("header", {}, make("h1", {}, "Comparison"), (this.title = make("p", { className: "quiet" })));
    return [header, group("stage", left, right), make("p", { className: "quiet keys" }, KEYS)];
  }

  /** Lists of the course's scenes, and of the techniques for either side. */
  course(scenes) {
    const { choose } = this;
    const sides = ["a", "b"].map((side) => list(side.toUpperCase(), [], (way) => choose({ [side]: way })));
    const scene = list("Scene", Object.keys(scenes).map((name) => [name, name]), (name) =>
      choose({ scene: name, a: scenes[name][0][0], b: scenes[name].length > 2 ? "mis" : "reference" }),
    );
    const power = { max: 8, say: (each) => String(2 ** each), moved: (each) => choose({ spp: 2 ** each }) };
    const spp = slider("Samples per pixel", power);
    this.drawCourse = (chosen) => {
      scene.set(chosen.scene);
      sides.forEach((side, k) => {
        side.offer(scenes[chosen.scene]);
        side.set(chosen["ab"[k]]);
      });
      spp.set(Math.log2(chosen.spp));
    };
    return group("row", scene, ...sides, spp);
  }

  /** Lists of the files, for either side. */
  choiceOf(files) {
    const sides = ["a", "b"].map((side) =>
      list(side.toUpperCase(), files, (index) => this.choose({ [side]: Number(index) })),
    );
    this.drawChoice = (chosen) => sides.forEach((side, k) => side.set(chosen["ab"[k]]));
    return group("row", ...sides);
  }

  /** Play, time, and the picture of all time. */
  transport({ start, width, count }) {
    const { model, choose, show } = this;
    const clock = { width, center: (step) => start + (step + 0.5) * width };
    this.play = button("Play", () => {
      show({ playing: !this.now.playing });
      if (this.now.playing) this.next();
    });
    this.time = slider("Time", { max: count - 1, say: (step) => when(clock, step), moved: (step) => choose({ step }) });
    this.all = tick("All time", (all) => choose({ step: all ? null : (this.last ?? 0) }));
    this.next = () => choose({ step: ((model.chosen.step ?? -1) + 1) % count });
    return group("row", this.play, this.time, this.all);
  }

  listen() {
    const { zoom, frame, show, choose } = this;
    zoom.listen(frame, {
      changed: this.redraw,
      drag: ([from], [to]) => {
        const { view, divider } = this.now;
        const near = Math.abs(from - divider) * frame.clientWidth < 24;
        if (view !== "divider" || (zoom.scale > 1 && !near)) return false;
        show({ divider: clamp(to, 0, 1) });
        return true;
      },
      point: (place) => this.planes && this.drawValues(place ? this.pixelAt(place) : undefined),
      click: (place) => choose({ pixel: this.pixelAt(place) }),
    });
    // Keys work before anything on the page has the focus
    document.addEventListener("keydown", (event) => {
      const { key } = event;
      const [target] = event.composedPath();
      if (!this.root.isConnected || !target.matches) return;
      if (event.ctrlKey || event.metaKey || event.altKey || target.matches("select")) return;
      const { view, divider } = this.now;
      const step = { ArrowLeft: -0.01, ArrowRight: 0.01 }[key];
      if (key === "f" || (key === " " && !target.matches("button, input"))) show({ view: view === "a" ? "b" : "a" });
      else if (key === "d") show({ view: "difference" });
      else if (key === "r") show({ view: "relative" });
      else if (key in ZOOMS) this.zoomBy(ZOOMS[key]);
      else if (step && target === frame) show({ view: "divider", divider: clamp(divider + step, 0, 1) });
      else return;
      event.preventDefault();
    });
  }

  zoomBy(factor) {
    if (factor) this.zoom.by(factor);
    else this.zoom.reset();
    this.redraw();
  }

  pixelAt(place) {
    const { width, height } = this.model.data;
    const [x, y] = this.zoom.at(place);
    return [clamp(Math.floor(x * width), 0, width - 1), clamp(Math.floor(y * height), 0, height - 1)];
  }

  // ----------------------------------------------------------------------------------- drawing

  draw() {
    const { model, now, title } = this;
    const { state, data, chosen } = model;
    tell(this.message, state.message);
    this.drawCourse?.(chosen);
    this.drawChoice?.(chosen);
    this.views.set(now.view);
    this.divider.set(now.divider);
    this.exposure.set(now.exposure);
    this.numbers.replaceChildren(...terms(state.rows));
    if (state.clock) this.drawTime(chosen);
    if (!data.pictures) return;
    title.textContent = `A: ${data.names[0]}  ·  B: ${data.names[1]}  ·  ${data.width} × ${data.height} pixels`;
    this.paint(data);
    this.drawPicture(data);
    this.drawValues();
    if (state.clock) this.drawResponses(data);
    if (now.playing && data.step === chosen.step && data !== this.played) {
      this.played = data;
      setTimeout(() => now.playing && this.next(), 40);
    }
  }

  drawTime({ step }) {
    this.last = step ?? this.last;
    if (step !== null) this.time.set(step);
    this.all.set(step === null);
    this.play.textContent = this.now.playing ? "Pause" : "Play";
  }

  /** Both pictures and their difference in colors, once for each data and exposure. */
  paint(data) {
    const { exposure } = this.now;
    if (this.painted === data && this.paintedAt === exposure) return;
    [this.painted, this.paintedAt] = [data, exposure];
    const { width, height, weights } = data;
    const size = width * height;
    this.planes = data.pictures.map((bytes) => weights.map((_, c) => new Float32Array(bytes, 4 * c * size, size)));
    const light = this.planes.map((planes) =>
      planes[0].map((_, i) => weights.reduce((sum, weight, c) => sum + weight * planes[c][i], 0)),
    );
    const look = { gain: 2 ** exposure / this.model.state.white, curve: this.curve, width };
    const layers = this.planes.map((planes, k) => paintLight(planes, { ...look, hatch: light[k].map(Number.isNaN) }));
    const difference = light[1].map((value, i) => value - light[0][i]);
    const high = Math.max(...range(difference, 0.005).map(Math.abs), Number.MIN_VALUE) / 2 ** exposure;
    layers.push(paintMap(difference, { low: -high, high, map: this.map, width }));
    const relative = difference.map((off, i) => (off ? (2 * off) / (Math.abs(light[0][i]) + Math.abs(light[1][i])) : off));
    layers.push(paintMap(relative, { low: -2, high: 2, map: this.map, width }));
    this.highs = { difference: high, relative: 2 };
    this.layers = layers.map((bytes) => canvasOf(bytes, width, height));
  }

  drawPicture({ width, height, names }) {
    const { canvas, frame, now, zoom } = this;
    frame.style.setProperty("--aspect", width / height);
    frame.style.touchAction = zoom.scale > 1 ? "none" : "pan-y";
    const [wide, tall] = [frame.clientWidth, frame.clientHeight];
    const pen = sharp(canvas);
    pen.imageSmoothingEnabled = false;
    const [a, b, difference, relative] = this.layers;
    const place = (layer) =>
      pen.drawImage(layer, zoom.x * width, zoom.y * height, width / zoom.scale, height / zoom.scale, 0, 0, wide, tall);
    place({ a, b, difference, relative, divider: b }[now.view]);
    if (now.view === "divider") {
      const at = Math.round(now.divider * wide);
      pen.save();
      pen.beginPath();
      pen.rect(0, 0, at, tall);
      pen.clip();
      place(a);
      pen.restore();
      for (const [color, half] of [["#000", 2], ["#fff", 1]]) {
        pen.fillStyle = color;
        pen.fillRect(at - half, 0, 2 * half, tall);
      }
    }
    const [x, y] = this.pixel.map((at, k) => (at / [width, height][k] - [zoom.x, zoom.y][k]) * zoom.scale);
    const side = 2 + Math.max(6, (zoom.scale * wide) / width);
    pen.strokeStyle = inkOf(this.root).accent;
    pen.lineWidth = 2;
    pen.strokeRect(x * wide - 1, y * tall - 1, side, side);
    this.tags.forEach((tag, k) => {
      tag.textContent = `${"AB"[k]}: ${names[k]}`;
      tag.hidden = now.view !== "divider" && now.view !== "ab"[k];
    });
    canvas.setAttribute("aria-label", `${VIEWS.find(([view]) => view === now.view)[1]} of ${names.join(" and ")}`);
    Object.assign(canvas.dataset, { view: now.view, divider: now.divider, scale: zoom.scale });
    const high = this.highs[now.view];
    this.bar.hidden = high === undefined;
    const said = [-1, -0.5, 0, 0.5, 1].map((part) => short(part * high));
    if (!this.bar.hidden) this.scale.replaceChildren(...said.map((each) => make("span", {}, each)));
  }

  /** Column and row of the chosen pixel, at first the one in the middle. */
  get pixel() {
    const { chosen, data } = this.model;
    const sizes = [data.width, data.height];
    return sizes.map((size, k) => Math.min(chosen.pixel?.[k] ?? Math.floor(size / 2), size - 1));
  }

  /** Values as they were sent, of the chosen pixel or of another one. */
  drawValues([x, y] = this.pixel) {
    this.at.textContent = `Pixel (${x}, ${y})`;
    const i = y * this.model.data.width + x;
    const rows = this.planes[0].map((plane, c) => {
      const [a, b] = [plane[i], this.planes[1][c][i]];
      return [this.planes[0].length === 3 ? CHANNELS[c] : "light", exact(a), exact(b), exact(Math.fround(b - a))];
    });
    fill(this.values, [["", "A", "B", "B − A"], ...rows]);
  }

  drawResponses({ curves, step }) {
    const { state } = this.model;
    const dark = isDark(this.root);
    const ink = inkOf(this.root);
    const lines = curves.map((bytes, k) => ({ values: new Float32Array(bytes), style: k }));
    const words = { quantity: state.quantity, below: "time [ns]", above: "optical path length [m]" };
    drawCurves(this.plot, state.clock, lines, { bin: step ?? undefined }, words, { log: this.now.log, dark, ink });
    this.plot.setAttribute("aria-label", `${words.quantity} over ${words.below} of A and B`);
    this.log.set(this.now.log);
    this.keys.forEach((key, k) => (key.style.color = colorOf(k, dark)));
  }
}

const ZOOMS = { "+": 2, "=": 2, "-": 0.5, 0: 0 };

/** A value of single precision, with as many digits as it has. */
function exact(value) {
  return Number.isFinite(value) ? short(value, 7) : String(value);
}

export function render({ model }) {
  return live(model, "tof-compare", Comparison);
}
