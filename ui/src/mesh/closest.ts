// The closest point of a surface.
//
// Purpose: a bounding volume hierarchy over triangles that answers how far a point is. Invariant: the answer is that of a look
// at all triangles. Must not know: which surface is the input.

import type { Surface } from "./surface.ts";

/** The most triangles of a leaf. */
const LEAF = 4;

export class ClosestPoint {
  private readonly order: Uint32Array;
  /** Six numbers of each node: its box. Nodes are in depth-first order; the left child follows its parent. */
  private readonly boxes: Float64Array;
  /** The right child of an inner node; of a leaf, minus its first triangle minus one. */
  private readonly links: Int32Array;
  private readonly counts: Uint8Array;
  private nodes = 0;
  private readonly corners: Float64Array;

  constructor(surface: Surface) {
    const { positions, indices } = surface;
    const facets = indices.length / 3;
    const centres = new Float64Array(3 * facets);
    for (let facet = 0; facet < facets; facet++) {
      for (let axis = 0; axis < 3; axis++) {
        const at = (i: number): number => positions[3 * indices[3 * facet + i] + axis];
        centres[3 * facet + axis] = (at(0) + at(1) + at(2)) / 3;
      }
    }
    this.order = Uint32Array.from({ length: facets }, (_, i) => i);
    const most = 2 * Math.ceil(facets / (LEAF / 2)) + 2;
    this.boxes = new Float64Array(6 * most);
    this.links = new Int32Array(most);
    this.counts = new Uint8Array(most);
    this.build(surface, centres, 0, facets);
    // Corners in the order of the leaves: what is near is read together.
    this.corners = new Float64Array(9 * facets);
    for (let i = 0; i < facets; i++) {
      for (let corner = 0; corner < 9; corner++) {
        const vertex = indices[3 * this.order[i] + Math.floor(corner / 3)];
        this.corners[9 * i + corner] = positions[3 * vertex + (corner % 3)];
      }
    }
  }

  private build(surface: Surface, centres: Float64Array, begin: number, end: number): void {
    const node = this.nodes++;
    const { boxes, order } = this;
    const { positions, indices } = surface;
    const low = [Infinity, Infinity, Infinity];
    const high = [-Infinity, -Infinity, -Infinity];
    const from = [Infinity, Infinity, Infinity];
    const to = [-Infinity, -Infinity, -Infinity];
    for (let i = begin; i < end; i++) {
      const facet = order[i];
      for (let axis = 0; axis < 3; axis++) {
        for (let corner = 0; corner < 3; corner++) {
          const x = positions[3 * indices[3 * facet + corner] + axis];
          if (x < low[axis]) low[axis] = x;
          if (x > high[axis]) high[axis] = x;
        }
        const x = centres[3 * facet + axis];
        if (x < from[axis]) from[axis] = x;
        if (x > to[axis]) to[axis] = x;
      }
    }
    boxes.set(low, 6 * node);
    boxes.set(high, 6 * node + 3);
    if (end - begin <= LEAF) {
      this.links[node] = -begin - 1;
      this.counts[node] = end - begin;
      return;
    }
    const extents = [0, 1, 2].map((axis) => to[axis] - from[axis]);
    const axis = extents.indexOf(Math.max(...extents));
    const middle = (begin + end) >> 1;
    select(order, centres, axis, begin, end, middle);
    this.build(surface, centres, begin, middle);
    this.links[node] = this.nodes;
    this.build(surface, centres, middle, end);
  }

  /** The distance of a point. */
  distance(x: number, y: number, z: number): number {
    const { links, counts, corners } = this;
    let best = Infinity;
    const stack = STACK;
    let height = 0;
    stack[height++] = 0;
    while (height > 0) {
      const node = stack[--height];
      if (this.toBox(node, x, y, z) >= best) continue;
      if (counts[node] > 0) {
        const first = -links[node] - 1;
        for (let i = first; i < first + counts[node]; i++) best = Math.min(best, toTriangle(corners, 9 * i, x, y, z));
        continue;
      }
      const left = node + 1;
      const right = links[node];
      // The nearer one is looked at first.
      const isLeft = this.toBox(left, x, y, z) <= this.toBox(right, x, y, z);
      stack[height++] = isLeft ? right : left;
      stack[height++] = isLeft ? left : right;
    }
    return Math.sqrt(best);
  }

