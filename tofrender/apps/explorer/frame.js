/** The frame around the picture: the picture, its color bar, its markers, and places in it. */

import { make, placeIn } from "../ui/parts.js";
import { colorOf } from "./plot.js";
import { clamp } from "./words.js";

const NEAR_MARKER = 14; // px

/** Show a picture with its color bar. */
export function showPicture({ canvas, frame, space, bar, assumes, hatched }, picture, smooth) {
  frame.hidden = Boolean(picture.scene);
  space.element.hidden = !picture.scene;
  if (picture.scene) space.draw(picture.scene);
  else paintOn(canvas, picture);
  frame.style.setProperty("--aspect", picture.aspect ?? picture.width / picture.height);
  frame.classList.toggle("smooth", smooth);
  assumes.textContent = picture.assumes ?? "";
  assumes.hidden = !picture.assumes;
  hatched.hidden = !picture.hatched;
  hatched.lastChild.textContent = picture.hatched;
  bar.hidden = !picture.bar;
  if (!picture.bar) return;
  const { map, says } = picture.bar;
  bar.replaceChildren(stripOf(map), make("div", {}, ...says.map((each) => make("span", {}, each))));
}

/** The colors of a map, from left to right. */
export function stripOf(map) {
  const bytes = new Uint8ClampedArray(1024).fill(255);
  for (let i = 0; i < 256; i++) bytes.set(map.subarray(3 * i, 3 * i + 3), 4 * i);
  return canvasOf(bytes, 256, 1);
}

export function canvasOf(bytes, width, height) {
  return paintOn(make("canvas"), { bytes, width, height });
}

function paintOn(canvas, { bytes, width, height }) {
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  canvas.getContext("2d").putImageData(new ImageData(bytes, width, height), 0, 0);
  return canvas;
}

/** Show where the chosen pixels are, and the points that the laser lights. */
export function showMarkers({ markers }, recording, now, dark) {
  const { width, height } = recording.light;
  const put = (element, column, row) => {
    element.style.left = `${(100 * (column + 0.5)) / width}%`;
    element.style.top = `${(100 * (row + 0.5)) / height}%`;
    return element;
  };
  const pixels = now.pixels.map(([column, row], k) => {
    const marker = make("div", { className: k === now.active ? "marker active" : "marker" }, String(k + 1));
    marker.style.setProperty("--own", colorOf(k, dark));
    return put(marker, column, row);
  });
  const { grid, geometry } = recording.about;
  const lasers = (geometry.lasers ?? []).map(([column, row], k) => {
    const laser = make("div", { className: k === now.laser ? "laser active" : "laser" });
    return put(laser, (column + 0.5) / grid.step - 0.5, (row + 0.5) / grid.step - 0.5);
  });
  markers.replaceChildren(...(hasPixels(now) ? [...lasers, ...pixels] : []));
}

/** Whether the picture shows pixels of the light, not a projection of a volume. */
export function hasPixels({ view }) {
  return view !== "side" && view !== "top";
}

/** Column and row of the light's pixel under a pointer. */
export function pixelUnder(event, { frame }, { light }) {
  const [x, y] = placeIn(frame, event);
  const column = clamp(Math.floor(x * light.width), 0, light.width - 1);
  return [column, clamp(Math.floor(y * light.height), 0, light.height - 1)];
}

/** The number of the marker near a pointer, -1 if there is none. */
export function markerUnder(event, { frame }, { light }, pixels) {
  const { clientWidth: width, clientHeight: height } = frame;
  const [x, y] = placeIn(frame, event);
  const away = pixels.map(([column, row]) =>
    Math.hypot(((column + 0.5) / light.width - x) * width, ((row + 0.5) / light.height - y) * height),
  );
  const nearest = away.indexOf(Math.min(...away));
  return away[nearest] <= NEAR_MARKER ? nearest : -1;
}
