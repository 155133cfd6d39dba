// From planes of light to codes and colours; pure, for the workers and for tests.
//
// Planes are light [W/m^2/sr] of one source alone, in eight bits more than a float32 has; their sum is a double, and
// becomes radiant exposure by a scale. That is rounded to a float32 once, as the server rounds it: then codes are the server's.
// A code is a rank among thresholds. A float's upper bits say nearly which rank: a table of them leaves a step or two.

/** @typedef {import("./types.js").Thresholds} Thresholds */
/** @typedef {import("./types.js").Plane} Plane */
/** @typedef {import("./types.js").Section} Section */
/** @typedef {import("./types.js").Look} Look */
/** @typedef {import("./types.js").Frame} Frame */
/** @typedef {{first: number, values: Float32Array, words: Int32Array, begin: Uint16Array, single: boolean,
 *   saturated: number, lit: number, full: number, barely: number}} Ranks thresholds as floats and as their bits, and where a bucket of bits begins; bits
 *   of light that is saturated, and no longer dark */
/** @typedef {{ranks: Uint16Array, counted: Uint32Array[], saturated: number, dark: number}} Line a row of pixels in the
 *   making */

const SHIFT = 15; // bits of a float that the table passes over
const CHUNK = 4096;
const ALIKE = 1e-12; // of a level: far below what a float of the planes holds
const LANES = 4; // counts of each code, as neighbours are alike: one count would wait for the other
const LAST_WORD = 0x7fffffff;

/**
 * The sum of all planes; it may be negative by noise.
 * @param {Plane[]} planes
 * @param {number[]} factors
 * @param {Float64Array} sum
 */
export function sumPlanes(planes, factors, sum) {
  sum.fill(0);
  for (let start = 0; start < sum.length; start += CHUNK) {
    const end = Math.min(sum.length, start + CHUNK); // a part of the sum that stays near the processor
    for (const [k, plane] of planes.entries()) if (factors[k] !== 0) addPlane(sum, plane, factors[k], start, end);
  }
}

/**
 * Add a share of one plane: what turning one knob costs, whatever the number of sources.
 * @param {Float64Array} sum
 * @param {Plane} plane
 * @param {number} change
 * @param {number} start
 * @param {number} end
 */
export function addPlane(sum, { high, low, unit }, change, start = 0, end = sum.length) {
  const small = change * unit;
  if (low === null) for (let i = start; i < end; i++) sum[i] += change * high[i];
  else for (let i = start; i < end; i++) sum[i] += change * high[i] + small * low[i];
}

/**
 * By how much all levels together are larger: then the sum is only multiplied; null where they are not turned alike.
 * @param {number[]} before
 * @param {number[]} after
 */
export function timesOf(before, after) {
  const k = before.findIndex((level) => level > 0);
  if (k < 0 || before.length !== after.length) return null;
  const times = after[k] / before[k];
  return after.every((level, n) => Math.abs(level - times * before[n]) <= ALIKE * level) ? times : null;
}

/**
 * A table in which codes are looked up.
 * @param {Thresholds} thresholds
 * @returns {Ranks}
 */
export function ranksOf({ first, values, saturated, lit }) {
  const words = new Int32Array(values.length + 1);
  words.set(new Int32Array(values.buffer.slice(values.byteOffset, values.byteOffset + values.byteLength)));
  words[values.length] = LAST_WORD; // no light is brighter
  return { first, values, words, saturated, lit, full: wordOf(saturated), barely: wordOf(lit), ...bucketsOf(words) };
}

/**
 * The rank with which each bucket of bits begins, and whether none holds more than one threshold.
 * @param {Int32Array} words
 */
function bucketsOf(words) {
  const buckets = 0x7f800000 >>> SHIFT, count = words.length - 1;
  const begin = new Uint16Array(buckets + 2);
  let rank = 0, most = 0;
  for (let bucket = 0; bucket < begin.length; bucket++) {
    const least = bucket * 2 ** SHIFT, before = rank;
    while (rank < count && words[rank] < least) rank++;
    begin[bucket] = rank;
    most = Math.max(most, rank - before);
  }
  return { begin, single: most <= 1 };
}

const oneFloat = new Float32Array(1);
const oneWord = new Int32Array(oneFloat.buffer);

/** Floats that are not negative are in the order of their bits. @param {number} value */
function wordOf(value) {
  oneFloat[0] = value;
  return oneWord[0];
}

/**
 * The code of one radiant exposure [J/m^2].
 * @param {number} exposure
 * @param {Ranks} ranks
 */
export function codeOf(exposure, { first, words, begin }) {
  const word = wordOf(exposure);
  let rank = begin[word >>> SHIFT];
  while (words[rank] <= word) rank++;
  return first + rank;
}

