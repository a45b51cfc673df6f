/** Elements of a page. Text gets in as text only, never as markup. */

/** An element: `properties` are set on it, `aria-...` and the like as attributes. */
export function make(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name.includes("-") || name === "role") element.setAttribute(name, value);
    else element[name] = value;
  }
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

/** A `div` of a class. */
export function group(className, ...children) {
  return make("div", { className }, ...children);
}

/** A slider with its name and what its value says. */
export function slider(name, { min = 0, max = 1, step = 1, value = min, say = String, title = "", moved }) {
  const input = make("input", { type: "range", min, max, step, title, "aria-label": name });
  const output = make("output");
  const tell = () => {
    output.textContent = say(input.valueAsNumber);
    input.setAttribute("aria-valuetext", output.textContent);
  };
  const element = make("label", { className: "slider" }, make("span", {}, name), input, output);
  element.set = (next) => {
    input.value = next;
    tell();
  };
  element.limit = (most) => {
    input.max = most;
  };
  input.addEventListener("input", () => {
    tell();
    moved(input.valueAsNumber);
  });
  element.set(value);
  return element;
}

/** Buttons of which one is pressed. */
export function choices(name, options, chosen) {
  const buttons = options.map(([value, label, title = ""]) => {
    const button = make("button", { type: "button", title, role: "radio" }, label);
    button.addEventListener("click", () => chosen(value));
    button.addEventListener("keydown", (event) => {
      const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
      if (!step) return;
      event.preventDefault();
      event.stopPropagation();
      const at = options.findIndex(([each]) => each === value);
      const next = (at + step + options.length) % options.length;
      chosen(options[next][0]);
      buttons[next].focus();
    });
    return button;
  });
  const element = make("div", { className: "choices", role: "radiogroup", "aria-label": name });
  element.append(...buttons);
  element.set = (value) =>
    options.forEach(([each], k) => {
      buttons[k].setAttribute("aria-checked", String(each === value));
      buttons[k].tabIndex = each === value ? 0 : -1;
    });
  return element;
}

/** A list to choose from; `offer` replaces its options [value, label, group], all text. */
export function list(name, options, chosen) {
  const select = make("select", { "aria-label": name });
  select.addEventListener("change", () => chosen(select.value));
  const element = make("label", { className: "list" }, make("span", {}, name), select);
  element.set = (value) => {
    select.value = value;
  };
  let offered = "";
  element.offer = (next) => {
    if (offered === (offered = JSON.stringify(next))) return;
    const groups = new Map([[undefined, select]]);
    select.replaceChildren();
    for (const [value, label, group] of next) {
      if (!groups.has(group)) groups.set(group, select.appendChild(make("optgroup", { label: group })));
      groups.get(group).append(make("option", { value }, label));
    }
  };
  element.offer(options);
  return element;
}

/** A number to type; the browser says why another text is not accepted. */
export function number(name, { min = "", max = "", step = "any", value = 0, changed }) {
  const input = make("input", { type: "number", min, max, step, "aria-label": name });
  input.required = true;
  input.addEventListener("change", () => input.reportValidity() && changed(input.valueAsNumber));
  const element = make("label", { className: "list" }, make("span", {}, name), input);
  element.set = (next) => {
    if (input.valueAsNumber !== next) input.value = next;
  };
  element.limit = (limits) => Object.assign(input, limits);
  element.set(value);
  return element;
}

/** A button with a text. */
export function button(text, pressed, className = "") {
  const element = make("button", { type: "button", className: `button ${className}` }, text);
  element.addEventListener("click", pressed);
  return element;
}

/** Show a message {kind, title, text, code, rows} of Python, or none. */
export function tell(element, message) {
  const { kind = "", title = "", text = "", code = "", rows = [] } = message ?? {};
  const parts = [title && make("strong", {}, title), text && make("p", {}, text), code && make("pre", {}, code)];
  element.className = `message ${kind}`;
  element.hidden = !title;
  element.replaceChildren(...parts.filter(Boolean), ...(rows.length ? [make("dl", {}, ...terms(rows))] : []));
}

