// What accuracy costs on this scene: every method with several settings, measured by the server in the light of the knobs.

import { byId, element, tableOf } from "./dom.js";
import { TradePlot } from "./plots.js";
import { errorText, shortNumber, timeText } from "./units.js";

/** @typedef {import("./explorer.js").Explorer} Explorer */
/** @typedef {import("./types.js").TradeFound} TradeFound */
/** @typedef {import("./types.js").TradeProgress} TradeProgress */

/**
 * Rows of the settings, the fastest first: what it is, rays, time, error, its bound, whether no other is better.
 * @param {TradeFound["settings"]} settings
 */
export function settingRows(settings) {
  return [...settings].sort((a, b) => a.wall_s - b.wall_s)
    .map(({ options, rays, wall_s: seconds, rms_gray: rms, rms_gray_upper: bound, front }) =>
      [options.replaceAll("--", ""), shortNumber(rays, 3), timeText(Number(seconds.toPrecision(3))), errorText(rms), errorText(bound), front ? "yes" : "no"]);
}

/** How far it is, in words that change seldom enough to be read out. @param {TradeProgress} progress */
export function progressText({ what, done, of }) {
  if (what !== "settings") return "measuring: rays to compare with";
  return `measuring: ${Math.min(done, of)} of ${of} settings`;
}

/** The trade, once it is asked for. */
export class Trading {
  /** @param {Explorer} explorer @param {AbortSignal} signal */
  constructor(explorer, signal) {
    this.explorer = explorer;
    /** @type {AbortController | null} */
    this.job = null;
    this.button = byId("trade-begin", HTMLButtonElement);
    this.stop = byId("trade-stop", HTMLButtonElement);
    this.bar = byId("trade-progress", HTMLProgressElement);
    this.status = byId("tradeof");
    this.place = byId("traded");
    this.longest = byId("trade-longest", HTMLInputElement);
    this.plot = new TradePlot(byId("tradeplot"));
    this.place.hidden = true;
    this.say("");
    this.rest();
    this.button.addEventListener("click", () => { void this.measure(); }, { signal });
    this.stop.addEventListener("click", () => this.job?.abort(), { signal });
    signal.addEventListener("abort", () => this.job?.abort());
  }

  /** @param {string} text */
  say(text) {
    if (this.status.textContent !== text) this.status.textContent = text;
  }

  /** Nothing is measured. */
  rest() {
    this.button.disabled = Boolean(this.explorer.described.coarse);
    this.stop.hidden = this.bar.hidden = true;
  }

  /** The knobs have moved: what is told is of the turn before. */
  turned() {
    if (this.place.hidden || this.job) return;
    this.say("of the knobs before they were turned");
    this.place.classList.add("stale");
  }

  /** By rays, for the knobs as they stand. */
  async measure() {
    const { explorer } = this;
    const job = this.job = new AbortController();
    const of = explorer.history.now;
    const held = document.activeElement === this.button;
    this.button.disabled = true;
    this.stop.hidden = this.bar.hidden = false;
    if (held) this.stop.focus(); // a button that is disabled loses the focus
    this.bar.removeAttribute("value");
    this.longest.removeAttribute("aria-invalid");
    this.say("measuring");
    try {
      const told = { basis: explorer.described.basis, turn: of, longest: this.longest.value };
      const found = await explorer.source.told("trade", told, job.signal, (/** @type {TradeProgress} */ progress) => {
        this.say(progressText(progress));
        this.bar.value = progress.done / Math.max(progress.of, 1);
      });
      this.show(found);
      if (explorer.history.now !== of) this.turned();
    } catch (error) {
      if (explorer.leave.signal.aborted) return;
      const { where, message } = /** @type {any} */ (error);
      if (where === "longest") this.longest.setAttribute("aria-invalid", "true");
      this.say(job.signal.aborted ? "stopped; the next one goes on with what is finished" : message);
    } finally {
      if (!explorer.leave.signal.aborted) {
        const held = document.activeElement === this.stop;
        this.rest();
        if (held) this.button.focus();
        this.job = null;
      }
    }
  }

  /** @param {TradeFound} found */
  show(found) {
    this.place.hidden = false;
    this.place.classList.remove("stale");
    const head = ["setting of radwrap render", "rays", "time", "gray rms", "at most (97.5 %)", "none better"];
    byId("tradetable").replaceChildren(tableOf("What accuracy costs", head, settingRows(found.settings)));
    const left = found.left_out.map(({ options, why }) => `left out: ${options.replaceAll("--", "")}: ${why}`);
    byId("tradenotes").replaceChildren(...[found.recommendation.replaceAll("--", ""), ...left,
      "None better: no other setting is both as fast and more exact. Errors are against rays, which know no waves."]
      .map((text) => element("p", { class: "note" }, text)));
    this.plot.show(found.settings);
    this.say(`measured for the picture as it is shown, at the tolerance ${shortNumber(found.tolerance)}`);
    this.job = null;
  }
}
