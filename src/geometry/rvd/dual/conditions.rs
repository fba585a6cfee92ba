//! When the dual has the topology of the surface.
//!
//! Purpose: finds what breaks it. The dual is homeomorphic to the surface if every component of
//! a restricted cell is a disk that meets the boundary in at most one stretch, and two of them meet
//! in at most one curve (the closed ball property, Edelsbrunner and Shah 1997); where that fails,
//! more seeds are the cure.
//! Invariant: read from symbolic identities alone. A mesh line meets a convex cell in one segment, so
//! a component with F pieces, E mesh edges between two of its pieces and V mesh vertices inside has
//! χ = F - E + V, and is a disk if that is 1.
//! Must not know: triangles, positions.

use rayon::prelude::*;

use crate::mesh::edges::DisjointSets;

/// A stretch of the curve in which two cells meet, within one facet: the pieces on its two sides.
pub(super) type Stretch = [u32; 2];

/// Where such a curve crosses a mesh edge: (edge, seeds in order) -> stretch.
pub(super) type Crossing = ((u32, [u32; 2]), u32);

/// Components that are not a disk, ascending. `pieces` has the component of each piece; `joints` the
/// component of each mesh edge between two pieces; `inner` that of each mesh vertex inside.
pub(super) fn not_disks(components: usize, pieces: &[u32], joints: &[u32], inner: &[u32]) -> Vec<u32> {
    let mut chi = vec![0i64; components];
    pieces.iter().for_each(|&c| chi[c as usize] += 1);
    joints.iter().for_each(|&c| chi[c as usize] -= 1);
    inner.iter().for_each(|&c| chi[c as usize] += 1);
    numbers(chi, |&chi| chi != 1)
}

/// Components that meet the boundary in more than one stretch, ascending. `ends` has the component of every
/// end of a stretch.
pub(super) fn multiple_boundary_arcs(components: usize, ends: impl Iterator<Item = u32>) -> Vec<u32> {
    let mut count = vec![0u32; components];
    ends.for_each(|c| count[c as usize] += 1);
    numbers(count, |&ends| ends > 2)
}

/// Where it is so.
fn numbers<T>(of: Vec<T>, is_so: impl Fn(&T) -> bool) -> Vec<u32> {
    (0..).zip(of).filter(|(_, value)| is_so(value)).map(|(number, _)| number).collect()
}

/// Pairs of components that meet in more than one curve, ascending.
pub(super) fn multiple_edges(stretches: &[Stretch], mut crossings: Vec<Crossing>, component: &[u32]) -> Vec<[u32; 2]> {
    let mut curves = DisjointSets::new(stretches.len());
    crossings.par_sort_unstable();
    for here in crossings.chunk_by(|a, b| a.0 == b.0) {
        here.windows(2).for_each(|pair| curves.join(pair[0].1 as usize, pair[1].1 as usize));
    }
    let mut pairs: Vec<[u32; 2]> = (0..stretches.len())
        .filter(|&s| curves.root(s) == s)
        .map(|s| {
            let [a, b] = stretches[s].map(|piece| component[piece as usize]);
            [a.min(b), a.max(b)]
        })
        .collect();
    pairs.sort_unstable();
    pairs.chunk_by(|a, b| a == b).filter(|same| same.len() > 1).map(|same| same[0]).collect()
}
