// What matters to the picture: causes of its deviation, effects that are measured in its light, advice, a study's results.

import { byId, element, tableOf } from "./dom.js";
import { errorText, shortNumber, timeText } from "./units.js";

/** @typedef {import("./explorer.js").Explorer} Explorer */
/** @typedef {import("./types.js").Matters} Matters */
/** @typedef {import("./types.js").Study} Study */

const FEW = 1e-3; // gray levels, less than which is none

/** @param {string} name */
const words = (name) => name.replaceAll("_", " ");

/**
 * Rows of the effects, the largest first: name, what it is worth, its bound, whether the tolerance needs it, what would be without.
 * @param {Matters["effects"]} effects
 */
export function effectRows(effects) {
  return [...effects].sort((a, b) => (b.rms_gray_upper95 ?? Infinity) - (a.rms_gray_upper95 ?? Infinity))
    .map(({ name, rms_gray: rms, rms_gray_upper95: bound, needed, left_out: what }) => [words(name),
      rms !== null && rms < FEW ? "< 0.001" : errorText(rms), bound !== null && bound < FEW ? "< 0.001" : errorText(bound),
      needed ? "yes" : "no", what]);
}

/** What is advised, in sentences. @param {Matters} found */
export function adviceOf({ advice, method, why, best_opening: best, eight_bits: eight, exposure_time: own, effects_exposure_time: taken }) {
  const said = [`exposure: ${advice}`, `a picture of this tolerance is traced by the method ${method}: ${why}`];
  if (taken !== own) said.unshift(`measured at an exposure of ${timeText(taken)}, as the picture saturates`);
  if (best) said.push(`round opening for the depths in sight: ${shortNumber(1e3 * best.steepest_diameter, 3)} mm has the steepest edges`);
  if (eight) said.push(`8 bits ${eight.enough ? "are enough" : "are too few"} for the noise of one frame on ${eight.target}`);
  return said;
}

/** What matters, once it is asked for. */
export class Mattering {
  /** @param {Explorer} explorer @param {AbortSignal} signal */
  constructor(explorer, signal) {
    this.explorer = explorer;
    this.asked = 0;
    byId("mattering").replaceChildren();
    byId("matteringof").textContent = "";
    byId("matters", HTMLButtonElement).disabled = Boolean(explorer.described.coarse);
    byId("matters").addEventListener("click", () => { void this.measure(); }, { signal });
    byId("study").replaceChildren(...studyOf(explorer.described.study ?? null));
  }

  /** The knobs have moved: what is told is of the turn before. */
  turned() {
    this.asked++;
    const there = byId("mattering").children.length > 0;
    byId("matteringof").textContent = there ? "of the knobs before they were turned" : "";
    byId("mattering").classList.toggle("stale", there);
  }

  /** By rays, for the knobs as they stand. */
  async measure() {
    const { explorer } = this;
    const asked = ++this.asked;
    byId("matteringof").textContent = "measuring";
    try {
      const told = { basis: explorer.described.basis, turn: explorer.history.now };
      const found = await (await explorer.source.ask("matters", told, explorer.leave.signal)).json();
      if (asked === this.asked) this.show(found);
    } catch (error) {
      if (asked !== this.asked || explorer.leave.signal.aborted) return;
      byId("matteringof").textContent = error instanceof Error ? error.message : String(error);
    }
  }

  /** @param {Matters} found */
  show(found) {
    const parts = Object.entries(found.parts).map(([name, rms]) => [words(name), errorText(rms)]);
    byId("mattering").classList.remove("stale");
    byId("mattering").replaceChildren(
      tableOf("Parts of the deviation, over the picture", ["part of σ, over all pixels", "gray rms"], parts),
      wide(tableOf("Effects", ["effect", "gray rms", "at most (95 %)", "needed", "without it"], effectRows(found.effects)), "Effects"),
      ...adviceOf(found).map((text) => element("p", { class: "note" }, text)));
    byId("matteringof").textContent = `measured anew for the picture as it is shown; needed: at the tolerance ${shortNumber(found.tolerance)}`;
  }
}

/** A table that may be wider than its place. @param {HTMLElement} table @param {string} label */
function wide(table, label) {
  return element("div", { class: "table", tabindex: "0", role: "region", "aria-label": label }, table);
}

/** @param {Study | null} study */
function studyOf(study) {
  if (!study) return [];
  return [element("h3", {}, `Study: ${study.title}`), ...study.responses.flatMap(({ response, runs, margin, effects, sentences }) => {
    const rows = effects.map(({ label, name, effect, image_error: error, significant, from, to }) =>
      [label === name ? name : `${label} (${name})`, `${shortNumber(effect, 4)}${significant ? " *" : ""}`, shortNumber(error, 2),
        from !== null && to !== null ? `${from} to ${to}` : ""]);
    const limit = margin === null ? [] : [element("p", { class: "note" }, `* exceeds ${shortNumber(margin, 3)}, which chance by itself would reach`)];
    return [element("h4", {}, `${response}${runs ? `, ${runs} runs` : ""}`), ...sentences.map((text) => element("p", { class: "note" }, text)),
      ...rows.length ? [wide(tableOf(`Effects on ${response}`, ["factor", "effect", "± by images", "levels"], rows), `Effects on ${response}`), ...limit] : []];
  })];
}
