//! Seams: on which side of a seam each corner of the result lies.
//!
//! Purpose: [`Seams::split`] takes values that the input's facets name corner by corner to the result's corners.
//! How: a seam is an edge whose two facets do not have the same values at its ends. Each result facet has an origin,
//! the input facet nearest to its centroid. From there we walk, best first and over no seam, towards each of
//! the result facet's corners; where a seam blocks the walk, the corner takes its value from the nearest facet on this side.
//! Result facets with a common edge, whose origins no seam separates, share their values at it.
//! Invariant: the walk keeps to the ball around its two ends, so that it cannot reach the other side of a seam by a
//! detour; each walk is its own, so that threads change nothing.
//! Must not know: what the values mean.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashSet};

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use super::Provenance;
use crate::mesh::TriMesh;
use crate::mesh::adjacency::{Adjacency, EdgeKind};
use crate::mesh::attributes::PerCorner;
use crate::mesh::closest_point::{ClosestPoint, closest_on_facet};
use crate::mesh::edges::DisjointSets;
use crate::remesh::constants::{LONG_SEAM_REACH, MAX_SEAM_FACETS, MOST_STRETCH, SEAM_END_REACH, SEAM_REACH};
use crate::tasks;

/// Where a corner of the result takes its value.
#[derive(Clone, Copy, Debug)]
pub(super) struct Source {
    pub(super) facet: u32,
    /// Of its point that is nearest to the corner.
    pub(super) barycentric: [f64; 3],
    vertex: u32,
    /// The input's facet where the walk began.
    origin: u32,
    /// Squared distance of that point from the corner, unit frame.
    squared: f64,
    /// Whether a seam separates the origin from the vertex.
    blocked: bool,
}

/// Two meshes, one remeshed from the other.
pub(super) struct Seams<'a> {
    mesh: &'a TriMesh,
    result: &'a TriMesh,
    provenance: &'a [Provenance],
    adjacency: Adjacency,
    /// Vertices of the input and of the result in a frame in which the input's box has side 1.
    unit: Vec<DVec3>,
    points: Vec<DVec3>,
    /// For each facet of the result the input's facet nearest to its centroid, and where.
    starts: Vec<(u32, DVec3)>,
}

impl<'a> Seams<'a> {
    pub(super) fn new(
        mesh: &'a TriMesh,
        closest: &ClosestPoint,
        result: &'a TriMesh,
        provenance: &'a [Provenance],
    ) -> Self {
        let (low, high) = mesh.bounds();
        let (centre, scale) = (low * 0.5 + high * 0.5, 1.0 / (high - low).max_element());
        let to_unit = |p: DVec3| (p - centre) * scale;
        let origin = |facet: usize| {
            let [a, b, c] = result.corners(facet);
            let third = 1.0 / 3.0;
            let point = closest.project(a * third + b * third + c * third);
            (point.facet, to_unit(point.position))
        };
        Self {
            mesh,
            result,
            provenance,
            adjacency: Adjacency::new(mesh),
            unit: mesh.positions().iter().map(|&p| to_unit(p)).collect(),
            points: result.positions().iter().map(|&p| to_unit(p)).collect(),
            starts: tasks::map(result.facets().len(), origin),
        }
    }

    /// The result's values, each made by `value` of where it comes from.
    pub(super) fn split<T, V>(&self, given: &PerCorner<T>, value: V) -> PerCorner<T>
    where
        T: Copy + PartialEq + Send + Sync,
        V: Fn(&Source) -> T + Send + Sync,
    {
        let open = self.open(given);
        let blocked = |h: usize| !open[h] && self.is_shared(h);
        if !tasks::any(open.len(), blocked) {
            let places = (0u32..).zip(self.provenance).map(|(vertex, p)| Source {
                facet: p.facet,
                barycentric: p.barycentric,
                vertex,
                origin: p.facet,
                squared: 0.0,
                blocked: false,
            });
            return PerCorner {
                values: places.collect::<Vec<_>>().par_iter().map(value).collect(),
                corners: self.result.facets().to_vec(),
            };
        }
        let facets = 0..self.result.facets().len();
        let places: Vec<[Source; 3]> =
            facets.into_par_iter().map_init(Walk::default, |walk, facet| self.places(facet, &open, walk)).collect();
        let places = places.as_flattened();
        let mut same = self.shared_corners(places, &open);
        // Of the corners that share a value, the one that no seam blocks, the nearest, the first decides.
        let mut chosen: Vec<usize> = (0..places.len()).collect();
        let rank = |corner: usize| (places[corner].blocked, places[corner].squared);
        for corner in 0..places.len() {
            let root = same.root(corner);
            if rank(corner) < rank(chosen[root]) {
                chosen[root] = corner;
            }
        }
        let mut numbers = vec![0; places.len()];
        let mut sources = Vec::new();
        for corner in 0..places.len() {
            // The root is the lowest of its corners, so its number is there.
            let root = same.root(corner);
            if root == corner {
                numbers[corner] = sources.len() as u32;
                sources.push(places[chosen[root]]);
            }
            numbers[corner] = numbers[root];
        }
        PerCorner { values: sources.par_iter().map(value).collect(), corners: numbers.as_chunks::<3>().0.to_vec() }
    }

