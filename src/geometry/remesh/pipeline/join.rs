//! Sheets joined where they meet.
//!
//! Purpose: [`join`] makes one vertex of those that several sheets, or pieces of one, have in one place on a curve.
//! Invariant: facets keep their numbers and corners their places. Must not know: how sheets came to have the same vertices.

use std::collections::{HashMap, HashSet};

use super::carried::Carried;
use super::extract::Built;
use crate::mesh::edges::undirected;
use crate::mesh::{MeshError, TriMesh};
use crate::remesh::features::KeptCurves;
use crate::remesh::features::seams::Joint;

/// Joins the sheets of a result in their places. Some vertices have become those of other seeds, which are in `settled`.
pub(super) fn join(
    built: &mut Built,
    curves: &KeptCurves,
    settled: &HashMap<u32, u32>,
    carried: &mut Carried,
) -> Result<(), MeshError> {
    let positions = built.mesh.positions();
    let mut first: HashMap<(Joint, [u64; 3]), u32> = HashMap::new();
    let mut kept: Vec<u32> = Vec::with_capacity(positions.len());
    let mut number: Vec<u32> = Vec::with_capacity(positions.len());
    for (v, (p, &seed)) in (0..).zip(positions.iter().zip(&built.vertex_seed)) {
        let next = kept.len() as u32;
        let own = match curves.joint(settled.get(&v).copied().unwrap_or(seed)) {
            Some(joint) => *first.entry((joint, p.to_array().map(f64::to_bits))).or_insert(next),
            None => next,
        };
        number.push(own);
        if own == next {
            kept.push(v);
        }
    }
    if kept.len() == positions.len() {
        return Ok(());
    }
    let renumbered = |v: u32| number[v as usize];
    let places = kept.iter().map(|&v| positions[v as usize]).collect();
    let facets = built.mesh.facets().iter().map(|t| t.map(renumbered)).collect();
    built.mesh = TriMesh::new(places, facets)?;
    built.vertex_seed = kept.iter().map(|&v| built.vertex_seed[v as usize]).collect();
    built.curve_edges.iter_mut().for_each(|edge| *edge = edge.map(renumbered));
    // Copies of a curve are one now.
    let mut met: HashSet<[u32; 2]> = HashSet::new();
    built.curve_edges.retain(|&edge| met.insert(undirected(edge)));
    built.segments.iter_mut().flatten().for_each(|edge| *edge = edge.map(renumbered));
    if !carried.provenance.is_empty() {
        carried.provenance = kept.iter().map(|&v| carried.provenance[v as usize]).collect();
    }
    carried.attributes = carried.attributes.take().map(|attributes| attributes.of_vertices(&kept));
    Ok(())
}
