// One basis on the page: knobs, picture, readings, and the server's word on each turn once the knobs rest.

import { Comparison } from "./compare.js";
import { byId, download, element, focusKnob, numberOf, settle } from "./dom.js";
import { Field } from "./field.js";
import { take } from "./handover.js";
import { KnobPanel } from "./knobs.js";
import { LayoutView } from "./layout_view.js";
import { Mattering } from "./matters.js";
import { Trading } from "./trading.js";
import { Measurement } from "./measuring.js";
import { coloursOf } from "./mix.js";
import { PhotoComparison } from "./photo.js";
import { HistogramPlot, ProfilePlot } from "./plots.js";
import { RayKnobs } from "./ray_knobs.js";
import { RingControl } from "./ring.js";
import { Readings } from "./readings.js";
import { grayOf, rankOf, thresholdsOf, turnedSensor } from "./response.js";
import { History, sameTurn, untouched } from "./state.js";
import { linePixels, stripPixels } from "./statistics.js";
import { errorText, parseTime, percent, shortNumber } from "./units.js";
import { NUMBERS_FROM, View } from "./view.js";

/** @typedef {import("./types.js").Described} Described */
/** @typedef {import("./types.js").Certified} Certified */
/** @typedef {import("./types.js").Turn} Turn */
/** @typedef {import("./field.js").Picture} Picture */
/** @typedef {import("./view.js").Pixel} Pixel */
/** @typedef {import("./types.js").Kept} Kept */
/** @typedef {{code: number, gray: number, sigma: number | null, exposure: number}} Value */

const REST = 100; // ms after which a turn is certified
const READ_EVERY = 80; // ms between updates of what is read beside the picture

/** What can be told of an image without its server, too; the exported page has a source of its own. */
export class Explorer {
  /**
   * @param {any} source the server, or what an exported page holds
   * @param {Described} described
   * @param {{state: (text: string, kind?: string) => void, banner: (text: string | null) => void}} tell
   * @param {Kept | null} [kept] what the coarse picture leaves that stood for this one
   * @param {import("./types.js").KeptPicture | null} [a] what is kept of a basis before, to compare
   */
  constructor(source, described, tell, kept = null, a = null) {
    this.source = source;
    this.described = described;
    this.tell = tell;
    this.leave = new AbortController();
    this.history = kept?.history ?? new History(untouched(described.sources.length));
    /** @type {Certified | null} of the present turn */
    this.certified = null;
    /** @type {AbortController | null} */
    this.asking = null;
    this.planes = false;
    this.tracing = "ready";
    /** @type {number | undefined} */
    this.timer = undefined;
    /** @type {number | undefined} */
    this.reader = undefined;
    this.frames = 0;
    /** @type {number | undefined} */
    this.bits = undefined;
    const { rows, columns } = described;
    this.field = new Field(() => source.makeWorker(), rows, columns, (picture) => this.show(picture));
    this.respond();
    byId("title").textContent = byId("title").title = described.title;
    document.title = `${described.title} - radwrap`;
    this.view = new View(byId("picture"), byId("image", HTMLCanvasElement), byId("marks", HTMLCanvasElement), rows, columns,
      () => this.draw());
    const places = { rings: byId("rings"), levels: byId("levels"), camera: byId("camera") };
    this.panel = new KnobPanel(described, places, () => this.history.now, (turn, what) => this.turn(turn, what),
      () => this.history.rest());
    this.readings = new Readings(this, this.leave.signal);
    this.comparison = new Comparison(this, a, this.leave.signal);
    this.measurement = new Measurement(this, this.leave.signal);
    this.photo = new PhotoComparison(this, this.leave.signal);
    this.mattering = new Mattering(this, this.leave.signal);
    this.trading = new Trading(this, this.leave.signal);
    this.layout = new LayoutView(this, this.leave.signal);
    this.ring = new RingControl(this, this.leave.signal);
    this.profile = new ProfilePlot(fresh("profile"), byId("profiletable"));
    this.histogram = new HistogramPlot(fresh("histogram"), byId("histogramtable"));
    this.listen();
    this.resetWindow();
    if (kept) take(this, kept);
    this.tellUnmeasured();
    this.tellLeftOut();
    this.rayKnobs = new RayKnobs(this, kept?.rays);
    if (kept?.focus?.knob.startsWith("ray:")) focusKnob(kept.focus);
    byId("rays").textContent = "Materials, and what else is not here, need rays too: change them in the scene file."
      + (described.dark_sources.length ? ` Dark in the scene, so without a knob: ${described.dark_sources.join(", ")}.` : "");
    if (!described.mixes) byId("rays").append(" This basis is too large to be mixed in the page: the picture follows when a knob rests.");
    byId("save").hidden = !described.saves || Boolean(described.coarse);
    for (const id of ["png", "toml"]) byId(id).hidden = Boolean(described.coarse);
  }

