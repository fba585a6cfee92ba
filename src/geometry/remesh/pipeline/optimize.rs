//! Optimization of the seeds.
//!
//! Purpose: [`Job::optimize`] draws seeds, takes the steps that were asked for and reads the dual. Where the surface is too thin
//! for its cells, it does so again with shorter edges there, as long as that helps.
//! Invariant: the best of all rounds comes back; without failing cells there is one round.
//! Must not know: how a surface is made of a dual.

use std::sync::Arc;

use glam::DVec3;

use super::job::Job;
use super::prepare::{Prepared, prepare, with_source};
use super::schedule::{Figures, Schedule};
use super::thin_parts::{self, FailingCells};
use crate::cvt::density::{DensitySource, Plan};
use crate::cvt::{Cvt, CvtOptions};
use crate::mesh::TriMesh;
use crate::mesh::sample::spread;
use crate::remesh::constants::{MAX_THIN_ROUNDS, MAX_VAIN_ROUNDS, THIN_LONGEST, THIN_MOST_POINTS};
use crate::remesh::features::curves::KeptCurves;
use crate::remesh::{RemeshError, RemeshOptions, Seeds};
use crate::rvd::{RvdError, Session, SessionOptions, Surface, dual};
use crate::token::{Stopped, Token};

/// Seeds after their steps.
pub(super) struct Optimized<'a> {
    pub(super) plan: Plan<'a>,
    pub(super) surface: Arc<Surface>,
    pub(super) curves: KeptCurves,
    pub(super) cvt: Cvt,
    /// In double precision, for duals.
    pub(super) session: Box<dyn Session>,
    pub(super) dual: dual::Dual,
    failing: FailingCells,
    pub(super) figures: Figures,
}

impl<'a> Job<'a, '_> {
    /// Seeds optimized for `options`, or for shorter edges where cells fail.
    pub(super) fn optimize(
        &mut self,
        prepared: Prepared<'a>,
        options: &RemeshOptions,
    ) -> Result<Optimized<'a>, RemeshError> {
        let optimized = self.optimize_once(prepared, options)?;
        let optimized = self.resolve_thin_parts(optimized, options)?;
        self.scale_seeds(optimized, options)
    }

    /// Prepares other options; `None` if their density needs too many points.
    pub(super) fn prepare_again(&mut self, options: &RemeshOptions) -> Result<Option<Prepared<'a>>, RemeshError> {
        self.enter("prepare");
        match prepare(self.separated, options, self.token) {
            Err(RemeshError::Density(_)) => Ok(None),
            prepared => prepared.map(Some),
        }
    }

    /// Optimizes other seeds; `None` if there is no memory for them beside the best so far, which stays on the device.
    pub(super) fn optimize_again(
        &mut self,
        prepared: Prepared<'a>,
        options: &RemeshOptions,
    ) -> Result<Option<Optimized<'a>>, RemeshError> {
        match self.optimize_once(prepared, options) {
            Err(RemeshError::Rvd(RvdError::NeverFits { .. } | RvdError::OutOfMemory { .. })) => Ok(None),
            next => next.map(Some),
        }
    }

    /// Draws seeds, takes their steps, and reads their dual.
    fn optimize_once(&mut self, prepared: Prepared<'a>, options: &RemeshOptions) -> Result<Optimized<'a>, RemeshError> {
        let Prepared { plan, surface, mut curves, closest } = prepared;
        self.laps.end(|t| &mut t.prepare);
        self.token.check()?;

        self.enter("sample");
        let (first, seed) = first_seeds(&plan, &surface, &curves, &options.seeds);
        self.laps.end(|t| &mut t.sample);
        self.token.check()?;

        self.enter("iterations");
        let max_seeds = options.refine.and_then(|refine| refine.max_points).unwrap_or(0);
        let cvt_options = CvtOptions { projection: options.projection, max_seeds };
        let mut cvt = Cvt::new(self.backend, Arc::clone(&surface), &first, cvt_options)?;
        cvt.bring_closest(closest);
        if !curves.seeds.is_empty() {
            cvt.keep_curves(curves.seeds.clone(), self.token)?;
        }
        let figures = Figures { seed, asked: plan.points, ..Figures::default() };
        let mut schedule = Schedule { job: self, options, figures };
        schedule.main(&mut cvt)?;
        schedule.job.laps.end(|t| &mut t.iterations);
        schedule.clear_curves(&mut cvt)?;
        curves.seeds = cvt.curves().clone();
        schedule.job.laps.end(|t| &mut t.refine);

        schedule.job.enter("dual");
        let room = max_seeds.max(cvt.len());
        let exact = SessionOptions { flat_pieces: true, ..SessionOptions::new(room) };
        let mut session = schedule.job.backend.exact_session(Arc::clone(&surface), exact)?;
        let dual = ExactDual { surface: &surface, session: &mut *session }.dual(&mut cvt, &mut schedule)?;
        let figures = schedule.figures;
        self.token.check()?;
        let failing = thin_parts::failing(&dual, &plan.mesh, &surface, &self.topology, self.token)?;
        self.laps.end(|t| &mut t.dual);
        Ok(Optimized { plan, surface, curves, cvt, session, dual, failing, figures })
    }

    /// Optimizes again with shorter edges where cells fail, as long as that helps.
    fn resolve_thin_parts(
        &mut self,
        optimized: Optimized<'a>,
        options: &RemeshOptions,
    ) -> Result<Optimized<'a>, RemeshError> {
        let mut best = optimized;
        best.figures.refine.closed_ball_failures = best.failing.components.len();
        if !self.keep_thin || matches!(options.seeds, Seeds::Given(_)) {
            return Ok(best);
        }
        let median = best.plan.figures.edge_median;
        let most = THIN_MOST_POINTS * best.plan.points;
        let mut failing = !best.failing.components.is_empty();
        let mut lengths = if failing { best.shorter_lengths(self.separated, self.token)? } else { Vec::new() };
        let mut vain = 0;
        for round in 1..=MAX_THIN_ROUNDS {
            if !failing || vain == MAX_VAIN_ROUNDS {
                break;
            }
            let options = with_source(options, DensitySource::Sizes(lengths));
            let Some(prepared) = self.prepare_again(&options)? else { break };
            let Plan { figures, points, .. } = &prepared.plan;
            let longer = median.zip(figures.edge_median).is_some_and(|(before, now)| now > THIN_LONGEST * before);
            if longer || *points > most {
                break;
            }
            let Some(mut next) = self.optimize_again(prepared, &options)? else { break };
            (lengths, failing) =
                (next.shorter_lengths(self.separated, self.token)?, !next.failing.components.is_empty());
            if next.failing.area < best.failing.area {
                next.take_over(&best);
                next.figures.refine.closed_ball_rounds = round;
                (best, vain) = (next, 0);
            } else {
                best.figures.refine.evaluations += next.figures.passes();
                vain += 1;
            }
        }
        best.figures.refine.closed_ball_failures = best.failing.components.len();
        Ok(best)
    }
}

