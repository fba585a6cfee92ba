//! Attempts at a remesh, one or several until a tolerance is met.
//!
//! Purpose: [`Job::attempt`] optimizes the seeds, then builds results in rounds. Each round adds seeds where the result is too far
//! from the input, or moves seeds that produced no vertex. [`refine`] remeshes again and again, each time with shorter edges where
//! the last result was too far from the input, then with longer ones where it was nearer than it has to be. The distance of a facet from a
//! smooth surface falls with the square of its edges, so a few rounds do. Shorter edges that grade into the others keep triangles round.
//! Seeds that are only added do not: steps spread them out again. Given seeds stay, so [`Job::add`] can only add to them.
//! Invariant: never more points than allowed; the nearest result of all rounds comes back. If it is too far, as many points with a
//! uniform density or one by curvature are no nearer, unless the lengths were given. At most [`MAX_REFINING_ROUNDS`] rounds, one
//! that adds seeds, and two comparisons for each of two searches, and [`MAX_LENGTHENING_ROUNDS`]. The result does not depend on how many
//! points drawn seeds were asked for, but for how many there may be.
//! Must not know: how a surface is made, how distances are measured.

use glam::DVec3;

use super::adapt;
use super::crossing::shorten_near;
use super::extract::{Built, Draft, Extraction, Missed};
use super::job::Job;
use super::optimize::{Optimized, exact_dual};
use super::patches;
use super::prepare::{Metric, Prepared, prepare, with_source};
use super::schedule::{Figures, Schedule};
use crate::cvt::density::{DensitySource, Plan};
use crate::mesh::TriMesh;
use crate::mesh::adjacency::Adjacency;
use crate::mesh::closest_point::ClosestPoint;
use crate::mesh::comparison::{Comparison, Distances};
use crate::mesh::crossings::crossing_facets;
use crate::mesh::measure::topology_unless;
use crate::remesh::constants::*;
use crate::remesh::features::KeptCurves;
use crate::remesh::metric::Wanted;
use crate::remesh::report::{DeviceFigures, RefineEnd};
use crate::remesh::{Limits, Placement, Refine, RemeshOptions, Result, Seeds};
use crate::rvd::{Lifted, RvdError};

struct Measured<'a> {
    attempt: Attempt<'a>,
    distances: Distances,
    options: RemeshOptions,
}

impl Measured<'_> {
    /// Points that were asked for: of a seed that several sheets have, one.
    fn points(&self) -> usize {
        self.attempt.seeds.len().saturating_sub(self.attempt.curves.surplus())
    }
}

struct Search<'a, 'j, 'b> {
    job: &'j mut Job<'a, 'b>,
    comparison: Comparison<'a>,
    limits: Limits,
    best: Measured<'a>,
    /// Points and largest distance of the first one.
    first: (usize, f64),
    rounds: usize,
    /// Points of the last comparison with other densities.
    compared: usize,
    /// Passes over the diagram that the other results took.
    passes_of_others: usize,
}

fn attempt<'a>(
    job: &mut Job<'a, '_>,
    comparison: &Comparison<'a>,
    prepared: Prepared<'a>,
    options: RemeshOptions,
    tolerance: f64,
) -> Result<Measured<'a>> {
    let attempt = job.attempt(prepared, &options, Some(tolerance))?;
    let distances = comparison.with(&attempt.built.mesh, job.token)?;
    job.laps.end(|t| &mut t.refine);
    Ok(Measured { attempt, distances, options })
}

