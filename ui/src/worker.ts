// The worker: all that takes long on large surfaces.
//
// Purpose: answers the questions of `tasks.ts`, one after the other. Invariant: an error is an answer; the surfaces that were
// kept stay. Must not know: the page, the service.

import { ClosestPoint, distances } from "./mesh/closest.ts";
import { divide } from "./mesh/divide.ts";
import { isShown } from "./mesh/formats.ts";
import { NearestSeeds } from "./mesh/nearest.ts";
import { quality } from "./mesh/quality.ts";
import { BadFile, read } from "./mesh/read.ts";
import { regionNames } from "./mesh/regions.ts";
import { cornersOf, frameOf, spread, type Frame, type Surface } from "./mesh/surface.ts";
import type { Answers, Cells, Compared, Loaded, Question, Reply, Requests, Side, Task } from "./tasks.ts";

/** The most facets that are shown: their corners take 36 bytes each, thrice. */
const MOST_FACETS = 6_000_000;

/** The most facets that cells are drawn on. */
const MOST_DIVIDED = 1_500_000;

/** The most seeds whose cells are drawn, as at the service. */
const MOST_SEEDS = 1_000_000;

/** Seeds that count on a facet. A multiple of four, as a texel holds four. */
const NEAREST = 12;

interface Kept {
  readonly surface: Surface;
  readonly frame: Frame;
}

interface Divided {
  readonly of: Surface;
  readonly seeds: number;
  readonly corners: Float32Array<ArrayBuffer>;
}

const kept: Record<Side, Kept | null> = { input: null, result: null };
let divided: Divided | null = null;

async function load({ side, file, format, isLoose }: Requests["load"]): Promise<Loaded> {
  drop({ side });
  if (!isShown(format)) throw new BadFile(`files of the format ${format} are not shown here`);
  const bytes = new Uint8Array(await file.arrayBuffer());
  const surface = read(bytes, format, isLoose);
  const facets = surface.indices.length / 3;
  if (facets > MOST_FACETS) throw new Error(`${facets} facets are more than the ${MOST_FACETS} that are shown here`);
  // Both are drawn in the input's frame, so that they lie on each other.
  const frame = (side === "result" ? kept.input?.frame : null) ?? frameOf(surface);
  kept[side] = { surface, frame };
  const { values, figures } = quality(surface);
  const atCorners = new Float32Array(3 * facets);
  for (let corner = 0; corner < 3 * facets; corner++) atCorners[corner] = values[(corner / 3) | 0];
  const vertices = surface.positions.length / 3;
  const corners = cornersOf(surface, frame);
  let square = 0;
  for (let i = 0; i < corners.length; i += 3) square = Math.max(square, corners[i] ** 2 + corners[i + 1] ** 2 + corners[i + 2] ** 2);
  return { frame, vertices, facets, radius: Math.sqrt(square), corners, quality: atCorners, figures, regions: side === "input" ? regionNames(bytes, format) : [] };
}

function drop({ side }: Requests["drop"]): null {
  kept[side] = null;
  if (side === "input") divided = null;
  return null;
}

function compare(): Compared {
  const { input, result } = kept;
  if (!input || !result) throw new BadFile("there are not two surfaces to compare");
  const { diagonal } = input.frame;
  const ofResult = distances(result.surface, new ClosestPoint(input.surface), diagonal);
  const ofInput = distances(input.surface, new ClosestPoint(result.surface), diagonal);
  return {
    input: spread(input.surface, ofInput.values),
    result: spread(result.surface, ofResult.values),
    inputFigures: ofInput.figures,
    resultFigures: ofResult.figures,
  };
}

function cells({ seeds: bytes }: Requests["cells"]): Cells {
  const { input, result } = kept;
  if (!input) throw new BadFile("there is no surface to draw cells on");
  const { centre, diagonal } = input.frame;
  const places = bytes ? doubles(bytes) : (result?.surface.positions ?? []);
  const count = Math.floor(places.length / 3);
  if (count === 0) throw new BadFile("there are no seeds");
  if (count > MOST_SEEDS) throw new BadFile("there are too many seeds to draw their cells");
  const points = new Float64Array(3 * count);
  const seeds = new Float32Array(4 * count);
  for (let seed = 0; seed < count; seed++) {
    for (let axis = 0; axis < 3; axis++) {
      const x = (places[3 * seed + axis] - centre[axis]) / diagonal;
      points[3 * seed + axis] = x;
      seeds[4 * seed + axis] = x;
    }
  }
  const tree = new NearestSeeds(points, NEAREST);
  const isNew = divided?.of !== input.surface || divided.seeds !== count;
  if (isNew) {
    const corners = divide(cornersOf(input.surface, input.frame), tree, Math.max(MOST_DIVIDED, input.surface.indices.length / 3));
    divided = { of: input.surface, seeds: count, corners };
  }
  const { corners } = divided as Divided;
  const facets = corners.length / 9;
  const nearest = new Uint32Array(NEAREST * facets);
  for (let facet = 0; facet < facets; facet++) {
    const at = 9 * facet;
    const x = (corners[at] + corners[at + 3] + corners[at + 6]) / 3;
    const y = (corners[at + 1] + corners[at + 4] + corners[at + 7]) / 3;
    const z = (corners[at + 2] + corners[at + 5] + corners[at + 8]) / 3;
    tree.ask(x, y, z, nearest, NEAREST * facet);
  }
  // The worker keeps its own.
  return { corners: isNew ? corners.slice() : null, seeds, count, nearest, k: NEAREST };
}

function doubles(bytes: ArrayBuffer): Float64Array {
  const raw = new DataView(bytes);
  return Float64Array.from({ length: Math.floor(bytes.byteLength / 8) }, (_, i) => raw.getFloat64(8 * i, true));
}

const tasks: { [T in Task]: (request: Requests[T]) => Answers[T] | Promise<Answers[T]> } = { load, drop, compare, cells };

/** The memory of all arrays of an answer. */
function arrays(answer: Answers[Task]): ArrayBuffer[] {
  return answer === null ? [] : Object.values(answer).flatMap((value) => (ArrayBuffer.isView(value) ? [value.buffer as ArrayBuffer] : []));
}

async function answer<T extends Task>({ id, task, request }: Question<T>): Promise<void> {
  let reply: Reply;
  try {
    reply = { id, answer: await tasks[task](request) };
  } catch (error) {
    const isMemory = error instanceof RangeError;
    reply = { id, error: isMemory ? "there is not enough memory for it" : error instanceof Error ? error.message : String(error), isFile: error instanceof BadFile };
  }
  postMessage(reply, { transfer: "answer" in reply ? arrays(reply.answer) : [] });
}

let before: Promise<void> = Promise.resolve();
addEventListener("message", (event: MessageEvent<Question>) => {
  before = before.then(() => answer(event.data));
});
