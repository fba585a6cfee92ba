//! The nearest seed of every facet, where its walk over the cells begins.
//!
//! Purpose: a seed whose cell holds the facet's centroid, found by walking the neighbour table from
//! a guess and proved by the same radius that ends a clip; the seeds' index answers where the table
//! cannot.
//! Invariant: the answer is a nearest seed, never a later duplicate. Which of several equal ones it is may depend on the
//! guess; the diagram does not. A guess that is to be made better promises nothing.
//! Must not know: polygons.

use std::ops::Range;

use glam::DVec3;
use rayon::prelude::*;

use super::incident::Diagram;
use crate::token::Token;

/// Facets per task. Part of no result.
const CHUNK: usize = 512;
/// Facets between two looks at the token.
const ASKED: usize = 32;

/// The first cells of a range of facets, kept as guesses for when the seeds have moved.
#[derive(Debug, Default)]
pub struct Starts {
    facets: Range<u32>,
    seeds: Vec<u32>,
}

impl Starts {
    /// Finds those of `facets` on all threads of the present pool. The guess is the last answer for
    /// the same facets, or the one before where that is near; without one the index answers, which is faster than a
    /// walk from afar. Ends early where `token` is stopped; the answers are then of no use.
    pub fn find(&mut self, diagram: Diagram<'_>, facets: Range<u32>, token: &Token) -> &mut [u32] {
        let guessed = self.facets == facets;
        self.seeds.resize(facets.len(), 0);
        self.seeds.par_chunks_mut(CHUNK).enumerate().for_each(|(c, part)| {
            let mut last = None;
            for (k, start) in part.iter_mut().enumerate() {
                if k.is_multiple_of(ASKED) && token.is_stopped() {
                    return;
                }
                let q = diagram.surface.centroid(facets.start + (c * CHUNK + k) as u32);
                let old = Some(*start).filter(|&s| guessed && (s as usize) < diagram.seeds.len());
                // Facets in a row are often beside each other.
                *start = match old.or_else(|| last.filter(|&s| is_beside(diagram, q, s))) {
                    Some(guess) => nearest(diagram, q, guess),
                    None => diagram.index.nearest(q),
                };
                last = Some(*start);
            }
        });
        self.facets = facets;
        &mut self.seeds
    }
}

/// Whether a walk from seed `s` to `q` is short: `q` is no farther away than the last neighbour in the table.
fn is_beside(diagram: Diagram<'_>, q: DVec3, s: u32) -> bool {
    let here = diagram.seeds[s as usize];
    let last = diagram.table.row(s).0.last();
    last.is_some_and(|&j| q.distance_squared(here) <= here.distance_squared(diagram.seeds[j as usize]))
}

/// A nearest seed of `q`, from the guess `from`. Seeds nearer to q than x_i lie within 2|q - x_i|
/// of x_i, so the row of i, nearest first, need not be read beyond that.
pub(super) fn nearest(diagram: Diagram<'_>, q: DVec3, from: u32) -> u32 {
    let Diagram { seeds, index, table, .. } = diagram;
    let mut i = first_duplicate(diagram, from);
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

/// The earliest seed at the place of seed `i`. A later one has no cell, and no neighbour but it.
fn first_duplicate(diagram: Diagram<'_>, i: u32) -> u32 {
    match diagram.table.row(i).0 {
        [first, ..] if diagram.seeds[*first as usize] == diagram.seeds[i as usize] => *first,
        _ => i,
    }
}
