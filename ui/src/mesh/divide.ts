// Facets that are small enough for cells to be drawn on.
//
// Purpose: divides facets that are large beside the cells, so that the few nearest seeds of a facet's centre contain the
// nearest seed of each of its points. Invariant: the surface is the same; there are never more facets than the limit. Must not
// know: seeds that move later; cells are of about the same size then.

import type { NearestSeeds } from "./nearest.ts";

/** An edge may be this many times the distance of neighbouring seeds. */
const LONGEST = 1.3;

/** Corners of the divided facets, nine numbers each. */
export function divide(corners: Float32Array, seeds: NearestSeeds, limit: number): Float32Array<ArrayBuffer> {
  let list = new Float32Array(Math.max(corners.length, 9));
  let length = 0;
  // What is on the stack becomes a facet at least.
  let waiting = corners.length / 9;
  const found = new Uint32Array(seeds.k);
  const put = (facet: Float64Array): void => {
    if (length + 9 > list.length) {
      const longer = new Float32Array(2 * list.length);
      longer.set(list);
      list = longer;
    }
    list.set(facet, length);
    length += 9;
  };
  const stack: Float64Array[] = [];
  for (let first = 0; first < corners.length; first += 9) {
    stack.push(Float64Array.from(corners.subarray(first, first + 9)));
    while (stack.length > 0) {
      const facet = stack.pop() as Float64Array;
      const lengths = [0, 1, 2].map((i) => edge(facet, i));
      const longest = lengths.indexOf(Math.max(...lengths));
      const isFull = length / 9 + waiting + 1 >= limit;
      if (isFull || lengths[longest] <= LONGEST * spacing(facet, seeds, found)) {
        put(facet);
        waiting--;
        continue;
      }
      waiting++;
      const a = longest;
      const b = (longest + 1) % 3;
      const half = new Float64Array(facet);
      const other = new Float64Array(facet);
      for (let axis = 0; axis < 3; axis++) {
        const middle = (facet[3 * a + axis] + facet[3 * b + axis]) / 2;
        half[3 * b + axis] = middle;
        other[3 * a + axis] = middle;
      }
      stack.push(half, other);
    }
  }
  return list.slice(0, length);
}

/** The length of the edge from corner i to the next. */
function edge(facet: Float64Array, i: number): number {
  const a = 3 * i;
  const b = 3 * ((i + 1) % 3);
  return Math.hypot(facet[a] - facet[b], facet[a + 1] - facet[b + 1], facet[a + 2] - facet[b + 2]);
}

/** About how far apart seeds are here: k of them in a disk. */
function spacing(facet: Float64Array, seeds: NearestSeeds, found: Uint32Array): number {
  const centre = [0, 1, 2].map((axis) => (facet[axis] + facet[3 + axis] + facet[6 + axis]) / 3);
  seeds.ask(centre[0], centre[1], centre[2], found, 0);
  const last = Math.min(seeds.k, seeds.count) - 1;
  if (last < 1) return Infinity;
  return Math.sqrt((Math.PI * seeds.squares[last]) / (last + 1));
}
