// The page at work.
//
// Purpose: takes a mesh from the file through the job to the remesh, and updates the page's parts. Invariant: one mesh and one
// job are shown. A new one cancels the work for the one before. A failure ends in a message, and the page stays usable. Must
// not know: how surfaces are read, measured and drawn.

import { Api, isAbort, isOver, pause, Problem, type Event, type Job } from "./api.ts";
import { Chart } from "./chart.ts";
import { written, type Language } from "./copy.ts";
import { the } from "./dom.ts";
import { Figures } from "./figures.ts";
import { open, type Chosen } from "./file.ts";
import { Options } from "./options.ts";
import { Progress } from "./progress.ts";
import { Queue } from "./queue.ts";
import { Regions } from "./regions.ts";
import { sample, SAMPLE_POINTS, type Sample } from "./samples.ts";
import { Stage } from "./stage.ts";
import { isShown, SHOWN } from "./mesh/formats.ts";
import type { Loaded, Side } from "./tasks.ts";
import { showWarnings } from "./warnings.ts";
import { count, ending, problem, size, type Told } from "./words.ts";
import { Work, WorkError } from "./work.ts";

/** Larger files are remeshed, but not shown: no browser has a text of so many characters. */
const SHOWN_BYTES = 500_000_000;

export class App {
  private readonly api = new Api((isWrong) => this.askKey(isWrong));
  private readonly work = new Work();
  private readonly stage = new Stage();
  private readonly options = new Options(the("form", HTMLFormElement));
  private readonly progress = new Progress();
  private readonly chart = new Chart(the("chart", SVGSVGElement), the("chart-words", HTMLElement));
  private readonly figures = new Figures();
  private readonly regions = new Regions(the("keep", HTMLInputElement), the("regions", HTMLFieldSetElement), the("region-names", HTMLElement));
  private readonly queue = new Queue(the("queue", HTMLUListElement), the("queue-note", HTMLElement), this.api);
  private readonly go = the("go", HTMLButtonElement);
  private readonly cancelButton = the("cancel", HTMLButtonElement);
  private readonly download = the("download", HTMLAnchorElement);
  private readonly save = the("save", HTMLAnchorElement);

  /** The formats that the service reads. */
  private formats: readonly string[] = SHOWN;
  private learned: Promise<void> = Promise.resolve();
  private chosen: Chosen | null = null;
  /** The input's name at the service. */
  private digest: string | null = null;
  private loaded: Loaded | null = null;
  private job: string | null = null;
  /** Ends what is done for the mesh, and for the job. */
  private ofMesh = new AbortController();
  private ofJob = new AbortController();

  start(): void {
    the("form", HTMLFormElement).addEventListener("submit", (event) => {
      event.preventDefault();
      void this.remesh();
    });
    this.cancelButton.addEventListener("click", () => void this.cancel());
    the("message-close", HTMLButtonElement).addEventListener("click", () => this.hush());
    addEventListener("hashchange", () => void this.follow());
    this.takeDrops();
    for (const button of document.querySelectorAll<HTMLElement>("[data-sample]")) {
      button.addEventListener("click", () => {
        this.options.points(SAMPLE_POINTS);
        // The button goes away with the invitation.
        void this.take(sample(button.dataset["sample"] as Sample)).then(() => this.go.focus());
      });
    }
    for (const button of document.querySelectorAll<HTMLElement>("[data-copy]")) {
      button.addEventListener("click", () => void this.copy(button.dataset["copy"] as Language));
    }
    this.chart.clear();
    this.figures.clear();
    this.stage.welcome(jobInAddress() === null);
    this.queue.refresh();
    this.learned = this.learn();
    void this.follow();
  }

  // ---- The mesh

  private takeDrops(): void {
    const input = the("file", HTMLInputElement);
    const zones = [the("drop", HTMLElement), the("viewer", HTMLElement)];
    input.addEventListener("change", () => {
      const file = input.files?.[0];
      // The same file may be chosen again, after a change.
      input.value = "";
      if (file) void this.take(file);
    });
    let depth = 0;
    const mark = (change: number): void => {
      depth = change === 0 ? 0 : depth + change;
      for (const zone of zones) zone.toggleAttribute("data-over", depth > 0);
    };
    addEventListener("dragenter", () => mark(1));
    addEventListener("dragleave", () => mark(-1));
    addEventListener("dragover", (event) => event.preventDefault());
    addEventListener("drop", (event) => {
      event.preventDefault();
      mark(0);
      const file = event.dataTransfer?.files[0];
      if (file) void this.take(file);
    });
  }

