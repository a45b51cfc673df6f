// Points of a warp and the grid that it bends, in the plane or on the sphere.
//
// The model has `points` and `lines`, float32 with one coordinate after the other (NaN ends a
// line), `view` ("2D" or "3D"), `parts` (of "points", "grid") and `domain`: `dimensions`, `low`,
// `high`, `labels`, `down`, `upper_only`, `alt`. Directions in 2D have the azimuth to the right and
// the cosine of the polar angle upwards.

const TURN = [-0.6, 0.42];

export function render({ model }) {
  const root = document.createElement("div");
  root.style.cssText = "position:relative;width:100%;height:100%;min-height:300px";
  const canvas = document.createElement("canvas");
  canvas.style.cssText = "position:absolute;inset:0;width:100%;height:100%;touch-action:pan-y";
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "img");
  root.append(canvas);

  let turn = [...TURN];
  let pending = 0;
  const redraw = () => {
    if (!pending) pending = requestAnimationFrame(() => ((pending = 0), draw(canvas, model, turn)));
  };
  for (const name of ["points", "lines", "domain", "view", "parts"]) model.on(name, redraw);
  const size = new ResizeObserver(redraw);
  size.observe(root);
  const scheme = matchMedia("(prefers-color-scheme: dark)");
  scheme.addEventListener("change", redraw);
  model.on("remove", () => {
    size.disconnect();
    scheme.removeEventListener("change", redraw);
  });

  const move = (dx, dy) => {
    turn = [turn[0] + dx, Math.max(-Math.PI / 2, Math.min(Math.PI / 2, turn[1] + dy))];
    redraw();
  };
  let from = null;
  const turns = () => model.domain.dimensions === 3 && model.view === "3D";
  canvas.addEventListener("pointerdown", (event) => {
    if (!turns()) return;
    from = [event.clientX, event.clientY];
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!from) return;
    move(0.01 * (event.clientX - from[0]), 0.01 * (event.clientY - from[1]));
    from = [event.clientX, event.clientY];
  });
  for (const end of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(end, () => (from = null));
  }
  canvas.addEventListener("dblclick", () => ((turn = [...TURN]), redraw()));
  canvas.addEventListener("keydown", (event) => {
    const steps = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] };
    if (!turns() || !(event.key in steps)) return;
    move(...steps[event.key]);
    event.preventDefault();
  });
  model.ready += 1; // From now on, what is sent arrives
  return root;
}

// ------------------------------------------------------------------------------- all of it

function draw(canvas, model, turn) {
  const box = canvas.getBoundingClientRect();
  if (box.width < 10 || box.height < 10) return;
  const scale = window.devicePixelRatio || 1;
  canvas.width = Math.round(box.width * scale);
  canvas.height = Math.round(box.height * scale);
  const c = canvas.getContext("2d");
  c.scale(scale, scale);
  c.font = "12px system-ui, sans-serif";
  const d = model.domain.dimensions;
  const points = columns(model.points, d);
  const lines = columns(model.lines, d);
  const shown = { points: model.parts.includes("points"), grid: model.parts.includes("grid") };
  const colours = colours_of(canvas);
  const solid = d === 3 && model.view === "3D";
  canvas.setAttribute("aria-label", model.domain.alt);
  canvas.style.cursor = solid ? "grab" : "default";
  canvas.dataset.count = points[0].length;
  canvas.dataset.view = solid ? "3D" : "2D";
  canvas.dataset.grid = shown.grid ? lines[0].length : 0;
  canvas.dataset.first = points.map((axis) => (axis.length ? axis[0].toPrecision(5) : "")).join(" ");
  if (solid) draw_solid(c, box, model, turn, points, lines, shown, colours);
  else draw_flat(c, box, model, points, lines, shown, colours);
}

function columns(bytes, d) {
  const all = new Float32Array(bytes?.slice?.(0) ?? new ArrayBuffer(0));
  const n = Math.floor(all.length / d);
  return Array.from({ length: d }, (_, k) => all.subarray(k * n, (k + 1) * n));
}

