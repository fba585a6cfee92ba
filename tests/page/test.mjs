// Uses the page as people do, in a headless Chromium.
//
// Purpose: one function for each thing that the page promises. Invariant: every request of every test goes to the page's own
// server, no policy is violated, and nothing is complained of on the console that a test did not provoke.
// Usage: see run.sh, which sets PAGE, LOCKED, KEY, MESH, CHROMIUM, SERVER, CALLS and PICTURES.

import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync, symlinkSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { basename, delimiter, join } from "node:path";
import { chromium } from "playwright-core";

const { PAGE, LOCKED, KEY, MESH, CHROMIUM, SERVER, CALLS, PICTURES } = process.env;
const SLOW = { timeout: 120_000 };

const browser = await chromium.launch({
  executablePath: CHROMIUM,
  args: [
    "--headless", "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--enable-unsafe-swiftshader", "--use-gl=angle", "--use-angle=swiftshader",
  ],
});

/** Opens the page, and watches what it does. `provokes` is what the console may say. */
async function opened(use, { at = PAGE, provokes = /(?!)/, script, ...options } = {}) {
  const context = await browser.newContext({
    viewport: { width: 1280, height: 800 }, deviceScaleFactor: PICTURES ? 1 : 0.5, acceptDownloads: true, ...options,
  });
  const wrong = [];
  context.on("request", (request) => {
    const url = request.url();
    if (!url.startsWith(at) && !url.startsWith("blob:") && !url.startsWith("data:")) wrong.push(`a request left the page's server: ${url}`);
  });
  await context.exposeFunction("violated", (what) => wrong.push(`the policy was violated: ${what}`));
  await context.addInitScript(() => {
    addEventListener("securitypolicyviolation", (event) => window.violated(`${event.violatedDirective} ${event.blockedURI}`));
  });
  await context.addInitScript(() => {
    window.heard = [];
    new MutationObserver((changes) => {
      for (const { target } of changes) {
        const element = target.nodeType === 1 ? target : target.parentElement;
        if (element?.id) window.heard.push([element.id, element.textContent]);
      }
    }).observe(document, { subtree: true, childList: true, characterData: true });
  });
  if (script) await context.addInitScript(script);
  const page = await context.newPage();
  page.on("pageerror", (error) => wrong.push(`an error: ${error.stack}`));
  page.on("console", (message) => {
    // Reading back pixels for a screenshot is slow, and Chromium says so.
    const isDriver = /GPU stall due to ReadPixels|GL Driver Message/.test(message.text());
    if (["error", "warning"].includes(message.type()) && !isDriver && !provokes.test(message.text())) wrong.push(`the console: ${message.text()}`);
  });
  try {
    await page.goto(at);
    await use(page, at);
  } catch (error) {
    // What the page complained of may be why.
    error.stack += wrong.map((one) => `\n    and ${one}`).join("");
    throw error;
  } finally {
    await context.close();
  }
  assert.deepEqual(wrong, []);
}

/** Drops a file on the page, as a hand does. */
async function drop(page, name, bytes) {
  const transfer = await page.evaluateHandle(([name, text]) => {
    const transfer = new DataTransfer();
    transfer.items.add(new File([Uint8Array.from(atob(text), (c) => c.charCodeAt(0))], name));
    return transfer;
  }, [name, Buffer.from(bytes).toString("base64")]);
  // Anywhere will do. Over the views it is seen.
  await page.dispatchEvent("#stage", "dragenter", { dataTransfer: transfer });
  assert.ok(await page.locator("#viewer[data-over]").count(), "the views show that a file may be dropped");
  await page.dispatchEvent("#stage", "drop", { dataTransfer: transfer });
  assert.equal(await page.locator("#viewer[data-over]").count(), 0);
}

const text = (page, selector) => page.locator(selector).innerText();
const number = (words) => Number(words.replaceAll(",", ""));

/** Waits until an element's text matches. */
async function says(page, selector, pattern, timeout = SLOW.timeout) {
  const isSaid = ([selector, source]) => new RegExp(source).test(document.querySelector(selector)?.textContent ?? "");
  await page.waitForFunction(isSaid, [selector, pattern.source], { timeout }).catch(async () => {
    assert.match(await page.locator(selector).textContent(), pattern, selector);
  });
}

/** Waits until an element's text matches, or has matched: what passes quickly is found too. */
async function said(page, selector, pattern) {
  await page.waitForFunction(([selector, source]) => window.heard.some(([of, words]) => `#${of}` === selector && new RegExp(source).test(words)),
    [selector, pattern.source], SLOW);
}

const ended = (page) => page.waitForSelector("#download:not([hidden])", SLOW);
/** Both surfaces are shown and compared. */
const compared = (page) => page.waitForSelector("#colours-distance:enabled", { ...SLOW, state: "attached" });

