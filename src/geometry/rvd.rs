//! The restricted Voronoi diagram (RVD) seen from outside.
//!
//! Purpose: [`Backend`] makes a [`Session`] for one surface; a session takes seeds and answers
//! with sums per cell or with the pieces themselves. Three backends stand behind the trait:
//! [`Serial`] (f64, the reference), [`Parallel`] (f64, all cores) and `gpu` (f32, WGSL).
//! Invariant: every (facet, cell) pair of the diagram is in the answer. A pair that runs out
//! of a capacity gets a [`PairStatus`] and is done again with more; capacities tune, they never
//! change a result.
//! Must not know: iterations, jobs, files.

pub mod cell_file;
pub mod cells;
pub mod clip;
mod diagram;
pub(crate) mod dual;
mod error;
mod exact;
pub(crate) mod figures;
pub mod incident;
mod kind;
mod on_host;
mod options;
pub mod parallel;
pub mod resident;
pub mod seeds;
pub mod serial;
pub mod start;
mod status;
mod sums;
pub mod surface;
pub(crate) mod work;

use std::ops::Range;
use std::sync::Arc;

use glam::DVec3;

use crate::token::Token;

pub use cells::{PieceBatch, facet_edge};
pub use diagram::{Cells, Diagram};
pub use error::{MAX_SEED_DISTANCE, RvdError};
pub use kind::{BackendChoice, BackendKind};
pub use options::{Accumulate, CELLS_PER_FACET, Capacities, SessionOptions, Strategy, Together, Tuning};
pub use parallel::Parallel;
#[doc(hidden)]
pub use resident::{Evaluation, Resident};
pub(crate) use seeds::check_seeds;
use seeds::take_seeds;
pub use serial::Serial;
pub use status::PairStatus;
pub use sums::{CellSums, PassStats};
pub use surface::{Frame, Surface};
pub use work::{DeviceWork, PhasesMs};

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
    /// A session whose pieces the dual may be read from: f64. A backend that works in less
    /// precision hands out another one's.
    fn exact_session(&self, surface: Arc<Surface>, options: SessionOptions) -> Result<Box<dyn Session>, RvdError> {
        self.session(surface, options)
    }
    /// Plans and allocates everything for one surface and up to `options.max_seeds` seeds.
    fn session(&self, surface: Arc<Surface>, options: SessionOptions) -> Result<Box<dyn Session>, RvdError>;
}

/// One surface and its buffers, reused for any number of seed sets. Not shared: one at a time.
///
/// All coordinates are in the surface's unit frame ([`Surface::frame`]).
pub trait Session: Send {
    /// Sets the seeds. Their neighbour table is built by the next pass, which can be cancelled. May
    /// be called any number of times, with another number of seeds each time, up to `max_seeds`.
    fn set_seeds(&mut self, seeds: &[DVec3]) -> Result<(), RvdError>;

    /// The sums over every cell for the present seeds. `out` is reset to their number.
    /// The statistics include the neighbour table, if these seeds are new.
    fn sums(&mut self, out: &mut CellSums, token: &Token) -> Result<PassStats, RvdError>;

    /// The pieces in `facets`, ordered by facet and then by seed. `out` is cleared first.
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

    /// The seeds last set, to be moved where they are; `None` where they lie in the host's memory, whose
    /// vectors are the caller's own.
    #[doc(hidden)]
    fn resident(&mut self) -> Option<&mut dyn Resident> {
        None
    }
}
