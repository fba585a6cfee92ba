//! The restricted Voronoi diagram (RVD) seen from outside.
//!
//! Purpose: [`Backend`] makes a [`Session`] for one surface; a session takes seeds and answers
//! with sums per cell or with the pieces themselves. Three backends stand behind the trait:
//! [`Serial`] (f64, the reference), [`Parallel`] (f64, all cores) and `gpu` (f32, WGSL).
//! Invariant: every (facet, cell) pair of the diagram is in the answer. A pair that runs out of a capacity gets a [`PairStatus`]
//! and is done again with more; capacities tune, they never change a result. Must not know: iterations, jobs, files.

pub mod cells;
pub mod clip;
mod diagram;
pub(crate) mod dual;
mod exact;
mod figures;
pub mod incident;
mod on_host;
mod options;
pub mod out_of_core;
pub mod parallel;
pub mod resident;
pub mod serial;
mod sums;
pub mod surface;

use std::ops::Range;
use std::sync::Arc;

use glam::DVec3;

pub use crate::knn::{Lifted, Point};
use crate::token::Token;
pub use cells::{PieceBatch, facet_edge};
pub use diagram::{Cells, Diagram};
pub use figures::RvdFigures;
#[doc(hidden)]
pub use on_host::OnHost;
pub use options::{Accumulate, CELLS_PER_FACET, Capacities, SessionOptions, Strategy, Together, Tuning};
pub use options::{MAX_SEED_DISTANCE, RvdError};
pub use parallel::Parallel;
#[doc(hidden)]
pub use resident::{Evaluation, Resident};
pub use serial::Serial;
pub use sums::{CellSums, DeviceWork, PassStats, PhasesMs};
pub use surface::{Frame, Surface};

/// Milliseconds since a moment.
pub fn elapsed_ms(since: std::time::Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1e3
}

/// Does work on the threads of a backend, so that their number bounds all that is done for it.
pub fn on_threads_of<R: Send>(backend: &dyn Backend, work: impl FnOnce() -> R + Send) -> R {
    match backend.pool() {
        Some(pool) => pool.install(work),
        None => work(),
    }
}

/// What a backend's device is and allows.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DeviceFacts {
    /// The adapter's name.
    pub adapter: String,
    /// Through what it is reached, such as "vulkan".
    pub api: String,
    /// Its driver, with the version.
    pub driver: String,
    /// Whether it is a program on the CPU.
    pub is_software: bool,
    /// The largest buffer, bytes.
    pub max_buffer_bytes: u64,
    /// The largest part of a buffer that a stage sees, bytes.
    pub max_binding_bytes: u64,
    /// Workgroups in each dimension of a dispatch.
    pub max_workgroups: u32,
    /// What is allocated on it now, bytes, if it is known.
    pub allocated_bytes: Option<u64>,
}

/// Makes sessions. One per process is enough; it is the caller's to share.
pub trait Backend: Send + Sync {
    /// The threads that work for this backend, in its passes and between them; `None` for those of rayon's common pool.
    fn pool(&self) -> Option<Arc<rayon::ThreadPool>> {
        None
    }

    /// Which one this is.
    fn kind(&self) -> BackendKind;
    /// The adapter's name, for a GPU.
    fn adapter(&self) -> Option<String> {
        None
    }
    /// The device it works on; `None` for a CPU.
    fn device_facts(&self) -> Option<DeviceFacts> {
        None
    }
    /// How many threads the pool has (1 for `serial`).
    fn threads(&self) -> usize;
    /// A session whose pieces the dual may be read from: f64; another backend's where this one works in less precision.
    fn exact_session(&self, surface: Arc<Surface>, options: SessionOptions) -> Result<Box<dyn Session>, RvdError> {
        self.session(surface, options)
    }
    /// Plans and allocates everything for one surface and up to `options.max_seeds` seeds.
    fn session(&self, surface: Arc<Surface>, options: SessionOptions) -> Result<Box<dyn Session>, RvdError>;

    /// The same for a lifted surface. A backend that has none of its own has one in double precision on its threads.
    fn lifted_session(
        &self,
        surface: Arc<Surface<Lifted>>,
        options: SessionOptions,
    ) -> Result<Box<dyn Session<Lifted>>, RvdError> {
        let parallel = self.pool().map_or_else(|| Parallel::new(None), |pool| Ok(Parallel::on(pool)))?;
        parallel.lifted_session(surface, options)
    }

    /// As [`Self::exact_session`], for a lifted surface.
    fn exact_lifted_session(
        &self,
        surface: Arc<Surface<Lifted>>,
        options: SessionOptions,
    ) -> Result<Box<dyn Session<Lifted>>, RvdError> {
        self.lifted_session(surface, options)
    }
}

/// The spaces in which there are diagrams: the points of a surface, or of one that is lifted.
pub trait Space: Point {
    /// A session of a backend.
    fn session(
        backend: &dyn Backend,
        surface: Arc<Surface<Self>>,
        options: SessionOptions,
    ) -> Result<Box<dyn Session<Self>>, RvdError>;

    /// As [`Backend::exact_session`].
    fn exact_session(
        backend: &dyn Backend,
        surface: Arc<Surface<Self>>,
        options: SessionOptions,
    ) -> Result<Box<dyn Session<Self>>, RvdError>;
}