impl Optimized<'_> {
    /// Target edge length per vertex of the caller's `mesh`, shorter where cells fail.
    fn shorter_lengths(&self, mesh: &TriMesh, token: &Token) -> Result<Vec<f64>, Stopped> {
        let mut lengths = self.plan.lengths(mesh, token)?;
        thin_parts::shorten(&mut lengths, mesh, &self.failing, &self.dual, &self.surface, token)?;
        Ok(lengths)
    }

    /// Vertices that its dual has once it is repaired.
    pub(super) fn vertices(&self) -> usize {
        self.failing.vertices
    }

    /// Takes the place of another one that was made before.
    pub(super) fn take_over(&mut self, before: &Self) {
        self.figures.refine.evaluations += before.figures.passes();
        self.figures.refine.closed_ball_rounds = before.figures.refine.closed_ball_rounds;
        self.figures.refine.closed_ball_failures = self.failing.components.len();
        self.plan.figures.source = before.plan.figures.source;
        self.figures.asked = before.figures.asked;
    }
}

/// What the duals are computed with.
pub(super) struct ExactDual<'a> {
    pub(super) surface: &'a Surface,
    pub(super) session: &'a mut dyn Session,
}

impl ExactDual<'_> {
    /// Puts the seeds on the surface and reads their dual.
    pub(super) fn dual(
        &mut self,
        cvt: &mut Cvt,
        schedule: &mut Schedule<'_, '_, '_>,
    ) -> Result<dual::Dual, RemeshError> {
        cvt.put_on_surface(schedule.job.token)?;
        self.session.set_seeds(cvt.unit_seeds()?)?;
        let dual = dual::extract(self.session, self.surface, cvt.len(), schedule.job.token)?;
        schedule.figures.rvd.add_pass(&dual.stats);
        Ok(dual)
    }
}

/// The seeds that the options name, those of curves first, caller's coordinates; and the random seed they were drawn from.
fn first_seeds(plan: &Plan<'_>, surface: &Surface, curves: &KeptCurves, seeds: &Seeds) -> (Vec<DVec3>, Option<u64>) {
    match *seeds {
        Seeds::Given(ref seeds) => (seeds.clone(), None),
        Seeds::Sample { seed, .. } | Seeds::Implied { seed } if curves.seeds.is_empty() => {
            let drawn = spread(&plan.mesh, plan.weights.as_deref(), None, plan.points, seed);
            (drawn.iter().map(|p| p.position).collect(), Some(seed))
        }
        Seeds::Sample { seed, .. } | Seeds::Implied { seed } => (curves.with_others(plan, surface, seed), Some(seed)),
    }
}
