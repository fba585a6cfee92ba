//! A patch: a small part of a result, to be changed on its own.
//!
//! Purpose: [`Patch`] is a vertex with its one-ring, those of its neighbours, and the input there. It has their distance.
//! Invariant: facets outside stay, and the result is as it was until the patch is put back. The same bits on any threads.
//! Must not know: which patches there are, seeds, diagrams.

use std::sync::Arc;

use glam::DVec3;

use super::{Context, Steps};
use crate::mesh::csr::ascending;
use crate::mesh::facet_set::{FacetSet, sample_points, squared_distance};
use crate::remesh::constants::*;
use crate::remesh::manifold::{Flip, LocalMesh};
use crate::remesh::triangle::{Shapes, perimeter, score, unit_normal};
use crate::token::Token;

/// Vertices and facets have local numbers.
#[derive(Clone)]
pub(super) struct Patch {
    pub(super) mesh: LocalMesh,
    /// Numbers in the result, ascending.
    pub(super) vertices: Vec<u32>,
    pub(super) facet_ids: Vec<u32>,
    /// Positions at the beginning.
    pub(super) start: Vec<DVec3>,
    /// Vertices that have all their facets inside and may move.
    pub(super) movable: Vec<u32>,
    pub(super) shapes: Shapes,
    /// The score from which on facets cost nothing.
    pub(super) wanted_score: f64,
    pub(super) steps: Steps,
    pub(super) centre: u32,
    pub(super) mean_edge: f64,
    /// Distance of the two surfaces at the beginning.
    pub(super) start_distance: PatchDistance,
    pub(super) input_points: Vec<InputPoint>,
    /// Squared distance of input point `p` from facet `f` at `p * facets + f`.
    squared_distances: Vec<f64>,
    /// Facets of the input. Clones share them.
    pub(super) input_facets: Arc<FacetSet>,
    pub(super) token: Token,
}

#[derive(Clone, Copy)]
pub(super) struct InputPoint {
    pub(super) position: DVec3,
    /// The vertex whose cell holds it.
    owner: u32,
    /// Squared distance to the owner's facets outside of the patch.
    pub(super) outside_squared: f64,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct PatchDistance {
    /// In and around the cell of its centre.
    pub(super) centre: f64,
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
        let whole = context.mesh;
        let inner = whole.neighbours(centre);
        let facet_ids = whole.facets_around(&inner);
        if facet_ids.len() > MAX_FACETS {
            return None;
        }
        let vertices = whole.corners_around(&inner);
        let mesh = whole.part(&facet_ids, &vertices);
        let may_move = |&(k, v): &(u32, u32)| context.movable[v as usize] && mesh.is_inside(k) && inner.contains(&v);
        let movable = (0..).zip(vertices.iter().copied()).filter(may_move).map(|(k, _)| k);
        let centre = vertices.binary_search(&centre).unwrap_or_default() as u32;
        let mut movable: Vec<u32> = movable.collect();
        // The centre moves first.
        movable.sort_by_key(|&v| (v != centre, v));
        let edges: f64 = (0..facet_ids.len() as u32).map(|f| perimeter(mesh.corners(f))).sum();
        let mut patch = Self {
            movable,
            shapes: context.shapes,
            wanted_score: context.shapes.least_score() + SCORE_MARGIN,
            steps: Steps::new(vertices.len()),
            centre,
            mean_edge: edges / (3 * facet_ids.len()) as f64,
            start: mesh.positions.clone(),
            start_distance: PatchDistance { centre: f64::INFINITY, rest: f64::INFINITY, farthest_point: None },
            mesh,
            facet_ids,
            input_points: Vec::new(),
            squared_distances: Vec::new(),
            input_facets: Arc::new(FacetSet::new(std::iter::empty())),
            token: context.token.clone(),
            vertices,
        };
        patch.take_input(context);
        Some(patch)
    }

    fn take_input(&mut self, context: &Context<'_>) {
        let reference = context.reference;
        let facets = ascending(self.vertices.iter().flat_map(|&v| reference.facets.of(v)).copied());
        self.input_facets = Arc::new(FacetSet::new(facets.iter().map(|&f| reference.corners(f))));
        let mut points: Vec<(DVec3, u32)> = Vec::new();
        for (&v, owner) in self.vertices.iter().zip(0..) {
            points.extend(reference.vertices.of(v).iter().map(|&p| (p, owner)));
        }
        if points.len() > DENSE_INPUT * self.vertices.len() {
            thin_out(&mut points, CUBE_OF_POINTS * self.mean_edge, |(p, owner)| {
                let from = |&f: &u32| squared_distance(p, self.mesh.corners(f));
                self.mesh.ring(owner).iter().map(from).fold(f64::INFINITY, f64::min)
            });
        }
        self.add_edge_midpoints(&mut points);
        for (position, owner) in points {
            let ring = context.mesh.ring(self.vertices[owner as usize]).iter();
            let outer = ring.filter(|f| self.facet_ids.binary_search(f).is_err());
            let outer = outer.map(|&f| squared_distance(position, context.mesh.corners(f)));
            let outside_squared = outer.fold(f64::INFINITY, f64::min);
            self.input_points.push(InputPoint { position, owner, outside_squared });
        }
        self.squared_distances = vec![0.0; self.input_points.len() * self.facet_ids.len()];
        (0..self.facet_ids.len() as u32).for_each(|f| self.update_distances(f));
        self.start_distance = self.distance();
    }

