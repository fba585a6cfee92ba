//! Shorter edges around thin shafts and bores.
//!
//! Purpose: [`lengths`] finds where a surface turns back on itself within an edge or two, as a bore or a pin does. Edges as long as its
//! radius would cut through it. They are shorter there, so that about eight go around.
//! Invariant: all copies of a vertex have one length. A fillet, which turns by 90 degrees, is never off by much, and keeps its length.
//! Must not know: how lengths become seeds.

use std::collections::HashMap;

use glam::DVec3;
use rayon::prelude::*;

use crate::mesh::TriMesh;
use crate::mesh::apart::Apart;
use crate::mesh::closest_point::ClosestPoint;
use crate::mesh::edges::{sides, undirected};
use crate::remesh::constants::{BEND_EDGE, BEND_FACING, BEND_OFF, LEAST_BEND, SHORTEST_BEND_EDGE};
use crate::remesh::triangle::unit_normal;
use crate::token::{Stopped, Token};

/// Lengths for the vertices of `apart`'s surface, where `edge` is that of all others; `None` if nothing is bent so.
pub(super) fn lengths(apart: &Apart, edge: f64, token: &Token) -> Result<Option<Vec<f64>>, Stopped> {
    let mesh = &apart.mesh;
    let mut first: HashMap<[u32; 2], u32> = HashMap::new();
    let mut bends: Vec<([u32; 2], Bend)> = Vec::new();
    for (f, &t) in (0..).zip(mesh.facets()) {
        token.check_at(f as usize)?;
        for side in sides(t).map(undirected) {
            if let Some(other) = first.insert(side, f)
                && let Some(bend) = bend(mesh, side, [other, f])
                && (LEAST_BEND * edge..edge / BEND_EDGE).contains(&bend.radius)
            {
                bends.push((side, bend));
            }
        }
    }
    if bends.is_empty() {
        return Ok(None);
    }
    let closest = ClosestPoint::unless(mesh, token)?;
    let turns_back = |(_, bend): &([u32; 2], Bend)| {
        let there = closest.project(bend.opposite);
        let facing = unit_normal(mesh.corners(there.facet as usize)).dot(bend.normal);
        there.position.distance(bend.opposite) < BEND_OFF * bend.radius && facing < -BEND_FACING
    };
    let found: Vec<bool> = bends.par_iter().map(turns_back).collect();
    token.check()?;
    let mut of_vertex: HashMap<u32, f64> = HashMap::new();
    for (side, Bend { radius, .. }) in bends.iter().zip(found).filter(|own| own.1).map(|own| own.0) {
        for &v in side {
            let length = of_vertex.entry(apart.before(v)).or_insert(edge);
            *length = length.min((BEND_EDGE * radius).max(SHORTEST_BEND_EDGE * edge));
        }
    }
    let of = |v: u32| of_vertex.get(&apart.before(v)).copied().unwrap_or(edge);
    Ok((!of_vertex.is_empty()).then(|| (0..mesh.positions().len() as u32).map(of).collect()))
}

/// The circle through two facets.
struct Bend {
    /// Unit normal of the edge between them.
    normal: DVec3,
    /// The place of the circle that is farthest from the edge.
    opposite: DVec3,
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
    let radius = width / n.cross(m).length().atan2(n.dot(m));
    // Facets beside an edge that juts out are behind its normal.
    let way = if (from + to).dot(normal) < 0.0 { -normal } else { normal };
    (radius.is_finite() && radius > 0.0).then_some(Bend { normal, opposite: 0.5 * (a + b) + 2.0 * radius * way, radius })
}
