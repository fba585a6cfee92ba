//! Distances between the input and the result.
//!
//! Purpose: [`InputSamples`] has the samples and the vertices of the input in the cell of each result vertex, for the fit and
//! for distances of the whole result. [`Reference`] has the facets that the cell meets, for distances in one place. Neither
//! needs a search over the whole surface. [`RingQuery`] finds the closest point of a one-ring. [`HausdorffEstimate`] takes both
//! directions: the input's vertices against the one-ring of their own result vertex, and the result's vertices and facet
//! centroids against the nearest samples of the input.
//! Invariant: depends on the diagram and the result alone; the same bits whatever the number of threads.
//! Must not know: how the result is changed.

use glam::DVec3;
use rayon::prelude::*;

use super::constants::*;
use super::manifold::LocalMesh;
use super::triangle::perimeter;
use crate::mesh::closest_point::closest_on_facet;
use crate::mesh::csr::Csr;
use crate::rvd::Surface;
use crate::tasks;
use crate::token::{Pace, Stopped, Token};

/// A point of the input with its share of the area.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SurfaceSample {
    /// Unit frame.
    pub(crate) position: DVec3,
    /// Unit normal of the input there.
    pub(crate) normal: DVec3,
    pub(crate) area: f64,
}

/// The input as points, by result vertex.
#[derive(Debug)]
pub(crate) struct InputSamples {
    pub(crate) samples: Csr<SurfaceSample>,
    /// Unit frame. The nearest facet is sought in the one-ring of the result vertex.
    pub(crate) vertices: Csr<DVec3>,
}

/// The input as facets and vertices, by result vertex.
pub(crate) struct Reference<'a> {
    pub(crate) surface: &'a Surface,
    /// Those that the cell meets.
    pub(crate) facets: Csr<u32>,
    /// Those in the cell, unit frame.
    pub(crate) vertices: Csr<DVec3>,
}

impl Reference<'_> {
    /// Corners of an input facet, unit frame.
    pub(crate) fn corners(&self, facet: u32) -> [DVec3; 3] {
        self.surface.facets()[facet as usize].map(|v| self.surface.positions()[v as usize])
    }
}

