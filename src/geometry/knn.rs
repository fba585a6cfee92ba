//! Neighbour tables of the seeds.
//!
//! Purpose: for every seed its nearest other seeds in order, and the nearest seed of a point.
//! Invariant: a row of k neighbours is a prefix of every longer row of the same seed, so that a longer table never changes
//! what a shorter one decided. Order: squared distance, then index. A seed exactly on an earlier one is no neighbour of any
//! seed; its own row is that earlier seed alone, which makes its cell empty. Must not know: facets, polygons.

mod grid;
mod index;
mod point;
#[cfg(test)]
mod tests;
mod tree;

use rayon::prelude::*;

use grid::Scratch;
pub use index::SeedIndex;
pub use point::{Lifted, Point};
pub use tree::SearchTree;

/// One seed's neighbours.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NeighbourRow {
    /// Other seeds, nearest first.
    pub seeds: Vec<u32>,
    /// Whether no other seed can matter, so that the row cannot be exhausted.
    pub complete: bool,
}

/// The threads that build an index or a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Threads {
    /// The calling thread alone.
    One,
    /// All threads of the present rayon pool.
    Pool,
}

/// The squared distance that orders all rows, with the same rounding in every search.
fn squared_distance(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    let [x, y, z] = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    x * x + y * y + z * z
}

/// Rows of about `k` neighbours for all seeds, in one array.
#[derive(Clone, Debug, Default)]
pub struct NeighbourTable {
    k: usize,
    /// Which row each seed has; empty where they are numbered alike.
    place: Vec<u32>,
    seeds: Vec<u32>,
    len: Vec<u32>,
    complete: Vec<bool>,
}

/// Seeds per task: enough to hide the cost of a task, few enough to share evenly.
const CHUNK: usize = 256;

/// Seeds, lengths and flags of a task.
type Part<'a> = (&'a mut [u32], (&'a mut [u32], &'a mut [bool]));

impl NeighbourTable {
    /// Fills the table with rows of at most `k` neighbours, most of at least two thirds of that, reusing its memory. Returns
    /// `false` soon after `stop` does; the table is then invalid.
    pub fn fill<P: Point>(
        &mut self,
        index: &SeedIndex<P>,
        k: usize,
        threads: Threads,
        stop: &(dyn Fn() -> bool + Sync),
    ) -> bool {
        let (n, k) = (index.len(), k.min(index.len()).max(1));
        // Shorter, rather than that the grid reads cells farther away for a few.
        let least = k - k / 3;
        self.k = k;
        self.seeds.resize(n * k, 0);
        self.len.resize(n, 0);
        self.complete.resize(n, false);
        // Rows of seeds close together are found, kept and read together.
        let order = index.order();
        self.place.clear();
        if let Some(order) = order {
            self.place.resize(n, 0);
            for (row, &seed) in order.iter().enumerate() {
                self.place[seed as usize] = row as u32;
            }
        }
        let fill = |(chunk, (seeds, (len, complete))): (usize, Part<'_>)| {
            let (mut row, mut scratch) = (NeighbourRow::default(), Scratch::default());
            for (s, (l, c)) in len.iter_mut().zip(complete).enumerate() {
                // A row may look at all seeds.
                if s.is_multiple_of(16) && stop() {
                    return;
                }
                let r = chunk * CHUNK + s;
                index.row_with(order.map_or(r as u32, |o| o[r]), (least, k), &mut scratch, &mut row);
                seeds[s * k..s * k + row.seeds.len()].copy_from_slice(&row.seeds);
                *l = row.seeds.len() as u32;
                *c = row.complete;
            }
        };
        let rows = self.len.chunks_mut(CHUNK).zip(self.complete.chunks_mut(CHUNK));
        let parts: Vec<_> = self.seeds.chunks_mut(CHUNK * k).zip(rows).enumerate().collect();
        match threads {
            Threads::One => parts.into_iter().for_each(fill),
            Threads::Pool => parts.into_par_iter().for_each(fill),
        }
        !stop()
    }

    /// Takes all rows away.
    pub fn clear(&mut self) {
        self.place.clear();
        self.seeds.clear();
        self.len.clear();
        self.complete.clear();
    }

    /// Whether it has no rows.
    pub fn is_empty(&self) -> bool {
        self.len.is_empty()
    }

    /// The row of seed `i`, and whether it is complete; empty for a table without rows.
    pub fn row(&self, i: u32) -> (&[u32], bool) {
        let i = self.place.get(i as usize).map_or(i, |&row| row) as usize;
        let Some(&len) = self.len.get(i) else { return (&[], false) };
        let start = i * self.k;
        (&self.seeds[start..start + len as usize], self.complete[i])
    }
}
