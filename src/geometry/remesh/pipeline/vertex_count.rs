//! The number of vertices.
//!
//! Purpose: [`Job::scale_seeds`] draws fewer seeds where the result would have more vertices than were asked for: a cell that
//! reaches through to another sheet or part has a vertex for each of its components. How many vertices a seed has changes
//! little with the number of seeds, so a few rounds do. Seeds on parts without thickness, which have no vertex, are moved
//! later.
//! Invariant: the nearest count of all rounds comes back; a count within the limit takes no round; never more seeds than
//! vertices that were asked for, for which memory was planned.
//! Must not know: how the vertices are placed.

use super::job::Job;
use super::optimize::Optimized;
use super::prepare::with_source;
use crate::cvt::density::DensitySource;
use crate::mesh::measure::Topology;
use crate::remesh::constants::{
    COUNT_LIMIT, COUNT_SLACK, FEWEST_SEEDS, FEWEST_SEEDS_SHARE, LEAST_SLOPE, MAX_COUNT_ROUNDS, VAIN_STRETCH,
};
use crate::remesh::report::CountReason;
use crate::remesh::{RemeshError, RemeshOptions, Seeds};

/// Whether a number of vertices is near enough to what was asked for.
fn is_near(vertices: usize, asked: usize) -> bool {
    vertices.abs_diff(asked) <= COUNT_SLACK.max((COUNT_LIMIT * asked as f64) as usize)
}

/// Why a result with this number of vertices and parts does not have as many as were asked for; `None` if it has.
pub(super) fn reason(
    (vertices, parts): (usize, usize),
    asked: usize,
    seeds: &Seeds,
    surface: &Topology,
) -> Option<CountReason> {
    if is_near(vertices, asked) {
        return None;
    }
    Some(match seeds {
        Seeds::Given(_) => CountReason::GivenSeeds,
        _ if vertices > asked && surface.fewest_vertices() > asked => CountReason::Parts,
        _ if vertices > asked => CountReason::CloseSheets,
        _ if parts < surface.components => CountReason::SmallParts,
        _ => CountReason::NoThickness,
    })
}

impl<'a> Job<'a, '_> {
    /// Seeds that result in as many vertices as were asked for, or as near to that as fewer seeds and a few rounds come.
    pub(super) fn scale_seeds(
        &mut self,
        optimized: Optimized<'a>,
        options: &RemeshOptions,
    ) -> Result<Optimized<'a>, RemeshError> {
        let mut best = optimized;
        let (&Seeds::Sample { seed, .. } | &Seeds::Implied { seed }) = &options.seeds else { return Ok(best) };
        let asked = best.figures.asked;
        let least = (FEWEST_SEEDS_SHARE * asked as f64).max(FEWEST_SEEDS).min(asked as f64);
        // Seeds and vertices of the best.
        let mut from = (asked as f64, best.vertices() as f64);
        // Vertices per further seed, and how much farther to go than that says.
        let (mut slope, mut stretch) = (from.1 / from.0, 1.0);
        for round in 1..=MAX_COUNT_ROUNDS {
            if !self.scales_seeds || is_near(best.vertices(), asked) {
                break;
            }
            let drawn = (from.0 + stretch * (asked as f64 - from.1) / slope).clamp(least, asked as f64).round();
            if drawn == from.0 {
                break;
            }
            // Shorter edges in thin parts stay.
            let options = match best.figures.refine.closed_ball_rounds {
                0 => options.clone(),
                _ => with_source(options, DensitySource::Sizes(best.plan.lengths(self.separated, self.token)?)),
            };
            let options = options.with_seeds(Seeds::Sample { points: drawn as usize, seed });
            let Some(prepared) = self.prepare_again(&options)? else { break };
            let Some(mut next) = self.optimize_again(prepared, &options)? else { break };
            let here = (drawn, next.vertices() as f64);
            if next.vertices().abs_diff(asked) < best.vertices().abs_diff(asked) {
                next.take_over(&best);
                next.figures.refine.count_rounds = round;
                best = next;
                let between = (here.1 - from.1) / (here.0 - from.0);
                slope = between.clamp(LEAST_SLOPE, (here.1 / here.0).max(LEAST_SLOPE));
                (from, stretch) = (here, 1.0);
            } else {
                stretch *= VAIN_STRETCH;
                best.figures.refine.evaluations += next.figures.passes();
            }
        }
        Ok(best)
    }
}
