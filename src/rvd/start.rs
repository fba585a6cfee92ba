//! The nearest seed of every facet, where its walk over the cells begins.
//!
//! Purpose: a seed whose cell holds the facet's centroid, found by walking the neighbour table from
//! a guess and proved by the same radius that ends a clip; the kd-tree answers where the table
//! cannot.
//! Invariant: the answer is a nearest seed. Which of several equal ones it is may depend on the
//! guess; the diagram does not.
//! Must not know: polygons.

use glam::DVec3;

use super::incident::Diagram;

/// A nearest seed of `q`, from the guess `from`. Seeds nearer to q than x_i lie within 2|q - x_i|
/// of x_i, so the row of i, nearest first, need not be read beyond that.
pub(super) fn nearest(diagram: Diagram<'_>, q: DVec3, from: u32) -> u32 {
    let Diagram { seeds, index, table, .. } = diagram;
    let mut i = from;
    let mut best = q.distance_squared(seeds[i as usize]);
    'walk: loop {
        let (row, complete) = table.row(i);
        let origin = seeds[i as usize];
        for &j in row {
            let x = seeds[j as usize];
            if x.distance_squared(origin) > 4.0 * best {
                return i;
            }
            let distance = q.distance_squared(x);
            if distance < best {
                (i, best) = (j, distance);
                continue 'walk;
            }
        }
        return if complete { i } else { index.nearest(q) };
    }
}
