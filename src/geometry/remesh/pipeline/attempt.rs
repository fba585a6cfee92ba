//! One attempt at a remesh: from what is prepared to a surface.
//!
//! Purpose: optimizes the seeds, then builds results in rounds. Each round adds seeds where the result is too far from the
//! input, or moves seeds that produced no vertex.
//! Invariant: the best result of all rounds comes back. Must not know: why there are several attempts.

use glam::DVec3;

use super::extract::{Built, Draft, Extraction, Missed};
use super::job::Job;
use super::optimize::{ExactDual, Optimized};
use super::prepare::Prepared;
use super::schedule::{Figures, Schedule};
use crate::cvt::Cvt;
use crate::cvt::density::Plan;
use crate::mesh::TriMesh;
use crate::mesh::closest_point::ClosestPoint;
use crate::remesh::constants::{ADDING_ROUNDS, ADDING_SLACK, MOVING_ROUNDS, MOVING_SLACK};
use crate::remesh::features::curves::KeptCurves;
use crate::remesh::report::DeviceFigures;
use crate::remesh::{Placement, RemeshError, RemeshOptions};
use crate::rvd::{RvdError, dual};

/// A result, and how it came about.
pub(super) struct Attempt<'a> {
    pub(super) plan: Plan<'a>,
    pub(super) curves: KeptCurves,
    pub(super) closest: Option<ClosestPoint>,
    pub(super) built: Built,
    /// Caller's coordinates.
    pub(super) seeds: Vec<DVec3>,
    pub(super) figures: Figures,
    pub(super) device: DeviceFigures,
    pub(super) device_bytes: u64,
}

impl<'a> Job<'a, '_> {
    /// From what is prepared for `options` to a surface. Its creases may be off by half of `tolerance`.
    pub(super) fn attempt(
        &mut self,
        prepared: Prepared<'a>,
        options: &RemeshOptions,
        tolerance: Option<f64>,
    ) -> Result<Attempt<'a>, RemeshError> {
        let optimized = self.optimize(prepared, options)?;
        let Optimized { plan, surface, curves, mut cvt, mut session, dual, figures, .. } = optimized;
        let mut schedule = Schedule { job: self, options, figures };
        let exact = ExactDual { surface: &surface, session: &mut *session };
        let (built, seeds) = build(&plan.mesh, &curves, &mut cvt, (exact, dual), &mut schedule, tolerance)?;
        let figures = schedule.figures;
        let device = DeviceFigures::new(cvt.device_work(), &figures.iterations);
        let device_bytes = cvt.device_bytes();
        // Nothing else of it is needed: its memory is free for the measurements.
        let closest = cvt.into_closest();
        Ok(Attempt { plan, curves, closest, built, seeds, figures, device, device_bytes })
    }
}

/// Builds the result of the present seeds, whose dual is there, and of better ones as long as rounds help. Returns the best
/// result and its seeds, caller's coordinates.
fn build(
    mesh: &TriMesh,
    curves: &KeptCurves,
    cvt: &mut Cvt,
    (mut exact, mut dual): (ExactDual<'_>, dual::Dual),
    schedule: &mut Schedule<'_, '_, '_>,
    tolerance: Option<f64>,
) -> Result<(Built, Vec<DVec3>), RemeshError> {
    let (options, token) = (schedule.options, schedule.job.token);
    let surface = exact.surface;
    let rounds = match (options.refine, options.placement) {
        (Some(_), _) => ADDING_ROUNDS,
        (None, Placement::Fitted) if options.newton > 0 => MOVING_ROUNDS,
        _ => 0,
    };
    let tolerance = tolerance.map(|t| t * surface.frame().scale);
    let first_added = cvt.len() as u32;
    let mut best: Option<(Draft, Vec<DVec3>)> = None;
    let (placement, adds) = (options.placement, options.refine.is_some());
    let extraction = Extraction { mesh, surface, curves, placement, first_added, tolerance, adds, token };
    let mut round = 0;
    loop {
        token.check()?;
        schedule.job.enter("repair");
        // The whole draft is one task of the pool: its parts then find the pool's threads awake.
        let seeds = cvt.unit_seeds()?;
        let draft = rayon::scope(|_| extraction.draft(&dual, seeds))?;
        schedule.job.laps.end(|t| &mut t.repair);
        let missed = draft.missed.clone();
        let is_better = |before: &Missed| match adds {
            true => missed.deviation < ADDING_SLACK * before.deviation,
            false => {
                missed.seeds_without_vertex.len() < before.seeds_without_vertex.len()
                    && missed.deviation < MOVING_SLACK * before.deviation
            }
        };
        if best.as_ref().is_none_or(|(before, _)| is_better(&before.missed)) {
            schedule.figures.rvd.of_dual(&dual, surface);
            best = Some((draft, cvt.seeds()?));
        }
        let goes_on = round < rounds
            && match adds {
                true => schedule.add_seeds(cvt, &missed.places)?,
                false => schedule.move_seeds(cvt, &missed)?,
            };
        if !goes_on {
            break;
        }
        schedule.job.laps.end(|t| &mut t.refine);
        round += 1;
        schedule.job.enter("dual");
        dual = exact.dual(cvt, schedule)?;
        schedule.job.laps.end(|t| &mut t.dual);
    }
    let (draft, seeds) = best.ok_or_else(|| RvdError::Internal("no result was built".to_owned()))?;
    let built = rayon::scope(|_| extraction.finish(draft))?;
    schedule.figures.refine.out_of_tolerance = built.missed;
    schedule.job.laps.end(|t| &mut t.repair);
    Ok((built, seeds))
}