function colours_of(element) {
  const ink = getComputedStyle(element).color;
  const [r, g, b] = (ink.match(/[\d.]+/g) || [0, 0, 0]).map(Number);
  const dark = r + g + b > 382;
  return dark
    ? { ink, soft: "rgba(255,255,255,.28)", points: "#7cc0ff", grid: "#ffb454" }
    : { ink, soft: "rgba(0,0,0,.25)", points: "#0b5cad", grid: "#d0700a" };
}

function radius_of(count) {
  return Math.max(0.7, Math.min(3.2, 70 / Math.sqrt(Math.max(count, 1))));
}

// ---------------------------------------------------------------------------------- the plane

function draw_flat(c, box, model, points, lines, shown, colours) {
  const unrolled = model.domain.dimensions === 3;
  const low = unrolled ? [-Math.PI, model.domain.upper_only ? 0 : -1] : model.domain.low;
  const high = unrolled ? [Math.PI, 1] : model.domain.high;
  const labels = unrolled ? ["φ [rad]", "cos θ"] : model.domain.labels;
  let [left, top, width, height] = [58, 14, box.width - 74, box.height - 62];
  if (!unrolled) {
    const side = Math.min(width, height);
    left += (width - side) / 2;
    [width, height] = [side, side];
  }
  const x_of = (x) => left + (width * (x - low[0])) / (high[0] - low[0]);
  const up = (y) => (y - low[1]) / (high[1] - low[1]);
  const y_of = (y) => top + height * (model.domain.down ? up(y) : 1 - up(y));

  c.strokeStyle = colours.soft;
  c.lineWidth = 1;
  c.strokeRect(left, top, width, height);
  c.fillStyle = colours.ink;
  c.textAlign = "center";
  c.textBaseline = "top";
  for (const [value, text] of unrolled ? angles() : ticks(low[0], high[0])) {
    tick(c, x_of(value), top + height, 0, 5);
    c.fillText(text, x_of(value), top + height + 8);
  }
  c.fillText(labels[0], left + width / 2, top + height + 28);
  c.textAlign = "right";
  c.textBaseline = "middle";
  for (const [value, text] of ticks(low[1], high[1])) {
    tick(c, left, y_of(value), -5, 0);
    c.fillText(text, left - 8, y_of(value));
  }
  c.save();
  c.translate(left - 44, top + height / 2);
  c.rotate(-Math.PI / 2);
  c.textAlign = "center";
  c.fillText(labels[1], 0, 0);
  c.restore();

  const flat = (axes) => (unrolled ? unroll(axes) : axes);
  if (shown.points) {
    const [x, y] = flat(points);
    dots(c, x.length, (i) => x_of(x[i]), (i) => y_of(y[i]), colours.points, 0.85);
  }
  if (shown.grid) {
    const [x, y] = flat(lines);
    const jump = unrolled ? Math.PI : 0.25 * (high[0] - low[0]);
    const near = (i) => Math.abs(x[i] - x[i - 1]) < jump && Math.abs(y[i] - y[i - 1]) < jump;
    polyline(c, x.length, (i) => x_of(x[i]), (i) => y_of(y[i]), near, colours.grid, 0.75);
  }
}

function unroll([x, y, z]) {
  return [x.map((each, i) => Math.atan2(y[i], each)), z];
}

function angles() {
  return [-1, -0.5, 0, 0.5, 1].map((k, i) => [k * Math.PI, ["−π", "−π/2", "0", "π/2", "π"][i]]);
}

function ticks(low, high) {
  const step = (high - low) / 4;
  const text = (value) => String(Math.round(value * 100) / 100).replace("-", "−");
  return [0, 1, 2, 3, 4].map((k) => [low + k * step, text(low + k * step)]);
}

function tick(c, x, y, dx, dy) {
  c.beginPath();
  c.moveTo(x, y);
  c.lineTo(x + dx, y + dy);
  c.stroke();
}

// --------------------------------------------------------------------------------- the sphere