  /** Learns the formats and defaults of the service. */
  private async learn(): Promise<void> {
    try {
      const schemas = await this.api.options();
      this.formats = schemas["format"]?.enum ?? this.formats;
      this.options.learn(schemas);
    } catch (error) {
      if (!(error instanceof Problem && error.status === 401)) this.say(problem("The server did not answer", error));
    }
    the("file", HTMLInputElement).accept = this.formats.flatMap((format) => [`.${format}`, `.${format}.gz`]).join(",");
    const names = this.formats.map((format) => format.toUpperCase());
    const list = `${names.slice(0, -1).join(", ")} or ${names[names.length - 1]}`;
    the("welcome-formats", HTMLElement).textContent = `${list}, also compressed as .gz`;
    if (!this.chosen) the("file-note", HTMLElement).textContent = list;
  }

  private async take(file: File): Promise<void> {
    this.hush();
    const mesh = this.begin();
    this.leaveJob();
    history.replaceState(null, "", location.pathname + location.search);
    try {
      this.note(file.name, `Opening ${size(file.size)} …`);
      const chosen = await open(file, this.formats).catch(async (error: unknown) => {
        if (this.formats !== SHOWN) throw error;
        // The server may read more, and has not said so yet.
        await this.learned;
        return open(file, this.formats);
      });
      if (mesh.aborted) return;
      await this.look(chosen, mesh);
    } catch (error) {
      if (mesh.aborted) return;
      this.chosen = null;
      this.note("Choose a mesh", "The last file could not be opened.");
      this.stage.welcome(true);
      this.say({ ...problem("This file could not be opened", error), advice: `The server reads ${this.formats.join(", ")}.` });
    }
    this.enable();
  }

  /** Forgets the mesh before. */
  private begin(): AbortSignal {
    this.ofMesh.abort();
    this.ofMesh = new AbortController();
    // What is large and was begun would keep the next one waiting.
    if (this.work.isBusy) this.work.restart();
    this.chosen = null;
    this.loaded = null;
    this.digest = null;
    this.keep(null);
    this.regions.offer([]);
    this.stage.welcome(false);
    this.stage.clear("input", "Reading …");
    this.stage.clear("result", "The remesh appears here");
    this.figures.clear();
    this.enable();
    return this.ofMesh.signal;
  }

  /** Takes a mesh and shows it if that can be. */
  private async look(chosen: Chosen, signal: AbortSignal): Promise<void> {
    this.chosen = chosen;
    this.keep(chosen);
    this.enable();
    const about = `${chosen.format.toUpperCase()}, ${size(chosen.file.size)}`;
    this.note(chosen.name, about);
    if (!(await this.stage.canDraw) || signal.aborted) return;
    try {
      const loaded = await this.read("input", chosen.file, chosen.format, signal);
      if (signal.aborted) return;
      this.loaded = loaded;
      this.stage.show("input", loaded);
      this.figures.input(loaded);
      if (loaded.regions.length > 0) this.regions.offer(loaded.regions);
      this.note(chosen.name, `${about}, ${count(loaded.facets)} facets`);
    } catch (error) {
      if (signal.aborted) return;
      this.stage.clear("input", "This mesh cannot be shown");
      const isBad = error instanceof Problem && error.status === 400;
      const advice = isBad ? "Correct the file, or choose another." : "It can still be remeshed: press Remesh. Or choose another file.";
      this.say({ ...problem(`${chosen.name} cannot be ${isBad ? "read" : "shown"}`, error), advice });
    }
  }

  /** Reads a surface to be shown: here if the page knows the format, else by the server. */
  private async read(side: Side, file: Blob, format: string, signal: AbortSignal): Promise<Loaded> {
    let reason: string | null = null;
    if (isShown(format) && file.size <= SHOWN_BYTES) {
      try {
        return await this.work.ask("load", { side, file, format });
      } catch (error) {
        if (signal.aborted || !(error instanceof WorkError && error.isFile)) throw error;
        reason = error.message;
      }
    }
    this.stage.clear(side, "The server reads the file …");
    const digest = await this.api.upload(file, () => {}, signal);
    if (side === "input") this.digest = digest;
    const facets = await this.api.facets(digest, format, signal).catch((error: unknown) => {
      // A refusal before the job begins does not say what is wrong with the file.
      const isVague = error instanceof Problem && error.fields.length > 0;
      throw isVague && reason !== null ? new Problem(error.status, error.reason, reason) : error;
    });
    if (facets.size > SHOWN_BYTES) throw new WorkError("it has too many facets to be shown");
    return this.work.ask("load", { side, file: facets, format: "ply", isLoose: true });
  }

