//! The few worst triangles, made better.
//!
//! Purpose: after the iterations a handful of triangles, most of them where curves come close to each other,
//! have an angle far below the rest. Their vertices are moved a little, one at a time, to where the facets
//! around them lack least of a good shape, the worst counting most.
//! Invariant: moves are short beside an edge, within the tangent plane, and for a vertex of a curve along the
//! curve but for a small tolerance, which is all that ends of curves have, corners not even that; no facet turns over. Deterministic.
//! Must not know: seeds, diagrams, files.

use std::collections::HashSet;

use glam::DVec3;
use rayon::prelude::*;

use super::fences::Fences;
use super::flips;
use super::triangle::{DEGREES_PER_QUALITY, perimeter, score, unit_normal};
use crate::mesh::csr::Csr;
use crate::mesh::measure::{facet_quality, is_wide};
use crate::token::Token;

/// How a vertex may move.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Rail {
    /// Within the surface.
    Free,
    /// Along a direction, unit.
    Along(DVec3),
    /// Within a small tolerance.
    Corner,
    /// Not at all.
    Fixed,
}

/// Facets with a smaller score ([`score`]) are to be better, degrees.
const GOAL: f64 = 33.5;
/// The vertices around them, so many edges far, move as long as their own facets have less than this.
const RINGS: usize = 1;
const ENOUGH: f64 = 35.0;
/// Passes over their vertices.
const SWEEPS: usize = 40;
/// Times that edges are turned between such passes, at most.
const TURNS: usize = 3;
/// Steps that are tried, as shares of the mean edge around the vertex.
const STEPS: [f64; 4] = [0.15, 0.08, 0.04, 0.02];
/// Directions that are tried.
const DIRECTIONS: usize = 12;
/// A vertex goes no farther in all, same shares: within the surface or along its curve,
const FARTHEST: f64 = 0.4;
/// across its curve,
const ACROSS: f64 = 0.095;
/// and off the end of its curve.
const OFF: f64 = 0.07;
/// A facet's normal turns by at most this cosine.
const LEAST_COSINE: f64 = 0.8;
/// A place is better if it lacks so much less.
const GAIN: f64 = 0.01;
/// Of angles that may be too sharp for a bound this is left to the exact ones.
const CLEAR: f64 = 1.0 - 1e-9;

/// How vertices may move.
#[derive(Clone, Copy)]
pub(super) struct Bounds<'a> {
    pub(super) rails: &'a [Rail],
    pub(super) fences: &'a Fences,
    /// What leaves a curve leaves it by no more than this, whatever the edge.
    pub(super) off_curve: f64,
}

/// Improves the worst facets; edges in `curves` (lower end first) stay. Ends early where `token` is stopped.
pub(super) fn polish(
    positions: &mut [DVec3],
    facets: &mut [[u32; 3]],
    bounds: Bounds<'_>,
    curves: &HashSet<[u32; 2]>,
    token: &Token,
) {
    let start = positions.to_vec();
    for _ in 0..TURNS {
        let around = Csr::one_rings(positions.len(), facets);
        move_vertices(positions, &start, facets, &around, bounds, token);
        if token.is_stopped() || !flips::for_angles(positions, facets, &around, curves, GOAL, token) {
            return;
        }
    }
    let around = Csr::one_rings(positions.len(), facets);
    move_vertices(positions, &start, facets, &around, bounds, token);
}

fn move_vertices(
    positions: &mut [DVec3],
    start: &[DVec3],
    facets: &[[u32; 3]],
    around: &Csr<u32>,
    bounds: Bounds<'_>,
    token: &Token,
) {
    let normals: Vec<DVec3> = facets.par_iter().map(|t| unit_normal(t.map(|v| positions[v as usize]))).collect();
    let poor = |positions: &[DVec3], t: &[u32; 3]| score(t.map(|v| positions[v as usize])) < GOAL;
    let mut vertices: Vec<u32> = facets.par_iter().filter(|t| poor(positions, t)).flat_map_iter(|t| *t).collect();
    // Those around make room.
    for _ in 0..RINGS {
        let ring = vertices.iter().flat_map(|&v| around.of(v)).flat_map(|&f| facets[f as usize]);
        vertices = ring.collect();
        vertices.sort_unstable();
        vertices.dedup();
    }
    // Who stayed stays, as long as nobody beside it moves.
    let mut is_due = vec![true; positions.len()];
    for _ in 0..SWEEPS {
        let mut moved = false;
        for &v in &vertices {
            if !std::mem::replace(&mut is_due[v as usize], false) {
                continue;
            }
            if token.is_stopped() {
                return;
            }
            let star = Star { around: around.of(v), facets, normals: &normals, v };
            if star.improve(positions, start, bounds) {
                moved = true;
                star.around.iter().flat_map(|&f| facets[f as usize]).for_each(|u| is_due[u as usize] = true);
            }
        }
        if !moved {
            return;
        }
    }
}

