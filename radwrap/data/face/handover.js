// What a picture leaves to the one that takes its place, of finer or coarser pixels, or with other rays: knobs, probe, lines, view, focus.

import { byId, focusedKnob, focusKnob } from "./dom.js";

/** @typedef {import("./explorer.js").Explorer} Explorer */
/** @typedef {import("./types.js").Kept} Kept */

/**
 * What of a picture goes on in the next one; null where that is another scene, or nothing was there.
 * @param {Explorer | null} before
 * @param {import("./types.js").Described} next
 * @returns {Kept | null}
 */
export function keptOf(before, next) {
  if (!before) return null;
  const { basis, coarse, sources } = before.described;
  if (next.replaces !== basis || sources.length !== next.sources.length) return null;
  const block = (coarse || 1) / (next.coarse || 1);
  const { view, readings: { pin, line, region } } = before;
  /** @param {number} place @param {number} most */
  const middle = (place, most) => Math.min(most - 1, Math.floor((place + 0.5) * block));
  /** @param {number[]} ends */
  const scaled = (ends) => ends.map((place, k) => middle(place, k % 2 ? next.rows : next.columns));
  const [low, high] = before.window;
  const full = low === 0 && high === 2 ** before.sensor.bit_depth - 1;
  return {
    history: before.history, focus: focusedKnob(), rays: before.rayKnobs.past,
    pin: pin && { u: middle(pin.u, next.columns), v: middle(pin.v, next.rows) },
    line: line && scaled(line), region: region && scaled(region), window: full ? null : [low, high],
    sight: view.fitted ? null : { x: view.x * block, y: view.y * block, size: view.size / block },
  };
}

/** @param {Explorer} explorer @param {Kept} kept */
export function take(explorer, { pin, line, region, window, sight, focus }) {
  Object.assign(explorer.readings, { pin, line, region });
  if (focus) focusKnob(focus);
  if (window) {
    for (const [k, id] of ["low", "high"].entries()) byId(id, HTMLInputElement).value = String(window[k]);
  }
  if (sight) explorer.view.see(sight);
}
