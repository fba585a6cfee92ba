//! Local improvement of a result.
//!
//! Purpose: one set of operators ([`LocalMesh`](super::manifold::local_mesh::LocalMesh)), one search for a better place of a
//! vertex ([`relocation`]) and one objective ([`objective`]) for all of it. [`shapes`] improves the worst triangles of the whole
//! result, where distances need not be measured; [`curves`] keeps edges near their curves; [`places`] improves what is left,
//! in a queue: irregular vertices, and places far from the input. Each of these is a [`patch`] on which several
//! ways are tried ([`trial`]), in turn with the [`editor`].
//! Invariant: a manifold stays one, no facet turns over, edges of curves stay. The same bits whatever the number of threads.
//! Must not know: seeds, diagrams, files.

mod context;
pub(super) mod curves;
pub(super) mod editor;
mod objective;
mod patch;
pub(super) mod places;
mod queue;
mod relocation;
pub(super) mod shapes;
mod trial;
