//! The pipeline: sample, iterate, dual, repair, measure.
//!
//! Purpose: one call from a surface and a count to a new surface and a report.
//! Invariant: the result is oriented as the input; what could not be kept is in the report.
//! Must not know: files, jobs, the network.

mod around;
mod curves;
mod fit;
mod flips;
mod polish;
pub mod repair;
pub mod report;

use std::sync::Arc;
use std::time::Instant;

use glam::DVec3;

use crate::cvt::{Cvt, CvtOptions, Iteration, Projection};
use crate::mesh::TriMesh;
use crate::mesh::closest_point::ClosestPoint;
use crate::mesh::features::FeatureError;
use crate::mesh::measure::{quality_unless, topology};
use crate::mesh::sample::sample;
use crate::rvd::{Backend, CancelFlag, RvdError, SessionOptions, Surface, dual};

pub use report::Report;
use report::{
    FinalFigures, InputFigures, IterationFigures, MemoryFigures, RepairFigures, ResultFigures, RvdFigures, Timings,
    topology_changes,
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

/// Where the result's vertices go.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Placement {
    /// Where the facets between them are nearest to the input in the mean, a little off the surface.
    #[default]
    Fitted,
    /// To their seeds, on the surface.
    Surface,
    /// To the centroids of their restricted cells, a little inside where the surface bulges.
    Centroids,
}

/// What to do. Everything has a default but the seeds.
#[derive(Clone, Debug)]
pub struct RemeshOptions {
    /// First seeds.
    pub seeds: Seeds,
    /// Lloyd steps.
    pub lloyd: usize,
    /// Quasi-Newton steps after them, at most; fewer where a test of convergence says so.
    pub newton: usize,
    /// Density weight per mesh vertex, or uniform.
    pub weights: Option<Vec<f64>>,
    /// Where seeds go after each step. The last step always ends on the surface.
    pub projection: Projection,
    /// Where the result's vertices go.
    pub placement: Placement,
    /// Edges bent by more than this are creases, which the result keeps, degrees; 0 finds none. Creases and
    /// boundaries get seeds of their own where seeds are drawn; given seeds stay as they are.
    pub crease_angle_deg: f64,
    /// Edges that are creases whatever their angle, two vertices each.
    pub creases: Vec<[u32; 2]>,
    /// Whether boundaries get seeds of their own, so that they do not shrink.
    pub keep_boundaries: bool,
    /// Whether to measure the result (Hausdorff distance and the like) for the report.
    pub measure: bool,
}

impl RemeshOptions {
    /// The defaults: 5 Lloyd steps and up to 30 quasi-Newton steps of a uniform density, measured.
    pub fn new(seeds: Seeds) -> Self {
        Self {
            seeds,
            lloyd: 5,
            newton: 30,
            weights: None,
            projection: Projection::Free,
            placement: Placement::Fitted,
            crease_angle_deg: 30.0,
            creases: Vec::new(),
            keep_boundaries: true,
            measure: true,
        }
    }

    /// The seeds as they are, moved by so many Lloyd steps and nothing else, not measured.
    pub fn plain(seeds: Seeds, lloyd: usize) -> Self {
        Self {
            lloyd,
            newton: 0,
            placement: Placement::Surface,
            crease_angle_deg: 0.0,
            keep_boundaries: false,
            measure: false,
            ..Self::new(seeds)
        }
    }
}

