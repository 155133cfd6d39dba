// The knobs as the user sees them: a slider, a text with its unit, a way back.

import { drawing, element } from "./dom.js";
import { withKnob, withLevels } from "./state.js";
import { parseNumber, parseTime, shortNumber, timeText } from "./units.js";

/** @typedef {import("./types.js").Turn} Turn */
/** @typedef {import("./types.js").Knobs} Knobs */
/** @typedef {import("./types.js").Described} Described */
/** @typedef {{show: (turn: Turn) => void, wrong: (text: string | null) => void}} Row */

const MOST = 2; // of a level's slider; more can be typed
const OCTAVES = 4; // of a slider of factors, to each side

/** All knobs of a basis. */
export class KnobPanel {
  /**
   * @param {Described} described
   * @param {{rings: HTMLElement, levels: HTMLElement, camera: HTMLElement}} places
   * @param {() => Turn} now
   * @param {(turn: Turn, what: string) => void} turn
   * @param {() => void} rest
   */
  constructor(described, places, now, turn, rest) {
    this.described = described;
    this.now = now;
    this.turn = turn;
    this.rest = rest;
    /** @type {Map<string, Row>} */
    this.rows = new Map();
    places.rings.replaceChildren();
    places.levels.replaceChildren();
    places.camera.replaceChildren();
    this.addLevels(places);
    this.addCamera(places.camera);
    this.show(now());
  }

  /** @param {Turn} turn */
  show(turn) {
    for (const row of this.rows.values()) row.show(turn);
  }

  /**
   * Mark a field whose value is refused, with the reason; none where the place names no field.
   * @param {string} where
   * @param {string} text
   */
  refuse(where, text) {
    const name = where.replace(/^.*: /, "").replace("camera.sensor.", "").replace("camera.", "");
    const known = /** @type {Record<string, string>} */ ({ system_gain: "gain", offset: "dark_gray", saturation_gray: "bit_depth" });
    const row = this.rows.get(known[name] ?? name) ?? this.rows.get(where.replace(/^level /, "level:"));
    row?.wrong(text);
    return Boolean(row);
  }

  accept() {
    for (const row of this.rows.values()) row.wrong(null);
  }

  /** @param {{rings: HTMLElement, levels: HTMLElement}} places */
  addLevels(places) {
    const { sources } = this.described;
    const all = sources.map((_, k) => k);
    if (sources.length > 1) this.addLevel(places.levels, "all", all, "level:all");
    const rings = new Map();
    sources.forEach(({ ring }, k) => { if (ring !== null) rings.set(ring, [...(rings.get(ring) ?? []), k]); });
    for (const [ring, members] of rings) {
      if (members.length < sources.length) this.addLevel(places.levels, ring, members, `level:${ring}.*`);
      this.addRing(places.rings, ring, members);
    }
    sources.forEach(({ name, ring }, k) => {
      this.addLevel(places.levels, ring !== null && rings.size === 1 ? name.slice(ring.length + 1) : name, [k], `level:${name}`);
    });
  }

  /**
   * @param {HTMLElement} place
   * @param {string} label
   * @param {number[]} which
   * @param {string} name
   */
  addLevel(place, label, which, name) {
    /** @param {Turn} turn */
    const level = (turn) => {
      const first = turn.levels[which[0]];
      return which.every((k) => turn.levels[k] === first) ? first : null;
    };
    this.addRow(place, "knob led", label, name, {
      slider: { min: 0, max: MOST, step: 0.01, of: (turn) => level(turn) ?? mean(turn.levels, which),
        to: (value) => withLevels(this.now(), which, value) },
      text: (turn) => { const one = level(turn); return one === null ? "mixed" : shortNumber(one, 6); },
      read: (text) => {
        const value = parseNumber(text);
        return value === null || value < 0 || value > 1e6 ? "a level is a number from 0 to 1e6"
          : withLevels(this.now(), which, value);
      },
      back: () => withLevels(this.now(), which, 1),
    });
  }

