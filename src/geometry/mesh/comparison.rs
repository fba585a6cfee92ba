//! Distances between a surface and others, both ways, and parts that others lack.
//!
//! Purpose: [`Comparison`] measures at samples of facets, edges and vertices of either surface, and finds the vertices of
//! the first near places beyond the tolerance. The samples include those of [`quality`](super::measure::quality), whose
//! Hausdorff distance is therefore never larger. [`lost_parts`] groups the facets that are farther from a result than an
//! edge of it into connected parts, with place and reason. Invariant: the same bits for any number of threads. Lost parts
//! are sorted by falling area. Must not know: the making of results, the reaction.

use serde::Serialize;

use super::adjacency::{Adjacency, EdgeKind};
use super::closest_point::ClosestPoint;
use super::edges::DisjointSets;
use super::measure::{Probe, probes};
use super::{TriMesh, normal};
use crate::token::{Stopped, Token};

pub(crate) struct Comparison<'a> {
    input: &'a TriMesh,
    closest: ClosestPoint,
    samples: Vec<Probe>,
    /// Samples farther away than this are off, caller's units.
    tolerance: f64,
}

/// How far a result and the input are from each other, caller's units.
pub(crate) struct Distances {
    /// The largest distance near each vertex of the input; 0 without a sample.
    pub by_vertex: Vec<f64>,
    /// Number of samples that are farther off than allowed.
    pub missed: usize,
    pub missed_share: f64,
    pub largest: f64,
}

impl Distances {
    fn add(&mut self, probe: &Probe, distance: f64, tolerance: f64) {
        self.missed += usize::from(distance > tolerance);
        self.largest = self.largest.max(distance);
        for &v in &probe.vertices {
            let own = &mut self.by_vertex[v as usize];
            *own = own.max(distance);
        }
    }
}

impl<'a> Comparison<'a> {
    pub(crate) fn new(input: &'a TriMesh, tolerance: f64, token: &Token) -> Result<Self, Stopped> {
        let samples = probes(input, token)?;
        Ok(Self { input, closest: ClosestPoint::unless(input, token)?, samples, tolerance })
    }

    pub(crate) fn with(&self, result: &TriMesh, token: &Token) -> Result<Distances, Stopped> {
        let places = |samples: &[Probe]| samples.iter().map(|s| s.position).collect::<Vec<_>>();
        let there = || ClosestPoint::unless(result, token)?.distances(&places(&self.samples), token);
        let back = || -> Result<_, Stopped> {
            let places = places(&probes(result, token)?);
            let points = self.closest.project_all(&places, token)?;
            Ok((places, points))
        };
        let (there, back) = rayon::join(there, back);
        let (there, (places, points)) = (there?, back?);
        let by_vertex = vec![0.0; self.input.positions().len()];
        let mut found = Distances { by_vertex, missed: 0, missed_share: 0.0, largest: 0.0 };
        self.samples.iter().zip(&there).for_each(|(probe, &d)| found.add(probe, d, self.tolerance));
        for (place, point) in places.iter().zip(&points) {
            found.add(&Probe::of(self.input, point), place.distance(point.position), self.tolerance);
        }
        found.missed_share = found.missed as f64 / (there.len() + points.len()).max(1) as f64;
        Ok(found)
    }
}

/// Distance from the result, in mean edges, from which a facet is lost rather than deviating.
const LOST_EDGES: f64 = 1.0;
/// Parts that are named, at most: a report of a bad scan stays one that can be read.
const MOST_LOST_PARTS: usize = 16;

/// Parts of the input that are farther from the result than an edge of it.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct LostParts {
    /// Number of connected parts.
    pub count: usize,
    /// Their area, percent of the input's.
    pub area_percent: f64,
    /// The largest of them.
    pub parts: Vec<LostPart>,
}

/// One part of the input that the result lacks.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LostPart {
    /// The vertex of it that is farthest from the result, caller's coordinates.
    pub place: [f64; 3],
    /// Facets.
    pub facets: usize,
    /// Percent of the input's area.
    pub area_percent: f64,
    /// Distance of that vertex from the result, percent of the input's bounding-box diagonal.
    pub distance_percent: f64,
    /// Reason of the loss.
    pub reason: LostReason,
}

