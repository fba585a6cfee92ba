//! Steps: Lloyd, one or several at a time, or quasi-Newton.
//!
//! Purpose: [`Cvt::lloyd`] and [`Cvt::lbfgs`], and the [`Iteration`] that says what they saw and did. [`Cvt::relax`] lets the
//! backend take Lloyd steps on its own where nothing is to be done between them; a GPU then needs one submission for several.
//! Invariant: energy and gradient come from one pass over the diagram, which is not repeated while the seeds stay. Several Lloyd
//! steps have the seeds, energies and gradients of as many single ones, to the last bit.
//! Must not know: how many steps are taken, curves.

use std::time::Instant;

use super::{Cvt, Newest, Projection, line_search, resident};
use crate::rvd::{DeviceWork, Evaluation, PassStats, RvdError, Space, elapsed_ms};
use crate::token::Token;

/// A first step, where 1 takes seeds to their centroids. The energy falls most at about this: by 0.035 of 1.11 after
/// five Lloyd steps on three models, and by 0.014 at 1.
const FIRST_STEP: f64 = 3.5;

/// Which kind of step was taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StepKind {
    /// Every seed to its cell's centroid.
    Lloyd,
    /// A quasi-Newton step.
    Lbfgs,
}

impl StepKind {
    /// "lloyd" or "lbfgs".
    pub fn name(self) -> &'static str {
        match self {
            Self::Lloyd => "lloyd",
            Self::Lbfgs => "lbfgs",
        }
    }
}

/// What one step saw and did. Energies and gradients are those of the seeds *before* the step, in the caller's units.
#[derive(Clone, Copy, Debug)]
pub struct Iteration {
    /// 0 for the first step of this `Cvt`.
    pub index: usize,
    /// What was done.
    pub kind: StepKind,
    /// E = Σ ∫ w |p - x_i|², with weights scaled so that the largest is in (1/2, 1].
    pub energy: f64,
    /// E over [`Surface::hexagonal_energy`](crate::rvd::Surface::hexagonal_energy): about 1.98 for random seeds, 1.0 when converged.
    pub energy_ratio: f64,
    /// ‖∇E‖, ∇E_i = 2 m_i (x_i - c_i).
    pub gradient_norm: f64,
    /// Passes over the diagram.
    pub evaluations: usize,
    /// Cells without any surface; their seeds were placed anew.
    pub empty_cells: usize,
    /// Area covered by all pieces, caller's units squared.
    pub area: f64,
    /// Wall-clock milliseconds.
    pub ms: f64,
    /// What the passes did.
    pub stats: PassStats,
}

impl<P: Space> Cvt<P> {
    /// One Lloyd step: every seed to the centroid of its cell, or, if that is empty, beside the cell of highest energy.
    /// After an error seeds are as before, or as after the step, if it was stopped on their way to the surface.
    pub fn lloyd(&mut self, token: &Token) -> Result<Iteration, RvdError> {
        self.metered(|cvt| {
            let begin = Instant::now();
            let (evaluation, evaluations) = cvt.evaluate(token)?;
            let report = Iteration { evaluations, ..cvt.figures(StepKind::Lloyd, evaluation) };
            cvt.lloyd_from(report, begin, token)
        })
    }

    /// One quasi-Newton step (L-BFGS; \[YLL*09\], \[FWW14\]): along -H∇E as far as the strong Wolfe
    /// conditions ask. Where the search fails, and where cells are empty, it is a Lloyd step instead.
    pub fn lbfgs(&mut self, token: &Token) -> Result<Iteration, RvdError> {
        self.metered(|cvt| cvt.take_lbfgs(token))
    }

    fn take_lbfgs(&mut self, token: &Token) -> Result<Iteration, RvdError> {
        let begin = Instant::now();
        let (evaluation, evaluations) = self.evaluate(token)?;
        let mut report = Iteration { evaluations, ..self.figures(StepKind::Lbfgs, evaluation) };
        if evaluation.empty_cells > 0 || evaluation.gradient_squared == 0.0 {
            report.kind = StepKind::Lloyd;
            self.converged |= evaluation.empty_cells == 0;
            return self.lloyd_from(report, begin, token);
        }
        let vectors = resident(&mut *self.session)?;
        let mut slope = vectors.search_direction()?;
        let mut first = if self.fresh { FIRST_STEP } else { 1.0 };
        if slope >= 0.0 {
            vectors.clear_history();
            slope = vectors.search_direction()?;
            first = FIRST_STEP;
        }
        let found = line_search::search(vectors, Evaluation { slope, ..evaluation }, first, token)?;
        report.evaluations += found.probes;
        report.stats.add(&found.stats);
        let Some(next) = found.evaluation else {
            report.kind = StepKind::Lloyd;
            return self.lloyd_from(report, begin, token);
        };
        vectors.accept()?;
        let next = self.without_sides(next)?;
        (self.newest, self.fresh) = (Newest::InSession, false);
        self.present = Some(next);
        self.converged = self.convergence.judge(evaluation.energy, next.energy, next.gradient_squared.sqrt());
        if self.options.projection == Projection::OnSurface {
            self.project_seeds(token)?;
        }
        self.steps += 1;
        report.ms = elapsed_ms(begin);
        Ok(report)
    }

