//! Fit of the result to the input.
//!
//! Purpose: a triangulation whose vertices lie on a curved surface lies on one side of it, off by a share of κh² everywhere.
//! [`fit`] moves the vertices so that the mean square distance from the input to the facets is least, tangent plane by
//! tangent plane ([`normal_equations`]): along the normals where the surface is smooth, and towards a ridge where samples of
//! its two sides ask for it. [`backtrack`] then shortens moves until no facet turns over or becomes a sliver beside what it was.
//! Invariant: fixed vertices stay. The answer of the backtracking is that of checking all facets each time, though a facet is
//! checked again only if a corner's move was shortened. The same bits whatever the number of threads.
//! Must not know: seeds, diagrams, files.

mod normal_equations;

use glam::DVec3;
use rayon::prelude::*;

use super::constants::*;
use super::distance::InputSamples;
use super::features::envelope::CurveSample;
use super::manifold::LocalMesh;
use super::triangle::{Wanted, unit_normal};
use crate::mesh::csr::ascending;
use crate::mesh::measure::facet_quality;
use crate::token::Token;
use normal_equations::NormalEquations;

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

/// The shape of a facet: its normal, and what it lacks of not being poor.
pub(super) struct FacetShape {
    normal: DVec3,
    lack: f64,
}

impl FacetShape {
    fn of(corners: [DVec3; 3], wanted: Wanted) -> Self {
        Self { normal: unit_normal(corners), lack: wanted.lack(corners, facet_quality(corners)) }
    }

    pub(super) fn all(mesh: &LocalMesh) -> Vec<Self> {
        let wanted = Wanted::new(POOR_SCORE, POOR_ANGLE);
        (0..mesh.facets().len() as u32).into_par_iter().map(|f| Self::of(mesh.corners(f), wanted)).collect()
    }
}

/// Shortens `moves`, one a vertex. `first` are the shapes before the fit.
pub(super) fn backtrack(mesh: &LocalMesh, first: &[FacetShape], moves: &mut [DVec3]) {
    let wanted = Wanted::new(POOR_SCORE, POOR_ANGLE);
    let mut checked: Vec<u32> = (0..mesh.facets().len() as u32).collect();
    for round in 0..BACKTRACKING_HALVINGS + BACKTRACKING_DROPS {
        let is_bad = |f: &u32| {
            let before = &first[*f as usize];
            let corners = mesh.facets()[*f as usize].map(|v| mesh.positions[v as usize] + moves[v as usize]);
            let after = FacetShape::of(corners, wanted);
            after.normal.dot(before.normal) < MEASURED_COSINE || after.lack > before.lack
        };
        let bad: Vec<u32> = checked.par_iter().with_min_len(ITEMS_PER_TASK).copied().filter(is_bad).collect();
        if bad.is_empty() {
            return;
        }
        let factor = if round < BACKTRACKING_HALVINGS { 0.5 } else { 0.0 };
        let shortened = ascending(bad.iter().flat_map(|&f| mesh.facets()[f as usize]));
        shortened.iter().for_each(|&v| moves[v as usize] *= factor);
        checked = mesh.facets_around(&shortened);
    }
}
