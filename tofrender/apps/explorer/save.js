/** Copy a link, and save the picture, the film and the curves. */

import { inkOf, make } from "../ui/parts.js";
import { SPEEDS } from "./controls.js";
import { canvasOf, stripOf } from "./frame.js";
import { Gif } from "./gif.js";
import { linkOf } from "./link.js";
import { SPEED_OF_LIGHT } from "./recording.js";

const LARGE = 640; // px, least length of a saved picture's longer side
const SMALL = 320; // of a film's
const MOST_FRAMES = 200;
const FASTEST = 50; // frames a second that browsers show
const LINE = 26; // px, of text below a picture

/** Buttons that copy and save what an explorer shows; a link only if its address keeps the view. */
export function saveButtons(explorer) {
  const { recording } = explorer;
  const { count, hasTimes } = recording;
  const kinds = [
    [explorer.isLinked, "Copy link", "Copy link to this view", copyLink],
    [true, "PNG", "Save the picture as PNG", savePicture],
    [hasTimes && count > 1, "GIF", "Save the film as GIF", saveFilm],
    [hasTimes, "CSV", "Save the curves as CSV", saveCurves],
  ];
  const buttons = kinds.filter(([applies]) => applies).map(([, label, title, act]) => {
    const button = make("button", { type: "button", title, "aria-label": title }, label);
    const say = (text) => {
      button.textContent = text;
      explorer.parts.spoken.textContent = text;
    };
    button.addEventListener("click", async () => {
      button.disabled = true;
      try {
        say(await act(explorer, (part) => (button.textContent = `${Math.round(100 * part)} %`)));
      } catch (error) {
        say(`Failed: ${error.message}`);
      } finally {
        button.disabled = false;
        setTimeout(() => (button.textContent = label), 2000);
      }
    });
    return button;
  });
  return make("div", { className: "saves" }, ...buttons);
}