/// The options of a remesh within a tolerance, from the number of points that it begins with; `None` if that is as given. It goes with the
/// surface and the tolerance alone, so that the result does, too, and not with how many points are asked for.
pub(super) fn begin(mesh: &TriMesh, options: &RemeshOptions) -> Option<RemeshOptions> {
    let (Some(Refine { tolerance, max_points }), &Seeds::Sample { points, seed }) = (options.refine, &options.seeds)
    else {
        return None;
    };
    let most = max_points.unwrap_or(points.saturating_mul(2));
    // Vertices that stay are in the number.
    if !begins_anew(options) || options.keeps_parts() || points > most {
        return None;
    }
    let (low, high) = mesh.bounds();
    let points = mesh.area() / (FIRST_POINTS_AREA * tolerance.length(mesh) * (high - low).length());
    // Saturates.
    let points = (points as usize).clamp(LEAST_FIRST_POINTS, most.max(LEAST_FIRST_POINTS)).min(most);
    let refine = Refine { tolerance, max_points: Some(most) };
    Some(RemeshOptions { refine: Some(refine), seeds: Seeds::Sample { points, seed }, ..options.clone() })
}

/// Whether a tolerance alone says how many points there are. Lengths that are given are the longest that edges may have.
fn begins_anew(options: &RemeshOptions) -> bool {
    let given = matches!(options.density.source, DensitySource::Sizes(_) | DensitySource::Weights(_));
    matches!(options.seeds, Seeds::Sample { .. }) && options.density.edge_length.is_none() && !given
}

/// Remeshes from what is prepared for `options`, with more points where the result is too far from the input.
pub(super) fn refine<'a>(
    job: &mut Job<'a, '_>,
    prepared: Prepared<'a>,
    options: &RemeshOptions,
    limits: Limits,
    random_seed: u64,
) -> Result<Attempt<'a>> {
    let options = RemeshOptions { refine: None, ..options.clone() };
    let mut search = Search::begin(job, prepared, options.clone(), limits)?;
    let mut from = None;
    // Where another density is nearer, one more search goes on from there.
    for _ in 0..2 {
        search.shorten(from.take(), random_seed)?;
        search.add_few()?;
        if !search.compare(&options, random_seed)? {
            break;
        }
        from = Some(search.best.attempt.plan.lengths(search.job.separated, search.job.token)?);
    }
    if begins_anew(&options) {
        search.uncross(random_seed)?;
        search.lengthen(random_seed)?;
    }
    Ok(search.end())
}

impl<'a, 'j, 'b> Search<'a, 'j, 'b> {
    fn begin(job: &'j mut Job<'a, 'b>, prepared: Prepared<'a>, options: RemeshOptions, limits: Limits) -> Result<Self> {
        let comparison = Comparison::new(job.separated, limits.tolerance, job.token)?;
        let best = attempt(job, &comparison, prepared, options, limits.tolerance)?;
        let first = (best.points(), best.distances.largest);
        let limits = Limits { max_points: limits.max_points.max(first.0), ..limits };
        Ok(Self { job, comparison, limits, best, first, rounds: 0, compared: 0, passes_of_others: 0 })
    }

    fn is_done(&self) -> bool {
        self.best.distances.missed == 0
    }

    fn is_spent(&self) -> bool {
        self.best.points() as f64 >= SPENT_SHARE * self.limits.max_points as f64
    }

    fn attempt(&mut self, options: RemeshOptions, tolerance: f64) -> Result<()> {
        self.job.enter("prepare");
        let prepared = prepare(self.job.separated, &options, self.job.asked, None, self.job.token)?;
        let next = attempt(self.job, &self.comparison, prepared, options, tolerance)?;
        self.offer(next);
        Ok(())
    }

    /// Takes another result if it is nearer.
    fn offer(&mut self, mut next: Measured<'a>) {
        if next.distances.largest < self.best.distances.largest {
            std::mem::swap(&mut self.best, &mut next);
        }
        self.passes_of_others += next.attempt.figures.passes();
    }

