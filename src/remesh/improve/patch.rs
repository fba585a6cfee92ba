//! A local mesh: a small part of a result, to be changed on its own.
//!
//! Purpose: [`Patch`] is a vertex with its one-ring and the one-rings of its neighbours, and the input there. Its operators are
//! in [`super::operators`] and [`super::relocation`].
//! Invariant: facets outside stay as they are, and nothing changes in the result before the patch is put back. The same bits
//! whatever the number of threads.
//! Must not know: which patches there are, seeds, diagrams.

use std::sync::Arc;

use glam::DVec3;

use super::context::Context;
use crate::remesh::distance::facet_set::{FacetSet, sample_points, squared_distance};
use crate::remesh::triangle::{score, unit_normal};
use crate::token::Token;

/// The score that facets of a patch are to have, degrees.
pub(super) const LEAST_SCORE: f64 = 34.3;
/// The cosine at which neighbouring facets may meet in any case; the input may have such edges.
const SHARPEST_COSINE: f64 = -0.75;
/// The midpoint of an edge of the input is a point to compare with if the edge is longer than this share of the mean edge,
const LONG_EDGE: f64 = 0.3;
/// and if a vertex of the patch is within this share of it.
const MIDPOINT_REACH: f64 = 0.65;
/// Facets of a patch, at most. The memory of a patch grows with their square, and each trial copies it. Vertices with seven
/// neighbours have patches of sixty facets.
const MAX_FACETS: usize = 512;

/// See the module's head. Vertices and facets have local numbers.
#[derive(Clone)]
pub(super) struct Patch {
    /// Numbers in the result, ascending.
    pub(super) vertices: Vec<u32>,
    pub(super) facet_ids: Vec<u32>,
    pub(super) facets: Vec<[usize; 3]>,
    pub(super) positions: Vec<DVec3>,
    /// Positions at the beginning.
    pub(super) start: Vec<DVec3>,
    /// Unit normals at the beginning, or after the last flip of the facet.
    pub(super) normals: Vec<DVec3>,
    /// Facets of the patch around each vertex.
    pub(super) rings: Vec<Vec<usize>>,
    /// How many facets are around each vertex outside of the patch.
    pub(super) outside: Vec<usize>,
    /// Whether a vertex has all its facets inside and may move.
    pub(super) movable: Vec<bool>,
    /// How often the step of each vertex was halved.
    pub(super) halvings: Vec<i32>,
    pub(super) on_boundary: Vec<bool>,
    /// Edges that stay, lower end first.
    pub(super) curve_edges: Vec<[usize; 2]>,
    /// The vertex around which the patch is.
    pub(super) centre: usize,
    pub(super) mean_edge: f64,
    /// Distance of the two surfaces at the beginning.
    pub(super) start_distance: f64,
    /// Points of the input to compare with.
    pub(super) input_points: Vec<InputPoint>,
    /// Squared distance of input point `p` from facet `f` at `p * facets + f`.
    pub(super) squared_distances: Vec<f64>,
    /// Facets of the input. Clones share them.
    pub(super) input_facets: Arc<FacetSet>,
    pub(super) token: Token,
}

/// A point of the input, and what is known of it.
#[derive(Clone, Copy)]
pub(super) struct InputPoint {
    pub(super) position: DVec3,
    /// The vertex whose cell holds it.
    pub(super) owner: usize,
    /// Squared distance to the owner's facets outside of the patch.
    pub(super) outside_squared: f64,
}

/// How far a patch is from the input.
#[derive(Clone, Copy, Debug)]
pub(super) struct PatchDistance {
    /// In and around the cell of its centre.
    pub(super) centre: f64,
    /// Elsewhere.
    pub(super) rest: f64,
    /// The input point of the centre's cell that is farthest from the patch, if nothing there is farther.
    pub(super) farthest_point: Option<DVec3>,
}

impl PatchDistance {
    pub(super) fn largest(&self) -> f64 {
        self.centre.max(self.rest)
    }
}