    /// Whether the last quasi-Newton step converged: ‖∇E‖ below a thousandth of the first, or two gains below a millionth.
    pub fn converged(&self) -> bool {
        self.converged
    }

    /// Energy, energy ratio and gradient norm of the present seeds: known after a quasi-Newton step, else one more pass.
    pub fn present(&mut self, token: &Token) -> Result<Iteration, RvdError> {
        let (evaluation, evaluations) = self.evaluate(token)?;
        Ok(Iteration { evaluations, ..self.figures(StepKind::Lloyd, evaluation) })
    }

    /// Takes a step and reports all that the device did for it, not only in its passes, and what the phases took, if known.
    fn metered(&mut self, step: impl FnOnce(&mut Self) -> Result<Iteration, RvdError>) -> Result<Iteration, RvdError> {
        let (work, phases) = (self.session.device_work(), self.session.device_phases());
        let mut report = step(self)?;
        report.stats.device = self.session.device_work().since(&work);
        if let (Some(before), Some(now)) = (phases, self.session.device_phases()) {
            report.stats.set_phases(now.since(&before));
        }
        Ok(report)
    }

    /// What a pass says of the present seeds, and how many passes that took: one, or none if it is known.
    fn evaluate(&mut self, token: &Token) -> Result<(Evaluation, usize), RvdError> {
        if let Some(known) = self.present {
            // The pass was another step's; so are its times.
            return Ok((Evaluation { stats: PassStats::default(), ..known }, 0));
        }
        self.upload()?;
        let evaluation = resident(&mut *self.session)?.evaluate(token)?;
        let evaluation = self.without_sides(evaluation)?;
        self.convergence.begin(evaluation.gradient_squared.sqrt());
        self.present = Some(evaluation);
        Ok((evaluation, 1))
    }

    /// Empty cells of further sides do not count: these stay where they are.
    fn without_sides(&mut self, mut evaluation: Evaluation) -> Result<Evaluation, RvdError> {
        if evaluation.empty_cells > 0 && !self.sides.is_empty() {
            resident(&mut *self.session)?.read_sums(&mut self.sums)?;
            evaluation.empty_cells = self.sums.area[..self.seeds.len()].iter().filter(|&&area| area <= 0.0).count();
        }
        Ok(evaluation)
    }

    /// The step to the centroids from seeds that were evaluated.
    fn lloyd_from(&mut self, mut report: Iteration, begin: Instant, token: &Token) -> Result<Iteration, RvdError> {
        let update = Instant::now();
        let vectors = resident(&mut *self.session)?;
        if report.empty_cells > 0 {
            vectors.read_sums(&mut self.sums)?;
        }
        vectors.to_centroids()?;
        (self.newest, self.fresh) = (Newest::InSession, true);
        self.present = None;
        if report.empty_cells > 0 {
            self.download()?;
            let places = self.new_places(token)?;
            places.into_iter().for_each(|(seed, place)| self.seeds[seed as usize] = place);
            self.seeds_changed();
        }
        self.clear_curves(token)?;
        if self.options.projection == Projection::OnSurface {
            self.project_seeds(token)?;
        }
        self.steps += 1;
        report.stats.update_ms += elapsed_ms(update);
        report.ms = elapsed_ms(begin);
        Ok(report)
    }

    /// Energy and gradient as a caller wants them.
    fn figures(&self, kind: StepKind, evaluation: Evaluation) -> Iteration {
        let scale = self.surface.frame().scale;
        Iteration {
            index: self.steps,
            kind,
            energy: evaluation.energy / scale / scale / scale / scale,
            energy_ratio: evaluation.energy / self.surface.hexagonal_energy(self.seeds.len()),
            gradient_norm: evaluation.gradient_squared.sqrt() / scale / scale / scale,
            evaluations: 0,
            empty_cells: evaluation.empty_cells,
            area: evaluation.area / scale / scale,
            ms: 0.0,
            stats: evaluation.stats,
        }
    }

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
            taken.push(if report.empty_cells > 0 {
                self.lloyd_from(report, Instant::now(), token)?
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