    /// Rounds with shorter edges, from these lengths or from those of the best result.
    fn shorten(&mut self, from: Option<Vec<f64>>, random_seed: u64) -> Result<()> {
        let (separated, token) = (self.job.separated, self.job.token);
        let Limits { tolerance, max_points } = self.limits;
        let mut lengths = from.map_or_else(|| self.best.attempt.plan.lengths(separated, token), Ok)?;
        let mut options = RemeshOptions { refine: None, ..self.best.options.clone() };
        let mut by_vertex = self.best.distances.by_vertex.clone();
        let (mut vain, mut points, mut full) = (0, self.best.points(), self.first.0 == max_points);
        while !self.is_done() && self.rounds < MAX_REFINING_ROUNDS && vain < MAX_VAIN_REFINING {
            self.rounds += 1;
            let mut growth: f64 = if vain > 0 { VAIN_GROWTH } else { 1.0 };
            if self.rounds > LOCAL_ROUNDS {
                let left = (MAX_REFINING_ROUNDS + 1 - self.rounds) as f64;
                growth = growth.max((max_points as f64 / points as f64).powf(left.recip()));
            }
            let even = if full { 1.0 } else { growth.sqrt().recip() };
            let aim = TOLERANCE_AIM * tolerance;
            for (length, &d) in lengths.iter_mut().zip(&by_vertex) {
                let nearer = if d > aim { (aim / d).sqrt().max(SHORTEST_SHARE) } else { 1.0 };
                *length *= nearer.min(even);
            }
            options = with_source(&options, DensitySource::Sizes(lengths));
            options.density.max_points = max_points;
            options.seeds = Seeds::Implied { seed: random_seed };
            let prepared = match self.job.prepare_again(&options, None)? {
                Some(prepared) => prepared,
                None => {
                    full = true;
                    options.seeds = Seeds::Sample { points: max_points, seed: random_seed };
                    prepare(separated, &options, self.job.asked, None, token)?
                }
            };
            let next = attempt(self.job, &self.comparison, prepared, options.clone(), tolerance)?;
            lengths = next.attempt.plan.lengths(separated, token)?;
            by_vertex.clone_from(&next.distances.by_vertex);
            points = next.points();
            let (before, now) = (&self.best.distances, &next.distances);
            let progress =
                now.largest < PROGRESS_SHARE * before.largest || now.missed_share < FEWER_MISSED * before.missed_share;
            vain = if progress { 0 } else { vain + 1 };
            self.offer(next);
            // Once the points are used up, rounds go on as long as they make better use of them.
            if full && vain > 0 {
                break;
            }
        }
        Ok(())
    }