function draw_solid(c, box, model, [azimuth, elevation], points, lines, shown, colours) {
  const R = 0.5 * Math.min(box.width, box.height) - 34;
  const lift = model.domain.upper_only ? 0.3 * R * Math.cos(elevation) : 0;
  const [cx, cy] = [box.width / 2, box.height / 2 + lift];
  const [ca, sa, ce, se] = [azimuth, elevation].flatMap((a) => [Math.cos(a), Math.sin(a)]);
  // x to the right, y away, z up, seen from the front and above
  const place = (x, y, z) => {
    const right = ca * x - sa * y;
    const away = sa * x + ca * y;
    return [cx + R * right, cy - R * (ce * z + se * away), se * z - ce * away];
  };

  const ring = (at) => {
    const [front, back] = [[], []];
    for (let k = 0; k <= 96; k++) {
      const p = place(...at((2 * Math.PI * k) / 96));
      (p[2] >= 0 ? front : back).push(p);
      (p[2] >= 0 ? back : front).push(null);
    }
    path(c, front, colours.soft, 1);
    c.setLineDash([3, 4]);
    path(c, back, colours.soft, 1);
    c.setLineDash([]);
  };
  if (!model.domain.upper_only) {
    c.beginPath();
    c.arc(cx, cy, R, 0, 2 * Math.PI);
    c.strokeStyle = colours.soft;
    c.stroke();
  } else {
    const half = (plane) => (t) => plane(0.5 * t);
    ring(half((t) => [Math.cos(t), 0, Math.sin(t)]));
    ring(half((t) => [0, Math.cos(t), Math.sin(t)]));
  }
  ring((t) => [Math.cos(t), Math.sin(t), 0]);

  const both = (axes, paint, back, front) => {
    const where = Array.from(axes[0], (x, i) => place(x, axes[1][i], axes[2][i]));
    paint(where, (p) => p[2] < 0, back);
    paint(where, (p) => p[2] >= 0, front);
  };
  if (shown.points) {
    const paint = (where, side, alpha) => {
      const those = where.filter(side);
      dots(c, those.length, (i) => those[i][0], (i) => those[i][1], colours.points, alpha, where.length);
    };
    both(points, paint, 0.25, 0.9);
  }
  if (shown.grid) {
    const paint = (where, side, alpha) => {
      const near = (i) => side(where[i]) && Math.hypot(...where[i].map((v, k) => v - where[i - 1][k])) < 0.3 * R;
      polyline(c, where.length, (i) => where[i][0], (i) => where[i][1], near, colours.grid, alpha);
    };
    both(lines, paint, 0.22, 0.8);
  }
  c.fillStyle = colours.ink;
  c.strokeStyle = colours.ink;
  c.textAlign = "center";
  c.textBaseline = "middle";
  for (const [name, end] of Object.entries({ x: [1, 0, 0], y: [0, 1, 0], z: [0, 0, 1] })) {
    const [a, b] = [place(...end), place(...end.map((v) => 1.16 * v))];
    const text = place(...end.map((v) => 1.25 * v));
    c.globalAlpha = a[2] < -0.05 ? 0.45 : 1;
    path(c, [a, b], colours.ink, 1.5);
    c.fillText(name, text[0], text[1]);
  }
  c.globalAlpha = 1;
}

// ------------------------------------------------------------------------------- strokes

function path(c, places, colour, width) {
  c.beginPath();
  let drawing = false;
  for (const p of places) {
    if (p === null) drawing = false;
    else if (drawing) c.lineTo(p[0], p[1]);
    else c.moveTo(p[0], p[1]), (drawing = true);
  }
  c.strokeStyle = colour;
  c.lineWidth = width;
  c.stroke();
}

function polyline(c, count, x_of, y_of, joins, colour, alpha) {
  c.beginPath();
  let at = -1;
  for (let i = 1; i < count; i++) {
    if (!joins(i)) continue;
    if (at !== i - 1) c.moveTo(x_of(i - 1), y_of(i - 1));
    c.lineTo(x_of(i), y_of(i));
    at = i;
  }
  c.globalAlpha = alpha;
  c.strokeStyle = colour;
  c.lineWidth = 1;
  c.stroke();
  c.globalAlpha = 1;
}

function dots(c, count, x_of, y_of, colour, alpha, total = count) {
  const radius = radius_of(total);
  c.fillStyle = colour;
  c.globalAlpha = alpha;
  for (let i = 0; i < count; i++) {
    const [x, y] = [x_of(i), y_of(i)];
    if (radius < 1.2) c.fillRect(x - radius, y - radius, 2 * radius, 2 * radius);
    else c.beginPath(), c.arc(x, y, radius, 0, 2 * Math.PI), c.fill();
  }
  c.globalAlpha = 1;
}
