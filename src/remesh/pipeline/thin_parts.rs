//! Sizing of parts of a surface that are too thin for their cells.
//!
//! Purpose: [`failing`] finds the cells around which the dual has another topology than the surface: those that reach around a
//! horn or a finger, across a bridge or a strip, or hold the whole end of something slender, of which the dual would have
//! nothing. Where many cells reach through a thin wall to its other side, these fail too: their parts make vertices as they come,
//! and poor triangles. [`shorten`] makes edges shorter there, for seeds to be drawn again. Where all cells are disks that meet each
//! other and the boundary once, the dual is homeomorphic to the surface (closed ball property, Edelsbrunner and Shah 1997).
//! Invariant: no cell fails if the repaired dual has all components, holes, handles and cells of the surface, and few cells have
//! several parts. Where the surface itself is no manifold, no cell fails either: no seeds could help.
//! Must not know: how seeds are drawn, iterations.

use glam::DVec3;

use crate::mesh::TriMesh;
use crate::mesh::adjacency::{Adjacency, EdgeKind};
use crate::mesh::closest_point::{ClosestPoint, SurfacePoint};
use crate::mesh::measure::{self, Topology};
use crate::remesh::constants::{
    MANY_SPLITS, MANY_SPLITS_SHARE, MAX_VAIN_ROUNDS, MOST_SPLITS, MOST_WALLS, SPLIT_GAIN, THIN_SHORTER, WALL_RINGS,
    WALL_SHORTER,
};
use crate::remesh::manifold::repair::{self, Repaired};
use crate::rvd::Surface;
use crate::rvd::dual::Dual;
use crate::token::{Stopped, Token};

/// Cells around which a dual has another topology than the surface, or poor triangles.
#[derive(Default)]
pub(super) struct FailingCells {
    /// Components of the dual around which the topology is another one, ascending.
    components: Vec<u32>,
    /// Area of the cells, those in several parts included, unit frame.
    area: f64,
    /// Vertices of the repaired dual.
    pub(super) vertices: usize,
    /// Components on walls through which many cells reach, ascending.
    walls: Vec<u32>,
    /// Area of the cells that do, unit frame.
    split_area: f64,
}

impl FailingCells {
    /// Cells around which the topology is another one.
    pub(super) fn len(&self) -> usize {
        self.components.len()
    }

    pub(super) fn is_empty(&self) -> bool {
        self.components.is_empty() && self.walls.is_empty()
    }

    /// Rounds without a better result, at most.
    pub(super) fn max_vain_rounds(&self) -> usize {
        if self.components.is_empty() { 1 } else { MAX_VAIN_ROUNDS }
    }

