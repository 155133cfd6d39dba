// A new user's way: from a fresh clone to a turned knob by one command, `make face`.
//
//     node scripts/face_first_knob.mjs
//
// Prints wall times and the load of the machine. Needs what `make test-face` has installed.

import { execFileSync, spawn } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync } from "node:fs";
import { loadavg, tmpdir } from "node:os";
import { join } from "node:path";
import { fileURLToPath } from "node:url";
import { chromium } from "../tests/face/browser/node_modules/playwright-core/index.mjs";

const ROOT = fileURLToPath(new URL("../", import.meta.url));
const folder = mkdtempSync(join(tmpdir(), "face-first-"));
const start = Date.now();
const tell = (what) => console.log(`${((Date.now() - start) / 1000).toFixed(1).padStart(7)} s  ${what}`);
execFileSync("git", ["clone", "--quiet", ROOT, join(folder, "radwrap")]);
tell("cloned");
// make's own child is ended by the signal to its group, as Ctrl-C in a terminal does.
const made = spawn("make", ["face", "ARGS=--no-browser"], { cwd: join(folder, "radwrap"), detached: true, stdio: ["ignore", "ignore", "pipe"] });
try {
  let said = "";
  made.stderr.setEncoding("utf8");
  made.stderr.on("data", (text) => { said += text; });
  while (!said.includes("/link\n")) {
    if (made.exitCode !== null) throw new Error(said);
    await new Promise((resolve) => { setTimeout(resolve, 50); });
  }
  tell("set up, and the link is told");
  const browser = await chromium.launch({ executablePath: "/usr/bin/chromium", args: ["--no-sandbox", "--disable-gpu"] });
  const page = await browser.newPage({ viewport: { width: 1440, height: 900 } });
  await page.goto(readFileSync(said.match(/\/\S+\/link/)[0], "utf8").trim());
  const frames = () => page.evaluate(() => Number(document.getElementById("picture").dataset.frames ?? 0));
  await page.waitForFunction(() => Number(document.getElementById("picture").dataset.frames) > 0, undefined, { timeout: 300_000 });
  tell(`first picture (${await page.textContent("#kept")})`);
  const before = await frames();
  await page.locator('[data-knob="level:all"] input[type=range]').press("ArrowLeft");
  while (await frames() === before) await new Promise((resolve) => { setTimeout(resolve, 5); });
  tell("a knob is turned, and the picture with it");
  await page.waitForFunction(() => document.getElementById("state").textContent === "measured", undefined, { timeout: 300_000 });
  tell(`picture of the asked tolerance (${await page.textContent("#error")})`);
  await browser.close();
} finally {
  process.kill(-made.pid, "SIGTERM");
  await new Promise((resolve) => { if (made.exitCode === null) made.once("exit", resolve); else resolve(); });
  rmSync(folder, { recursive: true, force: true });
}
console.log(`load of the machine: ${loadavg()[0].toFixed(1)}`);