  /** Fetch the planes, then certify. */
  async load() {
    const { basis, mixes, sources } = this.described;
    const certifying = this.certify();
    try {
      if (mixes) {
        let number = 0;
        await this.source.planes(basis, (/** @type {import("./types.js").Plane} */ plane) => {
          number++;
          if (!this.certified) this.tell.state(`loading ${percent(number / sources.length)}`, "stale");
          this.field.addPlane(plane);
        });
        this.planes = true;
        this.draw();
      }
      await certifying;
    } catch (error) {
      if (!this.leave.signal.aborted) this.tell.banner(error instanceof Error ? error.message : String(error));
    }
  }

  close() {
    this.leave.abort();
    this.asking?.abort();
    clearTimeout(this.timer);
    this.field.close();
    this.view.close();
  }

  /** The server has gone. */
  lost() {
    this.asking?.abort();
    this.rayKnobs.back();
    if (this.certified) this.tellError(this.certified);
    else this.setStale("not measured");
  }

  // ----------------------------------------------------------------------------------------------------------- Turning

  /** @param {Turn} turn @param {string} what */
  turn(turn, what) {
    if (!this.history.turn(turn, what)) return;
    this.turned();
  }

  turned() {
    this.panel.accept();
    this.panel.show(this.history.now);
    this.certified = null;
    this.asking?.abort();
    if (this.source.live) this.tell.banner(null); // what was refused was of other knobs
    this.setStale("measuring");
    for (const part of [this.measurement, this.photo, this.mattering, this.trading, this.ring]) part.turned();
    this.layout.draw();
    this.respond();
    this.comparison.refresh();
    this.draw();
    clearTimeout(this.timer);
    this.timer = setTimeout(() => { void this.certify(); }, REST);
    this.buttons();
  }

  /** By how much the exposure time is longer; 1 where its text is none, which the server will say. */
  get times() {
    const { exposure_time: before } = this.described;
    const now = this.history.now.knobs.exposure_time;
    const value = now === undefined ? null : parseTime(now);
    return value === null || !(before > 0) ? 1 : value / before;
  }

  get sensor() {
    return this.certified ? this.certified.told.sensor : turnedSensor(this.described.sensor, this.history.now.knobs, this.times);
  }

  get thresholds() {
    return this.certified ? this.certified.thresholds : thresholdsOf(this.sensor);
  }

  get scale() {
    return this.described.exposure_of_radiance * this.times;
  }

  respond() {
    this.field.respond(this.thresholds, this.sensor);
    const bits = this.sensor.bit_depth;
    if (this.bits !== undefined && this.bits !== bits) this.resetWindow();
    this.bits = bits;
  }

  /** Ask the server for the present turn: the newest one counts. */
  async certify() {
    const turn = this.history.now;
    const asking = new AbortController();
    this.asking?.abort();
    this.asking = asking;
    try {
      const certified = await this.source.turn(this.described.basis, turn, asking.signal);
      if (asking.signal.aborted || !sameTurn(turn, this.history.now) || this.leave.signal.aborted) return;
      if (!certified) {
        this.setStale("turned: error of the scene's own levels");
        return;
      }
      this.certified = certified;
      this.panel.accept();
      this.respond();
      this.field.certify(certified.exposure, certified.sigma);
      this.tellError(certified);
      this.comparison.refresh();
      this.ring.follow();
      this.draw();
      await this.readings.certify();
    } catch (error) {
      if (asking.signal.aborted || this.leave.signal.aborted) return;
      const { where, message } = /** @type {any} */ (error);
      if (where === undefined) {
        this.setStale("not measured");
        return; // no answer: the page hears of that by its own watch
      }
      if (where === "basis") return; // another one has come: the page's watch is about to say so
      if (!this.panel.refuse(where, message)) this.tell.banner(message);
      this.setStale("refused");
    }
  }

