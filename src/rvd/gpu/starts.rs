//! The first cell of each facet: the seed nearest to its centroid (\[HYWZ17\], Algorithm 1).
//!
//! Purpose: find it by a walk over neighbour rows from a good guess, which costs an eighth of a
//! fresh query, and fall back to the tree where the walk cannot prove its answer.
//! Invariant: the answer is a nearest seed of the centroid, computed in f64, never a later twin.
//! Must not know: the device.

use glam::DVec3;
use rayon::prelude::*;

use crate::knn::{NeighbourTable, SeedIndex};
use crate::rvd::Surface;

/// Facets per task. Part of no result.
const CHUNK: usize = 512;

/// Fills `starts` for all facets; what it holds already serves as a guess.
pub fn find(surface: &Surface, seeds: &[DVec3], index: &SeedIndex, table: &NeighbourTable, starts: &mut Vec<u32>) {
    let guessed = starts.len() == surface.facets().len();
    starts.resize(surface.facets().len(), 0);
    starts.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, part)| {
        let mut last = None;
        for (k, start) in part.iter_mut().enumerate() {
            let centroid = surface.centroid((chunk * CHUNK + k) as u32);
            let guess = if guessed && (*start as usize) < seeds.len() { Some(*start) } else { last };
            *start = match guess {
                Some(guess) => walk(seeds, index, table, guess, centroid),
                None => index.nearest(centroid),
            };
            last = Some(*start);
        }
    });
}

/// The seed nearest to `q`, walking from `at`. A seed i is nearest if no seed within 2 |q - x_i|
/// of it is nearer, because any farther one is at least |q - x_i| from q.
fn walk(seeds: &[DVec3], index: &SeedIndex, table: &NeighbourTable, mut at: u32, q: DVec3) -> u32 {
    loop {
        let here = seeds[at as usize];
        let d2 = q.distance_squared(here);
        let (row, complete) = table.row(at);
        let (mut best, mut best2, mut closed) = (at, d2, complete);
        for &j in row {
            let x = seeds[j as usize];
            let b2 = x.distance_squared(here);
            if b2 > 4.0 * d2 {
                closed = true;
                break;
            }
            let j2 = q.distance_squared(x);
            // Only a later twin has a neighbour at its own place.
            if j2 < best2 || (j2 == best2 && (b2 == 0.0 || j < best)) {
                (best, best2) = (j, j2);
            }
        }
        if best2 < d2 || (best != at && seeds[best as usize] == here) {
            at = best;
        } else if closed {
            return best;
        } else {
            return index.nearest(q);
        }
    }
}