    /// Texture coordinates at a place; beyond a seam, those of the facet's plane.
    pub(super) fn texture_at(&self, texture: &PerCorner<DVec2>, place: &Source) -> DVec2 {
        let uv = |facet: u32| texture.corners[facet as usize].map(|i| texture.values[i as usize]);
        let weighted = |[a, b, c]: [DVec2; 3], w: [f64; 3]| a * w[0] + b * w[1] + c * w[2];
        let here = uv(place.facet);
        let inside = weighted(here, place.barycentric);
        if !place.blocked {
            return inside;
        }
        let [a, b, c] = self.corners(place.facet);
        let normal = (b - a).cross(c - a);
        let norm = normal.length_squared();
        let ap = self.points[place.vertex as usize] - a;
        let (v, w) = (ap.cross(c - a).dot(normal) / norm, (b - a).cross(ap).dot(normal) / norm);
        let mut shift = weighted(here, [1.0 - v - w, v, w]) - inside;
        // A sliver's plane may run off in any direction: no farther than a few times the texture's own stretch there.
        let origin = (uv(place.origin), self.corners(place.origin));
        let longest = (0..3).map(|i| (i, (i + 1) % 3)).fold(0.0, |longest: f64, (i, j)| {
            let length = (origin.1[j] - origin.1[i]).length();
            if length > 0.0 { longest.max((origin.0[j] - origin.0[i]).length() / length) } else { longest }
        });
        let area = (here[1] - here[0]).perp_dot(here[2] - here[0]).abs() / norm.sqrt();
        let most = MOST_STRETCH * place.squared.sqrt() * longest.max(area.sqrt());
        let length = shift.length();
        if length > most {
            shift *= most / length;
        }
        if (inside + shift).is_finite() { inside + shift } else { inside }
    }

    fn corners(&self, facet: u32) -> [DVec3; 3] {
        self.mesh.facets()[facet as usize].map(|v| self.unit[v as usize])
    }

    /// Whether other facets lie across a half-edge.
    fn is_shared(&self, half_edge: usize) -> bool {
        matches!(self.adjacency.kind(half_edge), EdgeKind::Manifold | EdgeKind::Inconsistent | EdgeKind::NonManifold)
    }

    /// For each half-edge of the input, whether one facet lies across it that has the same values at both ends.
    fn open<T: Copy + PartialEq + Sync>(&self, given: &PerCorner<T>) -> Vec<bool> {
        let representative = self.adjacency.representative();
        let facets = self.mesh.facets();
        let value = |facet: usize, corner: usize| given.values[given.corners[facet][corner] as usize];
        let agrees = |half: usize| {
            let Some(opposite) = self.adjacency.opposite(half) else { return false };
            let (here, there) = (half / 3, opposite / 3);
            [half % 3, (half + 1) % 3].into_iter().all(|corner| {
                let vertex = representative[facets[here][corner] as usize];
                let across = facets[there].iter().position(|&v| representative[v as usize] == vertex);
                across.is_some_and(|across| value(here, corner) == value(there, across))
            })
        };
        tasks::map(3 * facets.len(), agrees)
    }

    /// Where the corners of a result facet take their values.
    fn places(&self, facet: usize, open: &[bool], walk: &mut Walk) -> [Source; 3] {
        let (origin, start) = self.starts[facet];
        self.result.facets()[facet].map(|vertex| {
            let goal = self.provenance[vertex as usize];
            let to = self.points[vertex as usize];
            let query = Query { origin, start, to, goal: goal.facet, goal_squared: self.nearest(to, goal.facet).0 };
            let found = walk.run(self, open, &query);
            // Neither reached nor blocked: the surface itself makes a detour.
            let (facet, barycentric, squared) = match found.reached || found.blocked {
                true => (found.facet, found.barycentric, found.squared),
                false => (goal.facet, goal.barycentric, query.goal_squared),
            };
            let barycentric = if facet == goal.facet { goal.barycentric } else { barycentric };
            Source { facet, barycentric, vertex, origin, squared, blocked: found.blocked && !found.reached }
        })
    }

