// Looks at every page of the site in Chromium, from file://, with the network cut.
//
// node tests/docs_site/site.mjs SITE: exit code 1 where a link or an anchor leads nowhere, a page asks for anything
// outside, says something on the console, is wider than a window, or has a serious fault for axe; or where the search
// finds nothing.

import { readdirSync, readFileSync, statSync } from "node:fs";
import { createRequire } from "node:module";
import { dirname, join, relative, resolve } from "node:path";
import { fileURLToPath, pathToFileURL } from "node:url";

const required = createRequire(new URL("../face/browser/package.json", import.meta.url));
const { chromium } = required("playwright-core");
const AXE = required.resolve("axe-core");
const SITE = resolve(process.argv[2]);
const WIDTHS = [1280, 400]; // px: a desk and a telephone
const BROWSER = ["/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"].find(isThere);

/** All files of the site with an ending. */
function files(ending, folder = SITE) {
  return readdirSync(folder, { withFileTypes: true }).flatMap((entry) => {
    const path = join(folder, entry.name);
    return entry.isDirectory() ? files(ending, path) : path.endsWith(ending) ? [path] : [];
  });
}

const faults = [];
const outside = new Set();
// Live pages are tested by `make test-face`, and what stands under _static is the theme's.
const pages = files(".html").filter((path) => !/_downloads|_static/.test(path));
const texts = new Map(pages.map((path) => [path, readFileSync(path, "utf8")]));
const anchors = new Map([...texts].map(([path, text]) => [path, new Set([...text.matchAll(/\sid="([^"]+)"/g)].map((m) => m[1]))]));

function isThere(path) {
  try {
    return statSync(path).isFile();
  } catch {
    return false;
  }
}

for (const [path, text] of texts) {
  for (const [, link] of text.matchAll(/\s(?:href|src)="([^"]*)"/g)) {
    if (/^(https?:|mailto:)/.test(link)) outside.add(link);
    if (link === "" || /^(https?:|mailto:|data:|javascript:)/.test(link)) continue;
    const there = new URL(link.replaceAll("&amp;", "&"), pathToFileURL(path));
    const file = fileURLToPath(new URL(there.pathname, "file://"));
    const anchor = decodeURIComponent(there.hash.slice(1));
    if (!isThere(file)) faults.push(`${relative(SITE, path)}: ${link} leads nowhere`);
    else if (anchor && anchors.has(file) && !anchors.get(file).has(anchor)) {
      faults.push(`${relative(SITE, path)}: there is no ${link}`);
    }
  }
}

const browser = await chromium.launch({ executablePath: BROWSER, args: ["--no-sandbox"] });
for (const javaScriptEnabled of [true, false]) {
  for (const width of WIDTHS) {
    const context = await browser.newContext({ javaScriptEnabled, viewport: { width, height: 900 } });
    await context.route(/^(?!file:|data:|blob:)/, (route) => {
      faults.push(`a page asks for ${route.request().url()}`);
      return route.abort();
    });
    const page = await context.newPage();
    let here = "";
    page.on("console", (said) => ["error", "warning"].includes(said.type()) && faults.push(`${here}: ${said.text()}`));
    page.on("pageerror", (error) => faults.push(`${here}: ${error.message}`));
    for (const path of pages) {
      here = relative(SITE, path);
      await page.goto(pathToFileURL(path).href);
      if (!javaScriptEnabled) {
        if (!/search|genindex/.test(here) && !(await page.locator("h1").first().isVisible())) faults.push(`${here}: shows no title without scripts`);
        continue;
      }
      const wide = await page.evaluate(() => document.documentElement.scrollWidth - window.innerWidth);
      if (wide > 0) faults.push(`${here}: ${wide} px wider than ${width}`);
      if (width !== WIDTHS[0]) continue;
      await page.addScriptTag({ path: AXE });
      const { violations } = await page.evaluate(() => window.axe.run(document, { resultTypes: ["violations"], preload: false }));
      for (const one of violations.filter((one) => ["serious", "critical"].includes(one.impact))) {
        faults.push(`${here}: axe: ${one.id}: ${one.nodes[0].html.slice(0, 120)}`);
      }
    }
    if (javaScriptEnabled && width === WIDTHS[0]) {
      await page.goto(`${pathToFileURL(join(SITE, "search.html")).href}?q=retroreflective`);
      await page.locator("#search-results li").first().waitFor({ timeout: 20_000 }).catch(() => faults.push("the search finds nothing"));
    }
    await context.close();
  }
}
await browser.close();

for (const one of [...new Set(faults)]) console.error(one);
console.log(`${pages.length} pages, ${outside.size} links outside:`);
for (const link of [...outside].sort()) console.log(`  ${link}`);
process.exit(faults.length ? 1 : 0);
