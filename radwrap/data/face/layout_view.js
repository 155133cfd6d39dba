// The layout's picture on a canvas, its keys, and the same as a table.

import { byId, element, tableOf } from "./dom.js";
import { drawn, frustum, placesOf, rim, turn, VIEWS } from "./layout.js";
import { shortNumber } from "./units.js";

/** @typedef {import("./explorer.js").Explorer} Explorer */
/** @typedef {import("./layout.js").Point} Point */
/** @typedef {import("./types.js").Layout} Layout */
/** @typedef {import("./types.js").Sight} Sight */

const MARGIN = 18; // px
const MOST_BEAMS = 64;
const STEP = Math.PI / 24;

/** @param {number} length [m] */
const millimetres = (length) => shortNumber(1e3 * length, 4);

/** The layout of the present scene; it is asked for once its place is opened. */
export class LayoutView {
  /** @param {Explorer} explorer @param {AbortSignal} signal */
  constructor(explorer, signal) {
    this.explorer = explorer;
    this.turned = { ...VIEWS.oblique };
    this.zoom = 1;
    /** @type {Layout | null} */
    this.layout = null;
    /** @type {Sight | null} */
    this.sight = null;
    this.canvas = byId("scene", HTMLCanvasElement);
    this.listen(signal);
    byId("layouttable").replaceChildren();
    if (byId("layout", HTMLDetailsElement).open) void this.load();
  }

