//! Optimization of the seeds.
//!
//! Purpose: [`Job::optimize`] draws seeds, takes the steps that were asked for and reads the dual. Where the surface is too thin
//! for its cells, it does so again with shorter edges there, as long as that helps, and then with fewer seeds until the result
//! has as many vertices as were asked for. Cells fail that reach around a horn or a finger, across a bridge or a strip, or
//! hold the whole end of something slender, of which the dual would have nothing. Where all cells are disks that meet each
//! other and the boundary once, the dual is homeomorphic to the surface (closed ball property, Edelsbrunner and Shah 1997).
//! On a lifted surface cells fail where it bends within a cell; the lift becomes shorter there.
//! Invariant: the best round comes back; without failing cells there is one. Edges become shorter only where cells fail.
//! Must not know: how a surface is made of a dual.

use std::sync::Arc;

use glam::DVec3;

use super::job::Job;
use super::prepare::{Metric, Prepared, prepare, with_source};
use super::schedule::{Figures, Schedule};
use crate::cvt::density::{DensitySource, Plan};
use crate::cvt::{Cvt, CvtOptions, lifted};
use crate::mesh::TriMesh;
use crate::mesh::closest_point::{ClosestPoint, SurfacePoint};
use crate::mesh::measure::{self, Topology};
use crate::mesh::sample::spread_unless;
use crate::remesh::constants::*;
use crate::remesh::features::KeptCurves;
use crate::remesh::manifold::repair::{self, Repaired};
use crate::remesh::report::CountReason;
use crate::remesh::{RemeshError, RemeshOptions, Result, Seeds};
use crate::rvd::dual::Dual;
use crate::rvd::{RvdError, Session, SessionOptions, Surface, dual};
use crate::token::{Stopped, Token};

pub(super) struct Optimized<'a, P: Metric> {
    pub(super) plan: Plan<'a>,
    pub(super) surface: Arc<Surface>,
    pub(super) curves: KeptCurves,
    pub(super) cvt: Cvt<P>,
    /// In double precision, for duals.
    pub(super) session: Box<dyn Session<P>>,
    pub(super) dual: Dual,
    failing: FailingCells,
    /// Of the lift, one for each vertex of the plan's mesh; none if there is no lift.
    lift_lengths: Vec<f64>,
    pub(super) figures: Figures,
}

