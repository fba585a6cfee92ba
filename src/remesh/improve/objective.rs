//! The cost of a place for one vertex of a patch.
//!
//! Purpose: [`VertexObjective`] adds up how far all that depends on the vertex is from the input, and how badly the facets
//! around it are shaped. What is near enough by more than one step can change is not measured again: a point of a facet moves
//! by its barycentric weight of the vertex.
//! Invariant: nothing changes, and costs are those of measuring everything. Must not know: which places are tried.

use glam::DVec3;

use super::patch::{LEAST_SCORE, Patch};
use crate::mesh::closest_point::closest_on_facet;
use crate::mesh::measure::{facet_quality, is_wide, least_angle};
use crate::remesh::distance::facet_set::least_distance;
use crate::remesh::triangle::{DEGREES_PER_QUALITY, unit_normal};

/// A facet's normal keeps this cosine to that at the beginning.
pub(super) const LEAST_COSINE: f64 = 0.5;
/// A facet whose score is this far below [`LEAST_SCORE`] + [`SCORE_MARGIN`], degrees, costs as much as the worst distance.
const SCORE_MARGIN: f64 = 3.0;
/// Cost of a facet with Q = 0 beside that of its score, as a share of the worst distance's.
const QUALITY_WEIGHT: f64 = 0.3;
/// Cost of the vertex's own squared distance, as a share of the worst distance's.
const OWN_WEIGHT: f64 = 0.3;
/// Distances below this share of the worst one cost nothing.
const FREE_SHARE: f64 = 0.55;
/// Share of the one-ring's radius within which the input has to be known around the vertex: the points whose distances are
/// taken lie within it.
const KNOWN_SHARE: f64 = 0.8;

/// Factor on bounds of angles and distances: what is nearer to the bound is left to the exact computation.
const BOUND_ROUNDING: f64 = 1.0 - 1e-9;
/// Factor by which the radius of a search grows, so that rounding leaves nothing outside.
const RADIUS_ROUNDING: f64 = 1.0 + 1e-9;
/// Squares below this share of a squared bound have roots below the bound despite rounding.
const SQUARE_ROUNDING: f64 = 1.0 - 1e-12;

/// Points of an edge at the vertex whose distance is taken, as shares of the edge from the vertex.
const ON_EDGE: [f64; 3] = [0.25, 0.5, 0.75];

/// See the module's head.
pub(super) struct VertexObjective<'a> {
    patch: &'a Patch,
    v: usize,
    /// The distance that costs 1.
    worst: f64,
    /// Where the vertex is, and the squared distance from the input there, once that is known.
    here: DVec3,
    own_squared: f64,
    /// Points of the input whose distance depends on the vertex.
    input_points: Vec<DependentPoint>,
    /// Groups of the input's facets that may be nearest to a point of the one-ring,
    near: Vec<u32>,
    /// and those that may be nearest to the vertex.
    nearest: Vec<u32>,
    /// The input's facet that was nearest to the vertex last.
    hint: u32,
    /// By facet around the vertex.
    ring: Vec<RingFacet>,
    /// An angle whose cotangent is less than this costs nothing.
    wide: f64,
    /// Corners of the facets with the vertex at the place that is measured.
    corners: Vec<[DVec3; 3]>,
}

/// A point of the input that may be nearest to a facet around the vertex.
struct DependentPoint {
    number: usize,
    /// Squared distance to all facets that are not around the vertex.
    other_squared: f64,
    /// The facet around the vertex that was nearest last.
    hint: usize,
}

/// What is known of a facet around the vertex.
struct RingFacet {
    /// The corner after the vertex.
    next: usize,
    /// The input's facets that were nearest last: to its inner points, and to its edge from the vertex to that corner.
    hints: [u32; 2],
    /// Distances of these points from the input, or more, with the vertex where it is.
    inner: [f64; 4],
    on_edge: [f64; 3],
}

impl<'a> VertexObjective<'a> {
    pub(super) fn new(patch: &'a Patch, v: usize, worst: f64, step: f64) -> Self {
        let facets = &patch.rings[v];
        let enough = (FREE_SHARE * worst).powi(2);
        let p = patch.positions[v];
        let neighbours = facets.iter().flat_map(|&f| patch.facets[f]);
        let reach = neighbours.map(|u| patch.positions[u].distance(p)).fold(0.0, f64::max);
        // A point nearer than this costs nothing; nearer by a step, it does so wherever the vertex goes.
        let free = FREE_SHARE * worst * BOUND_ROUNDING;
        let free_after_step = (free - step).max(0.0).powi(2);
        let mut input_points = Vec::new();
        for (number, point) in patch.input_points.iter().enumerate() {
            if point.position.distance_squared(p) > (reach + step + worst).powi(2) {
                continue;
            }
            let row = &patch.squared_distances[number * patch.facets.len()..(number + 1) * patch.facets.len()];
            let Some(&nearest) = facets.iter().min_by(|&&f, &&g| row[f].total_cmp(&row[g])) else { continue };
            if row[nearest] < free_after_step {
                continue;
            }
            // The closest point of the facet moves by the vertex's weight only.
            if row[nearest] < enough {
                let corner = patch.facets[nearest].iter().position(|&u| u == v).unwrap_or_default();
                let (squared, weights) = closest_on_facet(point.position, patch.corners(nearest), [0, 1, 2]);
                if squared.sqrt() + weights[corner] * step < free {
                    continue;
                }
            }
            let mut other_squared = point.outside_squared;
            for (f, &squared) in row.iter().enumerate() {
                if squared < other_squared && !facets.contains(&f) {
                    other_squared = squared;
                    if other_squared < enough {
                        break;
                    }
                }
            }
            if other_squared >= enough {
                input_points.push(DependentPoint { number, other_squared, hint: 0 });
            }
        }
        let near = patch.input_near(p, KNOWN_SHARE * reach + step);
        let of = |&facet: &usize| {
            let next = patch.facets[facet].iter().position(|&u| u == v).map_or(0, |i| (i + 1) % 3);
            RingFacet { next, hints: [0; 2], inner: [f64::INFINITY; 4], on_edge: [f64::INFINITY; 3] }
        };
        let ring = facets.iter().map(of).collect();
        let wide = BOUND_ROUNDING / (LEAST_SCORE + SCORE_MARGIN).to_radians().tan();
        let corners = Vec::with_capacity(facets.len());
        Self {
            patch,
            v,
            worst,
            here: p,
            own_squared: f64::INFINITY,
            input_points,
            nearest: near.clone(),
            near,
            hint: 0,
            ring,
            wide,
            corners,
        }
    }

