//! The kd-tree of the crate kiddo, for seed sets and places that a grid of equal cells does not suit.
//!
//! Purpose: rows and nearest seeds at any spacing.
//! Invariant: the promise of [`super`]; the answers do not depend on the thread that built the tree.
//! Must not know: the grid.

use std::collections::HashMap;
use std::num::NonZero;

use kiddo::{ImmutableKdTree, SquaredEuclidean};

use super::{NeighbourRow, Threads};

/// A kd-tree over the seeds that lie on no earlier one.
pub(super) struct Tree {
    tree: Option<ImmutableKdTree<f64, 3>>,
    /// Seed of each tree item; `None` if they are equal.
    item_seed: Option<Vec<u32>>,
}

/// Below this many seeds one thread builds the tree sooner than several do.
const PARALLEL_BUILD: usize = 8192;

impl Tree {
    /// Builds the tree; `earlier` holds the seeds to leave out.
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

    /// A nearest seed of a point.
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
