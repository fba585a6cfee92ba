//! Vertices that slide along the surface until the largest distance is small.
//!
//! Purpose: with its corners on a curved surface, a facet is off by half of its squared circumradius, measured by the second fundamental
//! form, and farthest near its circumcentre. [`slide`] draws each vertex to the farthest places of the facets around it, the farther ones
//! by a high power more: a step of descent for the norm of that power. Edges are flipped between such steps.
//! Invariant: of all states the one with the least largest distance remains, with its vertices on the input. Vertices that are fixed, of
//! curves or of boundaries stay. The same bits whatever the number of threads. Must not know: why a vertex is fixed.

use glam::DVec3;

use super::normal_equations::{NONE, NearestFacets};
use super::{FacetShape, Target, backtrack, flips};
use crate::mesh::closest_point::closest_on_facet;
use crate::mesh::csr::{Csr, ascending};
use crate::remesh::constants::*;
use crate::remesh::distance::Reference;
use crate::remesh::manifold::LocalMesh;
use crate::remesh::triangle::{Norm, Wanted};
use crate::tasks;
use crate::token::Token;

/// Slides the vertices of `mesh`, which lie on the input of `reference`, and flips edges. Ends early where `token` is stopped.
pub(super) fn slide(
    mesh: &mut LocalMesh,
    target: &mut Target,
    reference: &Reference<'_>,
    wanted: Wanted,
    token: &Token,
) {
    let vertices = 0..mesh.positions.len() as u32;
    let may_move = |v| !target.fixed[v as usize] && !mesh.is_on_boundary(v) && !mesh.is_on_curve(v);
    let may_move: Vec<bool> = tasks::map(vertices.len(), |v| may_move(v as u32));
    if !may_move.contains(&true) {
        return;
    }
    let mut shapes = FacetShape::all(mesh, wanted);
    let mut last = vec![DVec3::ZERO; mesh.positions.len()];
    let mut nearest = (f64::INFINITY, mesh.clone());
    for step in 0..=SLIDING_STEPS {
        if step > 0 && step.is_multiple_of(SLIDING_STEPS_PER_FLIP) {
            flips::flip(mesh, target, (wanted, Norm::Largest), token);
            shapes = FacetShape::all(mesh, wanted);
        }
        let pulls = Pulls::new(mesh, target, token);
        if token.is_stopped() {
            return;
        }
        if pulls.largest < nearest.0 {
            nearest = (pulls.largest, mesh.clone());
        }
        let by = |v: u32| {
            let here = mesh.positions[v as usize];
            let to = here + SLIDING_SHARE * pulls.of(mesh, v) + SLIDING_MOMENTUM * last[v as usize];
            match target.own_sample(v, to) {
                Some(own) if may_move[v as usize] => to - own.normal.dot(to - own.position) * own.normal - here,
                _ => DVec3::ZERO,
            }
        };
        let mut moves: Vec<DVec3> = tasks::map(vertices.len(), |v| by(v as u32));
        backtrack(mesh, &shapes, wanted, &mut moves);
        mesh.positions.iter_mut().zip(&moves).for_each(|(p, by)| *p += by);
        last = moves;
    }
    *mesh = nearest.1;
    let on_input =
        |v: u32| if may_move[v as usize] { on_input(mesh, reference, v) } else { mesh.positions[v as usize] };
    mesh.positions = tasks::map(vertices.len(), |v| on_input(v as u32));
}

/// What a facet draws its corners to: sums over its samples. But for the area they are weighted by a power of the distances.
#[derive(Clone, Copy, Default)]
struct Pull {
    area: f64,
    weight: f64,
    place: DVec3,
    /// How much of the distance depends on each corner.
    corners: [f64; 3],
}

struct Pulls {
    of_facet: Vec<Pull>,
    /// The largest squared distance.
    largest: f64,
}

impl Pulls {
    /// Gives samples to the corners of their nearest facets too, so that these are found as vertices move on.
    fn new(mesh: &LocalMesh, target: &mut Target, token: &Token) -> Self {
        let found = NearestFacets::new(mesh, target, token);
        let samples = target.input.samples.all();
        let squared = |k: usize| match found.facet[k] {
            NONE => 0.0,
            f => {
                let (corners, weights) = (mesh.corners(f), found.weights[k]);
                (0..3).map(|i| weights[i] * corners[i]).sum::<DVec3>().distance_squared(samples[k].position)
            }
        };
        let squared: Vec<f64> = tasks::map(samples.len(), squared);
        let largest = squared.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
        let mut of_facet = vec![Pull::default(); mesh.facets().len()];
        for (k, sample) in samples.iter().enumerate().filter(|(k, _)| found.facet[*k] != NONE) {
            let (weight, own) = (sample.area * (squared[k] / largest).powi(SLIDING_POWER), found.facet[k]);
            let own = &mut of_facet[own as usize];
            own.area += sample.area;
            own.weight += weight;
            own.place += weight * sample.position;
            own.corners.iter_mut().zip(found.weights[k]).for_each(|(corner, share)| *corner += weight * share);
        }
        let nearest_corner = |(&f, weights): (&u32, &[f64; 3])| {
            let corner = (1..3).fold(0, |best, k| if weights[k] > weights[best] { k } else { best });
            mesh.facets().get(f as usize).map_or(NONE, |t| t[corner])
        };
        let owners: Vec<u32> = found.facet.iter().zip(&found.weights).map(nearest_corner).collect();
        target.input.samples = Csr::group(mesh.positions.len(), &owners, |k| samples[k]);
        Self { of_facet, largest }
    }

    /// From a vertex to where the facets around it draw it.
    fn of(&self, mesh: &LocalMesh, v: u32) -> DVec3 {
        let (mut sum, mut place) = (0.0, DVec3::ZERO);
        for &f in mesh.ring(v) {
            let pull = &self.of_facet[f as usize];
            let corner = mesh.facets()[f as usize].iter().position(|&u| u == v).unwrap_or_default();
            if pull.weight > 0.0 {
                // The mean over each facet: the smaller ones, where the surface bends most, are to be no farther.
                let share = pull.corners[corner] / pull.area;
                sum += share;
                place += share / pull.weight * pull.place;
            }
        }
        if sum > 0.0 { place / sum - mesh.positions[v as usize] } else { DVec3::ZERO }
    }
}

/// The point of the input that is nearest to a vertex.
fn on_input(mesh: &LocalMesh, reference: &Reference<'_>, v: u32) -> DVec3 {
    let p = mesh.positions[v as usize];
    let near = ascending(mesh.neighbours(v).into_iter().flat_map(|u| reference.facets.of(u)).copied());
    let on = |f: u32| {
        let corners = reference.corners(f);
        let (squared, weights) = closest_on_facet(p, corners, [0, 1, 2]);
        (squared, (0..3).map(|k| weights[k] * corners[k]).sum::<DVec3>())
    };
    near.into_iter().map(on).reduce(|a, b| if b.0 < a.0 { b } else { a }).map_or(p, |found| found.1)
}
