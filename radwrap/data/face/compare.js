// Two pictures beside each other: A, which is kept, and B, which the knobs make.

import { byId, element, numberOf } from "./dom.js";
import { SURE } from "./difference.js";
import { grayOf, rankOf } from "./response.js";
import { errorText, percent, shortNumber } from "./units.js";

/** @typedef {import("./explorer.js").Explorer} Explorer */
/** @typedef {import("./types.js").KeptPicture} KeptPicture */
/** @typedef {"b" | "a" | "blink" | "wipe" | "difference"} Mode */

const BLINK = 700; // ms a side: far from the three flashes a second that may harm

/** What is kept, and how it is shown. */
export class Comparison {
  /** @param {Explorer} explorer @param {KeptPicture | null} a of a basis before @param {AbortSignal} signal */
  constructor(explorer, a, signal) {
    this.explorer = explorer;
    const { rows, columns, coarse } = explorer.described;
    this.held = a; // a coarse picture hands it on
    /** @type {KeptPicture | null} */
    this.a = a && !coarse && a.rows === rows && a.columns === columns ? a : null;
    /** @type {Mode} */
    this.mode = "b";
    /** @type {"a" | "b"} what is seen while it blinks */
    this.front = "b";
    /** @type {number | undefined} */
    this.blinking = undefined;
    signal.addEventListener("abort", () => clearInterval(this.blinking));
    this.listen(signal);
    this.share();
    this.choose("b");
  }

  /** @param {AbortSignal} signal */
  listen(signal) {
    byId("keepa").addEventListener("click", () => this.keep(), { signal });
    byId("toa").addEventListener("click", () => { if (this.a) this.explorer.turn(this.a.turn, "to A"); }, { signal });
    for (const radio of this.radios) radio.addEventListener("change", () => this.choose(/** @type {Mode} */ (radio.value)), { signal });
    for (const id of ["curtain", "range"]) byId(id).addEventListener("input", () => this.explorer.draw(), { signal });
  }

  /** @returns {HTMLInputElement[]} */
  get radios() {
    return [...document.querySelectorAll("input[name=side]")].filter((one) => one instanceof HTMLInputElement);
  }

  /** Keep the present picture as A. */
  keep() {
    const { certified, described: { rows, columns, basis, coarse }, history } = this.explorer;
    if (!certified || coarse) return;
    const { exposure, sigma, thresholds, told } = certified;
    this.hold({ rows, columns, basis, turn: history.now, exposure, sigma, thresholds, told });
    this.explorer.photo.offer();
  }

  /** @param {KeptPicture} a kept, or a photo */
  hold(a) {
    this.a = a;
    this.held = a;
    this.share();
    this.explorer.draw();
  }

  /** What the workers need for it. */
  share() {
    this.explorer.field.keep(this.a);
    this.refresh();
  }

  /** @param {Mode} mode */
  choose(mode) {
    this.mode = this.a ? mode : "b";
    this.front = "b";
    clearInterval(this.blinking);
    if (this.mode === "blink") {
      this.blinking = setInterval(() => {
        this.front = this.front === "a" ? "b" : "a";
        this.explorer.draw();
      }, BLINK);
    }
    this.refresh();
    this.explorer.draw();
  }

  /** The other one of A and B. */
  flip() {
    this.choose(this.mode === "a" ? "b" : "a");
  }

  /** Which picture the workers are to draw. @returns {import("./types.js").Shown} */
  get shown() {
    if (this.mode === "blink") return this.front;
    return this.mode === "difference" && !(this.explorer.certified && this.alike) ? "b" : this.mode;
  }

  /** Codes of as many bits are comparable. */
  get alike() {
    return this.a?.told.sensor.bit_depth === this.explorer.sensor.bit_depth;
  }

  /** Gray levels at which a difference has the strongest colour. */
  get range() {
    return numberOf("range", (range) => range > 0);
  }

  /** Controls and words, as things stand. */
  refresh() {
    const { a, explorer } = this;
    const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    byId("keepa", HTMLButtonElement).disabled = !explorer.certified || Boolean(explorer.described.coarse);
    byId("toa", HTMLButtonElement).disabled = a?.basis !== explorer.described.basis;
    for (const radio of this.radios) {
      radio.checked = radio.value === this.mode;
      radio.disabled = radio.value !== "b" && (!a || (radio.value === "blink" && still));
    }
    byId("curtainlabel").hidden = this.mode !== "wipe";
    byId("rangelabel").hidden = this.mode !== "difference";
    this.tell(null);
  }

  /** Say what A is, and what the picture shows of both. @param {import("./types.js").Apart | null} apart */
  tell(apart) {
    const { a, explorer } = this;
    const said = [];
    if (a) {
      const { rms_gray: rms, rms_gray_upper95: bound } = a.told.error;
      said.push(a.photo ? `A: the photo ${a.photo.name}` : `A: error ${errorText(rms)} gray rms, below ${errorText(bound)} (95 %)`);
    }
    if (this.mode === "difference") {
      const pixels = explorer.described.rows * explorer.described.columns;
      if (!this.alike) said.push("A has other bits than B: no difference");
      else if (!explorer.certified) said.push("the difference follows when the knob rests");
      else if (apart) {
        said.push(`B − A: ${percent(apart.beyond / pixels)} of the pixels differ by more than ${SURE} σ, from `
          + `${apart.least.toFixed(2)} to ${apart.largest.toFixed(2)} gray, ${shortNumber(Math.sqrt(apart.squares / pixels), 3)} rms`);
      }
    }
    byId("compared").textContent = said.join("; ");
  }

  /** What is known of some pixels of A. @param {import("./view.js").Pixel[]} pixels @returns {import("./explorer.js").Value[]} */
  values(pixels) {
    const { a } = this;
    return a === null ? [] : pixels.map(({ u, v }) => {
      const exposure = a.exposure[v * a.columns + u];
      return { exposure, code: rankOf(exposure, a.thresholds), gray: grayOf(exposure, a.told.sensor), sigma: a.sigma[v * a.columns + u] };
    });
  }

  /** Codes of some pixels as they are shown. @param {import("./view.js").Pixel[]} pixels */
  async codes(pixels) {
    const { explorer: { view }, shown } = this;
    const before = this.values(pixels), now = await this.explorer.values(pixels);
    const edge = this.curtain * view.image.width;
    return now.map(({ code }, k) => {
      if (shown === "difference") return code - before[k].code;
      const first = shown === "a" || (shown === "wipe" && view.origin.x + (pixels[k].u + 0.5) * view.size < edge);
      return first ? before[k].code : code;
    });
  }

  /** Up to which share of the frame a wipe shows A. */
  get curtain() {
    return Number(byId("curtain", HTMLInputElement).value) / 100;
  }

  /** What the probe says of A. @param {import("./view.js").Pixel} pixel @param {import("./explorer.js").Value} value */
  probed(pixel, { gray, sigma }) {
    const [before] = this.values([pixel]);
    if (!before || before.sigma === null) return [];
    const lines = [this.a?.photo ? `photo: ${shortNumber(before.gray, 6)}`
      : `A: ${before.code}, gray ${before.gray.toFixed(2)} ± ${shortNumber(before.sigma, 2)}`];
    if (this.alike && sigma !== null) {
      const off = gray - before.gray, error = Math.hypot(sigma, before.sigma);
      lines.push(`B − A: ${off.toFixed(2)} ± ${shortNumber(error, 2)}${Math.abs(off) > SURE * error ? "" : ", may be error only"}`);
    }
    return lines.map((text) => element("div", { class: "beside" }, text));
  }
}