    /// A result with these lengths of edges; `None` if they need too many points.
    fn with_lengths(&mut self, lengths: Vec<f64>, random_seed: u64) -> Result<Option<Measured<'a>>> {
        let options = RemeshOptions { refine: None, ..self.best.options.clone() };
        let mut options = with_source(&options, DensitySource::Sizes(lengths));
        options.density.max_points = self.limits.max_points;
        options.seeds = Seeds::Implied { seed: random_seed };
        let Some(prepared) = self.job.prepare_again(&options, None)? else { return Ok(None) };
        attempt(self.job, &self.comparison, prepared, options, self.limits.tolerance).map(Some)
    }

    /// Once the tolerance is met: rounds with shorter edges where facets cross, as long as fewer do. Where facets of the input cross, nothing
    /// changes.
    fn uncross(&mut self, random_seed: u64) -> Result<()> {
        if !self.is_done() {
            return Ok(());
        }
        let token = self.job.token;
        let mut crossing = self.job.crossing(&self.best.attempt.built.mesh)?;
        if crossing.is_empty() || !crossing_facets(self.job.clean, token)?.is_empty() {
            return Ok(());
        }
        for _ in 0..MAX_LENGTHENING_ROUNDS {
            self.rounds += 1;
            let mut lengths = self.best.attempt.plan.lengths(self.job.separated, token)?;
            shorten_near(&mut lengths, self.job.separated, (&self.best.attempt.built.mesh, &crossing), token)?;
            let Some(mut next) = self.with_lengths(lengths, random_seed)? else { break };
            let of_next = self.job.crossing(&next.attempt.built.mesh)?;
            let is_better = next.distances.missed == 0 && next.attempt.is_whole && of_next.len() < crossing.len();
            if is_better {
                std::mem::swap(&mut self.best, &mut next);
                crossing = of_next;
            }
            self.passes_of_others += next.attempt.figures.passes();
            if !is_better || crossing.is_empty() {
                break;
            }
        }
        Ok(())
    }

    /// Once the tolerance is met: rounds with longer edges where the result is nearer than it has to be, as long as points are saved and
    /// the topology and the curves stay.
    fn lengthen(&mut self, random_seed: u64) -> Result<()> {
        let (separated, token) = (self.job.separated, self.job.token);
        let mut soundness = Soundness::of(&self.best.attempt, self.job)?;
        // How much of the way edges go to the lengths that are sought.
        let mut pace = 1.0;
        for _ in 0..MAX_LENGTHENING_ROUNDS {
            if !self.is_done() {
                break;
            }
            self.rounds += 1;
            // At last all edges alike: the largest distance of a round is a matter of chance, too.
            let is_even = pace < LEAST_PACE;
            let mut lengths = self.best.attempt.plan.lengths(separated, token)?;
            let aim = TOLERANCE_AIM * self.limits.tolerance;
            for (length, &d) in lengths.iter_mut().zip(&self.best.distances.by_vertex) {
                let share = (aim / d.max(f64::MIN_POSITIVE)).sqrt().clamp(SHORTEST_SHARE, LONGEST_SHARE);
                *length *= if is_even { EVEN_GROWTH } else { share.powf(pace) };
            }
            let next = self.with_lengths(lengths, random_seed);
            token.check()?;
            let mut next = match next {
                Ok(Some(next)) => next,
                // So few that a part or a patch has no room for its vertices.
                Err(_) if !is_even => {
                    pace *= 0.5;
                    continue;
                }
                _ => break,
            };
            let saved = self.best.points() as f64 - next.points() as f64;
            let is_less = saved >= LEAST_SAVED * self.best.points() as f64;
            let mut is_better = saved > 0.0 && next.distances.missed == 0 && next.attempt.is_whole;
            if is_better {
                let of_next = Soundness::of(&next.attempt, self.job)?;
                is_better = of_next.is_kept_from(&soundness);
                if is_better {
                    soundness = of_next;
                    std::mem::swap(&mut self.best, &mut next);
                }
            }
            self.passes_of_others += next.attempt.figures.passes();
            if is_even && !is_better {
                break;
            }
            pace = if is_better && is_less { pace } else { 0.5 * pace };
        }
        Ok(())
    }

    /// The best again, with a few seeds more, if it misses little.
    fn add_few(&mut self) -> Result<()> {
        if self.is_done() || self.is_spent() || self.best.distances.missed_share > FEW_MISSED_SHARE {
            return Ok(());
        }
        self.rounds += 1;
        let options = RemeshOptions { refine: Some(self.limits.into()), ..self.best.options.clone() };
        self.attempt(options, TOLERANCE_AIM * self.limits.tolerance)
    }

    /// If the best is too far: as many points by other densities. Returns whether one was so much nearer as to go on from.
    fn compare(&mut self, first: &RemeshOptions, random_seed: u64) -> Result<bool> {
        let given = matches!(first.density.source, DensitySource::Sizes(_) | DensitySource::Weights(_));
        let (points, before) = (self.best.points(), self.best.distances.largest);
        if self.is_done() || given || points == self.compared {
            return Ok(false);
        }
        self.compared = points;
        for source in [DensitySource::Uniform, DensitySource::Curvature] {
            if points == self.first.0 && source == first.density.source {
                continue;
            }
            let options = with_source(first, source).with_seeds(Seeds::Sample { points, seed: random_seed });
            self.attempt(options, self.limits.tolerance)?;
        }
        Ok(self.best.distances.largest < PROGRESS_SHARE * before && !self.is_done() && !self.is_spent())
    }

    /// The nearest result, and what ended the search.
    fn end(self) -> Attempt<'a> {
        let ended = match &self.best.distances {
            _ if self.is_done() => RefineEnd::Reached,
            // More points are of use if those that there were have been, or if there were none.
            now if self.is_spent()
                && (now.largest < PROGRESS_SHARE * self.first.1
                    || self.first.0 as f64 >= SPENT_SHARE * self.limits.max_points as f64) =>
            {
                RefineEnd::Budget
            }
            _ => RefineEnd::NoProgress,
        };
        let points = self.best.points();
        let Measured { mut attempt, distances, .. } = self.best;
        let figures = &mut attempt.figures.refine;
        figures.rounds += self.rounds;
        figures.added_seeds = points.saturating_sub(self.first.0);
        figures.evaluations += self.passes_of_others;
        figures.out_of_tolerance = distances.missed;
        figures.deviation_percent = Some(100.0 * distances.largest / self.job.diagonal);
        figures.ended = Some(ended);
        attempt
    }
}