impl Patch {
    /// The patch around `centre`. `None` if that has more than [`MAX_FACETS`], as around a vertex of thousands of facets.
    pub(super) fn around(context: &Context<'_>, centre: u32) -> Option<Self> {
        let ring = |v: u32| context.rings.of(v).iter().copied();
        let mut inner: Vec<u32> = ring(centre).flat_map(|f| context.facets[f as usize]).collect();
        inner.sort_unstable();
        inner.dedup();
        let mut facet_ids: Vec<u32> = inner.iter().flat_map(|&v| ring(v)).collect();
        facet_ids.sort_unstable();
        facet_ids.dedup();
        if facet_ids.len() > MAX_FACETS {
            return None;
        }
        let mut vertices: Vec<u32> = facet_ids.iter().flat_map(|&f| context.facets[f as usize]).collect();
        vertices.sort_unstable();
        vertices.dedup();
        let local = |v: u32| vertices.binary_search(&v).unwrap_or(0);
        let facets: Vec<[usize; 3]> = facet_ids.iter().map(|&f| context.facets[f as usize].map(local)).collect();
        let positions: Vec<DVec3> = vertices.iter().map(|&v| context.positions[v as usize]).collect();
        let mut rings = vec![Vec::new(); vertices.len()];
        facets.iter().enumerate().for_each(|(f, t)| t.iter().for_each(|&v| rings[v].push(f)));
        let outside: Vec<usize> =
            vertices.iter().zip(&rings).map(|(&v, inside)| context.rings.of(v).len() - inside.len()).collect();
        let mut curve_edges = Vec::new();
        let mut edges = 0.0;
        for t in &facets {
            for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                edges += positions[a].distance(positions[b]);
                let (low, high) = (a.min(b), a.max(b));
                if context.curves.contains(&[vertices[low], vertices[high]]) {
                    curve_edges.push([low, high]);
                }
            }
        }
        let movable = |(k, &v): (usize, &u32)| context.movable[v as usize] && outside[k] == 0 && inner.contains(&v);
        let mut patch = Self {
            movable: vertices.iter().enumerate().map(movable).collect(),
            on_boundary: vertices.iter().map(|&v| context.on_boundary[v as usize]).collect(),
            normals: facets.iter().map(|t| unit_normal(t.map(|v| positions[v]))).collect(),
            centre: local(centre),
            mean_edge: edges / (3 * facets.len()) as f64,
            start: positions.clone(),
            halvings: vec![0; positions.len()],
            start_distance: f64::INFINITY,
            facet_ids,
            facets,
            positions,
            rings,
            outside,
            curve_edges,
            input_points: Vec::new(),
            squared_distances: Vec::new(),
            input_facets: Arc::new(FacetSet::new(std::iter::empty())),
            token: context.token.clone(),
            vertices,
        };
        patch.take_input(context);
        Some(patch)
    }

    /// Takes in the input of the patch's cells.
    fn take_input(&mut self, context: &Context<'_>) {
        let reference = context.reference;
        let mut facets: Vec<u32> = self.vertices.iter().flat_map(|&v| reference.facets(v)).copied().collect();
        facets.sort_unstable();
        facets.dedup();
        self.input_facets = Arc::new(FacetSet::new(facets.iter().map(|&f| reference.corners(f))));
        let mut points: Vec<(DVec3, usize)> = Vec::new();
        for (owner, &v) in self.vertices.iter().enumerate() {
            points.extend(reference.vertices(v).iter().map(|&p| (p, owner)));
        }
        self.add_edge_midpoints(&mut points);
        for (position, owner) in points {
            let v = self.vertices[owner];
            let outer = context.rings.of(v).iter().filter(|f| self.facet_ids.binary_search(f).is_err());
            let corners = |f: &u32| context.facets[*f as usize].map(|u| context.positions[u as usize]);
            let outer = outer.map(|f| squared_distance(position, corners(f)));
            let outside_squared = outer.fold(f64::INFINITY, f64::min);
            self.input_points.push(InputPoint { position, owner, outside_squared });
        }
        self.squared_distances = vec![0.0; self.input_points.len() * self.facets.len()];
        (0..self.facets.len()).for_each(|f| self.update_distances(f));
        self.start_distance = self.distance().largest();
    }

    /// Adds midpoints of the input's longer edges, each with the nearest vertex that has a facet on the same side of the
    /// surface. Across a sharp crease or a thin sheet, vertices of the other side may be as near, and are left out.
    fn add_edge_midpoints(&self, points: &mut Vec<(DVec3, usize)>) {
        let mut midpoints = Vec::new();
        for [a, b, c] in self.input_facets.corners() {
            let normal = unit_normal([a, b, c]);
            for (p, q) in [(a, b), (b, c), (c, a)] {
                if p.distance(q) > LONG_EDGE * self.mean_edge {
                    midpoints.push(((p + q) / 2.0, normal));
                }
            }
        }
        midpoints.sort_by(|(p, _), (q, _)| p.x.total_cmp(&q.x).then(p.y.total_cmp(&q.y)).then(p.z.total_cmp(&q.z)));
        // The two facets of an edge give the same midpoint: addition does not depend on the order of the ends.
        for same in midpoints.chunk_by(|a, b| a.0 == b.0) {
            let (p, normal) = (same[0].0, same.iter().map(|m| m.1).sum::<DVec3>());
            let to = |v: usize| self.positions[v].distance_squared(p);
            let faces = |&v: &usize| self.rings[v].iter().any(|&f| self.normals[f].dot(normal) >= 0.0);
            let nearest = (0..self.positions.len()).filter(faces).min_by(|&u, &v| to(u).total_cmp(&to(v)));
            points.extend(nearest.filter(|&v| to(v) < (MIDPOINT_REACH * self.mean_edge).powi(2)).map(|v| (p, v)));
        }
    }

    /// Distances of the input points from facet `f`; infinite for points that are surely too far to matter.
    pub(super) fn update_distances(&mut self, f: usize) {
        let corners = self.corners(f);
        let centroid = (corners[0] + corners[1] + corners[2]) / 3.0;
        let radius = corners.iter().map(|c| c.distance_squared(centroid)).fold(0.0, f64::max).sqrt();
        let reach = radius + 2.0 * self.start_distance;
        for (k, point) in self.input_points.iter().enumerate() {
            let close = point.position.distance_squared(centroid) <= reach * reach;
            self.squared_distances[k * self.facets.len() + f] =
                if close { squared_distance(point.position, corners) } else { f64::INFINITY };
        }
    }

    pub(super) fn corners(&self, f: usize) -> [DVec3; 3] {
        self.facets[f].map(|v| self.positions[v])
    }

    pub(super) fn valence(&self, v: usize) -> usize {
        self.rings[v].len() + self.outside[v]
    }

    /// The least score of its facets.
    pub(super) fn worst_score(&self) -> f64 {
        (0..self.facets.len()).map(|f| score(self.corners(f))).fold(f64::INFINITY, f64::min)
    }

    /// The least cosine between the normals of two neighbours, or [`SHARPEST_COSINE`] if all are above that.
    pub(super) fn sharpest_cosine(&self) -> f64 {
        let mut least = SHARPEST_COSINE;
        for (f, t) in self.facets.iter().enumerate() {
            for e in 0..3 {
                let (a, b) = (t[e], t[(e + 1) % 3]);
                let neighbours = self.rings[a].iter().filter(|&&g| g < f && self.facets[g].contains(&b));
                let n = unit_normal(self.corners(f));
                least = neighbours.map(|&g| n.dot(unit_normal(self.corners(g)))).fold(least, f64::min);
            }
        }
        least
    }

    /// Groups of the input's facets that may be nearest to something within `reach` of `p`.
    pub(super) fn input_near(&self, p: DVec3, reach: f64) -> Vec<u32> {
        self.input_facets.groups_near(p, reach + 2.0 * self.start_distance)
    }

    /// Squared distance of an input point from the result.
    fn point_distance(&self, k: usize) -> f64 {
        let row = &self.squared_distances[k * self.facets.len()..(k + 1) * self.facets.len()];
        row.iter().copied().fold(self.input_points[k].outside_squared, f64::min)
    }

    /// How far it is from the input, in both directions.
    pub(super) fn distance(&self) -> PatchDistance {
        // Squared: at the centre, and elsewhere.
        let (mut squared, mut farthest_point) = ([0.0f64; 2], None);
        for (k, point) in self.input_points.iter().enumerate() {
            let distance = self.point_distance(k);
            let side = &mut squared[usize::from(point.owner != self.centre)];
            if distance > *side {
                *side = distance;
                farthest_point = if point.owner == self.centre { Some(point.position) } else { farthest_point };
            }
        }
        let of_points = squared[0];
        for (f, t) in self.facets.iter().enumerate() {
            let [a, b, c] = self.corners(f);
            let centroid = (a + b + c) / 3.0;
            let radius = [a, b, c].map(|p| p.distance(centroid)).into_iter().fold(0.0, f64::max);
            let near = self.input_near(centroid, radius);
            let side = &mut squared[usize::from(!t.contains(&self.centre))];
            let mut hint = 0;
            // Less than the largest so far need not be known exactly.
            sample_points([a, b, c])
                .for_each(|p| *side = side.max(self.input_facets.distance(p, &near, &mut hint, *side)));
        }
        let [centre, rest] = squared.map(f64::sqrt);
        PatchDistance { centre, rest, farthest_point: farthest_point.filter(|_| of_points == squared[0]) }
    }

    /// Vertices of the result that have all their facets in it.
    pub(super) fn inner(&self) -> impl Iterator<Item = u32> + '_ {
        (0..self.vertices.len()).filter(|&v| self.outside[v] == 0).map(|v| self.vertices[v])
    }
}