  /** Offers the input as a file: it may be a sample, or of a job of another computer. */
  private keep(chosen: Chosen | null): void {
    if (this.save.href !== "") URL.revokeObjectURL(this.save.href);
    this.save.removeAttribute("href");
    this.save.hidden = chosen === null;
    if (!chosen) return;
    this.save.href = URL.createObjectURL(chosen.file);
    this.save.download = `${chosen.stem}.${chosen.format}`;
  }

  /** Copies the form's options as a call in a language. */
  private async copy(language: Language): Promise<void> {
    if (!this.options.check()) return;
    const { name, stem, format } = this.chosen ?? { name: "mesh.ply", stem: "mesh", format: "ply" };
    const base = new URL(".", document.baseURI).href;
    const text = written(language, { name, stem, format, base, options: this.options.read(), needsKey: this.api.hasKey });
    const shown = the("as-text", HTMLElement);
    shown.textContent = text;
    shown.hidden = false;
    // Pages without TLS have no clipboard, unless they are of this machine.
    const isCopied = await (navigator.clipboard?.writeText(text) ?? Promise.reject(new Error())).then(() => true, () => false);
    if (!isCopied) getSelection()?.selectAllChildren(shown);
    the("as-note", HTMLElement).textContent = isCopied ? "Copied." : "Selected: copy it with Ctrl+C.";
  }

  // ---- The job

  private async remesh(): Promise<void> {
    this.hush();
    const { chosen } = this;
    if (!chosen || !this.options.check()) return;
    const signal = this.leaveJob();
    this.progress.begin("Sending the mesh");
    this.enable();
    try {
      const job = await this.create(chosen, signal);
      history.pushState(null, "", `#job=${job.id}`);
      this.queue.refresh();
      await this.attend(job, signal);
    } catch (error) {
      if (signal.aborted) return;
      this.progress.end("Not started.");
      if (!(error instanceof Problem && this.options.blame(error))) this.say(problem("The remesh did not start", error));
      this.endJob();
    }
  }

  private async create(chosen: Chosen, signal: AbortSignal): Promise<Job> {
    const options = { ...this.options.read(), format: chosen.format, labels: { file: chosen.name.slice(0, 80) } };
    // A digest that was given once may be of a blob that is gone.
    for (let isKnown = this.digest !== null; ; isKnown = false) {
      if (!isKnown) {
        this.digest = await this.api.upload(chosen.file, (part) => this.progress.part("Sending the mesh", part), signal);
      }
      try {
        return await this.api.create({ ...options, mesh: this.digest }, signal);
      } catch (error) {
        if (!(isKnown && error instanceof Problem && error.reason === "blob")) throw error;
      }
    }
  }

  /** Watches a job to its end, and shows what comes of it. */
  private async attend(job: Job, signal: AbortSignal): Promise<void> {
    this.job = job.id;
    this.queue.mark(job.id);
    this.chart.clear();
    this.stage.forgetCells();
    if (!isOver(job.state)) {
      this.progress.begin("Waiting for a place in the queue", job.created_ms);
      this.stage.clear("result", "Cells become triangles at the end");
      if (this.loaded) this.stage.expectCells();
      void this.watchCells(job.id, signal);
    }
    this.enable();
    await this.api.watch(job.id, (event) => this.hear(event), (seconds) => this.progress.cut(seconds), signal);
    if (signal.aborted) return;
    await this.finish(await this.api.job(job.id, signal), signal);
  }

  private hear(event: Event): void {
    switch (event.kind) {
      case "state": return this.progress.state(event.state);
      case "stage": return this.progress.stage(event.stage);
      case "iteration":
        this.chart.add(event.iteration);
        return this.progress.iteration(event.iteration);
    }
  }

