// The page in a real browser, as its users turn it; run by `make test-face`.

import assert from "node:assert/strict";
import { execFile, spawn } from "node:child_process";
import { existsSync, mkdirSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { fileURLToPath } from "node:url";
import { promisify } from "node:util";
import axe from "axe-core";
import { chromium } from "playwright-core";

const ROOT = fileURLToPath(new URL("../../../", import.meta.url));
const RADWRAP = join(ROOT, ".venv/bin/radwrap");
const CHROMIUM = ["/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"].find((path) => existsSync(path));
const QUIET = ["--no-sandbox", "--disable-background-networking", "--disable-component-update", "--disable-default-apps",
  "--disable-sync", "--no-first-run"];
const SCENE = join(ROOT, "rad_scenes/bench_board/scene.toml");
const PATIENCE = Number(process.env.FACE_PATIENCE ?? 60_000); // ms; a busy machine traces the bench board in ten seconds
const run = promisify(execFile);

let folder, server, link, port, opens;

const serve = (...more) => served([RADWRAP], more);

/** A server by the command, or by a Python program that begins as it does. */
async function served([program, ...words], more) {
  const process = spawn(program, [...words, "face", SCENE, "--no-browser", ...more], { stdio: ["ignore", "ignore", "pipe"] });
  let said = "";
  process.stderr.setEncoding("utf8");
  while (!said.includes("/link\n")) {
    said += await new Promise((resolve, reject) => {
      process.stderr.once("data", resolve);
      process.once("exit", () => reject(new Error(said)));
    });
  }
  const place = said.match(/\/\S+\/link/)[0];
  return { process, link: readFileSync(place, "utf8").trim(), opens: place.replace(/link$/, "open.html") };
}

before(async () => {
  assert.ok(CHROMIUM, "there is no Chromium: on Debian, apt install chromium");
  folder = mkdtempSync(join(tmpdir(), "face-test-"));
  ({ process: server, link, opens } = await serve("--out", join(folder, "out")));
  port = new URL(link).port;
});

after(async () => {
  const ended = new Promise((resolve) => { server.once("exit", resolve); });
  server.kill("SIGTERM");
  assert.equal(await ended, 130);
  rmSync(folder, { recursive: true, force: true });
});

/** A page whose every fault but the expected ones, and every request to another place, fails the test. */
async function opened(t, { flags = [], at = link, expected = null, size = { width: 1440, height: 900 }, ...context } = {}) {
  const browser = await chromium.launch({ executablePath: CHROMIUM, args: [...QUIET, ...flags] });
  const page = await (await browser.newContext({ viewport: size, acceptDownloads: true, ...context })).newPage();
  const faults = [];
  page.on("pageerror", (error) => faults.push(error.stack));
  page.on("console", (message) => { if (message.type() === "error") faults.push(message.text()); });
  await page.route("**/*", (route) => {
    const url = new URL(route.request().url());
    if (["blob:", "data:", "file:"].includes(url.protocol) || url.hostname === "127.0.0.1") return route.continue();
    faults.push(`asked ${url}`);
    return route.abort();
  });
  await page.addInitScript(() => {
    document.addEventListener("securitypolicyviolation", (event) => console.error(`policy: ${event.violatedDirective} ${event.blockedURI}`));
  });
  t.after(async () => {
    await browser.close();
    assert.deepEqual(faults.filter((text) => !expected?.test(text)), []);
  });
  page.setDefaultTimeout(PATIENCE);
  await page.goto(at);
  return { page, faults, browser };
}

const measured = (page) => page.waitForFunction(() => document.getElementById("state").textContent === "measured",
  undefined, { timeout: PATIENCE });

async function loaded(t, options) {
  const all = await opened(t, options);
  await measured(all.page);
  return all;
}

/** The newest frame is on the canvas: a changed layout is drawn anew within two frames of the browser. */
async function redrawn(page) {
  await page.evaluate(() => new Promise((resolve) => { requestAnimationFrame(() => requestAnimationFrame(resolve)); }));
  await page.waitForFunction(() => document.getElementById("picture").ariaBusy === "false", undefined, { timeout: PATIENCE });
}

/** Codes on the canvas at 1 : 1, as rows of the picture. */
async function picture(page, rows, columns) {
  await page.focus("#picture");
  await page.keyboard.press("1");
  await page.waitForFunction(() => document.getElementById("zoom").textContent === "1 : 1");
  await redrawn(page);
  return page.evaluate(([height, wide]) => {
    const canvas = document.getElementById("image");
    const pen = canvas.getContext("2d");
    const { data } = pen.getImageData(0, 0, canvas.width, canvas.height);
    let first = 0;
    while (data[4 * first + 3] === 0) first++;
    const [left, top] = [first % canvas.width, Math.floor(first / canvas.width)];
    return Array.from({ length: height }, (_, v) =>
      Array.from({ length: wide }, (_, u) => data[4 * ((top + v) * canvas.width + left + u)]));
  }, [rows, columns]);
}

/** Codes of a gray.png, by radwrap's own reader. */
async function codesOf(path) {
  const code = "import json, sys; from pathlib import Path; from radwrap.images import read_image;"
    + "print(json.dumps(read_image(Path(sys.argv[1]))[0].tolist()))";
  const { stdout } = await run(join(ROOT, ".venv/bin/python"), ["-c", code, path], { maxBuffer: 1 << 26 });
  return JSON.parse(stdout);
}

const field = (page, name) => page.locator(`[data-knob="${name}"] input[type=text]`);
const slider = (page, name) => page.locator(`[data-knob="${name}"] input[type=range]`);

async function type(page, name, text) {
  await field(page, name).fill(text);
  await field(page, name).press("Enter");
}

for (const [name, flags] of [["without WebGL", ["--disable-gpu"]], ["with WebGL in software", ["--enable-unsafe-swiftshader"]]]) {
  test(`the canvas shows what the command of the page writes, ${name}`, async (t) => {
    const { page } = await loaded(t, { flags });
    await type(page, "level:ring.led03", "0.25");
    await type(page, "exposure_time", "300 ms");
    await type(page, "gamma", "0.7");
    await measured(page);
    const words = (await page.textContent("#command")).split(" && ").at(-1);
    assert.match(words, /^radwrap relight \S+ --level ring.led03=0.25 --set 'camera.exposure_time=300 ms'/);
    const argv = [...words.matchAll(/'([^']*)'|(\S+)/g)].map(([, quoted, plain]) => quoted ?? plain).slice(1);
    argv[argv.length - 1] = join(folder, `turned ${name}`);
    await run(RADWRAP, argv);
    const written = await codesOf(join(folder, `turned ${name}`, "gray.png"));
    assert.deepEqual(await picture(page, 165, 192), written);
    // Pinned: the server's word, on the very pixel.
    for (let k = 0; k < 9; k++) await page.keyboard.press("Shift+ArrowRight");
    await page.waitForSelector("#probe table");
    const probe = page.locator("#probe .code");
    const [u, v] = [Number(await probe.getAttribute("data-u")), Number(await probe.getAttribute("data-v"))];
    assert.equal(Number(await probe.textContent()), written[v][u]);
    await page.keyboard.press("ArrowLeft");
    await page.waitForFunction((u) => document.querySelector("#probe .code").dataset.u === String(u - 1), u);
    assert.equal(Number(await probe.textContent()), written[v][u - 1]);
    // gray.png and the profile, as they are downloaded.
    const [png] = await Promise.all([page.waitForEvent("download"), page.click("#png")]);
    assert.deepEqual(readFileSync(await png.path()), readFileSync(join(folder, `turned ${name}`, "gray.png")));
    await page.focus("#picture");
    await page.keyboard.press("h");
    await page.waitForSelector("#csv:enabled");
    const [csv] = await Promise.all([page.waitForEvent("download"), page.click("#csv")]);
    const rows = readFileSync(await csv.path(), "utf8").trim().split("\n").slice(1).map((line) => line.split(",").map(Number));
    assert.deepEqual(rows.map(([, , , code]) => code), written[v]);
  });
}

test("a knob by mouse, by keys and by its text is one state", async (t) => {
  const { page } = await loaded(t);
  const knob = slider(page, "level:all");
  const box = await knob.boundingBox();
  await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
  await page.mouse.down();
  for (let k = 0; k <= 10; k++) await page.mouse.move(box.x + box.width * (0.5 + 0.03 * k), box.y + box.height / 2);
  await page.mouse.up();
  const byMouse = await field(page, "level:all").inputValue();
  assert.ok(Number(byMouse) > 1.3);
  await page.click("#undo"); // a drag is one step
  assert.equal(await field(page, "level:all").inputValue(), "1");
  await page.click("#redo");
  assert.equal(await field(page, "level:all").inputValue(), byMouse);
  await measured(page);
  const command = await page.textContent("#command");
  await page.click("#reset");
  assert.equal(await field(page, "level:ring.led07").inputValue(), "1");
  await knob.focus();
  const steps = Math.round((Number(byMouse) - 1) * 100);
  for (let k = 0; k < steps; k++) await page.keyboard.press("ArrowRight");
  assert.equal(await field(page, "level:all").inputValue(), byMouse);
  await measured(page);
  assert.equal(await page.textContent("#command"), command);
  await page.keyboard.press("Home");
  assert.equal(await field(page, "level:ring.led00").inputValue(), "0");
  await page.keyboard.press("Control+z");
  assert.equal(await field(page, "level:all").inputValue(), byMouse);
  await page.click("#reset");
  await type(page, "level:all", byMouse);
  await measured(page);
  assert.equal(await page.textContent("#command"), command);
  // The ring map turns the same knobs.
  const led = page.locator(".ring [role=slider]").nth(4);
  await led.focus();
  await page.keyboard.press("Enter");
  assert.equal(await field(page, "level:ring.led04").inputValue(), "0");
  assert.equal(await field(page, "level:all").inputValue(), "mixed");
  await page.locator(`[data-knob="level:ring.led04"] button`).click();
  assert.equal(await field(page, "level:ring.led04").inputValue(), "1");
});

test("what is wrong is said at its field, and the picture stays", async (t) => {
  const { page } = await loaded(t, { expected: /422/ }); // the browser's own word on a refusal
  const before = await picture(page, 20, 20);
  for (const [name, text, says] of [["exposure_time", "5 mm", '"mm" is not a unit of time'], ["exposure_time", "nan s", "exposure_time"],
    ["exposure_time", "1e300 s", "must be at most"], ["exposure_time", `${"1".repeat(400)} ms`, "at most 64 characters"],
    ["gain", "NaN", "gain factor is a number"], ["gain", "1e300", "gain factor is a number"], ["gain", "1".repeat(400), "gain factor is a number"],
    ["gamma", "1 mm", "gamma is a number"], ["bit_depth", "8.5", "whole number"], ["level:ring.led01", "-1", "a level is a number"]]) {
    await type(page, name, text);
    const wrong = page.locator(`[data-knob="${name}"] .wrong`);
    await wrong.waitFor({ state: "visible" });
    assert.ok((await wrong.textContent()).includes(says), `${name}: ${await wrong.textContent()}`);
    assert.equal(await field(page, name).getAttribute("aria-invalid"), "true");
    assert.deepEqual(await picture(page, 20, 20), before);
    await page.locator(`[data-knob="${name}"] button`).click();
    await measured(page);
  }
});

test("overlays, histogram and the numbers in the pixels tell one story", async (t) => {
  const { page } = await loaded(t);
  await type(page, "level:all", "3");
  await measured(page);
  await page.locator("#histogramtable").locator("xpath=..").locator("summary").click();
  await page.focus("#picture");
  for (const key of ["s", "x", "d"]) await page.keyboard.press(key);
  await page.waitForFunction(() => document.getElementById("flipsshare").textContent !== "");
  const counts = await page.$$eval("#histogramtable td", (cells) => cells.map((cell) => Number(cell.textContent)));
  assert.equal(counts.reduce((all, count) => all + count, 0), 165 * 192);
  const told = JSON.parse(await page.evaluate(async () => {
    const headers = { Authorization: `Bearer ${sessionStorage.getItem("token")}`, "Content-Type": "application/json" };
    const { described } = await (await fetch("/api/watch", { method: "POST", headers, body: "{}" })).json();
    const answer = await fetch("/api/turn", { method: "POST", headers,
      body: JSON.stringify({ basis: described.basis, turn: { levels: new Array(12).fill(3) } }) });
    return new TextDecoder().decode(new Uint8Array(await answer.arrayBuffer())).split("\n")[0];
  }));
  await page.waitForFunction((share) => document.getElementById("saturatedshare").textContent === share,
    `${(100 * told.saturated_fraction).toFixed(1)} %`);
  // The scale is fixed: black 0, white full scale, whatever the light.
  assert.deepEqual([await page.inputValue("#low"), await page.inputValue("#high")], ["0", "255"]);
  while ((await page.textContent("#zoom")) !== "32 : 1") await page.keyboard.press("+");
  // No number stands in the pixels before it is drawn, soon after the picture.
  await page.waitForFunction(() => document.getElementById("marks").getContext("2d").getImageData(0, 0, 400, 400).data
    .some((value) => value > 0));
  assert.ok((await page.textContent("#kept")).includes("tolerance 0.5"));
});

test("a number that a field does not take is marked, counts for nothing, and goes once it is left", async (t) => {
  const { page } = await loaded(t);
  const flips = () => page.textContent("#flipsshare");
  await page.check("#flips");
  await page.fill("#share", "10");
  await page.waitForFunction(() => Number.parseFloat(document.getElementById("flipsshare").textContent) > 20);
  await redrawn(page);
  const before = await flips();
  for (const text of ["-1", "0", "1000000000", ""]) {
    await page.fill("#share", text);
    assert.equal(await page.getAttribute("#share", "aria-invalid"), "true", text);
    await redrawn(page);
    await page.waitForTimeout(120); // what stands beside the picture follows it
    assert.equal(await flips(), before);
    await page.press("#share", "Enter");
    assert.deepEqual([await page.inputValue("#share"), await page.getAttribute("#share", "aria-invalid")], ["10", null]);
  }
  await page.focus("#picture");
  for (const key of ["ArrowRight", "h"]) await page.keyboard.press(key);
  for (const [id, usual, wrong] of [["profilewidth", "1", ["0", "2", "101", "-3"]], ["low", "0", [""]], ["high", "255", [""]]]) {
    for (const text of wrong) {
      await page.fill(`#${id}`, text);
      await page.waitForSelector(`#${id}[aria-invalid=true]`);
      await page.press(`#${id}`, "Enter");
      assert.equal(await page.inputValue(`#${id}`), usual);
    }
  }
  await type(page, "bit_depth", "17");
  assert.match(await page.textContent("[data-knob=bit_depth]"), /bits are a whole number from 1 to 16/);
});

test("a region has its statistics, a profile its band and its table", async (t) => {
  const { page } = await loaded(t);
  await page.check("input[value=region]");
  const box = await page.locator("#picture").boundingBox();
  await page.mouse.move(box.x + 300, box.y + 250);
  await page.mouse.down();
  await page.mouse.move(box.x + 400, box.y + 310, { steps: 5 });
  await page.mouse.up();
  await page.waitForSelector("#probe caption:has-text('Region')", { state: "attached" });
  await page.check("input[value=profile]");
  await page.mouse.move(box.x + 200, box.y + 250);
  await page.mouse.down();
  await page.mouse.move(box.x + 500, box.y + 260, { steps: 5 });
  await page.mouse.up();
  await page.waitForSelector("#profile canvas");
  await page.locator("#profiletable").locator("xpath=..").locator("summary").click();
  assert.ok((await page.locator("#profiletable tbody tr").count()) > 50);
  assert.match(await page.locator("#profiletable tbody tr td:last-child").first().textContent(), /^0\.\d+$/);
  // A wide one has means of codes, which are no whole numbers.
  await page.fill("#profilewidth", "9");
  await page.waitForFunction(() => [...document.querySelectorAll("#profiletable tbody tr td:nth-child(4)")]
    .some((cell) => cell.textContent.includes(".")));
  // Black and white by dragging: to the right more contrast; the codes stay.
  const code = await page.locator("#probe").textContent();
  await page.check("input[value=window]");
  await page.mouse.move(box.x + 200, box.y + 250);
  await page.mouse.down();
  await page.mouse.move(box.x + 350, box.y + 250, { steps: 5 });
  await page.mouse.up();
  const [low, high] = [Number(await page.inputValue("#low")), Number(await page.inputValue("#high"))];
  assert.ok(low > 50 && high < 205 && high > low, `${low} to ${high}`);
  assert.ok(code.includes(await page.locator("#probe table").first().textContent()));
  await page.click("#fullscale");
  assert.deepEqual([await page.inputValue("#low"), await page.inputValue("#high")], ["0", "255"]);
});

test("A and B: blink, wipe, and a difference against its error", async (t) => {
  const { page } = await loaded(t);
  const [rows, columns] = [165, 192];
  const side = (name) => page.locator(`input[name=side][value=${name}]`);
  assert.ok(await side("wipe").isDisabled());
  const a = await picture(page, rows, columns);
  await page.keyboard.press("a");
  await type(page, "level:all", "0.5");
  await measured(page);
  const b = await picture(page, rows, columns);
  await page.keyboard.press("b");
  await redrawn(page);
  assert.deepEqual(await picture(page, rows, columns), a);
  await page.keyboard.press("b");
  await redrawn(page);
  assert.deepEqual(await picture(page, rows, columns), b);
  // A wipe in the middle: 192 columns stand in the middle of the canvas.
  await page.keyboard.press("t");
  await redrawn(page);
  const wiped = await picture(page, rows, columns);
  assert.deepEqual(wiped.map((row) => row.slice(0, 95)), a.map((row) => row.slice(0, 95)));
  assert.deepEqual(wiped.map((row) => row.slice(99)), b.map((row) => row.slice(99)));
  // The difference is that of the gray levels before rounding: half a code from the codes at each end.
  await page.focus("#picture");
  await page.keyboard.press("g");
  await page.waitForFunction(() => /B − A: /.test(document.getElementById("compared").textContent));
  const told = await page.textContent("#compared");
  const off = b.flatMap((row, v) => row.map((code, u) => code - a[v][u]));
  const [, share, least, largest, rms] = told.match(/B − A: ([\d.]+) % .* from (\S+) to (\S+) gray, ([\d.]+) rms/);
  assert.ok(Math.abs(Number(least) - Math.min(...off)) <= 1 && Math.abs(Number(largest) - Math.max(...off)) <= 1);
  assert.ok(Math.abs(Number(rms) - Math.sqrt(off.reduce((sum, one) => sum + one * one, 0) / off.length)) < 0.2);
  assert.ok(Number(share) > 10 && Number(share) <= (100 * off.filter((one) => one !== 0).length) / off.length + 0.1);
  await page.keyboard.press("ArrowRight");
  await page.waitForFunction(() => document.querySelectorAll("#probe .beside").length === 2);
  assert.match((await page.locator("#probe .beside").allTextContents()).join("; "), /^A: \d+, gray [\d.]+ ± [\d.]+; B − A: -[\d.]+ ± [\d.]+/);
  // Other bits are not compared; back at A's knobs there is no difference.
  await type(page, "bit_depth", "10");
  await measured(page);
  assert.match(await page.textContent("#compared"), /other bits/);
  await page.click("#toa");
  await measured(page);
  await page.waitForFunction(() => /0 % of .* from 0.00 to 0.00 gray, 0 rms/.test(document.getElementById("compared").textContent));
  assert.equal(await field(page, "level:all").inputValue(), "1");
  await side("blink").check();
  await page.waitForTimeout(1600);
  assert.ok(await side("blink").isChecked());
});

test("nothing blinks for who wants less motion", async (t) => {
  const { page } = await loaded(t, { reducedMotion: "reduce" });
  await page.focus("#picture");
  await page.keyboard.press("a");
  assert.ok(await page.locator("input[name=side][value=wipe]").isEnabled());
  assert.ok(await page.locator("input[name=side][value=blink]").isDisabled());
});

test("what algorithms read is told with its error, and of which knobs it is", async (t) => {
  const { page } = await loaded(t);
  assert.equal(await page.locator("#measured table").count(), 0);
  await page.click("#measure");
  const rows = page.locator("#measured tbody tr");
  await rows.first().waitFor();
  assert.deepEqual(await page.locator("#measured th[scope=row]").allTextContents(), ["dot error", "focal length", "contrast"]);
  assert.match(await rows.nth(1).textContent(), /^focal length12\.\d+ ± 0\.\d+ mm$/);
  assert.match(await page.textContent("#measuredof"), /as it is shown/);
  await type(page, "level:all", "0");
  await measured(page);
  assert.match(await page.textContent("#measuredof"), /before they were turned/);
  await page.click("#measure");
  await page.waitForFunction(() => /as it is shown/.test(document.getElementById("measuredof").textContent));
  assert.match(await rows.first().textContent(), /not found$/);
});

test("a knob that needs rays traces anew, coarse first, with the other knobs where they are", async (t) => {
  const own = await serve("--tolerance", "1");
  t.after(() => own.process.kill("SIGTERM"));
  const { page } = await loaded(t, { at: own.link, expected: /422/ });
  await page.focus("#picture");
  await page.keyboard.press("a");
  await type(page, "level:ring.led03", "0.5");
  await measured(page);
  const opening = page.locator('[data-knob="ray:camera.aperture.diameter"] input');
  assert.equal(await opening.inputValue(), "0.1 mm");
  await opening.fill("0.1 deg");
  await opening.press("Enter");
  await page.waitForFunction(() => document.querySelector("#rayknobs .wrong").textContent !== "");
  assert.match(await page.textContent("#rayknobs .wrong"), /camera.aperture.diameter/);
  assert.equal(await opening.getAttribute("aria-invalid"), "true");
  assert.equal(await page.textContent("#state"), "measured");
  const frames = [];
  await page.exposeFunction("told", (text) => { if (frames.at(-1) !== text) frames.push(text); });
  await page.evaluate(() => {
    const kept = document.getElementById("kept");
    new MutationObserver(() => { void globalThis.told(kept.textContent.replace(/:.*/, "")); }).observe(kept, { childList: true });
  });
  await opening.fill("0.2 mm");
  await opening.press("Enter");
  await page.waitForFunction(() => /diameter="0.2 mm"/.test(document.getElementById("command").textContent), undefined, { timeout: PATIENCE });
  await measured(page);
  assert.ok(frames.indexOf("coarse picture") >= 0 && frames.indexOf("coarse picture") < frames.indexOf("tolerance 1 kept"), String(frames));
  assert.equal(await opening.inputValue(), "0.2 mm");
  assert.equal(await field(page, "level:ring.led03").inputValue(), "0.5");
  assert.match(await page.textContent("#command"), /--level ring.led03=0.5 /);
  // A is still there; so is the way back.
  await page.focus("#picture");
  await page.keyboard.press("g");
  await page.waitForFunction(() => /B − A: [1-9]/.test(document.getElementById("compared").textContent));
  // Esc ends the next trace within half a second, and leaves a picture.
  await page.fill('[data-knob="ray:camera.aperture.diameter"] input', "0.3 mm");
  await page.keyboard.press("Enter");
  await page.waitForFunction(() => !document.getElementById("stop").hidden);
  await page.keyboard.press("Escape");
  await page.waitForFunction(() => document.getElementById("stop").hidden);
  const shown = () => page.locator('[data-knob="ray:camera.aperture.diameter"] input').inputValue();
  // A coarse picture that has come by then stays, with its values.
  const state = await page.textContent("#state");
  if (state.startsWith("stopped")) assert.equal(await shown(), state === "stopped, coarse" ? "0.3 mm" : "0.2 mm");
  // Back to the file's own opening, and there is nothing left to reset.
  await page.click("text=Reset rays");
  await page.waitForFunction(() => !/diameter/.test(document.getElementById("command").textContent), undefined, { timeout: PATIENCE });
  await measured(page);
  assert.equal(await shown(), "0.1 mm");
  assert.ok(await page.isDisabled("text=Reset rays"));
  assert.equal(await field(page, "level:ring.led03").inputValue(), "0.5");
  await page.click("text=Undo rays");
  await page.waitForFunction(() => /diameter=/.test(document.getElementById("command").textContent), undefined, { timeout: PATIENCE });
  assert.match(await shown(), /^0\.[23] mm$/);
});

test("a photo is held against the picture, and what is none is said", async (t) => {
  const { page } = await loaded(t, { expected: /422/ });
  const [png] = await Promise.all([page.waitForEvent("download"), page.click("#png")]);
  const gray = readFileSync(await png.path());
  const find = (name) => page.locator(`#photofound tr:has(th:text-is("${name}")) td`);
  const open = (name, buffer, mimeType = "image/png") => page.setInputFiles("#photo", { name, mimeType, buffer });
  for (const [name, buffer, says] of [["no.gif", Buffer.from("GIF89a0000"), "is none of PNG"], ["cut.png", gray.subarray(0, 900), "is not complete"]]) {
    await open(name, buffer);
    await page.waitForFunction((text) => document.getElementById("photoof").textContent.includes(text), says);
    assert.ok(await page.isDisabled("#compare"));
  }
  const name = "</b><script>alert(1)</script>.png"; // a name is text
  await open(name, gray);
  await page.waitForFunction(() => /^the photo .* less the picture as it is shown$/.test(document.getElementById("photoof").textContent));
  assert.ok((await page.textContent("#compared")).includes(name));
  assert.ok(Number((await find("rms").textContent()).split(" ")[0]) < 0.5); // rounding alone
  assert.equal(await find("pixels beyond 1.96 σ").textContent(), "0 % (5 % by chance)");
  // It is A: its codes on the canvas, and none of its pixels differs.
  await page.check("input[name=side][value=a]");
  await page.waitForFunction(() => document.querySelector("input[name=side][value=a]").checked);
  writeFileSync(join(folder, "photo.png"), gray);
  assert.deepEqual(await picture(page, 165, 192), await codesOf(join(folder, "photo.png")));
  await page.keyboard.press("g");
  await page.waitForFunction(() => /B − A: 0 % of the pixels/.test(document.getElementById("compared").textContent));
  await page.keyboard.press("ArrowRight");
  await page.waitForFunction(() => /photo: \d+/.test(document.getElementById("probe").textContent));
  assert.ok(await page.isDisabled("#toa"));
  // With half the light the photo is brighter, and exposure would explain it.
  await type(page, "level:all", "0.5");
  await page.waitForFunction(() => document.getElementById("photoof").textContent === "of the knobs before they were turned");
  await measured(page);
  await page.waitForFunction(() => /B − A: [1-9]/.test(document.getElementById("compared").textContent));
  await page.click("#compare");
  await page.waitForFunction(() => /mainly light or exposure: 1\.8\d* times/.test(document.getElementById("photofound").textContent)); // 2 ** 0.85
  assert.ok(Number((await find("mean").textContent()).split(" ")[0]) > 1);
  // A picture that is kept takes its place.
  await page.focus("#picture");
  await page.keyboard.press("a");
  assert.ok(await page.isDisabled("#compare"));
});

test("what matters is measured for the knobs as they stand, and a study stands beside it", async (t) => {
  const study = join(folder, "study");
  mkdirSync(study);
  const lines = Array.from({ length: 8 }, (_, k) => `${k},1,1,${"LH"[k % 2]},${"LH"[(k >> 1) % 2]},${12 + 4 * (k % 2) + (k >> 2) / 100},0.01`);
  writeFileSync(join(study, "results.csv"), `run,replicate,seed,A,<b>B</b>,f [mm],f_error [mm]\n${lines.join("\n")}\n`);
  const own = await serve("--tolerance", "2", "--study", study);
  t.after(() => own.process.kill("SIGTERM"));
  const { page } = await loaded(t, { at: own.link });
  assert.match(await page.textContent("#study"), /A moves f by 4\.0.*\*/s);
  assert.match(await page.textContent("#study"), /<b>B<\/b>/);
  const rows = async () => Object.fromEntries(await page.$$eval("#mattering .table tbody tr", (lines) =>
    lines.map((line) => [line.cells[0].textContent, Number(line.cells[1].textContent.replace("< ", ""))])));
  const anew = () => page.waitForFunction(() => /^measured anew/.test(document.getElementById("matteringof").textContent),
    undefined, { timeout: PATIENCE });
  await page.focus("#matters");
  await page.keyboard.press("Enter");
  await anew();
  const before = await rows();
  assert.ok(before["finite aperture"] > 0 && "diffraction" in before);
  await type(page, "gain", "0.5");
  await page.waitForFunction(() => document.getElementById("matteringof").textContent === "of the knobs before they were turned");
  await measured(page);
  await page.click("#matters");
  await anew();
  assert.ok(Math.abs((await rows())["finite aperture"] / before["finite aperture"] - 0.5) < 0.05);
  assert.match(await page.textContent("#mattering"), /exposure: /);
});

test("what accuracy costs is measured, stopped and gone on with, and stands in a table beside its plot", async (t) => {
  const { page } = await loaded(t, { expected: /422/ });
  const said = (text) => page.waitForFunction((wanted) => new RegExp(wanted).test(document.getElementById("tradeof").textContent),
    text, { timeout: PATIENCE });
  await page.fill("#trade-longest", "ten");
  await page.click("#trade-begin");
  await said('"ten" has no unit|is not a time');
  assert.equal(await page.getAttribute("#trade-longest", "aria-invalid"), "true");
  await page.fill("#trade-longest", "0.3 s");
  await page.focus("#trade-begin");
  await page.keyboard.press("Enter");
  await page.waitForFunction(() => document.getElementById("trade-progress").value > 0, undefined, { timeout: PATIENCE });
  assert.equal(await page.evaluate(() => document.activeElement.id), "trade-stop");
  await page.keyboard.press("Enter");
  await said("^stopped");
  assert.equal(await page.evaluate(() => document.activeElement.id), "trade-begin");
  // A server that has not heard of the end yet refuses another one.
  for (let tries = 0; tries < 50; tries++) {
    await page.keyboard.press("Enter");
    await page.waitForFunction(() => !/^(stopped|measuring$)/.test(document.getElementById("tradeof").textContent), undefined, { timeout: PATIENCE });
    if (!/under way/.test(await page.textContent("#tradeof"))) break;
    await page.waitForTimeout(100);
  }
  await said("^measured for the picture");
  const rows = await page.$$eval("#tradetable tbody tr", (lines) => lines.map((line) => [...line.cells].map((cell) => cell.textContent)));
  assert.ok(rows.length >= 5 && rows.some((row) => row[5] === "yes") && rows.some((row) => row[5] === "no"), JSON.stringify(rows));
  assert.match(await page.textContent("#tradenotes"), /(gray use|the most exact is) `method \S+ tolerance/);
  const drawn = await page.$eval("#tradeplot canvas", (canvas) =>
    canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data.some((value) => value > 0));
  assert.ok(drawn && await page.isHidden("#trade-stop") && await page.isHidden("#trade-progress"));
  await type(page, "gain", "0.5");
  await said("^of the knobs before they were turned");
  await page.evaluate(axe.source);
  assert.deepEqual(await page.evaluate(async () => (await axe.run("#whatmatters")).violations.map(({ id, nodes }) => [id, nodes[0].html])), []);
});

test("the layout is drawn, turned by keys and by dragging, and stands in a table", async (t) => {
  const { page } = await loaded(t);
  await page.click("#layout summary");
  const drawing = () => page.evaluate(() => {
    const canvas = document.getElementById("scene");
    const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    let sum = 0, filled = 0;
    for (let k = 0; k < data.length; k += 4) { filled += data[k + 3] > 0; sum = (sum * 31 + data[k] + 7 * data[k + 1] + 13 * data[k + 3]) % 1000003; }
    return { sum, filled };
  });
  await page.waitForFunction(() => Number(document.getElementById("scene").dataset.drawn) > 0);
  const first = await drawing();
  assert.ok(first.filled > 2000, "nothing is drawn");
  const seen = new Set([first.sum]);
  await page.focus("#scene");
  for (const key of ["ArrowRight", "ArrowUp", "a", "s", "c", "+"]) {
    await page.keyboard.press(key);
    seen.add((await drawing()).sum);
  }
  assert.equal(seen.size, 7);
  await page.keyboard.press("o");
  await page.keyboard.press("-");
  assert.equal((await drawing()).sum, first.sum);
  await page.locator("#scene").scrollIntoViewIfNeeded();
  const box = await page.locator("#scene").boundingBox();
  await page.mouse.move(box.x + 100, box.y + 100);
  await page.mouse.down();
  await page.mouse.move(box.x + 160, box.y + 120, { steps: 3 });
  await page.mouse.up();
  assert.notEqual((await drawing()).sum, first.sum);
  // What a pinned pixel sees is said and drawn; without beams there is less.
  await page.click('#views button[value="side"]');
  const side = await drawing();
  await page.focus("#picture");
  await page.keyboard.press("ArrowRight");
  await page.waitForSelector("#probe .sees");
  assert.match(await page.textContent("#probe .sees"), /^sees board, [\d.]+ mm away$/);
  assert.notEqual((await drawing()).sum, side.sum);
  await page.keyboard.press("Enter");
  await page.uncheck("#beams");
  assert.ok((await drawing()).filled < side.filled);
  // An LED that is out is not filled.
  const lit = (await drawing()).filled;
  await type(page, "level:all", "0");
  assert.ok((await drawing()).filled < lit);
  const rows = await page.$$eval("#layouttable tbody tr", (lines) => lines.map((line) => [...line.cells].map((cell) => cell.textContent)));
  assert.equal(rows.length, 14); // camera, board, twelve LEDs
  assert.ok(rows.some(([name, is]) => name === "board" && is === "target"));
});

test("the LED ring shines as the knobs stand, while its tab lives", async (t) => {
  const drive = join(folder, "drive.toml");
  writeFileSync(drive, 'count = 12\nwavelength = "850 nm"\nrated_current = "100 mA"\ndrive_current = "50 mA"\nmax_level = 0.8\n'
    + 'max_sum = 9.0\nmax_on_time = "60 s"\n');
  const intensity = (await run(join(ROOT, ".venv/bin/python"), ["-c", "import radwrap, sys;"
    + "print(2 * radwrap.load_scene(sys.argv[1]).emitters[0].radiant_intensity)", SCENE])).stdout.trim();
  const own = await serve("--tolerance", "2", "--led", drive, "--full-scale", `${intensity} W/sr`, "--emulate");
  t.after(() => own.process.kill("SIGTERM"));
  const { page } = await loaded(t, { at: own.link, expected: /422/ });
  const says = (text) => page.waitForFunction((part) => document.getElementById("ringsays").textContent.includes(part), text,
    { timeout: PATIENCE });
  assert.match(await page.textContent("#ringis"), /^12 LEDs of 850 nm, .*emulated, no light shines$/);
  await says("The ring is off.");
  await page.focus("#ringlight");
  await page.keyboard.press("Enter");
  await says("levels from 0.5 to 0.5, as it says itself");
  await type(page, "level:ring.led03", "0.25");
  await says("levels from 0.125 to 0.5");
  // Too much is refused, and the light stays.
  await type(page, "level:all", "1.8");
  await says("shines as before: ");
  const { page: other } = await loaded(t, { at: own.link, expected: /422/ });
  await other.click("#ringlight");
  await other.waitForFunction(() => document.getElementById("ringsays").textContent.includes("another tab holds the ring"));
  await page.close(); // its heart beats no more
  await other.waitForTimeout(2000);
  await other.click("#ringlight");
  await other.waitForFunction(() => document.getElementById("ringsays").textContent.includes("levels from 0.5 to 0.5"));
  await other.click("#ringlight");
  await other.waitForFunction(() => document.getElementById("ringsays").textContent === "The ring is off.");
});

test("a basis that is too large to mix: the picture follows when a knob rests", async (t) => {
  const code = "import radwrap.face.app as app, sys; app.MOST_PLANES = 1; from radwrap.cli.main import main; sys.exit(main())";
  const own = await served([join(ROOT, ".venv/bin/python"), "-c", code], ["--tolerance", "2"]);
  t.after(() => own.process.kill("SIGTERM"));
  const { page } = await opened(t, { at: own.link });
  const asked = [];
  page.on("request", (request) => asked.push(new URL(request.url()).pathname));
  await measured(page);
  const before = (await picture(page, 165, 192)).flat();
  await type(page, "level:all", "0.5");
  await page.waitForFunction(() => document.querySelector("#command").textContent.includes("ring=0.5"));
  await measured(page);
  const after = (await picture(page, 165, 192)).flat();
  assert.ok(after.every((one, k) => one <= before[k]) && after.some((one, k) => one < before[k]));
  assert.ok(!asked.includes("/api/planes"));
  assert.match(await page.textContent("#rays"), /too large to be mixed in the page/);
});

test("saving leaves files in the folder, and says where", async (t) => {
  const { page } = await loaded(t);
  await type(page, "level:all", "0.5");
  await measured(page);
  await page.click("#save");
  await page.waitForFunction(() => document.getElementById("saved").textContent.startsWith("saved in "));
  const place = (await page.textContent("#saved")).slice("saved in ".length);
  assert.ok(place.startsWith(join(folder, "out")) && existsSync(join(place, "scene.toml")) && existsSync(join(place, "gray.png")));
});

test("a bad link says what to do, and the token leaves the address", async (t) => {
  const { page } = await loaded(t);
  assert.equal(page.url(), `http://127.0.0.1:${port}/`);
  await page.focus(".skip");
  await page.keyboard.press("Enter"); // #picture is a place in the page, and no token
  await page.reload();
  await measured(page);
  const { page: other, faults } = await opened(t, { at: `http://127.0.0.1:${port}/` });
  await other.waitForSelector("#banner:not([hidden])");
  assert.match(await other.textContent("#banner"), /needs its link/);
  const { page: wrong } = await opened(t, { at: `http://127.0.0.1:${port}/#wrong`, expected: /401/ });
  await wrong.waitForSelector("#banner:not([hidden])");
  assert.match(await wrong.textContent("#banner"), /open the last one that radwrap face printed/);
  assert.deepEqual(faults, []);
});

test("the header says what the error does not hold, and its place is no token", async (t) => {
  const own = await serve("--set", "camera.diffraction=off");
  t.after(() => own.process.kill("SIGTERM"));
  const { page } = await loaded(t, { at: own.link });
  await page.click("#lacks");
  const lacks = async () => page.textContent("#lacks");
  assert.match(await lacks(), /not in it: diffraction \d\.\d gray rms$/);
  const before = Number((await lacks()).match(/[\d.]+/)[0]);
  await type(page, "gain", "0.5"); // no ray is needed: half the gray levels, half the lack
  await measured(page);
  assert.ok(Math.abs(Number((await lacks()).match(/diffraction ([\d.]+) gray rms$/)[1]) - before / 2) < 0.06);
  await type(page, "level:ring.led03", "0.25");
  await measured(page);
  assert.match(await lacks(), /gray rms, at the scene's own levels$/);
  await page.reload();
  await measured(page);
});

test("the file with the link opens the page", async (t) => {
  const { page } = await opened(t, { at: `file://${opens}` });
  await measured(page);
  assert.equal(page.url(), `http://127.0.0.1:${port}/`);
});

test("eight tabs work side by side", async (t) => {
  const { page } = await loaded(t);
  const tabs = [];
  for (let k = 0; k < 7; k++) {
    const tab = await page.context().newPage();
    await tab.goto(link);
    tabs.push(tab);
  }
  await Promise.all(tabs.map(measured));
  await type(tabs[3], "level:all", "0.25");
  await measured(tabs[3]);
  assert.equal(await field(tabs[4], "level:all").inputValue(), "1");
});

test("accessible: axe finds nothing serious, in light and dark, and all is reached by keys", async (t) => {
  for (const [colorScheme, size] of [["light", { width: 1440, height: 900 }], ["dark", { width: 1440, height: 900 }],
    ["light", { width: 380, height: 800 }]]) {
    const { page } = await loaded(t, { colorScheme, size, reducedMotion: "reduce" });
    await page.focus("#picture");
    await page.keyboard.press("h");
    await page.keyboard.press("ArrowRight");
    await page.waitForSelector("#probe table");
    for (const summary of await page.locator("summary").all()) await summary.click();
    await page.waitForSelector("#layouttable table");
    await page.click("#matters");
    await page.waitForFunction(() => /^measured anew/.test(document.getElementById("matteringof").textContent), undefined, { timeout: PATIENCE });
    // Not through a script element: the page's policy refuses it.
    await page.evaluate(axe.source);
    const { violations } = await page.evaluate(() => globalThis.axe.run());
    const serious = violations.filter(({ impact }) => impact === "serious" || impact === "critical");
    assert.deepEqual(serious.map(({ id, nodes }) => `${id}: ${nodes.map(({ html }) => html.slice(0, 120)).join(" | ")}`), []);
    const wide = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
    assert.ok(wide <= 0, `at ${size.width} px the page is ${wide} px too wide`);
  }
  const { page } = await loaded(t);
  const reached = new Set();
  for (let k = 0; k < 120; k++) {
    await page.keyboard.press("Tab");
    reached.add(await page.evaluate(() => document.activeElement?.id || document.activeElement?.getAttribute("aria-label") || ""));
  }
  for (const id of ["help", "picture", "save", "saturated", "map", "png", "copy", "share"]) assert.ok(reached.has(id), id);
  await page.focus("#picture");
  await page.keyboard.press("ArrowUp");
  await page.waitForFunction(() => /column \d+, row \d+: \d+/.test(document.getElementById("live").textContent));
  await page.keyboard.press("?");
  assert.ok(await page.locator("#dialog").isVisible());
});

test("the server's end is said, and knobs go on", async (t) => {
  const own = await serve();
  const { page } = await loaded(t, { at: own.link, expected: /ERR_/ });
  await redrawn(page); // the workers of the asked picture have come from the server
  own.process.kill("SIGKILL");
  const begin = Date.now();
  await page.waitForSelector("#banner:not([hidden])", { timeout: 5000 });
  assert.ok(Date.now() - begin < 4000);
  assert.match(await page.textContent("#banner"), /server has gone/);
  const before = (await picture(page, 165, 192)).flat();
  await type(page, "level:all", "0.5");
  await page.waitForFunction(() => /not measured/.test(document.getElementById("state").textContent));
  const after = (await picture(page, 165, 192)).flat();
  assert.ok(after.every((code, k) => code <= before[k]) && after.some((code, k) => code < before[k]));
  assert.match(await page.textContent("#state"), /not measured/);
});

test("a trace that ends with its server is not said to go on", async (t) => {
  const own = await serve("--tolerance", "2");
  const { page } = await loaded(t, { at: own.link, expected: /ERR_/ });
  await type(page, "ray:camera.position", "0 mm, 0 mm, 800 mm");
  await page.waitForFunction(() => /tracing/.test(document.getElementById("state").textContent));
  own.process.kill("SIGKILL");
  await page.waitForSelector("#banner:not([hidden])", { timeout: 5000 });
  assert.match(await page.textContent("#banner"), /server has gone/);
  assert.doesNotMatch(await page.textContent("#state"), /tracing/);
  // Fields are those of the picture that is there: the one before, or the coarse one of the new place.
  const coarse = /coarse/.test(await page.textContent("#kept"));
  assert.equal(await field(page, "ray:camera.position").inputValue(), `0 mm, 0 mm, ${coarse ? 800 : 790} mm`);
});

test("a coarse picture comes first, is marked, and hands its knobs on", async (t) => {
  const { page } = await opened(t, { at: "about:blank" }); // the browser is up before the trace begins
  const own = await serve("--tolerance", "0.2", "--out", join(folder, "coarse"));
  t.after(() => own.process.kill("SIGTERM"));
  // What is said of the error with each frame: a picture without one says so.
  await page.addInitScript(() => {
    window.told = [];
    document.addEventListener("DOMContentLoaded", () => {
      const look = new MutationObserver(() => { window.told.push(document.getElementById("error").textContent); });
      look.observe(document.getElementById("picture"), { attributeFilter: ["data-frames"] });
    });
  });
  await page.goto(own.link);
  await page.waitForFunction(() => document.getElementById("error").textContent.endsWith("(95 %)"));
  const told = await page.evaluate(() => window.told);
  assert.ok(told.length > 0 && told.every((text) => /^error (being measured|.* gray rms, below .*)$/.test(text)), told.join("; "));
  assert.equal(await page.textContent("#kept"), "coarse picture: tolerance 3.1, 3 × 3 pixels as one");
  assert.match(await page.textContent("#state"), /^coarse, tracing(, [\d.]+( thousand| million)? rays)?$/); // no share: it is not known
  assert.match(await page.textContent("#error"), /^error .* gray rms, below .*95 %/);
  for (const id of ["png", "toml", "save", "copy", "trace"]) assert.ok(!(await page.locator(`#${id}`).isVisible()), id);
  await type(page, "level:all", "0.5");
  await page.focus("#picture");
  await page.keyboard.press("h");
  await page.keyboard.press("ArrowRight");
  await page.keyboard.press("+");
  const zoom = await page.textContent("#zoom");
  await slider(page, "gain").focus();
  // The coarse picture stays on the canvas until there is a frame of the other one: it is never empty between them.
  await page.evaluate(() => {
    const image = document.getElementById("image");
    const look = () => {
      const { data } = image.getContext("2d").getImageData(image.width >> 1, image.height >> 1, 1, 1);
      if (data[3] === 0) image.dataset.empty = "yes";
      requestAnimationFrame(look);
    };
    look();
  });
  await measured(page);
  assert.match(await page.textContent("#kept"), /^tolerance 0.2 (not )?kept/);
  assert.equal(await page.locator("#image").getAttribute("data-empty"), null);
  assert.match(await page.textContent("#command"), /--level ring=0.5 --out turned/);
  assert.equal(await field(page, "level:all").inputValue(), "0.5");
  assert.equal(await page.textContent("#zoom"), zoom.replace(/^\d+/, (into) => String(Number(into) / 3))); // of 3 x 3 pixels
  assert.ok((await page.evaluate(() => document.activeElement.id)).startsWith("knob-gain"));
  await page.waitForSelector("#csv:enabled");
  assert.equal(await page.locator("#probe .code").getAttribute("data-u"), "100"); // the middle of block 192 / 3 / 2, and one to the right
  for (const id of ["png", "toml", "save", "copy"]) assert.ok(await page.locator(`#${id}`).isVisible(), id);
  await page.click("#undo");
  assert.equal(await field(page, "level:all").inputValue(), "1");
});

test("a trace in the light of the knobs takes their place", async (t) => {
  const own = await serve("--tolerance", "2");
  t.after(() => own.process.kill("SIGTERM"));
  const { page } = await loaded(t, { at: own.link, expected: /422/ });
  await page.focus("#picture");
  await page.keyboard.press("a");
  await type(page, "level:all", "0");
  await measured(page);
  await page.click("#trace");
  await page.waitForSelector("#banner:has-text('there is no light')");
  const other = await page.context().newPage();
  await other.goto(own.link);
  await measured(other);
  await page.bringToFront();
  await type(page, "level:all", "2");
  assert.ok(await page.isHidden("#banner")); // what it said was of other knobs
  await measured(page);
  await page.click("#trace");
  // The trace may be over before it is seen to go on.
  await page.waitForFunction(() => /basis_2/.test(document.getElementById("command").textContent), undefined, { timeout: PATIENCE });
  await measured(page);
  assert.equal(await field(page, "level:all").inputValue(), "1");
  // Another tab did not ask for it, and is told.
  await other.waitForSelector("#banner:not([hidden])", { state: "attached" });
  assert.match(await other.textContent("#banner"), /Another tab has traced the scene anew/);
  assert.ok(await page.isHidden("#banner"));
  // A stays, to be compared with; its knobs were those of another trace.
  await page.focus("#picture");
  await page.keyboard.press("g");
  await page.waitForFunction(() => /B − A: [1-9]/.test(document.getElementById("compared").textContent));
  assert.ok(await page.locator("#toa").isDisabled());
});

test("the page in one file works from a folder and in a notebook's frame", async (t) => {
  const file = join(folder, "page.html");
  await run(RADWRAP, ["face", SCENE, "--set", "title=</script><script>alert(1)</script>", "--tolerance", "2", "--export", file]);
  const { page } = await loaded(t, { at: `file://${file}` });
  assert.equal(await page.textContent("#title"), "</script><script>alert(1)</script>");
  assert.match(await page.textContent("#rays"), /has no server/);
  const before = await picture(page, 165, 192);
  await type(page, "level:all", "0.5");
  await type(page, "gamma", "0.7");
  await page.waitForFunction(() => document.getElementById("state").textContent.startsWith("turned"));
  const out = join(folder, "one-file");
  await run(RADWRAP, ["render", SCENE, "--tolerance", "2", "--basis", "--out", `${out}-basis`]);
  const { stdout } = await run(join(ROOT, ".venv/bin/python"), ["-c", "import sys; from radwrap.scene.file.load import load_scene;"
    + "from radwrap.imaging.page.turn import Turn, changes_of;"
    + "print(changes_of(Turn((), gamma=0.7), load_scene(sys.argv[1]).camera)['camera.sensor.gain'])", SCENE]);
  assert.deepEqual(before, await codesOf(`${out}-basis/gray.png`));
  await run(RADWRAP, ["relight", `${out}-basis`, "--level", "ring=0.5", "--set", "camera.sensor.gamma=0.7", "--set",
    `camera.sensor.gain=${stdout.trim()}`, "--out", out]);
  const [shown, written] = [(await picture(page, 165, 192)).flat(), (await codesOf(`${out}/gray.png`)).flat()];
  const off = shown.flatMap((code, k) => (code === written[k] ? [] : [Math.abs(code - written[k])]));
  assert.ok(off.length <= 1e-4 * shown.length && off.every((by) => by <= 1), `${off.length} codes differ`);
  for (const id of ["save", "trace", "png", "toml"]) assert.ok(!(await page.locator(`#${id}`).isVisible()), id);
  // In a frame of an origin of its own, as Rendered.page() is shown in a notebook.
  const html = readFileSync(file, "utf8").replaceAll("&", "&amp;").replaceAll('"', "&quot;");
  const framed = join(folder, "notebook.html");
  writeFileSync(framed, `<!doctype html><iframe sandbox="allow-scripts allow-downloads" width="1200" height="900" srcdoc="${html}"></iframe>`);
  const { page: notebook } = await opened(t, { at: `file://${framed}` });
  await notebook.frameLocator("iframe").locator("#state:has-text('measured')").waitFor();
});
