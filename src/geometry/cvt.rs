//! Centroidal Voronoi tessellation: iterations that move the seeds.
//!
//! Purpose: [`Cvt`] holds a session and the seeds. It takes one step at a time: callers can look, stop or edit between.
//! Invariant: sees the backend through its trait and cannot name one. Energy and gradient come from one pass over the
//! diagram. The seeds stay where the backend keeps them, and come to the host on demand.
//! Must not know: files, remeshing, jobs.

pub(crate) mod curves;
pub mod density;
pub(crate) mod figures;
pub(crate) mod lifts;
mod line_search;
mod placement;
mod step;

use std::sync::Arc;

use glam::DVec3;

use crate::mesh::closest_point::ClosestPoint;
use crate::rvd::{
    Backend, CellSums, DeviceWork, Evaluation, Resident, RvdError, Session, SessionOptions, Space, Surface, check_seeds,
};
use curves::CurveSeeds;
pub use density::{Count, DensityError, DensityFigures, DensityOptions, DensitySource};
use lifts::{CurveLifts, MOST_SIDES};
pub use placement::SeedEdit;
pub(crate) use placement::lifted;
pub use step::{Iteration, StepKind};

/// Where the present seeds are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Newest {
    OnHost,
    OnBoth,
    /// The session alone, which has moved them.
    InSession,
}

/// One surface, its seeds, and the session that computes their diagram. An error of the device, such as
/// [`RvdError::DeviceLost`], changes no seeds; the session must be opened again.
pub struct Cvt<P: Space = DVec3> {
    surface: Arc<Surface<P>>,
    session: Box<dyn Session<P>>,
    options: CvtOptions,
    /// Unit frame; behind the session's where that has moved them.
    seeds: Vec<P>,
    /// Further points of seeds of curves, where the surface is lifted: one for each side but the first. The session has them behind the seeds.
    sides: Vec<(u32, P)>,
    /// Finds them.
    lifts: Option<Arc<CurveLifts>>,
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
    sums: CellSums<P>,
    /// The surface in the unit frame, built when it is first needed.
    closest: Option<ClosestPoint>,
    steps: usize,
}

impl Cvt {
    /// Opens a session for `seeds` (caller's coordinates) and room for more.
    pub fn new(
        backend: &dyn Backend,
        surface: Arc<Surface>,
        seeds: &[DVec3],
        options: CvtOptions,
    ) -> Result<Self, RvdError> {
        let seeds = seeds.iter().map(|&p| surface.frame().to_unit(p)).collect();
        Self::open(backend, surface, seeds, options, None)
    }
}

