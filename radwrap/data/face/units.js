// Numbers as people write and read them; pure. The server reads them anew: its word counts.

/** @type {Record<string, number>} */
const TIMES = { s: 1, ms: 1e-3, us: 1e-6, ns: 1e-9 };
const NUMBER = /^[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?$/;

/**
 * A time [s]; null where it is none.
 * @param {string} text
 */
export function parseTime(text) {
  const [number, unit, more] = text.trim().split(" ");
  if (more !== undefined || !NUMBER.test(number) || !Object.hasOwn(TIMES, unit ?? "")) return null;
  const value = Number(number) * TIMES[unit];
  return value > 0 && value <= 1e9 ? value : null;
}

/**
 * A number; null where it is none.
 * @param {string} text
 */
export function parseNumber(text) {
  const value = NUMBER.test(text.trim()) ? Number(text) : NaN;
  return Number.isFinite(value) ? value : null;
}

/**
 * A time with the unit that makes its number handy.
 * @param {number} seconds
 */
export function timeText(seconds) {
  const unit = Object.keys(TIMES).find((name) => seconds >= TIMES[name]) ?? "ns";
  return `${shortNumber(seconds / TIMES[unit])} ${unit}`;
}

/**
 * A number with so many significant digits, without noughts behind.
 * @param {number} value
 * @param {number} digits
 */
export function shortNumber(value, digits = 4) {
  if (!Number.isFinite(value)) return "no bound";
  return String(Number(value.toPrecision(digits)));
}

/** A large number as people say it. @param {number} count */
export function countText(count) {
  return count < 1e4 ? String(count) : count < 999_500 ? `${Math.round(count / 1e3)} thousand` : `${(count / 1e6).toFixed(1)} million`;
}

/** @param {number} share */
export function percent(share) {
  if (share === 0) return "0 %";
  const text = (100 * share).toFixed(share < 0.001 ? 3 : 1);
  return Number(text) === 0 ? "< 0.001 %" : `${text} %`;
}

/**
 * Radiant exposure in a handy unit.
 * @param {number} exposure [J/m^2]
 */
export function exposureText(exposure) {
  /** @type {[string, number][]} */
  const units = [["J/m²", 1], ["mJ/m²", 1e-3], ["µJ/m²", 1e-6], ["nJ/m²", 1e-9]];
  const [unit, size] = units.find(([, one]) => exposure >= one) ?? units[3];
  return `${shortNumber(exposure / size)} ${unit}`;
}

/** An error of gray levels with two digits that count. @param {number | null} gray */
export function errorText(gray) {
  return gray === null ? "without bound" : gray < 1e-3 ? "0.00" : gray.toPrecision(gray < 10 ? 2 : 3);
}