/** What a list of names and values has in it. */
export function terms(rows = []) {
  return rows.flatMap(([name, value]) => [make("dt", {}, name), make("dd", {}, value)]);
}

/** A box to tick. */
export function tick(name, chosen, title = "") {
  const input = make("input", { type: "checkbox" });
  input.addEventListener("change", () => chosen(input.checked));
  const element = make("label", { className: "tick", title }, input, make("span", {}, name));
  element.set = (value) => {
    input.checked = value;
  };
  return element;
}

/** A short line, as a legend shows one. */
export function lineSwatch(dash, color) {
  const ends = { x1: 0, y1: 5, x2: 28, y2: 5 };
  const line = svg("line", { ...ends, stroke: color, "stroke-width": 1.5, "stroke-dasharray": dash.join(" ") });
  return svg("svg", { width: 28, height: 10, "aria-hidden": "true" }, line);
}

/** An element of a vector picture. */
export function svg(tag, attributes, ...children) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

/** Rows of cells, the first row of headings; what has not changed stays, with the reader's focus. */
export function fill(table, [headings, ...rows]) {
  if (table.rows.length !== rows.length + 1) {
    const cells = (tag, row) => row.map(() => make(tag));
    table.replaceChildren(
      make("thead", {}, make("tr", {}, ...cells("th", headings))),
      make("tbody", {}, ...rows.map((row) => make("tr", {}, ...cells("td", row)))),
    );
  }
  [headings, ...rows].forEach((row, number) => {
    row.forEach((content, k) => fillCell(table.rows[number].cells[k], content));
  });
}

function fillCell(cell, content) {
  if (typeof content === "string") {
    if (cell.textContent !== content) cell.textContent = content;
  } else if (!cell.firstChild?.isEqualNode(content)) {
    const focused = cell.contains(document.activeElement);
    cell.replaceChildren(content);
    if (focused) content.focus();
  }
}

/** Where a pointer is in an element, as parts of its width and height. */
export function placeIn(element, { clientX, clientY }) {
  const { left, top, width, height } = element.getBoundingClientRect();
  return [(clientX - left) / width, (clientY - top) / height];
}

/** Follow a pointer from where it goes down until it is lifted. */
export function follow(element, { down, move, tap }) {
  element.addEventListener("pointerdown", (event) => {
    if (event.button) return;
    const held = down(event);
    if (!held && !tap) return;
    if (held) {
      event.preventDefault();
      element.setPointerCapture(event.pointerId);
    }
    const moved = (next) => held && move(next, held);
    const end = (last) => {
      element.removeEventListener("pointermove", moved);
      element.removeEventListener("pointerup", end);
      element.removeEventListener("pointercancel", end);
      if (!held && last.type === "pointerup") tap(last);
    };
    element.addEventListener("pointermove", moved);
    element.addEventListener("pointerup", end);
    element.addEventListener("pointercancel", end);
  });
}

/** Colors of a part as its style sheet has them, by names like "line". */
export function inkOf(element) {
  const style = getComputedStyle(element);
  const names = ["paper", "text", "line", "grid", "soft", "accent", "band"];
  return Object.fromEntries(names.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
}

/** Call `draw` whenever an element's size or the page's theme changes, until the signal aborts. */
export function watchLook(element, draw, signal) {
  const watchers = [new ResizeObserver(draw), new MutationObserver(draw)];
  watchers[0].observe(element);
  for (const each of [document.body, document.documentElement]) watchers[1].observe(each, { attributes: true });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw, { signal });
  signal.addEventListener("abort", () => watchers.forEach((each) => each.disconnect()));
}

/** Whether the page around is dark: as Jupyter, VS Code and Colab say, else as the reader likes. */
export function isDark(element) {
  const told = (element.closest("[data-jp-theme-light]") ?? document.body).dataset.jpThemeLight;
  if (told) return told === "false";
  if (/vscode-(dark|high-contrast(?!-light))/.test(document.body.className)) return true;
  if (document.body.className.includes("vscode-")) return false;
  const theme = document.documentElement.getAttribute("theme");
  if (theme) return theme === "dark";
  return matchMedia("(prefers-color-scheme: dark)").matches;
}
