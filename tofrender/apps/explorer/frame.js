/** The frame around the picture: the picture, its colour bar, its markers, and places in it. */

import { make } from "../ui/parts.js";
import { colourOf } from "./plot.js";
import { clamp } from "./words.js";

const NEAR_MARKER = 14; // px

/** Show a picture with its colour bar. */
export function showPicture({ canvas, frame, space, bar, assumes, hatched }, picture, smooth) {
  frame.hidden = Boolean(picture.scene);
  space.element.hidden = !picture.scene;
  if (picture.scene) space.draw(picture.scene);
  else showBytes(canvas, picture);
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

function showBytes(canvas, { width, height, bytes }) {
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  canvas.getContext("2d").putImageData(new ImageData(bytes, width, height), 0, 0);
}

/** The colours of a map, from left to right. */
export function stripOf(map) {
  const bytes = new Uint8ClampedArray(1024).fill(255);
  for (let i = 0; i < 256; i++) bytes.set(map.subarray(3 * i, 3 * i + 3), 4 * i);
  return canvasOf(bytes, 256, 1);
}

export function canvasOf(bytes, width, height) {
  const canvas = make("canvas", { width, height });
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
    marker.style.setProperty("--own", colourOf(k, dark));
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
  const { left, top, width, height } = frame.getBoundingClientRect();
  const column = Math.floor(((event.clientX - left) / width) * light.width);
  const row = Math.floor(((event.clientY - top) / height) * light.height);
  return [clamp(column, 0, light.width - 1), clamp(row, 0, light.height - 1)];
}

/** The number of the marker near a pointer, -1 if there is none. */
export function markerUnder(event, { frame }, { light }, pixels) {
  const { left, top, width, height } = frame.getBoundingClientRect();
  const away = pixels.map(([column, row]) =>
    Math.hypot(
      left + ((column + 0.5) / light.width) * width - event.clientX,
      top + ((row + 0.5) / light.height) * height - event.clientY,
    ),
  );
  const nearest = away.indexOf(Math.min(...away));
  return away[nearest] <= NEAR_MARKER ? nearest : -1;
}
