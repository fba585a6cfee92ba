//! Centroidal Voronoi tessellation: iterations that move the seeds.
//!
//! Purpose: [`Cvt`] holds a backend session and the seeds, and takes one step at a time, so that
//! a caller can look, stop or edit the seeds between steps.
//! Invariant: sees the backend through its trait and cannot name one. Energy and gradient come
//! from one pass over the diagram. The seeds stay where the backend keeps them, and come to the host
//! when somebody asks.
//! Must not know: files, remeshing, jobs.

mod convergence;
pub(crate) mod curves;
pub(crate) mod density;
mod line_search;
mod relax;
mod reseed;

use std::collections::HashSet;
use std::sync::Arc;
use std::time::Instant;

use glam::DVec3;

pub use density::{Count, DensityError, DensityFigures, DensityOptions, DensitySource};

use convergence::Convergence;
use curves::CurveSeeds;

use crate::mesh::closest_point::ClosestPoint;
use crate::rvd::{
    Backend, CellSums, DeviceWork, Evaluation, PassStats, Resident, RvdError, Session, SessionOptions, Surface,
    check_seeds, elapsed_ms,
};
use crate::token::Token;

/// Where seeds go after each step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Projection {
    /// They stay where the step put them, near the surface.
    #[default]
    Free,
    /// Each is moved to the closest point of the surface.
    OnSurface,
}

/// How iterations are done.
#[derive(Clone, Copy, Debug, Default)]
#[non_exhaustive]
pub struct CvtOptions {
    /// Where seeds go after each step.
    pub projection: Projection,
    /// Room for so many seeds; 0 means as many as are given at first.
    pub max_seeds: usize,
}

impl CvtOptions {
    /// The defaults.
    pub fn new() -> Self {
        Self::default()
    }

    setters! {
        with_projection(projection: Projection),
        with_max_seeds(max_seeds: usize),
    }
}

/// Which kind of step was taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
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

/// What one step saw and did. Energies and gradients are those of the seeds *before* the step,
/// in the caller's units.
#[derive(Clone, Copy, Debug)]
pub struct Iteration {
    /// 0 for the first step of this `Cvt`.
    pub index: usize,
    /// What was done.
    pub kind: StepKind,
    /// E = Σ ∫ w |p - x_i|², with weights scaled so that the largest is in (1/2, 1].
    pub energy: f64,
    /// E over [`Surface::hexagonal_energy`]: about 1.98 for random seeds, 1.0 when converged.
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

/// A change of the seeds between two steps. Positions in the caller's coordinates.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum SeedEdit {
    /// Seed `index` goes to `to`.
    Move {
        /// Which seed.
        index: u32,
        /// Where it goes.
        to: DVec3,
    },
    /// A new seed, with the next index.
    Add {
        /// Where it is.
        at: DVec3,
    },
    /// Seed `index` goes away; the last seed takes its index.
    Remove {
        /// Which seed.
        index: u32,
    },
}

/// Intruders that become seeds of a curve; more of them are a curve that the seeds cannot resolve.
const MOST_ADOPTED: usize = 64;

/// Times that seeds are pushed off curves after they were put on the surface: who was pushed may intrude elsewhere.
const PUSHES: usize = 4;

/// A first step, where 1 takes seeds to their centroids. The energy falls most at about this: by 0.035 of 1.11 after
/// five Lloyd steps on three models, and by 0.014 at 1.
const FIRST_STEP: f64 = 3.5;

/// Who has the present seeds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Newest {
    /// The host alone.
    OnHost,
    /// The host and the session.
    OnBoth,
    /// The session alone, which has moved them.
    InSession,
}

/// One surface, its seeds, and the session that computes their diagram.
pub struct Cvt {
    surface: Arc<Surface>,
    session: Box<dyn Session>,
    options: CvtOptions,
    /// Unit frame; behind the session's where that has moved them.
    seeds: Vec<DVec3>,
    newest: Newest,
    /// Seeds that never move; empty if all do.
    held: Vec<bool>,
    /// The first seeds lie on curves, of which the others are kept clear.
    curves: CurveSeeds,
    /// What the last pass found at the present seeds.
    present: Option<Evaluation>,
    /// The present seeds' history is empty, so that a step's length has to be guessed.
    fresh: bool,
    convergence: Convergence,
    converged: bool,
    sums: CellSums,
    /// The surface in the unit frame, built when it is first needed.
    closest: Option<ClosestPoint>,
    steps: usize,
}

