/** Pointer and keys: all that they do is to call `set` of the explorer. */

import { follow } from "../ui/parts.js";
import { hasPixels, markerUnder, pixelUnder } from "./frame.js";
import { Axes, STYLES } from "./plot.js";
import { clamp } from "./words.js";

const NEAR_EDGE = 14; // px, of a gate

/** Listen to picture, plot and keys of an explorer: its now, recording, parts, set, tell, speak. */
export function listen(explorer) {
  const { parts, recording } = explorer;
  const under = (event) => pixelUnder(event, parts, recording);
  follow(parts.frame, {
    down: (event) => grab(explorer, event),
    move: (event, { marker }) => {
      const pixels = explorer.now.pixels.map((each, k) => (k === marker ? under(event) : each));
      explorer.set({ pixels, active: marker });
    },
    tap: (event) => hasPixels(explorer.now) && addPixel(explorer, under(event)),
  });
  parts.frame.addEventListener("pointermove", (event) => explorer.tell(under(event)));
  parts.frame.addEventListener("pointerleave", () => explorer.tell(null));
  for (const element of [parts.frame, parts.space.element]) {
    element.addEventListener("keydown", (event) => pressedInPicture(explorer, event));
  }
  parts.space.element.addEventListener("click", (event) => {
    const { grid } = recording.about;
    const tapped = recording.isVolume ? -1 : parts.space.tapped(event);
    const pixel = [tapped % grid.width, Math.floor(tapped / grid.width)].map((k) => Math.floor(k / grid.step));
    if (tapped >= 0) addPixel(explorer, pixel);
  });
  follow(parts.plot, {
    down: (event) => grabInPlot(explorer, event),
    move: (event, held) => dragInPlot(explorer, event, held),
  });
}

function grab(explorer, event) {
  const { now, parts, recording } = explorer;
  if (!hasPixels(now)) return null;
  const found = markerUnder(event, parts, recording, now.pixels);
  parts.frame.focus({ preventScroll: true });
  if (found >= 0) {
    explorer.set({ active: found });
    return { marker: found };
  }
  if (event.pointerType === "touch") return null; // It may be to scroll: a tap adds
  addPixel(explorer, pixelUnder(event, parts, recording));
  return { marker: now.active };
}

function addPixel({ now, set }, pixel) {
  const { pixels, active } = now;
  if (pixels.length < STYLES.length) set({ pixels: [...pixels, pixel], active: pixels.length });
  else set({ pixels: pixels.map((each, k) => (k === active ? pixel : each)) });
}

export function removePixel({ now, set }, number) {
  set({ pixels: now.pixels.filter((_, k) => k !== number), active: number - 1 });
}

function grabInPlot({ now, parts, recording, set }, event) {
  const { gate, view } = now;
  const axes = new Axes(parts.plot, recording);
  const x = event.clientX - parts.plot.getBoundingClientRect().left;
  const bin = axes.bin(x);
  if (view !== "gate") {
    set({ bin, view: recording.isVolume || view === "space" ? view : "light", playing: false });
    return { what: "time" };
  }
  const edges = [gate.first, gate.first + gate.count].map((k) => axes.x(recording.edge(k)));
  const away = edges.map((edge) => Math.abs(edge - x));
  if (Math.min(...away) <= NEAR_EDGE) {
    return { what: "edge", other: away[0] < away[1] ? gate.first + gate.count : gate.first };
  }
  if (x < edges[0] || x > edges[1]) set({ gate: { ...gate, first: bin - Math.floor(gate.count / 2) } });
  return { what: "gate", ahead: bin - now.gate.first };
}

function dragInPlot({ now, parts, recording, set }, event, { what, other, ahead }) {
  const axes = new Axes(parts.plot, recording);
  const x = event.clientX - parts.plot.getBoundingClientRect().left;
  if (what === "time") {
    set({ bin: axes.bin(x) });
  } else if (what === "gate") {
    set({ gate: { ...now.gate, first: axes.bin(x) - ahead } });
  } else {
    const edge = clamp(Math.round((axes.opl(x) - axes.start) / axes.width), 0, axes.count);
    const first = Math.min(edge, other);
    set({ gate: { first, count: Math.max(1, Math.abs(edge - other)) } });
  }
}

/** Keys anywhere in an explorer. */
export function pressed(explorer, event) {
  const { key, target, shiftKey } = event;
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const own = target.matches("input, select");
  if (own) event.stopPropagation(); // Notebooks have other uses for arrows
  const { bin, gate, playing, view } = explorer.now;
  const steps = { ArrowLeft: -1, ArrowRight: 1, Home: -Infinity, End: Infinity };
  if (key === " " && !target.matches("button, select, summary, input[type=checkbox]")) {
    explorer.set({ playing: !playing });
  } else if (key in steps && !own) {
    const step = steps[key] * (shiftKey ? 10 : 1);
    if (view === "gate") explorer.set({ gate: { ...gate, first: gate.first + step } });
    else explorer.set({ bin: bin + step, playing: false });
    explorer.speak();
  } else return;
  event.preventDefault();
  event.stopPropagation();
}

function pressedInPicture(explorer, event) {
  const { now, recording, set } = explorer;
  const { pixels, active } = now;
  const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
  const far = event.shiftKey && now.view !== "space" ? 10 : 1;
  if (event.defaultPrevented) return; // The view has turned
  if (event.key in steps && pixels.length) {
    const [across, down] = steps[event.key];
    const [column, row] = pixels[active];
    const moved = [column + far * across, row + far * down];
    set({ pixels: pixels.map((each, k) => (k === active ? moved : each)) });
  } else if (event.key === "Enter") {
    const { width, height } = recording.light;
    const [column, row] = pixels[active] ?? [width / 2, height / 2];
    addPixel(explorer, [column + Math.round(width / 16), row]);
  } else if (event.key === "Delete" || event.key === "Backspace") {
    removePixel(explorer, active);
  } else if (/^[1-6]$/.test(event.key)) {
    set({ active: Number(event.key) - 1 });
  } else return;
  explorer.speak();
  event.preventDefault();
  event.stopPropagation();
}
