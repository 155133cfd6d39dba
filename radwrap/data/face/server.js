// Asks the server, with the token that came in the link.

/** @typedef {import("./types.js").Turn} Turn */
/** @typedef {import("./types.js").Described} Described */
/** @typedef {import("./types.js").Certified} Certified */

const KEY = "token";
const CALM = 1000; // ms after which a worker is started for the next picture

/** What is wrong, in the words of radwrap. */
export class Refused extends Error {
  /** @param {{text: string, where: string, error: string}} told @param {number} status */
  constructor(told, status) {
    super(told.text);
    this.where = told.where;
    this.what = told.error;
    this.status = status;
  }
}

/** The token of the link goes into this tab's memory, and out of the address and of the history. */
export function takeToken() {
  const told = location.hash.slice(1);
  // A place in the page is no token: where there is one, what follows another link within the page stays as it is.
  if (told && (/^[\w-]{43,}$/.test(told) || !sessionStorage.getItem(KEY))) {
    sessionStorage.setItem(KEY, told);
    history.replaceState(null, "", location.pathname);
  }
  return sessionStorage.getItem(KEY);
}

/** The server, as the page needs it. */
export class Server {
  /** @param {string} token */
  constructor(token) {
    this.token = token;
    this.live = true;
    this.wake = () => {};
    this.tracedFrom = 0; // the basis that was there when this tab asked for a trace
    /** @type {Worker | null} one that has its modules: to start it took .1 s of each first frame */
    this.spare = startedWorker();
  }

  /**
   * Wait; shorter where a trace is asked for meanwhile, as that changes what there is to see.
   * @param {number} time ms
   * @returns {Promise<void>}
   */
  pause(time) {
    return new Promise((resolve) => {
      this.wake = resolve;
      setTimeout(resolve, time);
    });
  }

  makeWorker() {
    const worker = this.spare ?? startedWorker();
    this.spare = null;
    setTimeout(() => { this.spare ??= startedWorker(); }, CALM);
    return worker;
  }

  /**
   * @param {string} name
   * @param {object} told
   * @param {AbortSignal} [signal]
   */
  async ask(name, told, signal) {
    if (name === "trace") this.tracedFrom = /** @type {{basis?: number}} */ (told).basis ?? 0;
    return this.send(name, JSON.stringify(told), "application/json", signal);
  }

  /**
   * @param {string} name
   * @param {string | Blob} body
   * @param {string} type
   * @param {AbortSignal} [signal]
   */
  async send(name, body, type, signal) {
    const headers = { Authorization: `Bearer ${this.token}`, "Content-Type": type };
    const answer = await fetch(`/api/${name}`, { method: "POST", headers, body, signal });
    if (answer.ok) {
      if (name === "trace") this.wake();
      return answer;
    }
    const json = answer.headers.get("content-type")?.startsWith("application/json");
    const text = json ? await answer.json() : await answer.text();
    throw new Refused(json ? text : { text, where: "", error: text }, answer.status);
  }

  /**
   * How far the trace is: when that or the basis is another than is known, or after a while.
   * @param {number} done
   * @param {number} basis
   * @returns {Promise<{state: string, done?: number, of?: number, error?: string, described?: Described}>}
   */
  async watch(done, basis) {
    return (await this.ask("watch", { done, basis })).json();
  }

  /**
   * Each plane of light as it comes.
   * @param {number} basis
   * @param {(plane: import("./types.js").Plane) => void} take
   */
  async planes(basis, take) {
    const blocks = new Blocks(await this.ask("planes", { basis }));
    const { blocks: sizes, pixels } = await blocks.head();
    for (const size of sizes) {
      const [unit] = await blocks.numbers(1);
      const rest = await blocks.numbers(size - 1);
      take({ unit, high: rest.subarray(0, pixels), low: new Int8Array(rest.buffer, 4 * pixels, pixels) });
    }
  }

  /**
   * What takes long: how far it is, then what was found; it ends when its signal says so.
   * @param {string} name
   * @param {object} told
   * @param {AbortSignal} signal
   * @param {(progress: any) => void} take
   * @returns {Promise<any>}
   */
  async told(name, told, signal, take) {
    const blocks = new Blocks(await this.ask(name, told, signal));
    for (;;) {
      const { progress, found, refused } = await blocks.head();
      if (refused) throw new Refused(refused, 422);
      if (found) return found;
      if (progress) take(progress);
    }
  }

  /**
   * All that is known of a pixel; null where the server has gone.
   * @param {number} basis
   * @param {Turn} turn
   * @param {{u: number, v: number}} pixel
   * @returns {Promise<import("./types.js").PixelTold | null>}
   */
  async pixel(basis, turn, { u, v }) {
    try {
      return await (await this.ask("pixel", { basis, turn, column: u, row: v })).json();
    } catch {
      return null;
    }
  }

  /**
   * Send a photo; it comes back as gray levels.
   * @param {{basis: number, turn: Turn}} told
   * @param {Blob} file
   * @param {AbortSignal} signal
   * @returns {Promise<{told: {photo: number, bit_depth: number, notes: string[]}, values: Float32Array}>}
   */
  async photo(told, file, signal) {
    const body = new Blob([`${JSON.stringify(told)}\n`, file]);
    const blocks = new Blocks(await this.send("photo", body, "application/octet-stream", signal));
    const found = await blocks.head();
    return { told: found, values: await blocks.numbers(found.blocks[0]) };
  }

  /**
   * @param {number} basis
   * @param {Turn} turn
   * @param {AbortSignal} signal
   * @returns {Promise<Certified>}
   */
  async turn(basis, turn, signal) {
    const blocks = new Blocks(await this.ask("turn", { basis, turn }, signal));
    const told = await blocks.head();
    const values = await blocks.numbers(told.blocks[0]);
    const exposure = await blocks.numbers(told.blocks[1]);
    const sigma = await blocks.numbers(told.blocks[2]);
    const { first, saturated, lit } = told.thresholds;
    return {
      told, exposure, sigma,
      thresholds: { first, values, saturated: saturated ?? Infinity, lit: lit ?? Infinity },
    };
  }
}

function startedWorker() {
  return new Worker("/worker.js", { type: "module" });
}

/** A line of JSON, then numbers; little-endian, as all browsers' machines are. */
class Blocks {
  /** @param {Response} answer */
  constructor(answer) {
    if (!answer.body) throw new Error("an empty answer");
    this.reader = answer.body.getReader();
    this.rest = new Uint8Array(0);
  }

  async more() {
    const { done, value } = await this.reader.read();
    if (done) throw new TypeError("the answer was cut off");
    return value;
  }

  /** @returns {Promise<any>} */
  async head() {
    let all = this.rest;
    while (!all.includes(10)) {
      const more = await this.more();
      const joined = new Uint8Array(all.length + more.length);
      joined.set(all);
      joined.set(more, all.length);
      all = joined;
    }
    const end = all.indexOf(10);
    this.rest = all.slice(end + 1);
    return JSON.parse(new TextDecoder().decode(all.subarray(0, end)));
  }

  /** @param {number} count */
  async numbers(count) {
    const octets = new Uint8Array(4 * count);
    let filled = 0;
    while (filled < octets.length) {
      if (this.rest.length === 0) this.rest = await this.more();
      const part = this.rest.subarray(0, octets.length - filled);
      octets.set(part, filled);
      filled += part.length;
      this.rest = this.rest.subarray(part.length);
    }
    return new Float32Array(octets.buffer);
  }
}
