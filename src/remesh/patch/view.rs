//! What a vertex of a patch sees while it moves.
//!
//! Purpose: the cost of a place for one vertex: how far from the input everything is that depends on it, and how
//! well shaped the facets around it are. What was near enough where the vertex is, by more than it can come farther by one
//! step, is not looked at again: a point of a facet moves by its corner's share in it.
//! Invariant: nothing changes, and costs are those of looking at everything. Must not know: which places are tried.

use glam::DVec3;

use super::super::triangle::{DEGREES_PER_QUALITY, unit_normal};
use super::rock::least_distance;
use super::{LEAST, LEAST_COSINE, Patch};
use crate::mesh::closest_point::closest_on_facet;
use crate::mesh::measure::{facet_quality, is_wide, least_angle};

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
/// So much farther than what is too far for the nearest is left to be compared.
const BEYOND: f64 = 1.0 + 1e-9;
/// Squares below this share of the squared bound are below it whatever rounding makes of their roots.
const SURE: f64 = 1.0 - 1e-12;

/// Points of a spoke that are looked at, as shares of it from the vertex; the vertex's weight is the rest.
const ON_SPOKE: [f64; 3] = [0.25, 0.5, 0.75];

/// See the module's head.
pub(super) struct View<'a> {
    patch: &'a Patch,
    v: usize,
    worst: f64,
    /// Where it is, and the squared distance from the input there, once that is known.
    here: DVec3,
    own: f64,
    /// Tips that depend on it.
    tips: Vec<SeenTip>,
    /// Groups of the input's facets that may be nearest to anything of it,
    near: Vec<u32>,
    /// and to itself.
    nearest: Vec<u32>,
    /// What was nearest to it when the last place was looked at.
    hint: u32,
    /// What it sees of each of its facets.
    around: Vec<SeenFacet>,
    /// An angle is wider than what costs anything where its cotangent is less than this.
    wide: f64,
    /// Corners of the facets with the vertex where it is looked at.
    corners: Vec<[DVec3; 3]>,
}

/// A vertex of the input that may be near a facet around the vertex.
struct SeenTip {
    number: usize,
    /// Squared distance to all facets that are not around the vertex.
    other: f64,
    /// The facet around it that was nearest last.
    hint: usize,
}

/// A facet around the vertex.
struct SeenFacet {
    /// Which corner comes after the vertex.
    next: usize,
    /// Of its inner points and its spoke to that corner: what of the input was nearest last, and how far they are from it
    /// at most while the vertex is here.
    hints: [u32; 2],
    inner: [f64; 4],
    spoke: [f64; 3],
}

