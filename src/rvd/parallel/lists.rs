//! The seeds that count on each facet, kept while no seed moves far.
//!
//! Purpose: a pass after one that moved every seed a little finds all cells without looking for neighbours,
//! as molecular dynamics keeps its neighbour lists (Verlet 1967). Seeds that converge move by a
//! hundredth of their spacing, so that a list serves several passes.
//! Invariant: lists are used while every seed is within its slack of where it was when they were made; none
//! that counts is missing then. What comes of a facet is the same with a kept list and with a new one.
//! Must not know: what becomes of a list; surfaces.

use glam::DVec3;
use rayon::prelude::*;

use super::gather::Slack;
use crate::knn::NeighbourTable;

/// A seed's slack is a share of the distance to this neighbour of it, which relaxed cells touch.
const NEIGHBOUR: usize = 6;
/// Lists are made for so many moves like the last one,
const MOVES: f64 = 6.25;
/// with a share of at most this, as lists get longer with it, and of at least that.
const MOST: f64 = 0.2;
const LEAST: f64 = 0.03;
/// They are not made where the last move says that they would not serve twice.
const FAST: f64 = MOST / 2.0;
/// Of its slack a seed may use so much, so that comparisons of distances are never near their roundings.
const USED: f64 = 1.0 - 1e-6;
/// Seeds per task.
const CHUNK: usize = 2048;

/// The lists of one chunk of facets, one after the other; an empty one where it would be too long.
#[derive(Default)]
pub(super) struct Lists {
    ends: Vec<u32>,
    seeds: Vec<u32>,
}

impl Lists {
    pub(super) fn clear(&mut self) {
        self.ends.clear();
        self.seeds.clear();
    }

    pub(super) fn push(&mut self, list: impl IntoIterator<Item = u32>) {
        self.seeds.extend(list);
        self.ends.push(self.seeds.len() as u32);
    }

    /// How many lists there are.
    pub(super) fn len(&self) -> usize {
        self.ends.len()
    }

    /// The list that was pushed last.
    pub(super) fn last_mut(&mut self) -> &mut [u32] {
        let begin = self.ends.len().checked_sub(2).map_or(0, |before| self.ends[before]);
        &mut self.seeds[begin as usize..]
    }

    /// The list of the facet at `at` of the chunk.
    pub(super) fn get(&self, at: usize) -> &[u32] {
        let begin = if at == 0 { 0 } else { self.ends[at - 1] };
        &self.seeds[begin as usize..self.ends[at] as usize]
    }
}

/// All lists, and the seeds that they hold for.
#[derive(Default)]
pub(super) struct KeptLists {
    /// Of each chunk of facets.
    chunks: Vec<Lists>,
    /// Whether there are lists.
    there: bool,
    share: f64,
    /// The distance to a neighbour, of each seed when rows were last made.
    width: Vec<f64>,
    /// Where the seeds were when the lists were made,
    made_at: Vec<DVec3>,
    /// and at the last pass.
    last: Vec<DVec3>,
    /// Seeds that could come to lie on each other within their slack.
    close: Vec<[u32; 2]>,
}

impl KeptLists {
    /// Whether the lists hold for these seeds.
    pub(super) fn hold(&self, seeds: &[DVec3]) -> bool {
        let used2 = (self.share * USED).powi(2);
        let still = |((a, b), width): ((&DVec3, &DVec3), &f64)| a.distance_squared(*b) <= used2 * width * width;
        self.there
            && self.made_at.len() == seeds.len()
            && seeds.iter().zip(&self.made_at).zip(&self.width).all(still)
            && self.close.iter().all(|&[i, j]| seeds[i as usize] != seeds[j as usize])
    }

    /// Chooses the slack of lists that are to be made now, from the new rows of these seeds; or `never`, that none are.
    pub(super) fn choose(&mut self, seeds: &[DVec3], table: &NeighbourTable, never: bool) {
        self.there = false;
        self.share = 0.0;
        if never {
            return;
        }
        self.width.resize(seeds.len(), 0.0);
        // Rows that are too short for it leave no width; lists are not kept then.
        self.width.par_iter_mut().enumerate().with_min_len(CHUNK).for_each(|(i, width)| {
            let neighbour = table.row(i as u32).0.get(NEIGHBOUR - 1);
            *width = neighbour.map_or(0.0, |&j| seeds[i].distance(seeds[j as usize]));
        });
        if self.last.len() != seeds.len() {
            return;
        }
        let moved = |i: usize| {
            if self.width[i] > 0.0 { self.last[i].distance(seeds[i]) / self.width[i] } else { f64::INFINITY }
        };
        let moved = (0..seeds.len()).into_par_iter().with_min_len(CHUNK).map(moved).reduce(|| 0.0, f64::max);
        if moved <= FAST {
            self.share = (MOVES * moved).clamp(LEAST, MOST);
            self.find_close(seeds, table);
            self.made_at.clear();
            self.made_at.extend_from_slice(seeds);
        }
    }

    /// The slack that was chosen, and the lists of so many chunks.
    pub(super) fn split(&mut self, chunks: usize) -> (Slack<'_>, &mut [Lists]) {
        self.chunks.resize_with(chunks, Lists::default);
        (Slack { share: self.share, width: &self.width }, &mut self.chunks)
    }

    /// A pass over these seeds is done; whether it made a list for every facet.
    pub(super) fn end_pass(&mut self, seeds: &[DVec3], made: bool) {
        self.last.clear();
        self.last.extend_from_slice(seeds);
        self.there |= made && self.share > 0.0;
    }

    /// Of two seeds that could meet, one is in the other's row before the neighbour that gives the width: slacks
    /// are a small part of that.
    fn find_close(&mut self, seeds: &[DVec3], table: &NeighbourTable) {
        self.close.clear();
        for (i, &p) in seeds.iter().enumerate() {
            let most = 2.0 * self.share * self.width[i] / (1.0 - self.share);
            for &j in table.row(i as u32).0.iter().take(NEIGHBOUR - 1) {
                let distance = p.distance(seeds[j as usize]);
                if distance > most {
                    break;
                }
                if (i as u32) < j && distance <= self.share * (self.width[i] + self.width[j as usize]) {
                    self.close.push([i as u32, j]);
                }
            }
        }
    }
}
