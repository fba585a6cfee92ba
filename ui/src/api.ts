// What the page asks the service.
//
// Purpose: one function for each request of docs/http.md. Invariant: every request goes to the server of the page; the key is
// in memory only; every failure is a `Problem`. Must not know: the page's elements.

export type State = "queued" | "running" | "succeeded" | "failed" | "cancelled" | "expired";

export function isOver(state: State): boolean {
  return state !== "queued" && state !== "running";
}

export interface Job {
  readonly id: string;
  readonly state: State;
  readonly created_ms: number;
  readonly started_ms: number | null;
  readonly changed_ms: number;
  readonly spec: Spec;
  readonly failure: { readonly kind: string; readonly message: string } | null;
  readonly results: Readonly<Record<string, string>>;
  readonly expired_by: string | null;
  /** Of several servers, the one that runs it. */
  readonly server: string | null;
}

/** What the page reads of the message `JobSpec`. Formats are as "MESH_FORMAT_PLY". */
export interface Spec {
  readonly mesh?: { readonly file?: { readonly digest: string; readonly format: string; readonly attributes?: boolean } };
  readonly remesh?: { readonly points?: number; readonly density?: Readonly<Record<string, unknown>>; readonly [option: string]: unknown };
  readonly backend?: string;
  readonly result?: { readonly file?: string };
  readonly labels?: Readonly<Record<string, string>>;
  readonly arrays?: Readonly<Record<string, { readonly digest: string; readonly form: string }>>;
  readonly [other: string]: unknown;
}

export interface Iteration {
  /** From 0. */
  readonly index: number;
  readonly total: number;
  readonly kind: string;
  readonly energy: number;
  /** Over that of regular hexagons of the same area and number. */
  readonly energy_ratio: number;
  readonly gradient_norm: number;
  readonly ms: number;
}

export interface Stage {
  readonly name: string;
  readonly done: number | null;
  readonly total: number | null;
}

export type Event =
  | { readonly kind: "state"; readonly state: State }
  | { readonly kind: "stage"; readonly stage: Stage }
  | { readonly kind: "iteration"; readonly iteration: Iteration };

/** Positions of all seeds after a number of steps; `ended` if no more will come. */
export type Seeds = { readonly steps: number; readonly bytes: ArrayBuffer } | "none" | "ended" | "unknown";

/** Label of the jobs that read a file for the page. */
const VIEW_LABEL = "tessera-page";

/** After this time such a job is not waited for by any page. */
const LEFT_MS = 60_000;

/** With its digest, the service stores an upload as it comes; smaller ones it holds until their digest is known. */
const LARGE_BYTES = 64 << 20;

/** What went wrong, as RFC 9457 has it. Status 0: there was no answer. */
export class Problem extends Error {
  constructor(
    readonly status: number,
    readonly reason: string,
    detail: string,
    readonly retryAfter: number | null = null,
    readonly fields: readonly { readonly field: string; readonly description: string }[] = [],
  ) {
    super(detail);
  }
}

/** Whether the page itself gave up the request. */
export function isAbort(error: unknown): boolean {
  return error instanceof DOMException && error.name === "AbortError";
}

export class Api {
  private key: string | null = null;

  /** `askKey` asks the user for a key. It gives null if the user has none. */
  constructor(private readonly askKey: (isWrong: boolean) => Promise<string | null>) {}

  get hasKey(): boolean {
    return this.key !== null;
  }

  /** The options of a job, as the service's document has them. */
  async options(): Promise<Schemas> {
    const document = await this.json<OpenApi>("v1/openapi.json");
    const resolve = (schema: Schema = {}): Schema => {
      const named = document.components?.schemas?.[schema.$ref?.split("/").pop() ?? ""];
      const parts = [...(named ? [named] : []), ...(schema.allOf ?? []), ...(schema.oneOf ?? []), ...(schema.anyOf ?? [])];
      // Of alternatives, the first is the plain one.
      const all = [schema, ...parts.map(resolve)].reverse();
      return { ...Object.assign({}, ...all), properties: Object.assign({}, ...all.map((part) => part.properties)) } as Schema;
    };
    const { properties } = resolve(document.paths?.["/v1/jobs"]?.post?.requestBody?.content?.["application/json"]?.schema);
    return Object.fromEntries(Object.entries(properties ?? {}).map(([name, schema]) => [name, resolve(schema)]));
  }

