//! Local improvement of a result.
//!
//! Purpose: three ways to a better result. [`queue`] improves places in the order of their distance from the input; [`valence`]
//! recovers edges of curves, and valences; [`angles`] improves the worst triangles. The first two change one local mesh
//! (`patch`) at a time, with its flips (`operators`) and relocations (`relocation`, `objective`), in turn with the
//! [`editor`]. [`flips`] flips edges of the whole result.
//! Invariant: a manifold stays one, no facet turns over, edges of curves stay. The same bits whatever the number of threads.
//! Must not know: seeds, diagrams, files.

pub(super) mod angles;
mod context;
pub(super) mod editor;
pub(super) mod flips;
mod objective;
mod operators;
mod patch;
pub(super) mod queue;
mod relocation;
pub(super) mod valence;
