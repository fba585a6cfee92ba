//! Parts of a surface that are too thin for their cells.
//!
//! Purpose: [`failing`] finds the cells of a diagram around which its dual has another topology than the surface:
//! those that reach around a horn or a finger, across a bridge or a strip, or hold the whole end of something slender, of
//! which the dual would have nothing. [`shorten`] makes edges shorter there, for seeds to be drawn anew. Where all
//! cells are disks that meet each other and the rim once, the dual is homeomorphic to the surface (closed ball property,
//! Edelsbrunner and Shah 1997).
//! Invariant: where the repaired dual has all components, holes and handles and every cell, none fails. Where the surface
//! itself is no manifold, which no seeds could help, none is looked at.
//! Must not know: how seeds are drawn, iterations.

use glam::DVec3;

use super::repair::{self, Repaired};
use crate::mesh::TriMesh;
use crate::mesh::adjacency::{Adjacency, EdgeKind};
use crate::mesh::closest_point::{ClosestPoint, SurfacePoint};
use crate::mesh::measure::{self, Topology};
use crate::rvd::Surface;
use crate::rvd::dual::Dual;
use crate::token::{Stopped, Token};

/// Times that seeds are drawn anew.
pub(super) const ROUNDS: usize = 6;
/// Rounds one after the other that did not help: where new seeds lie, other cells may fail that just held before.
pub(super) const VAIN: usize = 3;
/// What edges become in a round, as a share of what they were: twice as many cells around what one reached around.
const SHORTER: f64 = 0.5;
/// Edges elsewhere may become so much longer, for as many points: half of them may go to what is thin.
pub(super) const LONGER: f64 = 1.4;
/// And where lengths say how many points there are, they may be so many times as many.
pub(super) const MORE: usize = 2;

/// Cells around which a dual has another topology than the surface.
#[derive(Default)]
pub(super) struct Failing {
    /// The components of the dual, ascending.
    components: Vec<u32>,
    /// Of the cells and of those in several parts, unit frame.
    area: f64,
}

impl Failing {
    pub(super) fn len(&self) -> usize {
        self.components.len()
    }

    pub(super) fn is_empty(&self) -> bool {
        self.components.is_empty()
    }

    pub(super) fn is_better(&self, other: &Self) -> bool {
        self.area < other.area
    }
}

/// The failing cells of a dual of `mesh`, which `surface` was made of and which is to be as `wanted`.
pub(super) fn failing(
    dual: &Dual,
    mesh: &TriMesh,
    surface: &Surface,
    wanted: &Topology,
    token: &Token,
) -> Result<Failing, Stopped> {
    let count = dual.components.len();
    let mut there = vec![false; count];
    dual.triangles.iter().flatten().for_each(|&c| there[c as usize] = true);
    let holds = dual.not_disks.is_empty() && dual.multiple_rims.is_empty() && dual.multiple_edges.is_empty();
    if holds && !there.contains(&false) {
        return Ok(Failing::default());
    }
    let places: Vec<DVec3> = dual.components.iter().map(|c| c.centroid).collect();
    let Repaired { source, positions, facets, .. } = repair::repair(&places, &dual.triangles, token)?;
    token.check()?;
    there.fill(false);
    source.iter().for_each(|&c| there[c as usize] = true);
    let key = |t: &Topology| (t.euler, t.components, t.boundary_loops);
    let same = TriMesh::new(positions, facets).is_ok_and(|result| key(&measure::topology(&result)) == key(wanted));
    let whole = |c: u32| dual.components[c as usize].whole;
    let lost = (0..count as u32).any(|c| whole(c) && !there[c as usize]);
    // Folds of the surface that are smaller than cells close without a trace.
    if same && !lost {
        return Ok(Failing::default());
    }
    let pairs = dual.multiple_edges.iter().flatten();
    let mut fails = vec![false; count];
    dual.not_disks.iter().chain(&dual.multiple_rims).chain(pairs).for_each(|&c| fails[c as usize] = true);
    (0..count).filter(|&c| !there[c]).for_each(|c| fails[c] = true);
    let odd = odd_vertices(mesh, &Adjacency::new(mesh));
    for piece in &dual.pieces {
        if surface.welded()[piece.facet as usize].iter().any(|&v| odd[v as usize]) {
            fails[piece.component as usize] = false;
        }
    }
    let all: Vec<u32> = (0..).zip(&fails).filter(|(_, fails)| **fails).map(|(c, _)| c).collect();
    // Of cells in several parts most have them on two sheets that are close, which is as it should be.
    let area = all.iter().map(|&c| dual.components[c as usize].area).sum();
    let mut components: Vec<u32> = all.iter().copied().filter(|&c| whole(c)).collect();
    if components.is_empty() {
        components = all;
    }
    Ok(Failing { components, area })
}

/// The vertices around which a surface is no manifold.
fn odd_vertices(mesh: &TriMesh, adjacency: &Adjacency) -> Vec<bool> {
    let representative = adjacency.representative();
    let mut odd = measure::split_vertices(mesh, adjacency);
    for half in 0..3 * mesh.facets().len() {
        if matches!(adjacency.kind(half), EdgeKind::NonManifold | EdgeKind::Inconsistent) {
            let facet = mesh.facets()[half / 3];
            for v in [facet[half % 3], facet[(half + 1) % 3]] {
                odd[representative[v as usize] as usize] = true;
            }
        }
    }
    odd
}

/// Makes the lengths, one a vertex of the caller's `mesh`, shorter at vertices that failing cells hold; where one holds none,
/// at the nearest corner of the facet that it is on. The first vertices of `surface` are those of `mesh`.
pub(super) fn shorten(
    lengths: &mut [f64],
    mesh: &TriMesh,
    failing: &Failing,
    dual: &Dual,
    surface: &Surface,
    token: &Token,
) -> Result<(), Stopped> {
    let mut fails = vec![false; dual.components.len()];
    failing.components.iter().for_each(|&c| fails[c as usize] = true);
    let mut empty = fails.clone();
    let mut held = vec![false; surface.positions().len()];
    for piece in dual.pieces.iter().filter(|piece| fails[piece.component as usize]) {
        for corner in (0..3).filter(|c| piece.corners & 1 << c != 0) {
            let vertex = surface.welded()[piece.facet as usize][corner] as usize;
            held[vertex] = true;
            if vertex < lengths.len() {
                empty[piece.component as usize] = false;
            }
        }
    }
    let mut shorter = vec![false; lengths.len()];
    let mut closest = None;
    for (component, _) in dual.components.iter().zip(&empty).filter(|(_, empty)| **empty) {
        token.check()?;
        let tree = closest.get_or_insert_with(|| ClosestPoint::new(mesh));
        let SurfacePoint { facet, barycentric, .. } = tree.project(surface.frame().to_world(component.centroid));
        let corner = (0..3).max_by(|&a, &b| barycentric[a].total_cmp(&barycentric[b])).unwrap_or_default();
        shorter[mesh.facets()[facet as usize][corner] as usize] = true;
    }
    // Vertices in one place are one.
    let twins = surface.facets().iter().zip(surface.welded()).flat_map(|(own, welded)| own.iter().zip(welded));
    let twins = twins.map(|(&own, &first)| (own as usize, first as usize)).filter(|(own, _)| *own < lengths.len());
    twins.clone().for_each(|(own, first)| held[first] |= shorter[own]);
    twins.for_each(|(own, first)| shorter[own] |= held[first]);
    lengths.iter_mut().zip(&shorter).filter(|(_, shorter)| **shorter).for_each(|(length, _)| *length *= SHORTER);
    Ok(())
}
