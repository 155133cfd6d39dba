// The probe, the profile and the region: what is read off the picture, by pointer and by keys.

import { byId, download, element, tableOf } from "./dom.js";
import { draggedWindow, profileCsv, summary } from "./statistics.js";
import { exposureText, shortNumber } from "./units.js";

/** @typedef {import("./explorer.js").Explorer} Explorer */
/** @typedef {import("./view.js").Pixel} Pixel */

const SPEAK_EVERY = 800; // ms between words of the live region
const MOST_IN_REGION = 1 << 22; // pixels

/** What the user looks at. */
export class Readings {
  /** @param {Explorer} explorer @param {AbortSignal} signal */
  constructor(explorer, signal) {
    this.explorer = explorer;
    /** @type {Pixel | null} */
    this.pin = null;
    /** @type {Pixel | null} */
    this.hover = null;
    /** @type {number[] | null} */
    this.line = null;
    /** @type {number[] | null} */
    this.region = null;
    /** @type {import("./types.js").PixelTold | null} */
    this.told = null;
    this.spoken = 0;
    // What was read off the picture before may be of other pixels.
    byId("probe").replaceChildren();
    byId("csv", HTMLButtonElement).disabled = true;
    this.listen(signal);
  }

  get tool() {
    return document.querySelector("input[name=tool]:checked")?.getAttribute("value") ?? "probe";
  }

  /** Once the server has told of the turn: the parts of the pinned pixel's deviation are its own too. */
  async certify() {
    this.told = null;
    const { explorer, pin } = this;
    if (!pin || !explorer.certified) return;
    const { certified } = explorer;
    const told = await explorer.source.pixel?.(explorer.described.basis, explorer.history.now, pin);
    if (certified === explorer.certified && pin === this.pin && told) {
      this.told = told;
      explorer.layout.see(told.sees ?? null);
    }
    await this.showProbe();
  }

  async show() {
    const { explorer } = this;
    explorer.view.mark({ ...this, codes: await explorer.numbers() });
    await this.showProbe();
    if (this.line) {
      const before = await explorer.profileRows(this.line, (pixels) => explorer.comparison.values(pixels));
      explorer.profile.show(await explorer.profileRows(this.line), before);
    }
    byId("csv", HTMLButtonElement).disabled = this.line === null;
  }

  async showProbe() {
    const pixel = this.pin ?? this.hover;
    const place = byId("probe");
    const { explorer } = this;
    const parts = this.region ? [await this.regionTable(this.region)] : [];
    if (!pixel) {
      place.replaceChildren("Point at the picture, or press an arrow key in it.", ...parts);
      return;
    }
    const [value] = await explorer.values([pixel]);
    if (!value) return;
    const { u, v } = pixel;
    const told = this.pin ? this.told : null;
    const sigma = told?.sigma ?? value.sigma;
    const off = sigma === null ? "± measured at rest" : `± ${shortNumber(sigma, 2)}`;
    const gray = told?.gray ?? value.gray;
    const exposure = told?.radiant_exposure ?? value.exposure;
    const code = told?.code ?? value.code;
    const full = exposure >= explorer.thresholds.saturated ? ", saturated" : "";
    place.replaceChildren(
      element("div", {}, `column ${u}, row ${v}${this.pin ? ", pinned" : ""}`),
      element("div", { class: "code", "data-u": String(u), "data-v": String(v) }, String(code)),
      element("div", { class: "gray" }, `gray ${gray.toFixed(2)} ${off} (1 σ)${full}`),
      element("div", { class: "exposure", title: `${exposure} J/m²` }, `H ${exposureText(exposure)}`),
      ...(told?.sees ? [element("div", { class: "sees" }, `sees ${told.sees.target}, ${shortNumber(1e3 * told.sees.distance, 5)} mm away`)] : []),
      ...explorer.comparison.probed(pixel, { ...value, gray, sigma }),
      ...(told ? [tableOf("Parts of the deviation", ["part of σ", "gray"],
        Object.entries(told.parts).map(([name, part]) => [name.replaceAll("_", " "), shortNumber(part, 2)]))] : []),
      ...parts,
    );
    const now = Date.now();
    if (this.pin && document.activeElement === byId("picture") && now - this.spoken > SPEAK_EVERY) {
      this.spoken = now;
      byId("live").textContent = `column ${u}, row ${v}: ${code} ${off}${full}`;
    }
  }

  /** @param {number[]} region */
  async regionTable([u0, v0, u1, v1]) {
    const pixels = [];
    for (let v = v0; v <= v1; v++) for (let u = u0; u <= u1; u++) pixels.push({ u, v });
    const { explorer } = this;
    const values = await explorer.values(pixels);
    const { n, mean, deviation, min, max } = summary(values.map(({ code }) => code));
    const before = explorer.comparison.values(pixels);
    const beside = before.length > 0 ? [["mean of A", shortNumber(summary(before.map(({ code }) => code)).mean, 6)]] : [];
    return tableOf("Region", ["region of codes", ""], [["pixels", n], ["mean", shortNumber(mean, 6)],
      ["deviation", shortNumber(deviation, 4)], ["least", min], ["largest", max], ...beside]);
  }

  changed() {
    void this.show();
  }

  /** @param {Pixel | null} pixel */
  setPin(pixel) {
    this.pin = pixel;
    this.told = null;
    this.explorer.layout.see(null);
    if (pixel) this.explorer.view.reveal(pixel);
    this.changed();
    void this.certify();
  }