  /** @param {HTMLElement} place */
  addCamera(place) {
    const { sensor, exposure_time: time } = this.described;
    /** @param {keyof Knobs} name @param {string | undefined} text */
    const knob = (name, text) => withKnob(this.now(), name, text);
    /** @param {keyof Knobs} name @param {number} low @param {number} high */
    const read = (name, low, high) => (/** @type {string} */ text) => {
      const value = parseNumber(text);
      return value === null || value < low || value > high ? `${label[name]} is a number from ${low} to ${high}` : knob(name, text.trim());
    };
    const label = { exposure_time: "exposure time", gain: "gain factor", gamma: "gamma", bit_depth: "bits",
      dark_gray: sensor.linear ? "offset" : "dark level" };
    const dark = sensor.linear ? sensor.linear.offset : sensor.dark_gray;
    if (time > 0) {
      this.addRow(place, "knob", label.exposure_time, "exposure_time", {
        slider: { min: -OCTAVES, max: OCTAVES, step: 0.01,
          of: ({ knobs }) => Math.log2((parseTime(knobs.exposure_time ?? "") ?? time) / time),
          to: (value) => knob("exposure_time", value === 0 ? undefined : timeText(time * 2 ** value)) },
        text: ({ knobs }) => knobs.exposure_time ?? timeText(time),
        read: (text) => knob("exposure_time", text.trim()), // its units are the server's to judge
        back: () => knob("exposure_time", undefined),
      });
    }
    this.addRow(place, "knob", label.gain, "gain", {
      slider: { min: -OCTAVES, max: OCTAVES, step: 0.01, of: ({ knobs }) => Math.log2(Number(knobs.gain ?? 1)),
        to: (value) => knob("gain", value === 0 ? undefined : shortNumber(2 ** value)) },
      text: ({ knobs }) => knobs.gain ?? "1",
      read: read("gain", 1e-6, 1e6),
      back: () => knob("gain", undefined),
    });
    this.addRow(place, "knob", label.gamma, "gamma", {
      slider: { min: 0.2, max: 2, step: 0.01, of: ({ knobs }) => Number(knobs.gamma ?? sensor.gamma),
        to: (value) => knob("gamma", value === sensor.gamma ? undefined : String(value)) },
      text: ({ knobs }) => knobs.gamma ?? shortNumber(sensor.gamma, 6),
      read: read("gamma", 0.01, 10),
      back: () => knob("gamma", undefined),
    });
    this.addRow(place, "knob", label.dark_gray, "dark_gray", {
      slider: { min: 0, max: Math.max(1, Math.round(sensor.saturation_gray / 2)), step: 0.5,
        of: ({ knobs }) => Number(knobs.dark_gray ?? dark),
        to: (value) => knob("dark_gray", value === dark ? undefined : String(value)) },
      text: ({ knobs }) => knobs.dark_gray ?? shortNumber(dark, 6),
      read: read("dark_gray", 0, 65535),
      back: () => knob("dark_gray", undefined),
    });
    this.addRow(place, "knob", label.bit_depth, "bit_depth", {
      slider: { min: 1, max: 16, step: 1, of: ({ knobs }) => Number(knobs.bit_depth ?? sensor.bit_depth),
        to: (value) => knob("bit_depth", value === sensor.bit_depth ? undefined : String(value)) },
      text: ({ knobs }) => knobs.bit_depth ?? String(sensor.bit_depth),
      read: (text) => (/^([1-9]|1[0-6])$/.test(text.trim()) ? knob("bit_depth", text.trim()) : "bits are a whole number from 1 to 16"),
      back: () => knob("bit_depth", undefined),
    });
  }

  /**
   * @param {HTMLElement} place
   * @param {string} kind
   * @param {string} label
   * @param {string} name
   * @param {{slider: {min: number, max: number, step: number, of: (turn: Turn) => number, to: (value: number) => Turn},
   *   text: (turn: Turn) => string, read: (text: string) => Turn | string, back: () => Turn}} how
   */
  addRow(place, kind, label, name, { slider, text, read, back }) {
    const id = `knob-${name.replace(/[^A-Za-z0-9_.-]/g, "_")}-${this.rows.size}`;
    const range = element("input", { type: "range", id: `${id}-range`, min: String(slider.min), max: String(slider.max),
      step: String(slider.step), "aria-label": `${label}, slider` });
    const field = element("input", { type: "text", id, spellcheck: "false", autocomplete: "off" });
    const reset = element("button", { type: "button", "aria-label": `Reset ${label}`, title: "as in the scene" }, "↺");
    const wrong = element("p", { class: "wrong", id: `${id}-wrong`, hidden: "" });
    place.append(element("div", { class: kind, "data-knob": name },
      element("label", { for: id, title: label }, label), field, reset, range, wrong));
    range.addEventListener("input", () => this.turn(slider.to(Number(range.value)), name));
    range.addEventListener("change", () => this.rest());
    /** @param {string | null} message */
    const tell = (message) => {
      wrong.hidden = message === null;
      wrong.textContent = message ?? "";
      if (message === null) field.removeAttribute("aria-invalid");
      else field.setAttribute("aria-invalid", "true");
      field.setAttribute("aria-describedby", message === null ? "" : wrong.id);
    };
    field.addEventListener("change", () => {
      const found = read(field.value);
      if (typeof found === "string") {
        tell(found);
        return;
      }
      tell(null);
      this.turn(found, `${name} typed`);
      this.rest();
    });
    reset.addEventListener("click", () => {
      tell(null);
      this.turn(back(), `${name} reset`);
      this.rest();
      this.show(this.now());
    });
    this.rows.set(name, {
      wrong: tell,
      show: (turn) => {
        range.value = String(slider.of(turn));
        if (document.activeElement !== field || field.getAttribute("aria-invalid") !== "true") field.value = text(turn);
      },
    });
  }

