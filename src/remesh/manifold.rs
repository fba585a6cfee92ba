//! The combinatorics of a triangulation.
//!
//! Purpose: [`repair`] makes an oriented 2-manifold of the dual's triangles, [`boundary_ears`] restores edges of
//! boundaries, [`one_rings`] keeps the facets around each vertex up to date while facets change.
//! Invariant: what was a manifold stays one. Must not know: seeds, diagrams, distances.

pub(super) mod boundary_ears;
pub(super) mod one_rings;
pub(super) mod repair;
