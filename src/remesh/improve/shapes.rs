//! Improvement of the worst triangles of the whole result.
//!
//! Purpose: after the iterations some triangles, most of them where curves come close to each other, have an angle far from the
//! others'. The vertices at and beside them wait in a queue, that with the costliest facets first. A vertex is relocated to
//! where its facets cost least; where no place is better, an edge of a poor facet is flipped.
//! Invariant: moves are short beside an edge. A vertex moves in the tangent plane; a vertex of a curve along the curve, within a
//! small tolerance across it; the end of a curve within that tolerance; a corner not at all. No facet turns over. The same
//! bits whatever the number of threads.
//! Must not know: seeds, diagrams, files.

use glam::DVec3;
use rayon::prelude::*;

use super::objective::ShapeCost;
use super::queue::{Place, Queue};
use super::relocation::{Steps, cheapest, places_around};
use crate::mesh::measure::facet_quality;
use crate::remesh::constants::{
    DIRECTIONS, FARTHEST_ACROSS, FARTHEST_OF_END, FARTHEST_TANGENTIAL, FIRST_STEP, LEAST_GAIN_OF_PASS,
    MOVES_PER_VERTEX, POOR_ANGLE, POOR_SCORE, UNMEASURED_COSINE,
};
use crate::remesh::features::envelope::CurveEnvelope;
use crate::remesh::manifold::local_mesh::{Flip, LocalMesh};
use crate::remesh::triangle::{Wanted, perimeter};
use crate::token::Token;

/// How a vertex may move.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::remesh) enum Mobility {
    /// In the tangent plane.
    Free,
    /// Along a direction, unit.
    Along(DVec3),
    /// Within a small tolerance: the end of a curve.
    End,
    /// Not at all.
    Fixed,
}

/// How the vertices may move.
#[derive(Clone, Copy)]
pub(in crate::remesh) struct MotionBounds<'a> {
    pub(in crate::remesh) mobility: &'a [Mobility],
    pub(in crate::remesh) envelope: &'a CurveEnvelope,
    /// No vertex leaves its curve by more than this, whatever the edge.
    pub(in crate::remesh) off_curve: f64,
}

/// Improves the worst facets. Ends early where `token` is stopped.
pub(in crate::remesh) fn improve_shapes(mesh: &mut LocalMesh, bounds: MotionBounds<'_>, token: &Token) {
    mesh.mark();
    let wanted = Wanted::new(POOR_SCORE, POOR_ANGLE);
    let lack = |f: u32| {
        let corners = mesh.corners(f);
        wanted.lack(corners, facet_quality(corners))
    };
    let facets = (0..mesh.facets().len() as u32).into_par_iter();
    let poor: Vec<u32> = facets.filter(|&f| lack(f) > 0.0).flat_map_iter(|f| mesh.facets()[f as usize]).collect();
    // Their neighbours make room.
    let vertices = mesh.corners_around(&poor);
    let mut is_due = vec![false; mesh.positions.len()];
    vertices.iter().for_each(|&v| is_due[v as usize] = true);
    let (start, steps) = (mesh.positions.clone(), Steps::new(mesh.positions.len()));
    let mut shapes = Shapes { mesh, start, bounds, wanted, cost: ShapeCost::unmeasured(), steps, queue: Queue::new() };
    vertices.iter().for_each(|&v| shapes.push(v));
    let mut left = MOVES_PER_VERTEX * vertices.len();
    while let Some(place) = shapes.queue.pop() {
        if left == 0 || token.is_stopped() {
            return;
        }
        let v = place.vertex();
        // If it has changed since, it is in the queue again.
        if shapes.cost_of(v) == place.badness() {
            left -= 1;
            for u in shapes.improve(v, place.badness()).into_iter().filter(|&u| is_due[u as usize]) {
                shapes.steps.renew(u);
                shapes.push(u);
            }
        }
    }
}

struct Shapes<'a> {
    mesh: &'a mut LocalMesh,
    start: Vec<DVec3>,
    bounds: MotionBounds<'a>,
    wanted: Wanted,
    cost: ShapeCost,
    steps: Steps,
    queue: Queue<()>,
}

