//! The cost of a place for one vertex of a patch.
//!
//! Purpose: [`VertexObjective`] adds up how far all that depends on the vertex is from the input, and how badly the facets
//! around it are shaped. What is near enough by more than one step can change is not measured again: a point of a facet moves
//! by its barycentric weight of the vertex.
//! Invariant: nothing changes, and costs are those of measuring everything. Must not know: which places are tried.

use glam::DVec3;

use super::patch::Patch;
use crate::mesh::closest_point::closest_on_facet;
use crate::mesh::facet_set::least_distance;
use crate::mesh::measure::facet_quality;
use crate::remesh::constants::*;
use crate::remesh::manifold::LocalMesh;
use crate::remesh::triangle::{Shapes, Wanted};

/// What the shapes of facets cost: little for Q below 1, much for what they lack of the wanted shape.
#[derive(Clone, Copy)]
pub(super) struct ShapeCost {
    wanted: Wanted,
    power: i32,
    quality_weight: f64,
}

impl ShapeCost {
    /// Where distances are measured as well, and this score is wanted. Squares: near a ridge distances have to count beside facets that lack much.
    pub(super) fn measured(shapes: Shapes, wanted: f64) -> Self {
        let quality_weight = if shapes == Shapes::Round { QUALITY_WEIGHT } else { 0.0 };
        Self { wanted: Wanted::new(wanted, 180.0), power: 2, quality_weight }
    }

    /// Where they are not. Cubes, so that the worse of two facets gains at the other's cost.
    pub(super) fn unmeasured() -> Self {
        Self { wanted: Wanted::new(UNMEASURED_SCORE, UNMEASURED_ANGLE), power: 3, quality_weight: QUALITY_WEIGHT }
    }

    pub(super) fn of(&self, corners: [DVec3; 3]) -> f64 {
        let quality = facet_quality(corners);
        (self.wanted.lack(corners, quality) / SCORE_SCALE).powi(self.power) + self.quality_weight * (1.0 - quality)
    }

    /// The cost of the facets around `v` with it at `p`, or of some of them as soon as that is not less than `most`. Infinite
    /// if a facet turns by more than this cosine.
    pub(super) fn around(&self, mesh: &LocalMesh, v: u32, p: DVec3, most: f64, least_cosine: f64) -> f64 {
        let mut cost = 0.0;
        for &f in mesh.ring(v) {
            let corners = mesh.corners_with(f, v, p);
            if mesh.is_turned(f, corners, least_cosine) {
                return f64::INFINITY;
            }
            cost += self.of(corners);
            if cost >= most {
                break;
            }
        }
        cost
    }
}

/// Points of a facet whose distances are taken, by their weights of the vertex and the two corners after it: four inside, then
/// three on the edge to the next corner, so that each edge at the vertex has its points once.
const SAMPLES: [[f64; 3]; 7] = [
    [2.0 / 3.0, 1.0 / 6.0, 1.0 / 6.0],
    [1.0 / 6.0, 2.0 / 3.0, 1.0 / 6.0],
    [1.0 / 6.0, 1.0 / 6.0, 2.0 / 3.0],
    [1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0],
    [0.75, 0.25, 0.0],
    [0.5, 0.5, 0.0],
    [0.25, 0.75, 0.0],
];

pub(super) struct VertexObjective<'a> {
    patch: &'a Patch,
    v: u32,
    /// The distance that costs 1.
    worst: f64,
    /// Where the vertex is, and the squared distance from the input there, once that is known.
    here: DVec3,
    own_squared: f64,
    /// Points of the input whose distance depends on the vertex.
    input_points: Vec<DependentPoint>,
    /// Groups of the input's facets that may be nearest to a point of the one-ring.
    near: Vec<u32>,
    /// Facets of the input that may be nearest to the vertex.
    nearest: Vec<u32>,
    /// The input's facet that was nearest to the vertex last.
    hint: u32,
    ring: Vec<RingFacet>,
    shape: ShapeCost,
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

struct RingFacet {
    /// Which corner the vertex is.
    corner: usize,
    /// The input's facets that were nearest last: to its inner points, and to those of the edge.
    hints: [u32; 2],
    /// Distances of [`SAMPLES`] from the input, or more, with the vertex where it is.
    known: [f64; 7],
}

impl<'a> VertexObjective<'a> {
    pub(super) fn new(patch: &'a Patch, v: u32, worst: f64, step: f64) -> Self {
        let mesh = &patch.mesh;
        let facets = mesh.ring(v);
        let enough = (FREE_SHARE * worst).powi(2);
        let p = mesh.positions[v as usize];
        let reach = facets.iter().flat_map(|&f| mesh.corners(f)).map(|q| q.distance(p)).fold(0.0, f64::max);
        // A point nearer than this costs nothing; nearer by a step, it does so wherever the vertex goes.
        let free = FREE_SHARE * worst * BOUND_ROUNDING;
        let free_after_step = (free - step).max(0.0).powi(2);
        let mut input_points = Vec::new();
        for (number, point) in patch.input_points.iter().enumerate() {
            if point.position.distance_squared(p) > (reach + step + worst).powi(2) {
                continue;
            }
            let row = patch.distances_of(number);
            let of = |f: u32| row[f as usize];
            let Some(&nearest) = facets.iter().min_by(|&&f, &&g| of(f).total_cmp(&of(g))) else { continue };
            if of(nearest) < free_after_step {
                continue;
            }
            // The closest point of the facet moves by the vertex's weight only.
            if of(nearest) < enough {
                let corner = mesh.facets()[nearest as usize].iter().position(|&u| u == v).unwrap_or_default();
                let (squared, weights) = closest_on_facet(point.position, mesh.corners(nearest), [0, 1, 2]);
                if squared.sqrt() + weights[corner] * step < free {
                    continue;
                }
            }
            let mut other_squared = point.outside_squared;
            for (&squared, f) in row.iter().zip(0..) {
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
        let of = |&facet: &u32| {
            let corner = mesh.facets()[facet as usize].iter().position(|&u| u == v).unwrap_or_default();
            RingFacet { corner, hints: [0; 2], known: [f64::INFINITY; 7] }
        };
        let ring = facets.iter().map(of).collect();
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
            shape: ShapeCost::measured(patch.shapes, patch.wanted_score),
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
        let (patch, mesh) = (self.patch, &self.patch.mesh);
        let mut cost = self.shape.around(mesh, self.v, p, most, MEASURED_COSINE);
        if cost >= most {
            return cost;
        }
        self.corners.clear();
        self.corners.extend(mesh.ring(self.v).iter().map(|&f| mesh.corners_with(f, self.v, p)));
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
        for (facet, corners) in self.ring.iter_mut().zip(&self.corners) {
            for (hint, samples) in facet.hints.iter_mut().zip([0..4, 4..7]) {
                let mut largest = 0.0f64;
                for k in samples {
                    if facet.known[k] + SAMPLES[k][0] * moved < free {
                        continue;
                    }
                    let place: DVec3 = (0..3).map(|c| SAMPLES[k][c] * corners[(facet.corner + c) % 3]).sum();
                    let squared = patch.input_facets.distance(place, &self.near, hint, enough);
                    if is_here {
                        facet.known[k] = squared.sqrt();
                    }
                    if squared >= enough {
                        largest = largest.max(squared);
                    }
                }
                cost += of_distance(largest);
            }
            if cost >= most {
                return cost;
            }
        }
        cost
    }
}
