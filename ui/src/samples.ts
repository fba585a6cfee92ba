// Surfaces to try.
//
// Purpose: makes three meshes with poor triangles, as OBJ files: a swept tube, a part with sharp edges, an isosurface.
// Invariant: each is closed, and the same on every machine up to rounding. Must not know: the page, the service.

type Point = readonly [number, number, number];

export type Sample = "knot" | "bent-box" | "three-holes";

/** Points for a useful remesh. */
export const SAMPLE_POINTS = 3000;

export function sample(name: Sample): File {
  const { points, facets } = makers[name]();
  const text = [...points.map((point) => `v ${point.map((x) => x.toFixed(6)).join(" ")}`), ...facets.map((facet) => `f ${facet.map((i) => i + 1).join(" ")}`), ""];
  return new File([text.join("\n")], `${name}.obj`);
}

interface Mesh {
  readonly points: Point[];
  readonly facets: (readonly number[])[];
}

const makers: Record<Sample, () => Mesh> = { knot, "bent-box": bentBox, "three-holes": threeHoles };

/** The two triangles of a quadrilateral. */
const halves = (a: number, b: number, c: number, d: number): number[][] => [[a, b, c], [a, c, d]];

/** A tube around a trefoil: triangles of very different lengths. */
function knot(): Mesh {
  const [along, around] = [240, 14];
  const at = (t: number): Point => [Math.sin(t) + 2 * Math.sin(2 * t), Math.cos(t) - 2 * Math.cos(2 * t), -Math.sin(3 * t)];
  const points: Point[] = [];
  const facets: number[][] = [];
  const index = (i: number, j: number): number => (i % along) * around + (j % around);
  for (let i = 0; i < along; i++) {
    const t = (2 * Math.PI * i) / along;
    const [p, next] = [at(t), at(t + 1e-4)];
    const ahead = unit([next[0] - p[0], next[1] - p[1], next[2] - p[2]]);
    const side = unit(cross(ahead, [0, 0, 1]));
    const up = cross(side, ahead);
    for (let j = 0; j < around; j++) {
      const angle = (2 * Math.PI * j) / around;
      const [a, b] = [0.45 * Math.cos(angle), 0.45 * Math.sin(angle)];
      points.push([p[0] + a * side[0] + b * up[0], p[1] + a * side[1] + b * up[1], p[2] + a * side[2] + b * up[2]]);
      facets.push(...halves(index(i, j), index(i + 1, j), index(i + 1, j + 1), index(i, j + 1)));
    }
  }
  return { points, facets };
}

/** A box bent by three quarters of a turn: sharp edges and long triangles. */
function bentBox(): Mesh {
  const steps = 36;
  const section: readonly (readonly [number, number])[] = [[2, -0.7], [3, -0.7], [3, 0.7], [2, 0.7]];
  const points: Point[] = [];
  const facets: number[][] = [];
  for (let i = 0; i <= steps; i++) {
    const angle = (1.5 * Math.PI * i) / steps;
    for (const [radius, height] of section) points.push([radius * Math.cos(angle), height, radius * Math.sin(angle)]);
    if (i === steps) break;
    for (let j = 0; j < 4; j++) {
      const [a, b] = [4 * i + j, 4 * i + ((j + 1) % 4)];
      facets.push(...halves(a, b, b + 4, a + 4));
    }
  }
  const last = 4 * steps;
  facets.push(...halves(3, 2, 1, 0), ...halves(last, last + 1, last + 2, last + 3));
  return { points, facets };
}

/** Where three rings meet, as an isosurface of a grid: a point in each cube that it crosses, a quadrilateral around each edge. */
function threeHoles(): Mesh {
  const size = [58, 58, 16] as const;
  const step = 4.4 / 57;
  const place = (i: number, axis: number): number => (i - (size[axis]! - 1) / 2) * step;
  const at = (i: number, j: number, k: number): number => (k * size[1] + j) * size[0] + i;
  const values = new Float64Array(size[0] * size[1] * size[2]);
  for (let k = 0; k < size[2]; k++) for (let j = 0; j < size[1]; j++) for (let i = 0; i < size[0]; i++) {
    values[at(i, j, k)] = rings(place(i, 0), place(j, 1), place(k, 2));
  }
  const points: Point[] = [];
  const facets: number[][] = [];
  const pointOf = new Map<number, number>();
  const strides = [at(1, 0, 0), at(0, 1, 0), at(0, 0, 1)];
  for (let k = 0; k + 1 < size[2]; k++) for (let j = 0; j + 1 < size[1]; j++) for (let i = 0; i + 1 < size[0]; i++) {
    const sum = [0, 0, 0];
    let crossed = 0;
    for (let corner = 0; corner < 8; corner++) for (let axis = 0; axis < 3; axis++) {
      if ((corner >> axis) & 1) continue;
      const offset = [corner & 1, (corner >> 1) & 1, corner >> 2];
      const a = values[at(i + offset[0]!, j + offset[1]!, k + offset[2]!)]!;
      offset[axis]!++;
      const b = values[at(i + offset[0]!, j + offset[1]!, k + offset[2]!)]!;
      if (a < 0 === b < 0) continue;
      offset[axis]! += a / (a - b) - 1;
      [i, j, k].forEach((base, of) => (sum[of]! += place(base + offset[of]!, of)));
      crossed++;
    }
    if (crossed === 0) continue;
    pointOf.set(at(i, j, k), points.length);
    points.push([sum[0]! / crossed, sum[1]! / crossed, sum[2]! / crossed]);
  }
  for (const cube of pointOf.keys()) for (let axis = 0; axis < 3; axis++) {
    const [a, b] = [values[cube]!, values[cube + strides[axis]!]!];
    if (a < 0 === b < 0) continue;
    const [u, v] = [strides[(axis + 1) % 3]!, strides[(axis + 2) % 3]!];
    const around = [cube, cube - u, cube - u - v, cube - v].map((one) => pointOf.get(one));
    if (around.some((one) => one === undefined)) continue;
    const [p, q, r, s] = around as [number, number, number, number];
    facets.push(...(a < 0 ? halves(p, q, r, s) : halves(s, r, q, p)));
  }
  return { points, facets };
}

/** Negative inside of three rings that run into each other: a smooth minimum of their distances. */
function rings(x: number, y: number, z: number): number {
  let sum = 0;
  for (let i = 0; i < 3; i++) {
    const angle = Math.PI / 2 + (2 * Math.PI * i) / 3;
    const flat = Math.hypot(x - 0.95 * Math.cos(angle), y - 0.95 * Math.sin(angle));
    sum += Math.exp(-8 * (Math.hypot(flat - 0.75, z) - 0.3));
  }
  return -Math.log(sum) / 8;
}

function cross(a: Point, b: Point): Point {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

function unit(a: Point): Point {
  const length = Math.hypot(...a);
  return [a[0] / length, a[1] / length, a[2] / length];
}
