/** The view in the page's address: "#t=20.9&px=79,39&f=5e7" has what differs from the first view. */

import { viewsOf } from "./pictures.js";
import { SPEED_OF_LIGHT } from "./recording.js";
import { STOKES } from "./stokes.js";
import { clamp, digits, nanoseconds } from "./words.js";

const PAUSE = 500; // ms until the address follows; browsers allow 100 changes in 30 s

/** Names in the address with names of what is shown, and how values are written and read. */
function fieldsOf(recording) {
  const { about, isVolume, width } = recording;
  const one = (...options) => ({ write: String, read: (text) => (options.includes(text) ? text : NaN) });
  const flag = { write: Number, read: (text) => text === "1" };
  const between = (low, high) => ({ write: brief, read: (text) => clamp(Number(text), low, high) });
  const factor = isVolume ? 1 : nanoseconds(1);
  const fromBin = (bin) => Number((factor * recording.edge(bin)).toFixed(digits(factor * width) + 1));
  const toBin = (text) => (Number(text) / factor - recording.start) / width;
  return {
    laser: ["laser", between(0, about.lasers - 1)],
    unwarped: ["unwarped", flag],
    view: ["view", one(...viewsOf(recording).map(([view]) => view))],
    shown: ["stokes", one(...(recording.stokes.length > 1 ? Object.keys(STOKES) : ["S0"]))],
    of: ["channel", one("luminance", ...recording.weights.map((_, k) => String(k)))],
    colors: ["colors", one("gray", "false", recording.weights.length === 3 ? "color" : "gray")],
    phasor: ["phasor", one("depth", "phase", "amplitude")],
    [isVolume ? "z" : "t"]: ["bin", { write: (bin) => fromBin(bin + 0.5), read: (text) => toBin(text) - 0.5 }],
    gate: ["gate", {
      write: ({ first, count }) => [first, first + count].map(fromBin).join(","),
      read: (text) => {
        const [first, last] = text.split(",").map(toBin);
        return { first, count: last - first };
      },
    }],
    px: ["pixels", {
      write: (pixels) => pixels.map((pixel) => recording.place(pixel).join(",")).join(";"),
      read: (text) => text.split(";").filter(Boolean).map((each) => recording.at(each.split(",").map(Number))),
    }],
    f: ["frequency", about.frequencies ? nearest(about.frequencies) : between(1, SPEED_OF_LIGHT / (2 * width))],
    ev: ["exposure", between(-8, 8)],
    gamma: ["gamma", between(1, 5)],
    log: ["log", flag],
    smooth: ["smooth", flag],
    across: ["across", between(-1e3, 1e3)],
    tilt: ["tilt", between(-Math.PI / 2, Math.PI / 2)],
    zoom: ["zoom", between(0.5, 5)],
    threshold: ["threshold", between(0, 1)],
  };
}

/** One of some numbers, written in full. */
function nearest(numbers) {
  const off = (text) => (number) => Math.abs(number - Number(text));
  return { write: String, read: (text) => Number(text) && numbers.toSorted((a, b) => off(text)(a) - off(text)(b))[0] };
}

function brief(value) {
  const number = Number(value.toPrecision(6));
  const [long, short] = [String(number), number.toExponential().replace("+", "")];
  return short.length < long.length ? short : long;
}

/** The address of a page that shows what an explorer shows now. */
export function linkOf({ first, now, recording }) {
  const differs = ([, [name]]) => JSON.stringify(now[name]) !== JSON.stringify(first[name]);
  const fields = Object.entries(fieldsOf(recording)).filter(differs);
  const text = fields.map(([key, [name, { write }]]) => `${key}=${write(now[name])}`).join("&");
  const address = new URL(location.href);
  address.hash = "";
  return address.href.replace(/#$/, "") + (text && `#${text}`);
}

/** Show what an address says; whatever it does not say, or says wrongly, is as at first. */
function showLinked(explorer) {
  const given = new URLSearchParams(location.hash.slice(1));
  const read = (isTime) => {
    const found = {};
    for (const [key, [name, { read: from }]] of Object.entries(fieldsOf(explorer.recording))) {
      if (isTime !== ["laser", "unwarped"].includes(name)) continue; // These move the others
      const value = given.has(key) ? from(given.get(key)) : NaN;
      const isKnown = typeof value === "object" ? Object.values(value).flat().every(Number.isFinite) : value === value;
      found[name] = isKnown ? value : explorer.first[name];
    }
    return found;
  };
  explorer.set(read(true));
  explorer.set(read(false));
}

/** Show what the page's address says, and keep the address as what is shown. */
export function keepLinked(explorer, signal) {
  if (location.hash) showLinked(explorer);
  addEventListener("hashchange", () => showLinked(explorer), { signal });
  let timer;
  explorer.shown = () => {
    clearTimeout(timer);
    const write = () => {
      const link = linkOf(explorer);
      if (link !== location.href) history.replaceState(history.state, "", link);
    };
    if (!explorer.now.playing) timer = setTimeout(write, PAUSE);
  };
}