async function message(page, pattern) {
  await page.waitForSelector("#message:not([hidden])", SLOW);
  const words = await text(page, "#message");
  assert.match(words, pattern);
  assert.doesNotMatch(words, /[{}]|spec\.|urn:|problem\+json|invalid_argument/, "words of the interface");
  assert.notEqual(await text(page, "#message-advice"), "");
  const { y } = await page.locator("#message").boundingBox();
  assert.ok(y >= 0 && y < page.viewportSize().height, "it is seen wherever the page is scrolled to");
  await page.click("#message-close");
  await page.waitForSelector("#message", { state: "hidden" });
}

/** Presses Remesh and waits until both surfaces are compared. */
async function remeshed(page) {
  await page.click("#go");
  await ended(page);
  await compared(page);
}

async function downloaded(page, selector = "#download") {
  const [download] = await Promise.all([page.waitForEvent("download"), page.click(selector)]);
  return { name: download.suggestedFilename(), bytes: readFileSync(await download.path()) };
}

const CLIPBOARD = { permissions: ["clipboard-read", "clipboard-write"] };

/** Prints the path in a call of `remesh`, if the function has all keywords of the call. */
const KEYWORDS = `
import ast, sys
known = next(node for node in ast.parse(open(sys.argv[1]).read()).body if getattr(node, "name", "") == "remesh").args
call = next(node for node in ast.walk(ast.parse(sys.stdin.read())) if isinstance(node, ast.Call) and node.func.attr == "remesh")
unknown = {one.arg for one in call.keywords} - {one.arg for one in known.args + known.kwonlyargs}
assert not unknown, unknown
print(ast.literal_eval(call.args[0]))
`;

/** The copied command and request give the bits of the page's download, and the call in Python has known keywords. */
async function copiesAreRight(page, name, input = octahedron) {
  const folder = mkdtempSync(join(tmpdir(), "page-"));
  try {
    symlinkSync(SERVER, join(folder, "tessera"));
    writeFileSync(join(folder, name), input);
    const env = { ...process.env, PATH: `${folder}${delimiter}${process.env.PATH}` };
    const { bytes } = await downloaded(page);
    const output = await page.getAttribute("#download", "download");
    for (const language of ["command", "curl"]) {
      await page.click(`[data-copy=${language}]`);
      await says(page, "#as-note", /^Copied/);
      const words = await page.textContent("#as-text");
      assert.equal(await page.evaluate(() => navigator.clipboard.readText()), words);
      rmSync(join(folder, output), { force: true });
      execFileSync("sh", ["-c", words], { cwd: folder, env, stdio: "pipe" });
      const isSame = readFileSync(join(folder, output)).equals(bytes);
      assert.ok(isSame || words.startsWith("# Not here: "), `${words}\ngives other bits`);
    }
    await page.click("[data-copy=python]");
    const path = execFileSync("python3", ["-c", KEYWORDS, CALLS], { input: await page.textContent("#as-text") }).toString().trimEnd();
    assert.equal(path, name.startsWith("-") ? `./${name}` : name);
  } finally {
    rmSync(folder, { recursive: true });
  }
}

const idOf = (page) => new URL(page.url()).hash.replace("#job=", "");
const json = async (url, init) => {
  const response = await fetch(url, init);
  assert.ok(response.ok, `${url}: ${response.status}`);
  return response.json();
};
const post = (url, value) => json(url, { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(value) });

async function fits(page) {
  const [wide, room] = await page.evaluate(() => [document.documentElement.scrollWidth, innerWidth]);
  assert.ok(wide <= room, `the page is ${wide} pixels wide on a screen of ${room}`);
}

async function picture(page, name, options = {}) {
  if (PICTURES) await page.screenshot({ path: join(PICTURES, `page-${name}.png`), ...options });
}

/** The counts in the head of a PLY file. */
function counts(bytes) {
  const head = bytes.subarray(0, bytes.indexOf("end_header\n")).toString("latin1");
  assert.match(head, /^ply\nformat binary_little_endian 1\.0\n/);
  return ["vertex", "face"].map((element) => Number(new RegExp(`element ${element} (\\d+)`).exec(head)?.[1]));
}

/** How different two pictures of an element are can be told by their bytes alone. */
const seen = (page, selector) => page.locator(selector).screenshot();

/** Waits until an element looks different from a picture of it, and gives the new picture. */
async function changed(page, selector, before, what) {
  for (const end = Date.now() + SLOW.timeout; Date.now() < end; await page.waitForTimeout(50)) {
    const now = await seen(page, selector);
    if (!now.equals(before)) return now;
  }
  assert.fail(what);
}

const octahedron = Buffer.from(
  "v 1 0 0\nv -1 0 0\nv 0 1 0\nv 0 -1 0\nv 0 0 1\nv 0 0 -1\n" +
    "f 1 3 5\nf 3 2 5\nf 2 4 5\nf 4 1 5\nf 3 1 6\nf 2 3 6\nf 4 2 6\nf 1 4 6\n",
);

/** A PLY text with three vertices and a face. */
const ascii = (face) =>
  "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n" +
  `element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n${face}\n`;

