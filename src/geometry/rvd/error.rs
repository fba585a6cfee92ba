//! Why a diagram could not be computed.
//!
//! Invariant: a variant names a cause that the caller can act on. Must not know: backends.

use super::kind::BackendKind;
use crate::token::Stopped;

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