  /** Stores a file and gives its digest. */
  async upload(file: Blob, onProgress: (part: number) => void, signal: AbortSignal): Promise<string> {
    const digest = file.size > LARGE_BYTES ? await digestOf(file) : null;
    // An upload of what is there already would be answered, and cut, before its end.
    if (digest && (await this.hasBlob(digest, signal))) return digest;
    for (;;) {
      const reply = await this.send(`v1/blobs${digest ? `?digest=${digest}` : ""}`, file, onProgress, signal);
      if (reply.status === 401) {
        await this.renewKey();
        continue;
      }
      if (reply.status < 200 || reply.status > 299) throw problemOf(reply.status, reply.body, null);
      return (JSON.parse(reply.body) as { digest: string }).digest;
    }
  }

  private async hasBlob(digest: string, signal: AbortSignal): Promise<boolean> {
    try {
      await this.ask(`v1/blobs/${digest}`, { method: "HEAD", signal });
      return true;
    } catch (error) {
      if (error instanceof Problem && error.status === 404) return false;
      throw error;
    }
  }

  create(options: Readonly<Record<string, unknown>>, signal: AbortSignal): Promise<Job> {
    return this.json<Job>("v1/jobs", { method: "POST", body: JSON.stringify(options), headers: { "content-type": "application/json" }, signal });
  }

  job(id: string, signal?: AbortSignal): Promise<Job> {
    return this.json<Job>(`v1/jobs/${id}`, signal ? { signal } : {});
  }

  /** The newest jobs. */
  async jobs(count: number): Promise<Job[]> {
    const { jobs } = await this.json<{ jobs: Job[] }>(`v1/jobs?page_size=${2 * count}`);
    const isOwn = ({ spec }: Job): boolean => spec.labels?.[VIEW_LABEL] !== undefined;
    // A page that was closed in the meantime left them.
    const left = jobs.filter((job) => isOwn(job) && isOver(job.state) && Date.now() - job.changed_ms > LEFT_MS);
    for (const { id } of left) void this.delete(id).catch(() => {});
    return jobs.filter((job) => !isOwn(job)).slice(0, count);
  }

  cancel(id: string): Promise<Job> {
    return this.json<Job>(`v1/jobs/${id}/cancel`, { method: "POST" });
  }

  async blob(digest: string, signal: AbortSignal): Promise<Blob> {
    return (await this.ask(`v1/blobs/${digest}`, { signal })).blob();
  }

  async result(id: string, signal: AbortSignal, name = "mesh"): Promise<Blob> {
    return (await this.ask(`v1/jobs/${id}/result?name=${name}`, { signal })).blob();
  }

  private async delete(id: string): Promise<void> {
    await this.ask(`v1/jobs/${id}`, { method: "DELETE" });
  }

  /** The facets of a stored mesh as PLY: the diagram of a single seed. A failure is the service's own. */
  async facets(digest: string, format: string, signal: AbortSignal): Promise<Blob> {
    const mesh = { file: { digest, format: `MESH_FORMAT_${format.toUpperCase()}`, attributes: false } };
    const job = await this.create({ mesh, rvd: { points: 1 }, labels: { [VIEW_LABEL]: "view" } }, signal);
    try {
      await this.watch(job.id, () => {}, () => {}, signal);
      const { failure, state } = await this.job(job.id, signal);
      if (state !== "succeeded") throw new Problem(failure?.kind === "bad_input" ? 400 : 422, "invalid_argument", failure?.message ?? `the job is ${state}`);
      return await this.result(job.id, signal, "cells");
    } finally {
      void this.forget(job.id);
    }
  }

  /** Deletes a short job after its end. */
  private async forget(id: string): Promise<void> {
    const nothing = (): void => {};
    await this.watch(id, nothing, nothing, new AbortController().signal).then(() => this.delete(id)).catch(nothing);
  }

