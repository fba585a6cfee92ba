//! The restricted Voronoi diagram (RVD) seen from outside.
//!
//! Purpose: [`Backend`] makes a [`Session`] for one surface; a session takes seeds and answers
//! with sums per cell or with the pieces themselves. Three backends stand behind the trait:
//! [`Serial`] (f64, the reference), [`Parallel`] (f64, all cores) and `gpu` (f32, WGSL).
//! Invariant: every (facet, cell) pair of the diagram is in the answer. A pair that runs out
//! of a capacity gets a [`PairStatus`] and is done again with more; capacities tune, they never
//! change a result.
//! Must not know: iterations, jobs, files.

mod backends;
#[cfg(feature = "service")]
pub(crate) mod cell_file;
pub(crate) mod cells;
pub(crate) mod clip;
mod diagram;
pub(crate) mod dual;
mod exact;
#[cfg(feature = "gpu")]
pub(crate) mod gpu;
pub(crate) mod incident;
mod on_host;
pub(crate) mod parallel;
pub(crate) mod resident;
pub(crate) mod serial;
mod start;
pub(crate) mod surface;
pub(crate) mod work;

use std::ops::Range;
use std::sync::Arc;

use crate::token::{Stopped, Token};
use glam::DVec3;

pub use backends::{BackendChoice, BackendOptions, NoGpu, auto_backend};
pub use cells::{PieceBatch, facet_edge};
pub use diagram::{Cells, Diagram};
pub use parallel::Parallel;
#[doc(hidden)]
pub use resident::{Evaluation, Resident};
pub use serial::Serial;
pub use surface::{Frame, Surface};
pub use work::{DeviceWork, PhasesMs};

/// How a (facet, cell) pair ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u32)]
#[non_exhaustive]
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

/// Capacities with which a pass starts. They grow where a pair needs more, so they tune speed
/// and memory and never the diagram (sums in floating point may add up in another order).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Capacities {
    /// Neighbours per seed in the first table (\[HYWZ17\] uses 20).
    pub neighbours: usize,
    /// Polygon vertices per pair, at least 4.
    pub polygon: usize,
    /// Cells per facet, at least 1.
    pub cells: usize,
    /// Pairs in one pass, as a multiple of the expected number, at least 0.01.
    pub pairs_percent: usize,
}

impl Capacities {
    /// The defaults.
    pub fn new() -> Self {
        Self::default()
    }

    setters! {
        with_neighbours(neighbours: usize),
        with_polygon(polygon: usize),
        with_cells(cells: usize),
        with_pairs_percent(pairs_percent: usize),
    }
}

impl Default for Capacities {
    fn default() -> Self {
        Self { neighbours: 24, polygon: 10, cells: 16, pairs_percent: 100 }
    }
}

/// How the GPU backend finds the pairs of a facet (\[HYWZ17\]). The diagram is the same.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum Strategy {
    /// From the facet's first cell across bisectors. The default: on a software adapter looking by
    /// cell costs more than the rounds it saves, unless a facet meets thousands of cells.
    #[default]
    Facet,
    /// Each cell looks for the facets that it reaches.
    Cell,
    /// The publication's rule: by cell for the facets that are expected to meet more than
    /// [`CELLS_PER_FACET`] cells.
    Auto,
}

/// Where \[HYWZ17\] turns from facets to cells.
pub const CELLS_PER_FACET: f64 = 20.0;

/// How the GPU backend adds pieces to their cells' sums (\[HYWZ17\]). The sums are the same.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum Accumulate {
    /// Atomics to global memory.
    Direct,
    /// Partial sums within a workgroup, merged in a second phase.
    TwoPhase,
    /// What measured better: direct. On a software adapter adding takes 5 to 10 % of the clip phase
    /// directly and 20 to 39 % in two phases (the publication: 10 % and 20 %).
    #[default]
    Auto,
}

/// Choices that exist to be measured. They change the time of a pass on a GPU, never a bit of its
/// result; the CPU backends walk facet by facet and add in a fixed order whatever is chosen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Tuning {
    /// How pairs are found.
    pub strategy: Strategy,
    /// How sums are added.
    pub accumulate: Accumulate,
    /// How many Lloyd steps a submission may have.
    pub together: Together,
}