/// A remesh and how it came about.
#[derive(Clone, Debug)]
pub struct Remesh {
    /// The new surface, caller's coordinates, oriented as the input.
    pub mesh: TriMesh,
    /// For each vertex of `mesh`, the seed whose cell it stands for.
    pub vertex_seed: Vec<u32>,
    /// Edges of `mesh` that lie on creases and boundaries that were kept, two vertices each.
    pub curve_edges: Vec<[u32; 2]>,
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
    /// Creases that cannot be.
    #[error(transparent)]
    Feature(#[from] FeatureError),
    /// Every triangle of the dual lies back to back with another.
    #[error("the surface lies back to back with itself and has no thickness; remesh one of its sides")]
    NoThickness,
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
    let mut clock = Clock::start();
    observer.stage("prepare");
    let surface = Arc::new(Surface::new(mesh, options.weights.as_deref())?);
    let input = InputFigures::of(mesh);
    let mut kept = curves::Kept::find(mesh, &surface, options)?;
    let mut timings = Timings { prepare: clock.lap(), ..Timings::default() };
    cancel.check()?;

    observer.stage("sample");
    let (first, seed) = first_seeds(mesh, &surface, &kept, options);
    timings.sample = clock.lap();
    cancel.check()?;

    observer.stage("iterations");
    let cvt_options = CvtOptions { projection: options.projection, max_seeds: 0 };
    let mut cvt = Cvt::new(backend, Arc::clone(&surface), &first, cvt_options)?;
    if !kept.seeds.is_empty() {
        cvt.keep_curves(kept.seeds.clone())?;
    }
    let mut rvd = RvdFigures::default();
    let (iterations, last) = iterate(&mut cvt, options, &mut rvd, observer, cancel)?;
    kept.seeds = cvt.curves().clone();
    timings.iterations = clock.lap();

    observer.stage("dual");
    cvt.project_seeds()?;
    let exact = SessionOptions { flat_pieces: true, ..SessionOptions::new(cvt.len()) };
    let mut session = backend.exact_session(Arc::clone(&surface), exact)?;
    session.set_seeds(cvt.unit_seeds()?)?;
    let dual = dual::extract(&mut *session, &surface, cvt.len(), cancel)?;
    rvd.add_pass(&dual.stats);
    rvd.of_dual(&dual, &surface);
    timings.dual = clock.lap();
    cancel.check()?;

    observer.stage("repair");
    let source = Source { mesh, surface: &surface, kept: &kept };
    let built = source.triangulated(&dual, cvt.unit_seeds()?, options.placement)?;
    timings.repair = clock.lap();

    observer.stage("measure");
    cancel.check()?;
    let result = &built.mesh;
    let quality = match options.measure {
        true => Some(quality_unless(mesh, result, &|| cancel.is_cancelled()).ok_or(RvdError::Cancelled)?),
        false => None,
    };
    let (vertices, facets) = (result.positions().len(), result.facets().len());
    let repair = built.repair;
    let figures = ResultFigures { vertices, facets, topology: topology(result), quality, repair };
    timings.measure = clock.lap();
    timings.total = clock.total();
    let changes = topology_changes(&input.topology, &figures.topology);
    let report = Report {
        backend: backend.kind().name().into(),
        adapter: backend.adapter(),
        threads: backend.threads(),
        seed,
        converged: cvt.converged(),
        input,
        features: kept.figures(&built.curve_edges),
        rvd,
        iterations,
        last,
        timings_ms: timings,
        memory: MemoryFigures { host_peak_bytes: None, device_bytes: cvt.device_bytes() },
        result: figures,
        topology_changes: changes,
    };
    let curve_edges = built.curve_edges.into_iter().flatten().collect();
    Ok(Remesh { mesh: built.mesh, vertex_seed: built.vertex_seed, curve_edges, seeds: cvt.seeds()?, report })
}

/// Takes the steps, and some more where a seed was found on a curve that is not its own.
fn iterate(
    cvt: &mut Cvt,
    options: &RemeshOptions,
    rvd: &mut RvdFigures,
    observer: &mut dyn Observer,
    cancel: &CancelFlag,
) -> Result<(Vec<IterationFigures>, FinalFigures), RemeshError> {
    let steps = options.lloyd + options.newton;
    let mut iterations = Vec::with_capacity(steps);
    let mut take = |cvt: &mut Cvt, newton: bool, iterations: &mut Vec<IterationFigures>| -> Result<(), RemeshError> {
        let step = if newton { cvt.lbfgs(cancel)? } else { cvt.lloyd(cancel)? };
        rvd.add_pass(&step.stats);
        rvd.reseeded_cells += step.empty_cells;
        observer.iteration(&step, steps);
        iterations.push(IterationFigures::of(&step));
        Ok(())
    };
    while iterations.len() < steps && !cvt.converged() {
        let newton = iterations.len() >= options.lloyd;
        take(cvt, newton, &mut iterations)?;
    }
    let last = FinalFigures::of(&cvt.present(cancel)?);
    for round in 0..CLEARINGS {
        let in_the_way = if round + 1 < CLEARINGS { cvt.clear_curves()? } else { cvt.adopt_intruders()? };
        if in_the_way == 0 {
            break;
        }
        for k in 0..CLEARING_STEPS {
            take(cvt, k > 0, &mut iterations)?;
        }
    }
    Ok((iterations, last))
}

/// Times that seeds are pushed off curves after the last step, the last time taken up by them, and
/// steps after each.
const CLEARINGS: usize = 3;
const CLEARING_STEPS: usize = 3;

/// The seeds that the options name, those of curves first, caller's coordinates, and the random seed they were
/// drawn from.
fn first_seeds(
    mesh: &TriMesh,
    surface: &Surface,
    kept: &curves::Kept,
    options: &RemeshOptions,
) -> (Vec<DVec3>, Option<u64>) {
    match &options.seeds {
        Seeds::Given(seeds) => (seeds.clone(), None),
        &Seeds::Sample { points, seed } if kept.seeds.is_empty() => {
            let drawn = sample(mesh, options.weights.as_deref(), points, seed);
            (drawn.iter().map(|p| p.position).collect(), Some(seed))
        }
        &Seeds::Sample { points, seed } => (kept.with_others(mesh, surface, options, points, seed), Some(seed)),
    }
}

/// What a result is made from.
struct Source<'a> {
    mesh: &'a TriMesh,
    surface: &'a Surface,
    kept: &'a curves::Kept,
}

