//! Tips that a result lost.
//!
//! Purpose: where a cone, a needle or a pit is thinner than an edge, no cell has its tip, and the result ends below it. [`put_back`] divides
//! the facet there into three that meet in the tip. Where the result ends in a vertex itself, that one moves to the tip. [`settle_points`]
//! moves a vertex to each point that the result has to have and lacks: a cell may be around the whole cone of which the point is the tip.
//! Invariant: no more facets cross each other than before; curves stay. Must not know: seeds, diagrams.

use std::collections::{HashMap, HashSet};

use glam::DVec3;

use super::extract::Built;
use crate::mesh::closest_point::ClosestPoint;
use crate::mesh::crossings::crossings;
use crate::mesh::csr::Csr;
use crate::mesh::tips::Tips;
use crate::mesh::{MeshError, TriMesh};
use crate::remesh::features::KeptCurves;
use crate::remesh::triangle::{longest_side, unit_normal};
use crate::token::{Stopped, Token};

/// A tip is lost if the result is farther from it, longest sides of the facet there.
const LOST: f64 = 0.5;
/// A tip is pointed over this length, longest sides of the facet: cells there are half as wide as an edge is long.
const REACH: f64 = 0.5;
/// A facet that ends below a tip faces it within this, cosine.
const FACING: f64 = 0.5;
/// Facets around a vertex that moves to a tip do not turn by more, cosine.
const TURNED: f64 = 0.5;
/// New and moved vertices are at most this share of all.
const MOST_TIPS: f64 = 0.01;

/// Moves the nearest vertex to each single point of `curves` that no vertex has. `mesh` is that which the curves are of. Returns the seeds of
/// the points for the vertices that moved.
pub(super) fn settle_points(
    built: &mut Built,
    curves: &KeptCurves,
    mesh: &TriMesh,
    token: &Token,
) -> Result<Result<HashMap<u32, u32>, MeshError>, Stopped> {
    let present: HashSet<u32> = built.vertex_seed.iter().copied().collect();
    let absent: Vec<(u32, u32)> = curves.points().filter(|(_, seed)| !present.contains(seed)).collect();
    let mut moved = HashMap::new();
    if absent.is_empty() {
        return Ok(Ok(moved));
    }
    let closest = ClosestPoint::unless(&built.mesh, token)?;
    let rings = Csr::one_rings(built.mesh.positions().len(), built.mesh.facets());
    let mut positions = built.mesh.positions().to_vec();
    for (v, seed) in absent {
        let point = mesh.positions()[v as usize];
        let corners = built.mesh.facets()[closest.project(point).facet as usize];
        let from_point = |&v: &u32| positions[v as usize].distance_squared(point);
        let free = corners.into_iter().filter(|&v| !curves.has_seed(built.vertex_seed[v as usize]));
        let Some(end) = free.min_by(|a, b| from_point(a).total_cmp(&from_point(b))) else { continue };
        let turns = |&f: &u32| {
            let t = built.mesh.facets()[f as usize];
            let [before, after] = [positions[end as usize], point]
                .map(|place| unit_normal(t.map(|v| if v == end { place } else { positions[v as usize] })));
            before.dot(after) < TURNED
        };
        if !(moved.contains_key(&end) || rings.of(end).iter().any(turns)) {
            positions[end as usize] = point;
            moved.insert(end, seed);
        }
    }
    Ok(TriMesh::new(positions, built.mesh.facets().to_vec()).map(|mesh| {
        built.mesh = mesh;
        moved
    }))
}

/// Puts the tips of `mesh` back that are lost. Whether the result changes.
pub(super) fn put_back(built: &mut Built, mesh: &TriMesh, token: &Token) -> Result<Result<bool, MeshError>, Stopped> {
    let Some(tips) = Tips::of(mesh, token)? else { return Ok(Ok(false)) };
    let result = &built.mesh;
    let closest = ClosestPoint::unless(result, token)?;
    let rings = Csr::one_rings(result.positions().len(), result.facets());
    let most = (MOST_TIPS * result.positions().len() as f64).ceil() as usize;
    let on_curves: HashSet<u32> = built.curve_edges.iter().flatten().copied().collect();
    let mut made: Vec<(u32, DVec3)> = Vec::new();
    let mut moved: Vec<(u32, DVec3)> = Vec::new();
    // Facets that change.
    let mut taken: HashSet<u32> = HashSet::new();
    for &v in tips.candidates() {
        token.check()?;
        let tip = mesh.positions()[v as usize];
        let near = closest.project(tip);
        let longest = longest_side(result.corners(near.facet as usize));
        if made.len() + moved.len() == most || near.position.distance(tip) < LOST * longest {
            continue;
        }
        let Some(direction) = tips.direction(v, REACH * longest) else { continue };
        let outward = if tips.is_pit(v, direction) { -1.0 } else { 1.0 };
        // The nearest point is on an edge or a vertex as often as within a facet.
        let around = result.facets()[near.facet as usize].into_iter().flat_map(|corner| rings.of(corner));
        let facing = |f: u32| {
            let corners = result.corners(f as usize);
            let middle = corners.iter().sum::<DVec3>() / 3.0;
            outward * unit_normal(corners).dot((tip - middle).normalize_or_zero())
        };
        let best = around.map(|&f| (facing(f), f)).max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)));
        if let Some((_, f)) = best.filter(|&(cosine, _)| cosine > FACING) {
            if taken.insert(f) {
                made.push((f, tip));
            }
            continue;
        }
        let corners = result.facets()[near.facet as usize];
        let from_tip = |&v: &u32| result.positions()[v as usize].distance_squared(tip);
        let end = corners.into_iter().min_by(|a, b| from_tip(a).total_cmp(&from_tip(b))).unwrap_or(corners[0]);
        let turns = |&f: &u32| {
            let t = result.facets()[f as usize];
            let after = t.map(|v| if v == end { tip } else { result.positions()[v as usize] });
            unit_normal(result.corners(f as usize)).dot(unit_normal(after)) < TURNED
        };
        let ring = rings.of(end);
        if !on_curves.contains(&end) && !ring.iter().any(|f| taken.contains(f) || turns(f)) {
            taken.extend(ring);
            moved.push((end, tip));
        }
    }
    if made.is_empty() && moved.is_empty() {
        return Ok(Ok(false));
    }
    let mut positions = result.positions().to_vec();
    moved.iter().for_each(|&(v, tip)| positions[v as usize] = tip);
    let mut facets = result.facets().to_vec();
    for &(f, tip) in &made {
        let [a, b, c] = facets[f as usize];
        let new = positions.len() as u32;
        positions.push(tip);
        facets[f as usize] = [a, b, new];
        facets.extend([[b, c, new], [c, a, new]]);
    }
    let pointed = match TriMesh::new(positions, facets) {
        Ok(pointed) => pointed,
        Err(error) => return Ok(Err(error)),
    };
    let changes = crossings(&pointed, token)?.count <= crossings(result, token)?.count;
    if changes {
        built.mesh = pointed;
        // Vertices are in the order of their seeds.
        let last = built.vertex_seed.last().copied().unwrap_or(0);
        built.vertex_seed.resize(built.mesh.positions().len(), last);
    }
    Ok(Ok(changes))
}
