// Uses the page as people do, in a headless Chromium.
//
// Purpose: one function for each thing that the page promises. Invariant: every request of every test goes to the page's own
// server, no policy is violated, and nothing is complained of on the console that a test did not provoke.
// Usage: see run.sh, which sets PAGE, LOCKED, KEY, MESH, CHROMIUM and PICTURES.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { basename, join } from "node:path";
import { chromium } from "playwright-core";

const { PAGE, LOCKED, KEY, MESH, CHROMIUM, PICTURES } = process.env;
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
  const context = await browser.newContext({ viewport: { width: 1280, height: 800 }, acceptDownloads: true, ...options });
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
  await page.dispatchEvent("#drop", "dragenter", { dataTransfer: transfer });
  await page.dispatchEvent("#drop", "drop", { dataTransfer: transfer });
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
  assert.match(await text(page, "#message"), pattern);
  assert.notEqual(await text(page, "#message-advice"), "");
  await page.click("#message-close");
  await page.waitForSelector("#message", { state: "hidden" });
}

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
      await says(page, "#chart-words", /below the first/);
      if (PICTURES) await page.waitForTimeout(500);
      await picture(page, "after");

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
      await says(page, "#result-legend", /largest .* % of the diagonal/);
      const distance = await changed(page, "#result-canvas", quality, "distances are drawn");
      await page.check("#edges");
      await changed(page, "#result-canvas", distance, "edges are drawn");

      // The download is the result, and what it says it is.
      const [download] = await Promise.all([page.waitForEvent("download"), page.click("#download")]);
      assert.match(download.suggestedFilename(), /-remesh\.ply$/);
      const file = readFileSync(await download.path());
      const id = new URL(page.url()).hash.replace("#job=", "");
      const result = Buffer.from(await (await fetch(`${at}v1/jobs/${id}/result`)).arrayBuffer());
      assert.deepEqual(file, result);
      assert.deepEqual(counts(file), [vertices, facets]);

      // The queue has it, and its link opens it on another page.
      await says(page, "#queue", /3,000 points/);
      await page.reload();
      await ended(page);
      await says(page, "#result-counts", new RegExp(`^${figures["Vertices"][1]} vertices`));
      await says(page, "#input-counts", /vertices/);
    });
  },

  async "every format of a result is shown"() {
    await opened(async (page) => {
      await drop(page, "octahedron.obj", octahedron);
      await page.fill("#points", "300");
      for (const format of ["obj", "stl", "off", "ply"]) {
        await says(page, "#input-counts", /^6 vertices, 8 facets/);
        await page.selectOption("#to", format);
        await page.click("#go");
        await ended(page);
        await compared(page);
        await says(page, "#result-counts", /^(29\d|30\d) vertices/);
        const [download] = await Promise.all([page.waitForEvent("download"), page.click("#download")]);
        assert.equal(download.suggestedFilename(), `octahedron-remesh.${format}`);
        // Each result is an input too.
        const bytes = readFileSync(await download.path());
        await drop(page, `again.${format}`, bytes);
        await says(page, "#input-counts", /^(29\d|30\d) vertices/);
        await drop(page, "octahedron.obj", octahedron);
      }
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
      await page.setInputFiles("#file", { name: "octahedron.obj", mimeType: "model/obj", buffer: octahedron });
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
      await message(page, /broken\.obj cannot be shown.*coordinate is no finite number/s);
      await page.click("#go");
      await message(page, /failed|did not start/);
      await drop(page, "head.ply", "ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty float x\nend_header\n");
      await message(page, /shorter than its head says/);
      await drop(page, "cut.ply", "ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nend_header\nxxxx");
      await message(page, /no PLY file, or it is damaged/);
      await drop(page, "beyond.ply", ascii("3 0 1 7"));
      await message(page, /face names vertex 7/);
      await drop(page, "pentagon.ply", ascii("5 0 1 2 1 0"));
      await message(page, /neither triangles nor quadrilaterals/);
      await drop(page, "cut.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n");
      await message(page, /ends early/);
      await drop(page, "packed.obj.gz", Buffer.from([0x1f, 0x8b, 8, 0, 1, 2, 3]));
      await message(page, /cannot be unpacked/);
      await drop(page, "octahedron.obj", octahedron);
      await says(page, "#input-counts", /^6 vertices/);
      await page.fill("#points", "0");
      await page.click("#go");
      assert.ok(await page.isVisible("#points-error"));
      assert.equal(await page.getAttribute("#points", "aria-invalid"), "true");
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