async function copyLink(explorer) {
  const link = linkOf(explorer).replace(/\?token=[^#]*/, ""); // A live page's secret
  const copied = await navigator.clipboard?.writeText(link).then(() => true, () => false);
  if (copied) return "Copied";
  history.replaceState(history.state, "", link); // Without a secure connection
  return "In the address bar";
}

async function savePicture(explorer) {
  const { pictures, now } = explorer;
  const canvas = poster(explorer, pictures.of(now), LARGE);
  const blob = await new Promise((done) => canvas.toBlob(done, "image/png"));
  return save(explorer, blob, "png");
}

async function saveFilm(explorer, tell) {
  const { pictures, recording } = explorer;
  const view = explorer.now.view === "space" ? "space" : "light";
  const now = { ...explorer.now, view, playing: false };
  const rate = SPEEDS[now.speed];
  const step = Math.ceil(Math.max(recording.count / MOST_FRAMES, rate / FASTEST));
  const frame = (bin) => {
    const canvas = poster(explorer, pictures.of({ ...now, bin }), SMALL);
    const { width, height } = canvas;
    return { width, height, bytes: canvas.getContext("2d").getImageData(0, 0, width, height).data };
  };
  const samples = Array.from({ length: 12 }, (_, k) => frame(Math.floor((k * recording.count) / 12)));
  const { width, height } = samples[0];
  const gif = new Gif(width, height, samples.map(({ bytes }) => bytes));
  for (let bin = 0; bin < recording.count; bin += step) {
    gif.add(frame(bin).bytes, Math.round((100 * step) / rate));
    tell(bin / recording.count);
    await new Promise((done) => setTimeout(done)); // The page goes on
  }
  explorer.draw();
  return save(explorer, gif.blob(), "gif");
}

/**
 * Times, path lengths and curves of the chosen pixels.
 *
 * Columns of a block of pixels are named by its first and last pixels, and as a mean. Each curve has
 * its resolution, the largest error of values that are kept as one byte, and standard errors if they
 * are known.
 */
function saveCurves(explorer) {
  const { recording, responses } = explorer;
  const isBlock = recording.about.grid.step > 1;
  const places = recording.isVolume ? ["z_m"] : ["time_ns", "opl_m"];
  const curves = responses.curves().map((curve) => {
    const [x, y] = curve.block.map((ends) => (isBlock ? ends.join("-") : ends[0]));
    return { ...curve, name: isBlock ? `x${x}_y${y}_mean` : `x${x}_y${y}` };
  });
  const columns = [
    ...curves.map(({ name, values }) => [name, values]),
    ...curves.map(({ name, errors }) => [`${name}_error`, errors]),
    ...curves.map(({ name, resolution }) => [`${name}_resolution`, resolution]),
  ].filter(([, values]) => values);
  const rows = Array.from({ length: recording.count }, (_, bin) => {
    const opl = recording.center(bin);
    const at = recording.isVolume ? [opl] : [(1e9 * opl) / SPEED_OF_LIGHT, opl];
    const values = columns.map(([, column]) => column[bin]);
    return [...at, ...values].map((value) => String(Number(value.toPrecision(9))));
  });
  const headings = [...places, ...columns.map(([name]) => name)];
  const text = [headings, ...rows].map((row) => `${row.join(",")}\r\n`).join("");
  return save(explorer, new Blob([text], { type: "text/csv" }), "csv");
}

function save({ recording }, blob, suffix) {
  const url = URL.createObjectURL(blob);
  const name = recording.about.title.replace(/[^\p{L}\p{N}.-]+/gu, "_").slice(0, 80) || "explorer";
  make("a", { href: url, download: `${name}.${suffix}` }).click();
  setTimeout(() => URL.revokeObjectURL(url), 60_000);
  return "Saved";
}

/** The largest font in which a line fits into a width. Narrower letters would be hard to read. */
function fontFor(pen, line, width) {
  const font = (size) => `${size}px system-ui, sans-serif`;
  let size = 13;
  pen.font = font(size);
  while (size > 9 && pen.measureText(line).width > width) {
    size -= 1;
    pen.font = font(size);
  }
  return font(size);
}

/** A picture with its color bar and what it says; its longer side has `least` pixels or more. */
function poster(explorer, { scene, bytes, says, bar, ...picture }, least) {
  const { paper, soft } = inkOf(explorer.root);
  if (scene) explorer.parts.space.draw(scene);
  const drawn = scene ? explorer.parts.space.canvas : canvasOf(bytes, picture.width, picture.height);
  const { width, height } = drawn;
  const aspect = scene ? width / height : picture.aspect;
  const factor = Math.max(1, Math.ceil(least / Math.max(width, height)));
  const wide = aspect ? Math.round(least * Math.min(1, aspect)) : factor * width;
  const high = aspect ? Math.round(wide / aspect) : factor * height;
  const canvas = make("canvas", { width: wide, height: high + (bar ? 2 : 1) * LINE });
  const pen = canvas.getContext("2d", { willReadFrequently: true });
  pen.fillStyle = paper;
  pen.fillRect(0, 0, wide, canvas.height);
  pen.imageSmoothingEnabled = Boolean(scene) || explorer.now.smooth;
  pen.drawImage(drawn, 0, 0, wide, high);
  pen.fillStyle = soft;
  pen.font = fontFor(pen, says, wide - 12);
  pen.textBaseline = "middle";
  pen.fillText(says, 6, canvas.height - LINE / 2, wide - 12);
  if (!bar) return canvas;
  pen.drawImage(stripOf(bar.map), 0, high + 4, wide, 6);
  bar.says.forEach((text, k) => {
    pen.textAlign = k === 0 ? "left" : k < bar.says.length - 1 ? "center" : "right";
    pen.fillText(text, 6 + (k / (bar.says.length - 1)) * (wide - 12), high + LINE - 6);
  });
  return canvas;
}
