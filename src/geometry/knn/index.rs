//! The searchable seeds: a grid where it proves an answer, a kd-tree where it does not.
//!
//! Purpose: rows and nearest seeds, each by the faster of the two ways. The kd-tree of the crate kiddo is for seed sets and places
//! that a grid of equal cells does not suit.
//! Invariant: the promise of [`super`]; neither which way answered nor the thread that built the tree shows in an answer.
//! Must not know: how many rows a table wants.

use std::collections::HashMap;
use std::sync::OnceLock;

use glam::DVec3;

use super::grid::{Grid, Scratch};
use super::tree::SearchTree;
use super::{NeighbourRow, Point, Threads};

/// One set of seeds, ready to be searched.
pub struct SeedIndex<P: Point = DVec3> {
    seeds: Vec<P>,
    /// Later duplicate -> earliest.
    earlier: HashMap<u32, u32>,
    grid: Option<Grid>,
    /// Built at once without a grid, otherwise when the grid first fails to prove an answer.
    tree: OnceLock<P::Tree>,
}

impl<P: Point> SeedIndex<P> {
    /// Builds the index of finite `seeds`, on all threads of the present rayon pool.
    pub fn new(seeds: &[P]) -> Self {
        Self::with_threads(seeds, Threads::Pool)
    }

    /// Builds the index of finite `seeds`. The answers do not depend on `threads`.
    pub fn with_threads(seeds: &[P], threads: Threads) -> Self {
        let places: Vec<[f64; 3]> = seeds.iter().map(|p| p.place().to_array()).collect();
        let mut grid = Grid::new(&places, threads);
        let pairs = match &grid {
            Some(grid) if P::IS_PLACE => grid.duplicates(),
            _ => P::coincident(seeds),
        };
        if let Some(grid) = grid.as_mut().filter(|_| !pairs.is_empty()) {
            grid.hide(&pairs);
        }
        let index = Self { seeds: seeds.to_vec(), earlier: pairs.into_iter().collect(), grid, tree: OnceLock::new() };
        if index.grid.is_none() {
            index.tree.get_or_init(|| index.new_tree(threads));
        }
        index
    }

    /// Number of seeds.
    pub fn len(&self) -> usize {
        self.seeds.len()
    }

    /// Whether the index has no seeds.
    pub fn is_empty(&self) -> bool {
        self.seeds.is_empty()
    }

    /// How many seeds lie exactly on an earlier one.
    pub fn duplicates(&self) -> usize {
        self.earlier.len()
    }

    /// Whether seed `i` lies exactly on an earlier one.
    pub fn is_duplicate(&self, i: u32) -> bool {
        self.earlier.contains_key(&i)
    }

    /// Whether the seeds are spread so evenly that [`Self::in_box`] finds few that are not in the box.
    pub fn is_even(&self) -> bool {
        self.grid.as_ref().is_some_and(Grid::is_even)
    }

    /// A nearest seed of a point, never a later duplicate. Of several at the same distance it is a fixed but unspecified one.
    pub fn nearest(&self, p: P) -> u32 {
        // The tree decides between several seeds at one distance.
        let found = self.of_places().and_then(|grid| grid.nearest(&p.place().to_array()));
        found.unwrap_or_else(|| self.tree().nearest(&p.coordinates()))
    }

    /// A seed that is not far from a point, found sooner than the nearest one.
    pub fn near(&self, p: P) -> u32 {
        let near = self.of_places().and_then(|grid| grid.near(&p.place().to_array()));
        near.unwrap_or_else(|| self.nearest(p))
    }

    /// The grid, if distances are those of places.
    fn of_places(&self) -> Option<&Grid> {
        self.grid.as_ref().filter(|_| P::IS_PLACE)
    }

    /// Appends all seeds whose places are in a closed box, and some around it; no later duplicate. `false` if over `most` or if
    /// it were slow.
    pub fn in_box(&self, low: DVec3, high: DVec3, most: usize, out: &mut Vec<u32>) -> bool {
        self.each_in_box(low, high, most, |seed, _| out.push(seed))
    }

    /// Calls `found` for each seed of [`Self::in_box`]; also for some seeds before it returns `false`.
    #[inline(always)]
    pub fn each_in_box(&self, low: DVec3, high: DVec3, most: usize, mut found: impl FnMut(u32, P)) -> bool {
        let (low, high) = (low.to_array(), high.to_array());
        // A place alone is at hand there.
        let found =
            |seed: u32, p: &[f64; 3]| found(seed, P::found_at(DVec3::from_array(*p), || self.seeds[seed as usize]));
        self.grid.as_ref().is_some_and(|grid| grid.in_box(&low, &high, most, found))
    }

    /// The nearest neighbours of seed `i`, about `k` of them. The last ones are omitted if more seeds may lie at the same
    /// distance, so that every row is a prefix of the longer ones.
    pub fn row(&self, i: u32, k: usize, out: &mut NeighbourRow) {
        self.row_with(i, (k, k), &mut Scratch::default(), out);
    }

    /// [`Self::row`] without an allocation of its own, and shorter where that saves work, but about `least` long at least.
    pub(super) fn row_with(&self, i: u32, (least, k): (usize, usize), scratch: &mut Scratch, out: &mut NeighbourRow) {
        if let Some(&first) = self.earlier.get(&i) {
            out.seeds.clear();
            out.seeds.push(first);
            out.complete = true;
        } else if !self.of_places().is_some_and(|grid| grid.row(i, (least, k), scratch, out)) {
            self.tree().row(i, &self.seeds[i as usize].coordinates(), k, out);
        }
    }

    /// All seeds, with neighbours close to one another; `None` for their own order.
    pub(super) fn order(&self) -> Option<&[u32]> {
        self.grid.as_ref().map(Grid::order)
    }

    /// The first caller builds it alone: a thread that waits for helpers may take up another search, which would wait for it.
    fn tree(&self) -> &P::Tree {
        self.tree.get_or_init(|| self.new_tree(Threads::One))
    }

    fn new_tree(&self, threads: Threads) -> P::Tree {
        let seed = |i: u32| self.seeds[i as usize].coordinates();
        P::Tree::new(self.seeds.len() as u32, seed, &self.earlier, threads)
    }
}
