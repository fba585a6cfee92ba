//! The pipeline: sample, iterate, dual, repair, measure.
//!
//! Purpose: one call from a surface and a count to a new surface and a report.
//! Invariant: the result is oriented as the input; what could not be kept is in the report.
//! Must not know: files, jobs, the network.

pub mod repair;
pub mod report;

use glam::DVec3;

use crate::cvt::{Iteration, Projection};
use crate::mesh::TriMesh;
use crate::rvd::{Backend, CancelFlag, RvdError};

pub use report::Report;

/// Where the first seeds come from.
#[derive(Clone, Debug)]
pub enum Seeds {
    /// So many, drawn on the surface ∝ √w from this random seed.
    Sample {
        /// How many.
        points: usize,
        /// Random seed: the same number gives the same points everywhere.
        seed: u64,
    },
    /// These, caller's coordinates.
    Given(Vec<DVec3>),
}

/// What to do. Everything has a default but the seeds.
#[derive(Clone, Debug)]
pub struct RemeshOptions {
    /// First seeds.
    pub seeds: Seeds,
    /// Lloyd steps.
    pub lloyd: usize,
    /// Density weight per mesh vertex, or uniform.
    pub weights: Option<Vec<f64>>,
    /// Where seeds go after each step. The last step always ends on the surface.
    pub projection: Projection,
    /// Whether to measure the result (Hausdorff distance and the like) for the report.
    pub measure: bool,
}

/// A remesh and how it came about.
#[derive(Clone, Debug)]
pub struct Remesh {
    /// The new surface, caller's coordinates, oriented as the input.
    pub mesh: TriMesh,
    /// For each vertex of `mesh`, the seed whose cell it stands for.
    pub vertex_seed: Vec<u32>,
    /// The last seeds, on the surface, caller's coordinates.
    pub seeds: Vec<DVec3>,
    /// Figures.
    pub report: Report,
}

/// Why there is no remesh.
#[derive(Debug, Clone, thiserror::Error)]
pub enum RemeshError {
    /// The diagram could not be had.
    #[error(transparent)]
    Rvd(#[from] RvdError),
    /// The dual has no triangle: too few seeds for this surface.
    #[error("the dual of {seeds} seeds has no triangle; give more points")]
    TooFewSeeds {
        /// How many there were.
        seeds: usize,
    },
}

/// What the caller hears while it waits. All methods have empty defaults.
pub trait Observer {
    /// A stage began: "prepare", "sample", "iterations", "dual", "repair", "measure".
    fn stage(&mut self, _name: &'static str) {}
    /// An iteration ended; `total` iterations are planned.
    fn iteration(&mut self, _iteration: &Iteration, _total: usize) {}
}

impl Observer for () {}

/// Remeshes `mesh` on `backend`.
///
/// # Errors
/// [`RemeshError`]; `Rvd(Cancelled)` soon after `cancel` is set.
pub fn remesh(
    mesh: &TriMesh,
    options: &RemeshOptions,
    backend: &dyn Backend,
    observer: &mut dyn Observer,
    cancel: &CancelFlag,
) -> Result<Remesh, RemeshError> {
    let _ = (mesh, options, backend, observer, cancel);
    todo!()
}
