//! Refinement to a tolerance.
//!
//! Purpose: [`refine`] remeshes again and again, each time with shorter edges where the last result was too far from the
//! input. The distance of a facet from a smooth surface falls with the square of its edges, so a few rounds do. Shorter edges
//! that grade into the others keep triangles round. Seeds that are only added do not: steps spread them out again, and with as
//! many added as there were, 6 to 10 % of the triangles of the bunny and the rocker-arm had angles under 30 degrees.
//! Invariant: never more points than allowed; the best result of all rounds comes back.
//! Must not know: how a surface is made.

use super::attempt::Attempt;
use super::job::{Job, enter};
use super::prepare::{Prepared, prepare};
use crate::cvt::density::{DensityError, DensityOptions, DensitySource};
use crate::mesh::closest_point::ClosestPoint;
use crate::remesh::constants::{FEW_MISSED, FEW_MISSED_SHARE, MAX_REFINING_ROUNDS, SHORTEST_SHARE, TOLERANCE_AIM};
use crate::remesh::{Refine, RemeshError, RemeshOptions, Seeds};

/// How far the input's vertices are from a result.
struct InputDistances {
    /// By vertex, caller's units; 0 where no facet has the vertex.
    by_vertex: Vec<f64>,
    /// Those beyond the tolerance.
    missed: usize,
    largest: f64,
}

impl InputDistances {
    fn of(job: &mut Job<'_, '_>, attempt: &Attempt<'_>, tolerance: f64) -> Result<Self, RemeshError> {
        let tree = ClosestPoint::new(&attempt.built.mesh);
        let mut distances = tree.distances(job.mesh.positions(), job.token)?;
        let mut used = vec![false; distances.len()];
        let live = (0..job.mesh.facets().len()).filter(|&f| !job.mesh.is_degenerate(f));
        live.flat_map(|f| job.mesh.facets()[f]).for_each(|v| used[v as usize] = true);
        distances.iter_mut().zip(&used).filter(|(_, used)| !**used).for_each(|(d, _)| *d = 0.0);
        let missed = distances.iter().filter(|&&d| d > tolerance).count();
        let largest = distances.iter().copied().fold(0.0, f64::max);
        job.laps.timings.refine += job.laps.lap();
        Ok(Self { by_vertex: distances, missed, largest })
    }

    fn is_better(&self, other: &Self) -> bool {
        (self.missed, self.largest) < (other.missed, other.largest)
    }
}

/// The best result so far.
struct Best<'a> {
    attempt: Attempt<'a>,
    distances: InputDistances,
    options: RemeshOptions,
    /// Passes over the diagram that the other results took.
    passes_of_others: usize,
}

impl<'a> Best<'a> {
    /// Takes another result if it is better. Returns its distances if it is not.
    fn offer(
        &mut self,
        attempt: Attempt<'a>,
        distances: InputDistances,
        options: &RemeshOptions,
    ) -> Option<InputDistances> {
        let passes = |a: &Attempt<'_>| {
            a.figures.refine.evaluations + a.figures.iterations.iter().map(|step| step.evaluations).sum::<usize>()
        };
        if !distances.is_better(&self.distances) {
            self.passes_of_others += passes(&attempt);
            return Some(distances);
        }
        self.passes_of_others += passes(&self.attempt);
        (self.attempt, self.distances, self.options) = (attempt, distances, options.clone());
        None
    }
}

/// Remeshes from what is prepared for `options`, with more points where the result is too far from the input.
pub(super) fn refine<'a>(
    job: &mut Job<'a, '_>,
    prepared: Prepared<'a>,
    options: &RemeshOptions,
    limits: Refine,
    seed: u64,
) -> Result<Attempt<'a>, RemeshError> {
    let Refine { tolerance, max_points } = limits;
    let mut options = RemeshOptions { refine: None, ..options.clone() };
    let attempt = job.attempt(prepared, &options, Some(tolerance))?;
    let begin = attempt.seeds.len();
    let mut lengths = attempt.plan.lengths(job.mesh, job.token)?;
    let distances = InputDistances::of(job, &attempt, tolerance)?;
    let mut best = Best { attempt, distances, options: options.clone(), passes_of_others: 0 };
    // Distances of the last result if it was not the best.
    let mut worse: Option<InputDistances> = None;
    let max_points = max_points.max(begin);
    let mut full = false;
    let mut rounds = 0;
    // Once the points are used up, rounds go on as long as they make better use of them.
    while rounds < MAX_REFINING_ROUNDS && best.distances.missed > 0 && !(full && worse.is_some()) {
        rounds += 1;
        let distances = worse.as_ref().unwrap_or(&best.distances);
        lengths.iter_mut().zip(&distances.by_vertex).filter(|(_, d)| **d > TOLERANCE_AIM * tolerance).for_each(
            |(length, d)| {
                *length *= (TOLERANCE_AIM * tolerance / d).sqrt().max(SHORTEST_SHARE);
            },
        );
        let source = DensitySource::Sizes(lengths);
        options.density = DensityOptions { source, edge_length: None, adaptivity: 1.0, max_points, ..options.density };
        options.seeds = Seeds::Implied { seed };
        enter(job.observer, job.token, "prepare");
        let prepared = match prepare(job.mesh, &options, job.token) {
            Err(RemeshError::Density(DensityError::TooManyPoints { .. })) => {
                full = true;
                options.seeds = Seeds::Sample { points: max_points, seed };
                prepare(job.mesh, &options, job.token)?
            }
            prepared => prepared?,
        };
        let next = job.attempt(prepared, &options, Some(tolerance))?;
        lengths = next.plan.lengths(job.mesh, job.token)?;
        let distances = InputDistances::of(job, &next, tolerance)?;
        worse = best.offer(next, distances, &options);
    }
    let few = FEW_MISSED.max((FEW_MISSED_SHARE * best.attempt.seeds.len() as f64) as usize);
    if (1..=few).contains(&best.distances.missed) && best.attempt.seeds.len() < max_points {
        // The best again, with a few seeds more.
        rounds += 1;
        let options = RemeshOptions { refine: Some(limits), ..best.options.clone() };
        enter(job.observer, job.token, "prepare");
        let next = job.attempt(prepare(job.mesh, &options, job.token)?, &options, Some(tolerance))?;
        let distances = InputDistances::of(job, &next, tolerance)?;
        best.offer(next, distances, &options);
    }
    job.laps.timings.refine += job.laps.lap();
    let figures = &mut best.attempt.figures.refine;
    figures.rounds += rounds;
    figures.added_seeds = best.attempt.seeds.len().saturating_sub(begin);
    figures.evaluations += best.passes_of_others;
    figures.out_of_tolerance = best.distances.missed;
    Ok(best.attempt)
}
