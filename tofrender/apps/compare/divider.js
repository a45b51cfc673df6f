// Two pictures of one size, the first to the left of a divider that is dragged.
//
// The model has `left` and `right`, float32 RGB row by row, `size` (width, height), `exposure` [stops],
// `names` and `ready`.

export function render({ model }) {
  const root = document.createElement("div");
  root.style.cssText = "position:relative;width:100%;max-width:900px;touch-action:pan-y;user-select:none";
  const [right, left] = [document.createElement("canvas"), document.createElement("canvas")];
  for (const canvas of [right, left]) {
    canvas.style.cssText = "display:block;width:100%;image-rendering:pixelated;border-radius:4px";
    canvas.setAttribute("role", "img");
  }
  left.style.position = "absolute";
  left.style.inset = "0";
  left.style.height = "100%";
  const line = document.createElement("div");
  line.style.cssText =
    "position:absolute;top:0;bottom:0;width:2px;margin-left:-1px;background:#fff;pointer-events:none;" +
    "box-shadow:0 0 0 1px rgba(0,0,0,.55)";
  const slider = document.createElement("input");
  Object.assign(slider, { type: "range", min: 0, max: 100, step: 0.5, value: 50 });
  slider.setAttribute("aria-label", "Divider between the two pictures");
  slider.style.cssText = "width:100%;margin:8px 0 0;accent-color:var(--tf-accent,#0b5cad)";
  const tags = [0, 1].map((side) => {
    const tag = document.createElement("span");
    tag.style.cssText =
      `position:absolute;top:8px;${side ? "right" : "left"}:8px;padding:2px 8px;border-radius:4px;` +
      "background:rgba(0,0,0,.62);color:#fff;font:12px system-ui,sans-serif;pointer-events:none";
    return tag;
  });
  const frame = document.createElement("div");
  frame.style.cssText = "position:relative;cursor:ew-resize";
  frame.append(right, left, line, ...tags);
  root.append(frame, slider);

  const divide = () => {
    const at = Number(slider.value);
    left.style.clipPath = `inset(0 ${100 - at}% 0 0)`;
    line.style.left = `${at}%`;
    root.dataset.divider = at;
  };
  const paint = () => {
    for (const [canvas, bytes, name] of [[left, model.left, 0], [right, model.right, 1]]) {
      develop(canvas, bytes, ...model.size, model.exposure);
      canvas.setAttribute("aria-label", model.names[name] || "");
      tags[name].textContent = model.names[name] || "";
    }
    root.dataset.width = model.size[0];
    root.dataset.exposure = model.exposure;
  };
  let held = false;
  const to = (event) => {
    const box = frame.getBoundingClientRect();
    slider.value = (100 * (event.clientX - box.left)) / box.width;
    divide();
  };
  frame.addEventListener("pointerdown", (event) => {
    held = true;
    frame.setPointerCapture(event.pointerId);
    to(event);
  });
  frame.addEventListener("pointermove", (event) => held && to(event));
  for (const end of ["pointerup", "pointercancel"]) frame.addEventListener(end, () => (held = false));
  slider.addEventListener("input", divide);
  for (const name of ["left", "right", "exposure", "names"]) model.on(name, paint);
  divide();
  paint();
  model.ready += 1;
  return root;
}

function develop(canvas, bytes, width, height, exposure) {
  const values = new Float32Array(bytes?.slice?.(0) ?? new ArrayBuffer(0));
  if (!values.length || values.length !== 3 * width * height) return;
  [canvas.width, canvas.height] = [width, height];
  const context = canvas.getContext("2d");
  const image = context.createImageData(width, height);
  const gain = 2 ** exposure;
  for (let i = 0, k = 0; i < values.length; i += 3, k += 4) {
    for (let c = 0; c < 3; c++) {
      const x = Math.min(1, Math.max(0, gain * values[i + c]));
      image.data[k + c] = 255 * (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055) + 0.5;
    }
    image.data[k + 3] = 255;
  }
  context.putImageData(image, 0, 0);
}
