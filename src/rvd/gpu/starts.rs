//! The first cell of each facet: the seed nearest to its centroid (\[HYWZ17\], Algorithm 1).
//!
//! Purpose: find it for all facets on all threads, each from a good guess: what it was before
//! the seeds moved, or else the first cell of the facet before it in the list.
//! Invariant: the answer is a nearest seed of the centroid, computed in f64, never a later twin.
//! Must not know: the device.

use rayon::prelude::*;

use crate::rvd::incident::Diagram;
use crate::rvd::start::nearest;

/// Facets per task. Part of no result.
const CHUNK: usize = 512;

/// Fills `starts` for all facets; what it holds already serves as a guess.
pub fn find(diagram: Diagram<'_>, starts: &mut Vec<u32>) {
    let facets = diagram.surface.facets().len();
    let guessed = starts.len() == facets;
    starts.resize(facets, 0);
    starts.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, part)| {
        let mut last = None;
        for (k, start) in part.iter_mut().enumerate() {
            let centroid = diagram.surface.centroid((chunk * CHUNK + k) as u32);
            let old = Some(*start).filter(|&s| guessed && (s as usize) < diagram.seeds.len());
            *start = match old.or(last) {
                Some(guess) => nearest(diagram, centroid, first_twin(diagram, guess)),
                None => diagram.index.nearest(centroid),
            };
            last = Some(*start);
        }
    });
}

/// The earliest seed at the place of seed `i`. A later one has no cell, and no neighbour but it.
fn first_twin(diagram: Diagram<'_>, i: u32) -> u32 {
    match diagram.table.row(i).0 {
        [first, ..] if diagram.seeds[*first as usize] == diagram.seeds[i as usize] => *first,
        _ => i,
    }
}