    /// Squared distance from a facet, and where.
    fn nearest(&self, p: DVec3, facet: u32) -> (f64, [f64; 3]) {
        closest_on_facet(p, self.corners(facet), self.mesh.facets()[facet as usize])
    }

    /// Which corners of the result have one value.
    fn shared_corners(&self, places: &[Source], open: &[bool]) -> DisjointSets {
        let adjacency = Adjacency::new(self.result);
        let facets = self.result.facets();
        let pairs = |walk: &mut Walk, half: usize| {
            let opposite = adjacency.opposite(half).filter(|&o| o > half)?;
            let (here, there) = (half / 3, opposite / 3);
            let ends = [half % 3, (half + 1) % 3].map(|corner| {
                let across = facets[there].iter().position(|&v| v == facets[here][corner])?;
                Some((3 * here + corner, 3 * there + across))
            });
            let agree = |pair: &Option<(usize, usize)>| {
                pair.is_none_or(|(a, b)| places[a].facet == places[b].facet && places[a].blocked == places[b].blocked)
            };
            if ends.iter().all(agree) {
                return Some(ends);
            }
            let ((origin, start), (goal, to)) = (self.starts[here], self.starts[there]);
            let query = Query { origin, start, to, goal, goal_squared: 0.0 };
            let joined = origin == goal || walk.run(self, open, &query).reached;
            joined.then_some(ends)
        };
        let halves = 0..3 * facets.len();
        let joined: Vec<_> = halves.into_par_iter().map_init(Walk::default, pairs).collect();
        let mut same = DisjointSets::new(places.len());
        for (a, b) in joined.into_iter().flatten().flatten().flatten() {
            same.join(a, b);
        }
        same
    }
}

struct Query {
    origin: u32,
    start: DVec3,
    to: DVec3,
    /// The facet that is nearest to the end of all, and its squared distance.
    goal: u32,
    goal_squared: f64,
}

struct Reached {
    /// The nearest facet of the walk, and where.
    facet: u32,
    barycentric: [f64; 3],
    squared: f64,
    /// Whether it is as near as any.
    reached: bool,
    blocked: bool,
}

/// What a walk needs, kept for the next.
#[derive(Default)]
struct Walk {
    seen: HashSet<u32>,
    /// The nearest first: squared distance, whose bits are ordered as it is not negative, and facet.
    next: BinaryHeap<Reverse<(u64, u32)>>,
}

impl Walk {
    fn run(&mut self, seams: &Seams<'_>, open: &[bool], query: &Query) -> Reached {
        let found = self.within(SEAM_REACH, seams, open, query);
        if found.reached || found.blocked { found } else { self.within(LONG_SEAM_REACH, seams, open, query) }
    }

    fn within(&mut self, reach: f64, seams: &Seams<'_>, open: &[bool], query: &Query) -> Reached {
        let length = (query.to - query.start).length();
        let middle = query.start * 0.5 + query.to * 0.5;
        let off = query.goal_squared.sqrt();
        let ball = (0.5 * reach * length + off).powi(2);
        let tolerance = (off + SEAM_END_REACH * length).powi(2);
        self.seen.clear();
        self.next.clear();
        self.seen.insert(query.origin);
        let (squared, barycentric) = seams.nearest(query.to, query.origin);
        let mut found =
            Reached { facet: query.origin, barycentric, squared, reached: squared <= tolerance, blocked: false };
        self.next.push(Reverse((squared.to_bits(), query.origin)));
        while let Some(Reverse((bits, facet))) = self.next.pop() {
            let squared = f64::from_bits(bits);
            if found.reached && squared > tolerance || self.seen.len() > MAX_SEAM_FACETS {
                break;
            }
            if squared < found.squared || facet == query.goal {
                let barycentric = seams.nearest(query.to, facet).1;
                found = Reached { facet, barycentric, squared, reached: squared <= tolerance, ..found };
            }
            if facet == query.goal {
                found.reached = true;
                break;
            }
            for half in [0, 1, 2].map(|edge| 3 * facet as usize + edge) {
                if !open[half] {
                    found.blocked |= seams.is_shared(half);
                    continue;
                }
                let Some(opposite) = seams.adjacency.opposite(half) else { continue };
                let next = (opposite / 3) as u32;
                if self.seen.insert(next) && seams.nearest(middle, next).0 <= ball {
                    self.next.push(Reverse((seams.nearest(query.to, next).0.to_bits(), next)));
                }
            }
        }
        found
    }
}
