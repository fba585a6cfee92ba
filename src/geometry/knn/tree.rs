//! A kd-tree over seeds.
//!
//! Purpose: rows and nearest seeds where a grid of equal cells does not suit, by the crate kiddo, in three dimensions or six.
//! Invariant: seeds that lie on earlier ones are in no answer. Must not know: grids.

use std::collections::HashMap;
use std::num::NonZero;

use kiddo::{ImmutableKdTree, SquaredEuclidean};

use super::{NeighbourRow, Threads};

/// A search among points with coordinates `C`.
pub trait SearchTree<C>: Send + Sync {
    /// Over the seeds that lie on no earlier one; `seed` says where each of `count` is.
    fn new(count: u32, seed: impl Fn(u32) -> C, earlier: &HashMap<u32, u32>, threads: Threads) -> Self;

    /// A nearest seed.
    fn nearest(&self, p: &C) -> u32;

    /// The row of seed `i`, which lies at `p` and on no earlier seed.
    fn row(&self, i: u32, p: &C, k: usize, out: &mut NeighbourRow);
}

/// A kd-tree in `K` dimensions.
pub struct Tree<const K: usize> {
    tree: Option<ImmutableKdTree<f64, K>>,
    /// Seed of each tree item; `None` if they are equal.
    item_seed: Option<Vec<u32>>,
}

/// Below this many seeds one thread builds the tree sooner than several do.
const PARALLEL_BUILD: usize = 8192;

impl<const K: usize> SearchTree<[f64; K]> for Tree<K> {
    fn new(count: u32, seed: impl Fn(u32) -> [f64; K], earlier: &HashMap<u32, u32>, threads: Threads) -> Self {
        let kept = || (0..count).filter(|i| !earlier.contains_key(i)).collect::<Vec<_>>();
        let item_seed = (!earlier.is_empty()).then(kept);
        let points: Vec<[f64; K]> = match &item_seed {
            Some(kept) => kept.iter().map(|&i| seed(i)).collect(),
            None => (0..count).map(seed).collect(),
        };
        let builder = ImmutableKdTree::<f64, K>::builder();
        // An immutable tree is refused only for more items than u32 can number, which the
        // sessions above do not let through; without a tree every answer is "no neighbour".
        let tree = match threads {
            Threads::One => builder.with_serial_construction().build_from_slice(&points).ok(),
            Threads::Pool => {
                builder.with_parallel_construction_threshold(PARALLEL_BUILD).build_from_slice(&points).ok()
            }
        };
        Self { tree, item_seed }
    }

    fn nearest(&self, p: &[f64; K]) -> u32 {
        let Some(tree) = &self.tree else { return 0 };
        let found = tree.query(p).nearest_one::<SquaredEuclidean<f64>>().execute();
        self.seed_of(found.item)
    }

    fn row(&self, i: u32, p: &[f64; K], k: usize, out: &mut NeighbourRow) {
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
}

impl<const K: usize> Tree<K> {
    fn seed_of(&self, item: u32) -> u32 {
        self.item_seed.as_ref().map_or(item, |seeds| seeds[item as usize])
    }
}
