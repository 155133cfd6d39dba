// Time from turning a knob to codes on the canvas, and from its rest to the certificate, in headless Chromium without
// a GPU:
//
//     node scripts/face_benchmark.mjs LINK [TURNS]
//
// LINK is what `radwrap face SCENE --no-browser` tells. Turns follow each other once the picture of the one before is
// on the canvas, levels of one source and exposure by turns. Needs what `make test-face` has installed.

import { chromium } from "../tests/face/browser/node_modules/playwright-core/index.mjs";

const [link, turns = "200"] = process.argv.slice(2);
const begin = Date.now();
const browser = await chromium.launch({ executablePath: "/usr/bin/chromium", args: ["--no-sandbox", "--disable-gpu"] });
const page = await browser.newPage({ viewport: { width: 1440, height: 900 } });
await page.goto(link);
await page.waitForFunction(() => Number(document.getElementById("picture").dataset.frames) > 0, undefined, { timeout: 300_000 });
const first = Date.now() - begin;
await page.waitForFunction(() => document.getElementById("state").textContent === "measured", undefined, { timeout: 300_000 });
const planes = Date.now() - begin;
await page.waitForTimeout(1500);
const found = await page.evaluate(async (count) => {
  const frame = document.getElementById("picture");
  const frames = () => Number(frame.dataset.frames);
  const next = (from) => new Promise((resolve) => {
    const watch = new MutationObserver(() => { if (frames() > from) { watch.disconnect(); resolve(performance.now()); } });
    watch.observe(frame, { attributes: true });
  });
  const slider = (name) => document.querySelector(`[data-knob="${name}"] input[type=range]`);
  const names = [...document.querySelectorAll("[data-knob^='level:']")].map((row) => row.dataset.knob);
  const knobs = { level: () => slider(names[1 + (Math.random() * (names.length - 1) | 0)]), exposure: () => slider("exposure_time"),
    all: () => slider("level:all") };
  const times = {};
  for (const [kind, choose] of Object.entries(knobs)) {
    times[kind] = [];
    for (let k = 0; k < count; k++) {
      const knob = choose();
      const low = Number(knob.min), high = Number(knob.max);
      const before = frames(), start = performance.now();
      const shown = next(before);
      knob.value = String(low + (high - low) * (0.3 + 0.4 * Math.random()));
      knob.dispatchEvent(new Event("input", { bubbles: true }));
      times[kind].push(await shown - start);
      knob.dispatchEvent(new Event("change", { bubbles: true }));
      await new Promise((resolve) => { setTimeout(resolve, 5); });
    }
  }
  const state = document.getElementById("state");
  times.certificate = [];
  for (let k = 0; k < 10; k++) {
    const knob = slider("level:all");
    knob.value = String(0.5 + 0.1 * k);
    knob.dispatchEvent(new Event("input", { bubbles: true }));
    const start = performance.now();
    while (state.textContent !== "measured") await new Promise((resolve) => { setTimeout(resolve, 2); });
    times.certificate.push(performance.now() - start);
  }
  return times;
}, Number(turns));
const memory = await page.evaluate(() => performance.memory?.usedJSHeapSize ?? 0);
console.log(`first picture ${first} ms, all planes and certificate ${planes} ms after the browser's start; heap ${(memory / 1e6).toFixed(0)} MB`);
for (const [kind, times] of Object.entries(found)) {
  times.sort((a, b) => a - b);
  const at = (share) => times[Math.min(times.length - 1, Math.floor(share * times.length))].toFixed(1);
  console.log(`${kind}: median ${at(0.5)} ms, 95 % below ${at(0.95)} ms, of ${times.length}`);
}
await browser.close();