/// Why a part is not in the result.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum LostReason {
    /// A connected component of its own, smaller than its share of points can show.
    Component,
    /// A part at an edge of more than two facets.
    NonManifold,
    /// A part at a boundary, narrower than an edge.
    Boundary,
    /// A part thinner than an edge.
    Thin,
}

/// Returns the parts of `mesh` that `result` lacks, given the distances of the vertices of `mesh`.
pub(crate) fn lost_parts(mesh: &TriMesh, result: &TriMesh, apart: &[f64], token: &Token) -> Result<LostParts, Stopped> {
    // Scaled, so that the squares of a tiny or huge box stay within range.
    let (low, high) = mesh.bounds();
    let (extent, diagonal) = ((high - low).max_element(), ((high - low) / (high - low).max_element()).length());
    let size = |mesh: &TriMesh, f: usize| normal(mesh.corners(f).map(|p| (p - low) / extent)).length() / 2.0;
    let area = |mesh: &TriMesh| (0..mesh.facets().len()).map(|f| size(mesh, f)).sum::<f64>();
    // The edge of equilateral triangles of the result's area and number.
    let edge = extent * (4.0 / 3f64.sqrt() * area(result) / result.facets().len().max(1) as f64).sqrt();
    let far = |v: u32| apart[v as usize] > LOST_EDGES * edge;
    let is_lost = |f: usize| mesh.facets()[f].into_iter().any(far) && !mesh.is_degenerate(f);
    if !(0..apart.len() as u32).any(far) {
        return Ok(LostParts::default());
    }
    let adjacency = Adjacency::unless(mesh, token)?;
    let vertex = |v: u32| adjacency.representative()[v as usize] as usize;
    // Connected components of the lost facets, and of all.
    let (mut lost, mut all) = (DisjointSets::new(apart.len()), DisjointSets::new(apart.len()));
    for (f, &[a, b, c]) in mesh.facets().iter().enumerate() {
        token.check_at(f)?;
        for pair in [[a, b], [b, c]].map(|pair| pair.map(vertex)) {
            all.join(pair[0], pair[1]);
            if is_lost(f) {
                lost.join(pair[0], pair[1]);
            }
        }
    }
    let mut facets: Vec<(usize, usize)> =
        (0..mesh.facets().len()).filter(|&f| is_lost(f)).map(|f| (lost.root(vertex(mesh.facets()[f][0])), f)).collect();
    facets.sort_unstable();
    let mut beside = vec![false; apart.len()];
    (0..mesh.facets().len()).filter(|&f| !is_lost(f) && !mesh.is_degenerate(f)).for_each(|f| {
        beside[all.root(vertex(mesh.facets()[f][0]))] = true;
    });
    let area = area(mesh);
    let mut parts: Vec<LostPart> = facets
        .chunk_by(|a, b| a.0 == b.0)
        .map(|part| {
            let corners = || part.iter().flat_map(|&(_, f)| mesh.facets()[f]);
            let farthest = corners().max_by(|&a, &b| apart[a as usize].total_cmp(&apart[b as usize]).then(b.cmp(&a)));
            let at = farthest.unwrap_or_default() as usize;
            let has = |kind| part.iter().any(|&(_, f)| (0..3).any(|e| adjacency.kind(3 * f + e) == kind));
            let reason = if !beside[all.root(part[0].0)] {
                LostReason::Component
            } else if has(EdgeKind::NonManifold) {
                LostReason::NonManifold
            } else if has(EdgeKind::Boundary) {
                LostReason::Boundary
            } else {
                LostReason::Thin
            };
            LostPart {
                place: mesh.positions()[at].to_array(),
                facets: part.len(),
                area_percent: 100.0 * part.iter().map(|&(_, f)| size(mesh, f)).sum::<f64>() / area,
                distance_percent: 100.0 * apart[at] / extent / diagonal,
                reason,
            }
        })
        .collect();
    parts.sort_by(|a, b| b.area_percent.total_cmp(&a.area_percent));
    let (count, area_percent) = (parts.len(), parts.iter().map(|part| part.area_percent).sum());
    parts.truncate(MOST_LOST_PARTS);
    Ok(LostParts { count, area_percent, parts })
}