/// The dual made a surface.
struct Built {
    mesh: TriMesh,
    vertex_seed: Vec<u32>,
    /// For each segment of the curves the result's edge, if it is there.
    curve_edges: Vec<Option<[u32; 2]>>,
    repair: RepairFigures,
}

impl Source<'_> {
    /// The dual made a surface: repaired, its vertices placed, with the seed of each vertex.
    fn triangulated(&self, dual: &dual::Dual, seeds: &[DVec3], placement: Placement) -> Result<Built, RemeshError> {
        let positions = self.vertex_positions(dual, seeds, placement);
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
        let vertex_seed: Vec<u32> = repaired.source.iter().map(|&c| dual.components[c as usize].seed).collect();
        let (mut positions, mut facets) = (repaired.positions, repaired.facets);
        let curve_edges = self.kept.edges_in(&facets, &vertex_seed);
        if placement == Placement::Fitted {
            let mut draft = Draft {
                positions: &mut positions,
                facets: &mut facets,
                source: &repaired.source,
                vertex_seed: &vertex_seed,
                curve_edges: &curve_edges,
            };
            self.fit(&mut draft, dual);
        }
        // All that can be wrong with it is that no facet has an area: seeds on a line.
        let mesh = TriMesh::new(positions, facets).map_err(|_| too_few)?;
        Ok(Built { mesh, vertex_seed, curve_edges, repair: figures })
    }

    /// Where the dual's vertices go, caller's coordinates: a cell in one piece at its seed, which is
    /// on the surface, or its centroid; a component of a split cell at the closest point to its own centroid.
    fn vertex_positions(&self, dual: &dual::Dual, seeds: &[DVec3], placement: Placement) -> Vec<DVec3> {
        let frame = self.surface.frame();
        let closest = dual.components.iter().any(|c| !c.whole).then(|| ClosestPoint::new(self.mesh));
        let place = |c: &dual::Component| match &closest {
            _ if (c.seed as usize) < self.kept.seeds.len() && c.whole => self.kept.position(self.mesh, frame, c.seed),
            _ if placement == Placement::Centroids => frame.to_world(c.centroid),
            Some(tree) if !c.whole => tree.project(frame.to_world(c.centroid)).position,
            _ => frame.to_world(seeds[c.seed as usize]),
        };
        dual.components.iter().map(place).collect()
    }

    /// Moves the result's vertices to where its facets are nearest to the input ([`fit`]). Corners of curves stay.
    fn fit(&self, built: &mut Draft<'_>, dual: &dual::Dual) {
        let mut vertex = vec![u32::MAX; dual.components.len()];
        built.source.iter().enumerate().rev().for_each(|(v, &c)| vertex[c as usize] = v as u32);
        let mut target = fit::Target {
            curves: self.kept.samples(built.curve_edges),
            fixed: built.vertex_seed.iter().map(|&s| self.kept.is_corner(s)).collect(),
            ..fit::Target::default()
        };
        let mut held = vec![false; self.surface.positions().len()];
        for p in dual.pieces.iter().filter(|p| p.area > 0.0 && vertex[p.component as usize] != u32::MAX) {
            let vertex = vertex[p.component as usize];
            let normal = self.surface.normal(p.facet);
            target.samples.push(fit::Sample { position: p.centroid, normal, area: p.area, vertex });
            for corner in (0..3).filter(|c| p.corners & (1 << c) != 0) {
                let v = self.surface.welded()[p.facet as usize][corner] as usize;
                if !std::mem::replace(&mut held[v], true) {
                    target.tips.push(fit::Tip { position: self.surface.positions()[v], vertex });
                }
            }
        }
        let frame = self.surface.frame();
        let mut unit: Vec<DVec3> = built.positions.iter().map(|&p| frame.to_unit(p)).collect();
        fit::fit(&mut unit, built.facets, &target);
        let rails = rails(&unit, built.curve_edges, &target.fixed);
        let curves = built.curve_edges.iter().flatten().map(|&e| flips::sorted(e)).collect();
        polish::polish(&mut unit, built.facets, &rails, &curves);
        for ((p, u), _) in built.positions.iter_mut().zip(unit).zip(&target.fixed).filter(|(_, fixed)| !**fixed) {
            *p = frame.to_world(u);
        }
    }
}

