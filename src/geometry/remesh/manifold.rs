//! The combinatorics of a triangulation.
//!
//! Purpose: [`repair`] makes an oriented 2-manifold of the dual's triangles, [`boundary_ears`] restores edges of
//! boundaries. [`local_mesh`] is a triangulation under edits with its local operators.
//! Invariant: what was a manifold stays one. Must not know: seeds, diagrams, distances.

pub(super) mod boundary_ears;
pub(super) mod local_mesh;
pub(super) mod repair;
