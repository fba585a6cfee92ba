// The nearest seeds of a point.
//
// Purpose: a k-d tree over seeds that gives the k nearest, the nearest first. Invariant: the answer is that of a look at all
// seeds, whatever their density. Must not know: what a seed is for.

import { select } from "./closest.ts";

/** The most seeds of a leaf. */
const LEAF = 8;

export class NearestSeeds {
  private readonly order: Uint32Array;
  /** Axis of each node of the balanced tree, by the middle of its range. */
  private readonly axes: Uint8Array;
  readonly count: number;
  /** Of the last question: squared distances, ascending. */
  readonly squares: Float64Array;
  private held = 0;
  private readonly found: Uint32Array;

  constructor(private readonly points: Float64Array, readonly k: number) {
    this.count = points.length / 3;
    this.order = Uint32Array.from({ length: this.count }, (_, i) => i);
    this.axes = new Uint8Array(this.count);
    this.squares = new Float64Array(k);
    this.found = new Uint32Array(k);
    this.build(0, this.count);
  }

  private build(begin: number, end: number): void {
    if (end - begin <= LEAF) return;
    const { points, order } = this;
    const low = [Infinity, Infinity, Infinity];
    const high = [-Infinity, -Infinity, -Infinity];
    for (let i = begin; i < end; i++) {
      for (let axis = 0; axis < 3; axis++) {
        const x = points[3 * order[i] + axis];
        if (x < low[axis]) low[axis] = x;
        if (x > high[axis]) high[axis] = x;
      }
    }
    const extents = [0, 1, 2].map((axis) => high[axis] - low[axis]);
    const axis = extents.indexOf(Math.max(...extents));
    const middle = (begin + end) >> 1;
    select(order, points, axis, begin, end, middle);
    this.axes[middle] = axis;
    this.build(begin, middle);
    this.build(middle + 1, end);
  }

  /** Writes the k nearest to a list. If there are fewer seeds, the last is repeated. */
  ask(x: number, y: number, z: number, into: Uint32Array, at: number): void {
    this.held = 0;
    this.squares.fill(Infinity);
    this.visit(0, this.count, x, y, z);
    for (let i = 0; i < this.k; i++) into[at + i] = this.found[Math.min(i, this.held - 1)];
  }

  private visit(begin: number, end: number, x: number, y: number, z: number): void {
    if (end - begin <= LEAF) {
      for (let i = begin; i < end; i++) this.look(this.order[i], x, y, z);
      return;
    }
    const middle = (begin + end) >> 1;
    const axis = this.axes[middle];
    const seed = this.order[middle];
    const beyond = (axis === 0 ? x : axis === 1 ? y : z) - this.points[3 * seed + axis];
    if (beyond < 0) this.visit(begin, middle, x, y, z);
    else this.visit(middle + 1, end, x, y, z);
    this.look(seed, x, y, z);
    if (beyond * beyond >= this.squares[this.k - 1]) return;
    if (beyond < 0) this.visit(middle + 1, end, x, y, z);
    else this.visit(begin, middle, x, y, z);
  }

  private look(seed: number, x: number, y: number, z: number): void {
    const { points, squares, found, k } = this;
    const dx = points[3 * seed] - x, dy = points[3 * seed + 1] - y, dz = points[3 * seed + 2] - z;
    const square = dx * dx + dy * dy + dz * dz;
    if (square >= squares[k - 1]) return;
    let i = Math.min(this.held, k - 1);
    for (; i > 0 && squares[i - 1] > square; i--) {
      squares[i] = squares[i - 1];
      found[i] = found[i - 1];
    }
    squares[i] = square;
    found[i] = seed;
    if (this.held < k) this.held++;
  }
}
