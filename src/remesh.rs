//! The pipeline: sample, iterate, dual, repair, attributes, measure.
//!
//! Purpose: one call from a surface and a count to a new surface and a report.
//! Invariant: the result is oriented as the input; what could not be kept is in the report.
//! Must not know: files, jobs, the network.

pub mod attributes;
pub mod repair;
pub mod report;

use std::sync::Arc;
use std::time::Instant;

use glam::DVec3;

use crate::cvt::{Cvt, CvtOptions, Iteration, Projection};
use crate::mesh::TriMesh;
use crate::mesh::attributes::{AttributeError, Attributes};
use crate::mesh::closest_point::ClosestPoint;
use crate::mesh::measure::{quality_unless, topology};
use crate::mesh::sample::sample;
use crate::rvd::{Backend, CancelFlag, RvdError, SessionOptions, Surface, dual};

pub use attributes::Provenance;
pub use report::Report;
use report::{
    InputFigures, IterationFigures, MemoryFigures, RepairFigures, ResultFigures, RvdFigures, Timings, topology_changes,
};

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
    /// What `mesh` carries and the result is to carry. Some, even if empty, asks for the provenance too.
    pub attributes: Option<Attributes>,
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
    /// What `mesh` carries, if [`RemeshOptions::attributes`] was given.
    pub attributes: Option<Attributes>,
    /// For each vertex of `mesh`, where on the input it lies; empty if [`RemeshOptions::attributes`] was not given.
    pub provenance: Vec<Provenance>,
}

