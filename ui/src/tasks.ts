// What the worker is asked and answers.
//
// Purpose: the types that page and worker share. Invariant: a message holds data alone; large arrays are handed over, not
// copied. Must not know: how anything is computed or shown.

import type { DistanceFigures } from "./mesh/closest.ts";
import type { QualityFigures } from "./mesh/quality.ts";
import type { Frame } from "./mesh/surface.ts";

/** Which of the two surfaces. */
export type Side = "input" | "result";

export interface Requests {
  /** Reads a file and keeps its surface. Corners of a loose one have vertices of their own: those with equal coordinates become one. */
  load: { side: Side; file: Blob; format: string; isLoose?: boolean };
  /** Forgets a surface. */
  drop: { side: Side };
  /** How far each surface is from the other. */
  compare: Record<string, never>;
  /** Which seeds count on which facet of the input. A seed is three doubles, little-endian. Without seeds: the result's vertices. */
  cells: { seeds: ArrayBuffer | null };
}

export interface Loaded {
  readonly frame: Frame;
  readonly vertices: number;
  readonly facets: number;
  /** The farthest that a corner is from the frame's centre. */
  readonly radius: number;
  /** Nine numbers a facet, in the input's frame. */
  readonly corners: Float32Array<ArrayBuffer>;
  /** Q at each corner. */
  readonly quality: Float32Array<ArrayBuffer>;
  readonly figures: QualityFigures;
  /** Names of its regions, where the file has some. */
  readonly regions: readonly string[];
}

export interface Compared {
  /** Percent of the diagonal at each corner. */
  readonly input: Float32Array<ArrayBuffer>;
  readonly result: Float32Array<ArrayBuffer>;
  readonly inputFigures: DistanceFigures;
  readonly resultFigures: DistanceFigures;
}

export interface Cells {
  /** The divided facets, if they are other than before. */
  readonly corners: Float32Array<ArrayBuffer> | null;
  /** x y z and nothing, for each seed, in the frame. */
  readonly seeds: Float32Array<ArrayBuffer>;
  readonly count: number;
  /** `k` seeds for each facet. */
  readonly nearest: Uint32Array<ArrayBuffer>;
  readonly k: number;
}

export interface Answers {
  load: Loaded;
  drop: null;
  compare: Compared;
  cells: Cells;
}

export type Task = keyof Requests;

export interface Question<T extends Task = Task> {
  readonly id: number;
  readonly task: T;
  readonly request: Requests[T];
}

export type Reply = { readonly id: number; readonly answer: Answers[Task] } | { readonly id: number; readonly error: string; readonly isFile: boolean };
