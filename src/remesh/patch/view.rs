//! What a vertex of a patch sees while it moves.
//!
//! Purpose: the cost of a place for one vertex: how far from the input everything is that depends on it, and how
//! well shaped the facets around it are.
//! Invariant: nothing changes. Must not know: which places are tried.

use glam::DVec3;

use super::rock::least_distance;
use super::{LEAST, LEAST_COSINE, Patch, SHAPE, normal};
use crate::mesh::measure::{facet_quality, least_angle};

/// A facet that has so much less than [`LEAST`] + [`MARGIN`] costs as much as the farthest place,
const MARGIN: f64 = 3.0;
/// one with Q = 0 this much of it,
const ROUND: f64 = 0.3;
/// and a vertex as far from the input as the farthest place this.
const OFF: f64 = 0.3;
/// Distances below this share of the farthest one cost nothing.
const NEAR: f64 = 0.55;

/// Of angles that may be too sharp for a bound this is left to the exact ones.
const CLEAR: f64 = 1.0 - 1e-9;
/// Squares below this share of the squared bound are below it whatever rounding makes of their roots.
const SURE: f64 = 1.0 - 1e-12;

/// See the module's head.
pub(super) struct View<'a> {
    patch: &'a Patch,
    v: usize,
    worst: f64,
    /// Tips that depend on it: number, squared distance to all other facets.
    tips: Vec<(usize, f64)>,
    near: Vec<usize>,
    /// An angle is wider than what costs anything where its cosine is less than so many sines.
    wide: f64,
    /// What was nearest when the last place was looked at, which changes no cost: a facet of the input for the vertex
    /// and for the middle and the spoke of each of its facets, and a facet for each tip.
    hints: Vec<usize>,
    /// Corners of the facets with the vertex where it is looked at.
    corners: Vec<[DVec3; 3]>,
}

impl<'a> View<'a> {
    pub(super) fn new(patch: &'a Patch, v: usize, worst: f64, step: f64) -> Self {
        let star = &patch.star[v];
        let enough = (NEAR * worst).powi(2);
        let p = patch.at[v];
        let reach = star.iter().flat_map(|&f| patch.facets[f]).map(|u| patch.at[u].distance(p)).fold(0.0, f64::max);
        let mut tips = Vec::new();
        for (t, tip) in patch.tips.iter().enumerate() {
            if tip.0.distance_squared(p) > (reach + step + worst).powi(2) {
                continue;
            }
            let row = &patch.apart[t * patch.facets.len()..(t + 1) * patch.facets.len()];
            let mut other = tip.2;
            for (f, &squared) in row.iter().enumerate() {
                if squared < other && !star.contains(&f) {
                    other = squared;
                    if other < enough {
                        break;
                    }
                }
            }
            if other >= enough {
                tips.push((t, other));
            }
        }
        // Points on its spokes, wherever it steps.
        let near = patch.near(p, 0.8 * reach + step);
        let hints = vec![0; 1 + 2 * star.len() + tips.len()];
        let wide = CLEAR / (LEAST + MARGIN).to_radians().tan();
        Self { patch, v, worst, tips, near, wide, hints, corners: Vec::with_capacity(star.len()) }
    }

    /// What all that depends on the vertex costs if it is at `p`; any number not less than `most` if it costs that.
    pub(super) fn cost(&mut self, p: DVec3, most: f64) -> f64 {
        let patch = self.patch;
        let star = &patch.star[self.v];
        self.corners.clear();
        self.corners.extend(star.iter().map(|&f| patch.facets[f].map(|u| if u == self.v { p } else { patch.at[u] })));
        let Some(mut cost) = self.shapes(most) else { return f64::INFINITY };
        if cost >= most {
            return cost;
        }
        let (hints, of_tips) = self.hints.split_at_mut(1 + 2 * star.len());
        let enough = (NEAR * self.worst).powi(2);
        let far = |squared: f64| ((squared.sqrt() / self.worst - NEAR).max(0.0) / (1.0 - NEAR)).powi(3);
        for (&(t, other), hint) in self.tips.iter().zip(of_tips) {
            let own = least_distance(patch.tips[t].0, &self.corners, other, SURE * enough, hint);
            cost += far(own);
            if cost >= most {
                return cost;
            }
        }
        let own = patch.rocks_distance(p, &self.near, &mut hints[0], 0.0);
        cost += OFF * own / (self.worst * self.worst) + far(own);
        for (k, (&f, &corners)) in star.iter().zip(&self.corners).enumerate() {
            let [a, b, c] = corners;
            cost += far(patch.rocks_distance((a + b + c) / 3.0, &self.near, &mut hints[1 + 2 * k], enough));
            // Each spoke once: the one to the corner after this vertex.
            let next = (0..3).find(|&i| patch.facets[f][i] == self.v).map_or(0, |i| (i + 1) % 3);
            let apart = [0.25, 0.5, 0.75]
                .map(|t| patch.rocks_distance(p.lerp(corners[next], t), &self.near, &mut hints[2 + 2 * k], enough));
            cost += far(apart.into_iter().fold(0.0, f64::max));
            if cost >= most {
                return cost;
            }
        }
        cost
    }

    /// What the shapes of the facets cost, or some of them as soon as these cost `most`; nothing if one turned.
    fn shapes(&self, most: f64) -> Option<f64> {
        let (mut cost, mut fine) = (0.0, true);
        for (&f, &corners) in self.patch.star[self.v].iter().zip(&self.corners) {
            fine &= normal(corners).dot(self.patch.normals[f]) >= LEAST_COSINE;
            if !fine || cost >= most {
                break;
            }
            let quality = facet_quality(corners);
            // Most angles are wider than what costs anything, and that is seen without an arc tangent.
            let angle = if self.is_wide(corners) { f64::INFINITY } else { least_angle(corners) };
            let lack = (LEAST + MARGIN - angle.min(SHAPE * quality)).max(0.0) / MARGIN;
            cost += lack * lack + ROUND * (1.0 - quality);
        }
        fine.then_some(cost)
    }

    /// Whether all angles are clearly wider than what costs anything.
    fn is_wide(&self, [a, b, c]: [DVec3; 3]) -> bool {
        let (u, v, w) = (b - a, c - b, a - c);
        let sine = self.wide * u.cross(w).length();
        -u.dot(v) < sine && -v.dot(w) < sine && -w.dot(u) < sine
    }
}