const tests = {
  async "a mesh is dropped, remeshed, compared and downloaded"() {
    await opened(async (page, at) => {
      let cells = 0;
      page.on("response", (response) => {
        if (/\/seeds\?/.test(response.url()) && response.status() === 200) cells++;
      });
      await page.waitForFunction(() => document.fonts.status === "loaded");
      await picture(page, "before");
      assert.ok(await page.isDisabled("#go"));
      await drop(page, basename(MESH), readFileSync(MESH));
      await says(page, "#input-counts", /vertices, .* facets/);
      await page.fill("#points", "3000");
      const plain = await seen(page, "#input-canvas");
      await page.click("#go");
      await said(page, "#input-legend", /^3,000 cells/);
      await picture(page, "during");
      await ended(page);
      await said(page, "#run-stage", /iteration \d+ of 35/);
      await said(page, "#chart-words", /after \d+ of 35 iterations/);
      await compared(page);
      assert.ok(cells >= 1, "cells came");
      await says(page, "#run-stage", /^Done/);
      await says(page, "#chart-words", /times that of regular hexagons .* below the first/);
      const cut = await page.evaluate(() => ["chart", "bars-q", "bars-angle"].flatMap((id) => {
        const box = document.getElementById(id).getBoundingClientRect();
        return [...document.querySelectorAll(`#${id} text`)].filter((one) => {
          const { left, right, top, bottom } = one.getBoundingClientRect();
          return left < box.left - 1 || right > box.right + 1 || top < box.top - 1 || bottom > box.bottom + 1;
        }).map((one) => `${id}: ${one.textContent}`);
      }));
      assert.deepEqual(cut, [], "labels are whole");
      assert.match(await page.textContent("#chart"), /^E \/ Ehex/);
      for (const id of ["bars-q", "bars-angle"]) assert.match(await page.getAttribute(`#${id}`, "aria-description"), /^Input: .* Remesh: most facets/);
      if (PICTURES) await page.waitForTimeout(500);
      await picture(page, "after", { fullPage: true });

      const figures = await page.locator("#figures tr").evaluateAll((rows) =>
        Object.fromEntries(rows.map((row) => [row.querySelector("th").textContent, [...row.querySelectorAll("td")].map((cell) => cell.textContent)])));
      const [vertices, facets] = [number(figures["Vertices"][1]), number(figures["Facets"][1])];
      assert.ok(Math.abs(vertices - 3000) <= 60, `${vertices} vertices`);
      assert.match(figures["Smallest angle"][1], /^\d+\.\d°$/);
      assert.match(figures["Hausdorff distance, of the diagonal"][1], /^[\d.]+ %$/);
      assert.match(figures["Time"][1], /s$/);

      // Colours.
      await page.click("label[for=colours-cells]");
      await changed(page, "#input-canvas", plain, "cells are drawn");
      await page.click("label[for=colours-quality]");
      await says(page, "#result-legend", /mean 0\.\d+; under 30°/);
      const quality = await seen(page, "#result-canvas");
      await page.click("label[for=colours-distance]");
      await says(page, "#result-legend", /% and more.*largest .* % of the diagonal/);
      const distance = await changed(page, "#result-canvas", quality, "distances are drawn");
      await page.check("#edges");
      await changed(page, "#result-canvas", distance, "edges are drawn");

      await page.click("label[for=colours-quality]");
      await page.click("label[for=layout-slider]");
      if (PICTURES) await page.waitForTimeout(500);
      await picture(page, "slider");
      await page.click("label[for=layout-pair]");

      // The download is the result, and what it says it is.
      const { name, bytes: file } = await downloaded(page);
      assert.match(name, /-remesh\.ply$/);
      const result = Buffer.from(await (await fetch(`${at}v1/jobs/${idOf(page)}/result`)).arrayBuffer());
      assert.deepEqual(file, result);
      assert.deepEqual(counts(file), [vertices, facets]);

      // The queue has it, and its link opens it on another page, with the form, the mesh and the cells.
      await says(page, "#queue", /3,000 points/);
      await page.reload();
      await ended(page);
      await says(page, "#result-counts", new RegExp(`^${figures["Vertices"][1]} vertices`));
      await says(page, "#input-counts", /vertices/);
      assert.equal(await page.inputValue("#points"), "3000");
      await page.waitForSelector("#colours-cells:enabled", { ...SLOW, state: "attached" });
      await page.click("label[for=colours-cells]");
      await says(page, "#input-legend", /^[\d,]+ cells, each the points nearest to its vertex/);
      await says(page, "#chart-words", /after \d+ of 35 iterations/);
    });
  },

  async "every format is offered and shown"() {
    await opened(async (page, at) => {
      const { components } = await json(`${at}v1/openapi.json`);
      const formats = components.schemas.Options.properties.to.enum;
      assert.ok(formats.includes("glb") && formats.length > 8);
      for (const format of formats) await says(page, "#welcome-formats", new RegExp(`\\b${format.toUpperCase()}\\b`));
      const offered = await page.locator("#to option").evaluateAll((options) => options.map(({ value }) => value));
      assert.deepEqual(offered.sort(), [...formats].sort());
      await drop(page, "octahedron.obj", octahedron);
      await page.fill("#points", "300");
      for (const format of formats) {
        await says(page, "#input-counts", /^6 vertices, 8 facets/);
        await page.selectOption("#to", format);
        await remeshed(page);
        await says(page, "#result-counts", /^(29\d|30\d) vertices/);
        const result = await text(page, "#result-counts");
        const { name, bytes } = await downloaded(page);
        assert.equal(name, `octahedron-remesh.${format}`);
        if (format === "glb") assert.equal(bytes.subarray(0, 4).toString("latin1"), "glTF");
        // Each result is an input too.
        await drop(page, `again.${format}`, bytes);
        await says(page, "#input-counts", new RegExp(`^${result}`));
        await drop(page, "octahedron.obj", octahedron);
      }
      // What was made to read files is gone.
      const kept = async () => (await json(`${at}v1/jobs?page_size=100`)).jobs.filter(({ spec }) => spec.labels?.["tessera-page"]);
      for (const end = Date.now() + SLOW.timeout; (await kept()).length > 0; await page.waitForTimeout(50)) assert.ok(Date.now() < end);
    });
  },

  async "samples are remeshed at once"() {
    await opened(async (page) => {
      const samples = await page.locator("[data-sample]").evaluateAll((all) => all.map((one) => one.dataset.sample));
      assert.equal(samples.length, 3);
      for (const sample of samples) {
        if (sample !== samples[0]) await page.goto(PAGE);
        await page.reload();
        assert.ok(await page.isVisible("#welcome"));
        await page.click(`[data-sample=${sample}]`);
        await says(page, "#input-counts", /^[\d,]+ vertices/);
        assert.ok(await page.isHidden("#welcome"));
        await remeshed(page);
        await says(page, "#figures-note", /are as in the input/);
        assert.ok(await page.isHidden("#warnings"), `${sample} has warnings`);
        assert.match(await text(page, "#result-counts"), /^(2,9|3,0)\d\d vertices/);
        const { name, bytes } = await downloaded(page, "#save");
        assert.equal(name, `${sample}.obj`);
        assert.match(bytes.toString("latin1"), /^v .*\n/);
      }
    });
  },

  async "all warnings are shown, with codes and places"() {
    await opened(async (page, at) => {
      const beyond = { code: "shared_points", message: "parts touch at `7` points", count: 9, places: Array.from({ length: 7 }, (_, i) => [i, 0.5, -1]) };
      await page.route("**/result?name=report", async (route) => {
        const response = await route.fetch();
        const report = await response.json();
        await route.fulfill({ response, json: { ...report, warnings: [...report.warnings, beyond] } });
      });
      await page.click("[data-sample=bent-box]");
      await says(page, "#input-counts", /vertices/);
      // A bound that cannot be met.
      await page.fill("#points", "60");
      await page.click("summary");
      await page.fill("#max_deviation", "0.00001");
      await remeshed(page);
      const { warnings } = await json(`${at}v1/jobs/${idOf(page)}/result?name=report`);
      assert.ok(warnings.length >= 1);
      await says(page, "#warnings-title", new RegExp(`^${warnings.length + 1} warnings$`));
      assert.ok(await page.isVisible("#warnings"));
      const codes = await page.locator("#warnings-list > li > p code").allInnerTexts();
      assert.deepEqual(codes, [...warnings, beyond].map(({ code }) => code));
      const last = page.locator("#warnings-list > li").last();
      assert.match(await last.innerText(), /Parts touch at 7 points\..*At \(0, 0\.5, -1\).*\(2, 0\.5, -1\) and 4 more; 9 in all/s);
      await last.locator("summary").click();
      assert.match(await last.innerText(), /\(3, 0\.5, -1\).*\(6, 0\.5, -1\)/s);
      await page.click("#go");
      await page.waitForSelector("#warnings", { state: "hidden" });
    });
  },

  async "a job fills the form, and Remesh repeats it"() {
    await opened(async (page, at) => {
      const { digest } = await json(`${at}v1/blobs`, { method: "POST", body: octahedron });
      const jobs = [
        { points: 250 },
        { points: 260, density: "curvature", adaptivity: 0.5, seed: 7, crease_angle: 40, boundaries: "free", lloyd: 3, newton: 4, to: "glb" },
        { points: 270, density: "lfs", gradation: 0.2, thin: "even", placement: "surface", projection: "surface", measure: "topology", attributes: false, backend: "serial" },
        { points: 280, max_deviation: 5, max_points: 400, to: "obj" },
        { edge_length: 0.4, density: "uniform" },
        { points: 240, max_deviation_length: 0.1 },
        { points_percent: 5000 },
        { facets: 500 },
        { points: 300, density: "error_max", anisotropy: "auto" },
        { points: 310, density: "error", anisotropy: 0.1 },
        { points: 330, strict_creases: true, source_map: true },
        { points: 320, keep: "sphere:0,0,-1,0.1", size_in: "sphere:0,0,1,0.5=0.2" },
        { points: 290, sizes: (await json(`${at}v1/blobs`, { method: "POST", body: ".3\n.4\n.5\n.3\n.4\n.5\n" })).digest,
          creases: (await json(`${at}v1/blobs`, { method: "POST", body: "0 2\n2 1\n" })).digest, gradation: 0.5 },
      ];
      for (const options of jobs) {
        const { id, spec } = await post(`${at}v1/jobs`, { mesh: digest, format: "obj", ...options, labels: { file: "octahedron.obj" } });
        await page.goto(`${at}#job=${id}`);
        await ended(page);
        await compared(page);
        for (const [name, value] of Object.entries(options)) {
          if (name === "points_percent") {
            assert.equal(await page.inputValue("#points"), `${value}%`);
            continue;
          }
          const field = page.locator(`[name=${name}]`);
          if (await field.count()) assert.equal(await field.inputValue(), value === "uniform" ? "" : String(value), name);
          else assert.match(await text(page, "#others"), new RegExp(name.replaceAll("_", " ") + (/^[0-9a-f]{64}$/.test(value) ? "" : ` ${value}`)));
        }
        await page.click("#go");
        await page.waitForFunction((id) => /^#job=/.test(location.hash) && !location.hash.endsWith(id), id, SLOW);
        const again = (await json(`${at}v1/jobs/${idOf(page)}`)).spec;
        // Defaults may be named or not.
        const plain = (all) => JSON.stringify({ ...all, remesh: { ...all.remesh, density: { source: "DENSITY_SOURCE_UNIFORM", ...all.remesh.density } } }, sorted);
        const sorted = (_, value) => (value && typeof value === "object" ? Object.fromEntries(Object.entries(value).sort()) : value);
        assert.equal(plain(again), plain({ ...spec, result: { file: spec.result.file } }));
        await ended(page);
        await compared(page);
        await copiesAreRight(page, "octahedron.obj");
        // The last copy is the call in Python, where a number has no quotes.
        if (options.anisotropy) assert.ok((await page.textContent("#as-text")).includes(`, anisotropy=${JSON.stringify(options.anisotropy)}`));
      }
      assert.ok(await page.isVisible("#others"));
      await page.click("#others-drop");
      assert.ok(await page.isHidden("#others"));
    }, CLIPBOARD);
  },

  async "regions of the input are ticked to stay"() {
    await opened(async (page, at) => {
      const lines = octahedron.toString().split("\n");
      const halves = [...lines.slice(0, 6), "usemtl Top:glass", ...lines.slice(6, 10), "usemtl base", ...lines.slice(10)].join("\n");
      await drop(page, "halves.obj", Buffer.from(halves));
      await says(page, "#input-counts", /^6 vertices/);
      await page.click("summary");
      assert.deepEqual(await page.locator("#regions label").allInnerTexts(), ["Top:glass", "base"]);
      const [top, base] = [0, 1].map((k) => page.locator("#regions input").nth(k));
      await base.check();
      await top.check();
      assert.equal(await page.inputValue("#keep"), "base; region:Top:glass");
      await page.fill("#keep", "base");
      assert.deepEqual([await top.isChecked(), await base.isChecked()], [false, true]);
      await page.fill("#points", "250");
      await remeshed(page);
      const { spec } = await json(`${at}v1/jobs/${idOf(page)}`);
      assert.deepEqual(spec.remesh.keep, ["base"]);
      const report = await json(`${at}v1/jobs/${idOf(page)}/result?name=report`);
      assert.ok(report.result.kept.facets >= 4, JSON.stringify(report.result.kept));
      await copiesAreRight(page, "halves.obj", halves);
      await page.fill("#keep", "");
      await page.reload();
      await ended(page);
      await compared(page);
      assert.equal(await page.inputValue("#keep"), "base");
      assert.ok(await base.isChecked());
      await drop(page, "octahedron.obj", octahedron);
      await says(page, "#input-counts", /^6 vertices/);
      assert.ok(await page.isHidden("#regions"));
    }, CLIPBOARD);
  },

  async "a copied call gives the same bits"() {
    await opened(async (page) => {
      const cases = [
        ["octahedron.obj", {}, { points: "300" }],
        ["it's a $(mesh) `x` & \"y\".obj", { to: "glb", density: "curvature" }, { points: "250", seed: "9", adaptivity: "0.5", crease_angle: "20" }],
        ["-o.obj", { to: "off", boundaries: "free", density: "" }, { points: "260", lloyd: "3", newton: "2", max_deviation: "3" }],
        ["no extension", { to: "ply" }, { points: "0.2k", max_deviation: "" }],
        ["share.obj", { to: "obj" }, { points: "4000%" }],
        ["long.obj", { density: "error", anisotropy: "auto" }, { points: "300" }],
      ];
      await page.click("summary");
      for (const [name, choices, values] of cases) {
        await drop(page, name, octahedron);
        await says(page, "#input-counts", /^6 vertices/);
        for (const [field, value] of Object.entries(choices)) await page.selectOption(`#${field}`, value);
        for (const [field, value] of Object.entries(values)) await page.fill(`#${field}`, value);
        await remeshed(page);
        await copiesAreRight(page, name);
      }
    }, CLIPBOARD);
  },

  async "one view with a slider, standard views, the wheel, full screen"() {
    await opened(async (page) => {
      await page.click("[data-sample=three-holes]");
      await says(page, "#input-counts", /vertices/);
      assert.ok(await page.isDisabled("#layout-slider"), "there is nothing to slide between");
      let before = await seen(page, "#input-canvas");
      const turned = async (what) => (before = await changed(page, "#input-canvas", before, what));
      // The wheel zooms without a click, and the page stays where it is.
      await page.hover("#input-canvas");
      await page.mouse.wheel(0, -300);
      await turned("the wheel zooms");
      assert.equal(await page.evaluate(() => scrollY), 0);
      for (const stand of ["front", "top", "side", "iso"]) {
        await page.click(`[data-stand=${stand}]`);
        await turned(`${stand} is another view`);
      }
      await page.selectOption("#up", "z");
      await turned("the other axis is up");
      await remeshed(page);
      await page.click("label[for=layout-slider]");
      const [a, b] = await page.evaluate(() => ["input", "result"].map((side) => JSON.stringify(document.getElementById(`${side}-canvas`).getBoundingClientRect())));
      assert.equal(a, b, "both are at one place");
      const half = await seen(page, "#views");
      await page.focus("#split");
      for (let i = 0; i < 20; i++) await page.keyboard.press("ArrowRight");
      const more = await changed(page, "#views", half, "the slider moves");
      const box = await page.locator("#split").boundingBox();
      await page.mouse.move(box.x + 21 + 0.7 * (box.width - 42), box.y + box.height / 2);
      await page.mouse.down();
      await page.mouse.move(box.x + 0.2 * box.width, box.y + box.height / 2, { steps: 4 });
      await page.mouse.up();
      await changed(page, "#views", more, "the slider is dragged");
      assert.ok(Number(await page.inputValue("#split")) < 0.3);
      await page.click("#full");
      await page.waitForFunction(() => document.fullscreenElement?.id === "viewer");
      await says(page, "#full", /^Leave/);
      const [height, room] = await page.evaluate(() => [document.getElementById("input-canvas").clientHeight, innerHeight]);
      assert.ok(height > 0.6 * room, `${height} of ${room} pixels`);
      await page.click("#full");
      await page.waitForFunction(() => document.fullscreenElement === null);
    });
  },

  async "files of other programs are shown"() {
    await opened(async (page) => {
      const far = (x) => (5_000_000 + x).toFixed(3);
      const shown = {
        // Coordinates far from the origin need more digits than single precision has.
        "far.obj": [`v ${far(0)} 0 0\nv ${far(0.001)} 0 0\nv ${far(0)} 0.001 0\nf 1/1 2/2 3/3\n`, /^3 vertices, 1 facets/],
        "polygon.obj": ["o a\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv .5 2 0\nv 0 1 0\nf -5 -4 -3 -2 -1\no b\nv 0 0 1\nf 1 2 6\n", /^6 vertices, 4 facets/],
        "loose.ply": [ascii("3 0 1 2").replace("vertex 3", "vertex 4").replace("0 1 0\n", "0 1 0\n9 9 9\n"), /^3 vertices, 1 facets/],
        "text.stl": ["solid s\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1e0 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid s\n", /^3 vertices, 1 facets/],
        // What the page cannot read, the server reads.
        "pentagon.ply": [ascii("5 0 1 2 3 4").replace("vertex 3", "vertex 5").replace("0 1 0\n", "1 1 0\n.5 2 0\n0 1 0\n"), /^5 vertices, 3 facets/],
        "square.mesh": ["MeshVersionFormatted 2\nDimension 3\nVertices\n4\n0 0 0 0\n1 0 0 0\n1 1 0 0\n0 1 0 0\nTriangles\n2\n1 2 3 0\n1 3 4 0\nEnd\n", /^4 vertices, 2 facets/],
        "square.off": ["# comment\nCOFF\n4 1 0\n0 0 0 1 0 0 1\n1 0 0 1 0 0 1\n1 1 0 1 0 0 1\n0 1 0 1 0 0 1\n4 0 1 2 3 0 1 0\n", /^4 vertices, 2 facets/],
      };
      for (const [name, [text, counts]] of Object.entries(shown)) {
        await drop(page, name, text);
        await says(page, "#file-name", new RegExp(name));
        await says(page, "#input-counts", counts);
      }
      // Its facets have one shape, however far away they are.
      await drop(page, "far.obj", shown["far.obj"][0]);
      await says(page, "#figures", /45\.0°/);
    });
  },

  async "by keyboard alone"() {
    await opened(async (page) => {
      const focus = () => page.evaluate(() => document.activeElement?.id ?? "");
      const to = async (id, key = "Tab") => {
        for (let presses = 0; presses < 40; presses++) {
          if ((await focus()) === id) return;
          await page.keyboard.press(key);
        }
        assert.fail(`${id} cannot be reached by ${key}`);
      };
      await to("file");
      // The dialog for files is the system's.
      await page.setInputFiles("#file", { name: "octahedron.obj", mimeType: "text/plain", buffer: octahedron });
      await says(page, "#input-counts", /^6 vertices/);
      await to("points");
      await page.keyboard.press("Control+A");
      await page.keyboard.type("400");
      await to("density");
      await page.keyboard.press("ArrowDown");
      assert.equal(await page.inputValue("#density"), "curvature");
      await to("to");
      await page.keyboard.press("Tab");
      await page.keyboard.press("Enter");
      await to("seed");
      await page.keyboard.type("7");
      await to("go");
      await page.keyboard.press("Enter");
      await ended(page);
      await compared(page);
      await page.waitForFunction(() => document.querySelector("input[name=colours]:checked").value === "quality", null, SLOW);
      await to("colours-quality");
      await page.keyboard.press("ArrowLeft");
      assert.equal(await page.evaluate(() => document.querySelector("input[name=colours]:checked").value), "cells");
      await to("edges");
      await page.keyboard.press("Space");
      assert.ok(await page.isChecked("#edges"));
      await to("input-canvas");
      for (const key of ["ArrowRight", "ArrowUp", "Shift+ArrowLeft", "+", "-", ",", "0"]) {
        const before = await seen(page, "#result-canvas");
        await page.keyboard.press(key);
        await changed(page, "#result-canvas", before, `${key} moves both views`);
      }
      await to("download");
      const [download] = await Promise.all([page.waitForEvent("download"), page.keyboard.press("Enter")]);
      assert.ok(counts(readFileSync(await download.path()))[0] > 300);
      const isRing = await page.evaluate(() => getComputedStyle(document.activeElement).outlineStyle !== "none");
      assert.ok(isRing, "the focus is seen");
    });
  },

  async "on a phone, dark and light, at rest"() {
    for (const colorScheme of ["dark", "light"]) {
      await opened(async (page) => {
        await fits(page);
        await drop(page, "octahedron.obj", octahedron);
        await says(page, "#input-counts", /^6 vertices/);
        await page.fill("#points", "500");
        await page.click("#go");
        await ended(page);
        await compared(page);
        await page.click("summary");
        await fits(page);
        const [ground, words] = await page.evaluate(() => [getComputedStyle(document.body).backgroundColor, getComputedStyle(document.body).color]);
        const light = (colour) => /\d+/.exec(colour)[0] > 128;
        assert.equal(light(ground), colorScheme === "light");
        assert.notEqual(light(words), light(ground));
        assert.equal(await page.evaluate(() => document.getAnimations().length), 0, "nothing moves");
      }, { viewport: { width: 360, height: 740 }, hasTouch: true, isMobile: true, colorScheme, reducedMotion: "reduce" });
    }
  },

  async "labels, names and contrast"() {
    for (const colorScheme of ["light", "dark"]) {
      await opened(async (page) => {
        const bare = await page.evaluate(() =>
          [...document.querySelectorAll("input, select, button, a, canvas, progress, dialog, section")].filter((one) => {
            const by = one.getAttribute("aria-labelledby")?.split(" ").every((id) => document.getElementById(id)?.textContent);
            return !by && !one.getAttribute("aria-label") && !(one.labels?.length > 0) && !one.textContent.trim();
          }).map((one) => one.outerHTML));
        assert.deepEqual(bare, []);
        const faint = await page.evaluate(() => {
          const channels = (colour) => (colour.match(/[\d.]+/g) ?? []).map(Number);
          const light = (colour) => {
            const [r, g, b] = channels(colour).map((c) => (c / 255 <= 0.04045 ? c / 255 / 12.92 : ((c / 255 + 0.055) / 1.055) ** 2.4));
            return 0.2126 * r + 0.7152 * g + 0.0722 * b;
          };
          const ground = (element) => {
            for (let one = element; one; one = one.parentElement) {
              const colour = getComputedStyle(one).backgroundColor;
              if ((channels(colour)[3] ?? 1) > 0) return colour;
            }
            return "rgb(255 255 255)";
          };
          return [...document.querySelectorAll("body *")].filter((one) => {
            const isText = [...one.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim() !== "");
            const isOff = one.closest(":disabled") || document.getElementById(one.getAttribute("for"))?.disabled;
            if (!isText || !one.checkVisibility() || isOff) return false;
            const [a, b] = [light(getComputedStyle(one).color), light(ground(one))];
            return (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05) < 4.5;
          }).map((one) => one.outerHTML);
        });
        assert.deepEqual(faint, []);
      }, { colorScheme });
    }
  },

  async "wrong files and options give a message, and the page goes on"() {
    await opened(async (page) => {
      await drop(page, "notes.txt", "a letter");
      await message(page, /could not be opened.*no mesh file.*The server reads obj, ply, stl, off/s);
      await drop(page, "empty.obj", "");
      await message(page, /The file empty\.obj is empty/);
      await drop(page, "broken.obj", "v 0 0 0\nv 1 0 x\nv 0 1 0\nf 1 2 3\n");
      await message(page, /broken\.obj cannot be read.*line 2.*three numbers/s);
      await page.click("#go");
      await message(page, /failed|did not start/);
      await drop(page, "head.ply", "ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty float x\nend_header\n");
      await message(page, /shorter than its head says/);
      await drop(page, "cut.ply", "ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nend_header\nxxxx");
      await message(page, /no PLY file, or it is damaged/);
      await drop(page, "beyond.ply", ascii("3 0 1 7"));
      await message(page, /vertex 7/);
      await drop(page, "bad.glb", "glTFxxxx");
      await message(page, /bad\.glb cannot be read.*The file cannot be read: .*cut off/s);
      await drop(page, "cut.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n");
      await message(page, /ends early/);
      await drop(page, "packed.obj.gz", Buffer.from([0x1f, 0x8b, 8, 0, 1, 2, 3]));
      await message(page, /cannot be unpacked/);
      await drop(page, "octahedron.obj", octahedron);
      await says(page, "#input-counts", /^6 vertices/);
      for (const wrong of ["0", "", "many", "1,5", "-3", "2.5", "0%", "3 points"]) {
        await page.fill("#points", wrong);
        await page.click("#go");
        assert.ok(await page.isVisible("#points-error"), wrong);
        assert.equal(await page.getAttribute("#points", "aria-invalid"), "true");
      }
      await page.fill("#points", "200");
      assert.equal(await page.locator("#points-error").count(), 0);
      await page.click("#go");
      await ended(page);
    }, { provokes: /status of 400|status of 409|status of 422/ });
  },

  async "a server that goes away"() {
    await opened(async (page) => {
      await drop(page, "octahedron.obj", octahedron);
      await says(page, "#input-counts", /^6 vertices/);
      await page.fill("#points", "200");
      await page.route("**/v1/blobs*", (route) => route.abort());
      await page.click("#go");
      await message(page, /does not answer/);
      await page.unroute("**/v1/blobs*");
      // A watch that is cut goes on.
      let cuts = 0;
      await page.route("**/events", (route) => (cuts++ === 0 ? route.abort() : route.continue()));
      await page.click("#go");
      await ended(page);
      assert.ok(cuts >= 2);
    }, { provokes: /Failed to load resource/ });
  },

  async "a job is cancelled"() {
    await opened(async (page) => {
      await drop(page, basename(MESH), readFileSync(MESH));
      await page.fill("#points", "20000");
      await page.click("summary");
      await page.fill("#newton", "3000");
      await page.click("#go");
      await says(page, "#run-stage", /iteration/);
      // Loaded again, the page shows the job at work, with its cells.
      await page.reload();
      await says(page, "#input-legend", /^20,000 cells, each the points nearest to its seed/);
      await says(page, "#run-stage", /iteration/);
      assert.equal(await page.inputValue("#newton"), "3000");
      await page.click("#cancel");
      await says(page, "#run-stage", /was cancelled/);
      assert.ok(await page.isHidden("#cancel"));
      await says(page, "#queue", /cancelled/);
    });
  },

  async "without WebGL it remeshes and downloads"() {
    await opened(async (page) => {
      await page.waitForSelector("#no-webgl", { ...SLOW, state: "visible" });
      await drop(page, "octahedron.obj", octahedron);
      await page.fill("#points", "200");
      await page.click("#go");
      await ended(page);
      const [download] = await Promise.all([page.waitForEvent("download"), page.click("#download")]);
      assert.ok(counts(readFileSync(await download.path()))[0] > 100);
    }, {
      provokes: /WebGL/,
      script: () => {
        const before = HTMLCanvasElement.prototype.getContext;
        HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
          return /webgl/.test(kind) ? null : before.call(this, kind, ...more);
        };
      },
    });
  },

  async "a server with keys asks for one"() {
    await opened(async (page) => {
      await page.waitForSelector("#key-dialog[open]", SLOW);
      await page.fill("#key", "tsr_wrong");
      await page.keyboard.press("Enter");
      await says(page, "#key-note", /does not take this key/);
      await page.fill("#key", KEY);
      await page.keyboard.press("Enter");
      await page.waitForSelector("#key-dialog", { state: "hidden" });
      await drop(page, "octahedron.obj", octahedron);
      await page.fill("#points", "200");
      await page.click("#go");
      await ended(page);
      const kept = await page.evaluate(() => localStorage.length + sessionStorage.length + document.cookie.length);
      assert.equal(kept, 0);
      assert.ok(!page.url().includes(KEY));
    }, { at: LOCKED, provokes: /status of 401/ });
  },
};

let failed = 0;
for (const [name, test] of Object.entries(tests)) {
  if (process.argv[2] && !name.includes(process.argv[2])) continue;
  try {
    await test();
    console.log(`page: ${name}: ok`);
  } catch (error) {
    failed++;
    console.error(`page: ${name}: FAILED\n${error.stack}`);
  }
}
await browser.close();
process.exit(failed > 0 ? 1 : 0);
