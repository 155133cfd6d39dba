// A photo of the real scene: it becomes A, and what it differs by is held against what is expected.

import { byId, element, tableOf } from "./dom.js";
import { errorText, percent, shortNumber } from "./units.js";

/** @typedef {import("./explorer.js").Explorer} Explorer */
/** @typedef {import("./types.js").KeptPicture} KeptPicture */
/** @typedef {import("./types.js").PhotoFound} PhotoFound */

const LARGEST = 256 * 2 ** 20; // byte

/**
 * A photo as a picture that is kept: its gray levels stand for light, and each whole number begins half below itself.
 * @param {{number: number, name: string, values: Float32Array, bits: number, rows: number, columns: number,
 *   sensor: import("./types.js").Sensor}} photo
 * @returns {KeptPicture}
 */
export function pictureOf({ number, name, values, bits, rows, columns, sensor }) {
  const full = 2 ** bits - 1;
  return {
    rows, columns, basis: -1, turn: { levels: [], knobs: {} }, exposure: values, sigma: new Float32Array(values.length),
    thresholds: { first: 0, values: Float32Array.from({ length: full }, (_, k) => k + 0.5), saturated: sensor.saturation_gray,
      lit: sensor.dark_gray + 0.5 },
    told: { error: { rms_gray: null, rms_gray_upper95: null, method: "photo" }, keeps: true, saturated_fraction: 0,
      gray: { min: 0, max: full, mean: 0 }, sigma_rms: 0, exposure_of_radiance: 1, command: "",
      sensor: { gain: 1, gamma: 1, dark_gray: 0, saturation_gray: full, bit_depth: bits, rounding: true },
      thresholds: { first: 0, count: full, saturated: null, lit: null } },
    photo: { number, name },
  };
}

/** What explains most of a difference, in words. @param {PhotoFound["causes"]} causes */
export function causeText(causes) {
  if (!causes) return "hardly more than is expected: no cause is looked for";
  const { mainly, as_is: all, dark_level: dark, exposure, exposure_factor: factor, geometry, shift } = causes;
  const left = (/** @type {number} */ rms) => `${shortNumber(rms, 3)} gray rms of ${shortNumber(all, 3)} stay`;
  if (mainly === "dark level") return `mainly the dark level: with another one ${left(dark)}`;
  if (mainly === "exposure") return `mainly light or exposure: ${shortNumber(factor ?? 1, 3)} times as bright above dark, and ${left(exposure)}`;
  if (mainly === "geometry" && shift) return `mainly the place: moved by ${shift.map((by) => by.toFixed(2)).join(", ")} px, and ${left(geometry ?? all)}`;
  return "neither dark level, nor exposure, nor a shift explains much of it by itself";
}

/** The file, and what was found. */
export class PhotoComparison {
  /** @param {Explorer} explorer @param {AbortSignal} signal */
  constructor(explorer, signal) {
    this.explorer = explorer;
    this.asked = 0;
    this.notes = /** @type {string[]} */ ([]);
    const file = byId("photo", HTMLInputElement);
    file.disabled = Boolean(explorer.described.coarse);
    file.addEventListener("change", () => { void this.open(file.files?.[0] ?? null); file.value = ""; }, { signal });
    byId("compare").addEventListener("click", () => { void this.compare(); }, { signal });
    byId("photofound").replaceChildren();
    byId("photoof").textContent = explorer.comparison.a?.photo ? `A is the photo ${explorer.comparison.a.photo.name}` : "";
    this.offer();
  }

  /** Compare only what is there. */
  offer() {
    byId("compare", HTMLButtonElement).disabled = !this.explorer.comparison.a?.photo || Boolean(this.explorer.described.coarse);
  }

  /** The knobs have moved: what is told is of the turn before. */
  turned() {
    this.asked++;
    const { children } = byId("photofound");
    if (children.length === 0) return;
    byId("photoof").textContent = "of the knobs before they were turned";
    byId("photofound").classList.add("stale");
  }

  /** @param {File | null} file */
  async open(file) {
    if (!file) return;
    const { explorer } = this;
    const asked = ++this.asked;
    byId("photoof").textContent = `reading ${file.name}`;
    try {
      if (file.size > LARGEST) throw new Error(`photo: ${file.name} has more than ${LARGEST / 2 ** 20} MiB`);
      const told = { basis: explorer.described.basis, turn: explorer.history.now };
      const found = await explorer.source.photo(told, file, explorer.leave.signal);
      if (asked !== this.asked) return;
      const { rows, columns } = explorer.described;
      this.notes = found.told.notes;
      explorer.comparison.hold(pictureOf({ number: found.told.photo, name: file.name, values: found.values,
        bits: found.told.bit_depth, rows, columns, sensor: explorer.sensor }));
      byId("photoof").textContent = `A is the photo ${file.name}`;
      this.offer();
      await this.compare();
    } catch (error) {
      if (explorer.leave.signal.aborted) return;
      byId("photoof").textContent = error instanceof Error ? error.message : String(error);
    }
  }

  /** Ask the server, for the knobs as they stand. */
  async compare() {
    const { explorer } = this;
    const photo = explorer.comparison.a?.photo;
    if (!photo) return;
    const asked = ++this.asked;
    byId("photoof").textContent = `comparing with the photo ${photo.name}`;
    try {
      const told = { basis: explorer.described.basis, turn: explorer.history.now, photo: photo.number };
      const found = await (await explorer.source.ask("compare", told, explorer.leave.signal)).json();
      if (asked === this.asked) this.show(found, photo.name);
    } catch (error) {
      if (asked !== this.asked || explorer.leave.signal.aborted) return;
      byId("photoof").textContent = error instanceof Error ? error.message : String(error);
    }
  }

  /** @param {PhotoFound} found @param {string} name */
  show(found, name) {
    const { column, row, photo, picture } = found.worst;
    const rows = [["mean", `${shortNumber(found.mean, 3)} gray`], ["rms", `${errorText(found.rms)} gray`],
      ["rms that is expected", `${errorText(found.expected_rms)} gray`],
      ["pixels beyond 1.96 σ", `${percent(found.beyond)} (5 % by chance)`],
      ["most, at column, row", `${shortNumber(photo - picture, 3)} gray, at ${column}, ${row}`]];
    const notes = [causeText(found.causes), ...found.notes].map((text) => element("p", { class: "note" }, text));
    byId("photofound").classList.remove("stale");
    byId("photofound").replaceChildren(tableOf("Photo less picture", ["photo − picture", ""], rows), ...notes);
    byId("photoof").textContent = `the photo ${name} less the picture as it is shown`;
  }
}
