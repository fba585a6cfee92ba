// The table of figures.
//
// Purpose: sets the input and the remesh beside each other. Invariant: figures of the remesh are those of the job's report;
// those of the input are measured here. Must not know: how they are measured.

import { make, the } from "./dom.ts";
import type { Loaded } from "./tasks.ts";
import { count, duration, figure } from "./words.ts";

type Column = "input" | "result";

/** The rows: a name, and what explains it. */
const ROWS = [
  ["vertices", "Vertices"],
  ["facets", "Facets"],
  ["q_min", "Quality, least"],
  ["q_avg", "Quality, mean"],
  ["theta_min_deg", "Smallest angle"],
  ["under_30_percent", "Facets with an angle under 30°"],
  ["hausdorff_percent", "Hausdorff distance, of the diagonal"],
  ["time", "Time"],
] as const;

type Row = (typeof ROWS)[number][0];

export class Figures {
  private readonly cells = new Map<string, HTMLElement>();
  private readonly note = the("figures-note", HTMLElement);

  constructor() {
    const body = the("figures", HTMLTableSectionElement);
    for (const [row, name] of ROWS) {
      const columns = (["input", "result"] as const).map((column) => {
        const cell = make("td", {}, "–");
        this.cells.set(`${row} ${column}`, cell);
        return cell;
      });
      body.append(make("tr", {}, make("th", { scope: "row" }, name), ...columns));
    }
  }

  clear(): void {
    this.clearColumn("input");
    this.clearResult();
  }

  clearResult(): void {
    this.clearColumn("result");
    this.note.textContent = "";
  }

  input({ vertices, facets, figures }: Loaded): void {
    this.set("vertices", "input", count(vertices));
    this.set("facets", "input", count(facets));
    this.set("q_min", "input", figure(figures.least, 2));
    this.set("q_avg", "input", figure(figures.mean, 3));
    this.set("theta_min_deg", "input", `${figures.smallestAngle.toFixed(1)}°`);
    this.set("under_30_percent", "input", percent(figures.under30));
  }

  result(report: Readonly<Record<string, unknown>>): void {
    const result = (report["result"] ?? {}) as Readonly<Record<string, unknown>>;
    const put = (row: Row, write: (x: number) => string): void => {
      const value = result[row];
      if (typeof value === "number") this.set(row, "result", write(value));
    };
    put("vertices", count);
    put("facets", count);
    put("q_min", (x) => figure(x, 2));
    put("q_avg", (x) => figure(x, 3));
    put("theta_min_deg", (x) => `${x.toFixed(1)}°`);
    put("under_30_percent", percent);
    put("hausdorff_percent", percent);
    const total = (report["timings_ms"] as Readonly<Record<string, unknown>> | undefined)?.["total"];
    if (typeof total === "number") this.set("time", "result", duration(total));
    const lines = remarks(report).map((text) => {
      const line = document.createElement("p");
      line.textContent = text;
      return line;
    });
    this.note.replaceChildren(...lines);
  }

  private clearColumn(column: Column): void {
    for (const [row] of ROWS) this.set(row, column, "–");
  }

  private set(row: Row, column: Column, text: string): void {
    const cell = this.cells.get(`${row} ${column}`);
    if (cell) cell.textContent = text;
  }
}

/** Rounding leaves less than a millionth, which is shown as 0. */
function percent(x: number): string {
  if (x < 1e-6) return "0 %";
  return `${x >= 10 ? x.toFixed(1) : figure(x, 2)} %`;
}

/** The topology if it is kept, and the warnings of the report; a sentence each. */
function remarks(report: Readonly<Record<string, unknown>>): string[] {
  const [changes, warnings] = [report["topology_changes"], report["warnings"]];
  const kept = Array.isArray(changes) && changes.length === 0;
  const messages = Array.isArray(warnings) ? warnings.map((warning: { message?: unknown }) => sentence(warning.message)) : [];
  return [...(kept ? ["Components, holes and handles are as in the input."] : []), ...messages];
}

/** A message as a sentence. */
function sentence(message: unknown): string {
  const text = String(message).replaceAll("`", "");
  return `${text.charAt(0).toUpperCase()}${text.slice(1)}.`;
}
