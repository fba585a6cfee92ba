//! Seeds that have settled.
//!
//! Purpose: draws seeds, takes the steps that were asked for, and reads the dual; and the same again with shorter edges
//! where cells fail, as long as that helps.
//! Invariant: what comes back is the best of all rounds; where no cell fails there is one.
//! Must not know: how a surface is made of a dual.

use std::sync::Arc;

use super::report::{FinalFigures, IterationFigures, RefineFigures, RvdFigures};
use super::steps::Steps;
use super::{Job, Prepared, RemeshError, RemeshOptions, Seeds, curves, enter, first_seeds, prepare, thin};
use crate::cvt::density::{DensityError, DensityOptions, DensitySource, Plan};
use crate::cvt::{Cvt, CvtOptions};
use crate::mesh::TriMesh;
use crate::rvd::{RvdError, Session, SessionOptions, Surface, dual};
use crate::token::{Stopped, Token};

/// Seeds after their steps.
pub(super) struct Settled<'a> {
    pub(super) plan: Plan<'a>,
    pub(super) surface: Arc<Surface>,
    pub(super) kept: curves::Kept,
    pub(super) cvt: Cvt,
    /// In double precision.
    pub(super) session: Box<dyn Session>,
    pub(super) dual: dual::Dual,
    failing: thin::Failing,
    /// The random seed they were drawn from.
    pub(super) seed: Option<u64>,
    /// What they came to by the steps that were asked for.
    pub(super) converged: bool,
    pub(super) last: FinalFigures,
    pub(super) rvd: RvdFigures,
    pub(super) iterations: Vec<IterationFigures>,
    pub(super) refine: RefineFigures,
}

