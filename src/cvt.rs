//! Centroidal Voronoi tessellation: iterations that move the seeds.
//!
//! Purpose: [`Cvt`] holds a backend session and the seeds, and takes one step at a time, so that
//! a caller can look, stop or edit the seeds between steps.
//! Invariant: sees the backend through its trait and cannot name one. Energy and gradient come
//! from one pass over the diagram.
//! Must not know: files, remeshing, jobs.

pub mod density;
mod reseed;

use std::sync::Arc;
use std::time::Instant;

use glam::DVec3;
use rayon::prelude::*;

use crate::mesh::TriMesh;
use crate::mesh::closest_point::ClosestPoint;
use crate::rvd::{
    Backend, CancelFlag, CellSums, PassStats, RvdError, Session, SessionOptions, Surface, check_seeds, elapsed_ms,
};

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
    surface: Arc<Surface>,
    session: Box<dyn Session>,
    options: CvtOptions,
    /// Unit frame.
    seeds: Vec<DVec3>,
    sums: CellSums,
    /// The surface in the unit frame, built when it is first needed.
    closest: Option<ClosestPoint>,
    /// The session has not seen `seeds` yet.
    stale: bool,
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
        Ok(Self { surface, session, options, seeds, sums: CellSums::default(), closest: None, stale: true, steps: 0 })
    }

    /// One Lloyd step: every seed to the centroid of its cell.
    ///
    /// A seed whose cell is empty is placed anew beside the cell of highest energy.
    ///
    /// # Errors
    /// `Cancelled`, or what the device says. The seeds are then as before.
    pub fn lloyd(&mut self, cancel: &CancelFlag) -> Result<Iteration, RvdError> {
        let begin = Instant::now();
        self.refresh()?;
        let mut stats = self.session.sums(&mut self.sums, cancel)?;
        let update = Instant::now();
        let mut report = self.figures(StepKind::Lloyd);
        let mut next: Vec<DVec3> = (0..self.seeds.len()).map(|i| self.sums.centroid(i, self.seeds[i])).collect();
        let empty: Vec<u32> = (0..next.len() as u32).filter(|&i| self.sums.area[i as usize] <= 0.0).collect();
        if !empty.is_empty() {
            let closest = closest(&mut self.closest, &self.surface)?;
            reseed::place(&empty, &self.sums, &mut next, &self.surface, closest);
        }
        if self.options.projection == Projection::OnSurface {
            self.project(&mut next)?;
        }
        self.replace(next);
        self.steps += 1;
        stats.update_ms += elapsed_ms(update);
        report.stats = stats;
        report.empty_cells = empty.len();
        report.ms = elapsed_ms(begin);
        Ok(report)
    }

    /// Moves every seed to the closest point of the surface.
    ///
    /// # Errors
    /// Only `Internal`.
    pub fn project_seeds(&mut self) -> Result<(), RvdError> {
        let mut seeds = self.seeds.clone();
        self.project(&mut seeds)?;
        self.replace(seeds);
        Ok(())
    }

    /// The seeds now, caller's coordinates.
    pub fn seeds(&self) -> Vec<DVec3> {
        self.seeds.iter().map(|&p| self.surface.frame().to_world(p)).collect()
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
    pub fn unit_seeds(&self) -> &[DVec3] {
        &self.seeds
    }

    /// Applies edits in order; nothing is changed if one of them is wrong.
    ///
    /// # Errors
    /// `TooManySeeds` beyond the room reserved, `NonFiniteSeed`, `NoSeeds` if none would be
    /// left, `NoSuchSeed`.
    pub fn edit(&mut self, edits: &[SeedEdit]) -> Result<(), RvdError> {
        let frame = self.surface.frame();
        let mut seeds = self.seeds.clone();
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
                }
                SeedEdit::Remove { index } => {
                    if index as usize >= seeds.len() {
                        return Err(RvdError::NoSuchSeed { seed: index as usize, seeds: seeds.len() });
                    }
                    seeds.swap_remove(index as usize);
                }
            }
        }
        check_seeds(&seeds, self.options.max_seeds)?;
        self.replace(seeds);
        Ok(())
    }

    /// The diagram's session with the present seeds set, for a caller that wants cells.
    ///
    /// # Errors
    /// What the backend says of the seeds.
    pub fn session(&mut self) -> Result<&mut dyn Session, RvdError> {
        self.refresh()?;
        Ok(&mut *self.session)
    }

    /// The surface.
    pub fn surface(&self) -> &Arc<Surface> {
        &self.surface
    }

    /// Bytes of device memory held.
    pub fn device_bytes(&self) -> u64 {
        self.session.device_bytes()
    }

    /// Energy and gradient from the sums of the last pass.
    fn figures(&self, kind: StepKind) -> Iteration {
        let energy: f64 = self.sums.energy.iter().sum();
        // m (x - c) is minus the moment about the seed, so nothing is subtracted here.
        let gradient: f64 = self.sums.moment.iter().map(|m| 4.0 * m.length_squared()).sum();
        let scale = self.surface.frame().scale;
        Iteration {
            index: self.steps,
            kind,
            energy: energy / scale / scale / scale / scale,
            energy_ratio: energy / self.surface.hexagonal_energy(self.seeds.len()),
            gradient_norm: gradient.sqrt() / scale / scale / scale,
            evaluations: 1,
            empty_cells: 0,
            area: self.sums.area.iter().sum::<f64>() / scale / scale,
            ms: 0.0,
            stats: PassStats::default(),
        }
    }

    fn project(&mut self, seeds: &mut [DVec3]) -> Result<(), RvdError> {
        let closest = closest(&mut self.closest, &self.surface)?;
        seeds.par_iter_mut().for_each(|p| *p = closest.project(*p).position);
        Ok(())
    }

    /// Hands the seeds to the session if it has others.
    fn refresh(&mut self) -> Result<(), RvdError> {
        if self.stale {
            self.session.set_seeds(&self.seeds)?;
            self.stale = false;
        }
        Ok(())
    }

    fn replace(&mut self, seeds: Vec<DVec3>) {
        self.seeds = seeds;
        self.stale = true;
    }
}

/// The closest-point tree of the surface in the unit frame, built on first use.
fn closest<'a>(slot: &'a mut Option<ClosestPoint>, surface: &Surface) -> Result<&'a ClosestPoint, RvdError> {
    match slot {
        Some(tree) => Ok(tree),
        None => {
            let mesh = TriMesh::new(surface.positions().to_vec(), surface.facets().to_vec())
                .map_err(|e| RvdError::Internal(format!("the surface was valid before: {e}")))?;
            Ok(slot.insert(ClosestPoint::new(&mesh)))
        }
    }
}
