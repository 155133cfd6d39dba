// Knobs that need rays: pose, opening, focus, targets. Each turn traces anew, coarse first; the newest one counts.

import { byId, element } from "./dom.js";

/** @typedef {import("./explorer.js").Explorer} Explorer */

/** Fields with the scene file's own keys and values. */
export class RayKnobs {
  /** @param {Explorer} explorer */
  constructor(explorer) {
    this.explorer = explorer;
    /** @type {Map<string, HTMLInputElement>} */
    this.fields = new Map();
    this.waits = false;
    this.asking = false;
    this.traces = false;
    this.refusal = element("p", { class: "wrong", role: "alert" });
    const rows = Object.entries(explorer.described.ray_knobs ?? {}).map(([key, value]) => this.row(key, value));
    byId("rayknobs").replaceChildren(...rows, this.refusal);
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
    for (const [key, field] of this.fields) field.value = this.explorer.described.ray_knobs?.[key] ?? "";
  }

  async ask() {
    const { explorer } = this;
    const rays = Object.fromEntries([...this.fields].map(([key, field]) => [key, field.value]));
    try {
      await explorer.source.ask("trace", { basis: explorer.described.basis, rays });
      this.traces = true;
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