impl Shapes<'_> {
    fn cost_of(&self, v: u32) -> f64 {
        self.cost.around(self.mesh, v, self.mesh.positions[v as usize], f64::INFINITY, f64::NEG_INFINITY)
    }

    fn push(&mut self, v: u32) {
        if self.bounds.mobility[v as usize] != Mobility::Fixed {
            self.queue.push(Place::new((), v, self.cost_of(v)));
        }
    }

    /// Relocates a vertex whose facets cost so much, or flips an edge beside it. Returns the vertices around what changed.
    fn improve(&mut self, v: u32, cost: f64) -> Vec<u32> {
        if let Some(share) = self.steps.next(v) {
            let to = self.better_place(v, cost, share);
            if to != self.mesh.positions[v as usize] {
                self.mesh.positions[v as usize] = to;
                return self.mesh.neighbours(v);
            }
            self.steps.halve(v);
            self.queue.push(Place::new((), v, cost));
            return Vec::new();
        }
        let Some(flip) = self.better_flip(v) else { return Vec::new() };
        self.mesh.apply(&flip);
        self.mesh.corners_around(&flip.corners.concat())
    }

    fn better_place(&self, v: u32, cost: f64, share: f64) -> DVec3 {
        let (mesh, MotionBounds { mobility, envelope, off_curve }) = (&*self.mesh, self.bounds);
        let (here, start, mobility) = (mesh.positions[v as usize], self.start[v as usize], mobility[v as usize]);
        let ring = mesh.ring(v);
        let edge = ring.iter().map(|&f| perimeter(mesh.corners(f))).sum::<f64>() / (3 * ring.len()) as f64;
        let normal = mesh.vertex_normal(v);
        let (x, y) = match mobility {
            // A crease has no tangent plane: any direction across the curve will do.
            Mobility::Along(curve) => {
                (curve, curve.cross(normal).try_normalize().unwrap_or_else(|| curve.any_orthonormal_vector()))
            }
            _ => normal.any_orthonormal_pair(),
        };
        let may_go = |p: &DVec3| {
            let moved = *p - start;
            let within = match mobility {
                Mobility::Along(curve) => {
                    let along = moved.dot(curve);
                    along.abs() <= FARTHEST_TANGENTIAL * edge
                        && (moved - along * curve).length() <= (FARTHEST_ACROSS * edge).min(off_curve)
                }
                Mobility::End => moved.length() <= (FARTHEST_OF_END * edge).min(off_curve),
                Mobility::Fixed => false,
                Mobility::Free => moved.length() <= FARTHEST_TANGENTIAL * edge,
            };
            within && envelope.admits(&mesh.positions, v, *p)
        };
        let places = places_around(here, share * FIRST_STEP * edge, [x, y]).take(DIRECTIONS);
        let cost_at = |p: DVec3, most: f64| self.cost.around(mesh, v, p, most, UNMEASURED_COSINE);
        cheapest((cost, here), LEAST_GAIN_OF_PASS, places.filter(may_go), cost_at).1
    }

    /// The flip of an edge of a poor facet around `v` that gains most.
    fn better_flip(&self, v: u32) -> Option<Flip> {
        let mesh = &*self.mesh;
        let is_poor = |f: &&u32| {
            let corners = mesh.corners(**f);
            self.wanted.lack(corners, facet_quality(corners)) > 0.0
        };
        let gain = |flip: &Flip| {
            let before: f64 = flip.facets.iter().map(|&f| self.cost.of(mesh.corners(f))).sum();
            before - flip.corners.iter().map(|&t| self.cost.of(mesh.places(t))).sum::<f64>()
        };
        let flips = mesh.ring(v).iter().filter(is_poor).flat_map(|&f| mesh.flips_of(f));
        let best = flips.map(|flip| (gain(&flip), flip)).reduce(|a, b| if b.0 > a.0 { b } else { a });
        best.filter(|(gain, _)| *gain > LEAST_GAIN_OF_PASS).map(|(_, flip)| flip)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;
    use crate::mesh::measure::least_angle;

    #[test]
    fn the_hub_of_a_wheel_goes_to_its_middle_and_no_farther_than_it_may() {
        let mut positions = vec![DVec3::new(0.6, 0.2, 0.0)];
        positions.extend((0..6).map(|k| {
            let (sin, cos) = (f64::from(k) / 6.0 * std::f64::consts::TAU).sin_cos();
            DVec3::new(cos, sin, 0.0)
        }));
        let facets: Vec<[u32; 3]> = (0..6).map(|k| [0, 1 + k, 1 + (k + 1) % 6]).collect();
        let wheel = LocalMesh::new(positions, facets, HashSet::new());
        let worst = |m: &LocalMesh| (0..6).map(|f| least_angle(m.corners(f))).fold(f64::INFINITY, f64::min);
        let envelope = CurveEnvelope::new(&[DVec3::ZERO; 7], &[false; 7], &[]);
        let improved = |hub: Mobility, off_curve: f64| {
            let mut mobility = vec![Mobility::End; 7];
            mobility[0] = hub;
            let mut mesh = wheel.clone();
            let bounds = MotionBounds { mobility: &mobility, envelope: &envelope, off_curve };
            improve_shapes(&mut mesh, bounds, &Token::default());
            mesh
        };
        let farthest =
            |m: &LocalMesh| m.positions.iter().zip(&wheel.positions).map(|(p, q)| p.distance(*q)).fold(0.0, f64::max);
        assert!(farthest(&improved(Mobility::End, f64::INFINITY)) < 0.1, "ends have a tolerance");
        assert!(farthest(&improved(Mobility::End, 0.01)) <= 0.01, "and no more than that");
        let free = improved(Mobility::Free, f64::INFINITY);
        assert!(worst(&free) > worst(&wheel) + 5.0, "{} after {}", worst(&free), worst(&wheel));
        assert!(free.positions[0].distance(wheel.positions[0]) < 0.45);
        assert_eq!(free.positions[0].z, 0.0);
    }
}
