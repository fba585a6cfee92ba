//! Improvement of the worst triangles.
//!
//! Purpose: after the iterations a few triangles, most of them where curves come close to each other, have an angle far below
//! the others. Their vertices are relocated one at a time to where the facets around them lack least of a good score, the
//! worst facet counting most; between such passes edges are flipped.
//! Invariant: moves are short beside an edge. A vertex moves in the tangent plane; a vertex of a curve along the curve, within a
//! small tolerance across it; the end of a curve within that tolerance; a corner not at all. No facet turns over. The same
//! bits whatever the number of threads.
//! Must not know: seeds, diagrams, files.

use std::collections::HashSet;

use glam::DVec3;
use rayon::prelude::*;

use super::flips;
use crate::mesh::csr::Csr;
use crate::mesh::measure::{facet_quality, is_wide};
use crate::remesh::features::envelope::CurveEnvelope;
use crate::remesh::triangle::{DEGREES_PER_QUALITY, perimeter, score, unit_normal};
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

/// Facets with a smaller score are to be improved, degrees.
const GOAL_SCORE: f64 = 33.5;
/// One-rings around such a facet whose vertices move as well.
const RINGS: usize = 1;
/// Facets of moved vertices lack what they have less than this score, degrees.
const WANTED_SCORE: f64 = 35.0;
/// Passes over the vertices, at most.
const PASSES: usize = 40;
/// Rounds of flips between such passes, at most.
const FLIP_ROUNDS: usize = 3;
/// Steps that are tried, as shares of the mean edge around the vertex.
const STEPS: [f64; 4] = [0.15, 0.08, 0.04, 0.02];
/// Directions of a step.
const DIRECTIONS: usize = 12;
/// A vertex moves no farther than these shares of the mean edge in all: in the tangent plane or along its curve,
const FARTHEST: f64 = 0.4;
/// across its curve,
const FARTHEST_ACROSS: f64 = 0.095;
/// and at the end of its curve.
const FARTHEST_OF_END: f64 = 0.07;
/// A facet's normal keeps this cosine to that before.
const LEAST_COSINE: f64 = 0.8;
/// A place is better if its deficit is so much less, cubic degrees.
const LEAST_GAIN: f64 = 0.01;
/// Factor on a bound of angles: what is nearer to it is left to the exact computation.
const BOUND_ROUNDING: f64 = 1.0 - 1e-9;

/// How the vertices may move.
#[derive(Clone, Copy)]
pub(in crate::remesh) struct MotionBounds<'a> {
    pub(in crate::remesh) mobility: &'a [Mobility],
    pub(in crate::remesh) envelope: &'a CurveEnvelope,
    /// No vertex leaves its curve by more than this, whatever the edge.
    pub(in crate::remesh) off_curve: f64,
}

/// Improves the worst facets. Edges in `curves` (lower end first) stay. Ends early where `token` is stopped.
pub(in crate::remesh) fn improve_angles(
    positions: &mut [DVec3],
    facets: &mut [[u32; 3]],
    bounds: MotionBounds<'_>,
    curves: &HashSet<[u32; 2]>,
    token: &Token,
) {
    let start = positions.to_vec();
    for _ in 0..FLIP_ROUNDS {
        let rings = Csr::one_rings(positions.len(), facets);
        relocate(positions, &start, facets, &rings, bounds, token);
        if token.is_stopped() || !flips::flip_for_angles(positions, facets, &rings, curves, GOAL_SCORE, token) {
            return;
        }
    }
    let rings = Csr::one_rings(positions.len(), facets);
    relocate(positions, &start, facets, &rings, bounds, token);
}

fn relocate(
    positions: &mut [DVec3],
    start: &[DVec3],
    facets: &[[u32; 3]],
    rings: &Csr<u32>,
    bounds: MotionBounds<'_>,
    token: &Token,
) {
    let normals: Vec<DVec3> = facets.par_iter().map(|t| unit_normal(t.map(|v| positions[v as usize]))).collect();
    let poor = |positions: &[DVec3], t: &[u32; 3]| score(t.map(|v| positions[v as usize])) < GOAL_SCORE;
    let mut vertices: Vec<u32> = facets.par_iter().filter(|t| poor(positions, t)).flat_map_iter(|t| *t).collect();
    // Their neighbours make room.
    for _ in 0..RINGS {
        let ring = vertices.iter().flat_map(|&v| rings.of(v)).flat_map(|&f| facets[f as usize]);
        vertices = ring.collect();
        vertices.sort_unstable();
        vertices.dedup();
    }
    // A vertex that did not move is skipped until a neighbour moves.
    let mut is_due = vec![true; positions.len()];
    for _ in 0..PASSES {
        let mut moved = false;
        for &v in &vertices {
            if !std::mem::replace(&mut is_due[v as usize], false) {
                continue;
            }
            if token.is_stopped() {
                return;
            }
            let ring = OneRing { around: rings.of(v), facets, normals: &normals, v };
            if ring.improve(positions, start, bounds) {
                moved = true;
                ring.around.iter().flat_map(|&f| facets[f as usize]).for_each(|u| is_due[u as usize] = true);
            }
        }
        if !moved {
            return;
        }
    }
}

/// A vertex and the facets around it.
struct OneRing<'a> {
    around: &'a [u32],
    facets: &'a [[u32; 3]],
    normals: &'a [DVec3],
    v: u32,
}

