//! What a vertex of a patch sees while it moves.
//!
//! Purpose: the cost of a place for one vertex: how far from the input everything is that depends on it, and how
//! well shaped the facets around it are.
//! Invariant: nothing changes. Must not know: which places are tried.

use glam::DVec3;

use super::{LEAST, LEAST_COSINE, Patch, SHAPE, normal, squared_distance};
use crate::mesh::measure::{facet_quality, least_angle};

/// A facet that has so much less than [`LEAST`] + [`MARGIN`] costs as much as the farthest place,
const MARGIN: f64 = 3.0;
/// one with Q = 0 this much of it,
const ROUND: f64 = 0.3;
/// and a vertex as far from the input as the farthest place this.
const OFF: f64 = 0.3;
/// Distances below this share of the farthest one cost nothing.
const NEAR: f64 = 0.55;

/// See the module's head.
pub(super) struct View<'a> {
    patch: &'a Patch,
    v: usize,
    worst: f64,
    /// Tips that depend on it: number, squared distance to all other facets.
    tips: Vec<(usize, f64)>,
    near: Vec<usize>,
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
        Self { patch, v, worst, tips, near }
    }

    /// What all that depends on the vertex costs if it is at `p`; any number not less than `most` if it costs that.
    pub(super) fn cost(&self, p: DVec3, most: f64, hints: &mut [usize]) -> f64 {
        let patch = self.patch;
        let at = |u: usize| if u == self.v { p } else { patch.at[u] };
        let star = &patch.star[self.v];
        let mut cost = 0.0;
        for &f in star {
            let corners = patch.facets[f].map(at);
            if normal(corners).dot(patch.normals[f]) < LEAST_COSINE {
                return f64::INFINITY;
            }
            let quality = facet_quality(corners);
            let lack = (LEAST + MARGIN - least_angle(corners).min(SHAPE * quality)).max(0.0) / MARGIN;
            cost += lack * lack + ROUND * (1.0 - quality);
        }
        if cost >= most {
            return cost;
        }
        let enough = (NEAR * self.worst).powi(2);
        let far = |squared: f64| ((squared.sqrt() / self.worst - NEAR).max(0.0) / (1.0 - NEAR)).powi(3);
        for &(t, other) in &self.tips {
            let tip = patch.tips[t].0;
            let own = star.iter().map(|&f| squared_distance(tip, patch.facets[f].map(at)));
            cost += far(own.fold(other, f64::min));
        }
        if cost >= most {
            return cost;
        }
        let own = patch.rocks_distance(p, &self.near, &mut hints[0], 0.0);
        cost += OFF * own / (self.worst * self.worst) + far(own);
        for (k, &f) in star.iter().enumerate() {
            let [a, b, c] = patch.facets[f].map(at);
            cost += far(patch.rocks_distance((a + b + c) / 3.0, &self.near, &mut hints[1 + 2 * k], enough));
            // Each spoke once: the one to the corner after this vertex.
            let next = (0..3).find(|&i| patch.facets[f][i] == self.v).map_or(0, |i| (i + 1) % 3);
            let end = at(patch.facets[f][next]);
            let apart = [0.25, 0.5, 0.75]
                .map(|t| patch.rocks_distance(p.lerp(end, t), &self.near, &mut hints[2 + 2 * k], enough));
            cost += far(apart.into_iter().fold(0.0, f64::max));
            if cost >= most {
                return cost;
            }
        }
        cost
    }
}