impl Cvt {
    /// Opens a session for `seeds` (caller's coordinates) and room for more.
    ///
    /// # Errors
    /// What the backend says of the seeds and of the memory it needs.
    pub fn new(
        backend: &dyn Backend,
        surface: Arc<Surface>,
        seeds: &[DVec3],
        mut options: CvtOptions,
    ) -> Result<Self, RvdError> {
        options.max_seeds = options.max_seeds.max(seeds.len());
        let session = backend.session(Arc::clone(&surface), SessionOptions::new(options.max_seeds))?;
        let seeds: Vec<DVec3> = seeds.iter().map(|&p| surface.frame().to_unit(p)).collect();
        check_seeds(&seeds, options.max_seeds)?;
        Ok(Self {
            surface,
            session,
            options,
            seeds,
            newest: Newest::OnHost,
            held: Vec::new(),
            curves: CurveSeeds::default(),
            present: None,
            fresh: true,
            convergence: Convergence::default(),
            converged: false,
            sums: CellSums::default(),
            closest: None,
            steps: 0,
        })
    }

    /// Takes what answers for closest points of its surface ([`Surface::closest_points`]), so that it need not make it.
    pub fn bring_closest(&mut self, closest: ClosestPoint) {
        self.closest = Some(closest);
    }

    /// Which seeds never move, one entry a seed.
    ///
    /// # Errors
    /// `Internal` if the list is not as long as there are seeds.
    pub fn hold(&mut self, held: Vec<bool>) -> Result<(), RvdError> {
        if held.len() != self.seeds.len() {
            return Err(RvdError::Internal(format!("{} marks for {} seeds", held.len(), self.seeds.len())));
        }
        self.download()?;
        self.held = held;
        self.seeds_changed();
        Ok(())
    }

    /// Holds the first seeds, which are those of `curves`, and keeps the others clear of them in every Lloyd
    /// step.
    ///
    /// # Errors
    /// `Internal` if there are fewer seeds.
    pub(crate) fn keep_curves(&mut self, curves: CurveSeeds, token: &Token) -> Result<(), RvdError> {
        self.hold((0..self.seeds.len()).map(|i| i < curves.len()).collect())?;
        self.curves = curves;
        self.clear_curves(token)?;
        Ok(())
    }

    /// Pushes seeds off the curves. Returns how many there were.
    ///
    /// # Errors
    /// Those of the device, such as [`RvdError::DeviceLost`]: nothing was changed; the session must be opened again.
    pub(crate) fn clear_curves(&mut self, token: &Token) -> Result<usize, RvdError> {
        if self.curves.is_empty() {
            return Ok(0);
        }
        self.download()?;
        let mut seeds = self.seeds.clone();
        let pushed = self.curves.push_out(&mut seeds, token)?;
        if pushed > 0 {
            self.seeds = seeds;
            self.seeds_changed();
        }
        Ok(pushed)
    }

    /// Makes seeds that come between two neighbours on a curve, and could not be pushed off, seeds of that curve.
    /// Returns how many there were.
    ///
    /// # Errors
    /// Those of the device, such as [`RvdError::DeviceLost`]: nothing was changed; the session must be opened again.
    pub fn adopt_intruders(&mut self, token: &Token) -> Result<usize, RvdError> {
        self.download()?;
        let mut adopted = 0;
        while adopted < MOST_ADOPTED {
            // One a segment: who comes between the same two may not, when these have another between them. Seeds ascend, so
            // that none of those to come changes its number.
            let mut split = HashSet::new();
            let mut intruders = self.curves.intruders(&self.seeds, token)?;
            intruders.retain(|&(_, segment)| split.insert(segment));
            intruders.truncate(MOST_ADOPTED - adopted);
            if intruders.is_empty() {
                break;
            }
            for &(seed, segment) in &intruders {
                let place = self.curves.len();
                self.seeds.swap(place, seed as usize);
                self.held.swap(place, seed as usize);
                self.seeds[place] = self.curves.split(segment, curves::INNER_POINTS / 2);
                self.held[place] = true;
            }
            adopted += intruders.len();
        }
        if adopted > 0 {
            self.seeds_changed();
        }
        Ok(adopted)
    }

