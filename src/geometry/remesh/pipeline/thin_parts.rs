//! Sizing of parts of a surface that are too thin for their cells.
//!
//! Purpose: [`failing`] finds the cells around which the dual has another topology than the surface: those that reach around a
//! horn or a finger, across a bridge or a strip, or hold the whole end of something slender, of which the dual would have
//! nothing. [`shorten`] makes edges shorter there, for seeds to be drawn again. Where all cells are disks that meet each
//! other and the boundary once, the dual is homeomorphic to the surface (closed ball property, Edelsbrunner and Shah 1997).
//! Invariant: no cell fails if the repaired dual has all components, holes, handles and cells of the surface. Where the
//! surface itself is no manifold, no cell fails either: no seeds could help.
//! Must not know: how seeds are drawn, iterations.

use glam::DVec3;

use crate::mesh::TriMesh;
use crate::mesh::closest_point::{ClosestPoint, SurfacePoint};
use crate::mesh::measure::{self, Topology};
use crate::remesh::constants::THIN_SHORTER;
use crate::remesh::manifold::repair::{self, Repaired};
use crate::rvd::Surface;
use crate::rvd::dual::Dual;
use crate::token::{Stopped, Token};

/// Cells around which a dual has another topology than the surface.
#[derive(Default)]
pub(super) struct FailingCells {
    /// Their components of the dual, ascending.
    pub(super) components: Vec<u32>,
    /// Area of the cells, those in several parts included, unit frame.
    pub(super) area: f64,
    /// Vertices of the repaired dual.
    pub(super) vertices: usize,
}

/// The failing cells of a dual. `surface` was made of `mesh`, and the result is to have the topology `wanted`.
pub(super) fn failing(
    dual: &Dual,
    mesh: &TriMesh,
    surface: &Surface,
    wanted: &Topology,
    token: &Token,
) -> Result<FailingCells, Stopped> {
    let count = dual.components.len();
    let mut there = vec![false; count];
    dual.triangles.iter().flatten().for_each(|&c| there[c as usize] = true);
    let closed_balls =
        dual.not_disks.is_empty() && dual.multiple_boundary_arcs.is_empty() && dual.multiple_edges.is_empty();
    if closed_balls && !there.contains(&false) {
        return Ok(FailingCells { vertices: count, ..FailingCells::default() });
    }
    let places: Vec<DVec3> = dual.components.iter().map(|c| c.centroid).collect();
    let Repaired { source, positions, facets, .. } = repair::repair(&places, &dual.triangles, token)?;
    token.check()?;
    let vertices = source.len();
    there.fill(false);
    source.iter().for_each(|&c| there[c as usize] = true);
    let key = |t: &Topology| (t.euler, t.components, t.boundary_loops);
    let same = TriMesh::new(positions, facets).is_ok_and(|result| key(&measure::topology(&result)) == key(wanted));
    let whole = |c: u32| dual.components[c as usize].whole;
    let lost = (0..count as u32).any(|c| whole(c) && !there[c as usize]);
    // Folds of the surface that are smaller than a cell close without a trace.
    if same && !lost {
        return Ok(FailingCells { vertices, ..FailingCells::default() });
    }
    let pairs = dual.multiple_edges.iter().flatten();
    let mut fails = vec![false; count];
    dual.not_disks.iter().chain(&dual.multiple_boundary_arcs).chain(pairs).for_each(|&c| fails[c as usize] = true);
    (0..count).filter(|&c| !there[c]).for_each(|c| fails[c] = true);
    let non_manifold = measure::non_manifold_vertices(mesh);
    for piece in &dual.pieces {
        if surface.welded()[piece.facet as usize].iter().any(|&v| non_manifold[v as usize]) {
            fails[piece.component as usize] = false;
        }
    }
    let all: Vec<u32> = (0..).zip(&fails).filter(|(_, fails)| **fails).map(|(c, _)| c).collect();
    // Most cells in several parts have them on two close sheets, which is no failure.
    let area = all.iter().map(|&c| dual.components[c as usize].area).sum();
    let mut components: Vec<u32> = all.iter().copied().filter(|&c| whole(c)).collect();
    if components.is_empty() {
        components = all;
    }
    Ok(FailingCells { components, area, vertices })
}

/// Makes the lengths, one a vertex of the caller's `mesh`, shorter at the vertices in failing cells; for a cell without a
/// vertex, at the nearest corner of its facet. The first vertices of `surface` are those of `mesh`.
pub(super) fn shorten(
    lengths: &mut [f64],
    mesh: &TriMesh,
    failing: &FailingCells,
    dual: &Dual,
    surface: &Surface,
    token: &Token,
) -> Result<(), Stopped> {
    let mut fails = vec![false; dual.components.len()];
    failing.components.iter().for_each(|&c| fails[c as usize] = true);
    let mut without_vertex = fails.clone();
    let mut held = vec![false; surface.positions().len()];
    for piece in dual.pieces.iter().filter(|piece| fails[piece.component as usize]) {
        for corner in (0..3).filter(|c| piece.corners & 1 << c != 0) {
            let vertex = surface.welded()[piece.facet as usize][corner] as usize;
            held[vertex] = true;
            if vertex < lengths.len() {
                without_vertex[piece.component as usize] = false;
            }
        }
    }
    let mut shorter = vec![false; lengths.len()];
    let mut closest = None;
    for (component, _) in dual.components.iter().zip(&without_vertex).filter(|(_, without)| **without) {
        token.check()?;
        let tree = closest.get_or_insert_with(|| ClosestPoint::new(mesh));
        let SurfacePoint { facet, barycentric, .. } = tree.project(surface.frame().to_world(component.centroid));
        let corner = (0..3).max_by(|&a, &b| barycentric[a].total_cmp(&barycentric[b])).unwrap_or_default();
        shorter[mesh.facets()[facet as usize][corner] as usize] = true;
    }
    // Welded vertices are one.
    let welded = surface.facets().iter().zip(surface.welded()).flat_map(|(own, first)| own.iter().zip(first));
    let welded = welded.map(|(&own, &first)| (own as usize, first as usize)).filter(|(own, _)| *own < lengths.len());
    welded.clone().for_each(|(own, first)| held[first] |= shorter[own]);
    welded.for_each(|(own, first)| shorter[own] |= held[first]);
    lengths.iter_mut().zip(&shorter).filter(|(_, shorter)| **shorter).for_each(|(length, _)| *length *= THIN_SHORTER);
    Ok(())
}
