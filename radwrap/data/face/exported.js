// The page without a server: what it shows was measured when it was made, and it says so once a knob is turned.

import { byId } from "./dom.js";
import { Explorer } from "./explorer.js";

/** @typedef {import("./types.js").Turn} Turn */

const CANNOT = "This page has no server. It mixes light, exposure and sensor by itself, to one code in ten thousand pixels; "
  + "the error is that of the scene's own levels, and is not measured for others. It cannot trace, save, compare, measure, or give gray.png "
  + "and scene.toml: radwrap face does.";

/** @param {string} text */
function numbers(text) {
  return new Float32Array(Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer);
}

/** What the file holds, in the words of a server. */
class Exported {
  /** @param {any} data */
  constructor(data) {
    this.data = data;
    this.live = false;
    const text = byId("worker").textContent ?? "";
    this.script = URL.createObjectURL(new Blob([text], { type: "text/javascript" }));
  }

  makeWorker() {
    return new Worker(this.script);
  }

  /** @param {number} _ @param {(plane: import("./types.js").Plane) => void} take */
  async planes(_, take) {
    for (const plane of this.data.planes) take({ high: numbers(plane), low: null, unit: 0 });
  }

  /** @param {number} _ @param {Turn} turn */
  async turn(_, turn) {
    if (turn.levels.some((level) => level !== 1) || Object.keys(turn.knobs).length > 0) return null;
    const { told, values, exposure, sigma } = this.data;
    const { first, saturated, lit } = told.thresholds;
    return {
      told, exposure: numbers(exposure), sigma: numbers(sigma),
      thresholds: { first, values: numbers(values), saturated: saturated ?? Infinity, lit: lit ?? Infinity },
    };
  }
}

const held = JSON.parse(byId("data").textContent ?? "{}");
const chip = byId("state");
const page = new Explorer(new Exported(held), held.described, {
  state: (text, kind = "") => {
    chip.textContent = text;
    chip.className = `chip ${kind}`;
  },
  banner: (text) => {
    byId("banner").hidden = text === null;
    byId("banner").textContent = text ?? "";
  },
});
for (const id of ["png", "toml", "comparing", "measurement", "photos", "whatmatters", "layout", "needsrays"]) byId(id).hidden = true;
const { binned } = held.described;
const coarse = binned > 1 ? ` ${binned} × ${binned} pixels are one here: codes are those of their mean light.` : "";
byId("cannot").textContent = CANNOT + coarse;
byId("rays").textContent = `${CANNOT}${coarse} ${byId("rays").textContent}`;
void page.load();