    /// The curves' seeds, which are the first ones.
    pub(crate) fn curves(&self) -> &CurveSeeds {
        &self.curves
    }

    /// Puts seeds at places (unit frame), where they stay, and adds and holds new ones as far as there is room.
    /// Returns how many could be added.
    ///
    /// # Errors
    /// `NoSuchSeed`, `NonFiniteSeed`, or an error of the device.
    pub(crate) fn pin(&mut self, pins: &[(u32, DVec3)], new: &[DVec3]) -> Result<usize, RvdError> {
        self.download()?;
        self.held.resize(self.seeds.len(), false);
        for &(seed, to) in pins {
            let seeds = self.seeds.len();
            let place = self.seeds.get_mut(seed as usize).ok_or(RvdError::NoSuchSeed { seed: seed as usize, seeds })?;
            (*place, self.held[seed as usize]) = (to, true);
        }
        let room = self.options.max_seeds - self.seeds.len().min(self.options.max_seeds);
        let added = new.len().min(room);
        self.seeds.extend(&new[..added]);
        self.held.resize(self.seeds.len(), true);
        self.seeds_changed();
        Ok(added)
    }

    /// One Lloyd step: every seed to the centroid of its cell.
    ///
    /// A seed whose cell is empty is placed anew beside the cell of highest energy.
    ///
    /// # Errors
    /// `Stopped`, or an error of the device. The seeds are then as before, or, where the step was stopped while they were put on
    /// the surface, as after it.
    pub fn lloyd(&mut self, token: &Token) -> Result<Iteration, RvdError> {
        self.metered(|cvt| cvt.take_lloyd(token))
    }

    fn take_lloyd(&mut self, token: &Token) -> Result<Iteration, RvdError> {
        let begin = Instant::now();
        let (evaluation, evaluations) = self.evaluate(token)?;
        self.lloyd_from(
            evaluation,
            Iteration { evaluations, ..self.figures(StepKind::Lloyd, evaluation) },
            begin,
            token,
        )
    }

