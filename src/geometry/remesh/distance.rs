//! Distances between the input and the result.
//!
//! Purpose: [`reference`](mod@reference) holds the input by result vertex, so that a distance needs no search over the whole
//! surface. [`nearest`] finds the closest point in a one-ring, [`hausdorff`] estimates the distance both ways.
//! Invariant: the same bits whatever the number of threads. Must not know: how the result is changed.

pub(super) mod hausdorff;
pub(super) mod nearest;
pub(super) mod reference;
