//! Neighbour tables of the seeds.
//!
//! Purpose: for every seed its nearest other seeds in order, and the nearest seed of a point.
//! Invariant: a row of k neighbours is a prefix of every longer row of the same seed, so that a
//! longer table never changes what a shorter one decided. Order: squared distance, then index.
//! Must not know: facets, polygons.

mod kdtree;

pub use kdtree::{NeighbourRow, SeedIndex};