  /** @param {string} why */
  setStale(why) {
    byId("error").classList.add("stale");
    byId("kept").classList.add("stale");
    if (why !== "tracing") this.tell.state(why, "stale");
    byId("picture").classList.toggle("old", !this.planes && this.certified === null);
  }

  /** The picture comes by its planes, and its error a moment later: that of the picture before is not its own. */
  tellUnmeasured() {
    const { coarse, tolerance } = this.described, kept = byId("kept");
    byId("error").className = kept.className = "chip stale";
    byId("error").textContent = "error being measured";
    kept.textContent = !coarse ? "" : `coarse picture: tolerance ${shortNumber(tolerance)}${coarse > 1 ? `, ${coarse} × ${coarse} pixels as one` : ""}`;
  }

  /** @param {Certified} certified */
  tellError({ told }) {
    const { rms_gray: rms, rms_gray_upper95: bound } = told.error;
    const { tolerance, coarse } = this.described;
    const error = byId("error"), kept = byId("kept");
    error.className = "chip";
    error.textContent = `error ${errorText(rms)} gray rms, below ${errorText(bound)} (95 %)`;
    if (!coarse) {
      kept.className = `chip ${told.keeps ? "good" : "bad"}`;
      kept.textContent = `tolerance ${shortNumber(tolerance)} ${told.keeps ? "kept" : "not kept"}`;
    }
    this.tell.state("measured", "good");
    byId("picture").classList.remove("old");
    byId("copy").hidden = told.command === "";
    byId("inpython").hidden = !told.python;
    byId("python").textContent = told.python ?? "";
    byId("command").textContent = told.command || (coarse ? "The command comes with the picture of the asked tolerance." : "");
    this.offer(this.tracing);
    this.tellLeftOut();
  }

  /** Offer a new trace where the knobs have left the light of the old one. @param {string} tracing */
  offer(tracing) {
    this.tracing = tracing;
    const start = sameTurn(this.history.now, this.history.start);
    byId("trace").hidden = tracing === "tracing" || start || !this.certified || !this.source.live;
  }

  tellLeftOut() {
    const { left_out: own, warnings } = this.described;
    const turned = this.certified?.told.left_out;
    const effects = turned ?? own;
    const as = turned || sameTurn(this.history.now, this.history.start) ? "" : ", at the scene's own levels";
    const lines = effects.map(({ name, left_out: what, rms_gray: rms, rms_gray_upper95: bound, needed }) =>
      element("p", { class: "note" }, `${needed ? "⚠ " : ""}${name}: ${what}; ${bound < 1e-3 ? "less than 0.001 gray rms"
        : `${errorText(rms)} gray rms, at most ${errorText(bound)}`}${as}`));
    const needed = effects.filter((effect) => effect.needed);
    const chip = byId("lacks", HTMLAnchorElement);
    chip.hidden = needed.length === 0;
    chip.textContent = `⚠ not in it: ${needed.map(({ name, rms_gray: rms }) => `${name} ${errorText(rms)}`).join(", ")} gray rms${as}`;
    byId("leftout").replaceChildren(...lines, ...warnings.map((text) => element("p", { class: "note" }, `⚠ ${text}`)));
  }

  // ----------------------------------------------------------------------------------------------------------- Showing

  get look() {
    const [low, high] = this.window;
    return {
      low, high,
      map: byId("map", HTMLSelectElement).value,
      saturated: byId("saturated", HTMLInputElement).checked,
      dark: byId("dark", HTMLInputElement).checked,
      flips: byId("flips", HTMLInputElement).checked,
      share: numberOf("share", (share) => share >= 0.1 && share <= 10) / 100,
    };
  }

