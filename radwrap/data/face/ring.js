// The real LED ring: lit as the knobs stand while this tab's heart beats, and dark in all other cases.

import { byId } from "./dom.js";
import { shortNumber } from "./units.js";

/** @typedef {import("./explorer.js").Explorer} Explorer */

const BEAT = 500; // ms; the server turns the ring off where it hears none for 1.4 s

/** One button, and what the ring holds. */
export class RingControl {
  /** @param {Explorer} explorer @param {AbortSignal} signal */
  constructor(explorer, signal) {
    this.explorer = explorer;
    this.tab = Array.from(crypto.getRandomValues(new Uint8Array(16)), (octet) => octet.toString(16).padStart(2, "0")).join("");
    this.held = false;
    /** @type {number | undefined} */
    this.timer = undefined;
    const told = explorer.described.ring;
    byId("ring").hidden = !told;
    if (!told) return;
    const { emulated, count, wavelength, max_on_time: longest } = told;
    byId("ringis").textContent = `${count} LEDs${wavelength ? ` of ${shortNumber(1e9 * wavelength, 4)} nm` : ""}`
      + `${longest ? `, off ${shortNumber(longest)} s after the last turn` : ""}${emulated ? "; emulated, no light shines" : ""}`;
    byId("ringlight", HTMLButtonElement).disabled = Boolean(explorer.described.coarse);
    this.say("The ring is off.");
    byId("ringlight").addEventListener("click", () => { void (this.held ? this.dark() : this.light()); }, { signal });
    addEventListener("pagehide", () => { void this.dark(); }, { signal });
    signal.addEventListener("abort", () => { void this.dark(); }); // another basis has other lights
  }

  /** @param {string} text */
  say(text) {
    byId("ringlight").textContent = this.held ? "Turn the ring off" : "Light the ring as the knobs stand";
    byId("ringlight").ariaPressed = String(this.held);
    byId("ringsays").textContent = text;
  }

  /** @param {"light" | "beat" | "dark"} what @param {object} [more] */
  ask(what, more = {}) {
    return this.explorer.source.ask("ring", { do: what, tab: this.tab, ...more });
  }

  /** The knobs have moved. */
  turned() {
    if (this.held) this.say("The ring follows when the knob rests.");
  }

  /** The turn is measured: the ring follows. */
  follow() {
    if (this.held) void this.light();
  }

  async light() {
    const { described: { basis }, history } = this.explorer;
    try {
      const { held, verified, note } = await (await this.ask("light", { basis, turn: history.now })).json();
      this.held = true;
      clearInterval(this.timer);
      this.timer = setInterval(() => { void this.beat(); }, BEAT);
      this.say(`The ring shines as the knobs stand, at levels from ${shortNumber(Math.min(...held), 3)} to ${shortNumber(Math.max(...held), 3)}, `
        + `${verified ? "as it says itself" : "as it was told"}${note ? `; ${note}` : ""}.`);
    } catch (error) {
      const message = error instanceof Error ? error.message : String(error);
      this.say(this.held ? `The ring shines as before: ${message}` : message);
    }
  }

  async beat() {
    try {
      const { held, why } = await (await this.ask("beat")).json();
      if (!held && this.held) this.lost(why);
    } catch {
      if (this.held) this.lost("The server does not answer, and its guardian turns the ring off.");
    }
  }

  /** @param {string} why */
  lost(why) {
    this.held = false;
    clearInterval(this.timer);
    this.say(`The ring is off: ${why}`);
  }

  async dark() {
    const was = this.held;
    this.held = false;
    clearInterval(this.timer);
    if (!was) return;
    try {
      await this.ask("dark");
      this.say("The ring is off.");
    } catch {
      this.say("The server did not answer; without heartbeats the ring is off within 2 s.");
    }
  }
}
