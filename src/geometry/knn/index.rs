//! The searchable seeds: a grid where it proves an answer, a kd-tree where it does not.
//!
//! Purpose: rows and nearest seeds, each by the faster of the two ways. The kd-tree of the crate kiddo is for seed sets and places
//! that a grid of equal cells does not suit.
//! Invariant: the promise of [`super`]; neither which way answered nor the thread that built the tree shows in an answer.
//! Must not know: how many rows a table wants.

use std::collections::HashMap;
use std::num::NonZero;
use std::sync::OnceLock;

use glam::DVec3;
use kiddo::{ImmutableKdTree, SquaredEuclidean};

use super::grid::{Grid, Scratch};
use super::{NeighbourRow, Threads};
use crate::mesh::coincident;

/// One set of seeds, ready to be searched.
pub struct SeedIndex {
    seeds: Vec<[f64; 3]>,
    /// Later duplicate -> earliest.
    earlier: HashMap<u32, u32>,
    grid: Option<Grid>,
    /// Built at once without a grid, otherwise when the grid first fails to prove an answer.
    tree: OnceLock<Tree>,
}

impl SeedIndex {
    /// Builds the index of finite `seeds`, on all threads of the present rayon pool.
    pub fn new(seeds: &[DVec3]) -> Self {
        Self::with_threads(seeds, Threads::Pool)
    }

    /// Builds the index of finite `seeds`. The answers do not depend on `threads`.
    pub fn with_threads(seeds: &[DVec3], threads: Threads) -> Self {
        let points: Vec<[f64; 3]> = seeds.iter().map(|p| p.to_array()).collect();
        let mut grid = Grid::new(&points, threads);
        let pairs = match &grid {
            Some(grid) => grid.duplicates(),
            None => coincident::find(seeds),
        };
        if let Some(grid) = grid.as_mut().filter(|_| !pairs.is_empty()) {
            grid.hide(&pairs);
        }
        let index = Self { seeds: points, earlier: pairs.into_iter().collect(), grid, tree: OnceLock::new() };
        if index.grid.is_none() {
            index.tree.get_or_init(|| Tree::new(&index.seeds, &index.earlier, threads));
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
    pub fn nearest(&self, p: DVec3) -> u32 {
        let p = p.to_array();
        // The tree decides between several seeds at one distance.
        self.grid.as_ref().and_then(|g| g.nearest(&p)).unwrap_or_else(|| self.tree().nearest(&p))
    }

    /// A seed that is not far from a point, found sooner than the nearest one.
    pub fn near(&self, p: DVec3) -> u32 {
        let near = self.grid.as_ref().and_then(|g| g.near(&p.to_array()));
        near.unwrap_or_else(|| self.nearest(p))
    }

    /// Appends all seeds in a closed box, and some around it; no later duplicate. `false` if over `most` or if it were slow.
    pub fn in_box(&self, low: DVec3, high: DVec3, most: usize, out: &mut Vec<u32>) -> bool {
        self.each_in_box(low, high, most, |seed, _| out.push(seed))
    }

    /// Calls `found` for each seed of [`Self::in_box`], with its place; also for some seeds before it returns `false`.
    #[inline(always)]
    pub fn each_in_box(&self, low: DVec3, high: DVec3, most: usize, mut found: impl FnMut(u32, DVec3)) -> bool {
        let (low, high) = (low.to_array(), high.to_array());
        let found = |seed: u32, p: &[f64; 3]| found(seed, DVec3::from_array(*p));
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
        } else if !self.grid.as_ref().is_some_and(|g| g.row(i, (least, k), scratch, out)) {
            self.tree().row(i, &self.seeds[i as usize], k, out);
        }
    }

    /// All seeds, with neighbours close to one another; `None` for their own order.
    pub(super) fn order(&self) -> Option<&[u32]> {
        self.grid.as_ref().map(Grid::order)
    }

    /// The first caller builds it alone: a thread that waits for helpers may take up another search, which would wait for it.
    fn tree(&self) -> &Tree {
        self.tree.get_or_init(|| Tree::new(&self.seeds, &self.earlier, Threads::One))
    }
}

/// A kd-tree over the seeds that lie on no earlier one.
pub(super) struct Tree {
    tree: Option<ImmutableKdTree<f64, 3>>,
    /// Seed of each tree item; `None` if they are equal.
    item_seed: Option<Vec<u32>>,
}

/// Below this many seeds one thread builds the tree sooner than several do.
const PARALLEL_BUILD: usize = 8192;

impl Tree {
    pub(super) fn new(seeds: &[[f64; 3]], earlier: &HashMap<u32, u32>, threads: Threads) -> Self {
        let kept = || (0..seeds.len() as u32).filter(|i| !earlier.contains_key(i)).collect::<Vec<_>>();
        let item_seed = (!earlier.is_empty()).then(kept);
        let unique = item_seed.as_ref().map(|kept| kept.iter().map(|&i| seeds[i as usize]).collect::<Vec<_>>());
        let slice = unique.as_deref().unwrap_or(seeds);
        let builder = ImmutableKdTree::<f64, 3>::builder();
        // An immutable tree is refused only for more items than u32 can number, which the
        // sessions above do not let through; without a tree every answer is "no neighbour".
        let tree = match threads {
            Threads::One => builder.with_serial_construction().build_from_slice(slice).ok(),
            Threads::Pool => builder.with_parallel_construction_threshold(PARALLEL_BUILD).build_from_slice(slice).ok(),
        };
        Self { tree, item_seed }
    }

    pub(super) fn nearest(&self, p: &[f64; 3]) -> u32 {
        let Some(tree) = &self.tree else { return 0 };
        let found = tree.query(p).nearest_one::<SquaredEuclidean<f64>>().execute();
        self.seed_of(found.item)
    }

    /// The row of seed `i`, which lies at `p` and on no earlier seed.
    pub(super) fn row(&self, i: u32, p: &[f64; 3], k: usize, out: &mut NeighbourRow) {
        out.seeds.clear();
        out.complete = true;
        let Some(tree) = &self.tree else { return };
        let (items, wanted) = (tree.size(), k.saturating_add(1));
        let count = NonZero::new(wanted.min(items)).unwrap_or(NonZero::<usize>::MIN);
        let mut found = tree.query(p).nearest_n::<SquaredEuclidean<f64>>(count).execute();
        if wanted < items {
            out.complete = false;
            if let Some(last) = found.last().map(|n| n.distance) {
                found.retain(|n| n.distance < last);
            }
        }
        found.sort_by(|a, b| a.distance.total_cmp(&b.distance).then_with(|| a.item.cmp(&b.item)));
        out.seeds.extend(found.iter().map(|n| self.seed_of(n.item)).filter(|&j| j != i));
    }

    fn seed_of(&self, item: u32) -> u32 {
        self.item_seed.as_ref().map_or(item, |seeds| seeds[item as usize])
    }
}
