//! Patches that one plane shows without overlaps.
//!
//! Purpose: [`triangulated`] gives the constrained Delaunay triangulation of a patch's curves and of the vertices within it. A dual has an
//! edge of a curve only where both ends have neighbouring cells, and a cell of another curve may lie between. The triangulation has all.
//! Invariant: the result has the edges of the curves and no others as its boundary, and no facet is turned over in the plane.
//! Must not know: why a patch needs it, how its neighbours are made.

use std::collections::hash_map::Entry;
use std::collections::{HashMap, HashSet};

use glam::{DVec2, DVec3};
use spade::handles::{FaceHandle, InnerTag};
use spade::{CdtEdge, ConstrainedDelaunayTriangulation, Point2, PositionInTriangulation, Triangulation};

use super::Simplified;
use crate::mesh::closest_point::closest_on_facet;
use crate::mesh::edges::{sides, undirected};
use crate::remesh::features::Chain;
use crate::remesh::triangle::unit_normal;

/// Normals of a patch are within this of their mean, cosine: lengths in the plane are within a tenth of those on the patch.
const FLAT: f64 = 0.9;
/// A vertex this near to an edge of a curve would have a needle for a facet, share of the edge's length.
const NEAREST: f64 = 0.2;
/// Rounds in which vertices that were too near go where facets are largest.
const ROUNDS: usize = 8;

type Plane = ConstrainedDelaunayTriangulation<Point2<f64>>;

/// A patch of `facets` between `chains`, whose seeds are `at` their places, with the vertices `within` it. One that is too near to a curve,
/// or beyond it, moves to where facets are largest. `None` if the patch is not flat, or if curves cross each other in the plane.
pub(super) fn triangulated(
    facets: &[[DVec3; 3]],
    chains: &[&Chain],
    at: impl Fn(u32) -> DVec3,
    within: &[(u32, DVec3)],
) -> Option<Simplified> {
    let normal: DVec3 = facets.iter().map(|[a, b, c]| (*b - *a).cross(*c - *a)).sum();
    let normal = normal.try_normalize()?;
    // A facet without an area has no normal.
    if facets.iter().map(|&t| unit_normal(t)).any(|own| own != DVec3::ZERO && own.dot(normal) < FLAT) {
        return None;
    }
    let (x, y) = normal.any_orthonormal_pair();
    let origin = at(*chains.first()?.seeds.first()?);
    let flat = |p: DVec3| DVec2::new((p - origin).dot(x), (p - origin).dot(y));
    let outline = Outline::of(chains, |seed| flat(at(seed)))?;
    let mut plane = outline.plane.clone();
    let mut vertices: Vec<(u32, DVec3)> = outline.seeds.iter().map(|&seed| (seed, at(seed))).collect();
    let mut insert = |plane: &mut Plane, own: (u32, DVec3)| {
        let p = flat(own.1);
        let is_new =
            outline.has_room(p) && plane.insert(Point2::new(p.x, p.y)).is_ok_and(|v| v.index() == vertices.len());
        vertices.extend(is_new.then_some(own));
        is_new
    };
    let mut left: Vec<u32> = Vec::new();
    for &own in within {
        if !insert(&mut plane, own) {
            left.push(own.0);
        }
    }
    for _ in 0..ROUNDS {
        if left.is_empty() {
            break;
        }
        let mut touched: HashSet<u32> = HashSet::new();
        let mut largest = outline.inside(&plane);
        largest.sort_by(|a, b| b.squared_radius.total_cmp(&a.squared_radius).then(a.corners.cmp(&b.corners)));
        for Face { center, corners: t, .. } in largest {
            let Some(&seed) = left.last() else { break };
            if t.iter().any(|v| touched.contains(v)) {
                continue;
            }
            let place = origin + center.x * x + center.y * y;
            let on = |t: &[DVec3; 3]| (closest_on_facet(place, *t, [0, 1, 2]), *t);
            let nearest = facets.iter().map(on).min_by(|(a, _), (b, _)| a.0.total_cmp(&b.0));
            let on_patch = nearest.map(|((_, [a, b, c]), t)| a * t[0] + b * t[1] + c * t[2]);
            if on_patch.is_some_and(|place| insert(&mut plane, (seed, place))) {
                left.pop();
                touched.extend(t);
            }
        }
        if touched.is_empty() {
            break;
        }
    }
    let own: Vec<[u32; 3]> = outline.inside(&plane).into_iter().map(|face| face.corners).collect();
    // Curves that do not close leave no inside.
    let mut is_open: HashSet<[u32; 2]> = HashSet::new();
    for side in own.iter().flat_map(|&t| sides(t)).map(undirected) {
        if !is_open.remove(&side) {
            is_open.insert(side);
        }
    }
    if is_open != outline.rim {
        return None;
    }
    (!own.is_empty()).then_some((vertices, own))
}