  report(id: string, signal: AbortSignal): Promise<Record<string, unknown>> {
    return this.json(`v1/jobs/${id}/result?name=report`, { signal });
  }

  /** Waits for seeds after more steps than these. */
  async seeds(id: string, after: number, signal: AbortSignal): Promise<Seeds> {
    let response;
    try {
      response = await this.ask(`v1/jobs/${id}/seeds?after=${after}`, { signal });
    } catch (error) {
      // A service without cells still remeshes.
      if (error instanceof Problem && (error.status === 404 || error.status === 405)) return "unknown";
      throw error;
    }
    if (response.status === 204) return response.headers.get("tessera-ended") === "true" ? "ended" : "none";
    return { steps: Number(response.headers.get("tessera-steps")), bytes: await response.arrayBuffer() };
  }

  /**
   * Passes the events of a job to `onEvent` until the job ends. Reconnects when the connection breaks.
   * `onCut` gets the seconds until the next try when the connection breaks, and null when it works again.
   */
  async watch(id: string, onEvent: (event: Event) => void, onCut: (seconds: number | null) => void, signal: AbortSignal): Promise<void> {
    let last = "";
    for (let tries = 0; ; tries++) {
      try {
        const response = await this.ask(`v1/jobs/${id}/events`, { signal, headers: last === "" ? {} : { "last-event-id": last } });
        if (tries > 0) onCut(null);
        if (response.status === 204) return;
        let isOver = false;
        for await (const { id: number, event, data } of serverSent(response)) {
          if (number !== "") last = number;
          tries = 0;
          // It is the last; the answer ends after it.
          if (event === "end") isOver = true;
          if (event === "problem") throw problemOf(503, data, null);
          const told = eventOf(event, data);
          if (told) onEvent(told);
        }
        if (isOver) return;
      } catch (error) {
        if (isAbort(error)) throw error;
        if (error instanceof Problem && error.status > 0 && error.status < 500 && error.status !== 429) throw error;
      }
      const seconds = Math.min(2 ** tries, 15);
      onCut(seconds);
      await pause(1000 * seconds, signal);
    }
  }

  private async json<T>(path: string, init: RequestInit = {}): Promise<T> {
    return (await (await this.ask(path, init)).json()) as T;
  }

  /** Asks; once more with a key if one is needed. */
  private async ask(path: string, init: RequestInit): Promise<Response> {
    for (;;) {
      const headers = new Headers(init.headers);
      if (this.key !== null) headers.set("authorization", `Bearer ${this.key}`);
      let response;
      try {
        response = await fetch(place(path), { ...init, headers, cache: "no-store", credentials: "omit", redirect: "error" });
      } catch (error) {
        if (isAbort(error)) throw error;
        throw noAnswer();
      }
      if (response.status === 401) {
        await this.renewKey();
        continue;
      }
      if (!response.ok) throw problemOf(response.status, await response.text().catch(() => ""), response.headers.get("retry-after"));
      return response;
    }
  }

  private asking: Promise<string | null> | null = null;

  /** Many requests may need a key at once. The user is asked once. */
  private async renewKey(): Promise<void> {
    this.asking ??= this.askKey(this.key !== null).finally(() => (this.asking = null));
    const key = await this.asking;
    if (key === null) throw new Problem(401, "unauthenticated", "this server requires a key");
    this.key = key;
  }

  /** A request whose upload is watched, which fetch cannot do. */
  private send(path: string, body: Blob, onProgress: (part: number) => void, signal: AbortSignal): Promise<{ status: number; body: string }> {
    return new Promise((resolve, reject) => {
      const request = new XMLHttpRequest();
      const abort = (): void => request.abort();
      request.open("POST", place(path));
      // Some systems take meshes for text, which the service refuses from pages.
      request.setRequestHeader("content-type", "application/octet-stream");
      if (this.key !== null) request.setRequestHeader("authorization", `Bearer ${this.key}`);
      request.upload.addEventListener("progress", ({ loaded, total }) => onProgress(total > 0 ? loaded / total : 0));
      request.addEventListener("load", () => resolve({ status: request.status, body: request.responseText }));
      request.addEventListener("error", () => reject(noAnswer()));
      request.addEventListener("abort", () => reject(new DOMException("given up", "AbortError")));
      request.addEventListener("loadend", () => signal.removeEventListener("abort", abort));
      signal.addEventListener("abort", abort);
      if (signal.aborted) return reject(new DOMException("given up", "AbortError"));
      request.send(body);
    });
  }
}

