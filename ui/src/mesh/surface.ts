// A triangle surface in memory.
//
// Purpose: the one form that all readers give and all measures take. Invariant: every index is below the number of
// vertices, every coordinate is finite. Must not know: files, the page, how a surface is drawn.

/** Triangles that share vertices. Coordinates keep double precision. */
export interface Surface {
  readonly positions: Float64Array;
  readonly indices: Uint32Array;
}

/** Maps coordinates of a file to those that are drawn: the box is centred, and its diagonal is 1. */
export interface Frame {
  readonly centre: readonly [number, number, number];
  readonly diagonal: number;
}

export function frameOf(surface: Surface): Frame {
  const { positions } = surface;
  const low = [Infinity, Infinity, Infinity];
  const high = [-Infinity, -Infinity, -Infinity];
  for (let i = 0; i < positions.length; i += 3) {
    for (let axis = 0; axis < 3; axis++) {
      const x = positions[i + axis];
      if (x < low[axis]) low[axis] = x;
      if (x > high[axis]) high[axis] = x;
    }
  }
  const centre = [0, 1, 2].map((axis) => low[axis] / 2 + high[axis] / 2) as [number, number, number];
  const diagonal = Math.hypot(high[0] - low[0], high[1] - low[1], high[2] - low[2]);
  return { centre, diagonal: Number.isFinite(diagonal) && diagonal > 0 ? diagonal : 1 };
}

/** The corners of all facets, three after three, in the frame. */
export function cornersOf(surface: Surface, frame: Frame): Float32Array<ArrayBuffer> {
  const { positions, indices } = surface;
  const { centre, diagonal } = frame;
  const corners = new Float32Array(3 * indices.length);
  for (let corner = 0; corner < indices.length; corner++) {
    const vertex = 3 * indices[corner];
    for (let axis = 0; axis < 3; axis++) {
      corners[3 * corner + axis] = (positions[vertex + axis] - centre[axis]) / diagonal;
    }
  }
  return corners;
}

/** A value of each vertex at all corners. */
export function spread(surface: Surface, ofVertices: Float32Array): Float32Array<ArrayBuffer> {
  const { indices } = surface;
  const values = new Float32Array(indices.length);
  for (let corner = 0; corner < indices.length; corner++) values[corner] = ofVertices[indices[corner]];
  return values;
}