impl Tuning {
    /// The defaults.
    pub fn new() -> Self {
        Self::default()
    }

    setters! {
        with_strategy(strategy: Strategy),
        with_accumulate(accumulate: Accumulate),
        with_together(together: Together),
    }
}

/// How many Lloyd steps [`Resident::relax`] hands to a GPU at once, where nothing has to be done again in between.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum Together {
    /// Twice as many each time, as long as they end within a tenth of a second.
    #[default]
    ByTime,
    /// Twice as many each time up to this, however long they take.
    AtMost(usize),
}

/// What a session needs to know before it allocates.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct SessionOptions {
    /// The most seeds that will ever be set; seeds may be added up to it without a new plan.
    pub max_seeds: usize,
    /// First capacities.
    pub capacities: Capacities,
    /// How the work is done.
    pub tuning: Tuning,
    /// Whether [`Session::pieces`] has pieces of facets without area, which the dual needs to go
    /// across them. f64 sessions only; sums never have them.
    pub flat_pieces: bool,
}

impl SessionOptions {
    /// Default capacities for at most `max_seeds` seeds.
    pub fn new(max_seeds: usize) -> Self {
        Self { max_seeds, capacities: Capacities::default(), tuning: Tuning::default(), flat_pieces: false }
    }

    setters! {
        with_capacities(capacities: Capacities),
        with_tuning(tuning: Tuning),
        with_flat_pieces(flat_pieces: bool),
    }
}

/// Sums over each restricted cell Ω_i, in the surface's unit frame. All have one entry a seed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CellSums {
    /// ∫ w: the cell's mass.
    pub mass: Vec<f64>,
    /// ∫ w (p - x_i): the first moment about the seed. Centroid = x_i + moment / mass.
    pub moment: Vec<DVec3>,
    /// ∫ w |p - x_i|²: the cell's share of the CVT energy.
    pub energy: Vec<f64>,
    /// ∫ 1: the cell's area, whatever the weights.
    pub area: Vec<f64>,
}

impl CellSums {
    /// Zero for `n` cells, keeping what was allocated.
    pub fn reset(&mut self, n: usize) {
        self.mass.clear();
        self.mass.resize(n, 0.0);
        self.moment.clear();
        self.moment.resize(n, DVec3::ZERO);
        self.energy.clear();
        self.energy.resize(n, 0.0);
        self.area.clear();
        self.area.resize(n, 0.0);
    }

    /// Adds one piece to cell `i`.
    pub(crate) fn add(&mut self, i: usize, piece: &clip::Integrals) {
        self.mass[i] += piece.mass;
        self.moment[i] += piece.moment;
        self.energy[i] += piece.energy;
        self.area[i] += piece.area;
    }

    /// Centroid of cell `i` about seed `seed`, or the seed itself if the cell is empty.
    pub fn centroid(&self, i: usize, seed: DVec3) -> DVec3 {
        if self.mass[i] > 0.0 { seed + self.moment[i] / self.mass[i] } else { seed }
    }
}

/// What one pass did. Times are wall-clock milliseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PassStats {
    /// Non-empty pieces, i.e. (facet, cell) incidences.
    pub pairs: u64,
    /// Pairs done again because the neighbour table ended.
    pub relaunched_neighbours: u64,
    /// Pairs done again with more polygon slots.
    pub relaunched_polygon: u64,
    /// Pairs done again, or inserted again, with more cell slots for their facet.
    pub relaunched_cells: u64,
    /// Facets whose cells had found them and that were left to propagation, so that the pass began
    /// anew (GPU, [`Strategy::Cell`]).
    pub relaunched_facets: u64,
    /// Pairs that another precision finished (GPU: the f64 path).
    pub f64_finished: u64,
    /// Seeds that lie exactly on an earlier one, and so have an empty cell.
    pub duplicate_seeds: u64,
    /// Neighbour tables: building the tree and querying it.
    pub neighbours_ms: f64,
    /// The nearest seed of every facet.
    pub start_ms: f64,
    /// Clipping and summing.
    pub clip_ms: f64,
    /// Moving results to where the caller reads them.
    pub update_ms: f64,
    /// What the device did; its counts can be read as if they were fields of this.
    pub device: DeviceWork,
}