  /**
   * A ring as the camera sees it: each LED is turned by dragging up and down, or by the arrow keys.
   * @param {HTMLElement} place
   * @param {string} ring
   * @param {number[]} members
   */
  addRing(place, ring, members) {
    const placed = members.filter((k) => this.described.sources[k].place !== null);
    if (placed.length < 3) return;
    const picture = drawing("svg", { class: "ring", viewBox: "-1.3 -1.3 2.6 2.6", role: "group", "aria-label": `Ring ${ring}` });
    const size = Math.min(0.2, 2.4 / placed.length + 0.02);
    for (const k of placed) {
      const { name, place: at } = this.described.sources[k];
      const [x, y] = /** @type {[number, number]} */ (at);
      const disc = drawing("circle", { cx: String(x), cy: String(y), r: String(size) });
      const number = drawing("text", { x: String(x), y: String(y) });
      const told = drawing("title", {});
      told.textContent = `${name}: drag up and down; a click turns it off and on`;
      const knob = /** @type {SVGGElement} */ (drawing("g", { tabindex: "0", role: "slider", "aria-label": name,
        "aria-valuemin": "0", "aria-valuemax": String(MOST) }, told, disc, number));
      /** @param {number} level */
      const set = (level) => this.turn(withLevels(this.now(), [k], Math.max(0, Math.round(level * 100) / 100)), `ring ${name}`);
      knob.addEventListener("keydown", (event) => {
        const step = { ArrowUp: 0.05, ArrowRight: 0.05, ArrowDown: -0.05, ArrowLeft: -0.05, PageUp: 0.5, PageDown: -0.5 }[event.key];
        const level = this.now().levels[k];
        if (step !== undefined) set(level + step);
        else if (event.key === "Home") set(0);
        else if (event.key === "End") set(MOST);
        else if (event.key === "Enter" || event.key === " ") set(level === 0 ? 1 : 0);
        else return;
        event.preventDefault();
        this.rest();
      });
      knob.addEventListener("pointerdown", (event) => {
        const from = event.clientY, level = this.now().levels[k];
        let moved = false;
        knob.setPointerCapture(event.pointerId);
        /** @param {PointerEvent} move */
        const follow = (move) => {
          moved ||= Math.abs(move.clientY - from) > 3;
          if (moved) set(level + (from - move.clientY) / 100);
        };
        knob.addEventListener("pointermove", follow);
        knob.addEventListener("pointerup", () => {
          knob.removeEventListener("pointermove", follow);
          if (!moved) set(level === 0 ? 1 : 0);
          this.rest();
        }, { once: true });
      });
      picture.append(knob);
      this.rows.set(`ring:${name}`, {
        wrong: () => {},
        show: ({ levels }) => {
          const level = levels[k], share = Math.min(1, level / MOST);
          const shade = Math.round(40 + 215 * Math.sqrt(share));
          disc.setAttribute("fill", `rgb(${shade},${shade},${Math.round(shade * 0.75)})`);
          number.setAttribute("fill", shade > 130 ? "#000" : "#fff");
          number.textContent = placed.length <= 24 ? shortNumber(level, 2) : "";
          knob.setAttribute("aria-valuenow", String(level));
          knob.setAttribute("aria-valuetext", shortNumber(level));
        },
      });
    }
    place.append(picture);
  }
}

/**
 * @param {number[]} values
 * @param {number[]} which
 */
function mean(values, which) {
  return which.reduce((sum, k) => sum + values[k], 0) / which.length;
}
