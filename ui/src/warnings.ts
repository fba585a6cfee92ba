// The warnings of a remesh.
//
// Purpose: lists all warnings of a report, each with its code and its places. Invariant: none is left out; without any the list
// is not seen. Must not know: what a code means.

import { make, the } from "./dom.ts";
import { count, figure, plain, sentence } from "./words.ts";

/** Places of a warning that are seen at once. */
const PLACES = 3;

interface Warning {
  readonly code?: unknown;
  readonly message?: unknown;
  readonly count?: unknown;
  readonly places?: unknown;
}

export function showWarnings(report: Readonly<Record<string, unknown>> | null): void {
  const list = report?.["warnings"];
  const warnings = Array.isArray(list) ? (list as Warning[]) : [];
  the("warnings", HTMLElement).hidden = warnings.length === 0;
  the("warnings-title", HTMLElement).textContent = warnings.length === 1 ? "1 warning" : `${count(warnings.length)} warnings`;
  the("warnings-list", HTMLElement).replaceChildren(...warnings.map(row));
}

function row({ code, message, count: elements, places }: Warning): HTMLElement {
  const item = make("li", {}, make("p", {}, sentence(plain(String(message))), " ", make("code", {}, String(code))));
  const all = Array.isArray(places) ? places.map(place) : [];
  if (all.length > 0) item.append(at(all, typeof elements === "number" ? elements : all.length));
  return item;
}

/** The places; more than a few fold away. */
function at(places: readonly string[], elements: number): HTMLElement {
  const first = `At ${places.slice(0, PLACES).join(", ")}`;
  const rest = places.slice(PLACES);
  const beyond = elements > places.length ? `; ${count(elements)} in all` : "";
  if (rest.length === 0) return make("p", { class: "note" }, `${first}${beyond}.`);
  return make("details", { class: "note" }, make("summary", {}, `${first} and ${count(rest.length)} more${beyond}`), make("p", {}, rest.join(", ")));
}

function place(at: unknown): string {
  return Array.isArray(at) ? `(${at.map((x) => figure(Number(x), 5)).join(", ")})` : String(at);
}
