// Shape of triangles.
//
// Purpose: Q of every facet and what is told of all. Invariant: Q is (6/sqrt 3) area / (half perimeter * longest edge), from 0
// (no area) to 1 (equilateral), as the service's report has it. Must not know: how it is coloured.

import type { Surface } from "./surface.ts";

export interface QualityFigures {
  readonly least: number;
  readonly mean: number;
  /** Degrees. */
  readonly smallestAngle: number;
  /** Percent of the facets that have an angle below 30 degrees. */
  readonly under30: number;
  /** Percent of the facets in each bin of Q from 0 to 1, and of the smallest angle from 0 to 60 degrees. */
  readonly shares: { readonly q: readonly number[]; readonly angle: readonly number[] };
  /** In squared units of the file. */
  readonly area: number;
}

const BINS = 30;

/** Q of each facet, and the figures. */
export function quality(surface: Surface): { values: Float32Array; figures: QualityFigures } {
  const { positions, indices } = surface;
  const facets = indices.length / 3;
  const values = new Float32Array(facets);
  const factor = 6 / Math.sqrt(3);
  const cos30 = Math.sqrt(3) / 2;
  let least = Infinity;
  let sum = 0;
  let largestCosine = -1;
  let under = 0;
  let total = 0;
  const [ofQ, ofAngle] = [new Float64Array(BINS), new Float64Array(BINS)];
  for (let facet = 0; facet < facets; facet++) {
    const i = 3 * indices[3 * facet];
    const j = 3 * indices[3 * facet + 1];
    const k = 3 * indices[3 * facet + 2];
    const ux = positions[j] - positions[i], uy = positions[j + 1] - positions[i + 1], uz = positions[j + 2] - positions[i + 2];
    const vx = positions[k] - positions[i], vy = positions[k + 1] - positions[i + 1], vz = positions[k + 2] - positions[i + 2];
    const cx = uy * vz - uz * vy, cy = uz * vx - ux * vz, cz = ux * vy - uy * vx;
    const area = Math.sqrt(cx * cx + cy * cy + cz * cz) / 2;
    const a = Math.sqrt(ux * ux + uy * uy + uz * uz);
    const b = Math.sqrt(vx * vx + vy * vy + vz * vz);
    const c = Math.sqrt((ux - vx) ** 2 + (uy - vy) ** 2 + (uz - vz) ** 2);
    const longest = Math.max(a, b, c);
    const denominator = ((a + b + c) / 2) * longest;
    const q = denominator > 0 ? Math.min((factor * area) / denominator, 1) : 0;
    values[facet] = q;
    least = Math.min(least, q);
    sum += q;
    // The smallest angle is opposite the shortest edge.
    const shortest = Math.min(a, b, c);
    const middle = a + b + c - longest - shortest;
    const cosine = shortest > 0 ? (longest * longest + middle * middle - shortest * shortest) / (2 * longest * middle) : 1;
    largestCosine = Math.max(largestCosine, cosine);
    if (cosine > cos30) under++;
    total += area;
    ofQ[Math.min(Math.floor(BINS * q), BINS - 1)]++;
    ofAngle[Math.min(Math.floor((BINS * 3 * Math.acos(Math.min(cosine, 1))) / Math.PI), BINS - 1)]++;
  }
  const percent = (counts: Float64Array): number[] => Array.from(counts, (count) => (100 * count) / facets);
  const smallestAngle = (Math.acos(Math.min(largestCosine, 1)) * 180) / Math.PI;
  return { values, figures: { least, mean: sum / facets, smallestAngle, under30: (100 * under) / facets, shares: { q: percent(ofQ), angle: percent(ofAngle) }, area: total } };
}
