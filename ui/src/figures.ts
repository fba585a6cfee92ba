// The table of figures.
//
// Purpose: sets the input and the remesh beside each other. Invariant: figures of the remesh are those of the job's report;
// those of the input, and the shares of facets, are measured here. Must not know: how they are measured.

import { Bars } from "./bars.ts";
import { make, the } from "./dom.ts";
import type { Loaded, Side } from "./tasks.ts";
import { count, duration, figure } from "./words.ts";


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
  private readonly q = new Bars("bars-q", 1, "");
  private readonly angle = new Bars("bars-angle", 60, "°");
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
    this.shares("input", null);
    this.clearResult();
  }

  clearResult(): void {
    this.clearColumn("result");
    this.shares("result", null);
    this.note.textContent = "";
  }

  input(loaded: Loaded): void {
    const { vertices, facets, figures } = loaded;
    this.shares("input", loaded);
    this.set("vertices", "input", count(vertices));
    this.set("facets", "input", count(facets));
    this.set("q_min", "input", figure(figures.least, 2));
    this.set("q_avg", "input", figure(figures.mean, 3));
    this.set("theta_min_deg", "input", `${figures.smallestAngle.toFixed(1)}°`);
    this.set("under_30_percent", "input", percent(figures.under30));
  }

  /** Draws how the facets of a surface are shaped. */
  shares(side: Side, loaded: Loaded | null): void {
    this.q.show(side, loaded?.figures.shares.q ?? null);
    this.angle.show(side, loaded?.figures.shares.angle ?? null);
    the("shape", HTMLElement).toggleAttribute("data-empty", !this.q.isShown);
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
    const changes = report["topology_changes"];
    this.note.textContent = Array.isArray(changes) && changes.length === 0 ? "Components, holes and handles are as in the input." : "";
  }

  private clearColumn(column: Side): void {
    for (const [row] of ROWS) this.set(row, column, "–");
  }

  private set(row: Row, column: Side, text: string): void {
    const cell = this.cells.get(`${row} ${column}`);
    if (cell) cell.textContent = text;
  }
}

/** Rounding leaves less than a millionth, which is shown as 0. */
function percent(x: number): string {
  if (x < 1e-6) return "0 %";
  return `${x >= 10 ? x.toFixed(1) : figure(x, 2)} %`;
}
