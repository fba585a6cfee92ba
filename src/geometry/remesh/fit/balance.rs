//! The last moves of a fit that brings the largest distances down.
//!
//! Purpose: around a vertex, least squares of any weight leave the vertex farther from the input on one side than facets are on the
//! other, since few samples are near a peak. [`balance`] moves each vertex along its normal until both are as far.
//! Invariant: fixed vertices and those of curves stay. The same bits whatever the number of threads. Must not know: which fit there was.

use glam::DVec3;

use super::normal_equations::{NONE, NearestFacets, residual};
use super::{FacetShape, Target, backtrack};
use crate::remesh::constants::*;
use crate::remesh::manifold::LocalMesh;
use crate::remesh::triangle::Wanted;
use crate::tasks;
use crate::token::Token;

pub(super) fn balance(mesh: &mut LocalMesh, target: &Target, wanted: Wanted, token: &Token) {
    let shapes = FacetShape::all(mesh, wanted);
    let mut stays = target.fixed.clone();
    target.curves.iter().flat_map(|sample| sample.edge).for_each(|v| stays[v as usize] = true);
    for _ in 0..BALANCING_ROUNDS {
        let ranges = ranges(mesh, target, token);
        if token.is_stopped() {
            return;
        }
        let by = |v: u32| {
            if stays[v as usize] || mesh.is_on_boundary(v) {
                return DVec3::ZERO;
            }
            let around = mesh.ring(v).iter().map(|&f| ranges[f as usize]);
            let [low, high] = around.fold(own(mesh, target, v), |a, b| [a[0].min(b[0]), a[1].max(b[1])]);
            -0.5 * BALANCING_SHARE * (low + high) * mesh.vertex_normal(v)
        };
        let mut moves: Vec<DVec3> = tasks::map(mesh.positions.len(), |v| by(v as u32));
        backtrack(mesh, &shapes, wanted, &mut moves);
        mesh.positions.iter_mut().zip(moves).for_each(|(p, by)| *p += by);
    }
}

/// How far a vertex is from the tangent plane of the nearest sample of its own.
fn own(mesh: &LocalMesh, target: &Target, v: u32) -> [f64; 2] {
    let p = mesh.positions[v as usize];
    let nearest = target.own_sample(v, p);
    [nearest.map_or(0.0, |s| s.normal.dot(p - s.position)); 2]
}

/// The least and the largest residual of the samples that are nearest to each facet, 0 included.
fn ranges(mesh: &LocalMesh, target: &Target, token: &Token) -> Vec<[f64; 2]> {
    let found = NearestFacets::new(mesh, target, token);
    let mut ranges = vec![[0.0f64; 2]; mesh.facets().len()];
    let samples = target.input.samples.all();
    for ((&facet, &weights), sample) in found.facet.iter().zip(&found.weights).zip(samples) {
        if facet != NONE {
            let (off, [low, high]) = (residual(sample, mesh.corners(facet), weights), &mut ranges[facet as usize]);
            (*low, *high) = (low.min(off), high.max(off));
        }
    }
    ranges
}