impl Space for DVec3 {
    fn session(
        backend: &dyn Backend,
        surface: Arc<Surface>,
        options: SessionOptions,
    ) -> Result<Box<dyn Session>, RvdError> {
        backend.session(surface, options)
    }

    fn exact_session(
        backend: &dyn Backend,
        surface: Arc<Surface>,
        options: SessionOptions,
    ) -> Result<Box<dyn Session>, RvdError> {
        backend.exact_session(surface, options)
    }
}

impl Space for Lifted {
    fn session(
        backend: &dyn Backend,
        surface: Arc<Surface<Self>>,
        options: SessionOptions,
    ) -> Result<Box<dyn Session<Self>>, RvdError> {
        backend.lifted_session(surface, options)
    }

    fn exact_session(
        backend: &dyn Backend,
        surface: Arc<Surface<Self>>,
        options: SessionOptions,
    ) -> Result<Box<dyn Session<Self>>, RvdError> {
        backend.exact_lifted_session(surface, options)
    }
}

/// One surface and its buffers, reused for any number of seed sets. Not shared: one at a time.
///
/// All coordinates are in the surface's unit frame ([`Surface::frame`]).
pub trait Session<P: Point = DVec3>: Send {
    /// Sets seeds, any number up to `max_seeds`, any number of times. The next pass, which can be cancelled, builds their table.
    fn set_seeds(&mut self, seeds: &[P]) -> Result<(), RvdError>;

    /// Sums over every cell for the present seeds; `out` gets their number. The statistics include new seeds' table.
    fn sums(&mut self, out: &mut CellSums<P>, token: &Token) -> Result<PassStats, RvdError>;

    /// The pieces in `facets`, ordered by facet and then by seed, in R^3. `out` is cleared first.
    fn pieces(&mut self, facets: Range<u32>, out: &mut PieceBatch, token: &Token) -> Result<PassStats, RvdError>;

    /// Bytes of device memory that the session holds (0 on a CPU).
    fn device_bytes(&self) -> u64 {
        0
    }

    /// What the device did for the session since it was opened: passes, uploads and everything else.
    fn device_work(&self) -> DeviceWork {
        DeviceWork::default()
    }

    /// What the device's stages took, if it keeps time.
    fn device_phases(&self) -> Option<PhasesMs> {
        None
    }

    /// The seeds last set, to be moved where they are; `None` where they lie in the host's memory and vectors are the caller's.
    #[doc(hidden)]
    fn resident(&mut self) -> Option<&mut dyn Resident<P>> {
        None
    }
}

/// Which implementation does the work.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum BackendKind {
    /// Double precision, one thread.
    Serial,
    /// Double precision, all threads of the pool.
    Parallel,
    /// Single precision on a wgpu device.
    Gpu,
}

impl BackendKind {
    /// All backends, the fastest first.
    pub const ALL: [Self; 3] = [Self::Gpu, Self::Parallel, Self::Serial];

    /// "serial", "parallel" or "gpu".
    pub fn name(self) -> &'static str {
        match self {
            Self::Serial => "serial",
            Self::Parallel => "parallel",
            Self::Gpu => "gpu",
        }
    }
}

/// Which backend should do the work.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BackendChoice {
    /// The GPU if there is one, else the parallel backend.
    #[default]
    Auto,
    /// This one or an error.
    Only(BackendKind),
}

/// How a (facet, cell) pair ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u32)]
pub enum PairStatus {
    /// Clipped to the end: the security radius closed, or every other seed was tried.
    Done = 0,
    /// The neighbour table ended before the security radius closed.
    NeighboursExhausted = 1,
    /// The polygon needed more vertices than there were slots.
    PolygonOverflow = 2,
    /// The facet meets more cells than there were slots.
    CellsOverflow = 3,
    /// A coordinate left the range of the arithmetic in use.
    NonFinite = 4,
}

/// What every session checks of new seeds.
pub fn check_seeds<P: Point>(seeds: &[P], limit: usize) -> Result<(), RvdError> {
    if seeds.is_empty() {
        return Err(RvdError::NoSeeds);
    }
    if seeds.len() > limit {
        return Err(RvdError::TooManySeeds { given: seeds.len(), limit });
    }
    seeds.iter().enumerate().try_for_each(|(seed, &p)| check_seed(seed, p))
}

/// What every session checks of one seed.
pub fn check_seed<P: Point>(seed: usize, p: P) -> Result<(), RvdError> {
    if !p.is_finite() {
        return Err(RvdError::NonFiniteSeed { seed });
    }
    let boxes = p.coordinates().as_ref().iter().fold(0.0, |most: f64, x| most.max(x.abs()));
    if boxes > MAX_SEED_DISTANCE {
        return Err(RvdError::SeedTooFar { seed, boxes });
    }
    Ok(())
}

/// Checks new seeds and takes them, on the grid of [`surface::snap`].
pub fn take_seeds<P: Point>(seeds: &[P], limit: usize, into: &mut Vec<P>) -> Result<(), RvdError> {
    check_seeds(seeds, limit)?;
    refill(into, seeds.iter().map(|&p| surface::snap_point(p)));
    Ok(())
}

/// Puts other items into memory that is there already.
fn refill<T>(vec: &mut Vec<T>, items: impl IntoIterator<Item = T>) {
    vec.clear();
    vec.extend(items);
}
