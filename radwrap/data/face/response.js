// Eq. 5 as the page needs it between two answers of the server: G = K H^gamma + G0; pure.
//
// Where codes begin is found as the server finds it, see radwrap/imaging/page: the least float32 that Eq. 5 turns into a code.

/** @typedef {import("./types.js").Sensor} Sensor */
/** @typedef {import("./types.js").Knobs} Knobs */
/** @typedef {import("./types.js").Thresholds} Thresholds */

const LEAST = 2 ** -149; // of positive floats
const float = new Float32Array(1), word = new Int32Array(float.buffer);

/**
 * The sensor with its knobs turned, as radwrap/imaging/page/turn.py turns it.
 * @param {Sensor} sensor as the scene has it
 * @param {Knobs} knobs
 * @param {number} times by how much the exposure time is longer
 * @returns {Sensor}
 */
export function turnedSensor(sensor, knobs, times) {
  const gainFactor = numberOr(knobs.gain, 1);
  const gamma = numberOr(knobs.gamma, sensor.gamma);
  const bits = numberOr(knobs.bit_depth, sensor.bit_depth);
  const scale = bits === sensor.bit_depth ? 1 : (2 ** bits - 1) / (2 ** sensor.bit_depth - 1);
  if (sensor.linear) {
    const { full_well: fullWell, electrons_of_exposure: electrons } = sensor.linear;
    const systemGain = sensor.linear.system_gain * gainFactor * scale;
    const offset = numberOr(knobs.dark_gray, sensor.linear.offset) * scale;
    const signal = sensor.linear.dark_signal * times;
    const dark = offset + systemGain * signal;
    const full = Math.min(offset + systemGain * fullWell, 2 ** bits - 1);
    const gain = (systemGain * electrons) ** gamma * (full - dark) ** (1 - gamma);
    const linear = { ...sensor.linear, system_gain: systemGain, offset, dark_signal: signal };
    return { ...sensor, gain, gamma, dark_gray: dark, saturation_gray: full, bit_depth: bits, linear };
  }
  const fullExposure = ((sensor.saturation_gray - sensor.dark_gray) / sensor.gain) ** (1 / sensor.gamma);
  return {
    ...sensor,
    gain: gainFactor * scale * sensor.gain * fullExposure ** (sensor.gamma - gamma),
    gamma,
    dark_gray: numberOr(knobs.dark_gray, sensor.dark_gray) * scale,
    saturation_gray: sensor.saturation_gray * scale,
    bit_depth: bits,
  };
}

/**
 * @param {string | undefined} text
 * @param {number} otherwise
 */
function numberOr(text, otherwise) {
  const value = text === undefined ? NaN : Number(text);
  return Number.isFinite(value) && text?.trim() !== "" ? value : otherwise;
}

/**
 * Gray level before rounding.
 * @param {number} exposure radiant exposure [J/m^2]
 * @param {Sensor} sensor
 */
export function grayOf(exposure, sensor) {
  return Math.min(sensor.gain * exposure ** sensor.gamma + sensor.dark_gray, sensor.saturation_gray);
}

/**
 * The code of a radiant exposure: how many thresholds it has reached.
 * @param {number} exposure [J/m^2]
 * @param {Thresholds} thresholds
 */
export function rankOf(exposure, { first, values }) {
  let low = 0, high = values.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (values[middle] <= exposure) low = middle + 1;
    else high = middle;
  }
  return first + low;
}

/**
 * Radiant exposures at which codes begin.
 * @param {Sensor} sensor
 * @returns {Thresholds}
 */
export function thresholdsOf(sensor) {
  const first = nearest(sensor.dark_gray);
  const last = Math.max(first, nearest(sensor.saturation_gray));
  const values = new Float32Array(last - first);
  for (let k = 0; k < values.length; k++) values[k] = exposureOf(first + k + 0.5, sensor);
  const { saturation_gray: full, dark_gray: dark } = sensor;
  if (dark === first + 0.5 && values.length > 0) values[0] = LEAST; // no light has the even code, any light the next one
  return { first, values, saturated: exposureOf(full, sensor), lit: exposureOf(dark + 0.5, sensor) };
}

/**
 * The nearest whole number, of two the even one, as the server rounds: all pixels without light may lie on a half.
 * @param {number} gray
 */
function nearest(gray) {
  const above = Math.round(gray);
  return above - gray === 0.5 && above % 2 !== 0 ? above - 1 : above;
}

/**
 * The least float that reaches a gray level: one that is rounded to the nearest is too small in half of the cases.
 * @param {number} gray
 * @param {Sensor} sensor
 */
function exposureOf(gray, sensor) {
  if (gray > sensor.saturation_gray) return Infinity;
  const exact = Math.max(0, (gray - sensor.dark_gray) / sensor.gain) ** (1 / sensor.gamma);
  float[0] = exact;
  if (float[0] < exact) word[0]++; // floats that are not negative are in the order of their bits
  return float[0];
}