/**
 * One section of the picture, and the statistics of all pixels of a band.
 * @param {Float32Array | Float64Array} sum of the band's pixels
 * @param {number} columns
 * @param {number} top first row of the band in the image
 * @param {number} scale radiant exposure of a unit of the sum; 1 of floats, which are radiant exposure
 * @param {Ranks} ranks
 * @param {Section} section
 * @param {Look} look
 * @param {number} codes how many codes there are
 * @returns {Frame & {row: number}} with the first row of the picture that the band draws
 */
export function frameOf(sum, columns, top, scale, ranks, section, look, codes) {
  const { bin } = section;
  const rows = sum.length / columns;
  // Rows and columns of the picture whose first pixels lie in the band: bands begin at multiples of every bin.
  const row0 = Math.max(0, Math.ceil((top - section.y0) / bin));
  const row1 = Math.max(row0, Math.ceil((Math.min(top + rows, section.y1) - section.y0) / bin));
  const width = Math.ceil((section.x1 - section.x0) / bin);
  const colours = coloursOf(look, codes);
  const pixels = new Uint32Array(width * (row1 - row0));
  const { first } = ranks;
  const exposure = sum instanceof Float32Array ? null : new Float32Array(columns); // of a row
  const line = { ranks: new Uint16Array(columns), counted: Array.from({ length: LANES }, () => new Uint32Array(codes)),
    saturated: 0, dark: 0 };
  const down = new Uint32Array(columns); // sums of ranks, from the first row of a bin
  const sums = new Uint32Array(width);
  const marks = new Uint8Array(width);
  const marked = look.saturated || look.dark || look.flips;
  let flipped = 0;
  for (let row = 0; row < rows; row++) {
    const v = top + row - section.y0;
    const seen = v >= 0 && top + row < section.y1;
    const light = exposure ? exposed(sum, row * columns, scale, exposure) : sum.subarray(row * columns, (row + 1) * columns);
    rank(light, ranks, line);
    if (marked) flipped += mark(light, line, ranks, section, look, seen ? marks : null);
    if (!seen) continue;
    for (let column = section.x0; column < section.x1; column++) down[column] += line.ranks[column];
    if (v % bin === bin - 1 || row === rows - 1 || top + row === section.y1 - 1) {
      const high = (v % bin) + 1, at = Math.floor(v / bin) - row0;
      if (at >= 0 && at < row1 - row0) {
        binned(down, section, sums);
        for (let column = 0; column < width; column++) {
          const across = Math.min(bin, section.x1 - section.x0 - column * bin);
          const code = first + (bin === 1 ? sums[column] : Math.round(sums[column] / (high * across)));
          const colour = colours[code];
          pixels[at * width + column] = marks[column] ? markedColour(colour, marks[column], look, column, at + row0) : colour;
        }
      }
      down.fill(0);
      marks.fill(0);
    }
  }
  const counts = new Float64Array(codes);
  for (let lane = 0; lane < LANES; lane++) {
    for (let code = first; code < codes; code++) counts[code] += line.counted[lane][code - first];
  }
  const rgba = new Uint8ClampedArray(pixels.buffer);
  return { rgba, width, height: row1 - row0, row: row0, counts, saturated: line.saturated, dark: line.dark, flips: flipped };
}

/**
 * Radiant exposure of a row, as a file holds it.
 * @param {Float32Array | Float64Array} sum
 * @param {number} offset of the row
 * @param {number} scale
 * @param {Float32Array} exposure
 */
function exposed(sum, offset, scale, exposure) {
  for (let x = 0; x < exposure.length; x++) {
    const light = sum[offset + x] * scale;
    exposure[x] = light > 0 ? light : 0;
  }
  return exposure;
}

/**
 * Ranks of a row of pixels, how many pixels have each, and how many are saturated or dark. No branch hangs on the light:
 * a processor that guesses wrong loses as much time as all the rest takes.
 * @param {Float32Array | Float64Array} light floats of the row
 * @param {Ranks} begun
 * @param {Line} line
 */
function rank(light, begun, line) {
  const { words, begin, full, barely } = begun;
  const bits = new Int32Array(light.buffer, light.byteOffset, line.ranks.length);
  const { ranks, counted } = line;
  const whole = begun.single ? ranks.length - (ranks.length % LANES) : 0;
  const [count0, count1, count2, count3] = counted;
  let saturated = 0, dark = 0;
  for (let x = 0; x < whole; x += LANES) {
    const word0 = bits[x], word1 = bits[x + 1], word2 = bits[x + 2], word3 = bits[x + 3];
    let rank0 = begin[word0 >>> SHIFT], rank1 = begin[word1 >>> SHIFT], rank2 = begin[word2 >>> SHIFT], rank3 = begin[word3 >>> SHIFT];
    rank0 += (words[rank0] - 1 - word0) >>> 31; // 1 where the word is no less
    rank1 += (words[rank1] - 1 - word1) >>> 31;
    rank2 += (words[rank2] - 1 - word2) >>> 31;
    rank3 += (words[rank3] - 1 - word3) >>> 31;
    ranks[x] = rank0;
    ranks[x + 1] = rank1;
    ranks[x + 2] = rank2;
    ranks[x + 3] = rank3;
    count0[rank0]++;
    count1[rank1]++;
    count2[rank2]++;
    count3[rank3]++;
    saturated += ((full - 1 - word0) >>> 31) + ((full - 1 - word1) >>> 31) + ((full - 1 - word2) >>> 31) + ((full - 1 - word3) >>> 31);
    dark += ((word0 - barely) >>> 31) + ((word1 - barely) >>> 31) + ((word2 - barely) >>> 31) + ((word3 - barely) >>> 31);
  }
  for (let x = whole; x < ranks.length; x++) {
    const word = bits[x];
    let found = begin[word >>> SHIFT];
    while (words[found] <= word) found++;
    ranks[x] = found;
    counted[x % LANES][found]++;
    saturated += (full - 1 - word) >>> 31;
    dark += (word - barely) >>> 31;
  }
  line.saturated += saturated;
  line.dark += dark;
}