    /// The cost where the vertex is. To be asked for before places that are at most `step` away.
    pub(super) fn cost_here(&mut self, step: f64) -> f64 {
        let cost = self.cost(self.here, f64::INFINITY);
        // What is farther than the nearest by two steps is not the nearest after one.
        let Self { patch, here, .. } = *self;
        let most = self.own_squared.sqrt() + 2.0 * step;
        patch.input_facets.retain_near(&mut self.nearest, here, most * RADIUS_ROUNDING);
        cost
    }

    /// The cost with the vertex at `p`, or any number not less than `most` if it is not less. Infinite if a facet turned over.
    pub(super) fn cost(&mut self, p: DVec3, most: f64) -> f64 {
        let patch = self.patch;
        let facets = patch.rings[self.v].iter().map(|&f| patch.facets[f]);
        self.corners.clear();
        self.corners.extend(facets.map(|t| t.map(|u| if u == self.v { p } else { patch.positions[u] })));
        let Some(mut cost) = self.shape_cost(most) else { return f64::INFINITY };
        if cost >= most {
            return cost;
        }
        let Self { worst, here, .. } = *self;
        let enough = (FREE_SHARE * worst).powi(2);
        let of_distance = |squared: f64| ((squared.sqrt() / worst - FREE_SHARE).max(0.0) / (1.0 - FREE_SHARE)).powi(3);
        let moved = here.distance(p);
        let is_here = moved == 0.0;
        let free = FREE_SHARE * worst * BOUND_ROUNDING;
        for point in &mut self.input_points {
            let position = patch.input_points[point.number].position;
            let enough = SQUARE_ROUNDING * enough;
            cost += of_distance(least_distance(position, &self.corners, point.other_squared, enough, &mut point.hint));
            if cost >= most {
                return cost;
            }
        }
        let own_squared = patch.input_facets.distance(p, &self.nearest, &mut self.hint, 0.0);
        if is_here {
            self.own_squared = own_squared;
        }
        cost += OWN_WEIGHT * own_squared / (worst * worst) + of_distance(own_squared);
        for (facet, &corners) in self.ring.iter_mut().zip(&self.corners) {
            let squared = |place: DVec3, weight: f64, hint: &mut u32, known: &mut f64| {
                if *known + weight * moved < free {
                    return 0.0;
                }
                let squared = patch.input_facets.distance(place, &self.near, hint, enough);
                if is_here {
                    *known = squared.sqrt();
                }
                if squared < enough { 0.0 } else { squared }
            };
            let [inner_hint, edge_hint] = &mut facet.hints;
            let centroid = (corners[0] + corners[1] + corners[2]) / 3.0;
            let mut largest = 0.0f64;
            for (k, known) in facet.inner.iter_mut().enumerate() {
                // The centroid, and halfway from there to the corners; the corner before `next` is the vertex.
                let (place, weight) = match k {
                    3 => (centroid, 1.0 / 3.0),
                    _ => {
                        let weight = if (k + 1) % 3 == facet.next { 2.0 / 3.0 } else { 1.0 / 6.0 };
                        (corners[k].lerp(centroid, 0.5), weight)
                    }
                };
                largest = largest.max(squared(place, weight, inner_hint, known));
            }
            cost += of_distance(largest);
            // Each edge at the vertex once: that to the next corner.
            let mut largest = 0.0f64;
            for (&t, known) in ON_EDGE.iter().zip(&mut facet.on_edge) {
                largest = largest.max(squared(p.lerp(corners[facet.next], t), 1.0 - t, edge_hint, known));
            }
            cost += of_distance(largest);
            if cost >= most {
                return cost;
            }
        }
        cost
    }

    /// The cost of the shapes of the facets, or of some of them as soon as that is `most`. `None` if a facet turned over.
    fn shape_cost(&self, most: f64) -> Option<f64> {
        let (mut cost, mut fine) = (0.0, true);
        for (&f, &corners) in self.patch.rings[self.v].iter().zip(&self.corners) {
            fine &= unit_normal(corners).dot(self.patch.normals[f]) >= LEAST_COSINE;
            if !fine || cost >= most {
                break;
            }
            let quality = facet_quality(corners);
            // Most angles are wide enough to cost nothing. That needs no arc tangent.
            let angle = if is_wide(corners, self.wide) { f64::INFINITY } else { least_angle(corners) };
            let score = angle.min(DEGREES_PER_QUALITY * quality);
            let lack = (LEAST_SCORE + SCORE_MARGIN - score).max(0.0) / SCORE_MARGIN;
            cost += lack * lack + QUALITY_WEIGHT * (1.0 - quality);
        }
        fine.then_some(cost)
    }
}
