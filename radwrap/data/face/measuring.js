// What an algorithm reads from the picture: dots, an edge, parts, each with its certified error.

import { byId, element, tableOf } from "./dom.js";
import { shortNumber } from "./units.js";

/** @typedef {import("./explorer.js").Explorer} Explorer */
/** @typedef {import("./types.js").Measured} Measured */

/** The numbers, and of which knobs they are. */
export class Measurement {
  /** @param {Explorer} explorer @param {AbortSignal} signal */
  constructor(explorer, signal) {
    this.explorer = explorer;
    this.asked = 0;
    byId("measured").replaceChildren();
    byId("measuredof").textContent = "";
    byId("measure", HTMLButtonElement).disabled = Boolean(explorer.described.coarse);
    byId("measure").addEventListener("click", () => { void this.measure(); }, { signal });
  }

  /** The knobs have moved: what is told is of the turn before. */
  turned() {
    this.asked++;
    const { children } = byId("measured");
    byId("measuredof").textContent = children.length > 0 ? "of the knobs before they were turned" : "";
    byId("measured").classList.toggle("stale", children.length > 0);
  }

  /** Ask the server, for the knobs as they stand. */
  async measure() {
    const { explorer } = this;
    const asked = ++this.asked;
    byId("measuredof").textContent = "measuring";
    try {
      const told = { basis: explorer.described.basis, turn: explorer.history.now };
      const { measured } = await (await explorer.source.ask("measure", told, explorer.leave.signal)).json();
      if (asked === this.asked) this.show(measured);
    } catch (error) {
      if (asked !== this.asked || explorer.leave.signal.aborted) return;
      byId("measuredof").textContent = error instanceof Error ? error.message : String(error);
    }
  }

  /** @param {Measured[]} measured */
  show(measured) {
    const rows = measured.map(({ name, unit, value, error }) => [name.replaceAll("_", " "),
      value === null || error === null ? "not found" : `${shortNumber(value, 5)} ± ${shortNumber(error, 2)}${unit && ` ${unit}`}`]);
    const notes = measured.flatMap(({ name, notes: all }) => all.map((text) =>
      element("p", { class: "note" }, `${name.replaceAll("_", " ")}: ${text}`)));
    byId("measured").classList.remove("stale");
    byId("measured").replaceChildren(tableOf("Measurement", ["", "± 1 σ"], rows), ...notes);
    byId("measuredof").textContent = "of the picture as it is shown";
  }
}
