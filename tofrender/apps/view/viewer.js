/**
 * The explorer with what only a live application can do.
 *
 * State: `message`; `live` {status, running, canStop, out, canSave} of a render; `region`, sizes by
 * axis of a film that was reduced. Data: `header` and `bytes` of an explorer.
 */

import { mount } from "../explorer/explorer.js";
import { live } from "../ui/app.js";
import { button, group, make, number, tell } from "../ui/parts.js";

const AXES = { y: "Rows", x: "Columns", opl: "Bins" };

class Viewer {
  constructor({ model, root, ask }) {
    Object.assign(this, { model, ask });
    model.on("msg:custom", ({ paths }) => paths && this.handle?.addPaths(paths));
    this.message = make("div", { role: "status" });
    this.status = make("p", { className: "quiet", role: "status" });
    this.stop = button("Stop", () => ask("stop_or_go_on"));
    this.save = button("", () => ask("save"));
    this.controls = group("row", this.stop, this.save, this.status);
    this.fields = Object.entries(AXES).flatMap(([axis, name]) =>
      ["from", "to"].map((side, end) => {
        const changed = (value) => (this.ends[axis][end] = value);
        const field = number(`${name} ${side}`, { min: 0, step: 1, value: 0, changed });
        return Object.assign(field, { axis, end });
      }),
    );
    const closer = button("Look closer", () => ask("look_closer", { ends: this.ends }), "primary");
    this.region = group("row", ...this.fields, closer);
    this.explorer = make("div");
    const server = make("fieldset", {}, this.controls, this.region);
    root.append(server, this.message, this.explorer);
  }

  draw() {
    const { live: render, message, region } = this.model.state;
    tell(this.message, message);
    this.controls.hidden = !render;
    if (render) {
      this.askPaths ??= (pixel, range) => this.ask("trace", { pixel, range });
      this.status.textContent = render.status;
      this.stop.textContent = render.running ? "Stop" : "Go on";
      this.stop.disabled = !render.canStop;
      this.save.textContent = `Save as ${render.out}`;
      this.save.disabled = !render.canSave;
    }
    this.region.hidden = !region;
    if (region && !this.ends) {
      this.ends = Object.fromEntries(Object.entries(region).map(([axis, size]) => [axis, [0, size]]));
      for (const field of this.fields) {
        field.limit({ max: region[field.axis] });
        field.set(this.ends[field.axis][field.end]);
      }
    }
    const { data } = this.model;
    if (!data.header || data === this.shown) return;
    this.shown = data;
    const contents = { header: data.header, bytes: new Uint8Array(data.bytes) };
    if (this.handle) this.handle.setData(contents);
    else this.handle = mount(this.explorer, contents, { level: 1, linked: true, askPaths: this.askPaths });
  }

  remove() {
    this.handle?.destroy();
  }
}

export function render({ model }) {
  return live(model, "tof-view", Viewer);
}
