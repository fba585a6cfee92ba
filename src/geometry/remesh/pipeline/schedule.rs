//! The steps of a remesh.
//!
//! Purpose: [`Schedule`] takes Lloyd and quasi-Newton steps until they converge or are used up. Further steps follow when seeds
//! were pushed off curves, added where the result is far from the input, or moved because they produced no vertex.
//! Invariant: the report's iterations are the steps that were asked for; further steps are counted apart.
//! Must not know: how a surface is made of the seeds.

use glam::DVec3;

use super::extract::Missed;
use super::job::Job;
use super::prepare::Metric;
use crate::cvt::{Cvt, Iteration};
use crate::remesh::constants::{CLEARING_ROUNDS, CLEARING_STEPS, REFINING_STEPS, ROUNDING};
use crate::remesh::report::{FinalFigures, IterationFigures, RefineFigures};
use crate::remesh::{RemeshError, RemeshOptions};
use crate::rvd::RvdFigures;

#[derive(Default)]
pub(super) struct Figures {
    pub(super) seed: Option<u64>,
    pub(super) asked: usize,
    /// Whether the steps that were asked for converged, and where they ended.
    pub(super) converged: bool,
    pub(super) last: FinalFigures,
    pub(super) rvd: RvdFigures,
    pub(super) iterations: Vec<IterationFigures>,
    pub(super) refine: RefineFigures,
}

impl Figures {
    pub(super) fn passes(&self) -> usize {
        self.refine.evaluations + self.iterations.iter().map(|step| step.evaluations).sum::<usize>()
    }
}

pub(super) struct Schedule<'s, 'a, 'b> {
    pub(super) job: &'s mut Job<'a, 'b>,
    pub(super) options: &'s RemeshOptions,
    pub(super) figures: Figures,
}

impl Schedule<'_, '_, '_> {
    /// The steps that were asked for.
    pub(super) fn main<P: Metric>(&mut self, cvt: &mut Cvt<P>) -> Result<(), RemeshError> {
        let (planned, token) = (self.options.lloyd + self.options.newton, self.job.token);
        while self.figures.iterations.len() < planned && !cvt.converged() {
            let lloyd = self.options.lloyd.saturating_sub(self.figures.iterations.len());
            let is_watched = self.job.observer.wants_seeds();
            let at_once = if is_watched { lloyd.min(1) } else { lloyd };
            let steps = if at_once > 0 { cvt.relax(at_once, token)? } else { vec![cvt.lbfgs(token)?] };
            for step in steps {
                self.count(&step);
                self.job.observer.iteration(&step, planned);
                self.figures.iterations.push(IterationFigures::of(&step));
            }
            if is_watched {
                self.job.observer.seeds(self.figures.iterations.len(), &cvt.seeds()?);
            }
        }
        self.figures.last = FinalFigures::of(&cvt.present(token)?);
        // Further steps may leave it converged or not.
        self.figures.converged = cvt.converged();
        Ok(())
    }

    fn count(&mut self, step: &Iteration) {
        self.figures.rvd.add_pass(&step.stats);
        self.figures.rvd.reseeded_cells += step.empty_cells;
    }

    /// Further steps: one of Lloyd's, then quasi-Newton steps.
    fn further<P: Metric>(&mut self, cvt: &mut Cvt<P>, steps: usize) -> Result<(), RemeshError> {
        for k in 0..steps {
            let step = if k > 0 { cvt.lbfgs(self.job.token)? } else { cvt.lloyd(self.job.token)? };
            self.count(&step);
            self.figures.refine.evaluations += step.evaluations;
        }
        Ok(())
    }

    /// Clears the curves of seeds that are not theirs.
    pub(super) fn clear_curves<P: Metric>(&mut self, cvt: &mut Cvt<P>) -> Result<(), RemeshError> {
        for round in 1..=CLEARING_ROUNDS {
            let in_the_way = match round < CLEARING_ROUNDS {
                true => cvt.clear_curves(self.job.token)?,
                false => cvt.adopt_intruders(self.job.token)?,
            };
            if in_the_way == 0 {
                break;
            }
            self.further(cvt, CLEARING_STEPS)?;
        }
        Ok(())
    }

    /// Adds seeds at missed places, each with the nearest seed, and takes further steps. Returns whether any was added.
    pub(super) fn add_seeds<P: Metric>(
        &mut self,
        cvt: &mut Cvt<P>,
        places: &[(u32, DVec3)],
    ) -> Result<bool, RemeshError> {
        // A second seed in one place would be a duplicate.
        let seeds = cvt.unit_places()?;
        let apart = |p: &&(u32, DVec3)| seeds[p.0 as usize].distance(p.1) > ROUNDING;
        let places: Vec<DVec3> = places.iter().filter(apart).map(|p| p.1).collect();
        let added = cvt.pin(&[], &places)?;
        self.figures.refine.added_seeds += added;
        self.refine(cvt, added)
    }

    /// Moves seeds without a vertex to where edges are long, and takes further steps. Returns whether there were any.
    pub(super) fn move_seeds<P: Metric>(&mut self, cvt: &mut Cvt<P>, missed: &Missed) -> Result<bool, RemeshError> {
        let pins: Vec<(u32, DVec3)> =
            missed.seeds_without_vertex.iter().copied().zip(missed.long_edge_midpoints.iter().copied()).collect();
        if !pins.is_empty() {
            cvt.pin(&pins, &[])?;
        }
        self.figures.refine.moved_seeds += pins.len();
        self.refine(cvt, pins.len())
    }

    fn refine<P: Metric>(&mut self, cvt: &mut Cvt<P>, changed: usize) -> Result<bool, RemeshError> {
        if changed > 0 {
            self.figures.refine.rounds += 1;
            self.further(cvt, REFINING_STEPS)?;
        }
        Ok(changed > 0)
    }
}
