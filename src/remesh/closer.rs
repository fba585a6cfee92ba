//! A remesh that is nowhere farther from the input than a tolerance.
//!
//! Purpose: [`find`] makes remesh after remesh, each with shorter edges where the one before was too far from the
//! input. How far a facet is from a smooth surface goes by the square of its edges, so that a few rounds do.
//! Shorter edges that grade into the others keep triangles round; seeds that are only added where the result was far
//! do not: steps spread them out again, and with as many added as there were 6 to 10 % of the triangles of the bunny and the
//! rocker-arm had angles under 30 degrees.
//! Invariant: never more points than allowed; the result is the best of all rounds.
//! Must not know: how a surface is made.

use super::{Attempt, Job, Prepared, Refine, RemeshError, RemeshOptions, Seeds, enter, prepare};
use crate::cvt::density::{DensityError, DensityOptions, DensitySource};
use crate::mesh::closest_point::ClosestPoint;

/// Remeshes with shorter edges, at most.
const ROUNDS: usize = 5;
/// Edges are made as short as would bring a vertex to this share of the tolerance: the largest distances
/// around one are some half more than the mean.
const AIM: f64 = 0.7;
/// But in one round not shorter than this share of what they were: at a crease that was not kept distances go by
/// lengths themselves, and there may be other causes.
const SHORTEST: f64 = 0.35;
/// Where no more than this share of the seeds, or so many, would have to be added, that is done after the last round.
const FEW: (f64, usize) = (0.01, 4);

/// How far the input's vertices are from a result.
struct Far {
    /// Each of them, caller's units; 0 where no facet has the vertex.
    distances: Vec<f64>,
    /// Those beyond the tolerance.
    missed: usize,
    most: f64,
}

impl Far {
    fn of(job: &mut Job<'_, '_>, attempt: &Attempt<'_>, tolerance: f64) -> Result<Self, RemeshError> {
        let tree = ClosestPoint::new(&attempt.built.mesh);
        let mut distances = tree.distances(job.mesh.positions(), job.token)?;
        let mut used = vec![false; distances.len()];
        let live = (0..job.mesh.facets().len()).filter(|&f| !job.mesh.is_degenerate(f));
        live.flat_map(|f| job.mesh.facets()[f]).for_each(|v| used[v as usize] = true);
        distances.iter_mut().zip(&used).filter(|(_, used)| !**used).for_each(|(d, _)| *d = 0.0);
        let missed = distances.iter().filter(|&&d| d > tolerance).count();
        let most = distances.iter().copied().fold(0.0, f64::max);
        job.laps.timings.refine += job.laps.clock.lap();
        Ok(Self { distances, missed, most })
    }

    fn is_better(&self, other: &Self) -> bool {
        (self.missed, self.most) < (other.missed, other.most)
    }
}

/// The best result so far.
struct Best<'a> {
    attempt: Attempt<'a>,
    far: Far,
    options: RemeshOptions,
    /// Passes over the diagram that other results took.
    spent: usize,
}

impl<'a> Best<'a> {
    /// Takes another one if it is better. Returns how far that one is from the input if it is not.
    fn offer(&mut self, attempt: Attempt<'a>, far: Far, options: &RemeshOptions) -> Option<Far> {
        let passes = |a: &Attempt<'_>| {
            a.steps.refine.evaluations + a.steps.iterations.iter().map(|step| step.evaluations).sum::<usize>()
        };
        if !far.is_better(&self.far) {
            self.spent += passes(&attempt);
            return Some(far);
        }
        self.spent += passes(&self.attempt);
        (self.attempt, self.far, self.options) = (attempt, far, options.clone());
        None
    }
}

/// Remeshes from what is prepared for `options`, with more points where the result is too far from the input.
pub(super) fn find<'a>(
    job: &mut Job<'a, '_>,
    prepared: Prepared<'a>,
    options: &RemeshOptions,
    refine: Refine,
    seed: u64,
) -> Result<Attempt<'a>, RemeshError> {
    let Refine { tolerance, max_points } = refine;
    let mut options = RemeshOptions { refine: None, ..options.clone() };
    let attempt = job.attempt(prepared, &options, Some(tolerance))?;
    let begin = attempt.seeds.len();
    let mut lengths = attempt.plan.lengths(job.mesh, job.token)?;
    let far = Far::of(job, &attempt, tolerance)?;
    let mut best = Best { attempt, far, options: options.clone(), spent: 0 };
    // What the last result was like if it was not the best.
    let mut worse: Option<Far> = None;
    let max_points = max_points.max(begin);
    let mut full = false;
    let mut rounds = 0;
    // Where there are no more points, rounds go on as long as they make better use of them.
    while rounds < ROUNDS && best.far.missed > 0 && !(full && worse.is_some()) {
        rounds += 1;
        let far = worse.as_ref().unwrap_or(&best.far);
        lengths.iter_mut().zip(&far.distances).filter(|(_, d)| **d > AIM * tolerance).for_each(|(length, d)| {
            *length *= (AIM * tolerance / d).sqrt().max(SHORTEST);
        });
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
        let far = Far::of(job, &next, tolerance)?;
        worse = best.offer(next, far, &options);
    }
    let few = FEW.1.max((FEW.0 * best.attempt.seeds.len() as f64) as usize);
    if (1..=few).contains(&best.far.missed) && best.attempt.seeds.len() < max_points {
        // The same again, and a few more.
        rounds += 1;
        let options = RemeshOptions { refine: Some(refine), ..best.options.clone() };
        enter(job.observer, job.token, "prepare");
        let next = job.attempt(prepare(job.mesh, &options, job.token)?, &options, Some(tolerance))?;
        let far = Far::of(job, &next, tolerance)?;
        best.offer(next, far, &options);
    }
    job.laps.timings.refine += job.laps.clock.lap();
    let figures = &mut best.attempt.steps.refine;
    figures.rounds += rounds;
    figures.added_seeds = best.attempt.seeds.len().saturating_sub(begin);
    figures.evaluations += best.spent;
    figures.missed = best.far.missed;
    Ok(best.attempt)
}
