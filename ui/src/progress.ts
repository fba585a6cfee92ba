// Progress of a job.
//
// Purpose: the line, the bar and the clock. Invariant: a screen reader announces stages and quarters, not every iteration.
// Must not know: where events come from.

import type { Iteration, Stage, State } from "./api.ts";
import { the } from "./dom.ts";
import { duration, STAGES } from "./words.ts";

export class Progress {
  private readonly line = the("run-stage", HTMLElement);
  private readonly bar = the("run-bar", HTMLProgressElement);
  private readonly clock = the("run-time", HTMLElement);
  private readonly live = the("live", HTMLElement);
  private ticking: ReturnType<typeof setInterval> | undefined;
  private since = 0;
  private quarter = 0;
  private running = false;
  private before = "";

  get isRunning(): boolean {
    return this.running;
  }

  begin(what: string, since = Date.now()): void {
    this.running = true;
    this.quarter = 0;
    this.since = since;
    this.bar.removeAttribute("value");
    this.say(what);
    clearInterval(this.ticking);
    this.tick();
    this.ticking = setInterval(() => this.tick(), 200);
  }

  part(what: string, part: number): void {
    this.line.textContent = `${what}, ${Math.round(100 * part)} %`;
    this.bar.value = part;
  }

  state(state: State): void {
    if (state === "queued") this.say("Waiting for a place in the queue");
    if (state === "running") this.say("Reading the mesh");
  }

  stage({ name, done, total }: Stage): void {
    const words = STAGES[name] ?? name;
    this.say(words);
    if (done !== null && total !== null && total > 0) this.bar.value = done / total;
    else this.bar.removeAttribute("value");
  }

  iteration({ index, total, kind }: Iteration): void {
    const step = kind === "lloyd" ? "Lloyd step" : "quasi-Newton step";
    const done = index + 1;
    const words = `Evening out the cells: iteration ${done} of ${total}`;
    this.line.textContent = `${words}, ${step}`;
    this.bar.value = total > 0 ? done / total : 0;
    const quarter = total > 0 ? Math.floor((4 * done) / total) : 0;
    if (quarter !== this.quarter) this.live.textContent = words;
    this.quarter = quarter;
  }

  /** The connection broke, with the seconds until the next try; or it works again, with null. */
  cut(seconds: number | null): void {
    if (seconds === null) {
      this.say(this.before);
      return;
    }
    this.before = this.line.textContent ?? "";
    this.say(`The server does not answer. Next try in ${seconds} s. The job keeps running.`);
  }

  /** Ends with these words, and the time that it took if that is known. */
  end(what: string, ms: number | null = null): void {
    const wasRunning = this.running;
    this.stop();
    this.bar.value = ms === null ? 0 : 1;
    this.clock.textContent = ms === null ? "" : duration(ms);
    this.line.textContent = what;
    if (wasRunning) this.live.textContent = what;
  }

  stop(): void {
    this.running = false;
    clearInterval(this.ticking);
  }

  private say(words: string): void {
    if (this.line.textContent === words) return;
    this.line.textContent = words;
    this.live.textContent = words;
  }

  private tick(): void {
    this.clock.textContent = duration(Math.max(0, Date.now() - this.since));
  }
}