/**
 * What overlays show of a row; returns how many pixels flip.
 * @param {Float32Array | Float64Array} light floats of the row
 * @param {Line} line
 * @param {Ranks} ranks
 * @param {Section} section
 * @param {Look} look
 * @param {Uint8Array | null} marks null where the row is not seen
 */
function mark(light, { ranks: found }, ranks, section, look, marks) {
  const { full, barely } = ranks;
  const bits = new Int32Array(light.buffer, light.byteOffset, found.length);
  const brighter = 1 + look.share;
  let flipped = 0;
  for (let x = 0; x < found.length; x++) {
    let one = bits[x] >= full ? 1 : 0;
    if (bits[x] < barely) one |= 2;
    if (look.flips && flips(light[x] * brighter, found[x], ranks)) {
      flipped++;
      one |= 4;
    }
    if (one && marks && x >= section.x0 && x < section.x1) marks[Math.floor((x - section.x0) / section.bin)] |= one;
  }
  return flipped;
}

/**
 * Sums of ranks over the columns of each bin.
 * @param {Uint32Array} down
 * @param {Section} section
 * @param {Uint32Array} sums
 */
function binned(down, { x0, x1, bin }, sums) {
  for (let column = 0, x = x0; x < x1; column++) {
    const end = Math.min(x + bin, x1);
    let all = 0;
    for (; x < end; x++) all += down[x];
    sums[column] = all;
  }
}

/**
 * Whether more light gives another code.
 * @param {number} exposure the larger one
 * @param {number} rank of the smaller one
 * @param {Ranks} ranks
 */
function flips(exposure, rank, { values }) {
  return rank < values.length && values[rank] <= Math.fround(exposure);
}

// Overlays differ in pattern as well as in colour: all pixels, every second, every third diagonal.
const RED = 0xff2030ff;
const BLUE = 0xffff9020;
const GREEN = 0xff40c040;

/**
 * @param {number} colour
 * @param {number} mark
 * @param {Look} look
 * @param {number} x
 * @param {number} y
 */
function markedColour(colour, mark, look, x, y) {
  if (mark & 1 && look.saturated) return RED;
  if (mark & 4 && look.flips && (x + y) % 2 === 0) return BLUE;
  if (mark & 2 && look.dark && (x + y) % 3 === 0) return GREEN;
  return colour;
}

/**
 * Colour of each code, as little-endian RGBA.
 * @param {Look} look
 * @param {number} codes
 */
export function coloursOf(look, codes) {
  const colours = new Uint32Array(codes);
  const map = MAPS[look.map] ?? MAPS.gray;
  for (let code = 0; code < codes; code++) {
    const share = Math.min(1, Math.max(0, (code - look.low) / Math.max(1, look.high - look.low)));
    const [r, g, b] = map(share);
    colours[code] = (255 << 24) | (Math.round(b) << 16) | (Math.round(g) << 8) | Math.round(r);
  }
  return colours;
}

// Nodes of viridis and cividis [0..255]: read by people who see no difference of red and green.
const VIRIDIS = [[68, 1, 84], [71, 44, 122], [59, 81, 139], [44, 113, 142], [33, 144, 141], [39, 173, 129],
  [92, 200, 99], [170, 220, 50], [253, 231, 37]];
const CIVIDIS = [[0, 32, 77], [12, 53, 107], [64, 77, 107], [96, 101, 112], [124, 123, 120], [155, 147, 118],
  [188, 173, 108], [222, 200, 90], [255, 234, 70]];

/** @type {Record<string, (share: number) => number[]>} */
export const MAPS = {
  gray: (share) => [255 * share, 255 * share, 255 * share],
  viridis: (share) => between(VIRIDIS, share),
  cividis: (share) => between(CIVIDIS, share),
};

/**
 * @param {number[][]} nodes
 * @param {number} share
 */
function between(nodes, share) {
  const place = share * (nodes.length - 1);
  const k = Math.min(nodes.length - 2, Math.floor(place));
  return nodes[k].map((value, c) => value + (place - k) * (nodes[k + 1][c] - value));
}