  /** The scale is fixed, 0 to full scale, unless the user changes it. */
  resetWindow() {
    byId("low", HTMLInputElement).value = "0";
    byId("high", HTMLInputElement).value = String(2 ** this.sensor.bit_depth - 1);
  }

  /** Codes that are shown black and white. @returns {[number, number]} */
  get window() {
    return [numberOf("low", () => true), numberOf("high", () => true)];
  }

  /** @param {[number, number]} window */
  setWindow([low, high]) {
    byId("low", HTMLInputElement).value = String(low);
    byId("high", HTMLInputElement).value = String(high);
    this.draw();
  }

  draw() {
    if (!this.comparison) return;
    byId("zoom").textContent = this.view.text;
    if (!this.planes && !this.certified) return;
    byId("picture").ariaBusy = "true";
    this.field.draw({
      factors: this.history.now.levels, scale: this.scale, certified: this.certified !== null,
      section: this.view.section, look: this.look, shown: this.comparison.shown, range: this.comparison.range,
    });
  }

  /** @param {Picture} picture */
  show(picture) {
    this.view.show(picture, this.comparison.curtain);
    if (picture.apart) this.comparison.tell(picture.apart);
    this.frames++;
    byId("picture").dataset.frames = String(this.frames);
    byId("picture").ariaBusy = String(this.field.wish !== null); // a newer frame follows
    this.latest = picture;
    this.reader ??= setTimeout(() => {
      this.reader = undefined;
      if (!this.leave.signal.aborted) void this.read();
    }, READ_EVERY);
  }

  /** What stands beside the picture. */
  async read() {
    const picture = this.latest;
    if (!picture) return;
    const all = this.described.rows * this.described.columns;
    byId("saturatedshare").textContent = percent(picture.saturated / all);
    byId("darkshare").textContent = percent(picture.dark / all);
    byId("flipsshare").textContent = picture.wish.look.flips ? percent(picture.flips / all) : "";
    this.histogram.show(picture.counts);
    this.showScale(picture.wish.look);
    await this.readings.show();
  }

  /** @param {import("./types.js").Look} look */
  showScale(look) {
    byId("scalelow").textContent = String(look.low);
    byId("scalehigh").textContent = String(look.high);
    const ramp = byId("ramp", HTMLCanvasElement);
    const pen = /** @type {CanvasRenderingContext2D} */ (ramp.getContext("2d"));
    const colours = coloursOf({ ...look, low: 0, high: 255 }, 256);
    const rows = new Uint32Array(256 * ramp.height);
    for (let row = 0; row < ramp.height; row++) rows.set(colours, 256 * row);
    pen.putImageData(new ImageData(new Uint8ClampedArray(rows.buffer), 256, ramp.height), 0, 0);
  }

  /**
   * What is known of some pixels.
   * @param {Pixel[]} pixels
   * @returns {Promise<Value[]>}
   */
  async values(pixels) {
    const { certified, thresholds, sensor } = this;
    const { columns } = this.described;
    const light = certified ? pixels.map(({ u, v }) => certified.exposure[v * columns + u])
      : this.planes ? await this.field.light(pixels, this.history.now.levels, this.scale) : [];
    return light.map((exposure, k) => ({
      exposure,
      code: rankOf(exposure, thresholds),
      gray: grayOf(exposure, sensor),
      sigma: certified ? certified.sigma[pixels[k].v * columns + pixels[k].u] : null,
    }));
  }

  /** Codes that stand in the pixels where these are large. */
  async numbers() {
    if (this.view.into < NUMBERS_FROM) return [];
    const { x0, x1, y0, y1 } = this.view.section;
    /** @type {Pixel[]} */
    const pixels = [];
    for (let v = y0; v < y1; v++) for (let u = x0; u < x1; u++) pixels.push({ u, v });
    const codes = await this.comparison.codes(pixels);
    return codes.map((code, k) => ({ ...pixels[k], code }));
  }

  /** An odd number of pixels. */
  get profileWidth() {
    return numberOf("profilewidth", (width) => width >= 1 && width <= 99 && width % 2 === 1);
  }

