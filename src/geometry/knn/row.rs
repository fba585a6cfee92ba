//! A row of neighbours, and who makes rows.
//!
//! Purpose: what the grid and the tree answer with, and the index passes on.
//! Invariant: none of its own. Must not know: how seeds are searched.

/// One seed's neighbours.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NeighbourRow {
    /// Other seeds, nearest first.
    pub seeds: Vec<u32>,
    /// Whether no other seed can matter, so that the row cannot be exhausted.
    pub complete: bool,
}

/// Who builds an index or a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Threads {
    /// The calling thread alone.
    One,
    /// All threads of the present rayon pool.
    Pool,
}
