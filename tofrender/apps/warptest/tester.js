/** The warp tester: controls, points, and the verdict of the test. */

import { live } from "../ui/app.js";
import { button, choices, group, list, make, number, slider, tell, tick } from "../ui/parts.js";
import { Points } from "./points.js";

class Tester {
  constructor({ model, root, draw, choose, ask }) {
    this.model = model;
    const { state } = model;
    this.now = { view: "3D", points: true, grid: true };
    const show = (changes) => {
      Object.assign(this.now, changes);
      draw();
    };
    const options = (values) => values.map((value) => [String(value), value.toLocaleString("en").replaceAll(",", " ")]);
    this.source = list("Whose", [], (source) => {
      const names = this.names(source);
      choose({ source, subject: names.includes(model.chosen.subject) ? model.chosen.subject : names[0] });
    });
    this.subject = list("Distribution", [], (subject) => choose({ subject }));
    this.setValue = (name, value) => choose({ values: { ...model.chosen.values, [name]: value } });
    this.parameter = group("row given");
    this.parameterOf = null;
    this.file = make("input", { type: "file", accept: ".exr,.png,.jpg", "aria-label": "Image" });
    this.file.addEventListener("change", async () => {
      const [file] = this.file.files;
      if (file) ask("image", { name: file.name, content: await file.arrayBuffer() });
    });
    this.image = group("row", this.file, button("2 × 2 example", () => ask("example")));
    this.kind = list("Point set", options(state.kinds), (kind) => choose({ kind }));
    const power = { max: 16, say: (each) => String(2 ** each), moved: (each) => choose({ count: 2 ** each }) };
    this.count = slider("Points", power);
    this.seed = number("Seed", { min: 0, max: state.maxSeed, step: 1, changed: (seed) => choose({ seed }) });
    this.view = choices("View", [["3D", "3D"], ["2D", "2D"]], (view) => show({ view }));
    this.showPoints = tick("points", (points) => show({ points }));
    this.showGrid = tick("grid", (grid) => show({ grid }));
    this.samples = list("Samples", options(state.samples), (samples) => choose({ samples: Number(samples) }));
    this.test = button("Run the χ² test", () => ask("test"), "primary");
    this.format = list("Figure", options(["png", "pdf", "svg"]), () => {});
    this.save = button("Save the figure", () => ask("save", { format: this.format.querySelector("select").value }));
    this.title = make("h2");
    this.density = make("p");
    this.canvas = make("canvas", { tabIndex: 0, role: "img" });
    this.points = new Points(this.canvas, draw);
    this.error = make("div", { role: "status" });
    this.verdict = make("div", { role: "status" });
    this.panels = group("panels");
    root.append(...this.layout(state.note));
  }

  layout(note) {
    const set = (...parts) => make("fieldset", {}, group("row", ...parts));
    const about = "Points of the unit square, warped; and a χ² test of the warp against its density.";
    const left = group(
      "left",
      ...[set(this.source, this.subject, this.parameter, this.image), this.error],
      ...[group("heading", this.title, this.density), this.canvas],
      ...[group("row", this.view, this.showPoints, this.showGrid), set(this.kind, this.seed, this.count)],
    );
    const right = group(
      "left",
      ...[group("heading", make("h2", {}, "χ² test")), set(this.samples, this.test), this.verdict],
      ...[this.panels, set(this.format, this.save), make("p", { className: "quiet" }, note)],
    );
    const header = make("header", {}, make("h1", {}, "Warp tester"), make("p", { className: "quiet" }, about));
    return [header, group("stage", left, right)];
  }

  names(source) {
    return this.model.state.sources.find(([each]) => each === source)[2];
  }

  draw() {
    const { state, chosen, data } = this.model;
    const { now } = this;
    const subject = state.subjects[chosen.subject];
    this.source.offer(state.sources.map(([source, label]) => [source, label]));
    this.source.hidden = state.sources.length < 2;
    const named = (name) => [name, state.subjects[name].title, state.subjects[name].group];
    this.subject.offer(this.names(chosen.source).map(named));
    for (const name of ["source", "subject", "kind", "seed", "samples"]) this[name].set(chosen[name]);
    this.count.set(Math.log2(chosen.count));
    this.drawParameter(subject.parameter[0], chosen.values);
    this.image.hidden = !subject.takesImage;
    this.view.hidden = subject.dimensions === 2;
    this.view.set(now.view);
    this.showPoints.set(now.points);
    this.showGrid.set(now.grid);
    tell(this.error, state.error);
    tell(this.verdict, state.verdict);
    this.test.disabled = state.testing;
    this.save.disabled = !state.panels || !data.points?.byteLength;
    if (this.drawnPanels !== state.panels) {
      this.drawnPanels = state.panels; // Matplotlib's, without anybody's text
      const parsed = new DOMParser().parseFromString(state.panels, "image/svg+xml");
      this.panels.replaceChildren(...(state.panels ? [parsed.documentElement] : []));
    }
    if (!data.points) return;
    const solid = data.dimensions === 3 && now.view === "3D";
    this.title.textContent = state.subjects[data.subject].title;
    this.density.textContent = state.subjects[data.subject].density + (solid ? " · drag to turn" : "");
    this.points.draw(data, { ...now, solid });
  }

  /** A slider and a number, which may be out of the slider's range. */
  drawParameter({ name, label, low, high, step, default: first } = {}, values) {
    if (this.parameterOf !== name) {
      const moved = (value) => this.setValue(name, value);
      const parts = [slider(label, { min: low, max: high, step, moved }), number(`${label} as a number`, { changed: moved })];
      this.parameter.replaceChildren(...(name ? parts : []));
      this.parameter.hidden = !name;
      this.parameterOf = name;
    }
    for (const part of this.parameter.children) part.set(values[name] ?? first);
  }
}

export function render({ model }) {
  return live(model, "tof-warptest", Tester);
}