/// A facet counterclockwise, its number in the triangulation, and its circumcircle.
struct Face {
    number: usize,
    corners: [u32; 3],
    center: DVec2,
    squared_radius: f64,
}

/// The curves of a patch in its plane.
struct Outline {
    /// Its first vertices are the seeds.
    plane: Plane,
    seeds: Vec<u32>,
    edges: Vec<[DVec2; 2]>,
    /// The patch is on one side of these.
    rim: HashSet<[u32; 2]>,
    /// For each face of the plane, the outer one included, whether it is of the patch.
    is_inside: Vec<bool>,
}

impl Outline {
    /// `None` if seeds have the same place, or an edge crosses another one or a seed.
    fn of(chains: &[&Chain], at: impl Fn(u32) -> DVec2) -> Option<Self> {
        let mut plane = Plane::new();
        let mut seeds = Vec::new();
        let mut vertex = HashMap::new();
        for &seed in chains.iter().flat_map(|chain| &chain.seeds) {
            if let Entry::Vacant(entry) = vertex.entry(seed) {
                let p = at(seed);
                let own = plane.insert(Point2::new(p.x, p.y)).ok().filter(|own| own.index() == seeds.len())?;
                entry.insert(own);
                seeds.push(seed);
            }
        }
        let (mut rim, mut edges) = (HashSet::new(), Vec::new());
        for chain in chains {
            for ends in chain.edges() {
                let [a, b] = ends.map(|seed| vertex[&seed]);
                if !plane.can_add_constraint(a, b) {
                    return None;
                }
                plane.add_constraint(a, b);
                // A seed on the edge divides it.
                if !plane.exists_constraint(a, b) {
                    return None;
                }
                edges.push(ends.map(&at));
                if chain.boundary {
                    rim.insert(undirected([a, b].map(|v| v.index() as u32)));
                }
            }
        }
        let mut outline = Self { plane, seeds, edges, rim, is_inside: Vec::new() };
        outline.is_inside = vec![false; outline.plane.num_all_faces()];
        for face in outline.inside(&outline.plane) {
            outline.is_inside[face.number] = true;
        }
        Some(outline)
    }

    /// Whether a place is in the patch, and not too near to a curve.
    fn has_room(&self, p: DVec2) -> bool {
        let is_near = |[a, b]: &[DVec2; 2]| {
            let along = *b - *a;
            let share = ((p - *a).dot(along) / along.length_squared()).clamp(0.0, 1.0);
            p.distance_squared(*a + share * along) < NEAREST.powi(2) * along.length_squared()
        };
        let PositionInTriangulation::OnFace(face) = self.plane.locate(Point2::new(p.x, p.y)) else { return false };
        self.is_inside[face.index()] && !self.edges.iter().any(is_near)
    }

    /// The faces that an odd number of edges of the rim separates from the outside, with more vertices in the plane or not.
    fn inside(&self, plane: &Plane) -> Vec<Face> {
        let of = |face: FaceHandle<'_, InnerTag, Point2<f64>, (), CdtEdge<()>, ()>| {
            let (center, squared_radius) = face.circumcircle();
            let corners = face.vertices().map(|v| v.index() as u32);
            Face { number: face.index(), corners, center: DVec2::new(center.x, center.y), squared_radius }
        };
        let all: Vec<Face> = plane.inner_faces().map(of).collect();
        let of_side: HashMap<[u32; 2], usize> =
            (0..all.len()).flat_map(|f| sides(all[f].corners).map(|side| (side, f))).collect();
        let turns = |side| self.rim.contains(&undirected(side));
        let mut is_inside: Vec<Option<bool>> = vec![None; all.len()];
        let is_hull = |[a, b]: &[u32; 2]| !of_side.contains_key(&[*b, *a]);
        let mut front: Vec<(usize, bool)> =
            of_side.iter().filter(|own| is_hull(own.0)).map(|(&side, &f)| (f, turns(side))).collect();
        front.sort_unstable();
        while let Some((f, found)) = front.pop() {
            if is_inside[f].is_some() {
                continue;
            }
            is_inside[f] = Some(found);
            let beyond = |[a, b]: [u32; 2]| of_side.get(&[b, a]).map(|&next| (next, found != turns([a, b])));
            front.extend(sides(all[f].corners).into_iter().filter_map(beyond));
        }
        all.into_iter().zip(is_inside).filter(|own| own.1 == Some(true)).map(|own| own.0).collect()
    }
}
