/** The parts of an explorer's page, their layout, and what they say. */

import { choices, group, list, make, slider, terms, tick } from "../ui/parts.js";
import { viewsOf } from "./pictures.js";
import { SPEED_OF_LIGHT } from "./recording.js";
import { STOKES } from "./stokes.js";
import { VolumeView } from "./volume.js";
import { hertz, lengthText, short, signed, when } from "./words.js";

export const SPEEDS = { "½": 10, 1: 20, 2: 40, 4: 80 }; // bins a second

const PHASORS = [["depth", "Depth"], ["phase", "Phase"], ["amplitude", "Amplitude"]];
const KEYS =
  "Keys: ← → a step in time (Shift: ten), Home and End the first and the last, Space plays. In the " +
  "picture: arrows move the chosen pixel (Shift: ten), 1 to 6 choose, Enter adds, Delete removes. " +
  "Click to add a pixel, drag to move it; drag in the curves to move time or the gate. In 3D: drag or " +
  "arrows turn, + and − zoom, 0 turns back, Shift and arrows move the chosen point.";
const SET_AS_CALLED = [
  ...["exposure", "gamma", "colors", "smooth", "stokes", "unwarped", "laser", "channel", "log"],
  ...["threshold", "zoom"],
];

/** Make all parts; `now` has the values to begin with, and `set(changes)` is called for others. */
export function makeParts(recording, now, set) {
  const { about, isVolume } = recording;
  const parts = {};
  const views = viewsOf(recording);
  parts.views = choices("Picture", views, (view) => set({ view }));
  parts.views.hidden = views.length === 1;
  parts.canvas = make("canvas", { className: "tof-picture", role: "img" });
  parts.markers = make("div", { className: "markers", "aria-hidden": "true" });
  const says = "Picture; arrow keys move the chosen pixel, Enter adds one, Delete removes it";
  const focusable = { className: "frame", tabIndex: 0, role: "group", "aria-label": says };
  parts.frame = make("div", focusable, parts.canvas, parts.markers);
  parts.space = new VolumeView(set);
  parts.bar = group("bar");
  parts.assumes = make("p", { className: "assumes" });
  parts.hatched = make("p", { className: "assumes" }, make("span", { className: "hatch" }), "");
  parts.readout = make("p", { className: "readout" });
  parts.play = make("button", { type: "button", className: "play" });
  parts.play.addEventListener("click", () => set({ playing: !now.playing }));
  parts.time = slider(isVolume ? "Depth" : "Time", {
    max: recording.count - 1,
    say: (bin) => when(recording, bin),
    moved: (bin) => set({ bin, playing: false }),
  });
  parts.speed = list("Speed", Object.keys(SPEEDS).map((each) => [each, `${each}×`]), (speed) => set({ speed }));
  parts.gateStart = slider("Opens", {
    max: recording.count - 1,
    say: (first) => lengthText(recording, recording.edge(first)),
    moved: (first) => set({ gate: { ...now.gate, first } }),
  });
  parts.gateWidth = slider("Width", {
    ...{ min: 1, max: recording.count },
    say: (count) => lengthText(recording, count * recording.width),
    moved: (count) => set({ gate: { ...now.gate, count } }),
  });
  parts.exposure = slider("Exposure", {
    ...{ min: -8, max: 8, step: 0.1 },
    say: (stops) => `${stops > 0 ? "+" : ""}${signed(stops.toFixed(1))} EV`,
    moved: (exposure) => set({ exposure }),
  });
  parts.gamma = slider("Gamma", {
    ...{ min: 1, max: 5, step: 0.1 },
    say: (gamma) => gamma.toFixed(1),
    moved: (gamma) => set({ gamma }),
  });
  parts.threshold = slider("Threshold", {
    step: 0.01,
    say: (part) => `${Math.round(100 * part)} %`,
    title: "Smallest voxels that are shown, as a part of the largest",
    moved: (threshold) => set({ threshold }),
  });
  parts.zoom = slider("Zoom", {
    ...{ min: 0.5, max: 5, step: 0.05 },
    say: (zoom) => `${zoom.toFixed(2)}×`,
    moved: (zoom) => set({ zoom }),
  });
  const looks = [["color", "as rendered"], ["gray", "gray"], ["false", "false color"]];
  const offered = recording.weights.length === 3 ? looks : looks.slice(1);
  parts.colors = list("Colors", offered, (colors) => set({ colors }));
  parts.smooth = tick("Smooth", (smooth) => set({ smooth }));
  parts.unwarped = tick("Without the camera segment", (unwarped) => set({ unwarped }));
  parts.unwarped.hidden = !recording.distances;
  const momentOf = (frame) => (about.frames ? ` at ${short(about.frames[frame], 4)} s` : "");
  parts.laser = slider(about.frames ? "Frame" : "Lit point", {
    max: about.lasers - 1,
    say: (laser) => `${laser + 1} of ${about.lasers}${momentOf(laser)}`,
    moved: (laser) => set({ laser }),
  });
  parts.laser.hidden = about.lasers < 2;
  const channels = [["luminance", "luminance"], ["0", "red"], ["1", "green"], ["2", "blue"]];
  parts.channel = list("Of", channels, (channel) => set({ channel }));
  parts.channel.hidden = recording.weights.length < 3;
  const components = Object.entries(STOKES).map(([key, { name }]) => [key, name]);
  parts.stokes = list("Shown", components, (stokes) => set({ stokes }));
  parts.stokes.hidden = recording.stokes.length === 1;
  parts.log = tick("Logarithmic", (log) => set({ log }));
  parts.plot = make("canvas", { className: "plot", role: "img" });
  parts.legend = make("p", { className: "legend" });
  parts.pixels = make("table");
  parts.phasorView = choices("Phasor", PHASORS, (phasor) => set({ phasor, view: "phasor" }));
  parts.frequency = frequencySlider(recording, now, set);
  parts.plane = make("canvas", { className: "plane", role: "img" });
  parts.phasors = make("table");
  parts.rates = make("canvas", { className: "plot", role: "img" });
  parts.ratesOf = make("p", { className: "legend" });
  parts.spoken = make("div", { className: "spoken", role: "status" });
  return parts;
}

