// The page's end of the worker.
//
// Purpose: asks the worker and gives promises. Invariant: every question is answered, be it with an error, if the worker ends
// too. Must not know: what is done with an answer.

import type { Answers, Question, Reply, Requests, Task } from "./tasks.ts";

/** Why there is no answer. Its message is for people. */
export class WorkError extends Error {
  /** `isFile`: the file cannot be read here; another reader may know it. */
  constructor(message: string, readonly isFile = false) {
    super(message);
  }
}

interface Waiting {
  readonly resolve: (answer: never) => void;
  readonly reject: (error: Error) => void;
}

export class Work {
  private worker: Worker | null = null;
  private readonly waiting = new Map<number, Waiting>();
  private next = 1;

  ask<T extends Task>(task: T, request: Requests[T]): Promise<Answers[T]> {
    const worker = (this.worker ??= this.start());
    const question: Question<T> = { id: this.next++, task, request };
    return new Promise((resolve, reject) => {
      this.waiting.set(question.id, { resolve, reject });
      worker.postMessage(question);
    });
  }

  /** Gives up what is asked, and what is kept. */
  restart(): void {
    this.end("it was given up");
  }

  get isBusy(): boolean {
    return this.waiting.size > 0;
  }

  private start(): Worker {
    const worker = new Worker(new URL("worker.js", import.meta.url), { type: "module" });
    worker.addEventListener("message", ({ data }: MessageEvent<Reply>) => {
      const one = this.waiting.get(data.id);
      this.waiting.delete(data.id);
      if ("error" in data) one?.reject(new WorkError(data.error, data.isFile));
      else one?.resolve(data.answer as never);
    });
    worker.addEventListener("error", (event) => {
      event.preventDefault();
      this.end("the browser ended the work; the mesh may be too large for it");
    });
    return worker;
  }

  private end(why: string): void {
    this.worker?.terminate();
    this.worker = null;
    const waiting = [...this.waiting.values()];
    this.waiting.clear();
    for (const one of waiting) one.reject(new WorkError(why));
  }
}