impl OneRing<'_> {
    /// Moves the vertex to the best place among those in reach. Returns whether it moved.
    fn improve(&self, positions: &mut [DVec3], start: &[DVec3], bounds: MotionBounds<'_>) -> bool {
        let v = self.v as usize;
        let here = positions[v];
        let mobility = bounds.mobility[v];
        if mobility == Mobility::Fixed {
            return false;
        }
        let now = self.deficit(positions, here, f64::INFINITY);
        if now <= 0.0 {
            return false;
        }
        let edge = self.mean_edge(positions);
        let normal = self.around.iter().map(|&f| self.normals[f as usize]).sum::<DVec3>().normalize_or(DVec3::Z);
        let (x, y) = match mobility {
            // A crease has no tangent plane: any direction across the curve will do.
            Mobility::Along(curve) => {
                (curve, curve.cross(normal).try_normalize().unwrap_or_else(|| curve.any_orthonormal_vector()))
            }
            _ => normal.any_orthonormal_pair(),
        };
        let mut best = (now, here);
        for step in STEPS {
            for k in 0..DIRECTIONS {
                let (sin, cos) = (k as f64 / DIRECTIONS as f64 * std::f64::consts::TAU).sin_cos();
                let to = here + step * edge * (cos * x + sin * y);
                let moved = to - start[v];
                let within = match mobility {
                    Mobility::Along(curve) => {
                        let along = moved.dot(curve);
                        along.abs() <= FARTHEST * edge
                            && (moved - along * curve).length() <= (FARTHEST_ACROSS * edge).min(bounds.off_curve)
                    }
                    Mobility::End => moved.length() <= (FARTHEST_OF_END * edge).min(bounds.off_curve),
                    Mobility::Fixed => false,
                    Mobility::Free => moved.length() <= FARTHEST * edge,
                };
                if within && bounds.envelope.admits(positions, self.v, to) {
                    let deficit = self.deficit(positions, to, best.0 - LEAST_GAIN);
                    if deficit < best.0 - LEAST_GAIN {
                        best = (deficit, to);
                    }
                }
            }
        }
        positions[v] = best.1;
        best.1 != here
    }

    /// The sum of cubes of what the facets around the vertex would lack with it at `p`, or of some of them as soon as that is
    /// not less than `most`. Cubes, so that the worse of two facets gains at the other's cost. Infinite if a facet turned over.
    fn deficit(&self, positions: &[DVec3], p: DVec3, most: f64) -> f64 {
        let at = |u: u32| if u == self.v { p } else { positions[u as usize] };
        let cotangent = BOUND_ROUNDING / WANTED_SCORE.to_radians().tan();
        let mut sum = 0.0;
        for &f in self.around {
            let corners = self.facets[f as usize].map(at);
            if unit_normal(corners).dot(self.normals[f as usize]) < LEAST_COSINE {
                return f64::INFINITY;
            }
            // Most facets lack nothing. To see that needs no arc tangent.
            if !(DEGREES_PER_QUALITY * facet_quality(corners) >= WANTED_SCORE && is_wide(corners, cotangent)) {
                sum += (WANTED_SCORE - score(corners)).max(0.0).powi(3);
            }
            if sum >= most {
                break;
            }
        }
        sum
    }

    /// Mean length of the edges around.
    fn mean_edge(&self, positions: &[DVec3]) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0);
        for &f in self.around {
            sum += perimeter(self.facets[f as usize].map(|u| positions[u as usize]));
            count += 3.0;
        }
        sum / f64::max(count, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::measure::least_angle;

    #[test]
    fn the_hub_of_a_wheel_goes_to_its_middle_and_no_farther_than_it_may() {
        let mut positions = vec![DVec3::new(0.25, 0.0, 0.0)];
        positions.extend((0..6).map(|k| {
            let (sin, cos) = (f64::from(k) / 6.0 * std::f64::consts::TAU).sin_cos();
            DVec3::new(cos, sin, 0.0)
        }));
        positions[0] = DVec3::new(0.6, 0.2, 0.0);
        let mut facets: Vec<[u32; 3]> = (0..6).map(|k| [0, 1 + k, 1 + (k + 1) % 6]).collect();
        let mut mobility = vec![Mobility::End; 7];
        let wheel = facets.clone();
        let worst =
            |p: &[DVec3]| wheel.iter().map(|t| least_angle(t.map(|v| p[v as usize]))).fold(f64::INFINITY, f64::min);
        let (before, first) = (worst(&positions), positions[0]);
        let mut still = positions.clone();
        let envelope = CurveEnvelope::new(&[DVec3::ZERO; 7], &[false; 7], &[]);
        let none = HashSet::new();
        fn within<'a>(mobility: &'a [Mobility], envelope: &'a CurveEnvelope, off_curve: f64) -> MotionBounds<'a> {
            MotionBounds { mobility, envelope, off_curve }
        }
        improve_angles(&mut still, &mut facets, within(&mobility, &envelope, f64::INFINITY), &none, &Token::default());
        assert!(still.iter().zip(&positions).all(|(p, q)| p.distance(*q) < 0.1), "corners have a tolerance");
        let mut stiller = positions.clone();
        improve_angles(&mut stiller, &mut facets, within(&mobility, &envelope, 0.01), &none, &Token::default());
        assert!(stiller.iter().zip(&positions).all(|(p, q)| p.distance(*q) <= 0.01), "and no more than that");
        mobility[0] = Mobility::Free;
        improve_angles(
            &mut positions,
            &mut facets,
            within(&mobility, &envelope, f64::INFINITY),
            &none,
            &Token::default(),
        );
        assert!(worst(&positions) > before + 5.0, "{} after {before}", worst(&positions));
        assert!(positions[0].distance(first) < 0.35);
        assert_eq!(positions[0].z, 0.0);
    }
}