/** A slider of any frequency, or of those at which light was measured. */
function frequencySlider({ about: { axis, frequencies } }, now, set) {
  const limit = Math.log10(SPEED_OF_LIGHT / (2 * axis.width));
  const [from, to] = frequencies
    ? [(frequency) => frequencies.indexOf(frequency), (number) => frequencies[number]]
    : [Math.log10, (power) => 10 ** power];
  const range = frequencies
    ? { min: 0, max: frequencies.length - 1, step: 1 }
    : { min: Math.min(6, limit - 1), max: limit, step: 0.001 };
  const element = slider("Frequency", {
    ...{ ...range, value: from(now.frequency), title: "Modulation frequency of the light" },
    say: (at) => hertz(to(at)),
    moved: (at) => set({ frequency: to(at) }),
  });
  return { element, set: (frequency) => element.set(from(frequency)) };
}

/** Lay parts out; returns the children of the explorer's element, whose title is of `level`. */
export function layout(parts, { about, isVolume, hasOneBin, hasTimes, hasPhasors }, level) {
  const panel = (title, ...children) => make("section", { className: "panel", "aria-label": title }, ...children);
  parts.transport = group("transport", parts.play, parts.time, parts.speed);
  parts.gates = group("transport", parts.gateStart, parts.gateWidth);
  const tones = hasTimes ? [parts.exposure, parts.gamma, parts.colors] : [];
  const look = group("look", parts.threshold, parts.zoom, ...tones, parts.smooth, parts.unwarped, parts.laser);
  const left = group("left", parts.views, parts.stokes, parts.frame, parts.space.element, parts.bar);
  left.append(parts.transport, parts.gates, parts.readout, parts.assumes, parts.hatched, look);
  const heading = (title, ...more) => group("heading", make(`h${level + 1}`, {}, title), ...more);
  const responses = hasOneBin ? "Rows of the chosen pixels" : "Responses";
  const response = panel(
    isVolume ? "Along the depth" : "Response",
    heading(isVolume ? "Along the depth" : responses, parts.channel, parts.log),
    ...[parts.plot, parts.legend, parts.pixels],
  );
  response.hidden = !hasTimes;
  const plane = group("beside", parts.plane, parts.phasors);
  const phasor = panel("Phasors", heading("Phasors", parts.phasorView), parts.frequency.element, plane);
  phasor.hidden = !hasPhasors;
  const rates = panel("Range and velocity", heading("Range and velocity"), parts.rates, parts.ratesOf);
  const notes = make("ul", {}, ...about.notes.map((note) => make("li", {}, note)));
  const more = make("details", {}, make("summary", {}, "Contents and precision"), notes);
  more.append(make("dl", {}, ...terms(about.facts)), make("p", {}, KEYS));
  const [, size] = about.facts[0];
  const header = make("header", {}, make(`h${level}`, {}, about.title), make("p", {}, size), parts.saves);
  header.append(...about.warnings.map((warning) => make("p", { className: "warning" }, warning)));
  return [header, group("stage", left, group("right", response, ...(about.rateAxis ? [rates] : []), phasor)), more, parts.spoken];
}

/** Have the controls say what is shown now. */
export function showControls(parts, recording, now) {
  for (const name of SET_AS_CALLED) parts[name].set(now[name]);
  parts.views.set(now.view);
  parts.speed.set(now.speed);
  parts.phasorView.set(now.view === "phasor" ? now.phasor : "");
  parts.frequency.set(now.frequency);
  parts.time.limit(recording.count - 1);
  parts.time.set(now.bin);
  parts.gateStart.limit(recording.count - now.gate.count);
  parts.gateStart.set(now.gate.first);
  parts.gateWidth.limit(recording.count);
  parts.gateWidth.set(now.gate.count);
  parts.play.setAttribute("aria-label", now.playing ? "Pause" : "Play");
  parts.play.classList.toggle("playing", now.playing);
  parts.log.hidden = now.stokes !== "S0";
  parts.transport.hidden = now.view === "gate" || recording.count === 1 || !recording.hasTimes;
  parts.gates.hidden = now.view !== "gate";
  parts.threshold.hidden = parts.zoom.hidden = now.view !== "space";
  parts.colors.hidden = parts.smooth.hidden = now.view === "space";
}
