/** A live page: its parts are made here, what they show is computed in Python. */

import { isDark, make, watchLook } from "./parts.js";

const LOST =
  "The server has stopped. What is shown here stays, but nothing new is computed: start the command " +
  "again, and open the address that it prints.";

/**
 * Mount a page whose `model`, a component of Panel, has `state` (numbers and texts), `data` (arrays
 * as bytes) and `chosen`, what the reader chose.
 *
 * `new Page(app)` fills `app.root`; its `draw()` is called whenever something has changed.
 */
export function live(model, className, Page) {
  const root = make("section", { className: `tof-app ${className}`, "data-lm-suppress-shortcuts": "true" });
  let asked = 0;
  const draw = () => {
    cancelAnimationFrame(asked);
    asked = requestAnimationFrame(() => {
      root.classList.toggle("dark", isDark(root));
      page.draw();
    });
  };
  const choose = (changes) => {
    model.chosen = { ...model.chosen, ...changes };
  };
  const ask = (what, more = {}) => model.send_msg({ do: what, ...more });
  const page = new Page({ model, root, draw, choose, ask });
  for (const name of ["state", "data", "chosen"]) model.on(name, draw);
  model.on("msg:custom", download);

  const stopped = new AbortController();
  const { signal } = stopped;
  watchLook(root, draw, signal);
  globalThis.Bokeh?.documents?.[0]?.on_event("connection_lost", () => {
    if (signal.aborted || root.querySelector(".lost")) return;
    root.prepend(make("p", { className: "message bad lost", role: "alert" }, LOST));
    for (const set of root.querySelectorAll("fieldset")) set.disabled = true;
  });
  model.on("remove", () => {
    stopped.abort();
    page.remove?.();
  });
  ask("open");
  draw();
  return root;
}

function download({ name, content }) {
  if (!content) return;
  const link = make("a", { download: name, href: URL.createObjectURL(new Blob([content])) });
  link.click();
  URL.revokeObjectURL(link.href);
}
