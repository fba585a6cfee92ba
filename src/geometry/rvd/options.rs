//! Options of a session, and why a diagram could not be computed.
//!
//! Purpose: [`SessionOptions`]: the most seeds, first capacities, and choices that exist to be measured. [`RvdError`]: causes that
//! the caller can act on.
//! Invariant: no option changes the diagram. Must not know: backends.

use super::BackendKind;
use crate::token::Stopped;

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
pub enum Strategy {
    /// From the facet's first cell across bisectors. The default: on a software adapter looking by
    /// cell costs more than the rounds it saves, unless a facet meets thousands of cells.
    #[default]
    Facet,
    /// Each cell looks for the facets that it reaches.
    Cell,
    /// The publication's rule: by cell for the facets that are expected to meet more than [`CELLS_PER_FACET`] cells.
    Auto,
}

/// Where \[HYWZ17\] turns from facets to cells.
pub const CELLS_PER_FACET: f64 = 20.0;

/// How the GPU backend adds pieces to their cells' sums (\[HYWZ17\]). The sums are the same.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
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

/// How many Lloyd steps [`Resident::relax`](super::Resident::relax) hands to a GPU at once, where nothing has to be done again in between.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Together {
    /// Twice as many each time, as long as they end within a tenth of a second.
    #[default]
    ByTime,
    /// Twice as many each time up to this, however long they take.
    AtMost(usize),
}

/// What a session needs to know before it allocates.
#[derive(Clone, Copy, Debug)]
pub struct SessionOptions {
    /// The most seeds that will ever be set; seeds may be added up to it without a new plan.
    pub max_seeds: usize,
    /// First capacities.
    pub capacities: Capacities,
    /// How the work is done.
    pub tuning: Tuning,
    /// Whether [`Session::pieces`](super::Session::pieces) has pieces of facets without area, which the dual needs to go
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

/// Why a pass could not be done.
#[derive(Debug, Clone, thiserror::Error)]
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
    /// A vertex has no lift that can be computed with, or there is no such vertex.
    #[error("vertex {vertex} has no lift of at most {MAX_SEED_DISTANCE:e} bounding boxes; give one per vertex")]
    BadLift {
        /// Its index, from 0.
        vertex: usize,
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
    /// Facets that are read in windows cannot be read.
    #[error("the facets cannot be read: {0}")]
    Unreadable(String),
    /// A session whose facets are read in windows was asked for pieces.
    #[error("a surface that is read in windows has sums, and no pieces; read it as a whole")]
    NoPieces,
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

/// The farthest seed accepted, in bounding boxes: beyond it distances are rounded by the spacing of 10⁶ seeds.
pub const MAX_SEED_DISTANCE: f64 = 1e6;