/// `stats.uploaded_bytes` is `stats.device.uploaded_bytes`.
impl std::ops::Deref for PassStats {
    type Target = DeviceWork;

    fn deref(&self) -> &DeviceWork {
        &self.device
    }
}

impl PassStats {
    /// All pairs that were launched more than once.
    pub fn relaunched(&self) -> u64 {
        self.relaunched_neighbours + self.relaunched_polygon + self.relaunched_cells
    }

    /// What of this the device did.
    pub fn device_work(&self) -> DeviceWork {
        self.device
    }

    /// Takes what the device says of the phases.
    pub(crate) fn set_phases(&mut self, phases: PhasesMs) {
        self.neighbours_ms = phases.neighbours;
        self.start_ms = phases.start;
        self.clip_ms = phases.clip;
        self.update_ms = phases.update;
    }

    /// Adds another pass's figures to these. Of the duplicate seeds it keeps the most that a pass saw.
    pub fn add(&mut self, other: &PassStats) {
        self.pairs += other.pairs;
        self.relaunched_neighbours += other.relaunched_neighbours;
        self.relaunched_polygon += other.relaunched_polygon;
        self.relaunched_cells += other.relaunched_cells;
        self.relaunched_facets += other.relaunched_facets;
        self.f64_finished += other.f64_finished;
        self.duplicate_seeds = self.duplicate_seeds.max(other.duplicate_seeds);
        self.neighbours_ms += other.neighbours_ms;
        self.start_ms += other.start_ms;
        self.clip_ms += other.clip_ms;
        self.update_ms += other.update_ms;
        self.device += other.device;
    }
}

/// Why a pass could not be done.
#[derive(Debug, Clone, thiserror::Error)]
#[non_exhaustive]
pub enum RvdError {
    /// No seeds were given.
    #[error("no seeds; give at least one")]
    NoSeeds,
    /// More seeds than the session was opened for.
    #[error("{given} seeds, but the session was opened for at most {limit}")]
    TooManySeeds {
        /// How many were given.
        given: usize,
        /// How many fit.
        limit: usize,
    },
    /// A seed is so far from the surface that distances lose all detail.
    #[error(
        "seed {seed} is {boxes:.3e} bounding boxes away from the surface; seeds within {MAX_SEED_DISTANCE:e} are accepted"
    )]
    SeedTooFar {
        /// Its index, from 0.
        seed: usize,
        /// Largest coordinate in the unit frame.
        boxes: f64,
    },
    /// A seed is NaN or infinite.
    #[error("seed {seed} has a coordinate that is not finite")]
    NonFiniteSeed {
        /// Its index, from 0.
        seed: usize,
    },
    /// An edit names a seed that is not there.
    #[error("there is no seed {seed}; there are {seeds} (0 to {})", .seeds.saturating_sub(1))]
    NoSuchSeed {
        /// The index as given.
        seed: usize,
        /// How many there are.
        seeds: usize,
    },
    /// The backend asked for is not there.
    #[error("there is no {} backend here: {reason}", .wanted.name())]
    BackendUnavailable {
        /// Which one was asked for.
        wanted: BackendKind,
        /// Why it is not there.
        reason: String,
    },
    /// In the unit box every facet is thinner than double precision resolves.
    #[error("every facet is thinner than 1e-15 of the bounding box; there is no surface to divide")]
    NoArea,
    /// A weight is negative, NaN or infinite, or all are zero.
    #[error("weight {vertex} is {value}; weights are finite and at least 0, and not all 0")]
    BadWeight {
        /// The vertex.
        vertex: usize,
        /// Its weight.
        value: f64,
    },
    /// The list of weights is not as long as the list of vertices.
    #[error("{given} weights for {vertices} vertices; give one per vertex")]
    WeightCount {
        /// How many were given.
        given: usize,
        /// How many vertices there are.
        vertices: usize,
    },
    /// The caller asked to stop, or a limit was reached.
    #[error(transparent)]
    Stopped(#[from] Stopped),
    /// The plan will never fit this device.
    #[error(
        "the job needs a buffer of {needed_bytes} bytes and this device allows {limit_bytes}; use fewer seeds or facets, or the parallel backend"
    )]
    NeverFits {
        /// What the largest buffer needs.
        needed_bytes: u64,
        /// What the device allows.
        limit_bytes: u64,
    },
    /// The plan does not fit the device now.
    #[error(
        "the job needs {needed_bytes} bytes on the device and {limit_bytes} can be had; use fewer seeds or facets, or the parallel backend"
    )]
    OutOfMemory {
        /// What the plan adds up to.
        needed_bytes: u64,
        /// What can be had.
        limit_bytes: u64,
    },
    /// The device went away while it worked.
    #[error("the GPU device was lost: {0}")]
    DeviceLost(String),
    /// The device refused or failed; not the caller's fault.
    #[error("the GPU device failed: {0}")]
    Device(String),
    /// An invariant of this program was broken; please report it.
    #[error("internal error: {0}")]
    Internal(String),
}

