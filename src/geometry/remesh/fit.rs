//! Fit of the result to the input.
//!
//! Purpose: a triangulation whose vertices lie on a curved surface lies on one side of it, off by a share of κh² everywhere.
//! [`fit`] moves the vertices so that the mean square distance from the input to the facets is least, tangent plane by
//! tangent plane ([`normal_equations`]): along the normals where the surface is smooth, and towards a ridge where samples of
//! its two sides ask for it.
//! Invariant: no facet turns over and none becomes a sliver ([`backtracking`]); fixed vertices stay. The same bits whatever the
//! number of threads.
//! Must not know: seeds, diagrams, files.

mod backtracking;
mod normal_equations;

use crate::remesh::constants::FIT_ROUNDS;
use crate::remesh::distance::reference::InputSamples;
use crate::remesh::features::envelope::CurveSample;
use crate::remesh::manifold::local_mesh::LocalMesh;
use crate::token::Token;
use backtracking::{FacetShape, backtrack};
use normal_equations::NormalEquations;

/// What there is to fit to.
#[derive(Debug)]
pub(super) struct Target {
    /// By result vertex: the nearest facet is in its one-ring.
    pub(super) input: InputSamples,
    pub(super) curves: Vec<CurveSample>,
    /// Vertices that stay.
    pub(super) fixed: Vec<bool>,
}

/// Moves the vertices. Ends early where `token` is stopped.
pub(super) fn fit(mesh: &mut LocalMesh, target: &Target, token: &Token) {
    let (start, shapes) = (mesh.positions.clone(), FacetShape::all(mesh));
    for _ in 0..FIT_ROUNDS {
        let mut moves = NormalEquations::new(mesh, target, &start, token).solve(token);
        if token.is_stopped() {
            return;
        }
        backtrack(mesh, &shapes, &mut moves);
        mesh.positions.iter_mut().zip(moves).for_each(|(p, by)| *p += by);
    }
}