  /**
   * Of a wide profile, means over the pixels across the line; that of the deviation too, as pixels may err together.
   * @param {number[]} ends
   * @param {(pixels: Pixel[]) => Value[] | Promise<Value[]>} [of] default the picture of the knobs
   */
  async profileRows(ends, of = (pixels) => this.values(pixels)) {
    const line = /** @type {[number, number, number, number]} */ (ends);
    const { rows, columns } = this.described;
    const strips = stripPixels(line, this.profileWidth, rows, columns);
    const values = await of(strips.flat());
    if (values.length === 0) return [];
    let next = 0;
    return linePixels(line).map((pixel, k) => {
      const mine = values.slice(next, next += strips[k].length);
      /** @param {(value: Value) => number} of */
      const mean = (of) => mine.reduce((sum, value) => sum + of(value), 0) / mine.length;
      return { ...pixel, code: mean(({ code }) => code), gray: mean(({ gray }) => gray), exposure: mean(({ exposure }) => exposure),
        sigma: mine[0].sigma === null ? null : mean(({ sigma }) => sigma ?? 0), pixels: mine.length };
    });
  }

  // ---------------------------------------------------------------------------------------------------------- Listening

  buttons() {
    byId("undo", HTMLButtonElement).disabled = this.history.past.length === 0;
    byId("redo", HTMLButtonElement).disabled = this.history.undone.length === 0;
  }

  /** @param {boolean} moved */
  stepped(moved) {
    if (moved) this.turned();
  }

  listen() {
    const { signal } = this.leave;
    /** @param {string} id @param {() => void} act */
    const click = (id, act) => byId(id).addEventListener("click", act, { signal });
    click("undo", () => this.stepped(this.history.undo()));
    click("redo", () => this.stepped(this.history.redo()));
    click("reset", () => {
      this.turn(untouched(this.described.sources.length), "reset");
      this.history.rest();
    });
    click("in", () => this.view.zoom(1));
    click("out", () => this.view.zoom(-1));
    click("fit", () => this.view.fit());
    click("fullscale", () => {
      this.resetWindow();
      this.draw();
    });
    for (const [id, text] of [["copy", "command"], ["copypython", "python"]]) {
      click(id, () => { void navigator.clipboard?.writeText(byId(text).textContent ?? ""); });
    }
    click("help", () => byId("dialog", HTMLDialogElement).showModal());
    click("png", () => this.fetched("png", {}, "gray.png", "image/png"));
    click("toml", () => this.fetched("scene", {}, "scene.toml", "application/toml"));
    click("save", () => { void this.save(); });
    for (const id of ["low", "high", "map", "saturated", "flips", "dark", "share"]) {
      byId(id).addEventListener("input", () => this.draw(), { signal });
    }
    byId("profilewidth").addEventListener("input", () => this.readings.changed(), { signal });
    for (const id of ["low", "high", "share", "profilewidth", "range"]) byId(id).addEventListener("change", () => settle(id), { signal });
    document.addEventListener("keydown", (event) => {
      if (!(event.ctrlKey || event.metaKey) || event.target instanceof HTMLInputElement && event.target.type === "text") return;
      if (event.key === "z" || event.key === "y") {
        event.preventDefault();
        this.stepped(event.key === "z" && !event.shiftKey ? this.history.undo() : this.history.redo());
      }
    }, { signal });
    this.buttons();
  }

  /** @param {string} name @param {object} more @param {string} file @param {string} type */
  async fetched(name, more, file, type) {
    try {
      const answer = await this.source.ask(name, { basis: this.described.basis, turn: this.history.now, ...more });
      download(await answer.blob(), file, type);
    } catch (error) {
      this.tell.banner(error instanceof Error ? error.message : String(error));
    }
  }

  async save() {
    try {
      const told = { basis: this.described.basis, turn: this.history.now, profile: this.readings.line, width: this.profileWidth };
      const { folder, note } = await (await this.source.ask("save", told)).json();
      byId("saved").textContent = `saved in ${folder}${note ? `; ${note}` : ""}`;
    } catch (error) {
      byId("saved").textContent = error instanceof Error ? error.message : String(error);
    }
  }
}

/** An empty place for a plot: that of a basis before has its own. @param {string} id */
function fresh(id) {
  const place = byId(id);
  const made = element("div", {});
  place.replaceChildren(made);
  return made;
}