/// A vertex and the facets around it.
struct Star<'a> {
    around: &'a [u32],
    facets: &'a [[u32; 3]],
    normals: &'a [DVec3],
    v: u32,
}

impl Star<'_> {
    /// Moves the vertex to the best place in reach. Returns whether it moved.
    fn improve(&self, positions: &mut [DVec3], start: &[DVec3], bounds: Bounds<'_>) -> bool {
        let v = self.v as usize;
        let here = positions[v];
        let rail = bounds.rails[v];
        if rail == Rail::Fixed {
            return false;
        }
        let now = self.lack(positions, here, f64::INFINITY);
        if now <= 0.0 {
            return false;
        }
        let edge = self.edge(positions);
        let normal = self.around.iter().map(|&f| self.normals[f as usize]).sum::<DVec3>().normalize_or(DVec3::Z);
        let (x, y) = match rail {
            // Across a crease there is no tangent plane; any direction beside the curve's will do.
            Rail::Along(way) => {
                (way, way.cross(normal).try_normalize().unwrap_or_else(|| way.any_orthonormal_vector()))
            }
            _ => normal.any_orthonormal_pair(),
        };
        let mut best = (now, here);
        for step in STEPS {
            for k in 0..DIRECTIONS {
                let (sin, cos) = (k as f64 / DIRECTIONS as f64 * std::f64::consts::TAU).sin_cos();
                let to = here + step * edge * (cos * x + sin * y);
                let far = to - start[v];
                let within = match rail {
                    Rail::Along(way) => {
                        let along = far.dot(way);
                        along.abs() <= FARTHEST * edge
                            && (far - along * way).length() <= (ACROSS * edge).min(bounds.off_curve)
                    }
                    Rail::Corner => far.length() <= (OFF * edge).min(bounds.off_curve),
                    Rail::Fixed => false,
                    Rail::Free => far.length() <= FARTHEST * edge,
                };
                if within && bounds.fences.allow(positions, self.v, to) {
                    let lack = self.lack(positions, to, best.0 - GAIN);
                    if lack < best.0 - GAIN {
                        best = (lack, to);
                    }
                }
            }
        }
        positions[v] = best.1;
        best.1 != here
    }

    /// The sum of cubes of what the facets around the vertex lack if it were at `p`, or of some of them as soon as that is
    /// not less than `most`: where one can only gain at another's cost, the worse one gains. Infinite if a facet turned.
    fn lack(&self, positions: &[DVec3], p: DVec3, most: f64) -> f64 {
        let at = |u: u32| if u == self.v { p } else { positions[u as usize] };
        let cotangent = CLEAR / ENOUGH.to_radians().tan();
        let mut sum = 0.0;
        for &f in self.around {
            let corners = self.facets[f as usize].map(at);
            if unit_normal(corners).dot(self.normals[f as usize]) < LEAST_COSINE {
                return f64::INFINITY;
            }
            // Most facets lack nothing, and that is seen without an arc tangent.
            if !(DEGREES_PER_QUALITY * facet_quality(corners) >= ENOUGH && is_wide(corners, cotangent)) {
                sum += (ENOUGH - score(corners)).max(0.0).powi(3);
            }
            if sum >= most {
                break;
            }
        }
        sum
    }

    /// Mean length of the edges around.
    fn edge(&self, positions: &[DVec3]) -> f64 {
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
        let mut rails = vec![Rail::Corner; 7];
        let wheel = facets.clone();
        let worst =
            |p: &[DVec3]| wheel.iter().map(|t| least_angle(t.map(|v| p[v as usize]))).fold(f64::INFINITY, f64::min);
        let (before, first) = (worst(&positions), positions[0]);
        let mut still = positions.clone();
        let fences = Fences::new(&[DVec3::ZERO; 7], &[false; 7], &[]);
        let none = HashSet::new();
        fn within<'a>(rails: &'a [Rail], fences: &'a Fences, off_curve: f64) -> Bounds<'a> {
            Bounds { rails, fences, off_curve }
        }
        polish(&mut still, &mut facets, within(&rails, &fences, f64::INFINITY), &none, &Token::default());
        assert!(still.iter().zip(&positions).all(|(p, q)| p.distance(*q) < 0.1), "corners have a tolerance");
        let mut stiller = positions.clone();
        polish(&mut stiller, &mut facets, within(&rails, &fences, 0.01), &none, &Token::default());
        assert!(stiller.iter().zip(&positions).all(|(p, q)| p.distance(*q) <= 0.01), "and no more than that");
        rails[0] = Rail::Free;
        polish(&mut positions, &mut facets, within(&rails, &fences, f64::INFINITY), &none, &Token::default());
        assert!(worst(&positions) > before + 5.0, "{} after {before}", worst(&positions));
        assert!(positions[0].distance(first) < 0.35);
        assert_eq!(positions[0].z, 0.0);
    }
}
