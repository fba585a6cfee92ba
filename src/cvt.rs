//! Centroidal Voronoi tessellation: iterations that move the seeds.
//!
//! Purpose: [`Cvt`] holds a backend session and the seeds, and takes one step at a time, so that
//! a caller can look, stop or edit the seeds between steps.
//! Invariant: sees the backend through its trait and cannot name one. Energy and gradient come
//! from one pass over the diagram.
//! Must not know: files, remeshing, jobs.

use std::sync::Arc;

use glam::DVec3;

use crate::rvd::{Backend, CancelFlag, CellSums, PassStats, RvdError, Session, Surface};

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
    /// Room for so many seeds; 0 means as many as are given at first.
    pub max_seeds: usize,
}

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

/// What one step saw and did. Energies and gradients are those of the seeds *before* the step,
/// in the caller's units.
#[derive(Clone, Copy, Debug)]
pub struct Iteration {
    /// 0 for the first step of this `Cvt`.
    pub index: usize,
    /// What was done.
    pub kind: StepKind,
    /// E = Σ ∫ w |p - x_i|² (weights as given: scaled so that the largest is in (1/2, 1]).
    pub energy: f64,
    /// E over that of a regular hexagonal tiling with as many cells: 5/(18√3) A²/n.
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

/// One surface, its seeds, and the session that computes their diagram.
pub struct Cvt {
    #[allow(dead_code)]
    surface: Arc<Surface>,
    #[allow(dead_code)]
    session: Box<dyn Session>,
    seeds: Vec<DVec3>,
    #[allow(dead_code)]
    sums: CellSums,
}

impl Cvt {
    /// Opens a session for `seeds` (caller's coordinates) and room for more.
    pub fn new(
        backend: &dyn Backend,
        surface: Arc<Surface>,
        seeds: &[DVec3],
        options: CvtOptions,
    ) -> Result<Self, RvdError> {
        let _ = (backend, surface, seeds, options);
        todo!()
    }

    /// One Lloyd step.
    pub fn lloyd(&mut self, cancel: &CancelFlag) -> Result<Iteration, RvdError> {
        let _ = cancel;
        todo!()
    }

    /// The seeds now, caller's coordinates.
    pub fn seeds(&self) -> Vec<DVec3> {
        self.seeds.clone()
    }

    /// Applies edits in order; nothing is changed if one of them is wrong.
    ///
    /// # Errors
    /// `TooManySeeds` beyond the room reserved, `NonFiniteSeed`, `NoSeeds` if none would be
    /// left, `NoSuchSeed`.
    pub fn edit(&mut self, edits: &[SeedEdit]) -> Result<(), RvdError> {
        let _ = edits;
        todo!()
    }

    /// Bytes of device memory held.
    pub fn device_bytes(&self) -> u64 {
        self.session.device_bytes()
    }
}
