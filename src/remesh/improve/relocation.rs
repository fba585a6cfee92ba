//! Relocation of the vertices of a patch.
//!
//! Purpose: moves vertices one at a time, by steps that are halved when none helps, to where the patch is both near to the
//! input and well shaped ([`super::objective`]).
//! Invariant: only movable vertices move, and not far; no facet turns over.
//! Must not know: what a place costs, which patches there are.

use glam::DVec3;

use super::objective::{LEAST_COSINE, VertexObjective};
use super::patch::Patch;
use crate::remesh::triangle::unit_normal;

/// First step, as a share of the mean edge.
const FIRST_STEP: f64 = 0.2;
/// How often a vertex may halve its step.
const MAX_HALVINGS: i32 = 4;
/// A vertex moves no farther than this share of the mean edge in all.
const FARTHEST_MOVE: f64 = 0.6;
/// Directions of a step in the tangent plane. Beside them a vertex tries half a step up and down.
const DIRECTIONS: usize = 8;
/// Share of a step that is tried along the normal.
const NORMAL_STEP: f64 = 0.5;
/// A place has to cost so much less than the one before.
const LEAST_GAIN: f64 = 1e-4;

impl Patch {
    /// Puts the movable vertex that is nearest to `p` there, whatever becomes of the shapes. Returns whether it went, and no
    /// facet turned over.
    pub(super) fn jump(&mut self, p: DVec3) -> bool {
        let movable = (0..self.positions.len()).filter(|&v| self.movable[v]);
        let squared = |v: usize| self.positions[v].distance_squared(p);
        let nearest = movable.min_by(|&a, &b| squared(a).total_cmp(&squared(b)));
        let reach = FARTHEST_MOVE * self.mean_edge;
        let Some(v) = nearest.filter(|&v| self.positions[v].distance(p) < reach) else { return false };
        self.put(v, p);
        self.rings[v].iter().all(|&f| unit_normal(self.corners(f)).dot(self.normals[f]) >= LEAST_COSINE)
    }

    fn put(&mut self, v: usize, p: DVec3) {
        self.positions[v] = p;
        for k in 0..self.rings[v].len() {
            self.update_distances(self.rings[v][k]);
        }
    }

    /// Moves the vertices, the centre first, in so many passes at most. `worst` is the distance that costs as much as a bad
    /// shape.
    pub(super) fn relax(&mut self, worst: f64, passes: usize) {
        let mut order: Vec<usize> = (0..self.positions.len()).filter(|&v| self.movable[v]).collect();
        order.sort_by_key(|&v| (v != self.centre, v));
        for _ in 0..passes {
            let mut tried = false;
            for &v in &order {
                if self.token.is_stopped() {
                    return;
                }
                if self.halvings[v] < MAX_HALVINGS {
                    tried = true;
                    let step = FIRST_STEP * self.mean_edge * 0.5f64.powi(self.halvings[v]);
                    self.halvings[v] += i32::from(!self.improve(v, worst, step));
                }
            }
            if !tried {
                return;
            }
        }
    }

    /// Moves one vertex by one step to where it costs least. Returns whether it moved.
    fn improve(&mut self, v: usize, worst: f64, step: f64) -> bool {
        let mut objective = VertexObjective::new(self, v, worst, step);
        let here = self.positions[v];
        let mut best = (objective.cost_here(step), here);
        if best.0 <= 0.0 {
            return false;
        }
        let normals = self.rings[v].iter().map(|&f| unit_normal(self.corners(f)));
        let up = normals.sum::<DVec3>().normalize_or(DVec3::Z);
        let (x, y) = up.any_orthonormal_pair();
        let tangents = (0..DIRECTIONS).map(|k| {
            let (sin, cos) = (k as f64 / DIRECTIONS as f64 * std::f64::consts::TAU).sin_cos();
            cos * x + sin * y
        });
        for direction in tangents.chain([NORMAL_STEP * up, -NORMAL_STEP * up]) {
            let to = here + step * direction;
            if to.distance(self.start[v]) <= FARTHEST_MOVE * self.mean_edge {
                let cost = objective.cost(to, best.0);
                if cost < best.0 - LEAST_GAIN {
                    best = (cost, to);
                }
            }
        }
        if best.1 == here {
            return false;
        }
        self.put(v, best.1);
        true
    }
}
