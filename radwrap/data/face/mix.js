// From planes of light to codes and colours; pure, for the workers and for tests.
//
// Planes are float32, [W/m^2/sr] in the light of one source alone; a sum of them times a scale is radiant exposure.
// A code is a rank among thresholds. A float's upper bits say nearly which rank: a table of them leaves a step or two.

/** @typedef {import("./types.js").Thresholds} Thresholds */
/** @typedef {import("./types.js").Section} Section */
/** @typedef {import("./types.js").Look} Look */
/** @typedef {import("./types.js").Frame} Frame */
/** @typedef {{first: number, values: Float32Array, begin: Uint16Array, saturated: number, lit: number}} Ranks */

const SHIFT = 15; // bits of a float that the table passes over
const CHUNK = 4096;

/**
 * The sum of all planes.
 * @param {Float32Array[]} planes
 * @param {number[]} factors
 * @param {Float32Array} sum
 */
export function sumPlanes(planes, factors, sum) {
  const used = planes.map((plane, k) => ({ plane, factor: factors[k] })).filter((one) => one.factor !== 0);
  const chunk = new Float64Array(CHUNK);
  for (let start = 0; start < sum.length; start += CHUNK) {
    const size = Math.min(CHUNK, sum.length - start);
    chunk.fill(0);
    for (const { plane, factor } of used) {
      for (let i = 0; i < size; i++) chunk[i] += factor * plane[start + i];
    }
    for (let i = 0; i < size; i++) sum[start + i] = chunk[i] > 0 ? chunk[i] : 0;
  }
}

/**
 * Add a share of one plane: what turning one knob costs, whatever the number of sources.
 * @param {Float32Array} sum
 * @param {Float32Array} plane
 * @param {number} change
 */
export function addPlane(sum, plane, change) {
  for (let i = 0; i < sum.length; i++) {
    const value = sum[i] + change * plane[i];
    sum[i] = value > 0 ? value : 0;
  }
}

/**
 * A table in which codes are looked up.
 * @param {Thresholds} thresholds
 * @returns {Ranks}
 */
export function ranksOf({ first, values, saturated, lit }) {
  const buckets = 0x7f800000 >>> SHIFT;
  const begin = new Uint16Array(buckets + 2);
  const bits = new Uint32Array(values.buffer.slice(values.byteOffset, values.byteOffset + values.byteLength));
  let rank = 0;
  for (let bucket = 0; bucket < begin.length; bucket++) {
    const least = bucket * 2 ** SHIFT;
    while (rank < bits.length && bits[rank] < least) rank++;
    begin[bucket] = rank;
  }
  return { first, values, begin, saturated, lit };
}

const oneFloat = new Float32Array(1);
const oneWord = new Uint32Array(oneFloat.buffer);

/**
 * The code of one radiant exposure [J/m^2].
 * @param {number} exposure
 * @param {Ranks} ranks
 */
export function codeOf(exposure, { first, values, begin }) {
  oneFloat[0] = exposure;
  let rank = begin[oneWord[0] >>> SHIFT];
  while (rank < values.length && values[rank] <= oneFloat[0]) rank++;
  return first + rank;
}

/**
 * One section of the picture, and the statistics of all pixels of a band.
 * @param {Float32Array} sum of the band's pixels
 * @param {number} columns
 * @param {number} top first row of the band in the image
 * @param {number} scale radiant exposure of a unit of the sum
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
  const counted = new Uint32Array(codes);
  const { values, begin, first, saturated, lit } = ranks;
  const last = values.length;
  const light = new Float32Array(columns);
  const bits = new Uint32Array(light.buffer);
  const sums = new Uint32Array(width);
  const marks = new Uint8Array(width);
  const brighter = 1 + look.share;
  // Column of the picture of each pixel of a row: a division for each pixel would take as long as all the rest.
  const place = new Int32Array(columns).fill(-1);
  for (let x = section.x0; x < section.x1; x++) place[x] = Math.floor((x - section.x0) / bin);
  let full = 0, black = 0, flipped = 0;
  const flipping = look.flips;
  for (let row = 0; row < rows; row++) {
    const offset = row * columns;
    for (let x = 0; x < columns; x++) light[x] = sum[offset + x] * scale;
    const v = top + row - section.y0;
    const seen = v >= 0 && top + row < section.y1;
    for (let x = 0; x < columns; x++) {
      const h = light[x];
      let rank = begin[bits[x] >>> SHIFT];
      while (rank < last && values[rank] <= h) rank++;
      const code = first + rank;
      counted[code]++;
      let mark = 0;
      if (h >= saturated) {
        full++;
        mark = 1;
      }
      if (h < lit) {
        black++;
        mark |= 2;
      }
      if (flipping && flips(h * brighter, rank, ranks)) {
        flipped++;
        mark |= 4;
      }
      const column = place[x];
      if (seen && column >= 0) {
        sums[column] += code;
        if (mark) marks[column] |= mark;
      }
    }
    if (seen && (v % bin === bin - 1 || row === rows - 1 || top + row === section.y1 - 1)) {
      const line = Math.floor(v / bin);
      if (line >= row0 && line < row1) {
        const down = (v % bin) + 1;
        for (let column = 0; column < width; column++) {
          const across = Math.min(bin, section.x1 - section.x0 - column * bin);
          const code = bin === 1 ? sums[column] : Math.round(sums[column] / (down * across));
          const mark = marks[column];
          const at = (line - row0) * width + column;
          pixels[at] = mark ? markedColour(colours[code], mark, look, column, line) : colours[code];
        }
      }
      sums.fill(0);
      marks.fill(0);
    }
  }
  const rgba = new Uint8ClampedArray(pixels.buffer);
  return { rgba, width, height: row1 - row0, row: row0, counts: Float64Array.from(counted),
    saturated: full, dark: black, flips: flipped };
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
