//! The report of a run, as `--report` writes it and the service sends it.
//!
//! Purpose: plain figures with fixed names. Must not know: how they came about.

use serde::Serialize;

use crate::mesh::measure::{Quality, Topology};

/// What `--report` writes.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// "serial", "parallel" or "gpu".
    pub backend: String,
    /// The GPU adapter's name.
    pub adapter: Option<String>,
    /// Threads of the CPU pool.
    pub threads: usize,
    /// Random seed, if the seeds were drawn.
    pub seed: Option<u64>,
    /// Whether a convergence test stopped the iterations.
    pub converged: bool,
    /// The surface that came in.
    pub input: InputFigures,
    /// The last diagram and what it took.
    pub rvd: RvdFigures,
    /// One entry a step.
    pub iterations: Vec<IterationFigures>,
    /// Wall-clock times.
    pub timings_ms: Timings,
    /// The surface that came out.
    pub result: ResultFigures,
}

/// The surface that came in.
#[derive(Clone, Debug, Serialize)]
pub struct InputFigures {
    /// Vertices that a facet uses, after exact duplicates are counted once.
    pub vertices: usize,
    /// Facets, degenerate ones included.
    pub facets: usize,
    /// Facets without area.
    pub degenerate_facets: usize,
    /// Caller's units squared.
    pub area: f64,
    /// χ, components, holes, non-manifold elements.
    #[serde(flatten)]
    pub topology: Topology,
}

/// The last diagram and what all of them took.
#[derive(Clone, Debug, Default, Serialize)]
pub struct RvdFigures {
    /// Area covered by the pieces, caller's units squared.
    pub area: f64,
    /// (facet, cell) incidences.
    pub pairs: u64,
    /// Pairs launched more than once, all passes.
    pub relaunched_pairs: u64,
    /// Of these, because neighbours ran out.
    pub relaunched_neighbours: u64,
    /// Because polygon slots ran out.
    pub relaunched_polygon: u64,
    /// Because cell slots ran out.
    pub relaunched_cells: u64,
    /// Pairs that the f64 path finished for the GPU, all passes.
    pub f64_finished_pairs: u64,
    /// Cells without surface in the last diagram.
    pub empty_cells: usize,
    /// Seeds placed anew because their cell was empty, all passes.
    pub reseeded_cells: usize,
    /// Device memory held, bytes.
    pub device_bytes: u64,
}

/// One step.
#[derive(Clone, Debug, Serialize)]
pub struct IterationFigures {
    /// "lloyd" or "lbfgs".
    pub kind: &'static str,
    /// Before the step, caller's units.
    pub energy: f64,
    /// Over the hexagonal tiling's.
    pub energy_ratio: f64,
    /// ‖∇E‖.
    pub gradient_norm: f64,
    /// Passes.
    pub evaluations: usize,
    /// Wall-clock.
    pub ms: f64,
    /// Of which neighbour tables.
    pub neighbours_ms: f64,
    /// Nearest seeds of the facets.
    pub start_ms: f64,
    /// Clipping and summing.
    pub clip_ms: f64,
    /// Results, seeds moved.
    pub update_ms: f64,
}

/// Wall-clock milliseconds per stage.
#[derive(Clone, Debug, Default, Serialize)]
#[allow(missing_docs)]
pub struct Timings {
    pub read: f64,
    pub prepare: f64,
    pub sample: f64,
    pub iterations: f64,
    pub dual: f64,
    pub repair: f64,
    pub measure: f64,
    pub write: f64,
    pub total: f64,
}

/// The surface that came out.
#[derive(Clone, Debug, Serialize)]
pub struct ResultFigures {
    /// Vertices.
    pub vertices: usize,
    /// Facets.
    pub facets: usize,
    /// χ, components, holes, non-manifold elements.
    #[serde(flatten)]
    pub topology: Topology,
    /// Shape and distance figures; absent if not measured.
    #[serde(flatten)]
    pub quality: Option<Quality>,
    /// What the repair had to do.
    pub repair: RepairFigures,
}

/// What the repair had to do.
#[derive(Clone, Copy, Debug, Default, Serialize, PartialEq, Eq)]
pub struct RepairFigures {
    /// Restricted cells with more than one connected component.
    pub split_cells: usize,
    /// Facets dropped because another has the same corners.
    pub duplicate_facets: usize,
    /// Facets dropped at edges with more than two facets.
    pub non_manifold_facets: usize,
    /// Vertices split because their facets form more than one fan.
    pub split_vertices: usize,
}
