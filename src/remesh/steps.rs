//! The steps of a remesh.
//!
//! Purpose: Lloyd and quasi-Newton steps until they converge or are used up; steps that clear the curves; and
//! rounds in which seeds are added where the result is far from the input, or moved where they have no vertex.
//! Invariant: what is reported as iterations are the steps that were asked for; the others are counted apart.
//! Must not know: how a surface is made of the seeds.

use glam::DVec3;

use super::build::Missed;
use super::report::{FinalFigures, IterationFigures, RefineFigures, RvdFigures};
use super::{Observer, RemeshError, RemeshOptions};
use crate::cvt::{Cvt, Iteration};
use crate::token::Token;

/// Times that seeds are pushed off curves after the last step, the last time taken up by them, and
/// steps after each.
const CLEARINGS: usize = 2;
const CLEARING_STEPS: usize = 3;
/// Steps after seeds were moved or added for what was missed.
const REFINING_STEPS: usize = 6;

/// Takes the steps of one remesh.
pub(super) struct Steps<'a> {
    pub(super) options: &'a RemeshOptions,
    pub(super) observer: &'a mut dyn Observer,
    pub(super) token: &'a Token,
    pub(super) rvd: RvdFigures,
    pub(super) iterations: Vec<IterationFigures>,
    pub(super) refine: RefineFigures,
}

impl Steps<'_> {
    /// The steps that were asked for. Returns what they came to.
    pub(super) fn main(&mut self, cvt: &mut Cvt) -> Result<FinalFigures, RemeshError> {
        let planned = self.options.lloyd + self.options.newton;
        while self.iterations.len() < planned && !cvt.converged() {
            let lloyd = self.options.lloyd.saturating_sub(self.iterations.len());
            let steps = if lloyd > 0 { cvt.relax(lloyd, self.token)? } else { vec![cvt.lbfgs(self.token)?] };
            for step in steps {
                self.count(&step);
                self.observer.iteration(&step, planned);
                self.iterations.push(IterationFigures::of(&step));
            }
        }
        Ok(FinalFigures::of(&cvt.present(self.token)?))
    }

    fn take(&mut self, cvt: &mut Cvt, newton: bool) -> Result<Iteration, RemeshError> {
        let step = if newton { cvt.lbfgs(self.token)? } else { cvt.lloyd(self.token)? };
        self.count(&step);
        Ok(step)
    }

    fn count(&mut self, step: &Iteration) {
        self.rvd.add_pass(&step.stats);
        self.rvd.reseeded_cells += step.empty_cells;
    }

    /// Steps that are not counted as iterations: one of Lloyd's and quasi-Newton steps.
    fn more(&mut self, cvt: &mut Cvt, steps: usize) -> Result<(), RemeshError> {
        for k in 0..steps {
            let step = self.take(cvt, k > 0)?;
            self.refine.evaluations += step.evaluations;
        }
        Ok(())
    }

    /// Clears the curves of seeds that are not theirs.
    pub(super) fn clear_curves(&mut self, cvt: &mut Cvt) -> Result<(), RemeshError> {
        for round in 1..=CLEARINGS {
            let in_the_way = match round < CLEARINGS {
                true => cvt.clear_curves(self.token)?,
                false => cvt.adopt_intruders(self.token)?,
            };
            if in_the_way == 0 {
                break;
            }
            self.more(cvt, CLEARING_STEPS)?;
        }
        Ok(())
    }

    /// Adds seeds at places that were missed, each with the seed nearest to it, and lets the others settle. Returns
    /// whether there was anything to do.
    pub(super) fn add(&mut self, cvt: &mut Cvt, places: &[(u32, DVec3)]) -> Result<bool, RemeshError> {
        // Where a seed is already, another would only be its twin.
        let seeds = cvt.unit_seeds()?;
        let apart = |p: &&(u32, DVec3)| seeds[p.0 as usize].distance(p.1) > TWINS;
        let places: Vec<DVec3> = places.iter().filter(apart).map(|p| p.1).collect();
        let added = cvt.pin(&[], &places)?;
        self.refine.added_seeds += added;
        self.settle(cvt, added)
    }

    /// Sends seeds without a vertex to where edges are long, and lets the others settle. Returns whether there was
    /// anything to do.
    pub(super) fn move_lost(&mut self, cvt: &mut Cvt, missed: &Missed) -> Result<bool, RemeshError> {
        let pins: Vec<(u32, DVec3)> = missed.lost.iter().copied().zip(missed.room.iter().copied()).collect();
        if !pins.is_empty() {
            cvt.pin(&pins, &[])?;
        }
        self.refine.moved_seeds += pins.len();
        self.settle(cvt, pins.len())
    }

    fn settle(&mut self, cvt: &mut Cvt, changed: usize) -> Result<bool, RemeshError> {
        if changed > 0 {
            self.refine.rounds += 1;
            self.more(cvt, REFINING_STEPS)?;
        }
        Ok(changed > 0)
    }
}

/// Seeds nearer to each other than this, unit frame, are in one place.
const TWINS: f64 = 1e-9;
