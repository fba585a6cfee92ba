//! A row of neighbours, and the builders of rows.
//!
//! Purpose: the answer of the grid and the tree, which the index passes on.
//! Invariant: none of its own.
//! Must not know: the search.

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
