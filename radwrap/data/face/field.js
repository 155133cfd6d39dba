// The picture in bands of rows, each with a worker; one frame is in the making, and the newest wish wins.

import { together } from "./difference.js";

/** @typedef {import("./types.js").Thresholds} Thresholds */
/** @typedef {import("./types.js").Section} Section */
/** @typedef {import("./types.js").Look} Look */
/** @typedef {import("./types.js").Frame} Frame */
/** @typedef {{factors: number[], scale: number, certified: boolean, section: Section, look: Look,
 *   shown: import("./types.js").Shown, range: number}} Wish */
/** @typedef {{parts: (Frame & {row: number})[], section: Section, counts: Float64Array, saturated: number,
 *   dark: number, flips: number, wish: Wish, over: (Frame & {row: number})[] | null,
 *   apart: import("./types.js").Apart | null}} Picture over is drawn up to the curtain of a wipe */

const MOST_WORKERS = 8;
const BAND = 240; // rows; bands begin at multiples of 2, 3, 4, 5, 6, 8, 10, 12, ..., the bins that a view may have
const FEW_PIXELS = 1 << 18; // one worker is as fast

/** All bands. */
export class Field {
  /**
   * @param {() => Worker} make
   * @param {number} rows
   * @param {number} columns
   * @param {(picture: Picture) => void} show
   */
  constructor(make, rows, columns, show) {
    this.rows = rows;
    this.columns = columns;
    this.show = show;
    const cores = Math.min(MOST_WORKERS, Math.max(1, navigator.hardwareConcurrency || 2));
    const bands = rows * columns <= FEW_PIXELS ? 1 : Math.min(cores, Math.ceil(rows / BAND));
    const size = Math.ceil(Math.ceil(rows / bands) / BAND) * BAND;
    /** @type {{worker: Worker, top: number, bottom: number}[]} */
    this.bands = [];
    for (let top = 0; top < rows; top += size) {
      const worker = make();
      worker.onmessage = (event) => this.heard(event.data);
      const bottom = Math.min(rows, top + size);
      worker.postMessage({ kind: "begin", columns, top, rows: bottom - top });
      this.bands.push({ worker, top, bottom });
    }
    this.asked = 0;
    /** @type {Map<number, (told: any) => void>} */
    this.waiting = new Map();
    /** @type {Wish | null} */
    this.wish = null;
    this.busy = false;
  }

  /** The workers end. */
  close() {
    for (const { worker } of this.bands) worker.terminate();
    this.bands = [];
  }

  /** @param {any} told */
  heard(told) {
    const answer = this.waiting.get(told.id);
    this.waiting.delete(told.id);
    answer?.(told);
  }

  /**
   * @param {Worker} worker
   * @param {object} told
   * @returns {Promise<any>}
   */
  ask(worker, told) {
    const id = ++this.asked;
    return new Promise((resolve) => {
      this.waiting.set(id, resolve);
      worker.postMessage({ ...told, id });
    });
  }

  /**
   * One more plane of light; its memory goes to the workers.
   * @param {import("./types.js").Plane} plane
   */
  addPlane({ high, low, unit }) {
    for (const { worker, top, bottom } of this.bands) {
      const place = [top * this.columns, bottom * this.columns];
      const plane = { high: high.slice(...place), low: low && low.slice(...place), unit };
      worker.postMessage({ kind: "plane", plane }, { transfer: [plane.high.buffer, ...(plane.low ? [plane.low.buffer] : [])] });
    }
  }

  /**
   * The radiant exposure as the server has made it, and its deviations.
   * @param {Float32Array} exposure
   * @param {Float32Array} sigma
   */
  certify(exposure, sigma) {
    this.share(exposure, (part) => ({ kind: "certified", exposure: part }));
    this.share(sigma, (part) => ({ kind: "deviations", sigma: part }));
  }

  /** What is kept to compare with. @param {import("./types.js").KeptPicture | null} a */
  keep(a) {
    if (!a) return;
    const { thresholds, told: { sensor } } = a;
    this.share(a.exposure, (part) => ({ kind: "kept", exposure: part, thresholds, sensor }));
    this.share(a.sigma, (part) => ({ kind: "kept deviations", sigma: part }));
  }

  /**
   * @param {Float32Array} all
   * @param {(part: Float32Array) => object} message
   */
  share(all, message) {
    for (const { worker, top, bottom } of this.bands) {
      const part = all.slice(top * this.columns, bottom * this.columns);
      worker.postMessage(message(part), { transfer: [part.buffer] });
    }
  }

  /**
   * @param {Thresholds} thresholds
   * @param {import("./types.js").Sensor} sensor
   */
  respond(thresholds, sensor) {
    for (const { worker } of this.bands) worker.postMessage({ kind: "response", thresholds, sensor });
  }

  /**
   * Draw; where a frame is in the making, after it, unless there is a newer wish by then.
   * @param {Wish} wish
   */
  draw(wish) {
    this.wish = wish;
    if (!this.busy) void this.drawn();
  }

  async drawn() {
    this.busy = true;
    while (this.wish) {
      const wish = this.wish;
      this.wish = null;
      /** @param {import("./types.js").Shown} shown */
      const frames = (shown) => Promise.all(this.bands.map(async ({ worker }) =>
        (await this.ask(worker, { kind: "frame", ...wish, shown })).frame));
      const over = wish.shown === "wipe" ? await frames("a") : null;
      const parts = await frames(over ? "b" : wish.shown);
      const apart = wish.shown === "difference" ? together(parts.map((part) => part.apart)) : null;
      const counts = parts[0].counts.slice();
      for (const part of parts.slice(1)) {
        for (let code = 0; code < counts.length; code++) counts[code] += part.counts[code];
      }
      /** @param {"saturated" | "dark" | "flips"} name */
      const all = (name) => parts.reduce((sum, part) => sum + part[name], 0);
      const { section } = wish;
      this.show({
        parts, section, counts, saturated: all("saturated"), dark: all("dark"), flips: all("flips"), wish,
        over, apart,
      });
    }
    this.busy = false;
  }

  /**
   * Radiant exposure at some pixels, by the planes, in double precision.
   * @param {{u: number, v: number}[]} pixels
   * @param {number[]} factors
   * @param {number} scale
   * @returns {Promise<number[]>}
   */
  async light(pixels, factors, scale) {
    const values = new Array(pixels.length).fill(0);
    await Promise.all(this.bands.map(async ({ worker, top, bottom }) => {
      const mine = pixels.flatMap(({ v }, k) => (v >= top && v < bottom ? [k] : []));
      if (mine.length === 0) return;
      const places = mine.map((k) => (pixels[k].v - top) * this.columns + pixels[k].u);
      const told = await this.ask(worker, { kind: "light", places, factors });
      mine.forEach((k, n) => { values[k] = Math.fround(Math.max(0, told.values[n]) * scale); });
    }));
    return values;
  }
}
