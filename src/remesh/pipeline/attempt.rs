//! One attempt at a remesh: from what is prepared to a surface.
//!
//! Purpose: optimizes the seeds, then builds results in rounds. Each round adds seeds where the result is too far from the
//! input, or moves seeds that produced no vertex.
//! Invariant: the best result of all rounds comes back. Must not know: why there are several attempts.

use glam::DVec3;

use super::extract::{Built, Draft, Extraction, Missed};
use super::job::{Job, Laps, enter};
use super::optimize::{ExactDual, Optimized};
use super::prepare::Prepared;
use super::schedule::Schedule;
use crate::cvt::Cvt;
use crate::cvt::density::Plan;
use crate::mesh::TriMesh;
use crate::mesh::closest_point::ClosestPoint;
use crate::remesh::constants::{ADDING_ROUNDS, ADDING_SLACK, MOVING_ROUNDS, MOVING_SLACK};
use crate::remesh::features::curves::KeptCurves;
use crate::remesh::report::{DeviceFigures, FinalFigures, IterationFigures, RefineFigures, RvdFigures};
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
    /// The random seed they were drawn from.
    pub(super) seed: Option<u64>,
    pub(super) figures: Figures,
    pub(super) device: DeviceFigures,
    pub(super) device_bytes: u64,
}

/// What the steps of the seeds came to.
pub(super) struct Figures {
    pub(super) converged: bool,
    pub(super) rvd: RvdFigures,
    pub(super) iterations: Vec<IterationFigures>,
    pub(super) last: FinalFigures,
    pub(super) refine: RefineFigures,
    /// How many vertices were asked for.
    pub(super) asked: usize,
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
        let Optimized { plan, surface, curves, mut cvt, mut session, dual, seed, converged, last, .. } = optimized;
        let Optimized { rvd, iterations, refine, asked, .. } = optimized;
        let mut schedule =
            Schedule { options, observer: &mut *self.observer, token: self.token, rvd, iterations, refine };
        let exact = ExactDual { surface: &surface, session: &mut *session };
        let mesh = &plan.mesh;
        let (built, seeds) = build(mesh, &curves, &mut cvt, (exact, dual), &mut schedule, tolerance, &mut self.laps)?;
        let Schedule { rvd, iterations, refine, .. } = schedule;
        let device = DeviceFigures::new(cvt.device_work(), &iterations);
        let device_bytes = cvt.device_bytes();
        // Nothing else of it is needed: its memory is free for the measurements.
        let closest = cvt.into_closest();
        let figures = Figures { converged, rvd, iterations, last, refine, asked };
        Ok(Attempt { plan, curves, closest, built, seeds, seed, figures, device, device_bytes })
    }
}

/// Builds the result of the present seeds, whose dual is there, and of better ones as long as rounds help. Returns the best
/// result and its seeds, caller's coordinates.
fn build(
    mesh: &TriMesh,
    curves: &KeptCurves,
    cvt: &mut Cvt,
    (mut exact, mut dual): (ExactDual<'_>, dual::Dual),
    schedule: &mut Schedule<'_>,
    tolerance: Option<f64>,
    laps: &mut Laps,
) -> Result<(Built, Vec<DVec3>), RemeshError> {
    let options = schedule.options;
    let surface = exact.surface;
    let rounds = match (options.refine, options.placement) {
        (Some(_), _) => ADDING_ROUNDS,
        (None, Placement::Fitted) if options.newton > 0 => MOVING_ROUNDS,
        _ => 0,
    };
    let tolerance = tolerance.map(|t| t * surface.frame().scale);
    let first_added = cvt.len() as u32;
    let mut best: Option<(Draft, Missed, Vec<DVec3>)> = None;
    let placement = options.placement;
    let adds = options.refine.is_some();
    let token = schedule.token;
    let extraction = Extraction { mesh, surface, curves, placement, first_added, tolerance, adds, token };
    let mut round = 0;
    loop {
        schedule.token.check()?;
        enter(schedule.observer, schedule.token, "repair");
        // The whole draft is one task of the pool: its parts then find the pool's threads awake.
        let seeds = cvt.unit_seeds()?;
        let draft = rayon::scope(|_| extraction.draft(&dual, seeds))?;
        laps.timings.repair += laps.lap();
        let missed = draft.missed();
        let is_better = |before: &Missed| match adds {
            true => missed.deviation < ADDING_SLACK * before.deviation,
            false => {
                missed.seeds_without_vertex.len() < before.seeds_without_vertex.len()
                    && missed.deviation < MOVING_SLACK * before.deviation
            }
        };
        if best.as_ref().is_none_or(|(_, before, _)| is_better(before)) {
            schedule.rvd.of_dual(&dual, surface);
            best = Some((draft, missed.clone(), cvt.seeds()?));
        }
        let goes_on = round < rounds
            && match adds {
                true => schedule.add_seeds(cvt, &missed.places)?,
                false => schedule.move_seeds(cvt, &missed)?,
            };
        if !goes_on {
            break;
        }
        laps.timings.refine += laps.lap();
        round += 1;
        enter(schedule.observer, schedule.token, "dual");
        dual = exact.dual(cvt, schedule)?;
        laps.timings.dual += laps.lap();
    }
    let (draft, _, seeds) = best.ok_or_else(|| RvdError::Internal("no result was built".to_owned()))?;
    let built = rayon::scope(|_| extraction.finish(draft))?;
    schedule.refine.out_of_tolerance = built.missed;
    laps.timings.repair += laps.lap();
    Ok((built, seeds))
}
