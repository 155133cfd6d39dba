// Where the knobs stand, with a way back; pure.

/** @typedef {import("./types.js").Turn} Turn */
/** @typedef {import("./types.js").Knobs} Knobs */

const LONGEST = 500; // steps back

/** @param {number} sources @returns {Turn} */
export function untouched(sources) {
  return { levels: new Array(sources).fill(1), knobs: {} };
}

/** The knobs, their past, and what was undone. */
export class History {
  /** @param {Turn} turn */
  constructor(turn) {
    /** @type {Turn[]} */
    this.past = [];
    /** @type {Turn[]} */
    this.undone = [];
    this.now = turn;
    this.start = turn;
    /** @type {string | null} what the last step turned: a drag of one knob is one step */
    this.turning = null;
  }

  /**
   * Turn knobs.
   * @param {Turn} turn
   * @param {string} what same words in a row, until `rest`, are one step
   */
  turn(turn, what) {
    if (sameTurn(turn, this.now)) return false;
    if (this.turning !== what) {
      this.past.push(this.now);
      if (this.past.length > LONGEST) this.past.shift();
    }
    this.turning = what;
    this.undone = [];
    this.now = turn;
    return true;
  }

  /** The next step is another one. */
  rest() {
    this.turning = null;
  }

  /** One step back; false where there is none. */
  undo() {
    const before = this.past.pop();
    if (!before) return false;
    this.undone.push(this.now);
    this.now = before;
    this.turning = null;
    return true;
  }

  /** One step forward again. */
  redo() {
    const after = this.undone.pop();
    if (!after) return false;
    this.past.push(this.now);
    this.now = after;
    this.turning = null;
    return true;
  }
}

/**
 * @param {Turn} turn
 * @param {number[]} which
 * @param {number} level
 * @returns {Turn}
 */
export function withLevels(turn, which, level) {
  const levels = turn.levels.slice();
  for (const k of which) levels[k] = level;
  return { ...turn, levels };
}

/**
 * @param {Turn} turn
 * @param {keyof Knobs} name
 * @param {string | undefined} text undefined: as in the scene
 * @returns {Turn}
 */
export function withKnob(turn, name, text) {
  const knobs = { ...turn.knobs };
  if (text === undefined) delete knobs[name];
  else knobs[name] = text;
  return { ...turn, knobs };
}

/**
 * @param {Turn} a
 * @param {Turn} b
 */
export function sameTurn(a, b) {
  const names = new Set([...Object.keys(a.knobs), ...Object.keys(b.knobs)]);
  return a.levels.every((level, k) => level === b.levels[k])
    && [...names].every((name) => a.knobs[/** @type {keyof Knobs} */ (name)] === b.knobs[/** @type {keyof Knobs} */ (name)]);
}
