//! An estimate of the Hausdorff distance between input and result.
//!
//! Purpose: both directions. From the input: its vertices against the one-ring of their own result vertex. From the result:
//! its vertices and the centroids of its facets against the nearest samples of the input.
//! Invariant: the same bits whatever the number of threads. Must not know: what is done about it.

use glam::DVec3;
use rayon::prelude::*;

use super::nearest::RingQuery;
use super::reference::{InputSamples, SurfaceSample};
use crate::mesh::csr::Csr;
use crate::remesh::constants::{ITEMS_PER_TASK, MISSED_SHARES, SAMPLE_REACH, WORK_PER_VERTEX};
use crate::remesh::manifold::local_mesh::LocalMesh;
use crate::remesh::triangle::perimeter;
use crate::token::{Pace, Stopped, Token};

/// Distance between input and result.
pub(crate) struct HausdorffEstimate {
    /// Places of the input that were missed; see [`missed_places`].
    pub(crate) missed: Vec<(u32, DVec3)>,
    /// The largest distance in either direction.
    pub(crate) largest: f64,
    /// The largest distance around each vertex of the result.
    pub(crate) by_vertex: Vec<f64>,
}

impl HausdorffEstimate {
    /// Measures the whole result. Places farther away than `tolerance` were missed.
    pub(crate) fn of(mesh: &LocalMesh, input: &InputSamples, tolerance: Option<f64>, token: &Token) -> Self {
        let deviations = deviations(mesh, &input.vertices, token);
        let missed = select(mesh, &input.vertices, &deviations, tolerance);
        let by_facet = deviation_by_facet(mesh, &input.samples, token);
        let largest = deviations.iter().map(|d| d.distance).chain(by_facet.iter().copied()).fold(0.0, f64::max);
        let around = |v: u32| {
            let own = deviations[input.vertices.range(v)].iter().map(|d| d.distance);
            own.chain(mesh.ring(v).iter().map(|&f| by_facet[f as usize])).fold(0.0, f64::max)
        };
        let vertices = (0..mesh.positions.len() as u32).into_par_iter().with_min_len(ITEMS_PER_TASK);
        Self { missed, largest, by_vertex: vertices.map(around).collect() }
    }
}

/// Where a vertex of the input lies, seen from the result.
#[derive(Clone, Copy)]
struct Deviation {
    /// Distance from the nearest facet.
    distance: f64,
    /// The distance divided by the facet's mean edge.
    relative: f64,
    /// The corner of that facet that is nearest to the input's vertex.
    corner: u32,
}

/// Of a vertex whose owner has no facets.
const UNKNOWN: Deviation = Deviation { distance: 0.0, relative: 0.0, corner: 0 };

/// The deviation of all vertices of the input, in their order.
fn deviations(mesh: &LocalMesh, vertices: &Csr<DVec3>, token: &Token) -> Vec<Deviation> {
    let owner = |v: u32| std::iter::repeat_n(v, vertices.of(v).len());
    let owners: Vec<u32> = (0..mesh.positions.len() as u32).flat_map(owner).collect();
    let begin = || (RingQuery::default(), u32::MAX, Pace::default());
    let measure = |(query, at, pace): &mut (RingQuery, u32, Pace), (&owner, &vertex): (&u32, &DVec3)| {
        token.check_after(WORK_PER_VERTEX, pace)?;
        if *at != owner {
            query.move_to(mesh, owner);
            *at = owner;
        }
        Ok(deviation(mesh, query, vertex))
    };
    let pairs = owners.par_iter().zip(vertices.all()).with_min_len(ITEMS_PER_TASK);
    let all: Result<Vec<Deviation>, Stopped> = pairs.map_init(begin, measure).collect();
    all.unwrap_or_else(|_| vec![UNKNOWN; owners.len()])
}

fn deviation(mesh: &LocalMesh, query: &mut RingQuery, vertex: DVec3) -> Deviation {
    let found = query.nearest(vertex);
    let Some(&t) = mesh.facets().get(found.facet as usize) else { return UNKNOWN };
    let p = mesh.places(t);
    let edge = perimeter(p) / 3.0;
    let to = p.map(|q| q.distance_squared(vertex));
    let corner = if to[0] <= to[1] && to[0] <= to[2] {
        t[0]
    } else if to[1] <= to[2] {
        t[1]
    } else {
        t[2]
    };
    let distance = found.squared.sqrt();
    Deviation { distance, relative: if edge > 0.0 { distance / edge } else { 0.0 }, corner }
}

/// Places of the input that are farther from the result than `tolerance`, or than a share of an edge where that is
/// `None`: (nearest vertex of the result, place) by falling deviation. No two are in one one-ring.
pub(crate) fn missed_places(
    mesh: &LocalMesh,
    input: &InputSamples,
    tolerance: Option<f64>,
    token: &Token,
) -> Vec<(u32, DVec3)> {
    select(mesh, &input.vertices, &deviations(mesh, &input.vertices, token), tolerance)
}

fn select(
    mesh: &LocalMesh,
    vertices: &Csr<DVec3>,
    deviations: &[Deviation],
    tolerance: Option<f64>,
) -> Vec<(u32, DVec3)> {
    let is_far = |d: &Deviation| tolerance.map_or(d.relative > MISSED_SHARES[1], |t| d.distance > t);
    let far = vertices.all().iter().zip(deviations).filter(|(_, d)| is_far(d));
    let mut missed: Vec<(&DVec3, &Deviation)> = far.collect();
    missed.sort_by(|a, b| b.1.relative.total_cmp(&a.1.relative));
    if tolerance.is_none() && missed.first().is_some_and(|(_, d)| d.relative <= MISSED_SHARES[0]) {
        missed.clear();
    }
    let mut taken = vec![false; mesh.positions.len()];
    let mut found = Vec::new();
    for (&place, d) in missed {
        if !taken[d.corner as usize] {
            mesh.neighbours(d.corner).into_iter().for_each(|u| taken[u as usize] = true);
            found.push((d.corner, place));
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
