// What two pictures differ by, and where that is more than their errors; pure, for the workers and for tests.
//
// Gray levels before rounding are compared: codes may differ by 1 where there is hardly a difference.
// Errors of both are taken as independent. Pictures of one basis share its rays, so that theirs largely cancel: a
// difference is then surer than it is called here.

import { codeOf } from "./mix.js";
import { grayOf } from "./response.js";

/** @typedef {import("./types.js").Section} Section */
/** @typedef {{gray: Float32Array, sigma: Float32Array}} Side a picture's gray levels before rounding, and their standard
 *   deviations */
/** @typedef {Side & {light: Float32Array, ranks: import("./mix.js").Ranks}} Now and its radiant exposure [J/m^2], and where
 *   its codes begin */

export const SURE = 1.96; // standard deviations: 95 %
const SAME = 0xff767676; // what may be error alone

/**
 * Gray levels before rounding.
 * @param {Float32Array} light radiant exposure [J/m^2]
 * @param {import("./types.js").Sensor} sensor
 */
export function graysOf(light, sensor) {
  return light.map((exposure) => grayOf(exposure, sensor));
}

/**
 * B - A of one section, and the statistics of all pixels of a band. Where a bin holds several pixels, the one is shown
 * whose difference is the surest, so that no pixel disappears.
 * @param {Side} a
 * @param {Now} b
 * @param {number} columns
 * @param {number} top first row of the band in the image
 * @param {Section} section
 * @param {number} range difference of the strongest colours [gray level]
 * @param {number} codes how many codes there are
 * @returns {import("./types.js").Frame & {row: number, apart: import("./types.js").Apart}}
 */
export function differenceOf(a, b, columns, top, section, range, codes) {
  const { bin, x0, x1, y0, y1 } = section;
  const rows = a.gray.length / columns;
  const row0 = Math.max(0, Math.ceil((top - y0) / bin));
  const row1 = Math.max(row0, Math.ceil((Math.min(top + rows, y1) - y0) / bin));
  const width = Math.ceil((x1 - x0) / bin);
  const pixels = new Uint32Array(width * (row1 - row0)).fill(SAME);
  const surest = new Float32Array(pixels.length);
  const counts = new Float64Array(codes);
  const apart = { beyond: 0, squares: 0, least: Infinity, largest: -Infinity };
  let saturated = 0, dark = 0;
  for (let i = 0; i < a.gray.length; i++) {
    const off = b.gray[i] - a.gray[i];
    const sure = off === 0 ? 0 : Math.abs(off) / Math.sqrt(a.sigma[i] ** 2 + b.sigma[i] ** 2);
    counts[codeOf(b.light[i], b.ranks)]++;
    if (b.light[i] >= b.ranks.saturated) saturated++;
    if (b.light[i] < b.ranks.lit) dark++;
    if (sure > SURE) apart.beyond++;
    apart.squares += off * off;
    if (off < apart.least) apart.least = off;
    if (off > apart.largest) apart.largest = off;
    const x = i % columns, y = top + Math.floor(i / columns);
    if (sure <= SURE || x < x0 || x >= x1 || y < y0 || y >= y1) continue;
    const at = (Math.floor((y - y0) / bin) - row0) * width + Math.floor((x - x0) / bin);
    if (sure > surest[at]) {
      surest[at] = sure;
      pixels[at] = colourOf(off / range);
    }
  }
  const rgba = new Uint8ClampedArray(pixels.buffer);
  return { rgba, width, height: row1 - row0, row: row0, counts, saturated, dark, flips: 0, apart };
}

/**
 * Brighter is light and yellow, darker is dark and blue: told apart without colours too, as little-endian RGBA.
 * @param {number} share of the range
 */
export function colourOf(share) {
  const strong = Math.min(1, Math.abs(share));
  const [red, green, blue] = share > 0 ? [180 + 75 * strong, 150 + 85 * strong, 100 - 40 * strong]
    : [80 - 75 * strong, 100 - 80 * strong, 150 - 40 * strong];
  return ((255 << 24) | (Math.round(blue) << 16) | (Math.round(green) << 8) | Math.round(red)) >>> 0;
}

/**
 * What the bands of a picture say together.
 * @param {import("./types.js").Apart[]} parts
 * @returns {import("./types.js").Apart}
 */
export function together(parts) {
  return parts.reduce((all, one) => ({ beyond: all.beyond + one.beyond, squares: all.squares + one.squares,
    least: Math.min(all.least, one.least), largest: Math.max(all.largest, one.largest) }));
}