    /// Adds midpoints of the input's longer edges, each with the nearest vertex that has a facet on the same side of the
    /// surface. Across a sharp crease or a thin sheet, vertices of the other side may be as near, and are left out.
    fn add_edge_midpoints(&self, points: &mut Vec<(DVec3, u32)>) {
        let mut midpoints = Vec::new();
        // Long facets end far from the patch, where none of its vertices takes a midpoint.
        let middle = self.mesh.positions.iter().sum::<DVec3>() / self.mesh.positions.len() as f64;
        let radius = self.mesh.positions.iter().map(|p| p.distance(middle)).fold(0.0, f64::max);
        let reach = (radius + MIDPOINT_REACH * self.mean_edge) * (1.0 + 1e-9);
        for [a, b, c] in self.input_facets.corners() {
            let normal = unit_normal([a, b, c]);
            for (p, q) in [(a, b), (b, c), (c, a)] {
                if p.distance(q) > LONG_EDGE * self.mean_edge && middle.distance((p + q) / 2.0) < reach {
                    midpoints.push(((p + q) / 2.0, normal));
                }
            }
        }
        midpoints.sort_by(|(p, _), (q, _)| p.x.total_cmp(&q.x).then(p.y.total_cmp(&q.y)).then(p.z.total_cmp(&q.z)));
        // The two facets of an edge give the same midpoint: addition does not depend on the order of the ends.
        for same in midpoints.chunk_by(|a, b| a.0 == b.0) {
            let (p, normal) = (same[0].0, same.iter().map(|m| m.1).sum::<DVec3>());
            let to = |v: u32| self.mesh.positions[v as usize].distance_squared(p);
            let faces = |&v: &u32| self.mesh.ring(v).iter().any(|&f| self.mesh.marked_normal(f).dot(normal) >= 0.0);
            let nearest = (0..self.vertices.len() as u32).filter(faces).min_by(|&u, &v| to(u).total_cmp(&to(v)));
            points.extend(nearest.filter(|&v| to(v) < (MIDPOINT_REACH * self.mean_edge).powi(2)).map(|v| (p, v)));
        }
    }

    /// Distances of the input points from facet `f`; infinite for points that are surely too far to matter.
    fn update_distances(&mut self, f: u32) {
        let corners = self.mesh.corners(f);
        let centroid = (corners[0] + corners[1] + corners[2]) / 3.0;
        let radius = corners.iter().map(|c| c.distance_squared(centroid)).fold(0.0, f64::max).sqrt();
        let reach = radius + 2.0 * self.start_distance.largest();
        let facets = self.facet_ids.len();
        for (point, row) in self.input_points.iter().zip(self.squared_distances.chunks_mut(facets)) {
            let close = point.position.distance_squared(centroid) <= reach * reach;
            row[f as usize] = if close { squared_distance(point.position, corners) } else { f64::INFINITY };
        }
    }

    /// Squared distances of an input point from all facets.
    pub(super) fn distances_of(&self, point: usize) -> &[f64] {
        let facets = self.facet_ids.len();
        &self.squared_distances[point * facets..(point + 1) * facets]
    }

    pub(super) fn worst_score(&self) -> f64 {
        let [centre, rest] = self.worst_scores();
        centre.min(rest)
    }

    /// The least score around the centre, and elsewhere.
    pub(super) fn worst_scores(&self) -> [f64; 2] {
        let mut worst = [f64::INFINITY; 2];
        for (f, t) in (0..).zip(self.mesh.facets()) {
            let side = &mut worst[usize::from(!t.contains(&self.centre))];
            *side = side.min(score(self.mesh.corners(f)));
        }
        worst
    }

