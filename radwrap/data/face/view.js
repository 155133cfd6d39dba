// What of the picture is seen, and what is drawn over it.

/** @typedef {import("./types.js").Section} Section */
/** @typedef {import("./field.js").Picture} Picture */
/** @typedef {{u: number, v: number}} Pixel */

const INTO = [1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64];
const BINS = [1, 2, 3, 4, 5, 6, 8, 10, 12, 15, 16, 20, 24, 30, 40]; // divisors of a band's rows
export const NUMBERS_FROM = 32;

/** A view on the picture: one pixel is `into` screen pixels wide, or `bin` pixels are one. */
export class View {
  /**
   * @param {HTMLElement} frame
   * @param {HTMLCanvasElement} image
   * @param {HTMLCanvasElement} marks
   * @param {number} rows
   * @param {number} columns
   * @param {() => void} changed
   */
  constructor(frame, image, marks, rows, columns, changed) {
    this.frame = frame;
    this.image = image;
    this.marks = marks;
    this.rows = rows;
    this.columns = columns;
    this.changed = changed;
    this.into = 1;
    this.bin = 1;
    this.x = columns / 2; // what stands in the middle [px]
    this.y = rows / 2;
    this.fitted = true;
    this.off = new OffscreenCanvas(1, 1);
    /** @type {Picture | null} */
    this.picture = null;
    /** @type {number | null} where a wipe ends, on the canvas */
    this.edge = null;
    this.watch = new ResizeObserver(() => this.resize());
    this.watch.observe(frame);
    this.resize();
  }

  close() {
    this.watch.disconnect();
  }

  resize() {
    const dots = window.devicePixelRatio || 1;
    const width = Math.max(1, Math.round(this.frame.clientWidth * dots));
    const height = Math.max(1, Math.round(this.frame.clientHeight * dots));
    for (const canvas of [this.image, this.marks]) {
      if (canvas.width === width && canvas.height === height) continue; // what is drawn stays, until there is more
      canvas.width = width;
      canvas.height = height;
    }
    if (this.fitted) this.fit();
    else this.changed();
  }

  fit() {
    const { width, height } = this.image;
    const share = Math.min(width / this.columns, height / this.rows);
    this.into = share >= 1 ? INTO.filter((into) => into <= share).at(-1) ?? 1 : 1;
    this.bin = share >= 1 ? 1 : BINS.find((bin) => bin >= 1 / share) ?? BINS[BINS.length - 1];
    this.x = this.columns / 2;
    this.y = this.rows / 2;
    this.fitted = true;
    this.changed();
  }

  /** Screen pixels of a pixel. */
  get size() {
    return this.into / this.bin;
  }

  get text() {
    return this.bin > 1 ? `1 : ${this.bin}` : `${this.into} : 1`;
  }

  /**
   * One step in or out, about a pixel that stays where it is.
   * @param {number} direction
   * @param {Pixel} [about]
   */
  zoom(direction, about) {
    const steps = [...BINS.slice(1).reverse().map((bin) => ({ into: 1, bin })), ...INTO.map((into) => ({ into, bin: 1 }))];
    const now = steps.findIndex(({ into, bin }) => into === this.into && bin === this.bin);
    const next = steps[Math.min(steps.length - 1, Math.max(0, now + direction))];
    this.zoomTo(next.into, next.bin, about);
  }

  /** @param {number} into @param {number} bin @param {Pixel} [about] */
  zoomTo(into, bin, about) {
    const before = this.size;
    this.into = into;
    this.bin = bin;
    if (about) {
      this.x = about.u + 0.5 + ((this.x - about.u - 0.5) * before) / this.size;
      this.y = about.v + 0.5 + ((this.y - about.v - 0.5) * before) / this.size;
    }
    this.fitted = false;
    this.move(0, 0);
  }

  /**
   * Show the same part of the scene as another view did, whose pixels had another size.
   * @param {{x: number, y: number, size: number}} sight
   */
  see({ x, y, size }) {
    const steps = [...BINS.map((bin) => ({ into: 1, bin })).reverse(), ...INTO.slice(1).map((into) => ({ into, bin: 1 }))];
    const off = steps.map(({ into, bin }) => Math.abs(Math.log(into / bin / size)));
    const { into, bin } = steps[off.indexOf(Math.min(...off))];
    this.x = x;
    this.y = y;
    this.zoomTo(into, bin);
  }

  /** @param {number} across @param {number} down both in pixels of the picture */
  move(across, down) {
    this.x = Math.min(this.columns, Math.max(0, this.x + across));
    this.y = Math.min(this.rows, Math.max(0, this.y + down));
    this.changed();
  }

  /** Bring a pixel into sight. @param {Pixel} pixel */
  reveal({ u, v }) {
    const { x0, x1, y0, y1 } = this.section;
    if (u >= x0 && u < x1 && v >= y0 && v < y1) return;
    this.fitted = false;
    this.x = u + 0.5;
    this.y = v + 0.5;
    this.changed();
  }

  /** Left and upper end of the picture on the screen. */
  get origin() {
    return { x: Math.round(this.image.width / 2 - this.x * this.size), y: Math.round(this.image.height / 2 - this.y * this.size) };
  }

  /** @returns {Section} */
  get section() {
    const { x, y } = this.origin;
    /** @param {number} value */
    const down = (value) => Math.max(0, Math.floor(value / this.bin) * this.bin);
    return {
      x0: Math.min(down(-x / this.size), this.columns - 1), y0: Math.min(down(-y / this.size), this.rows - 1), bin: this.bin,
      x1: Math.max(1, Math.min(this.columns, Math.ceil((this.image.width - x) / this.size))),
      y1: Math.max(1, Math.min(this.rows, Math.ceil((this.image.height - y) / this.size))),
    };
  }

