//! kiddo's kd-tree behind the promise of [`super`].

use std::collections::HashMap;
use std::num::NonZero;

use glam::DVec3;
use kiddo::{ImmutableKdTree, SquaredEuclidean};

use crate::mesh::coincident;

/// One seed's neighbours.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NeighbourRow {
    /// Other seeds, nearest first.
    pub seeds: Vec<u32>,
    /// Whether no other seed can matter, so that the row cannot be exhausted.
    pub complete: bool,
}

/// Who builds a tree or a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Threads {
    /// The calling thread alone.
    One,
    /// All threads of the present rayon pool.
    Pool,
}

/// A kd-tree over one set of seeds.
pub struct SeedIndex {
    seeds: Vec<[f64; 3]>,
    tree: Option<ImmutableKdTree<f64, 3>>,
    /// Seed of each tree item; `None` where they are the same.
    item_seed: Option<Vec<u32>>,
    /// Later twin -> earliest twin.
    twin: HashMap<u32, u32>,
}

/// Below this many seeds one thread builds the tree sooner than several do.
const PARALLEL_BUILD: usize = 8192;

impl SeedIndex {
    /// Builds the tree over finite `seeds`, on all threads of the present rayon pool.
    pub fn new(seeds: &[DVec3]) -> Self {
        Self::with_threads(seeds, Threads::Pool)
    }

    /// Builds the tree over finite `seeds`. The answers do not depend on `threads`.
    pub fn with_threads(seeds: &[DVec3], threads: Threads) -> Self {
        let twin: HashMap<u32, u32> = coincident::find(seeds).into_iter().collect();
        let points: Vec<[f64; 3]> = seeds.iter().map(|p| p.to_array()).collect();
        let (unique, item_seed) = if twin.is_empty() {
            (None, None)
        } else {
            let kept: Vec<u32> = (0..points.len() as u32).filter(|i| !twin.contains_key(i)).collect();
            (Some(kept.iter().map(|&i| points[i as usize]).collect::<Vec<_>>()), Some(kept))
        };
        let slice = unique.as_deref().unwrap_or(&points);
        let builder = ImmutableKdTree::<f64, 3>::builder();
        // An immutable tree is refused only for more items than u32 can number, which the
        // sessions above do not let through; without a tree every answer is "no neighbour".
        let tree = match threads {
            Threads::One => builder.with_serial_construction().build_from_slice(slice).ok(),
            Threads::Pool => builder.with_parallel_construction_threshold(PARALLEL_BUILD).build_from_slice(slice).ok(),
        };
        Self { seeds: points, tree, item_seed, twin }
    }

    /// How many seeds there are.
    pub fn len(&self) -> usize {
        self.seeds.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.seeds.is_empty()
    }

    /// How many seeds lie exactly on an earlier one.
    pub fn duplicates(&self) -> usize {
        self.twin.len()
    }

    /// Whether seed `i` lies exactly on an earlier one.
    pub fn is_twin(&self, i: u32) -> bool {
        self.twin.contains_key(&i)
    }

    /// A nearest seed of a point, never a later twin. Among seeds at exactly the same distance
    /// it is any one of them, always the same one.
    pub fn nearest(&self, p: DVec3) -> u32 {
        let Some(tree) = &self.tree else { return 0 };
        let found = tree.query(&p.to_array()).nearest_one::<SquaredEuclidean<f64>>().execute();
        self.seed_of(found.item)
    }

    /// The nearest neighbours of seed `i`, about `k` of them: the last ones are left out where
    /// more seeds may lie at the same distance, so that every row is a prefix of the longer ones.
    pub fn row(&self, i: u32, k: usize, out: &mut NeighbourRow) {
        out.seeds.clear();
        out.complete = true;
        if let Some(&first) = self.twin.get(&i) {
            out.seeds.push(first);
            return;
        }
        let Some(tree) = &self.tree else { return };
        let (items, wanted) = (tree.size(), k.saturating_add(1));
        let count = NonZero::new(wanted.min(items)).unwrap_or(NonZero::<usize>::MIN);
        let mut found = tree.query(&self.seeds[i as usize]).nearest_n::<SquaredEuclidean<f64>>(count).execute();
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
        match &self.item_seed {
            Some(map) => map[item as usize],
            None => item,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    fn random(n: usize) -> Vec<DVec3> {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(n as u64);
        (0..n).map(|_| DVec3::new(rng.random(), rng.random(), rng.random())).collect()
    }

    fn brute(seeds: &[DVec3], i: usize) -> Vec<u32> {
        let mut all: Vec<(f64, u32)> = (0..seeds.len())
            .filter(|&j| j != i)
            .map(|j| {
                let d = seeds[j] - seeds[i];
                (d.x * d.x + d.y * d.y + d.z * d.z, j as u32)
            })
            .collect();
        all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        all.into_iter().map(|x| x.1).collect()
    }

    #[test]
    fn rows_are_prefixes_of_the_whole_order() {
        let lattice: Vec<DVec3> =
            (0..512).map(|i| DVec3::new((i % 8) as f64, (i / 8 % 8) as f64, (i / 64) as f64)).collect();
        for seeds in [random(500), lattice] {
            let index = SeedIndex::new(&seeds);
            let mut row = NeighbourRow::default();
            for i in (0..seeds.len()).step_by(7) {
                let all = brute(&seeds, i);
                for k in [1, 4, 5, 20, 100, 10_000] {
                    index.row(i as u32, k, &mut row);
                    assert!(row.seeds.len() <= k);
                    assert_eq!(row.seeds[..], all[..row.seeds.len()], "seed {i}, k {k}");
                    assert_eq!(row.complete, row.seeds.len() == all.len());
                }
            }
        }
    }

    #[test]
    fn twins_are_hidden_and_own_a_row_of_one() {
        let mut seeds = random(100);
        for i in 50..100 {
            seeds[i] = seeds[i % 10];
        }
        let index = SeedIndex::new(&seeds);
        assert_eq!(index.duplicates(), 50);
        let mut row = NeighbourRow::default();
        index.row(57, 20, &mut row);
        assert_eq!((row.seeds.as_slice(), row.complete), (&[7][..], true));
        index.row(7, 1000, &mut row);
        assert_eq!((row.seeds.len(), row.complete), (49, true));
        assert!(row.seeds.iter().all(|&j| j < 50));
        assert_eq!(index.nearest(seeds[99]), 9);
    }

    #[test]
    fn one_and_many_identical_seeds() {
        let one = SeedIndex::new(&[DVec3::ONE]);
        let mut row = NeighbourRow::default();
        one.row(0, 20, &mut row);
        assert!(row.seeds.is_empty() && row.complete);
        let same = SeedIndex::new(&vec![DVec3::ONE; 100_000]);
        same.row(0, 20, &mut row);
        assert!(row.seeds.is_empty() && row.complete);
    }

    #[test]
    fn threads_do_not_change_the_rows() {
        let seeds = random(20_000);
        let (a, b) = (SeedIndex::with_threads(&seeds, Threads::One), SeedIndex::new(&seeds));
        let (mut x, mut y) = (NeighbourRow::default(), NeighbourRow::default());
        for i in (0..seeds.len() as u32).step_by(97) {
            a.row(i, 24, &mut x);
            b.row(i, 24, &mut y);
            assert_eq!(x, y);
        }
    }
}