    /// The least cosine between the normals of two neighbours, or [`SHARPEST_COSINE`] if all are above that.
    pub(super) fn sharpest_cosine(&self) -> f64 {
        let mesh = &self.mesh;
        let normals: Vec<DVec3> = (0..self.facet_ids.len() as u32).map(|f| unit_normal(mesh.corners(f))).collect();
        let mut least = SHARPEST_COSINE;
        for (f, t) in (0..).zip(mesh.facets()) {
            for e in 0..3 {
                let is_neighbour = |g: &&u32| **g < f && mesh.facets()[**g as usize].contains(&t[(e + 1) % 3]);
                let cosine = |&g: &u32| normals[f as usize].dot(normals[g as usize]);
                least = mesh.ring(t[e]).iter().filter(is_neighbour).map(cosine).fold(least, f64::min);
            }
        }
        least
    }

    /// Groups of the input's facets that may be nearest to something within `reach` of `p`.
    pub(super) fn input_near(&self, p: DVec3, reach: f64) -> Vec<u32> {
        self.input_facets.groups_near(p, reach + 2.0 * self.start_distance.largest())
    }

    /// How far it is from the input, in both directions.
    pub(super) fn distance(&self) -> PatchDistance {
        // Squared: at the centre, and elsewhere.
        let (mut squared, mut farthest_point) = ([0.0f64; 2], None);
        for (k, point) in self.input_points.iter().enumerate() {
            let distance = self.distances_of(k).iter().copied().fold(point.outside_squared, f64::min);
            let side = &mut squared[usize::from(point.owner != self.centre)];
            if distance > *side {
                *side = distance;
                farthest_point = if point.owner == self.centre { Some(point.position) } else { farthest_point };
            }
        }
        let of_points = squared[0];
        for (f, t) in (0..).zip(self.mesh.facets()) {
            let [a, b, c] = self.mesh.corners(f);
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
        (0..).zip(&self.vertices).filter(|(k, _)| self.mesh.is_inside(*k)).map(|(_, &v)| v)
    }

    /// Flips of the edges of the centre's facets, each once, that are allowed with such valences.
    pub(super) fn flips(&self, valences: [usize; 2]) -> Vec<Flip> {
        let all = self.mesh.ring(self.centre).iter().flat_map(|&f| (0..3).map(move |side| (f, side)));
        let edges = all.filter(|&(f, side)| self.mesh.facets()[f as usize][side] != self.centre);
        edges.filter_map(|(f, side)| self.mesh.flip(f, side, valences)).collect()
    }

    pub(super) fn flip(&mut self, flip: &Flip) {
        self.mesh.apply(flip);
        flip.facets.into_iter().for_each(|f| self.update_distances(f));
    }

    pub(super) fn put(&mut self, v: u32, p: DVec3) {
        self.mesh.positions[v as usize] = p;
        for k in 0..self.mesh.ring(v).len() {
            self.update_distances(self.mesh.ring(v)[k]);
        }
    }

    /// Puts the movable vertex nearest to `p` there, whatever the shapes. Returns whether it did: no facet turns over.
    pub(super) fn jump(&mut self, p: DVec3) -> bool {
        let squared = |v: u32| self.mesh.positions[v as usize].distance_squared(p);
        let nearest = self.movable.iter().copied().min_by(|&a, &b| squared(a).total_cmp(&squared(b)).then(a.cmp(&b)));
        let Some(v) = nearest.filter(|&v| squared(v).sqrt() < FARTHEST_MOVE * self.mean_edge) else { return false };
        let turns = self.mesh.turns(v, p, MEASURED_COSINE);
        if !turns {
            self.put(v, p);
        }
        !turns
    }
}

/// Keeps of the points of each owner one in each cube with such sides: that of the largest distance, and the first of several.
fn thin_out(points: &mut Vec<(DVec3, u32)>, side: f64, distance: impl Fn((DVec3, u32)) -> f64) {
    let keyed = |k: usize| {
        let (p, owner) = points[k];
        ((owner, (p / side).floor().to_array().map(|x| x as i64)), distance(points[k]), k)
    };
    let mut keyed: Vec<_> = (0..points.len()).map(keyed).collect();
    keyed.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(b.1.total_cmp(&a.1)).then(a.2.cmp(&b.2)));
    keyed.dedup_by_key(|of| of.0);
    *points = keyed.iter().map(|of| points[of.2]).collect();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_points_in_a_cube_the_farthest_of_each_owner_stays() {
        let at = |x: f64, y: f64, owner: u32| (DVec3::new(x, y, 0.0), owner);
        let mut points =
            vec![at(0.1, 0.3, 0), at(0.2, 0.5, 0), at(0.3, 0.5, 0), at(0.4, 0.1, 1), at(1.1, 0.0, 0), at(-0.1, 0.2, 0)];
        thin_out(&mut points, 1.0, |(p, _)| p.y);
        assert_eq!(points, [at(-0.1, 0.2, 0), at(0.2, 0.5, 0), at(1.1, 0.0, 0), at(0.4, 0.1, 1)]);
    }
}
