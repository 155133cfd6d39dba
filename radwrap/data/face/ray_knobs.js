// Knobs that need rays: pose, opening, focus, targets. Each turn traces anew, coarse first; the newest one counts.

import { byId, element } from "./dom.js";

/** @typedef {import("./explorer.js").Explorer} Explorer */

/** Fields with the scene file's own keys and values. */
export class RayKnobs {
  /**
   * @param {Explorer} explorer
   * @param {Record<string, string>[]} [past] values of pictures before this one, with other rays
   */
  constructor(explorer, past = []) {
    this.explorer = explorer;
    this.past = past;
    this.kept = past; // what is past where the trace is stopped
    this.undoing = false;
    /** @type {Map<string, HTMLInputElement>} */
    this.fields = new Map();
    this.waits = false;
    this.asking = false;
    this.traces = false;
    this.refusal = element("p", { class: "wrong", role: "alert" });
    const rows = Object.entries(explorer.described.ray_knobs ?? {}).map(([key, value]) => this.row(key, value));
    const button = (/** @type {string} */ text, /** @type {string} */ title, /** @type {() => void} */ act) => {
      const made = element("button", { type: "button", title }, text);
      made.addEventListener("click", act);
      return made;
    };
    this.undo = button("Undo rays", "The values before", () => this.stepBack());
    this.reset = button("Reset rays", "As in the scene file", () => {
      this.fill(this.explorer.described.ray_knobs_of_file ?? {});
      void this.turned();
    });
    byId("rayknobs").replaceChildren(...rows, ...rows.length ? [element("p", {}, this.undo, " ", this.reset)] : [], this.refusal);
    this.offer();
  }

  /** Which buttons there is something for. */
  offer() {
    const { ray_knobs: now = {}, ray_knobs_of_file: file = {} } = this.explorer.described;
    this.undo.disabled = !this.past.length;
    this.reset.disabled = Object.entries(file).every(([key, value]) => now[key] === value);
  }

  /** @param {Record<string, string>} values */
  fill(values) {
    for (const [key, field] of this.fields) field.value = values[key] ?? field.value;
  }

  stepBack() {
    const before = this.past.at(-1);
    if (!before) return;
    this.fill(before);
    this.undoing = true;
    void this.turned();
  }

  /** @param {string} key @param {string} value */
  row(key, value) {
    const id = `ray-${this.fields.size}`;
    const field = element("input", { type: "text", id, spellcheck: "false", autocomplete: "off" });
    field.value = value;
    field.addEventListener("change", () => { void this.turned(); });
    this.fields.set(key, field);
    return element("div", { class: "knob ray", "data-knob": `ray:${key}` }, element("label", { for: id, title: key }, key), field);
  }

  /** Trace with the values as they stand: one request at a time, and after it the newest. */
  async turned() {
    this.waits = true;
    if (this.asking) return;
    this.asking = true;
    while (this.waits) {
      this.waits = false;
      await this.ask();
    }
    this.asking = false;
  }

  /** The trace was stopped, or failed: the values are again those of the picture. */
  back() {
    if (!this.traces) return;
    this.traces = false;
    this.past = this.kept;
    this.fill(this.explorer.described.ray_knobs ?? {});
    this.offer();
  }

  async ask() {
    const { explorer } = this;
    const rays = Object.fromEntries([...this.fields].map(([key, field]) => [key, field.value]));
    try {
      await explorer.source.ask("trace", { basis: explorer.described.basis, rays });
      if (!this.traces) this.kept = this.past;
      const now = explorer.described.ray_knobs ?? {};
      const same = Object.entries(rays).every(([key, value]) => now[key] === value);
      this.past = same ? this.kept : this.undoing ? this.kept.slice(0, -1) : [...this.kept, now];
      this.undoing = false;
      this.traces = !same;
      this.offer();
      this.refusal.textContent = "";
      for (const field of this.fields.values()) field.removeAttribute("aria-invalid");
    } catch (error) {
      const { where, message } = /** @type {any} */ (error);
      if (where === "basis") return; // another one has come, with fields of its own
      this.refusal.textContent = message;
      for (const [key, field] of this.fields) field.setAttribute("aria-invalid", String(Boolean(where?.includes(key))));
    }
  }
}
