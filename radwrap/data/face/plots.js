// Plots by uPlot, each with a table beside it.

import { element, tableOf } from "./dom.js";
import { grouped } from "./statistics.js";
import { shortNumber } from "./units.js";

const HEIGHT = 150;
const TENS = [1, 10, 100, 1e3, 1e4, 1e5, 1e6, 1e7];
const MOST_BARS = 256;
const MOST_ROWS = 400; // of a table; all of them are in the CSV

/** @param {string} name */
function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

/** @param {string} label @param {number} size @param {object} more @returns {object} */
function axis(label, size, more = {}) {
  return { label, size, labelSize: 15, labelGap: 0, gap: 3, ...more, labelFont: "12px system-ui, sans-serif", font: "11px system-ui, sans-serif",
    stroke: colour("--text"), grid: { stroke: colour("--line"), width: 1 }, ticks: { stroke: colour("--line") } };
}

/** @param {number} value */
function tenText(value) {
  return value < 1e3 ? String(value) : value < 1e6 ? `${value / 1e3}k` : `${value / 1e6}M`;
}

/** A plot in an element, which is made anew where its kind or its size has changed. */
class Plot {
  /**
   * @param {HTMLElement} place
   * @param {(width: number) => object} options
   */
  constructor(place, options) {
    this.place = place;
    this.options = options;
    /** @type {any} */
    this.plot = null;
    /** @type {any[] | null} */
    this.data = null;
    new ResizeObserver(() => this.fresh()).observe(place);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.fresh());
  }

  /** @param {any[]} data */
  show(data) {
    this.data = data;
    if (this.plot) this.plot.setData(data);
    else this.fresh();
  }

  fresh() {
    const width = Math.floor(this.place.clientWidth);
    if (!this.data || width < 50 || (this.plot && this.plot.width === width && this.theme === colour("--text"))) return;
    this.theme = colour("--text");
    this.plot?.destroy();
    const { uPlot } = /** @type {any} */ (globalThis);
    this.plot = new uPlot({ width, height: HEIGHT, cursor: { drag: { x: false, y: false } }, ...this.options(width) },
      this.data, this.place);
  }
}

/** @typedef {{u: number, v: number, distance: number, code: number, gray: number, sigma: number | null,
 *   exposure: number}} ProfileRow */

/** Gray levels along a line, with a band of 1.96 standard deviations. */
export class ProfilePlot {
  /** @param {HTMLElement} place @param {HTMLElement} table */
  constructor(place, table) {
    this.table = table;
    this.plot = new Plot(place, () => ({
      scales: { x: { time: false } },
      axes: [axis("distance [px]", 22), axis("gray level", 38)],
      series: [{}, { stroke: colour("--accent"), width: 1.5, points: { show: false } },
        { stroke: "transparent", points: { show: false } }, { stroke: "transparent", points: { show: false } },
        { stroke: colour("--text"), width: 1, dash: [5, 4], points: { show: false } }],
      bands: [{ series: [2, 3], fill: colour("--band") }],
    }));
  }

  /** @param {ProfileRow[]} rows @param {ProfileRow[]} before those of a picture to compare with, dashed; may be empty */
  show(rows, before) {
    /** @param {number} sign */
    const edge = (sign) => rows.map(({ gray, sigma }) => (sigma === null ? gray : gray + sign * 1.96 * sigma));
    this.plot.show([rows.map((row) => row.distance), rows.map((row) => row.gray), edge(1), edge(-1),
      rows.map((_, k) => before[k]?.gray ?? null)]);
    const cells = rows.slice(0, MOST_ROWS).map(({ distance, u, v, code, gray, sigma }, k) =>
      [shortNumber(distance), u, v, shortNumber(code, 6), shortNumber(gray, 5), sigma === null ? "" : shortNumber(sigma, 2),
        ...before.slice(k, k + 1).map((row) => shortNumber(row.gray, 5))]);
    const more = rows.length > MOST_ROWS ? [element("p", { class: "note" }, `${rows.length} rows; all are in the CSV`)] : [];
    this.table.replaceChildren(tableOf("Profile", ["distance [px]", "u", "v", "code", "gray", "± 1 σ", ...(before.length > 0 ? ["gray of A"] : [])], cells), ...more);
  }
}

const LEAST = 1e-3; // gray levels; a logarithmic axis has no zero

/** Time against error of settings, both axes logarithmic; a line joins those than which none is better. */
export class TradePlot {
  /** @param {HTMLElement} place */
  constructor(place) {
    const points = (/** @type {string} */ name, /** @type {number} */ size) => ({ show: true, size, stroke: colour(name), fill: colour(name) });
    this.plot = new Plot(place, () => ({
      scales: { x: { time: false, distr: 3 }, y: { distr: 3 } },
      axes: [axis("gray rms", 22), axis("time [s]", 46)],
      series: [{}, { stroke: "transparent", points: points("--soft", 6) },
        { stroke: colour("--accent"), width: 1.5, spanGaps: true, points: points("--accent", 8) }],
    }));
  }

  /** @param {{rms_gray: number, wall_s: number, front: boolean}[]} settings */
  show(settings) {
    const rows = [...settings].sort((a, b) => a.rms_gray - b.rms_gray);
    this.plot.show([rows.map((row) => Math.max(row.rms_gray, LEAST)), rows.map((row) => (row.front ? null : row.wall_s)),
      rows.map((row) => (row.front ? row.wall_s : null))]);
  }
}

/** How many pixels have each code, on a logarithmic axis. */
export class HistogramPlot {
  /** @param {HTMLElement} place @param {HTMLElement} table */
  constructor(place, table) {
    this.table = table;
    this.plot = new Plot(place, () => ({
      scales: { x: { time: false }, y: { distr: 3, range: (/** @type {any} */ _, /** @type {number} */ low,
        /** @type {number} */ high) => [0.7, Math.max(10, high * 1.3)] } },
      axes: [axis("code", 22), axis("pixels", 38, { splits: () => TENS, values: () => TENS.map(tenText) })],
      series: [{}, { stroke: colour("--accent"), fill: colour("--band"), width: 1, points: { show: false },
        paths: /** @type {any} */ (globalThis).uPlot.paths.bars({ size: [1, Infinity] }) }],
    }));
  }

  /** @param {Float64Array} counts */
  show(counts) {
    const groups = grouped(counts, MOST_BARS);
    this.plot.show([groups.map(({ first }) => first), groups.map(({ count }) => count || null)]);
    if (!(this.table.parentElement instanceof HTMLDetailsElement) || !this.table.parentElement.open) return;
    const rows = groups.filter(({ count }) => count > 0).map(({ first, last, count }) =>
      [first === last ? first : `${first} to ${last}`, count]);
    this.table.replaceChildren(tableOf("Histogram", ["code", "pixels"], rows));
  }
}
