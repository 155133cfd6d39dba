// The page: begins, waits for the basis, and begins again where it was traced anew.

import { byId, pressed } from "./dom.js";
import { Explorer } from "./explorer.js";
import { keptOf } from "./handover.js";
import { Refused, Server, takeToken } from "./server.js";
import { countText } from "./units.js";

const HAND = 100; // ms between looks at whether a knob is let go
const BEAT = 1500; // ms between looks at whether the server lives

/** @param {string} text @param {string} [kind] */
function state(text, kind = "") {
  const chip = byId("state");
  chip.textContent = text;
  chip.className = `chip ${kind}`;
}

/** @param {string | null} text */
function banner(text) {
  const place = byId("banner");
  place.hidden = text === null;
  place.textContent = text ?? "";
}

const GONE = "The server has gone. Light, exposure and sensor can still be turned, without a new error; "
  + "start radwrap face again and open its new link for more.";

const ANEW = "Another tab has traced the scene anew";

async function begin() {
  const token = takeToken();
  if (!token) {
    state("no link", "bad");
    banner("This page needs its link: open the one that radwrap face printed, with everything after #.");
    return;
  }
  const server = new Server(token);
  const stop = byId("stop"), trace = byId("trace");
  stop.addEventListener("click", () => { void server.ask("stop", {}).catch(() => {}); });
  document.addEventListener("keydown", (event) => { if (event.key === "Escape" && !stop.hidden) stop.click(); });
  trace.addEventListener("click", async () => {
    try {
      await server.ask("trace", explorer && !explorer.described.coarse ? { basis: explorer.described.basis, turn: explorer.history.now } : {});
      banner(null);
    } catch (error) {
      banner(error instanceof Error ? error.message : String(error));
    }
  });
  /** @type {Explorer | null} */
  let explorer = null;
  let done = -1;
  for (;;) {
    try {
      const told = await server.watch(done, explorer?.described.basis ?? 0);
      done = told.done ?? -1;
      if (!server.live) {
        server.live = true;
        banner(null);
      }
      stop.hidden = told.state !== "tracing";
      if (told.described && told.described.basis !== explorer?.described.basis) {
        if (explorer && pressed()) { // a knob is being dragged: it is not taken out of the hand
          await server.pause(HAND);
          continue;
        }
        const kept = keptOf(explorer, told.described), a = explorer?.comparison.held ?? null;
        const asked = !explorer || explorer.described.coarse || server.tracedFrom === explorer.described.basis;
        explorer?.close();
        banner(asked ? null : `${ANEW}: ${kept ? "what needs rays has other values" : "the knobs are at 1 again, of another light"}.`);
        explorer = new Explorer(server, told.described, { state: told.described.coarse ? () => {} : state, banner }, kept, a);
        void explorer.load();
      }
      if (told.state === "tracing") {
        trace.hidden = true;
        const far = done > 0 ? `tracing, ${countText(done)} rays` : "tracing"; // how many it takes shows on the way only
        if (explorer?.described.coarse) state(`coarse, ${far}`, "stale");
        else {
          state(far, "stale");
          explorer?.setStale("tracing");
        }
        continue;
      }
      if (told.state === "failed") {
        state("failed", "bad");
        banner(told.error ?? "the trace failed");
      }
      if (told.state !== "ready") explorer?.rayKnobs.back();
      if (told.state === "stopped") state(explorer?.described.coarse ? "stopped, coarse" : "stopped", "stale");
      const whole = explorer && !explorer.described.coarse ? explorer : null;
      trace.textContent = whole ? "Trace in this light" : "Trace";
      if (!whole) trace.hidden = false;
      else whole.offer(told.state);
      await server.pause(BEAT);
    } catch (error) {
      if (error instanceof Refused && error.status === 401) {
        state("no link", "bad");
        banner("This link belongs to another server: open the last one that radwrap face printed.");
        return;
      }
      if (server.live) {
        server.live = false;
        banner(GONE);
        stop.hidden = true;
        explorer?.lost();
        if (!explorer) state("no server", "bad");
        else if (explorer.described.coarse) state("stopped, coarse", "stale");
      }
      await server.pause(BEAT);
    }
  }
}

void begin();
