/** Films as GIF 89a: one palette for all frames, and LZW. */

const CODES = 4096; // of LZW

/** Encode a film, frame after frame. */
export class Gif {
  /** `samples` are pictures (bytes of red, green, blue, opaque) with the colors of all frames. */
  constructor(width, height, samples) {
    Object.assign(this, { width, height });
    this.palette = paletteOf(samples);
    this.nearest = new Int16Array(32_768).fill(-1);
    this.table = new Uint16Array(CODES * 256);
    const bytes = this.palette.flat();
    const table = [...bytes, ...new Array(768 - bytes.length).fill(0)];
    const size = [width & 255, width >> 8, height & 255, height >> 8];
    this.parts = [
      Uint8Array.from([...ascii("GIF89a"), ...size, 0xf7, 0, 0, ...table]),
      Uint8Array.from([0x21, 0xff, 11, ...ascii("NETSCAPE2.0"), 3, 1, 0, 0, 0]), // for ever
    ];
  }

  /** Add a frame that is shown for `delay` hundredths of a second. */
  add(bytes, delay) {
    const { width, height } = this;
    const size = [width & 255, width >> 8, height & 255, height >> 8];
    const control = [0x21, 0xf9, 4, 4, delay & 255, delay >> 8, 0, 0];
    this.parts.push(Uint8Array.from([...control, 0x2c, 0, 0, 0, 0, ...size, 0, 8]), this.packed(bytes));
  }

  blob() {
    return new Blob([...this.parts, Uint8Array.of(0x3b)], { type: "image/gif" });
  }

  index(red, green, blue) {
    const key = keyOf(red, green, blue);
    if (this.nearest[key] < 0) {
      const away = this.palette.map(([r, g, b]) => (r - red) ** 2 + (g - green) ** 2 + (b - blue) ** 2);
      this.nearest[key] = away.indexOf(Math.min(...away));
    }
    return this.nearest[key];
  }

  /** LZW in blocks of 255 bytes; `table` has the code of each code followed by each index. */
  packed(bytes) {
    const { table } = this;
    const out = new Bits(bytes.length);
    let [next, size, prefix] = [CODES, 9, -1];
    for (let i = 0; i < bytes.length; i += 4) {
      const index = this.index(bytes[i], bytes[i + 1], bytes[i + 2]);
      const known = prefix >= 0 && table[prefix * 256 + index];
      if (known) {
        prefix = known;
        continue;
      }
      if (prefix >= 0) {
        out.write(prefix, size);
        if (next < CODES) {
          table[prefix * 256 + index] = next;
          if (next++ === 1 << size) size++;
        }
      }
      if (next === CODES) {
        out.write(256, size);
        table.fill(0);
        [next, size] = [258, 9];
      }
      prefix = index;
    }
    out.write(prefix, size);
    out.write(257, next === 1 << size && size < 12 ? size + 1 : size);
    return out.blocks();
  }
}

/** Bits, the lowest first, in blocks that begin with their length. */
class Bits {
  constructor(most) {
    this.bytes = new Uint8Array(most + 64);
    [this.length, this.held, this.count] = [0, 0, 0];
  }

  write(code, size) {
    this.held |= code << this.count;
    this.count += size;
    for (; this.count >= 8; this.count -= 8, this.held >>>= 8) this.put(this.held & 255);
  }

  put(byte) {
    if (this.length % 256 === 0) this.bytes[this.length++] = 255;
    this.bytes[this.length++] = byte;
  }

  blocks() {
    if (this.count) this.put(this.held & 255);
    const last = this.length - (this.length % 256 || 256);
    this.bytes[last] = this.length - last - 1;
    return this.bytes.slice(0, this.length + 1);
  }
}

/** The 256 colors of pictures that are there most often. */
function paletteOf(samples) {
  const counts = new Map();
  for (const bytes of samples) {
    for (let i = 0; i < bytes.length; i += 4) {
      const key = keyOf(bytes[i], bytes[i + 1], bytes[i + 2]);
      counts.set(key, (counts.get(key) ?? 0) + 1);
    }
  }
  const keys = [...counts.keys()].sort((a, b) => counts.get(b) - counts.get(a)).slice(0, 256);
  return keys.map((key) => [key >> 10, (key >> 5) & 31, key & 31].map((each) => Math.round((each * 255) / 31)));
}

/** Five bits of each channel. */
function keyOf(red, green, blue) {
  return ((red >> 3) << 10) | ((green >> 3) << 5) | (blue >> 3);
}

function ascii(text) {
  return Array.from(text, (each) => each.charCodeAt(0));
}