/// How each vertex may move: those with two edges of curves along these, and other ends of curves not at all.
fn rails(positions: &[DVec3], curve_edges: &[Option<[u32; 2]>], fixed: &[bool]) -> Vec<polish::Rail> {
    let mut ends: Vec<(u32, u32)> = curve_edges.iter().flatten().flat_map(|&[a, b]| [(a, b), (b, a)]).collect();
    ends.sort_unstable();
    let of = |v: usize| match fixed[v] {
        true => polish::Rail::Fixed,
        false => polish::Rail::Free,
    };
    let mut rails: Vec<polish::Rail> = (0..positions.len()).map(of).collect();
    for group in ends.chunk_by(|a, b| a.0 == b.0) {
        let rail = &mut rails[group[0].0 as usize];
        if *rail == polish::Rail::Free {
            *rail = match group {
                [(_, a), (_, b)] => (positions[*b as usize] - positions[*a as usize])
                    .try_normalize()
                    .map_or(polish::Rail::Fixed, polish::Rail::Along),
                _ => polish::Rail::Fixed,
            };
        }
    }
    rails
}

/// A result whose vertices may still move.
struct Draft<'a> {
    positions: &'a mut [DVec3],
    facets: &'a mut [[u32; 3]],
    /// Component of the dual and seed of each vertex.
    source: &'a [u32],
    vertex_seed: &'a [u32],
    curve_edges: &'a [Option<[u32; 2]>],
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