impl<P: Space> Cvt<P> {
    /// Opens a session for `seeds` (unit frame) and room for more.
    pub(crate) fn open(
        backend: &dyn Backend,
        surface: Arc<Surface<P>>,
        seeds: Vec<P>,
        mut options: CvtOptions,
        lifts: Option<Arc<CurveLifts>>,
    ) -> Result<Self, RvdError> {
        options.max_seeds = options.max_seeds.max(seeds.len());
        // Curves may get further seeds, and each has a few sides.
        let room = options.max_seeds + lifts.as_ref().map_or(0, |_| MOST_SIDES * options.max_seeds);
        let session = P::session(backend, Arc::clone(&surface), SessionOptions::new(room))?;
        check_seeds(&seeds, options.max_seeds)?;
        Ok(Self {
            surface,
            session,
            options,
            seeds,
            sides: Vec::new(),
            lifts,
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

    /// The seeds now, caller's coordinates.
    pub fn seeds(&mut self) -> Result<Vec<DVec3>, RvdError> {
        self.download()?;
        Ok(self.seeds.iter().map(|p| self.surface.frame().to_world(p.place())).collect())
    }

    /// How many seeds there are.
    pub fn len(&self) -> usize {
        self.seeds.len()
    }

    /// How many points a session needs room for.
    pub(crate) fn room(&self) -> usize {
        self.options.max_seeds + self.lifts.as_ref().map_or(0, |_| MOST_SIDES * self.options.max_seeds)
    }

    /// Whether there are no seeds (there always are).
    pub fn is_empty(&self) -> bool {
        self.seeds.is_empty()
    }

    /// The seeds now, unit frame.
    pub fn unit_seeds(&mut self) -> Result<&[P], RvdError> {
        self.download()?;
        Ok(&self.seeds)
    }

    /// Where the seeds are now, unit frame.
    pub(crate) fn unit_places(&mut self) -> Result<Vec<DVec3>, RvdError> {
        self.download()?;
        Ok(self.places())
    }

    fn places(&self) -> Vec<DVec3> {
        self.seeds.iter().map(|p| p.place()).collect()
    }

    /// The points whose diagram the session has, unit frame: the seeds, and then further sides of some, with their seeds.
    pub(crate) fn points_and_owners(&mut self) -> Result<(Vec<P>, Vec<u32>), RvdError> {
        self.download()?;
        let (owners, sides): (Vec<u32>, Vec<P>) = self.sides.iter().copied().unzip();
        Ok(([&self.seeds[..], &sides].concat(), owners))
    }

    /// The diagram's session with the present seeds set, for a caller that wants cells.
    pub fn session(&mut self) -> Result<&mut dyn Session<P>, RvdError> {
        self.upload()?;
        Ok(&mut *self.session)
    }

    /// What answers for closest points of the surface, caller's coordinates, if it was needed; gives the rest back.
    pub fn into_closest(self) -> Option<ClosestPoint> {
        let frame = self.surface.frame();
        self.closest.map(|tree| tree.moved(frame.centre, frame.scale))
    }

    /// The surface.
    pub fn surface(&self) -> &Arc<Surface<P>> {
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

    fn upload(&mut self) -> Result<(), RvdError> {
        if self.newest == Newest::OnHost && self.sides.is_empty() {
            self.session.set_seeds(&self.seeds)?;
            if !self.held.is_empty() {
                resident(&mut *self.session)?.hold(&self.held)?;
            }
            self.newest = Newest::OnBoth;
        } else if self.newest == Newest::OnHost {
            let all: Vec<P> = self.seeds.iter().copied().chain(self.sides.iter().map(|side| side.1)).collect();
            self.session.set_seeds(&all)?;
            let mut held = self.held.clone();
            held.resize(self.seeds.len(), false);
            held.resize(all.len(), true);
            resident(&mut *self.session)?.hold(&held)?;
            self.newest = Newest::OnBoth;
        }
        Ok(())
    }

    fn download(&mut self) -> Result<(), RvdError> {
        if self.newest == Newest::InSession {
            resident(&mut *self.session)?.read(&mut self.seeds)?;
            self.seeds.truncate(self.seeds.len() - self.sides.len());
            self.newest = Newest::OnBoth;
        }
        Ok(())
    }

    fn seeds_changed(&mut self) {
        (self.newest, self.fresh) = (Newest::OnHost, true);
        self.present = None;
    }
}

fn resident<P: Space>(session: &mut dyn Session<P>) -> Result<&mut dyn Resident<P>, RvdError> {
    session.resident().ok_or_else(|| RvdError::Internal("this backend cannot move seeds".to_owned()))
}

/// Where seeds go after each step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Projection {
    /// They stay where the step put them, near the surface.
    #[default]
    Free,
    /// Each is moved to the closest point of the surface.
    OnSurface,
}

/// How iterations are done.
#[derive(Clone, Copy, Debug, Default)]
pub struct CvtOptions {
    /// Where seeds go after each step.
    pub projection: Projection,
    /// Most seeds there is room for; 0 means as many as are given at first.
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

/// The gradient has shrunk to this share of the first one.
const GRADIENT: f64 = 1e-3;
/// A step that gains less than this share of the energy counts as a standstill.
const GAIN: f64 = 1e-6;
/// Consecutive standstills that end the steps.
const STANDSTILLS: usize = 2;

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Convergence {
    /// Norm of the first gradient.
    first: Option<f64>,
    standstills: usize,
}

impl Convergence {
    /// Hears of a point: the first one gives the gradient that later ones are measured by.
    pub(super) fn begin(&mut self, gradient_norm: f64) {
        self.first.get_or_insert(gradient_norm);
    }

    pub(super) fn judge(&mut self, before: f64, after: f64, gradient_norm: f64) -> bool {
        let gained = before - after > GAIN * before.abs();
        self.standstills = if gained { 0 } else { self.standstills + 1 };
        let first = *self.first.get_or_insert(gradient_norm);
        self.standstills >= STANDSTILLS || gradient_norm <= GRADIENT * first
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_standstills_running_or_a_small_gradient() {
        let mut test = Convergence::default();
        test.begin(1.0);
        assert!(!test.judge(2.0, 1.0, 0.5));
        assert!(!test.judge(1.0, 1.0, 0.5));
        assert!(!test.judge(1.0, 0.9, 0.5));
        assert!(!test.judge(0.9, 0.9, 0.5));
        assert!(test.judge(0.9, 0.9, 0.5));
        let mut test = Convergence::default();
        test.begin(1.0);
        assert!(!test.judge(1.0, 0.9, 0.002));
        assert!(test.judge(0.9, 0.8, 0.001));
    }
}