  /** Draws seeds as they come; of those that come while it draws, the newest. */
  private async watchCells(id: string, signal: AbortSignal): Promise<void> {
    try {
      for (let after = 0; !signal.aborted; ) {
        const seeds = await this.api.seeds(id, after, signal);
        if (seeds === "ended" || seeds === "unknown") return;
        if (seeds === "none") continue;
        // A server that counts otherwise is not asked in a hurry.
        if (!(seeds.steps > after)) await pause(1000, signal);
        after = Math.max(seeds.steps || 0, after);
        if (!this.loaded) continue;
        const cells = await this.work.ask("cells", { seeds: seeds.bytes });
        if (signal.aborted) return;
        this.stage.cells(cells);
      }
    } catch {
      // The job goes on without a picture. The watch reports its failure.
    }
  }

  private async finish(job: Job, signal: AbortSignal): Promise<void> {
    this.queue.refresh();
    const told = ending(job);
    if (told) {
      this.progress.end(told.title + ".");
      this.stage.clear("result", "There is no remesh");
      if (job.state !== "cancelled") this.say(told);
      return this.endJob();
    }
    this.progress.stage({ name: "Fetching the result", done: null, total: null });
    const [file, report] = await Promise.all([this.api.result(job.id, signal), this.api.report(job.id, signal)]);
    if (signal.aborted) return;
    const format = formatOf(job);
    this.offer(file, job, format);
    this.figures.result(report);
    const regions = regionsIn(report);
    if (regions.length > 0) this.regions.offer(regions);
    showWarnings(report);
    this.progress.end("Done.", job.started_ms === null ? null : job.changed_ms - job.started_ms);
    this.endJob();
    await this.showResult(file, format, signal);
  }

  private async showResult(file: Blob, format: string, signal: AbortSignal): Promise<void> {
    if (!(await this.stage.canDraw) || signal.aborted) return;
    this.stage.clear("result", "Reading …");
    try {
      const loaded = await this.read("result", file, format, signal);
      if (signal.aborted) return;
      this.stage.show("result", loaded);
      this.figures.shares("result", loaded);
      if (!this.loaded) return;
      const compared = await this.work.ask("compare", {});
      if (signal.aborted) return;
      this.stage.compare(compared);
      // The steps were not seen here. The vertices lie near the last points.
      if (this.stage.hasCells) return;
      const cells = await this.work.ask("cells", { seeds: null });
      if (!signal.aborted) this.stage.cells(cells, "vertex of the remesh");
    } catch (error) {
      if (signal.aborted) return;
      this.stage.clear("result", "The remesh cannot be shown. Download it.");
      this.say({ ...problem("The remesh cannot be shown", error), advice: "It can be downloaded." });
    }
  }

  private offer(file: Blob, job: Job, format: string): void {
    const stem = this.chosen?.stem ?? `job-${job.id.slice(0, 8)}`;
    this.withdraw();
    this.download.href = URL.createObjectURL(file);
    this.download.download = `${stem}-remesh.${format}`;
    this.download.textContent = `Download ${format.toUpperCase()}, ${size(file.size)}`;
    this.download.hidden = false;
  }

  private withdraw(): void {
    if (this.download.href !== "") URL.revokeObjectURL(this.download.href);
    this.download.removeAttribute("href");
    this.download.hidden = true;
  }

  private async cancel(): Promise<void> {
    const { job } = this;
    if (job === null) {
      // It was not created yet.
      this.leaveJob();
      this.progress.end("Cancelled.");
      this.enable();
      return;
    }
    this.cancelButton.disabled = true;
    try {
      await this.api.cancel(job);
    } catch (error) {
      if (!isAbort(error)) this.say(problem("The job cannot be cancelled", error));
    } finally {
      this.cancelButton.disabled = false;
    }
  }

  /** Shows the job that the address names. */
  private async follow(): Promise<void> {
    const id = jobInAddress();
    if (id === null || id === this.job) return;
    this.hush();
    const signal = this.leaveJob();
    this.progress.begin("Opening the job");
    try {
      const job = await this.api.job(id, signal);
      await this.learned;
      if (!job.spec.remesh) throw new Problem(404, "kind", "it is no remesh, and the page shows no other jobs");
      this.options.fill(job.spec);
      await this.fetchInput(job, signal);
      if (signal.aborted) return;
      await this.attend(job, signal);
    } catch (error) {
      if (signal.aborted) return;
      this.progress.end("Nothing runs.");
      if (!this.chosen) this.stage.welcome(true);
      this.say(problem("The job cannot be opened", error));
      this.endJob();
    }
  }

