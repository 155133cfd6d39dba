// The pictures of docs/face.md: the page of the bench board in headless Chromium.
//
//     node scripts/face_pictures.mjs [FOLDER]
//
// FOLDER is docs where none is named. Needs what `make test-face` has installed.

import { spawn } from "node:child_process";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { fileURLToPath } from "node:url";
import { chromium } from "../tests/face/browser/node_modules/playwright-core/index.mjs";

const ROOT = fileURLToPath(new URL("../", import.meta.url));
const out = process.argv[2] ?? join(ROOT, "docs");
const browser = await chromium.launch({ executablePath: "/usr/bin/chromium", args: ["--no-sandbox", "--disable-gpu"] });
const server = spawn(join(ROOT, ".venv/bin/radwrap"), ["face", "rad_scenes/bench_board/scene.toml", "--no-browser"],
  { stdio: ["ignore", "ignore", "pipe"], cwd: ROOT });
try {
  let said = "";
  server.stderr.setEncoding("utf8");
  server.stderr.on("data", (text) => { said += text; });
  while (!said.includes("/link\n")) await new Promise((resolve) => { setTimeout(resolve, 20); });
  const link = readFileSync(said.match(/\/\S+\/link/)[0], "utf8").trim();
  for (const [name, colorScheme] of [["face", "light"], ["face_turned", "dark"], ["face_photo", "light"]]) {
    const viewport = { width: 1280, height: name === "face_photo" ? 1180 : 860 };
    const page = await (await browser.newContext({ viewport, colorScheme })).newPage();
    const measured = () => page.waitForFunction(() => document.getElementById("state").textContent === "measured", undefined,
      { timeout: 300_000 });
    await page.goto(link);
    await measured();
    await page.focus("#picture");
    for (const key of ["ArrowRight", "h"]) await page.keyboard.press(key);
    if (name === "face_turned") {
      // A third more exposure, one LED nearly out: saturated pixels, and those that flip.
      for (const [knob, text] of [["exposure_time", "520 ms"], ["level:ring.led03", "0.1"]]) {
        const field = page.locator(`[data-knob="${knob}"] input[type=text]`);
        await field.fill(text);
        await field.press("Enter");
      }
      await page.focus("#picture");
      for (const key of ["s", "x"]) await page.keyboard.press(key);
      await measured();
    }
    if (name === "face_photo") {
      // A photo that is 9 % brighter: here the page's own picture with the light turned up.
      const level = page.locator('[data-knob="level:all"] input[type=text]');
      await level.fill("1.1");
      await level.press("Enter");
      await measured();
      const [png] = await Promise.all([page.waitForEvent("download"), page.click("#png")]);
      await level.fill("1");
      await level.press("Enter");
      await measured();
      await page.setInputFiles("#photo", { name: "capture_0001.png", mimeType: "image/png", buffer: readFileSync(await png.path()) });
      await page.waitForFunction(() => /^the photo/.test(document.getElementById("photoof").textContent));
      await page.click("#matters");
      await page.waitForFunction(() => /^measured anew/.test(document.getElementById("matteringof").textContent), undefined, { timeout: 300_000 });
      await page.click("#layout summary");
      await page.focus("#picture");
      await page.keyboard.press("g");
      await page.evaluate(() => scrollTo(0, 0));
    }
    await page.waitForFunction(() => document.querySelector("#profile canvas") && document.querySelector("#probe table"));
    await page.waitForTimeout(500); // plots are drawn some frames later
    await page.screenshot({ path: join(out, `${name}.png`) });
    await page.close();
  }
} finally {
  server.kill("SIGTERM");
  await browser.close();
}