    /// One quasi-Newton step (L-BFGS; \[YLL*09\], \[FWW14\]): along -H∇E as far as the strong Wolfe
    /// conditions ask. Where the search fails, and where cells are empty, it is a Lloyd step instead.
    ///
    /// # Errors
    /// `Stopped`, or an error of the device. The seeds are then as before, or, where the step was stopped while they were put on
    /// the surface, as after it.
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
            return self.lloyd_from(evaluation, report, begin, token);
        }
        let vectors = resident(&mut *self.session)?;
        let mut slope = vectors.search_direction()?;
        let mut first = if self.fresh { FIRST_STEP } else { 1.0 };
        if slope >= 0.0 {
            vectors.clear_history();
            slope = vectors.search_direction()?;
            first = FIRST_STEP;
        }
        let found = line_search::search(vectors, (evaluation.energy, slope), first, token)?;
        report.evaluations += found.probes;
        report.stats.add(&found.stats);
        let Some(next) = found.evaluation else {
            report.kind = StepKind::Lloyd;
            return self.lloyd_from(evaluation, report, begin, token);
        };
        vectors.accept()?;
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

    /// Whether the last quasi-Newton step passed a test of convergence: ‖∇E‖ below a thousandth of the
    /// first step's, or two steps running that gain less than a millionth of the energy.
    pub fn converged(&self) -> bool {
        self.converged
    }

    /// Energy, energy ratio and gradient norm of the present seeds, as in [`Iteration`]: known after a
    /// quasi-Newton step, otherwise one more pass.
    ///
    /// # Errors
    /// `Stopped`, or an error of the device.
    pub fn present(&mut self, token: &Token) -> Result<Iteration, RvdError> {
        let (evaluation, evaluations) = self.evaluate(token)?;
        Ok(Iteration { evaluations, ..self.figures(StepKind::Lloyd, evaluation) })
    }

    /// Moves every seed that is not held to the closest point of the surface.
    ///
    /// # Errors
    /// `Stopped`, with the seeds where they were; or `Internal`.
    pub fn project_seeds(&mut self, token: &Token) -> Result<(), RvdError> {
        self.download()?;
        let mut seeds = std::mem::take(&mut self.seeds);
        let done = self.project(&mut seeds, token);
        self.seeds = seeds;
        self.seeds_changed();
        done
    }

    /// Moves every seed that is not held to the closest point of the surface that is clear of the curves: along a sharp crease
    /// seeds lie inside, between its two sides, and the point that is closest to one may be between two seeds of the curve.
    ///
    /// # Errors
    /// `Stopped`, with the seeds somewhere between; or `Internal`.
    pub fn put_on_surface(&mut self, token: &Token) -> Result<(), RvdError> {
        self.project_seeds(token)?;
        for _ in 0..PUSHES {
            let held = &self.held;
            let stays = |i: u32| held.get(i as usize).is_some_and(|&held| held);
            if self.curves.is_empty() || self.curves.push_out_unless(&mut self.seeds, stays, token)? == 0 {
                break;
            }
            self.project_seeds(token)?;
        }
        Ok(())
    }

    /// The seeds now, caller's coordinates.
    ///
    /// # Errors
    /// Those of the device, such as [`RvdError::DeviceLost`]: nothing was changed; the session must be opened again.
    pub fn seeds(&mut self) -> Result<Vec<DVec3>, RvdError> {
        self.download()?;
        Ok(self.seeds.iter().map(|&p| self.surface.frame().to_world(p)).collect())
    }

    /// How many seeds there are.
    pub fn len(&self) -> usize {
        self.seeds.len()
    }

    /// Whether there are no seeds (there always are).
    pub fn is_empty(&self) -> bool {
        self.seeds.is_empty()
    }

    /// The seeds now, unit frame.
    ///
    /// # Errors
    /// Those of the device, such as [`RvdError::DeviceLost`]: nothing was changed; the session must be opened again.
    pub(crate) fn unit_seeds(&mut self) -> Result<&[DVec3], RvdError> {
        self.download()?;
        Ok(&self.seeds)
    }

    /// Applies edits in order; nothing is changed if one of them is wrong.
    ///
    /// # Errors
    /// `TooManySeeds` beyond the room reserved, `NonFiniteSeed`, `NoSeeds` if none would be
    /// left, `NoSuchSeed`.
    pub fn edit(&mut self, edits: &[SeedEdit]) -> Result<(), RvdError> {
        self.download()?;
        let frame = self.surface.frame();
        let mut seeds = self.seeds.clone();
        let mut held = self.held.clone();
        held.resize(seeds.len(), false);
        for edit in edits {
            match *edit {
                SeedEdit::Move { index, to } => {
                    let count = seeds.len();
                    let seed = seeds
                        .get_mut(index as usize)
                        .ok_or(RvdError::NoSuchSeed { seed: index as usize, seeds: count })?;
                    *seed = frame.to_unit(to);
                }
                SeedEdit::Add { at } => {
                    if seeds.len() == self.options.max_seeds {
                        return Err(RvdError::TooManySeeds { given: seeds.len() + 1, limit: self.options.max_seeds });
                    }
                    seeds.push(frame.to_unit(at));
                    held.push(false);
                }
                SeedEdit::Remove { index } => {
                    if index as usize >= seeds.len() {
                        return Err(RvdError::NoSuchSeed { seed: index as usize, seeds: seeds.len() });
                    }
                    seeds.swap_remove(index as usize);
                    held.swap_remove(index as usize);
                }
            }
        }
        check_seeds(&seeds, self.options.max_seeds)?;
        self.seeds = seeds;
        if held.contains(&true) {
            self.held = held;
        }
        self.seeds_changed();
        Ok(())
    }

    /// The diagram's session with the present seeds set, for a caller that wants cells.
    ///
    /// # Errors
    /// What the backend says of the seeds.
    pub fn session(&mut self) -> Result<&mut dyn Session, RvdError> {
        self.upload()?;
        Ok(&mut *self.session)
    }

    /// What answers for closest points of the surface, caller's coordinates, if it was needed; gives the rest back.
    pub(crate) fn into_closest(self) -> Option<ClosestPoint> {
        let frame = self.surface.frame();
        self.closest.map(|tree| tree.moved(frame.centre, frame.scale))
    }

    /// The surface.
    pub fn surface(&self) -> &Arc<Surface> {
        &self.surface
    }

    /// Bytes of device memory held.
    pub fn device_bytes(&self) -> u64 {
        self.session.device_bytes()
    }

    /// What the device did since the session was opened.
    pub fn device_work(&self) -> DeviceWork {
        self.session.device_work()
    }

    /// Takes a step and puts into its report all that the device did for it, not only in its passes. A device that
    /// keeps time says what the phases took.
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
        self.convergence.begin(evaluation.gradient_squared.sqrt());
        self.present = Some(evaluation);
        Ok((evaluation, 1))
    }

    /// The step to the centroids from seeds that were evaluated.
    fn lloyd_from(
        &mut self,
        evaluation: Evaluation,
        mut report: Iteration,
        begin: Instant,
        token: &Token,
    ) -> Result<Iteration, RvdError> {
        let update = Instant::now();
        let vectors = resident(&mut *self.session)?;
        if evaluation.empty_cells > 0 {
            vectors.read_sums(&mut self.sums)?;
        }
        vectors.to_centroids()?;
        (self.newest, self.fresh) = (Newest::InSession, true);
        self.present = None;
        if evaluation.empty_cells > 0 {
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

    /// Whether a seed never moves.
    pub(crate) fn is_held(&self, seed: u32) -> bool {
        self.held.get(seed as usize).is_some_and(|&held| held)
    }

    fn project(&mut self, seeds: &mut [DVec3], token: &Token) -> Result<(), RvdError> {
        let closest = closest(&mut self.closest, &self.surface)?;
        let held = &self.held;
        let free = |i: usize| !held.get(i).is_some_and(|&held| held);
        let placed = closest.project_all(seeds, token)?;
        let moved = seeds.iter_mut().zip(placed).enumerate().filter(|(i, _)| free(*i));
        moved.for_each(|(_, (seed, place))| *seed = place.position);
        Ok(())
    }

    /// Hands the seeds to the session if it has others.
    fn upload(&mut self) -> Result<(), RvdError> {
        if self.newest == Newest::OnHost {
            self.session.set_seeds(&self.seeds)?;
            if !self.held.is_empty() {
                resident(&mut *self.session)?.hold(&self.held)?;
            }
            self.newest = Newest::OnBoth;
        }
        Ok(())
    }

    /// Fetches the seeds if the session has moved them.
    fn download(&mut self) -> Result<(), RvdError> {
        if self.newest == Newest::InSession {
            resident(&mut *self.session)?.read(&mut self.seeds)?;
            self.newest = Newest::OnBoth;
        }
        Ok(())
    }

    /// The host's seeds are others now.
    fn seeds_changed(&mut self) {
        (self.newest, self.fresh) = (Newest::OnHost, true);
        self.present = None;
    }
}

fn resident(session: &mut dyn Session) -> Result<&mut dyn Resident, RvdError> {
    session.resident().ok_or_else(|| RvdError::Internal("this backend cannot move seeds".to_owned()))
}

/// What answers for closest points of a surface, made on first use.
fn closest<'a>(slot: &'a mut Option<ClosestPoint>, surface: &Surface) -> Result<&'a ClosestPoint, RvdError> {
    match slot {
        Some(tree) => Ok(tree),
        None => Ok(slot.insert(surface.closest_points()?)),
    }
}