/** What this page reads of a JSON schema. */
export interface Schema {
  readonly $ref?: string;
  readonly allOf?: readonly Schema[];
  readonly oneOf?: readonly Schema[];
  readonly anyOf?: readonly Schema[];
  readonly properties?: Schemas;
  readonly enum?: readonly string[];
  readonly default?: unknown;
}

export type Schemas = Readonly<Record<string, Schema>>;

interface OpenApi {
  readonly paths?: Readonly<Record<string, { readonly post?: { readonly requestBody?: { readonly content?: Readonly<Record<string, { readonly schema?: Schema }>> } } }>>;
  readonly components?: { readonly schemas?: Schemas };
}

/** Beside the page, wherever that is. */
function place(path: string): string {
  return new URL(path, document.baseURI).href;
}

function noAnswer(): Problem {
  return new Problem(0, "no_answer", "the server does not answer");
}

/** What went wrong, out of an answer. */
function problemOf(status: number, body: string, retryAfter: string | null): Problem {
  interface Told {
    readonly status?: number;
    readonly detail?: string;
    readonly title?: string;
    readonly reason?: string;
    readonly retry_after_s?: number;
    readonly field_violations?: { readonly field: string; readonly description: string }[];
  }
  let told: Told = {};
  try {
    told = JSON.parse(body) as Told;
  } catch {
    // A proxy's answer is a page.
  }
  const seconds = told.retry_after_s ?? (retryAfter === null ? null : Number(retryAfter));
  const detail = told.detail ?? told.title ?? `the server answers with status ${status}`;
  return new Problem(told.status ?? status, told.reason ?? "", detail, seconds, told.field_violations ?? []);
}

/** The SHA-256 of what is not too large to be held. */
async function digestOf(file: Blob): Promise<string | null> {
  const isSecure = globalThis.crypto?.subtle !== undefined;
  if (!isSecure || file.size > 1 << 29) return null;
  const digest = new Uint8Array(await crypto.subtle.digest("SHA-256", await file.arrayBuffer()));
  return Array.from(digest, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

function eventOf(kind: string, data: string): Event | null {
  const value = JSON.parse(data) as never;
  switch (kind) {
    case "state": return { kind, state: (value as { state: State }).state };
    case "stage": return { kind, stage: value };
    case "iteration": return { kind, iteration: value };
    default: return null;
  }
}

/** Server-sent events of a response. A comment keeps the connection alive and is no event. */
async function* serverSent(response: Response): AsyncGenerator<{ id: string; event: string; data: string }> {
  if (!response.body) return;
  const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
  let text = "";
  for (;;) {
    const { value, done } = await reader.read();
    if (done) return;
    text += value;
    for (let end = text.indexOf("\n\n"); end >= 0; end = text.indexOf("\n\n")) {
      const told = { id: "", event: "", data: "" };
      for (const line of text.slice(0, end).split("\n")) {
        const [, name, rest] = /^(id|event|data): ?(.*)$/.exec(line) ?? [];
        if (name === "id" || name === "event" || name === "data") told[name] += rest ?? "";
      }
      text = text.slice(end + 2);
      if (told.event !== "") yield told;
    }
  }
}

export function pause(ms: number, signal: AbortSignal): Promise<void> {
  return new Promise((resolve, reject) => {
    if (signal.aborted) return reject(new DOMException("given up", "AbortError"));
    const end = (): void => {
      clearTimeout(timer);
      reject(new DOMException("given up", "AbortError"));
    };
    const timer = setTimeout(() => {
      signal.removeEventListener("abort", end);
      resolve();
    }, ms);
    signal.addEventListener("abort", end, { once: true });
  });
}
