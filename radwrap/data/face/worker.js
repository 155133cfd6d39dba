// A band of rows of the picture: holds the planes of light, mixes them, and draws what is asked for.

import { differenceOf, graysOf } from "./difference.js";
import { addPlane, frameOf, ranksOf, sumPlanes, timesOf } from "./mix.js";

const MOST_STEPS = 64; // sums that are changed plane by plane, before they are made anew: roundings add up

/** @type {import("./types.js").Plane[]} */
let planes = [];
/** @type {Float64Array} */
let sum = new Float64Array(0);
/** @type {Float32Array | null} */
let certified = null;
/** @type {Float32Array} */
let sigma = new Float32Array(0);
/** @type {Float32Array | null} gray levels of what is certified, once they are needed */
let grays = null;
/** @type {{light: Float32Array, gray: Float32Array, sigma: Float32Array, ranks: ReturnType<typeof ranksOf>, codes: number} | null} */
let kept = null;
/** @type {any} */
let sensor = null;
/** @type {number[]} */
let factors = [];
/** @type {ReturnType<typeof ranksOf>} */
let ranks = ranksOf({ first: 0, values: new Float32Array(0), saturated: Infinity, lit: Infinity });
let columns = 0, top_ = 0, codes = 256, steps = 0;

/**
 * Mix the light; returns by how much the sum is to be multiplied.
 * @param {number[]} wanted
 */
function mix(wanted) {
  const times = timesOf(factors, wanted);
  if (times !== null) return times;
  const turned = wanted.flatMap((factor, k) => (factor === factors[k] ? [] : [k]));
  const few = factors.length === wanted.length && 2 * turned.length < wanted.length + 2 && ++steps < MOST_STEPS;
  if (few && turned.every((k) => wanted[k] !== 0)) {
    for (const k of turned) addPlane(sum, planes[k], wanted[k] - factors[k]);
  } else {
    steps = 0;
    sumPlanes(planes, wanted, sum);
  }
  factors = wanted;
  return 1;
}

/** @param {MessageEvent} event */
onmessage = (event) => {
  const told = event.data;
  switch (told.kind) {
    case "begin":
      ({ columns } = told);
      top_ = told.top;
      planes = [];
      factors = [];
      certified = null;
      kept = null;
      sum = new Float64Array(told.rows * columns);
      break;
    case "plane":
      planes.push(told.plane);
      break;
    case "certified":
      certified = told.exposure;
      grays = null;
      break;
    case "deviations":
      ({ sigma } = told);
      break;
    case "kept":
      kept = { light: told.exposure, gray: graysOf(told.exposure, told.sensor), sigma: new Float32Array(0),
        ranks: ranksOf(told.thresholds), codes: 2 ** told.sensor.bit_depth };
      break;
    case "kept deviations":
      if (kept) kept.sigma = told.sigma;
      break;
    case "response":
      ({ sensor } = told);
      codes = 2 ** sensor.bit_depth;
      ranks = ranksOf(told.thresholds);
      break;
    case "frame": {
      if (told.shown === "a" && kept) {
        reply(told.id, frameOf(kept.light, columns, top_, 1, kept.ranks, told.section, told.look, kept.codes));
        break;
      }
      if (told.shown === "difference" && kept && certified) {
        grays ??= graysOf(certified, sensor);
        const now = { light: certified, gray: grays, sigma, ranks };
        reply(told.id, differenceOf(kept, now, columns, top_, told.section, told.range, codes));
        break;
      }
      if (told.certified && certified) {
        const frame = frameOf(certified, columns, top_, 1, ranks, told.section, told.look, codes);
        reply(told.id, frame);
        break;
      }
      const times = planes.length === told.factors.length ? mix(told.factors) : 1;
      reply(told.id, frameOf(sum, columns, top_, told.scale * times, ranks, told.section, told.look, codes));
      break;
    }
    case "light": {
      // Of a few pixels, in double precision.
      const values = told.places.map((/** @type {number} */ place) =>
        told.factors.reduce((/** @type {number} */ all, /** @type {number} */ factor, /** @type {number} */ k) => {
          const { high, low, unit } = planes[k];
          return all + factor * (high[place] + (low ? low[place] * unit : 0));
        }, 0));
      postMessage({ id: told.id, values });
      break;
    }
  }
};

/**
 * @param {number} id
 * @param {import("./types.js").Frame} frame
 */
function reply(id, frame) {
  postMessage({ id, frame }, { transfer: [frame.rgba.buffer, frame.counts.buffer] });
}
