//! An estimate of the Hausdorff distance between input and result.
//!
//! Purpose: both directions. From the input: its vertices against the one-ring of their result vertex. From the result:
//! its vertices and the centroids of its facets against the nearest samples of the input.
//! Invariant: the same bits whatever the number of threads. Must not know: what is done about it.

use glam::DVec3;
use rayon::prelude::*;

use super::deviation::InputDeviation;
use super::reference::{InputSamples, SurfaceSample};
use crate::mesh::csr::Csr;
use crate::remesh::constants::{ITEMS_PER_TASK, MISSED_SHARES, SAMPLE_REACH, WORK_PER_VERTEX};
use crate::remesh::manifold::local_mesh::LocalMesh;
use crate::token::Token;

/// Distance between input and result.
pub(in crate::remesh) struct HausdorffEstimate {
    /// Places of the input that were missed; see [`missed_places`].
    pub(in crate::remesh) missed: Vec<(u32, DVec3)>,
    /// The largest distance in either direction.
    pub(in crate::remesh) largest: f64,
    /// The largest distance around each vertex of the result.
    pub(in crate::remesh) by_vertex: Vec<f64>,
}

impl HausdorffEstimate {
    /// Measures the whole result. Places farther away than `tolerance` were missed.
    pub(in crate::remesh) fn of(mesh: &LocalMesh, input: &InputSamples, tolerance: Option<f64>, token: &Token) -> Self {
        let deviations = InputDeviation::new(mesh, &input.vertices, token);
        let missed = select(mesh, &deviations, tolerance);
        let by_facet = deviation_by_facet(mesh, &input.samples, token);
        let largest = by_facet.iter().copied().fold(deviations.largest(), f64::max);
        let mut by_vertex = deviations.by_owner(mesh.positions.len());
        let widen = |(v, distance): (usize, &mut f64)| {
            *distance = mesh.ring(v as u32).iter().map(|&f| by_facet[f as usize]).fold(*distance, f64::max);
        };
        by_vertex.par_iter_mut().enumerate().with_min_len(ITEMS_PER_TASK).for_each(widen);
        Self { missed, largest, by_vertex }
    }
}

/// Places of the input that are farther from the result than `tolerance`, or than a share of an edge where that is
/// `None`: (nearest vertex of the result, place) by falling deviation. No two are in one one-ring.
pub(in crate::remesh) fn missed_places(
    mesh: &LocalMesh,
    input: &InputSamples,
    tolerance: Option<f64>,
    token: &Token,
) -> Vec<(u32, DVec3)> {
    select(mesh, &InputDeviation::new(mesh, &input.vertices, token), tolerance)
}

fn select(mesh: &LocalMesh, deviations: &InputDeviation<'_>, tolerance: Option<f64>) -> Vec<(u32, DVec3)> {
    let mut missed = deviations.largest_first(|d| tolerance.map_or(d.relative > MISSED_SHARES[1], |t| d.distance > t));
    if tolerance.is_none() && missed.first().is_some_and(|(_, d)| d.relative <= MISSED_SHARES[0]) {
        missed.clear();
    }
    let mut taken = vec![false; mesh.positions.len()];
    let mut found = Vec::new();
    for (k, d) in missed {
        if !taken[d.corner as usize] {
            mesh.neighbours(d.corner).into_iter().for_each(|u| taken[u as usize] = true);
            found.push((d.corner, deviations.position(k)));
        }
    }
    found
}

/// The largest distance of a corner or of the centroid of each facet from the input.
fn deviation_by_facet(mesh: &LocalMesh, samples: &Csr<SurfaceSample>, token: &Token) -> Vec<f64> {
    let own = |v: u32| match token.check_at(WORK_PER_VERTEX * v as usize) {
        Err(_) => 0.0,
        Ok(()) => distance(mesh.positions[v as usize], [samples.of(v)]),
    };
    let vertices = (0..mesh.positions.len() as u32).into_par_iter().with_min_len(ITEMS_PER_TASK);
    let by_vertex: Vec<f64> = vertices.map(own).collect();
    let of = |t: &[u32; 3]| {
        let [a, b, c] = mesh.places(*t);
        let centroid = distance((a + b + c) / 3.0, t.map(|v| samples.of(v)));
        t.iter().map(|&v| by_vertex[v as usize]).fold(centroid, f64::max)
    };
    mesh.facets().par_iter().with_min_len(ITEMS_PER_TASK).map(of).collect()
}

/// Distance of `p` from the tangent plane of the nearest sample, or from that sample where it is not below `p`. 0 if there are no
/// samples.
fn distance<const N: usize>(p: DVec3, samples: [&[SurfaceSample]; N]) -> f64 {
    let (mut least, mut nearest) = (f64::INFINITY, None);
    for s in samples.into_iter().flatten() {
        let squared = s.position.distance_squared(p);
        if squared < least {
            (least, nearest) = (squared, Some(s));
        }
    }
    nearest.map_or(0.0, |s| {
        let (height, reach) = (s.normal.dot(p - s.position).abs(), s.area.sqrt());
        let tangential = (least - height * height).max(0.0).sqrt();
        height.max(tangential - SAMPLE_REACH * reach)
    })
}
