// Words for people.
//
// Purpose: words for numbers, times, states and problems. Invariant: each problem comes with advice. Must not know: the place
// of the words on the page.

import { Problem, type Job, type State } from "./api.ts";
import { WorkError } from "./work.ts";

const grouped = new Intl.NumberFormat("en");

export function count(x: number): string {
  return grouped.format(x);
}

/** With so many significant digits, and no exponent where none is needed. */
export function figure(x: number, digits = 3): string {
  if (!Number.isFinite(x)) return "–";
  if (x === 0) return "0";
  const size = Math.abs(x);
  if (size < 1e-4 || size >= 1e7) {
    const [mantissa, power] = x.toExponential(digits - 1).split("e");
    return `${mantissa} × 10${raised(Number(power))}`;
  }
  return String(Number(x.toPrecision(digits)));
}

/** An exponent. */
export function raised(power: number): string {
  return [...String(power)].map((sign) => (sign === "-" ? "⁻" : "⁰¹²³⁴⁵⁶⁷⁸⁹"[Number(sign)])).join("");
}

export function duration(ms: number): string {
  if (ms < 1000) return `${Math.round(ms)} ms`;
  if (ms < 60_000) return `${(ms / 1000).toFixed(1)} s`;
  return `${Math.floor(ms / 60_000)} min ${Math.round((ms % 60_000) / 1000)} s`;
}

export function ago(ms: number): string {
  const seconds = Math.max(0, (Date.now() - ms) / 1000);
  if (seconds < 60) return "just now";
  if (seconds < 3600) return `${Math.floor(seconds / 60)} min ago`;
  if (seconds < 86_400) return `${Math.floor(seconds / 3600)} h ago`;
  return `${Math.floor(seconds / 86_400)} d ago`;
}

export function size(bytes: number): string {
  if (bytes < 1000) return `${bytes} B`;
  if (bytes < 1e6) return `${(bytes / 1e3).toFixed(0)} kB`;
  return bytes < 1e9 ? `${(bytes / 1e6).toFixed(1)} MB` : `${(bytes / 1e9).toFixed(2)} GB`;
}

/** A whole number as people write it: 10000, 10,000, 10k, 1.5m or 1e4. */
export function whole(text: string): number | null {
  const [, digits, unit] = /^\s*(\d{1,3}(?:,\d{3})+|\d+(?:\.\d*)?(?:e\d+)?)\s*([km]?)\s*$/i.exec(text) ?? [];
  if (digits === undefined) return null;
  const number = Number(digits.replaceAll(",", "")) * { "": 1, k: 1e3, m: 1e6 }[(unit ?? "").toLowerCase() as "" | "k" | "m"];
  return Number.isSafeInteger(number) ? number : null;
}

export const STATES: Readonly<Record<State, string>> = {
  queued: "waiting", running: "running", succeeded: "done", failed: "failed", cancelled: "cancelled", expired: "expired",
};

/** What a stage does. A stage that is not here goes by its own name. */
export const STAGES: Readonly<Record<string, string>> = {
  read: "Reading the mesh", prepare: "Preparing the surface", sample: "Placing the first points", iterations: "Evening out the cells",
  dual: "Making triangles of cells", repair: "Repairing the triangles", refine: "Fitting to the surface", attributes: "Carrying over attributes",
  measure: "Measuring the result", write: "Writing the result", diagram: "Computing the diagram",
};

export interface Told {
  readonly title: string;
  readonly detail: string;
  readonly advice: string;
}

export function sentence(text: string): string {
  const begun = text.charAt(0).toUpperCase() + text.slice(1);
  return /[.!?]$/.test(begun) ? begun : `${begun}.`;
}

/** A message of the service, without the names of its fields. */
export function plain(message: string): string {
  return message
    .replaceAll("`", "")
    .replace(/^(spec\.)?mesh(\.file)?:?\s+the blob /, "the file ")
    .replace(/^(spec\.)?mesh(\.file)?:?\s+/, "the file: ")
    .replace(/\bspec\.(\w+\.)*(\w+)/g, "$2")
    .replace(/\b[a-z]+(_[a-z]+)+\b/g, (name) => name.replaceAll("_", " "));
}

/** What the service found wrong. */
function found({ message, fields, status }: Problem): string {
  if (status >= 500 && status !== 503) return "The server could not do this.";
  if (fields.length === 0) return sentence(plain(message));
  return fields.map(({ field, description }) => sentence(plain(`${field} ${description}`))).join(" ");
}

/** A failed attempt. */
export function problem(title: string, error: unknown): Told {
  if (error instanceof Problem) return { title, detail: found(error), advice: advice(error) };
  if (error instanceof WorkError) return { title, detail: sentence(error.message), advice: "Try another file, or one with fewer facets." };
  const detail = error instanceof Error ? error.message : String(error);
  return { title, detail: sentence(detail), advice: "Reload the page." };
}

function advice({ status, reason, retryAfter }: Problem): string {
  const later = retryAfter === null ? "a little later" : `in ${Math.max(1, Math.ceil(retryAfter))} s`;
  switch (status) {
    case 0: return "Check that it runs and that you are connected, then try again.";
    case 400: return "Correct the option or the file, then try again.";
    case 401: return "Ask the operator of the server for a key, then try again.";
    case 403: return "This key may read, but not start jobs. Use one with the role submit.";
    case 404: return reason === "job" ? "It may have been deleted. Start a new one." : "Start again from the file.";
    case 408: return "The upload took too long. Try again, or choose a smaller file.";
    case 413: return "Choose a mesh with fewer facets, or ask the operator for a larger limit.";
    case 422: return "Ask for fewer points, or choose a mesh with fewer facets.";
    case 429: return `This key has reached a limit. Try again ${later}.`;
    case 503: return `The server is full or shutting down. Try again ${later}.`;
    default: return "Try again. If it fails again, tell the operator of the server.";
  }
}

/** Why a job that has ended has no result. */
export function ending(job: Job): Told | null {
  switch (job.state) {
    case "failed": {
      const isInput = job.failure?.kind === "bad_input";
      const isLarge = job.failure?.kind === "too_large";
      return {
        title: "The job failed",
        detail: sentence(plain(job.failure?.message ?? "the server gives no reason")),
        advice: isInput ? "Correct the mesh or the options, then press Remesh." : isLarge ? "Ask for fewer points." : "Press Remesh to try again.",
      };
    }
    case "cancelled": return { title: "The job was cancelled", detail: "It has no result.", advice: "Press Remesh to start another." };
    case "expired": return { title: "The result is gone", detail: "A deadline passed, or the time for which results are stored ended.", advice: "Press Remesh to make it again." };
    default: return null;
  }
}