pub(super) struct Attempt<'a> {
    pub(super) plan: Plan<'a>,
    pub(super) curves: KeptCurves,
    pub(super) closest: Option<ClosestPoint>,
    pub(super) built: Built,
    /// Whether all patches of sheets that are apart along curves have their edges.
    pub(super) is_whole: bool,
    /// Caller's coordinates.
    pub(super) seeds: Vec<DVec3>,
    pub(super) figures: Figures,
    pub(super) device: DeviceFigures,
    pub(super) device_bytes: u64,
}

impl Attempt<'_> {
    /// Curves that were dropped, and segments without an edge.
    pub(super) fn lost_curves(&self) -> usize {
        self.curves.dropped().len() + self.built.segments.iter().filter(|edge| edge.is_none()).count()
    }
}

/// What a result with fewer points may not lose.
struct Soundness {
    euler: i64,
    components: usize,
    boundary_loops: usize,
    crossing: usize,
    lost_curves: usize,
}

impl Soundness {
    fn of(attempt: &Attempt<'_>, job: &Job<'_, '_>) -> Result<Self> {
        let (mesh, token) = (&attempt.built.mesh, job.token);
        let found = topology_unless(mesh, &Adjacency::unless(mesh, token)?, token)?;
        Ok(Self {
            euler: found.euler,
            components: found.components,
            boundary_loops: found.boundary_loops,
            crossing: job.crossing(mesh)?.len(),
            lost_curves: attempt.lost_curves(),
        })
    }

    fn is_kept_from(&self, other: &Self) -> bool {
        let topology = |of: &Self| (of.euler, of.components, of.boundary_loops);
        topology(self) == topology(other) && self.crossing <= other.crossing && self.lost_curves <= other.lost_curves
    }
}

