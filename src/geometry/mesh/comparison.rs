//! Distances between a surface and others, both ways.
//!
//! Purpose: [`Comparison`] measures at samples of facets, edges and vertices of either surface, and finds the vertices of
//! the first near places beyond the tolerance. The samples include those of [`quality`](super::measure::quality), whose
//! Hausdorff distance is therefore never larger.
//! Invariant: the same bits for any number of threads.
//! Must not know: the making of results, the reaction.

use super::TriMesh;
use super::closest_point::ClosestPoint;
use super::measure::{Probe, probes};
use crate::token::{Stopped, Token};

/// The input, ready to be compared with results.
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
    /// Share of all samples that are farther off than allowed.
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
    /// Takes the samples of the input.
    pub(crate) fn new(input: &'a TriMesh, tolerance: f64, token: &Token) -> Result<Self, Stopped> {
        let samples = probes(input, token)?;
        Ok(Self { input, closest: ClosestPoint::new(input), samples, tolerance })
    }

    /// Measures a result.
    pub(crate) fn with(&self, result: &TriMesh, token: &Token) -> Result<Distances, Stopped> {
        let places = |samples: &[Probe]| samples.iter().map(|s| s.position).collect::<Vec<_>>();
        let there = || ClosestPoint::new(result).distances(&places(&self.samples), token);
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
