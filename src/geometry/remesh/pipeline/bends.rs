//! Shorter edges where a designed surface bends.
//!
//! Purpose: [`lengths`] finds where a surface turns back on itself within an edge or two, as a bore or a pin does. Edges as long as its
//! radius would cut through it; about eight go around. It also finds bent walls: a chord of one skin is off by its squared length over
//! eight radii, and must not reach the other skin.
//! Invariant: all copies of a vertex have one length. A fillet of a solid turns by 90 degrees, is never off by much, and keeps its length.
//! Must not know: how lengths become seeds.

use std::collections::HashMap;

use glam::DVec3;

use crate::mesh::TriMesh;
use crate::mesh::apart::Apart;
use crate::mesh::closest_point::ClosestPoint;
use crate::mesh::edges::{sides, undirected};
use crate::remesh::constants::*;
use crate::remesh::triangle::unit_normal;
use crate::tasks;
use crate::token::{Stopped, Token};

/// Facets that turn by less are in one plane, radians.
const LEAST_ANGLE: f64 = 1e-3;

/// Lengths for the vertices of `apart`'s surface, which is `clean` with its sheets apart. `edge` is the length where nothing is bent so;
/// `None` if nothing is.
pub(super) fn lengths(apart: &Apart, clean: &TriMesh, edge: f64, token: &Token) -> Result<Option<Vec<f64>>, Stopped> {
    let mesh = &apart.mesh;
    let mut first: HashMap<[u32; 2], u32> = HashMap::new();
    let mut bends: Vec<([u32; 2], Bend)> = Vec::new();
    for (f, &t) in (0..).zip(mesh.facets()) {
        token.check_at(f as usize)?;
        for side in sides(t).map(undirected) {
            if let Some(other) = first.insert(side, f) {
                bends.extend(bend(mesh, side, [other, f]).map(|bend| (side, bend)));
            }
        }
    }
    if bends.is_empty() {
        return Ok(None);
    }
    let closest = ClosestPoint::unless(clean, token)?;
    // Where the surface faces the other way beside a place, and how far from that.
    let behind = |from: DVec3, normal: DVec3| {
        let there = closest.project(from);
        let facing = unit_normal(clean.corners(there.facet as usize)).dot(normal);
        (facing < -BEND_FACING).then_some(there.position)
    };
    let length = |(_, bend): &([u32; 2], Bend)| {
        let &Bend { normal, place, way, radius } = bend;
        let place = apart.back(place);
        let opposite = place + 2.0 * radius * way;
        let turns_back = (LEAST_BEND * edge..edge / BEND_EDGE).contains(&radius)
            && behind(opposite, normal).is_some_and(|there| there.distance(opposite) < BEND_OFF * radius);
        let around = if turns_back { BEND_EDGE * radius } else { edge };
        let wall = behind(place - THIN_WALL * edge * normal, normal).map(|there| there.distance(place));
        let along = wall.map_or(edge, |wall| BENT_WALL * (radius * wall).sqrt());
        around.min(along).max(SHORTEST_BEND_EDGE * edge)
    };
    let found: Vec<f64> = tasks::map(bends.len(), |k| length(&bends[k]));
    token.check()?;
    let mut of_vertex: HashMap<u32, f64> = HashMap::new();
    for ((side, _), found) in bends.iter().zip(found).filter(|own| own.1 < edge) {
        for &v in side {
            let length = of_vertex.entry(apart.before(v)).or_insert(edge);
            *length = length.min(found);
        }
    }
    let of = |v: u32| of_vertex.get(&apart.before(v)).copied().unwrap_or(edge);
    Ok((!of_vertex.is_empty()).then(|| (0..mesh.positions().len() as u32).map(of).collect()))
}

/// The circle through two facets.
struct Bend {
    /// Unit normal of the edge between them.
    normal: DVec3,
    /// The middle of the edge, and from there the unit vector to the middle of the circle.
    place: DVec3,
    way: DVec3,
    radius: f64,
}

/// `None` if the facets are in one plane.
fn bend(mesh: &TriMesh, side: [u32; 2], facets: [u32; 2]) -> Option<Bend> {
    let corners = facets.map(|f| mesh.corners(f as usize));
    let [a, b] = side.map(|v| mesh.positions()[v as usize]);
    let along = (b - a).try_normalize()?;
    let [n, m] = corners.map(unit_normal);
    let normal = (n + m).try_normalize()?;
    // Centroids are a third of the way from the edge to the third corners, and middles half.
    let [from, to] = corners.map(|[p, q, r]| ((p + q + r) / 3.0 - a).reject_from_normalized(along));
    let width = 1.5 * (from.length() + to.length());
    let angle = n.cross(m).length().atan2(n.dot(m));
    let radius = width / angle;
    // Facets beside an edge that juts out are behind its normal.
    let way = if (from + to).dot(normal) < 0.0 { -normal } else { normal };
    (angle > LEAST_ANGLE && radius > 0.0).then_some(Bend { normal, place: 0.5 * (a + b), way, radius })
}