impl<'a> Job<'a, '_> {
    /// Seeds optimized for `options`, or for shorter edges where cells fail.
    pub(super) fn optimize<P: Metric>(
        &mut self,
        prepared: Prepared<'a>,
        options: &RemeshOptions,
    ) -> Result<Optimized<'a, P>> {
        let optimized = self.optimize_once(prepared, options, None)?;
        let vertices = optimized.failing.vertices.saturating_sub(optimized.curves.surplus());
        // Cells in several pieces have parts of both skins.
        let is_thin = !optimized.failing.components.is_empty()
            || vertices as f64 > DIVIDED_ABOVE * optimized.figures.asked as f64;
        if is_thin && self.may_divide && optimized.curves.divide(&optimized.plan.mesh, self.topology.components) {
            self.wants_division = true;
            // No caller sees it: the stages look at `wants_division` first.
            return Err(RvdError::Internal("the surface is to be divided".to_owned()).into());
        }
        let optimized = self.resolve_thin_parts(optimized, options)?;
        let optimized = self.resolve_folds(optimized, options)?;
        self.scale_seeds(optimized, options)
    }

    /// Prepares other options; `None` if their density needs too many points.
    pub(super) fn prepare_again(
        &mut self,
        options: &RemeshOptions,
        lengths: Option<&[f64]>,
    ) -> Result<Option<Prepared<'a>>> {
        self.enter("prepare");
        match prepare(self.separated, options, self.asked, lengths, self.token) {
            Err(RemeshError::Density(_)) => Ok(None),
            prepared => prepared.map(Some),
        }
    }

    /// Optimizes other seeds; `None` if there is no memory for them beside the best so far, which stays on the device.
    fn optimize_again<P: Metric>(
        &mut self,
        prepared: Prepared<'a>,
        options: &RemeshOptions,
        free: Option<&[DVec3]>,
    ) -> Result<Option<Optimized<'a, P>>> {
        match self.optimize_once(prepared, options, free) {
            Err(RemeshError::Rvd(RvdError::NeverFits { .. } | RvdError::OutOfMemory { .. })) => Ok(None),
            next => next.map(Some),
        }
    }

    /// Draws seeds, takes their steps, and reads their dual. Free seeds begin at the places that are given, as far as these go.
    fn optimize_once<P: Metric>(
        &mut self,
        prepared: Prepared<'a>,
        options: &RemeshOptions,
        free: Option<&[DVec3]>,
    ) -> Result<Optimized<'a, P>> {
        let (measured, lifts) = P::surface(&prepared)?;
        let Prepared { plan, surface, mut curves, closest, lift } = prepared;
        self.laps.end(|t| &mut t.prepare);
        self.token.check()?;

        self.enter("sample");
        let weights = lift.as_ref().map(|lift| &lift.sampling[..]).or(plan.weights.as_deref());
        let (mut first, seed) = first_seeds(&plan, weights, &surface, &curves, &options.seeds, self.token)?;
        let drawn = first.iter_mut().skip(curves.seeds.len());
        drawn.zip(free.unwrap_or_default()).for_each(|(seed, &place)| *seed = place);
        let unit: Vec<DVec3> = first.iter().map(|&p| surface.frame().to_unit(p)).collect();
        let points = lifted(&measured, &closest, &unit, self.token)?;
        self.laps.end(|t| &mut t.sample);
        self.token.check()?;

        self.enter("iterations");
        let max_seeds = options.refine.and_then(|refine| refine.max_points).unwrap_or(0);
        let cvt_options = CvtOptions { projection: options.projection, max_seeds };
        let mut cvt = Cvt::open(self.backend, Arc::clone(&measured), points, cvt_options, lifts)?;
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
        let room = cvt.room();
        let exact = SessionOptions { flat_pieces: true, ..SessionOptions::new(room) };
        let mut session = P::exact_session(schedule.job.backend, measured, exact)?;
        let dual = exact_dual((&surface, &mut *session), &mut cvt, &mut schedule)?;
        let figures = schedule.figures;
        self.token.check()?;
        let failing = failing_cells(&dual, &plan.mesh, &surface, &self.topology, !P::IS_PLACE, self.token)?;
        self.laps.end(|t| &mut t.dual);
        let lift_lengths = lift.map(|lift| lift.lengths).unwrap_or_default();
        Ok(Optimized { plan, surface, curves, cvt, session, dual, failing, lift_lengths, figures })
    }

    /// Optimizes again with shorter edges where cells fail, as long as that helps.
    fn resolve_thin_parts<P: Metric>(
        &mut self,
        mut best: Optimized<'a, P>,
        options: &RemeshOptions,
    ) -> Result<Optimized<'a, P>> {
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
            let Some(prepared) = self.prepare_again(&options, None)? else { break };
            let Plan { figures, points, .. } = &prepared.plan;
            let longer = median.zip(figures.edge_median).is_some_and(|(before, now)| now > THIN_LONGEST * before);
            if longer || *points > most {
                break;
            }
            let Some(mut next) = self.optimize_again(prepared, &options, None)? else { break };
            lengths = next.shorter_lengths(self.separated, self.token)?;
            failing = !next.failing.components.is_empty();
            if next.failing.area < best.failing.area {
                next.take_over(&best);
                next.figures.refine.closed_ball_rounds = round;
                (best, vain) = (next, 0);
            } else {
                best.figures.refine.evaluations += next.figures.passes();
                vain += 1;
            }
        }
        Ok(best)
    }

    /// Optimizes again with a shorter lift where cells fail, as long as that helps: where the lifted surface bends within a cell,
    /// points are too few there, and the dual folds.
    fn resolve_folds<P: Metric>(
        &mut self,
        mut best: Optimized<'a, P>,
        options: &RemeshOptions,
    ) -> Result<Optimized<'a, P>> {
        if P::IS_PLACE || matches!(options.seeds, Seeds::Given(_)) {
            return Ok(best);
        }
        let mut lengths = best.lift_lengths.clone();
        let mut failing = !best.failing.components.is_empty();
        if failing {
            shorten(&mut lengths, FOLD_SHORTER, &best.plan.mesh, &best.failing, &best.dual, &best.surface, self.token)?;
        }
        // Most seeds stay about where they are.
        let fewer =
            RemeshOptions { lloyd: options.lloyd.min(1), newton: options.newton.min(FOLD_STEPS), ..options.clone() };
        for round in 1..=MAX_FOLD_ROUNDS {
            if !failing {
                break;
            }
            self.enter("prepare");
            let prepared = prepare(self.separated, options, self.asked, Some(&lengths), self.token)?;
            let free = best.cvt.seeds()?.split_off(best.curves.seeds.len());
            let Some(mut next) = self.optimize_again::<P>(prepared, &fewer, Some(&free))? else { break };
            lengths.clone_from(&next.lift_lengths);
            failing = !next.failing.components.is_empty();
            let factor = FOLD_SHORTER.powi(1 + round as i32);
            shorten(&mut lengths, factor, &next.plan.mesh, &next.failing, &next.dual, &next.surface, self.token)?;
            if next.failing.area < best.failing.area || !failing {
                next.take_over(&best);
                next.figures.refine.fold_rounds = round;
                best = next;
            } else {
                best.figures.refine.evaluations += next.figures.passes();
            }
        }
        Ok(best)
    }

    /// Seeds that result in as many vertices as were asked for, or as near to that as fewer seeds and a few rounds come.
    fn scale_seeds<P: Metric>(
        &mut self,
        mut best: Optimized<'a, P>,
        options: &RemeshOptions,
    ) -> Result<Optimized<'a, P>> {
        let (&Seeds::Sample { seed, .. } | &Seeds::Implied { seed }) = &options.seeds else { return Ok(best) };
        let asked = best.figures.asked;
        let least = (FEWEST_SEEDS_SHARE * asked as f64).max(FEWEST_SEEDS).min(asked as f64);
        // Where sheets are joined afterwards, and where edges stay, seeds have fewer vertices.
        let most = if best.curves.surplus() > 0 { MOST_SEEDS_OF_JOINED * asked as f64 } else { asked as f64 };
        let vertices = |of: &Optimized<'a, P>| of.failing.vertices.saturating_sub(of.curves.surplus());
        // Seeds and vertices of the best.
        let mut from = (asked as f64, vertices(&best) as f64);
        // Vertices per further seed, and how much farther to go than that says.
        let (mut slope, mut stretch) = (from.1 / from.0, 1.0);
        for round in 1..=MAX_COUNT_ROUNDS {
            if !self.scales_seeds || is_near(vertices(&best), asked) {
                break;
            }
            let drawn = (from.0 + stretch * (asked as f64 - from.1) / slope).clamp(least, most).round();
            if drawn == from.0 {
                break;
            }
            // Shorter edges in thin parts stay.
            let options = match best.figures.refine.closed_ball_rounds {
                0 => options.clone(),
                _ => with_source(options, DensitySource::Sizes(best.plan.lengths(self.separated, self.token)?)),
            };
            let options = options.with_seeds(Seeds::Sample { points: drawn as usize, seed });
            // So does a shorter lift.
            let shorter = Some(&*best.lift_lengths).filter(|_| best.figures.refine.fold_rounds > 0);
            let Some(prepared) = self.prepare_again(&options, shorter)? else { break };
            let Some(mut next) = self.optimize_again(prepared, &options, None)? else { break };
            let here = (drawn, vertices(&next) as f64);
            if vertices(&next).abs_diff(asked) < vertices(&best).abs_diff(asked) {
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

impl<P: Metric> Optimized<'_, P> {
    /// Target edge length per vertex of the caller's `mesh`, shorter where cells fail.
    fn shorter_lengths(&self, mesh: &TriMesh, token: &Token) -> Result<Vec<f64>, Stopped> {
        let mut lengths = self.plan.lengths(mesh, token)?;
        shorten(&mut lengths, THIN_SHORTER, mesh, &self.failing, &self.dual, &self.surface, token)?;
        Ok(lengths)
    }

    /// Takes the place of another one that was made before.
    fn take_over(&mut self, before: &Self) {
        self.figures.refine.evaluations += before.figures.passes();
        self.figures.refine.closed_ball_rounds = before.figures.refine.closed_ball_rounds;
        self.figures.refine.fold_rounds = before.figures.refine.fold_rounds;
        self.figures.refine.closed_ball_failures = self.failing.components.len();
        self.plan.figures.source = before.plan.figures.source;
        self.figures.asked = before.figures.asked;
    }
}

/// Puts the seeds on the surface and reads their dual.
pub(super) fn exact_dual<P: Metric>(
    (surface, session): (&Surface, &mut dyn Session<P>),
    cvt: &mut Cvt<P>,
    schedule: &mut Schedule<'_, '_, '_>,
) -> Result<Dual> {
    cvt.put_on_surface(schedule.job.token)?;
    let (points, owners) = cvt.points_and_owners()?;
    session.set_seeds(&points)?;
    let dual = dual::extract(session, surface, (cvt.len(), &owners), schedule.job.token)?;
    schedule.figures.rvd.add_pass(&dual.stats);
    Ok(dual)
}

/// The seeds that the options name, those of curves first, caller's coordinates; and the random seed they were drawn from.
fn first_seeds(
    plan: &Plan<'_>,
    weights: Option<&[f64]>,
    surface: &Surface,
    curves: &KeptCurves,
    seeds: &Seeds,
    token: &Token,
) -> Result<(Vec<DVec3>, Option<u64>), Stopped> {
    Ok(match (seeds, seeds.random_seed()) {
        (Seeds::Given(seeds), _) => (seeds.clone(), None),
        (_, seed) if curves.seeds.is_empty() => {
            let drawn = spread_unless(&plan.mesh, (weights, None), plan.points, seed, token)?;
            (drawn.iter().map(|p| p.position).collect(), Some(seed))
        }
        (_, seed) => (curves.with_others(plan, weights, surface, seed, token)?, Some(seed)),
    })
}

/// Cells around which a dual has another topology than the surface.
#[derive(Default)]
pub(super) struct FailingCells {
    /// Their components of the dual, ascending.
    pub(super) components: Vec<u32>,
    /// Area of the cells, those in several parts included, unit frame.
    pub(super) area: f64,
    /// Vertices of the repaired dual.
    pub(super) vertices: usize,
}

/// The failing cells of a dual. `surface` was made of `divided`, and the result is to have the topology `wanted`.
pub(super) fn failing_cells(
    dual: &Dual,
    divided: &TriMesh,
    surface: &Surface,
    wanted: &Topology,
    is_lifted: bool,
    token: &Token,
) -> Result<FailingCells, Stopped> {
    let count = dual.components.len();
    let mut there = vec![false; count];
    dual.triangles.iter().flatten().for_each(|&c| there[c as usize] = true);
    let balls = dual.not_disks.is_empty() && dual.multiple_boundary_arcs.is_empty() && dual.multiple_edges.is_empty();
    if balls && !there.contains(&false) {
        return Ok(FailingCells { vertices: count, ..FailingCells::default() });
    }
    let places: Vec<DVec3> = dual.components.iter().map(|c| c.centroid).collect();
    let Repaired { source, positions, facets, .. } = repair::repair(&places, &dual.triangles, token)?;
    token.check()?;
    let vertices = source.len();
    there.fill(false);
    source.iter().for_each(|&c| there[c as usize] = true);
    let key = |t: &Topology| (t.euler, t.components, t.boundary_loops);
    let same = TriMesh::new(positions, facets).is_ok_and(|result| key(&measure::topology(&result)) == key(wanted));
    let whole = |c: u32| dual.components[c as usize].whole;
    let lost = (0..count as u32).any(|c| whole(c) && !there[c as usize]);
    // Folds of the surface that are smaller than a cell close without a trace.
    if same && !lost {
        return Ok(FailingCells { vertices, ..FailingCells::default() });
    }
    let pairs = dual.multiple_edges.iter().flatten();
    let mut fails = vec![false; count];
    dual.not_disks.iter().chain(&dual.multiple_boundary_arcs).chain(pairs).for_each(|&c| fails[c as usize] = true);
    (0..count).filter(|&c| !there[c]).for_each(|c| fails[c] = true);
    if is_lifted {
        // Close sheets are far apart there: cells in several parts are as bad.
        (0..count).filter(|&c| !dual.components[c].whole).for_each(|c| fails[c] = true);
    }
    let non_manifold = measure::non_manifold_vertices(divided);
    for piece in &dual.pieces {
        if surface.welded()[piece.facet as usize].iter().any(|&v| non_manifold[v as usize]) {
            fails[piece.component as usize] = false;
        }
    }
    let all: Vec<u32> = (0..).zip(&fails).filter(|(_, fails)| **fails).map(|(c, _)| c).collect();
    // Most cells in several parts have them on two close sheets, which is no failure.
    let area = all.iter().map(|&c| dual.components[c as usize].area).sum();
    let components: Vec<u32> = all.iter().copied().filter(|&c| is_lifted || whole(c)).collect();
    Ok(FailingCells { components: if components.is_empty() { all } else { components }, area, vertices })
}

/// Makes the lengths, one a vertex of `separated`, shorter by a factor at the vertices in failing cells; for a cell without a
/// vertex, at the nearest corner of its facet. The first vertices of `surface` are those of `separated`.
pub(super) fn shorten(
    lengths: &mut [f64],
    factor: f64,
    separated: &TriMesh,
    failing: &FailingCells,
    dual: &Dual,
    surface: &Surface,
    token: &Token,
) -> Result<(), Stopped> {
    let mut fails = vec![false; dual.components.len()];
    failing.components.iter().for_each(|&c| fails[c as usize] = true);
    let mut without_vertex = fails.clone();
    let mut held = vec![false; surface.positions().len()];
    for piece in dual.pieces.iter().filter(|piece| fails[piece.component as usize]) {
        for corner in (0..3).filter(|c| piece.corners & 1 << c != 0) {
            let vertex = surface.welded()[piece.facet as usize][corner] as usize;
            held[vertex] = true;
            if vertex < lengths.len() {
                without_vertex[piece.component as usize] = false;
            }
        }
    }
    let mut shorter = vec![false; lengths.len()];
    let mut closest = None;
    for (component, _) in dual.components.iter().zip(&without_vertex).filter(|(_, without)| **without) {
        token.check()?;
        let tree = closest.get_or_insert_with(|| ClosestPoint::new(separated));
        let SurfacePoint { facet, barycentric, .. } = tree.project(surface.frame().to_world(component.centroid));
        let corner = (0..3).max_by(|&a, &b| barycentric[a].total_cmp(&barycentric[b])).unwrap_or_default();
        shorter[separated.facets()[facet as usize][corner] as usize] = true;
    }
    // Welded vertices are one.
    let welded = surface.facets().iter().zip(surface.welded()).flat_map(|(own, first)| own.iter().zip(first));
    let welded = welded.map(|(&own, &first)| (own as usize, first as usize)).filter(|(own, _)| *own < lengths.len());
    welded.clone().for_each(|(own, first)| held[first] |= shorter[own]);
    welded.for_each(|(own, first)| shorter[own] |= held[first]);
    lengths.iter_mut().zip(&shorter).filter(|(_, shorter)| **shorter).for_each(|(length, _)| *length *= factor);
    Ok(())
}

pub(super) fn is_near(vertices: usize, asked: usize) -> bool {
    vertices.abs_diff(asked) <= COUNT_SLACK.max((COUNT_LIMIT * asked as f64) as usize)
}

/// Why a result with this number of vertices and parts does not have as many as were asked for; `None` if it has.
pub(super) fn count_reason(
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