impl<'a> View<'a> {
    pub(super) fn new(patch: &'a Patch, v: usize, worst: f64, step: f64) -> Self {
        let star = &patch.star[v];
        let enough = (NEAR * worst).powi(2);
        let p = patch.at[v];
        let reach = star.iter().flat_map(|&f| patch.facets[f]).map(|u| patch.at[u].distance(p)).fold(0.0, f64::max);
        // So near that it costs nothing, and that wherever the vertex steps.
        let near_by = NEAR * worst * CLEAR;
        let settled = (near_by - step).max(0.0).powi(2);
        let mut tips = Vec::new();
        for (t, tip) in patch.tips.iter().enumerate() {
            if tip.0.distance_squared(p) > (reach + step + worst).powi(2) {
                continue;
            }
            let row = &patch.apart[t * patch.facets.len()..(t + 1) * patch.facets.len()];
            let Some(&nearest) = star.iter().min_by(|&&f, &&g| row[f].total_cmp(&row[g])) else { continue };
            if row[nearest] < settled {
                continue;
            }
            // Where the facet is nearest to it, it moves by the vertex's share only.
            if row[nearest] < enough {
                let corner = patch.facets[nearest].iter().position(|&u| u == v).unwrap_or_default();
                let (squared, weights) = closest_on_facet(tip.0, patch.corners(nearest), [0, 1, 2]);
                if squared.sqrt() + weights[corner] * step < near_by {
                    continue;
                }
            }
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
                tips.push(SeenTip { number: t, other, hint: 0 });
            }
        }
        // Points on its spokes, wherever it steps.
        let near = patch.near(p, 0.8 * reach + step);
        let seen = |&facet: &usize| {
            let next = patch.facets[facet].iter().position(|&u| u == v).map_or(0, |i| (i + 1) % 3);
            SeenFacet { next, hints: [0; 2], inner: [f64::INFINITY; 4], spoke: [f64::INFINITY; 3] }
        };
        let around = star.iter().map(seen).collect();
        let wide = CLEAR / (LEAST + MARGIN).to_radians().tan();
        let corners = Vec::with_capacity(star.len());
        Self {
            patch,
            v,
            worst,
            here: p,
            own: f64::INFINITY,
            tips,
            nearest: near.clone(),
            near,
            hint: 0,
            around,
            wide,
            corners,
        }
    }

    /// What all that depends on the vertex costs where it is. To be asked for before places that are at most `step` away.
    pub(super) fn cost_here(&mut self, step: f64) -> f64 {
        let cost = self.cost(self.here, f64::INFINITY);
        // What is farther than the nearest by two steps will not be nearer than that after one.
        let Self { patch, here, .. } = *self;
        let most = self.own.sqrt() + 2.0 * step;
        patch.rocks.retain(&mut self.nearest, here, most * BEYOND);
        cost
    }

    /// What it costs if the vertex is at `p`; any number not less than `most` if it costs that.
    pub(super) fn cost(&mut self, p: DVec3, most: f64) -> f64 {
        let patch = self.patch;
        let star = &patch.star[self.v];
        self.corners.clear();
        self.corners.extend(star.iter().map(|&f| patch.facets[f].map(|u| if u == self.v { p } else { patch.at[u] })));
        let Some(mut cost) = self.shapes(most) else { return f64::INFINITY };
        if cost >= most {
            return cost;
        }
        let Self { worst, here, .. } = *self;
        let enough = (NEAR * worst).powi(2);
        let far = |squared: f64| ((squared.sqrt() / worst - NEAR).max(0.0) / (1.0 - NEAR)).powi(3);
        let moved = here.distance(p);
        let is_here = moved == 0.0;
        // What is surely nearer than what costs anything.
        let near_by = NEAR * worst * CLEAR;
        for tip in &mut self.tips {
            let place = patch.tips[tip.number].0;
            cost += far(least_distance(place, &self.corners, tip.other, SURE * enough, &mut tip.hint));
            if cost >= most {
                return cost;
            }
        }
        let own = patch.rocks.distance(p, &self.nearest, &mut self.hint, 0.0);
        if is_here {
            self.own = own;
        }
        cost += OFF * own / (worst * worst) + far(own);
        for (seen, &corners) in self.around.iter_mut().zip(&self.corners) {
            let look = |place: DVec3, weight: f64, hint: &mut u32, reach: &mut f64| {
                if *reach + weight * moved < near_by {
                    return 0.0;
                }
                let squared = patch.rocks.distance(place, &self.near, hint, enough);
                if is_here {
                    *reach = squared.sqrt();
                }
                if squared < enough { 0.0 } else { squared }
            };
            let [of_inner, of_spoke] = &mut seen.hints;
            let centre = (corners[0] + corners[1] + corners[2]) / 3.0;
            let mut within = 0.0f64;
            for (k, reach) in seen.inner.iter_mut().enumerate() {
                // Its centre, and halfway from there to its corners; the one before `next` is the vertex.
                let (place, weight) = match k {
                    3 => (centre, 1.0 / 3.0),
                    _ => (corners[k].lerp(centre, 0.5), if (k + 1) % 3 == seen.next { 2.0 / 3.0 } else { 1.0 / 6.0 }),
                };
                within = within.max(look(place, weight, of_inner, reach));
            }
            cost += far(within);
            // Each spoke once: the one to the corner after this vertex.
            let mut apart = 0.0f64;
            for (&t, reach) in ON_SPOKE.iter().zip(&mut seen.spoke) {
                apart = apart.max(look(p.lerp(corners[seen.next], t), 1.0 - t, of_spoke, reach));
            }
            cost += far(apart);
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
            fine &= unit_normal(corners).dot(self.patch.normals[f]) >= LEAST_COSINE;
            if !fine || cost >= most {
                break;
            }
            let quality = facet_quality(corners);
            // Most angles are wider than what costs anything, and that is seen without an arc tangent.
            let angle = if is_wide(corners, self.wide) { f64::INFINITY } else { least_angle(corners) };
            let lack = (LEAST + MARGIN - angle.min(DEGREES_PER_QUALITY * quality)).max(0.0) / MARGIN;
            cost += lack * lack + ROUND * (1.0 - quality);
        }
        fine.then_some(cost)
    }
}