  /** Shows the mesh that a job is of, if it is not shown yet and still there. */
  private async fetchInput(job: Job, signal: AbortSignal): Promise<void> {
    const source = job.spec.mesh?.file;
    if (source && source.digest === this.digest) return;
    const mesh = this.begin();
    const name = job.spec.labels?.["file"] ?? `job ${job.id.slice(0, 8)}`;
    try {
      if (!source) throw new Problem(404, "blob", "the job's mesh is not a file");
      const file = await this.api.blob(source.digest, signal);
      if (signal.aborted || mesh.aborted) return;
      this.digest = source.digest;
      await this.look({ name, stem: name.replace(/(\.gz)?$/i, "").replace(/\.[^.]*$/, ""), format: formatName(source.format), file }, mesh);
    } catch (error) {
      if (isAbort(error)) throw error;
      this.note("Choose a mesh", "The mesh of this job is no longer stored.");
      this.stage.clear("input", "The mesh of this job is no longer stored");
    }
  }

  /** Stops following the job; it goes on at the service. */
  private leaveJob(): AbortSignal {
    this.ofJob.abort();
    this.ofJob = new AbortController();
    this.job = null;
    this.queue.mark("");
    this.withdraw();
    this.chart.clear();
    this.figures.clearResult();
    showWarnings(null);
    this.stage.clear("result", "The remesh appears here");
    this.progress.end("Nothing runs.");
    return this.ofJob.signal;
  }

  private endJob(): void {
    this.progress.stop();
    this.enable();
  }

  // ---- The page

  private enable(): void {
    const isBusy = this.progress.isRunning;
    this.go.disabled = this.chosen === null;
    this.cancelButton.hidden = !isBusy;
    the("go-note", HTMLElement).textContent = this.chosen === null ? "Choose a mesh first." : "";
  }

  private note(name: string, about: string): void {
    the("file-name", HTMLElement).textContent = name;
    the("file-note", HTMLElement).textContent = about;
  }

  private say({ title, detail, advice }: Told): void {
    the("message-title", HTMLElement).textContent = title;
    the("message-detail", HTMLElement).textContent = detail;
    the("message-advice", HTMLElement).textContent = advice;
    the("message", HTMLElement).hidden = false;
  }

  private hush(): void {
    the("message", HTMLElement).hidden = true;
  }

  private askKey(isWrong: boolean): Promise<string | null> {
    const dialog = the("key-dialog", HTMLDialogElement);
    const field = the("key", HTMLInputElement);
    the("key-note", HTMLElement).textContent = isWrong
      ? "The server does not take this key. Try another."
      : "The page forgets it when you close the tab, and sends it to this server only.";
    return new Promise((resolve) => {
      const ended = new AbortController();
      const { signal } = ended;
      const end = (key: string | null): void => {
        ended.abort();
        field.value = "";
        dialog.close();
        resolve(key);
      };
      the("key-form", HTMLFormElement).addEventListener("submit", (event) => {
        event.preventDefault();
        const key = field.value.trim();
        if (key !== "") end(key);
      }, { signal });
      the("key-cancel", HTMLButtonElement).addEventListener("click", () => end(null), { signal });
      dialog.addEventListener("cancel", () => end(null), { signal });
      dialog.showModal();
      field.focus();
    });
  }
}

/** The job that the address names. */
function jobInAddress(): string | null {
  return /^#job=([0-9a-f]{32})$/.exec(location.hash)?.[1] ?? null;
}

/** The format of a job's result. */
function formatOf(job: Job): string {
  return formatName(job.spec.result?.file ?? "ply");
}

/** The regions of a job's input, by name, else by number. */
function regionsIn(report: Readonly<Record<string, unknown>>): string[] {
  const { regions } = (report["result"] ?? {}) as { readonly regions?: readonly { readonly name?: string; readonly number: number }[] };
  return (regions ?? []).map(({ name, number }) => name ?? String(number)).filter((name) => !name.includes(";")).slice(0, 64);
}

/** A format's name, of its value in a message. */
function formatName(value: string): string {
  return value.replace("MESH_FORMAT_", "").toLowerCase();
}
