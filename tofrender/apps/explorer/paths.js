/** Paths by which light reached a pixel: as a list, and drawn into the picture. */

import { fill, make, svg } from "../ui/parts.js";
import { short } from "./words.js";

const MOST_KINDS = 8; // rows of the list
const MOST_LINES = 12; // drawn of the chosen kind
const MOST_LISTS = 50; // that are remembered

/**
 * Paths of an explorer's pixels: those of `lists`, and those that `ask(pixel, range)` is asked
 * for, if there is somebody to ask; they come in by `add`.
 */
export class Paths {
  constructor(lists, level, ask) {
    this.lists = [...lists];
    this.ask = ask;
    this.asked = null;
    this.chosen = 0;
    this.table = make("table", { className: "paths" });
    this.state = make("p", { className: "quiet" });
    this.lines = svg("svg", { class: "lines", "aria-hidden": "true", preserveAspectRatio: "none" });
    this.element = make(
      "section",
      { className: "panel", "aria-label": "Paths" },
      make("div", { className: "heading" }, make(`h${level}`, {}, "Paths of this light")),
      ...[this.state, this.table],
    );
    this.element.hidden = !this.lists.length && !ask;
  }

  /** Take in paths of a pixel, or `error`, why there are none. */
  add(list) {
    this.lists = [...this.lists.filter((each) => !each.error).slice(-MOST_LISTS), list];
  }

  /** Show the paths of a pixel of the light, [x, y] on the film, with lengths in a range [m]. */
  show(pixel, range, grid) {
    if (this.element.hidden) return;
    const list = pixel && this.lists.findLast((each) => isFor(each, pixel, range, grid));
    if (pixel && !list) this.request(middleOf(pixel, grid), range);
    const kinds = list && !list.error ? kindsOf(list, range) : [];
    this.state.textContent = stateOf(pixel, list, kinds, this.ask);
    this.state.hidden = !this.state.textContent;
    this.chosen = Math.min(this.chosen, Math.max(0, kinds.length - 1));
    const all = kinds.reduce((sum, { light }) => sum + light, 0);
    const rows = kinds.slice(0, MOST_KINDS).map(({ shapes, light, opl }, k) => {
      const name = make("button", { type: "button", className: "kind", "aria-pressed": k === this.chosen }, shapes);
      name.addEventListener("click", () => {
        this.chosen = k;
        this.show(pixel, range, grid);
      });
      return [name, opl, `${short((100 * light) / all, 2)} %`];
    });
    this.table.hidden = !rows.length;
    if (rows.length) fill(this.table, [["from the light to the sensor", "length [m]", "of the light"], ...rows]);
    this.draw(kinds[this.chosen]?.paths ?? [], grid);
  }

  /** Ask for paths once for each pixel and range. */
  request(pixel, range) {
    const key = JSON.stringify([pixel, range]);
    if (!this.ask || key === this.asked) return;
    this.asked = key;
    clearTimeout(this.waiting);
    this.waiting = setTimeout(() => this.ask(pixel, range), 200);
  }

  draw(paths, { first, width, height }) {
    this.lines.setAttribute("viewBox", `${first[0]} ${first[1]} ${width} ${height}`);
    const points = ({ film }) => film.filter(Boolean).map((point) => point.join(",")).join(" ");
    this.lines.replaceChildren(
      ...paths.slice(0, MOST_LINES).map((path) => svg("polyline", { points: points(path) })),
    );
  }
}

/** The pixel of the film in the middle of a block. */
function middleOf(pixel, { first, width, height, step }) {
  const last = [first[0] + width - 1, first[1] + height - 1];
  return pixel.map((least, k) => Math.min(least + Math.floor(step / 2), last[k]));
}

/** Whether a list has the paths of a block of pixels and a range; a traced one is of its range only. */
function isFor(list, pixel, range, { step }) {
  const off = list.opl && [range[0] - list.opl[0], list.opl[1] - range[1]];
  const inside = !off || off.every((each) => (list.traced ? Math.abs(each) < 1e-9 : each > -1e-9));
  return inside && pixel.every((least, k) => list.pixel[k] >= least && list.pixel[k] < least + step);
}

/** Paths in range by the shapes that they meet, the brightest first. */
function kindsOf({ paths, traced }, [low, high]) {
  const kinds = new Map();
  for (const path of paths) {
    if (!path.light || (!traced && (path.opl < low || path.opl >= high))) continue;
    const shapes = [...path.shapes].reverse().join(" → ");
    const kind = kinds.get(shapes) ?? { shapes, light: 0, paths: [] };
    kind.light += path.light;
    kind.paths.push(path);
    kinds.set(shapes, kind);
  }
  const found = [...kinds.values()].sort((a, b) => b.light - a.light);
  for (const kind of found) {
    const lengths = kind.paths.map(({ opl }) => opl);
    const [least, most] = [Math.min(...lengths), Math.max(...lengths)].map((opl) => opl.toFixed(2));
    kind.opl = least === most ? least : `${least}–${most}`;
  }
  return found;
}

function stateOf(pixel, list, kinds, ask) {
  if (!pixel) return "Choose a pixel.";
  if (list?.error) return list.error;
  if (!list) return ask ? "Tracing …" : "No paths of this pixel are in this file.";
  return kinds.length ? "" : "No path that was found brings light to this pixel then.";
}