/// The farthest seed that is accepted, in bounding boxes: beyond it a double's rounding of the
/// distance to the seed is as large as the spacing of 10⁶ seeds.
pub const MAX_SEED_DISTANCE: f64 = 1e6;

/// What every session checks of new seeds.
pub(crate) fn check_seeds(seeds: &[DVec3], limit: usize) -> Result<(), RvdError> {
    if seeds.is_empty() {
        return Err(RvdError::NoSeeds);
    }
    if seeds.len() > limit {
        return Err(RvdError::TooManySeeds { given: seeds.len(), limit });
    }
    seeds.iter().enumerate().try_for_each(|(seed, &p)| check_seed(seed, p))
}

/// What every session checks of one seed.
fn check_seed(seed: usize, p: DVec3) -> Result<(), RvdError> {
    if !p.is_finite() {
        return Err(RvdError::NonFiniteSeed { seed });
    }
    let boxes = p.abs().max_element();
    if boxes > MAX_SEED_DISTANCE {
        return Err(RvdError::SeedTooFar { seed, boxes });
    }
    Ok(())
}

/// Checks new seeds and takes them, on the grid of [`surface::snap`].
fn take_seeds(seeds: &[DVec3], limit: usize, into: &mut Vec<DVec3>) -> Result<(), RvdError> {
    check_seeds(seeds, limit)?;
    into.clear();
    into.extend(seeds.iter().map(|&p| surface::snap(p)));
    Ok(())
}

pub(crate) fn elapsed_ms(since: std::time::Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1e3
}

/// Which implementation does the work.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum BackendKind {
    /// f64, one thread.
    Serial,
    /// f64, all threads of the pool.
    Parallel,
    /// f32 on a wgpu device.
    Gpu,
}

impl BackendKind {
    /// "serial", "parallel" or "gpu".
    pub fn name(self) -> &'static str {
        match self {
            Self::Serial => "serial",
            Self::Parallel => "parallel",
            Self::Gpu => "gpu",
        }
    }
}

/// A session that may be opened.
#[cfg(feature = "service")]
#[cfg_attr(not(feature = "gpu"), allow(dead_code))]
#[derive(Clone, Copy, Debug)]
pub(crate) struct SessionForecast {
    /// Facets of its surface.
    pub(crate) facets: u64,
    /// Seeds at most.
    pub(crate) seeds: u64,
    /// Whether the surface has weights.
    pub(crate) graded: bool,
    /// Whether seeds are moved.
    pub(crate) moved: bool,
}

#[cfg(feature = "service")]
impl SessionForecast {
    /// Bytes that it takes on a device: those of the plan that allocates. 0 if this build has no GPU backend.
    pub(crate) fn device_bytes(&self) -> u64 {
        #[cfg(feature = "gpu")]
        return gpu::forecast::session_bytes(self);
        #[cfg(not(feature = "gpu"))]
        return 0;
    }
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
#[non_exhaustive]
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
    ///
    /// # Errors
    /// `NoSeeds`, `TooManySeeds`, `NonFiniteSeed`.
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
