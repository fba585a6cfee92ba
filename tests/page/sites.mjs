// Pages of other sites in a headless Chromium: none uses a server without keys.
//
// Purpose: one function for each kind of page: of another site, by a name that resolves to this machine (DNS rebinding), of an
// allowed site, and the server's own. Invariant: what a page may not do has no effect at the server either.
// Usage: see run.sh, which sets PAGE, FRIENDLY (a server with --cors-origin http://friend.example) and CHROMIUM.

import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { chromium } from "playwright-core";

const { PAGE, FRIENDLY, CHROMIUM } = process.env;
const { port } = new URL(PAGE);
const MESH = "v 1 1 1\nv 1 -1 -1\nv -1 1 -1\nv -1 -1 1\nf 1 2 3\nf 1 4 2\nf 1 3 4\nf 2 4 3\n";
const digest = (text) => createHash("sha256").update(text).digest("hex");

const browser = await chromium.launch({
  executablePath: CHROMIUM,
  args: [
    "--headless", "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--host-resolver-rules=MAP *.example 127.0.0.1",
    // The browser's own protection, which not all browsers have.
    "--disable-features=LocalNetworkAccessChecks,PrivateNetworkAccessSendPreflights,BlockInsecurePrivateNetworkRequests",
  ],
});

/** Opens an empty page of a site: it never comes from the server. */
async function of_site(origin) {
  const page = await browser.newPage();
  await page.route(`${origin}/attack`, (route) => route.fulfill({ contentType: "text/html", body: "<!doctype html><title>a</title>" }));
  await page.goto(`${origin}/attack`);
  return page;
}

/** What becomes of a request of a page: its status, `opaque`, or `blocked`. */
const ask = (page, url, options) =>
  page.evaluate(async ([url, options]) => {
    try {
      const answer = await fetch(url, options);
      return answer.type === "opaque" ? "opaque" : answer.status;
    } catch {
      return "blocked";
    }
  }, [url, options]);

const has = async (server, text) => (await fetch(`${server}v1/blobs/${digest(text)}`)).status === 200;
const jobs = async (server) => (await (await fetch(`${server}v1/jobs`)).json()).jobs.map((job) => job.id);

/** Makes a job, as a program does. */
async function job(server) {
  const stored = await fetch(`${server}v1/blobs`, { method: "POST", body: MESH });
  assert.equal(stored.status, 201);
  const body = JSON.stringify({ mesh: digest(MESH), format: "obj", points: 20 });
  const made = await fetch(`${server}v1/jobs`, { method: "POST", body, headers: { "content-type": "application/json" } });
  assert.equal(made.status, 201, await made.clone().text());
  const { id } = await made.json();
  while (!["succeeded", "failed"].includes((await (await fetch(`${server}v1/jobs/${id}`)).json()).state)) await new Promise((go) => setTimeout(go, 20));
  return id;
}

const JSON_BODY = { method: "POST", body: "{}", headers: { "content-type": "application/json" } };

async function a_page_of_another_site() {
  const id = await job(PAGE);
  const page = await of_site("http://evil.example");
  for (const [path, options] of [
    ["v1/jobs", {}],
    ["v1/jobs", JSON_BODY],
    [`v1/jobs/${id}`, { method: "DELETE" }],
    ["v1/blobs", { method: "POST", body: "cors" }],
    ["v1/openapi.json", {}],
    ["readyz", {}],
  ]) {
    assert.equal(await ask(page, PAGE + path, options), "blocked", `${options.method} ${path}`);
  }
  // What a page sends without asking first, and cannot read the answer of.
  for (const body of ["no-cors", MESH + "# by a page\n"]) {
    assert.equal(await ask(page, `${PAGE}v1/blobs`, { method: "POST", mode: "no-cors", body }), "opaque");
    assert.equal(await ask(page, `${PAGE}v1/remesh?points=9`, { method: "POST", mode: "no-cors", body }), "opaque");
    assert.ok(!(await has(PAGE, body)), "it was stored");
  }
  await page.evaluate((action) => {
    const form = Object.assign(document.createElement("form"), { method: "post", action, enctype: "text/plain", target: "frame" });
    form.append(Object.assign(document.createElement("input"), { name: "form" }));
    document.body.append(Object.assign(document.createElement("iframe"), { name: "frame" }), form);
    form.submit();
  }, `${PAGE}v1/blobs`);
  await page.waitForTimeout(500);
  assert.ok(!(await has(PAGE, "form=\r\n")), "a form was stored");
  assert.deepEqual(await jobs(PAGE), [id], "the job is still there, and no other");
  await page.close();
}

async function a_name_that_resolves_to_this_machine() {
  const id = (await jobs(PAGE))[0];
  const page = await of_site(`http://rebound.example:${port}`);
  for (const [path, options] of [
    ["/v1/jobs", {}],
    ["/v1/jobs", JSON_BODY],
    [`/v1/jobs/${id}`, { method: "DELETE" }],
    ["/v1/blobs", { method: "POST", body: "rebound", headers: { "content-type": "application/octet-stream" } }],
    ["/", {}],
    ["/healthz", {}],
  ]) {
    assert.equal(await ask(page, path, options), 403, `${options.method} ${path}`);
  }
  assert.ok(!(await has(PAGE, "rebound")));
  assert.deepEqual(await jobs(PAGE), [id]);
  await page.close();
}

async function the_page_of_the_server() {
  for (const at of [PAGE, `http://localhost:${port}/`]) {
    const page = await browser.newPage();
    await page.goto(at);
    assert.equal(await ask(page, "/v1/jobs", {}), 200, at);
    assert.equal(await ask(page, "/v1/blobs", { method: "POST", body: "own", headers: { "content-type": "application/octet-stream" } }), 201);
    const [id] = await jobs(PAGE);
    if (id) assert.equal(await ask(page, `/v1/jobs/${id}`, { method: "DELETE" }), 204);
    await page.close();
  }
}

async function an_allowed_site() {
  const id = await job(FRIENDLY);
  const page = await of_site("http://friend.example");
  assert.equal(await ask(page, `${FRIENDLY}v1/jobs`, {}), 200);
  assert.equal(await ask(page, `${FRIENDLY}v1/jobs`, JSON_BODY), 400, "it asks first, and is heard");
  assert.equal(await ask(page, `${FRIENDLY}v1/jobs/${id}`, { method: "DELETE" }), 204);
  await page.close();
  const other = await of_site("http://evil.example");
  assert.equal(await ask(other, `${FRIENDLY}v1/jobs`, {}), "blocked");
  await other.close();
}

for (const one of [a_page_of_another_site, a_name_that_resolves_to_this_machine, the_page_of_the_server, an_allowed_site]) {
  await one();
  console.log(`${one.name.replaceAll("_", " ")}: ok`);
}
await browser.close();
