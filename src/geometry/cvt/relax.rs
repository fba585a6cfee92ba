//! Lloyd steps several at a time.
//!
//! Purpose: where nothing is to be done between steps, the backend takes them on its own; a GPU then needs one
//! submission for several of them.
//! Invariant: the seeds, energies and gradients are those of [`Cvt::lloyd`] taken as often, to the last bit.
//! Must not know: how the backend takes steps.

use std::time::Instant;

use super::{Cvt, Iteration, Newest, Projection, StepKind, resident};
use crate::rvd::{DeviceWork, Evaluation, RvdError, elapsed_ms};
use crate::token::Token;

impl Cvt {
    /// One Lloyd step at least and `steps` at most, as many as the backend takes at once. Time and work of steps that were taken
    /// together count for the first of them, or evenly for all. A stop leaves the seeds as after some of the steps.
    pub fn relax(&mut self, steps: usize, token: &Token) -> Result<Vec<Iteration>, RvdError> {
        let between = !self.curves.is_empty() || self.options.projection != Projection::Free;
        if between || self.present.is_some() {
            return Ok(vec![self.lloyd(token)?]);
        }
        let begin = Instant::now();
        let (work, phases) = (self.session.device_work(), self.session.device_phases());
        self.upload()?;
        let mut evaluations: Vec<Evaluation> = Vec::new();
        let ended = resident(&mut *self.session)?.relax(steps.max(1), &mut evaluations, token);
        if let Some(first) = evaluations.first() {
            self.convergence.begin(first.gradient_squared.sqrt());
            (self.newest, self.fresh) = (Newest::InSession, true);
        }
        let mut taken = Vec::with_capacity(evaluations.len());
        for evaluation in evaluations {
            let report = Iteration { evaluations: 1, ..self.figures(StepKind::Lloyd, evaluation) };
            taken.push(if evaluation.empty_cells > 0 {
                self.lloyd_from(evaluation, report, Instant::now(), token)?
            } else {
                self.steps += 1;
                report
            });
        }
        ended?;
        let count = taken.len().max(1) as f64;
        let mut known = DeviceWork::default();
        taken.iter().for_each(|step| known += step.stats.device);
        let now = self.session.device_phases();
        for step in &mut taken {
            step.ms = elapsed_ms(begin) / count;
            if let (Some(before), Some(now)) = (phases, now) {
                step.stats.set_phases(now.since(&before).over(count));
            }
        }
        if let Some(last) = taken.last_mut() {
            // What was done after the last pass.
            let rest = self.session.device_work().since(&work).with(&known, u64::saturating_sub);
            last.stats.device += rest;
        }
        Ok(taken)
    }
}