impl<'a> Job<'a, '_> {
    /// Seeds that have settled for `options`, or for shorter edges where cells fail.
    pub(super) fn settled(
        &mut self,
        prepared: Prepared<'a>,
        options: &RemeshOptions,
    ) -> Result<Settled<'a>, RemeshError> {
        let settled = self.settle(prepared, options)?;
        self.thicken(settled, options)
    }

    /// Draws seeds, lets them settle, and reads their dual.
    fn settle(&mut self, prepared: Prepared<'a>, options: &RemeshOptions) -> Result<Settled<'a>, RemeshError> {
        let Prepared { plan, surface, mut kept, closest } = prepared;
        self.laps.timings.prepare += self.laps.clock.lap();
        self.token.check()?;

        enter(self.observer, self.token, "sample");
        let (first, seed) = first_seeds(&plan, &surface, &kept, &options.seeds);
        self.laps.timings.sample += self.laps.clock.lap();
        self.token.check()?;

        enter(self.observer, self.token, "iterations");
        let max_seeds = options.refine.map_or(0, |r| r.max_points);
        let cvt_options = CvtOptions { projection: options.projection, max_seeds };
        let mut cvt = Cvt::new(self.backend, Arc::clone(&surface), &first, cvt_options)?;
        cvt.bring_closest(closest);
        if !kept.seeds.is_empty() {
            cvt.keep_curves(kept.seeds.clone(), self.token)?;
        }
        let (rvd, refine) = (RvdFigures::default(), RefineFigures::default());
        let token = self.token;
        let mut steps = Steps { options, observer: &mut *self.observer, token, rvd, iterations: Vec::new(), refine };
        let last = steps.main(&mut cvt)?;
        // Of the steps that were asked for; those that come after have their own end.
        let converged = cvt.converged();
        self.laps.timings.iterations += self.laps.clock.lap();
        steps.clear_curves(&mut cvt)?;
        kept.seeds = cvt.curves().clone();
        self.laps.timings.refine += self.laps.clock.lap();

        enter(steps.observer, steps.token, "dual");
        let room = max_seeds.max(cvt.len());
        let exact = SessionOptions { flat_pieces: true, ..SessionOptions::new(room) };
        let mut session = self.backend.exact_session(Arc::clone(&surface), exact)?;
        let dual = Exact { surface: &surface, session: &mut *session }.dual(&mut cvt, &mut steps)?;
        self.token.check()?;
        let failing = thin::failing(&dual, &plan.mesh, &surface, &self.topology, token)?;
        self.laps.timings.dual += self.laps.clock.lap();
        let Steps { rvd, iterations, refine, .. } = steps;
        Ok(Settled { plan, surface, kept, cvt, session, dual, failing, seed, converged, last, rvd, iterations, refine })
    }

    /// Settles anew, with shorter edges where cells fail, as long as that helps.
    fn thicken(&mut self, settled: Settled<'a>, options: &RemeshOptions) -> Result<Settled<'a>, RemeshError> {
        let mut best = settled;
        best.refine.thin_cells = best.failing.len();
        if !self.keep_thin || matches!(options.seeds, Seeds::Given(_)) {
            return Ok(best);
        }
        let median = best.plan.figures.edge_median;
        let most = thin::MORE * best.plan.points;
        let mut failing = !best.failing.is_empty();
        let mut lengths = if failing { best.shorter(self.mesh, self.token)? } else { Vec::new() };
        let mut vain = 0;
        for round in 1..=thin::ROUNDS {
            if !failing || vain == thin::VAIN {
                break;
            }
            let source = DensitySource::Sizes(lengths);
            let density = DensityOptions { source, edge_length: None, adaptivity: 1.0, ..options.density.clone() };
            let options = RemeshOptions { density, ..options.clone() };
            enter(self.observer, self.token, "prepare");
            let prepared = match prepare(self.mesh, &options, self.token) {
                Err(RemeshError::Density(DensityError::TooManyPoints { .. })) => break,
                prepared => prepared?,
            };
            let Plan { figures, points, .. } = &prepared.plan;
            let longer = median.zip(figures.edge_median).is_some_and(|(before, now)| now > thin::LONGER * before);
            if longer || *points > most {
                break;
            }
            let mut next = match self.settle(prepared, &options) {
                // What there is stays on the device beside it.
                Err(RemeshError::Rvd(RvdError::NeverFits { .. } | RvdError::OutOfMemory { .. })) => break,
                next => next?,
            };
            (lengths, failing) = (next.shorter(self.mesh, self.token)?, !next.failing.is_empty());
            if next.failing.is_better(&best.failing) {
                next.refine.evaluations += best.passes();
                next.refine.thin_rounds = round;
                next.plan.figures.source = best.plan.figures.source;
                (best, vain) = (next, 0);
            } else {
                best.refine.evaluations += next.passes();
                vain += 1;
            }
        }
        best.refine.thin_cells = best.failing.len();
        Ok(best)
    }
}

impl Settled<'_> {
    /// Target edge length per vertex of the caller's `mesh`, shorter where cells fail.
    fn shorter(&self, mesh: &TriMesh, token: &Token) -> Result<Vec<f64>, Stopped> {
        let mut lengths = self.plan.lengths(mesh, token)?;
        thin::shorten(&mut lengths, mesh, &self.failing, &self.dual, &self.surface, token)?;
        Ok(lengths)
    }

    /// Passes over the diagram that it took.
    fn passes(&self) -> usize {
        self.refine.evaluations + self.iterations.iter().map(|step| step.evaluations).sum::<usize>()
    }
}

/// What the last diagrams are computed with.
pub(super) struct Exact<'a> {
    pub(super) surface: &'a Surface,
    pub(super) session: &'a mut dyn Session,
}

impl Exact<'_> {
    /// Puts the seeds on the surface and reads their dual.
    pub(super) fn dual(&mut self, cvt: &mut Cvt, steps: &mut Steps<'_>) -> Result<dual::Dual, RemeshError> {
        cvt.put_on_surface(steps.token)?;
        self.session.set_seeds(cvt.unit_seeds()?)?;
        let dual = dual::extract(self.session, self.surface, cvt.len(), steps.token)?;
        steps.rvd.add_pass(&dual.stats);
        Ok(dual)
    }
}
