//! kiddo's kd-tree behind the promise of [`super`].

use glam::DVec3;

/// One seed's neighbours.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NeighbourRow {
    /// Other seeds, nearest first.
    pub seeds: Vec<u32>,
    /// Whether these are all other seeds, so that the row cannot be exhausted.
    pub complete: bool,
}

/// A kd-tree over one set of seeds.
pub struct SeedIndex {}

impl SeedIndex {
    /// Builds the tree on all cores of the present rayon pool.
    pub fn new(_seeds: &[DVec3]) -> Self {
        todo!()
    }

    /// How many seeds there are.
    pub fn len(&self) -> usize {
        todo!()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The nearest seed of a point; the lowest index among equals.
    pub fn nearest(&self, _p: DVec3) -> u32 {
        todo!()
    }

    /// The nearest neighbours of seed `i`, about `k` of them: fewer where the last would be one
    /// of several at the same distance, so that every row is a prefix of the longer ones.
    pub fn row(&self, _i: u32, _k: usize, _out: &mut NeighbourRow) {
        todo!()
    }
}