/// The larger of two numbers that are not NaN; `f64::max` also asks for NaN.
fn larger(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

/// One facet of the ring. It lies in the wedge between its two sides at the vertex.
struct Wedge {
    facet: u32,
    ids: [u32; 3],
    corners: [DVec3; 3],
    /// The normal of the facet, and those of the two sides at the vertex, in the plane and inwards.
    normals: [DVec3; 3],
    /// One over the squared length of each; 0 for a length of zero.
    inverse_squares: [f64; 3],
}

/// See the module's head. One query serves one vertex after the other.
#[derive(Default)]
pub(crate) struct RingQuery {
    centre: DVec3,
    wedges: Vec<Wedge>,
    bounds: Vec<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Nearest {
    /// Squared distance; infinite if there are no facets.
    pub(crate) squared: f64,
    /// `u32::MAX` if there are none.
    pub(crate) facet: u32,
    /// Barycentric coordinates.
    pub(crate) weights: [f64; 3],
}

impl RingQuery {
    /// From now on, answers for the one-ring of vertex `v`.
    pub(crate) fn move_to(&mut self, mesh: &LocalMesh, v: u32) {
        self.centre = mesh.positions[v as usize];
        self.wedges.clear();
        self.wedges.extend(mesh.ring(v).iter().map(|&facet| {
            let ids = mesh.facets()[facet as usize];
            let corners = mesh.corners(facet);
            let k = ids.iter().position(|&u| u == v).unwrap_or(0);
            let (to, from) = (corners[(k + 1) % 3] - corners[k], corners[(k + 2) % 3] - corners[k]);
            let normal = to.cross(from);
            let normals = [normal, normal.cross(to), from.cross(normal)];
            let over = |squared: f64| Some(1.0 / squared).filter(|inverse| inverse.is_finite()).unwrap_or(0.0);
            let square = normal.length_squared();
            let inverse_squares = [square, square * to.length_squared(), square * from.length_squared()].map(over);
            Wedge { facet, ids, corners, normals, inverse_squares }
        }));
    }

    pub(crate) fn nearest(&mut self, p: DVec3) -> Nearest {
        let d = p - self.centre;
        self.bounds.clear();
        let (mut first, mut least) = (0, f64::INFINITY);
        for (k, wedge) in self.wedges.iter().enumerate() {
            let [off, left, right] = wedge.normals.map(|normal| normal.dot(d));
            let (left, right) = (larger(-left, 0.0), larger(-right, 0.0));
            let tangential = larger(left * left * wedge.inverse_squares[1], right * right * wedge.inverse_squares[2]);
            let bound = off * off * wedge.inverse_squares[0] + tangential;
            self.bounds.push(bound);
            if bound < least {
                (first, least) = (k, bound);
            }
        }
        let look = |k: usize| {
            let wedge = &self.wedges[k];
            let (squared, weights) = closest_on_facet(p, wedge.corners, wedge.ids);
            Nearest { squared, facet: wedge.facet, weights }
        };
        if self.wedges.is_empty() {
            return Nearest { squared: f64::INFINITY, facet: u32::MAX, weights: [0.0; 3] };
        }
        let (mut best, mut place) = (look(first), first);
        for (k, &bound) in self.bounds.iter().enumerate() {
            if k != first && bound * BOUND_ROUNDING <= best.squared + ROUNDING_SQUARED {
                let here = look(k);
                if here.squared < best.squared || (here.squared == best.squared && k < place) {
                    (best, place) = (here, k);
                }
            }
        }
        best
    }
}

pub(crate) struct HausdorffEstimate {
    /// Places of the input that were missed; see [`missed_places`].
    pub(crate) missed: Places,
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
        Self { missed, largest, by_vertex: tasks::map(mesh.positions.len(), |v| around(v as u32)) }
    }
}

/// Where a vertex of the input lies, seen from the result.
#[derive(Clone, Copy, Default)]
struct Deviation {
    /// From the nearest facet.
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
    let measure = |(query, at, pace): &mut (RingQuery, u32, Pace), k: usize| -> Result<Deviation, Stopped> {
        let (owner, vertex) = (owners[k], vertices.all()[k]);
        token.check_after(WORK_PER_POINT, pace)?;
        if *at != owner {
            query.move_to(mesh, owner);
            *at = owner;
        }
        Ok(deviation(mesh, query, vertex))
    };
    tasks::try_map(owners.len(), begin, measure).unwrap_or_else(|_| vec![UNKNOWN; owners.len()])
}

fn deviation(mesh: &LocalMesh, query: &mut RingQuery, vertex: DVec3) -> Deviation {
    let found = query.nearest(vertex);
    let Some(&t) = mesh.facets().get(found.facet as usize) else { return UNKNOWN };
    let p = mesh.places(t);
    let edge = perimeter(p) / 3.0;
    let to = p.map(|q| q.distance_squared(vertex));
    let corner = match to {
        [a, b, c] if a <= b && a <= c => t[0],
        [_, b, c] if b <= c => t[1],
        _ => t[2],
    };
    let distance = found.squared.sqrt();
    Deviation { distance, relative: if edge > 0.0 { distance / edge } else { 0.0 }, corner }
}

/// Of the input, each with the nearest vertex of the result.
type Places = Vec<(u32, DVec3)>;

/// Places of the input that are farther from the result than `tolerance`, or than a share of an edge where that is
/// `None`: (nearest vertex of the result, place) by falling deviation. No two are in one one-ring.
pub(crate) fn missed_places(mesh: &LocalMesh, input: &InputSamples, tolerance: Option<f64>, token: &Token) -> Places {
    select(mesh, &input.vertices, &deviations(mesh, &input.vertices, token), tolerance)
}

/// The vertices of the input by falling estimate of their distance: (estimate, place). The distance is at most that.
pub(crate) fn farthest_places(mesh: &LocalMesh, input: &InputSamples, token: &Token) -> Vec<(f64, DVec3)> {
    let deviations = deviations(mesh, &input.vertices, token);
    let mut all: Vec<_> = input.vertices.all().iter().zip(&deviations).map(|(&p, d)| (d.distance, p)).collect();
    // Stable: of places that are as far, the first stays the first.
    all.par_sort_by(|a, b| b.0.total_cmp(&a.0));
    all
}

fn select(mesh: &LocalMesh, vertices: &Csr<DVec3>, deviations: &[Deviation], tolerance: Option<f64>) -> Places {
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
    let own = |v: u32| match token.check_at(WORK_PER_POINT * v as usize) {
        Err(_) => 0.0,
        Ok(()) => distance(mesh.positions[v as usize], [samples.of(v)]),
    };
    let by_vertex = tasks::map(mesh.positions.len(), |v| own(v as u32));
    let of = |t: &[u32; 3]| {
        let [a, b, c] = mesh.places(*t);
        let centroid = distance((a + b + c) / 3.0, t.map(|v| samples.of(v)));
        t.iter().map(|&v| by_vertex[v as usize]).fold(centroid, f64::max)
    };
    tasks::map(mesh.facets().len(), |f| of(&mesh.facets()[f]))
}

/// Distance of `p` from the tangent plane of the nearest sample, or from that if it is not below. 0 without samples.
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

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;

    #[test]
    fn the_same_as_looking_at_all() {
        let number = |k: u32| f64::from(k.wrapping_mul(2_654_435_761) >> 8) / f64::from(1 << 24) - 0.5;
        let point = |k: u32| DVec3::new(number(3 * k), number(3 * k + 1), number(3 * k + 2));
        let mut query = RingQuery::default();
        for round in 0..200 {
            // A bumpy wheel; one in four has a facet without area. Another one is flat, with points on its spokes.
            let mut positions = vec![0.1 * point(round)];
            positions.extend((0..7).map(|k| {
                let (sin, cos) = (f64::from(k) / 7.0 * std::f64::consts::TAU).sin_cos();
                DVec3::new(cos, sin, 0.0) + 0.4 * point(1000 + 7 * round + k)
            }));
            if round % 4 == 0 {
                positions[3] = positions[4];
            }
            let is_flat = round % 4 == 1;
            if is_flat {
                positions.iter_mut().for_each(|p| p.z = 0.3 * p.x - 0.7 * p.y);
            }
            let facets: Vec<[u32; 3]> = (0..7).map(|k| [1 + k, 1 + (k + 1) % 7, 0]).collect();
            query.move_to(&LocalMesh::new(positions.clone(), facets.clone(), HashSet::new()), 0);
            for k in 0..50 {
                let spoke = positions[0].lerp(positions[1 + k as usize % 7], number(k) + 0.5);
                let p = if is_flat { spoke } else { 2.0 * point(100_000 + 50 * round + k) };
                let all = facets.iter().map(|t| closest_on_facet(p, t.map(|v| positions[v as usize]), *t).0);
                let (facet, squared) =
                    all.enumerate().reduce(|a, b| if b.1 < a.1 { b } else { a }).unwrap_or((0, f64::INFINITY));
                let found = query.nearest(p);
                assert_eq!((found.facet as usize, found.squared), (facet, squared));
            }
        }
        query.move_to(&LocalMesh::new(vec![DVec3::ZERO], Vec::new(), HashSet::new()), 0);
        assert_eq!(query.nearest(DVec3::ONE).facet, u32::MAX);
    }
}