  /** @param {AbortSignal} signal */
  listen(signal) {
    const { canvas } = this;
    byId("layout").addEventListener("toggle", () => { if (byId("layout", HTMLDetailsElement).open && !this.layout) void this.load(); }, { signal });
    byId("beams").addEventListener("change", () => this.draw(), { signal });
    for (const button of byId("views").querySelectorAll("button")) {
      button.addEventListener("click", () => this.look(VIEWS[button.value]), { signal });
    }
    canvas.addEventListener("keydown", (event) => { if (this.pressed(event.key)) event.preventDefault(); }, { signal });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.pressed(event.deltaY < 0 ? "+" : "-");
    }, { signal, passive: false });
    canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId), { signal });
    canvas.addEventListener("pointermove", (event) => {
      if (event.buttons !== 1) return;
      this.look({ yaw: this.turned.yaw - event.movementX / 150, pitch: this.turned.pitch + event.movementY / 150 });
    }, { signal });
    const watch = new ResizeObserver(() => this.draw());
    watch.observe(canvas);
    const dark = matchMedia("(prefers-color-scheme: dark)");
    dark.addEventListener("change", () => this.draw(), { signal });
    signal.addEventListener("abort", () => watch.disconnect());
  }

  /** @param {string} key */
  pressed(key) {
    const { yaw, pitch } = this.turned;
    /** @type {Record<string, () => void>} */
    const keys = {
      ArrowLeft: () => this.look({ yaw: yaw + STEP, pitch }), ArrowRight: () => this.look({ yaw: yaw - STEP, pitch }),
      ArrowUp: () => this.look({ yaw, pitch: pitch - STEP }), ArrowDown: () => this.look({ yaw, pitch: pitch + STEP }),
      "+": () => { this.zoom = Math.min(16, this.zoom * 1.25); this.draw(); },
      "-": () => { this.zoom = Math.max(0.5, this.zoom / 1.25); this.draw(); },
      c: () => this.look(VIEWS.camera), a: () => this.look(VIEWS.above), s: () => this.look(VIEWS.side), o: () => this.look(VIEWS.oblique),
    };
    if (!Object.hasOwn(keys, key)) return false;
    keys[key]();
    return true;
  }

  /** @param {{yaw: number, pitch: number}} turned */
  look({ yaw, pitch }) {
    this.turned = { yaw, pitch: Math.min(Math.PI / 2, Math.max(-Math.PI / 2, pitch)) };
    this.draw();
  }

  /** What the pinned pixel sees. @param {Sight | null} sight */
  see(sight) {
    this.sight = sight;
    this.draw();
  }

  async load() {
    const { explorer } = this;
    try {
      const told = { basis: explorer.described.basis };
      this.layout = await (await explorer.source.ask("layout", told, explorer.leave.signal)).json();
      this.draw();
      this.table();
    } catch (error) {
      if (!explorer.leave.signal.aborted) byId("layouttable").textContent = error instanceof Error ? error.message : String(error);
    }
  }

  table() {
    const { layout } = this;
    if (!layout) return;
    const { targets, sources, camera, unknown } = layout;
    /** @param {string} name @param {string} kind @param {Point} world @param {Point} place @param {string} more */
    const row = (name, kind, world, place, more) => [name, kind, world.map(millimetres).join(", "), millimetres(Math.hypot(...place)), more];
    const sees = [0, 1].map((k) => millimetres(camera.depth * (Math.max(...camera.corners.map((corner) => corner[k]))
      - Math.min(...camera.corners.map((corner) => corner[k]))))).join(" × ");
    const rows = [row("camera", "camera", camera.world, [0, 0, 0], `sees ${sees} mm in the depth ${millimetres(camera.depth)} mm`
      + (camera.focus === null ? "" : `, in focus at ${millimetres(camera.focus)} mm`)),
      ...targets.map(({ name, world, place, boxed }) => row(name, "target", world, place, boxed ? "only its bounds are drawn" : "")),
      ...sources.map(({ name, world, place, half_angle: angle }) => row(name, "source", world, place,
        angle === null ? "shines all around" : `half at ${shortNumber((angle * 180) / Math.PI, 3)}° from its axis`))];
    const lost = unknown.length ? [element("p", { class: "note" }, `not drawn, as their shapes are not known: ${unknown.join(", ")}`)] : [];
    byId("layouttable").replaceChildren(tableOf("Layout", ["", "is", "x, y, z [mm]", "from the camera [mm]", ""], rows), ...lost);
  }

  /** Where a place that is turned stands on the canvas. @param {Point[]} places @returns {(seen: Point) => [number, number]} */
  screen(places) {
    const { canvas, turned, zoom } = this;
    const seen = places.map((place) => turn(place, turned));
    const [left, right, top, bottom] = [0, 1].flatMap((k) => [seen.reduce((least, one) => Math.min(least, one[k]), Infinity),
      seen.reduce((most, one) => Math.max(most, one[k]), -Infinity)]);
    const size = zoom * Math.min((canvas.width - 2 * MARGIN) / (right - left || 1), (canvas.height - 2 * MARGIN) / (bottom - top || 1));
    return ([x, y]) => [canvas.width / 2 + size * (x - (left + right) / 2), canvas.height / 2 + size * (y - (top + bottom) / 2)];
  }

  draw() {
    const { canvas, layout, turned } = this;
    const dots = window.devicePixelRatio || 1;
    const [width, height] = [Math.round(canvas.clientWidth * dots), Math.round(canvas.clientHeight * dots)];
    if (!layout || width < 40 || height < 40) return;
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const pen = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
    const flat = this.screen(placesOf(layout));
    const at = (/** @type {Point} */ point) => flat(turn(point, turned));
    const colour = (/** @type {string} */ name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
    pen.clearRect(0, 0, width, height);
    /** @param {Point[]} points @param {boolean} [closed] */
    const path = (points, closed = false) => {
      pen.beginPath();
      points.forEach((point, k) => { const [x, y] = at(point); if (k) pen.lineTo(x, y); else pen.moveTo(x, y); });
      if (closed) pen.closePath();
    };
    pen.lineJoin = "round";
    this.fill(pen, drawn(layout.targets, turned), flat, colour("--line"));
    pen.lineWidth = dots;
    const { levels } = this.explorer.history.now;
    const names = this.explorer.described.sources.map(({ name }) => name);
    const lit = layout.sources.filter(({ name }) => levels[names.indexOf(name)] > 0);
    if (byId("beams", HTMLInputElement).checked) {
      pen.strokeStyle = colour("--soft");
      for (const source of lit.slice(0, MOST_BEAMS)) {
        const length = Math.max(layout.camera.depth - source.place[2], 0.2 * layout.camera.depth);
        const ring = rim(source, length / Math.max(Math.abs(source.axis[2]), 0.3));
        if (!ring.length) continue;
        pen.globalAlpha = 0.7;
        path(ring, true);
        pen.stroke();
        pen.globalAlpha = 0.35;
        for (let k = 0; k < ring.length; k += 4) { path([source.place, ring[k]]); pen.stroke(); }
        pen.globalAlpha = 1;
      }
    }
    for (const source of layout.sources) {
      const [x, y] = at(source.place);
      pen.beginPath();
      pen.arc(x, y, 4 * dots, 0, 2 * Math.PI);
      pen.fillStyle = "#ffdc5a";
      if (lit.includes(source)) pen.fill();
      pen.strokeStyle = colour("--text");
      pen.stroke();
    }
    const far = frustum(layout.camera);
    pen.strokeStyle = colour("--accent");
    pen.lineWidth = 1.5 * dots;
    for (const corner of far) { path([[0, 0, 0], corner]); pen.stroke(); }
    path(far, true);
    pen.stroke();
    if (this.sight) {
      pen.strokeStyle = colour("--bad");
      pen.setLineDash([6 * dots, 4 * dots]);
      path([[0, 0, 0], this.sight.place]);
      pen.stroke();
      pen.setLineDash([]);
    }
    const [x, y] = at([0, 0, 0]);
    pen.fillStyle = colour("--accent");
    pen.fillRect(x - 4 * dots, y - 4 * dots, 8 * dots, 8 * dots);
    canvas.dataset.drawn = String(Number(canvas.dataset.drawn ?? 0) + 1);
  }

  /**
   * @param {CanvasRenderingContext2D} pen
   * @param {ReturnType<typeof drawn>} triangles
   * @param {(seen: Point) => [number, number]} flat
   * @param {string} line
   */
  fill(pen, triangles, flat, line) {
    pen.lineWidth = 0.5;
    for (const { corners, colour: [red, green, blue, opacity], facing } of triangles) {
      const shade = 0.55 + 0.45 * facing;
      const paint = `rgba(${Math.round(red * shade)},${Math.round(green * shade)},${Math.round(blue * shade)},${opacity / 255})`;
      pen.beginPath();
      corners.forEach((corner, k) => { const [x, y] = flat(corner); if (k) pen.lineTo(x, y); else pen.moveTo(x, y); });
      pen.closePath();
      pen.fillStyle = paint;
      pen.fill();
      pen.strokeStyle = facing > 0.02 ? paint : line; // closes the seams between triangles; edge-on there is no more than a line
      pen.stroke();
    }
  }
}