  /**
   * The pixel at a place on the screen; null beside the picture.
   * @param {{clientX: number, clientY: number}} event
   * @param {boolean} [nearest] the nearest one instead
   * @returns {Pixel | null}
   */
  pixelAt({ clientX, clientY }, nearest = false) {
    const box = this.frame.getBoundingClientRect();
    const dots = this.image.width / Math.max(1, this.frame.clientWidth);
    const { x, y } = this.origin;
    let u = Math.floor(((clientX - box.left - this.frame.clientLeft) * dots - x) / this.size);
    let v = Math.floor(((clientY - box.top - this.frame.clientTop) * dots - y) / this.size);
    if (nearest) {
      u = Math.min(this.columns - 1, Math.max(0, u));
      v = Math.min(this.rows - 1, Math.max(0, v));
    }
    return u >= 0 && v >= 0 && u < this.columns && v < this.rows ? { u, v } : null;
  }

  /**
   * @param {Picture} picture
   * @param {number} curtain up to this share of the frame what lies over the picture is seen
   */
  show(picture, curtain) {
    this.picture = picture;
    const screen = /** @type {CanvasRenderingContext2D} */ (this.image.getContext("2d"));
    const { width, height } = this.image;
    screen.clearRect(0, 0, width, height);
    this.paint(screen, picture.parts, picture.section);
    this.edge = null;
    if (!picture.over) return;
    const edge = Math.round(curtain * width);
    screen.save();
    screen.beginPath();
    screen.rect(0, 0, edge, height);
    screen.clip();
    screen.clearRect(0, 0, edge, height);
    this.paint(screen, picture.over, picture.section);
    screen.restore();
    this.edge = edge;
  }

  /**
   * @param {CanvasRenderingContext2D} screen
   * @param {Picture["parts"]} parts
   * @param {Section} section
   */
  paint(screen, parts, section) {
    const width = parts[0].width;
    const height = parts.reduce((sum, part) => sum + part.height, 0);
    if (width === 0 || height === 0) return;
    if (this.off.width !== width || this.off.height !== height) this.off = new OffscreenCanvas(width, height);
    const off = /** @type {OffscreenCanvasRenderingContext2D} */ (this.off.getContext("2d"));
    for (const part of parts) {
      if (part.height > 0) off.putImageData(new ImageData(/** @type {any} */ (part.rgba), width, part.height), 0, part.row);
    }
    screen.imageSmoothingEnabled = false;
    const { x, y } = this.origin;
    screen.drawImage(this.off, x + section.x0 * this.size, y + section.y0 * this.size, width * this.into, height * this.into);
  }

  /**
   * What lies over the picture.
   * @param {{pin: Pixel | null, hover: Pixel | null, line: number[] | null, region: number[] | null,
   *   codes: {u: number, v: number, code: number}[]}} over
   */
  mark({ pin, hover, line, region, codes }) {
    const pen = /** @type {CanvasRenderingContext2D} */ (this.marks.getContext("2d"));
    pen.clearRect(0, 0, this.marks.width, this.marks.height);
    const { size } = this;
    const { x, y } = this.origin;
    /** @param {() => void} path drawn dark, then light on it: seen on any gray */
    const stroke = (path) => {
      for (const [colour, width] of /** @type {[string, number][]} */ ([["#000", 4], ["#ffd84a", 1.6]])) {
        pen.strokeStyle = colour;
        pen.lineWidth = width;
        pen.beginPath();
        path();
        pen.stroke();
      }
    };
    if (this.edge !== null) {
      const { edge } = this;
      stroke(() => { pen.moveTo(edge, 0); pen.lineTo(edge, this.marks.height); });
    }
    if (codes.length > 0) {
      pen.font = `${Math.min(14, size / 2.6)}px system-ui, sans-serif`;
      pen.textAlign = "center";
      pen.textBaseline = "middle";
      pen.lineJoin = "round";
      pen.lineWidth = 3;
      for (const { u, v, code } of codes) {
        pen.strokeStyle = "#000";
        pen.fillStyle = "#fff";
        pen.strokeText(String(code), x + (u + 0.5) * size, y + (v + 0.5) * size);
        pen.fillText(String(code), x + (u + 0.5) * size, y + (v + 0.5) * size);
      }
    }
    if (line) {
      stroke(() => {
        pen.moveTo(x + (line[0] + 0.5) * size, y + (line[1] + 0.5) * size);
        pen.lineTo(x + (line[2] + 0.5) * size, y + (line[3] + 0.5) * size);
      });
    }
    if (region) {
      const [u0, v0, u1, v1] = region;
      stroke(() => pen.rect(x + u0 * size, y + v0 * size, (u1 + 1 - u0) * size, (v1 + 1 - v0) * size));
    }
    for (const [pixel, reach] of /** @type {[Pixel | null, number][]} */ ([[pin, 14], [hover, 0]])) {
      if (!pixel) continue;
      const left = x + pixel.u * size, top = y + pixel.v * size;
      stroke(() => {
        pen.rect(left, top, Math.max(size, 1), Math.max(size, 1));
        if (reach === 0) return;
        const cx = left + size / 2, cy = top + size / 2, gap = size / 2 + 3;
        for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
          pen.moveTo(cx + dx * gap, cy + dy * gap);
          pen.lineTo(cx + dx * (gap + reach), cy + dy * (gap + reach));
        }
      });
    }
  }
}
