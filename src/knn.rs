//! Neighbour tables of the seeds.
//!
//! Purpose: for every seed its nearest other seeds in order, and the nearest seed of a point.
//! Invariant: a row of k neighbours is a prefix of every longer row of the same seed, so that a
//! longer table never changes what a shorter one decided. Order: squared distance, then index.
//! A seed that lies exactly on an earlier one is nobody's neighbour; its own row is that earlier
//! seed alone, which leaves it an empty cell.
//! Must not know: facets, polygons.

mod kdtree;
mod table;

pub use kdtree::{NeighbourRow, SeedIndex, Threads};
pub use table::NeighbourTable;
