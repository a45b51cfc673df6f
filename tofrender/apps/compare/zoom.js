/** A window into a picture, moved by pointers, wheel and keys. Lengths are parts of the picture. */

import { clamp } from "../explorer/words.js";
import { placeIn } from "../ui/parts.js";

const MOST = 64; // times larger
const CLICK = 5; // px that a pointer may move in a click

export class Zoom {
  constructor() {
    this.reset();
  }

  reset() {
    Object.assign(this, { scale: 1, x: 0, y: 0 });
  }

  /** Enlarge; what is at (x, y) of the frame stays there. */
  by(factor, x = 0.5, y = 0.5) {
    const scale = clamp(this.scale * factor, 1, MOST);
    const [dx, dy] = [x, y].map((at) => at / this.scale - at / scale);
    this.scale = scale;
    this.move(dx * scale, dy * scale);
  }

  /** Move by parts of the frame. */
  move(dx, dy) {
    this.x = clamp(this.x + dx / this.scale, 0, 1 - 1 / this.scale);
    this.y = clamp(this.y + dy / this.scale, 0, 1 - 1 / this.scale);
  }

  /** Where in the picture a place of the frame is. */
  at([x, y]) {
    return [this.x + x / this.scale, this.y + y / this.scale];
  }

  /**
   * Follow pointers in a frame: two of them, or the wheel, zoom; `drag(from, to)` says whether it
   * has used a move, which else moves the window; `point` hears of places, `click` of clicks.
   */
  listen(frame, { changed, drag, point, click }) {
    const held = new Map(); // by pointer: where it went down [px], and where it is
    let moved = false;
    const place = (event) => placeIn(frame, event);
    const apart = () => {
      const [one, other] = [...held.values()].map(({ at }) => at);
      return Math.hypot(frame.clientWidth * (one[0] - other[0]), frame.clientHeight * (one[1] - other[1]));
    };
    frame.addEventListener("pointerdown", (event) => {
      if (event.button) return;
      moved = held.size > 0;
      held.set(event.pointerId, { x: event.clientX, y: event.clientY, at: place(event) });
      frame.setPointerCapture(event.pointerId);
    });
    frame.addEventListener("pointermove", (event) => {
      const to = place(event);
      point(to);
      const pointer = held.get(event.pointerId);
      if (!pointer) return;
      moved ||= Math.hypot(event.clientX - pointer.x, event.clientY - pointer.y) > CLICK;
      if (!moved) return;
      const from = pointer.at;
      const before = held.size === 2 && apart();
      pointer.at = to;
      if (before) this.by(apart() / before, ...to);
      else if (drag(from, to)) return;
      this.move((from[0] - to[0]) / held.size, (from[1] - to[1]) / held.size);
      changed();
    });
    for (const name of ["pointerup", "pointercancel"]) {
      frame.addEventListener(name, (event) => {
        if (held.delete(event.pointerId) && !moved && name === "pointerup") click(place(event));
      });
    }
    frame.addEventListener("pointerleave", () => point(null));
    frame.addEventListener("wheel", (event) => {
      if (this.scale === 1 && event.deltaY > 0) return; // The page may scroll
      event.preventDefault();
      this.by(2 ** (-event.deltaY / 300), ...place(event));
      changed();
    });
  }
}