/// Why there is no remesh.
#[derive(Debug, Clone, thiserror::Error)]
pub enum RemeshError {
    /// The diagram could not be had.
    #[error(transparent)]
    Rvd(#[from] RvdError),
    /// Every triangle of the dual lies back to back with another.
    #[error("the surface lies back to back with itself and has no thickness; remesh one of its sides")]
    NoThickness,
    /// The dual has no triangle: too few seeds for this surface.
    #[error("the dual of {seeds} seeds has no triangle; give more points")]
    TooFewSeeds {
        /// How many there were.
        seeds: usize,
    },
    /// The attributes are not the surface's.
    #[error(transparent)]
    Attributes(#[from] AttributeError),
}

/// What the caller hears while it waits. All methods have empty defaults.
pub trait Observer {
    /// A stage began: "prepare", "sample", "iterations", "dual", "repair", "attributes" (if
    /// any were given), "measure".
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
    options.attributes.iter().try_for_each(|attributes| attributes.check_mesh(mesh))?;
    let mut clock = Clock::start();
    observer.stage("prepare");
    let surface = Arc::new(Surface::new(mesh, options.weights.as_deref())?);
    let input = InputFigures::of(mesh);
    let mut timings = Timings { prepare: clock.lap(), ..Timings::default() };
    cancel.check()?;

    observer.stage("sample");
    let (first, seed) = first_seeds(mesh, options);
    timings.sample = clock.lap();
    cancel.check()?;

    observer.stage("iterations");
    let cvt_options = CvtOptions { projection: options.projection, max_seeds: 0 };
    let mut cvt = Cvt::new(backend, Arc::clone(&surface), &first, cvt_options)?;
    let mut rvd = RvdFigures::default();
    let mut iterations = Vec::with_capacity(options.lloyd);
    for _ in 0..options.lloyd {
        let step = cvt.lloyd(cancel)?;
        rvd.add_pass(&step.stats);
        rvd.reseeded_cells += step.empty_cells;
        observer.iteration(&step, options.lloyd);
        iterations.push(IterationFigures::of(&step));
    }
    timings.iterations = clock.lap();

    observer.stage("dual");
    cvt.project_seeds()?;
    let exact = SessionOptions { flat_pieces: true, ..SessionOptions::new(cvt.len()) };
    let mut session = backend.exact_session(Arc::clone(&surface), exact)?;
    session.set_seeds(cvt.unit_seeds())?;
    let dual = dual::extract(&mut *session, &surface, cvt.len(), cancel)?;
    rvd.add_pass(&dual.stats);
    rvd.of_dual(&dual, &surface);
    timings.dual = clock.lap();
    cancel.check()?;

    observer.stage("repair");
    let (result, vertex_seed, repair) = triangulated(&dual, &surface, cvt.unit_seeds(), mesh)?;
    timings.repair = clock.lap();

    let (attributes, provenance) = carried(mesh, options, &result, observer, cancel)?;
    timings.attributes = clock.lap();

    observer.stage("measure");
    cancel.check()?;
    let quality = match options.measure {
        true => Some(quality_unless(mesh, &result, &|| cancel.is_cancelled()).ok_or(RvdError::Cancelled)?),
        false => None,
    };
    let (vertices, facets) = (result.positions().len(), result.facets().len());
    let figures = ResultFigures { vertices, facets, topology: topology(&result), quality, repair };
    timings.measure = clock.lap();
    timings.total = clock.total();
    let changes = topology_changes(&input.topology, &figures.topology);
    let report = Report {
        backend: backend.kind().name().into(),
        adapter: backend.adapter(),
        threads: backend.threads(),
        seed,
        converged: false,
        input,
        rvd,
        iterations,
        timings_ms: timings,
        memory: MemoryFigures { host_peak_bytes: None, device_bytes: cvt.device_bytes() },
        result: figures,
        topology_changes: changes,
    };
    Ok(Remesh { mesh: result, vertex_seed, seeds: cvt.seeds(), report, attributes, provenance })
}

/// The seeds that the options name, caller's coordinates, and the random seed they were drawn from.
fn first_seeds(mesh: &TriMesh, options: &RemeshOptions) -> (Vec<DVec3>, Option<u64>) {
    match &options.seeds {
        Seeds::Given(seeds) => (seeds.clone(), None),
        Seeds::Sample { points, seed } => {
            let points = sample(mesh, options.weights.as_deref(), *points, *seed);
            (points.iter().map(|p| p.position).collect(), Some(*seed))
        }
    }
}

/// The dual made a surface: repaired, its vertices placed, with the seed of each vertex.
fn triangulated(
    dual: &dual::Dual,
    surface: &Surface,
    seeds: &[DVec3],
    mesh: &TriMesh,
) -> Result<(TriMesh, Vec<u32>, RepairFigures), RemeshError> {
    let positions = vertex_positions(dual, surface, seeds, mesh);
    let repaired = repair::repair(&positions, &dual.triangles);
    let too_few = RemeshError::TooFewSeeds { seeds: seeds.len() };
    if repaired.facets.is_empty() {
        return Err(if repaired.figures.closed_pockets > 1 { RemeshError::NoThickness } else { too_few });
    }
    let figures = RepairFigures {
        split_cells: dual.split_cells,
        not_disks: dual.not_disks,
        multiple_edges: dual.multiple_edges,
        multiple_rims: dual.multiple_rims,
        disputed_vertices: dual.disputed,
        ..repaired.figures
    };
    let vertex_seed = repaired.source.iter().map(|&c| dual.components[c as usize].seed).collect();
    // All that can be wrong with it is that no facet has an area: seeds on a line.
    let result = TriMesh::new(repaired.positions, repaired.facets).map_err(|_| too_few)?;
    Ok((result, vertex_seed, figures))
}

/// Where the dual's vertices go, caller's coordinates: a cell in one piece at its seed, which is
/// on the surface; a component of a split cell at the closest point to its own centroid.
fn vertex_positions(dual: &dual::Dual, surface: &Surface, seeds: &[DVec3], mesh: &TriMesh) -> Vec<DVec3> {
    let frame = surface.frame();
    let closest = dual.components.iter().any(|c| !c.whole).then(|| ClosestPoint::new(mesh));
    dual.components
        .iter()
        .map(|c| match &closest {
            Some(tree) if !c.whole => tree.project(frame.to_world(c.centroid)).position,
            _ => frame.to_world(seeds[c.seed as usize]),
        })
        .collect()
}

/// The input's attributes on the result, and where its vertices lie on the input, if asked for.
fn carried(
    mesh: &TriMesh,
    options: &RemeshOptions,
    result: &TriMesh,
    observer: &mut dyn Observer,
    cancel: &CancelFlag,
) -> Result<(Option<Attributes>, Vec<Provenance>), RemeshError> {
    let Some(attributes) = &options.attributes else { return Ok((None, Vec::new())) };
    observer.stage("attributes");
    cancel.check()?;
    let closest = ClosestPoint::new(mesh);
    let provenance = attributes::provenance(&closest, result.positions());
    cancel.check()?;
    let carried = attributes::carry(mesh, attributes, &closest, result, &provenance)?;
    Ok((Some(carried), provenance))
}

/// Wall-clock laps in milliseconds.
struct Clock {
    begin: Instant,
    lap: Instant,
}

impl Clock {
    fn start() -> Self {
        let now = Instant::now();
        Self { begin: now, lap: now }
    }

    fn lap(&mut self) -> f64 {
        let ms = self.lap.elapsed().as_secs_f64() * 1e3;
        self.lap = Instant::now();
        ms
    }

    fn total(&self) -> f64 {
        self.begin.elapsed().as_secs_f64() * 1e3
    }
}