    /// Topology counts first. That few cells less reach through walls is not worth other edges.
    pub(super) fn is_better(&self, other: &Self) -> bool {
        match (self.components.is_empty(), other.components.is_empty()) {
            (true, true) => self.split_area < SPLIT_GAIN * other.split_area,
            (false, false) => self.area < other.area,
            (holds, _) => holds,
        }
    }
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
    let mut walls = walls(dual);
    if closed_balls && !there.contains(&false) && walls.is_empty() {
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
    let holds = same && !lost;
    if holds && walls.is_empty() {
        return Ok(FailingCells { vertices, ..FailingCells::default() });
    }
    let mut fails = vec![false; count];
    if !holds {
        let pairs = dual.multiple_edges.iter().flatten();
        dual.not_disks.iter().chain(&dual.multiple_boundary_arcs).chain(pairs).for_each(|&c| fails[c as usize] = true);
        (0..count).filter(|&c| !there[c]).for_each(|c| fails[c] = true);
    }
    let non_manifold = non_manifold_vertices(mesh, &Adjacency::new(mesh));
    let is_odd = |facet: u32| surface.welded()[facet as usize].iter().any(|&v| non_manifold[v as usize]);
    for piece in dual.pieces.iter().filter(|piece| is_odd(piece.facet)) {
        fails[piece.component as usize] = false;
        walls.get_mut(piece.component as usize).into_iter().for_each(|wall| *wall = false);
    }
    let numbers = |of: &[bool]| (0..).zip(of).filter(|(_, is)| **is).map(|(c, _)| c).collect::<Vec<u32>>();
    let area = |of: &[u32]| of.iter().map(|&c| dual.components[c as usize].area).sum::<f64>();
    let (all, walls) = (numbers(&fails), numbers(&walls));
    // Few cells in several parts have them on two close sheets, which is no failure.
    let mut components: Vec<u32> = all.iter().copied().filter(|&c| whole(c)).collect();
    if components.is_empty() {
        components.clone_from(&all);
    }
    let split: Vec<u32> = walls.iter().copied().filter(|&c| !whole(c)).collect();
    Ok(FailingCells { components, area: area(&all), vertices, walls, split_area: area(&split) })
}

/// Of each component whether it is on a wall through which many cells reach; empty if there is none, or where somewhat shorter edges
/// do not help: walls are all of the surface, or most cells of them reach through.
fn walls(dual: &Dual) -> Vec<bool> {
    let cells = dual.components.last().map_or(0, |last| last.seed as usize + 1);
    if dual.split_cells < MANY_SPLITS.max((MANY_SPLITS_SHARE * cells as f64) as usize) {
        return Vec::new();
    }
    let mut on_wall: Vec<bool> = dual.components.iter().map(|c| !c.whole).collect();
    // Grown and shrunk again, so that what lies between is on the wall and what lies beside it is not.
    for grows in [true, false] {
        for _ in 0..WALL_RINGS {
            let before = on_wall.clone();
            for t in dual.triangles.iter().filter(|t| t.iter().any(|&c| before[c as usize] == grows)) {
                t.iter().for_each(|&c| on_wall[c as usize] = grows);
            }
        }
    }
    let area = |of: &dyn Fn(usize) -> bool| -> f64 {
        dual.components.iter().enumerate().filter(|(c, _)| of(*c)).map(|(_, c)| c.area).sum()
    };
    let (split, wall) = (area(&|c| !dual.components[c].whole), area(&|c| on_wall[c]));
    if wall > MOST_WALLS * dual.area || split > MOST_SPLITS * wall { Vec::new() } else { on_wall }
}

/// The vertices around which a surface is no manifold.
fn non_manifold_vertices(mesh: &TriMesh, adjacency: &Adjacency) -> Vec<bool> {
    let representative = adjacency.representative();
    let mut found = measure::split_vertices(mesh, adjacency);
    for half in 0..3 * mesh.facets().len() {
        if matches!(adjacency.kind(half), EdgeKind::NonManifold | EdgeKind::Inconsistent) {
            let facet = mesh.facets()[half / 3];
            for v in [facet[half % 3], facet[(half + 1) % 3]] {
                found[representative[v as usize] as usize] = true;
            }
        }
    }
    found
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
    // What lengths are multiplied with, by component, vertex of the surface, and vertex of the mesh.
    let mut of_component = vec![1.0; dual.components.len()];
    failing.walls.iter().for_each(|&c| of_component[c as usize] = WALL_SHORTER);
    failing.components.iter().for_each(|&c| of_component[c as usize] = THIN_SHORTER);
    let mut without_vertex: Vec<bool> = of_component.iter().map(|&factor| factor < 1.0).collect();
    let mut held = vec![1.0f64; surface.positions().len()];
    for piece in dual.pieces.iter().filter(|piece| of_component[piece.component as usize] < 1.0) {
        for corner in (0..3).filter(|c| piece.corners & 1 << c != 0) {
            let vertex = surface.welded()[piece.facet as usize][corner] as usize;
            held[vertex] = held[vertex].min(of_component[piece.component as usize]);
            if vertex < lengths.len() {
                without_vertex[piece.component as usize] = false;
            }
        }
    }
    let mut own = vec![1.0f64; lengths.len()];
    let mut closest = None;
    for (c, component) in dual.components.iter().enumerate().filter(|(c, _)| without_vertex[*c]) {
        token.check()?;
        let tree = closest.get_or_insert_with(|| ClosestPoint::new(mesh));
        let SurfacePoint { facet, barycentric, .. } = tree.project(surface.frame().to_world(component.centroid));
        let corner = (0..3).max_by(|&a, &b| barycentric[a].total_cmp(&barycentric[b])).unwrap_or_default();
        let nearest = &mut own[mesh.facets()[facet as usize][corner] as usize];
        *nearest = nearest.min(of_component[c]);
    }
    // Welded vertices are one.
    let welded = surface.facets().iter().zip(surface.welded()).flat_map(|(own, first)| own.iter().zip(first));
    let welded = welded.map(|(&v, &first)| (v as usize, first as usize)).filter(|(v, _)| *v < lengths.len());
    welded.clone().for_each(|(v, first)| held[first] = held[first].min(own[v]));
    welded.for_each(|(v, first)| own[v] = own[v].min(held[first]));
    lengths.iter_mut().zip(own).for_each(|(length, factor)| *length *= factor);
    Ok(())
}
