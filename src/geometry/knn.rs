//! Neighbour tables of the seeds.
//!
//! Purpose: for every seed its nearest other seeds in order, and the nearest seed of a point.
//! Invariant: a row of k neighbours is a prefix of every longer row of the same seed, so that a longer table never changes
//! what a shorter one decided. Order: squared distance, then index. A seed exactly on an earlier one is no neighbour of any
//! seed; its own row is that earlier seed alone, which makes its cell empty.
//! Must not know: facets, polygons.

mod grid;
mod index;
mod kdtree;
mod table;
#[cfg(test)]
mod tests;

pub use index::SeedIndex;
pub use table::NeighbourTable;

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
pub fn squared_distance(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    let [x, y, z] = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    x * x + y * y + z * z
}
