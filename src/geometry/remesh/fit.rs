//! Fit of the result to the input.
//!
//! Purpose: a triangulation whose vertices lie on a curved surface lies on one side of it, off by a share of κh² everywhere.
//! [`fit`] moves the vertices so that the mean square distance from the input to the facets is least, tangent plane by
//! tangent plane ([`normal_equations`]): along the normals where the surface is smooth, and towards a ridge where samples of
//! its two sides ask for it. Where facets may be slender, edges are flipped between such moves ([`flips`]), and largest distances
//! are balanced ([`balance`]). Where vertices are to stay on the surface, they slide along it instead ([`slide`]). [`backtrack`] shortens
//! moves until no facet turns over or becomes a sliver beside what it was.
//! Invariant: fixed vertices stay. The answer of the backtracking is that of checking all facets each time, though a facet is
//! checked again only if a corner's move was shortened. The same bits whatever the number of threads.
//! Must not know: seeds, diagrams, files.

mod balance;
mod flips;
mod normal_equations;
mod slide;

use glam::DVec3;

use super::constants::*;
use super::distance::{InputSamples, Reference, SurfaceSample};
use super::features::envelope::CurveSample;
use super::manifold::LocalMesh;
use super::triangle::{Norm, Shapes, Wanted, unit_normal};
use crate::mesh::TriMesh;
use crate::mesh::crossings::crossing_facets;
use crate::mesh::csr::ascending;
use crate::mesh::measure::facet_quality;
use crate::tasks;
use crate::token::{Stopped, Token};
use normal_equations::NormalEquations;

#[derive(Debug)]
pub(super) struct Target {
    /// By result vertex: the nearest facet is in its one-ring.
    pub(super) input: InputSamples,
    pub(super) curves: Vec<CurveSample>,
    /// Vertices that stay.
    pub(super) fixed: Vec<bool>,
}

impl Target {
    /// The sample of a vertex's own cell that is nearest to a place.
    fn own_sample(&self, v: u32, p: DVec3) -> Option<&SurfaceSample> {
        let to = |s: &SurfaceSample| s.position.distance_squared(p);
        self.input.samples.of(v).iter().min_by(|a, b| to(a).total_cmp(&to(b)))
    }
}

/// Moves the vertices; flips edges where facets are to be nearest. Ends early where `token` is stopped.
pub(super) fn fit(mesh: &mut LocalMesh, target: &mut Target, shapes: Shapes, token: &Token) {
    let wanted = shapes.wanted();
    let start = mesh.positions.clone();
    if shapes != Shapes::Round {
        flips::unfold(mesh, target, token);
    }
    let Shapes::Nearest(norm) = shapes else {
        return move_vertices(mesh, target, (&start, 1.0), (wanted, Norm::MeanSquare), token);
    };
    move_vertices(mesh, target, (&start, SLENDER_DAMPING), (wanted, norm), token);
    for _ in 0..SLENDER_ROUNDS {
        flips::flip(mesh, target, (wanted, norm), token);
        move_vertices(mesh, target, (&start, SLENDER_DAMPING), (wanted, norm), token);
    }
    if norm == Norm::Largest {
        balance::balance(mesh, target, wanted, token);
    }
}

/// Flips edges. Where the largest distances count, vertices that are not fixed slide along the surface.
pub(super) fn flip(
    mesh: &mut LocalMesh,
    target: &mut Target,
    reference: &Reference<'_>,
    shapes: Shapes,
    token: &Token,
) {
    flips::unfold(mesh, target, token);
    let Shapes::Nearest(norm) = shapes else { return };
    flips::flip(mesh, target, (shapes.wanted(), norm), token);
    if norm == Norm::Largest {
        slide::slide(mesh, target, reference, shapes.wanted(), token);
    }
}

fn move_vertices(
    mesh: &mut LocalMesh,
    target: &Target,
    (start, damping): (&[DVec3], f64),
    (wanted, norm): (Wanted, Norm),
    token: &Token,
) {
    let shapes = FacetShape::all(mesh, wanted);
    // Of reweighted least squares, a whole step goes too far.
    let (rounds, share) = match norm {
        Norm::MeanSquare => (FIT_ROUNDS, 1.0),
        Norm::Largest => (LARGEST_ROUNDS, 1.0 / (1.0 + 2.0 * f64::from(LARGEST_POWER))),
    };
    for _ in 0..rounds {
        let equations = NormalEquations::new(mesh, target, (start, damping), norm, token);
        let mut moves = equations.solve(token);
        moves.iter_mut().for_each(|by| *by *= share);
        if token.is_stopped() {
            return;
        }
        backtrack(mesh, &shapes, wanted, &mut moves);
        mesh.positions.iter_mut().zip(moves).for_each(|(p, by)| *p += by);
    }
}

/// Takes vertices at and around facets that cross others back to where they were, half of the way a round.
pub(super) fn uncross(mesh: &mut LocalMesh, start: &[DVec3], fixed: &[bool], token: &Token) -> Result<(), Stopped> {
    for round in 1..=UNCROSSING_ROUNDS {
        let Ok(now) = TriMesh::new(mesh.positions.clone(), mesh.facets().to_vec()) else { break };
        let crossing = crossing_facets(&now, token)?;
        if crossing.is_empty() {
            break;
        }
        let share = if round < UNCROSSING_ROUNDS { 0.5 } else { 1.0 };
        let corners = ascending(crossing.iter().flat_map(|&f| mesh.facets()[f as usize]));
        for v in mesh.corners_around(&corners).into_iter().map(|v| v as usize).filter(|&v| !fixed[v]) {
            mesh.positions[v] = mesh.positions[v].lerp(start[v], share);
        }
    }
    Ok(())
}

/// The shape of a facet: its normal, and what it lacks of not being poor.
#[derive(Default)]
struct FacetShape {
    normal: DVec3,
    lack: f64,
}

impl FacetShape {
    fn of(corners: [DVec3; 3], wanted: Wanted) -> Self {
        Self { normal: unit_normal(corners), lack: wanted.lack(corners, facet_quality(corners)) }
    }

    fn all(mesh: &LocalMesh, wanted: Wanted) -> Vec<Self> {
        tasks::map(mesh.facets().len(), |f| Self::of(mesh.corners(f as u32), wanted))
    }
}

/// Shortens `moves`, one a vertex. `first` are the shapes before the fit.
fn backtrack(mesh: &LocalMesh, first: &[FacetShape], wanted: Wanted, moves: &mut [DVec3]) {
    let mut checked: Vec<u32> = (0..mesh.facets().len() as u32).collect();
    for round in 0..BACKTRACKING_HALVINGS + BACKTRACKING_DROPS {
        let is_bad = |f: &u32| {
            let before = &first[*f as usize];
            let corners = mesh.facets()[*f as usize].map(|v| mesh.positions[v as usize] + moves[v as usize]);
            let after = FacetShape::of(corners, wanted);
            after.normal.dot(before.normal) < MEASURED_COSINE || after.lack > before.lack
        };
        let bad: Vec<u32> = tasks::flat_map(checked.len(), |k| Some(checked[k]).filter(is_bad));
        if bad.is_empty() {
            return;
        }
        let factor = if round < BACKTRACKING_HALVINGS { 0.5 } else { 0.0 };
        let shortened = ascending(bad.iter().flat_map(|&f| mesh.facets()[f as usize]));
        shortened.iter().for_each(|&v| moves[v as usize] *= factor);
        checked = mesh.facets_around(&shortened);
    }
}