impl<'a> Job<'a, '_> {
    /// Remeshes from what is prepared for given seeds, with more seeds where the result is too far from the input.
    pub(super) fn add(&mut self, from: Prepared<'a>, options: &RemeshOptions, limits: Limits) -> Result<Attempt<'a>> {
        let mut tolerance = limits.tolerance;
        let mut search = Search::begin(self, from, options.clone(), limits)?;
        let first = if let Seeds::Given(seeds) = &options.seeds { seeds.len() } else { search.first.0 };
        search.first = (first, f64::INFINITY);
        for _ in 1..MAX_ADDING_TIMES {
            if search.is_done() || search.is_spent() {
                break;
            }
            // Seeds are added by the distances of vertices, which are less than those of samples.
            let short = limits.tolerance / search.best.distances.largest;
            tolerance *= (PROGRESS_SHARE * short).max(SHORTEST_SHARE);
            search.attempt(options.clone(), tolerance)?;
        }
        Ok(search.end())
    }

    /// From what is prepared for `options` to a surface, its patches mended. Its creases may be off by half of `tolerance`.
    pub(super) fn attempt(
        &mut self,
        prepared: Prepared<'a>,
        options: &RemeshOptions,
        tolerance: Option<f64>,
    ) -> Result<Attempt<'a>> {
        let mut done = match prepared.lift {
            None => self.attempt_in::<DVec3>(prepared, options, tolerance),
            Some(_) => self.attempt_in::<Lifted>(prepared, options, tolerance),
        }?;
        if let Some(apart) = self.apart.filter(|_| self.meet) {
            let broken = |e| RvdError::Internal(format!("a surface was valid before: {e}"));
            let of = (&*done.plan.mesh, &done.curves, &done.seeds[..]);
            done.is_whole = patches::mend(&mut done.built, of, apart, self.token)?.map_err(broken)?;
        }
        Ok(done)
    }

    fn attempt_in<P: Metric>(
        &mut self,
        prepared: Prepared<'a>,
        options: &RemeshOptions,
        tolerance: Option<f64>,
    ) -> Result<Attempt<'a>> {
        let mut optimized = self.optimize::<P>(prepared, options)?;
        let figures = std::mem::take(&mut optimized.figures);
        let mut schedule = Schedule { job: self, options, figures };
        let (built, seeds) = build(&mut optimized, &mut schedule, tolerance)?;
        let figures = schedule.figures;
        let Optimized { plan, curves, cvt, .. } = optimized;
        let device = DeviceFigures::new(cvt.device_work(), &figures.iterations);
        let device_bytes = cvt.device_bytes();
        // Nothing else of it is needed: its memory is free for the measurements.
        let closest = cvt.into_closest();
        Ok(Attempt { plan, curves, closest, built, is_whole: true, seeds, figures, device, device_bytes })
    }
}

/// Builds the result of the present seeds, whose dual is there, and of better ones as long as rounds help. Returns the best
/// result and its seeds, caller's coordinates.
fn build<P: Metric>(
    Optimized { plan, surface, curves, cvt, session, dual, .. }: &mut Optimized<'_, P>,
    schedule: &mut Schedule<'_, '_, '_>,
    tolerance: Option<f64>,
) -> Result<(Built, Vec<DVec3>)> {
    let (options, token) = (schedule.options, schedule.job.token);
    let (divided, surface, curves) = (&*plan.mesh, &**surface, &*curves);
    let rounds = match (options.refine, options.placement) {
        (Some(_), _) => ADDING_ROUNDS,
        (None, Placement::Fitted) if options.newton > 0 => MOVING_ROUNDS,
        _ => 0,
    };
    let tolerance = tolerance.map(|t| t * surface.frame().scale);
    let first_added = cvt.len() as u32;
    let mut best: Option<(Draft, Vec<DVec3>)> = None;
    let (placement, adds) = (options.placement, options.refine.is_some());
    let shapes = schedule.job.asked.shapes;
    let extraction = Extraction { divided, surface, curves, placement, first_added, tolerance, adds, shapes, token };
    let mut round = 0;
    loop {
        token.check()?;
        schedule.job.enter("repair");
        // The whole draft is one task of the pool: its parts then find the pool's threads awake.
        let seeds = cvt.unit_places()?;
        let draft = rayon::scope(|_| extraction.draft(dual, &seeds))?;
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
            schedule.figures.rvd.of_dual(dual, surface);
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
        *dual = exact_dual((surface, &mut **session), cvt, schedule)?;
        schedule.job.laps.end(|t| &mut t.dual);
    }
    let (draft, mut seeds) = best.ok_or_else(|| RvdError::Internal("no result was built".to_owned()))?;
    let mut built = rayon::scope(|_| extraction.finish(draft))?;
    schedule.figures.refine.out_of_tolerance = built.missed;
    if let DensitySource::Metric(tensors) = &options.density.source {
        let asked = options.seeds.drawn();
        let wanted = Wanted { vertices: asked, most: options.density.max_points };
        built = adapt::adapt(built, (schedule.job.separated, tensors), (surface, curves), wanted, token)?;
        // Vertices are not those of the seeds any more.
        seeds = built.mesh.positions().to_vec();
        schedule.figures.asked = asked.unwrap_or(seeds.len());
    }
    schedule.job.laps.end(|t| &mut t.repair);
    Ok((built, seeds))
}