  /** The squared distance of a box. */
  private toBox(node: number, x: number, y: number, z: number): number {
    const { boxes } = this;
    const at = 6 * node;
    const dx = Math.max(boxes[at] - x, x - boxes[at + 3], 0);
    const dy = Math.max(boxes[at + 1] - y, y - boxes[at + 4], 0);
    const dz = Math.max(boxes[at + 2] - z, z - boxes[at + 5], 0);
    return dx * dx + dy * dy + dz * dz;
  }
}

/** Halves are as large as each other, so no path is longer than this. */
const STACK = new Int32Array(128);

/** Orders so that what is before `middle` has no larger coordinate than what is after it. */
export function select(order: Uint32Array, points: Float64Array, axis: number, begin: number, end: number, middle: number): void {
  let low = begin;
  let high = end - 1;
  while (low < high) {
    const pivot = points[3 * order[(low + high) >> 1] + axis];
    let i = low;
    let j = high;
    while (i <= j) {
      while (points[3 * order[i] + axis] < pivot) i++;
      while (points[3 * order[j] + axis] > pivot) j--;
      if (i <= j) {
        const other = order[i];
        order[i++] = order[j];
        order[j--] = other;
      }
    }
    if (middle <= j) high = j;
    else if (middle >= i) low = i;
    else return;
  }
}

/** The squared distance of a triangle: of its plane if the foot is inside, else of the nearest edge. */
function toTriangle(corners: Float64Array, at: number, x: number, y: number, z: number): number {
  const ax = corners[at] - x, ay = corners[at + 1] - y, az = corners[at + 2] - z;
  const bx = corners[at + 3] - x, by = corners[at + 4] - y, bz = corners[at + 5] - z;
  const cx = corners[at + 6] - x, cy = corners[at + 7] - y, cz = corners[at + 8] - z;
  const ux = bx - ax, uy = by - ay, uz = bz - az;
  const vx = cx - ax, vy = cy - ay, vz = cz - az;
  const nx = uy * vz - uz * vy, ny = uz * vx - ux * vz, nz = ux * vy - uy * vx;
  const square = nx * nx + ny * ny + nz * nz;
  if (square > 0) {
    // The point is inside if it is on the inner side of all three edges.
    const ab = side(ax, ay, az, bx, by, bz, nx, ny, nz);
    const bc = side(bx, by, bz, cx, cy, cz, nx, ny, nz);
    const ca = side(cx, cy, cz, ax, ay, az, nx, ny, nz);
    if (ab >= 0 && bc >= 0 && ca >= 0) {
      const height = ax * nx + ay * ny + az * nz;
      return (height * height) / square;
    }
  }
  return Math.min(toEdge(ax, ay, az, bx, by, bz), toEdge(bx, by, bz, cx, cy, cz), toEdge(cx, cy, cz, ax, ay, az));
}

function side(px: number, py: number, pz: number, qx: number, qy: number, qz: number, nx: number, ny: number, nz: number): number {
  return (py * qz - pz * qy) * nx + (pz * qx - px * qz) * ny + (px * qy - py * qx) * nz;
}

/** The squared distance of the origin to a segment. */
function toEdge(px: number, py: number, pz: number, qx: number, qy: number, qz: number): number {
  const dx = qx - px, dy = qy - py, dz = qz - pz;
  const square = dx * dx + dy * dy + dz * dz;
  const t = square > 0 ? Math.min(Math.max(-(px * dx + py * dy + pz * dz) / square, 0), 1) : 0;
  const fx = px + t * dx, fy = py + t * dy, fz = pz + t * dz;
  return fx * fx + fy * fy + fz * fz;
}

export interface DistanceFigures {
  /** All in percent of the diagonal. */
  readonly largest: number;
  readonly mean: number;
  /** 98 % of the vertices are not farther. */
  readonly most: number;
}

/** The distance of each vertex to a surface, in percent of the diagonal. */
export function distances(of: Surface, to: ClosestPoint, diagonal: number): { values: Float32Array; figures: DistanceFigures } {
  const { positions } = of;
  const count = positions.length / 3;
  const values = new Float32Array(count);
  let largest = 0;
  let sum = 0;
  for (let vertex = 0; vertex < count; vertex++) {
    const i = 3 * vertex;
    const value = (100 * to.distance(positions[i], positions[i + 1], positions[i + 2])) / diagonal;
    values[vertex] = value;
    largest = Math.max(largest, value);
    sum += value;
  }
  return { values, figures: { largest, mean: sum / count, most: values.slice().sort()[Math.floor(0.98 * (count - 1))] ?? 0 } };
}