  /** @param {AbortSignal} signal */
  listen(signal) {
    const frame = byId("picture");
    const { view, described } = this.explorer;
    /** @type {{pixel: Pixel, x: number, y: number, moved: boolean, window: [number, number]} | null} */
    let drag = null;
    frame.addEventListener("pointerdown", (event) => {
      frame.focus();
      const pixel = view.pixelAt(event, true);
      if (!pixel || event.button > 1) return;
      frame.setPointerCapture(event.pointerId);
      drag = { pixel, x: event.clientX, y: event.clientY, moved: false, window: this.explorer.window };
      event.preventDefault();
    }, { signal });
    frame.addEventListener("pointermove", (event) => {
      this.hover = view.pixelAt(event);
      if (drag) {
        drag.moved ||= Math.hypot(event.clientX - drag.x, event.clientY - drag.y) > 3;
        if (drag.moved) this.dragged(drag, event);
      }
      this.changed();
    }, { signal });
    frame.addEventListener("pointerup", () => {
      if (drag && !drag.moved && this.tool !== "pan" && this.tool !== "window") {
        const again = this.pin && this.pin.u === drag.pixel.u && this.pin.v === drag.pixel.v;
        this.setPin(again ? null : drag.pixel);
      }
      drag = null;
    }, { signal });
    frame.addEventListener("pointerleave", () => {
      this.hover = null;
      this.changed();
    }, { signal });
    frame.addEventListener("wheel", (event) => {
      event.preventDefault();
      view.zoom(event.deltaY < 0 ? 1 : -1, view.pixelAt(event, true) ?? undefined);
    }, { signal, passive: false });
    frame.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey) return;
      if (this.pressed(event, described.columns, described.rows)) event.preventDefault();
    }, { signal });
    byId("csv").addEventListener("click", () => { void this.csv(); }, { signal });
  }

  /**
   * @param {{pixel: Pixel, x: number, y: number, window: [number, number]}} drag
   * @param {PointerEvent} event
   */
  dragged(drag, event) {
    const { view } = this.explorer;
    const end = view.pixelAt(event, true);
    if (!end) return;
    const { pixel: { u, v } } = drag;
    if (event.buttons === 4 || this.tool === "pan") {
      const dots = window.devicePixelRatio || 1;
      view.fitted = false;
      view.move(((drag.x - event.clientX) * dots) / view.size, ((drag.y - event.clientY) * dots) / view.size);
      drag.x = event.clientX;
      drag.y = event.clientY;
    } else if (this.tool === "window") {
      this.explorer.setWindow(draggedWindow(drag.window, event.clientX - drag.x, event.clientY - drag.y));
    } else if (this.tool === "profile") {
      const across = Math.abs(end.u - u) >= Math.abs(end.v - v);
      this.line = event.shiftKey ? [u, v, across ? end.u : u, across ? v : end.v] : [u, v, end.u, end.v];
    } else if (this.tool === "region") {
      const region = [Math.min(u, end.u), Math.min(v, end.v), Math.max(u, end.u), Math.max(v, end.v)];
      if ((region[2] - region[0] + 1) * (region[3] - region[1] + 1) <= MOST_IN_REGION) this.region = region;
    } else {
      this.pin = end;
      this.told = null;
      void this.certify();
    }
  }

  /**
   * @param {KeyboardEvent} event
   * @param {number} columns
   * @param {number} rows
   */
  pressed(event, columns, rows) {
    const { view } = this.explorer;
    const { comparison } = this.explorer;
    const step = event.shiftKey || event.altKey ? 10 : 1;
    const move = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    const from = this.pin ?? this.hover ?? { u: columns >> 1, v: rows >> 1 };
    if (move) {
      this.setPin({
        u: Math.min(columns - 1, Math.max(0, from.u + step * move[0])),
        v: Math.min(rows - 1, Math.max(0, from.v + step * move[1])),
      });
      return true;
    }
    /** @param {string} id */
    const toggle = (id) => byId(id).click();
    /** @param {string} tool */
    const choose = (tool) => /** @type {HTMLInputElement} */ (document.querySelector(`input[name=tool][value=${tool}]`)).click();
    /** @type {Record<string, () => void>} */
    const keys = {
      "+": () => view.zoom(1, from), "=": () => view.zoom(1, from), "-": () => view.zoom(-1, from),
      f: () => view.fit(), 1: () => view.zoomTo(1, 1, from),
      s: () => toggle("saturated"), x: () => toggle("flips"), d: () => toggle("dark"),
      p: () => choose("probe"), l: () => choose("profile"), r: () => choose("region"), m: () => choose("pan"), w: () => choose("window"),
      h: () => { this.line = [0, from.v, columns - 1, from.v]; this.changed(); },
      v: () => { this.line = [from.u, 0, from.u, rows - 1]; this.changed(); },
      Enter: () => this.setPin(this.pin ? null : from),
      a: () => comparison.keep(), b: () => comparison.flip(), t: () => comparison.choose("wipe"), g: () => comparison.choose("difference"),
      "?": () => toggle("help"),
    };
    if (!Object.hasOwn(keys, event.key)) return false;
    keys[event.key]();
    return true;
  }

  /** The profile as a file: the server's where there is one, with all digits of its numbers. */
  async csv() {
    const { explorer, line } = this;
    if (!line) return;
    if (explorer.source.ask && explorer.source.live) {
      await explorer.fetched("profile", { profile: line, width: explorer.profileWidth }, "profile.csv", "text/csv");
      return;
    }
    download(profileCsv(await explorer.profileRows(line)), "profile.csv", "text/csv");
  }
}
