// The queue.
//
// Purpose: lists the newest jobs, and asks again while the page is seen. Invariant: a row that stays keeps its elements, so that
// who is on it by keyboard stays there. Must not know: how a job is opened; a row links to `#job=ID`.

import { Problem, type Api, type Job } from "./api.ts";
import { make } from "./dom.ts";
import { ago, count, duration, STATES } from "./words.ts";

const ROWS = 8;
const SOON_MS = 2000;
const LATER_MS = 8000;

export class Queue {
  private readonly rows = new Map<string, HTMLLIElement>();
  private timer: ReturnType<typeof setTimeout> | undefined;
  private current = "";
  private isAsking = false;

  constructor(private readonly list: HTMLUListElement, private readonly note: HTMLElement, private readonly api: Api) {
    document.addEventListener("visibilitychange", () => {
      if (!document.hidden) this.refresh();
    });
  }

  /** Marks the job that is shown. */
  mark(id: string): void {
    this.current = id;
    for (const [other, row] of this.rows) row.toggleAttribute("data-current", other === id);
  }

  refresh(): void {
    clearTimeout(this.timer);
    void this.ask();
  }

  private async ask(): Promise<void> {
    if (this.isAsking) return;
    this.isAsking = true;
    let isBusy = false;
    try {
      const jobs = await this.api.jobs(ROWS);
      this.show(jobs);
      isBusy = jobs.some(({ state }) => state === "queued" || state === "running");
      this.note.textContent = jobs.length === 0 ? "No jobs yet." : "";
    } catch (error) {
      this.note.textContent = error instanceof Problem && error.status === 401 ? "The queue needs a key." : "The server does not answer. This list may be out of date.";
      if (error instanceof Problem && error.status === 401) return;
    } finally {
      this.isAsking = false;
    }
    clearTimeout(this.timer);
    if (!document.hidden) this.timer = setTimeout(() => this.refresh(), isBusy ? SOON_MS : LATER_MS);
  }

  private show(jobs: readonly Job[]): void {
    const ids = new Set(jobs.map(({ id }) => id));
    for (const [id, row] of this.rows) {
      if (ids.has(id)) continue;
      row.remove();
      this.rows.delete(id);
    }
    jobs.forEach((job, i) => {
      let row = this.rows.get(job.id);
      if (!row) {
        row = make("li", {}, make("a", { href: `#job=${job.id}` }));
        this.rows.set(job.id, row);
      }
      if (this.list.children[i] !== row) this.list.insertBefore(row, this.list.children[i] ?? null);
      this.fill(row, job);
    });
    this.mark(this.current);
  }

  private fill(row: HTMLLIElement, job: Job): void {
    row.dataset["state"] = job.state;
    const name = job.spec.labels?.["file"] ?? `job ${job.id.slice(0, 8)}`;
    const points = pointsOf(job);
    const took = job.started_ms !== null && job.state === "succeeded" ? `, ${duration(job.changed_ms - job.started_ms)}` : "";
    const more = [points, ago(job.created_ms) + took, job.server === null ? "" : `at ${job.server}`].filter((part) => part !== "").join(", ");
    const key = [name, job.state, more].join("|");
    const link = row.firstElementChild as HTMLAnchorElement;
    if (row.dataset["key"] === key) return;
    row.dataset["key"] = key;
    link.replaceChildren(
      make("span", { class: "queue-name" }, name),
      make("span", { class: `badge badge-${job.state}` }, STATES[job.state]),
      make("span", { class: "queue-more" }, more),
    );
  }
}

/** How fine the result of a job is, if it says so. */
function pointsOf({ spec: { remesh } }: Job): string {
  if (remesh?.points) return `${count(remesh.points)} points`;
  if (remesh?.["facets"]) return `${count(Number(remesh["facets"]))} facets`;
  if (remesh?.["points_percent"]) return `${String(remesh["points_percent"])} % of the vertices`;
  const length = remesh?.density?.["edge_length"];
  return length === undefined ? "" : `edges of ${String(length)}`;
}
