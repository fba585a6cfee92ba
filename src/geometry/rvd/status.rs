//! How a (facet, cell) pair ended.
//!
//! Invariant: a pair is done, or has the reason why it is done again. Must not know: backends.

/// How a (facet, cell) pair ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u32)]
pub enum PairStatus {
    /// Clipped to the end: the security radius closed, or every other seed was tried.
    Done = 0,
    /// The neighbour table ended before the security radius closed.
    NeighboursExhausted = 1,
    /// The polygon needed more vertices than there were slots.
    PolygonOverflow = 2,
    /// The facet meets more cells than there were slots.
    CellsOverflow = 3,
    /// A coordinate left the range of the arithmetic in use.
    NonFinite = 4,
}
