//! The pipeline: sample, iterate, dual, repair, attributes, measure.
//!
//! Purpose: one call from a surface and a count to a new surface and a report.
//! Invariant: the result is oriented as the input; what could not be kept is in the report.
//! Must not know: files, jobs, the network.

pub(crate) mod attributes;
mod build;
mod closer;
mod curves;
mod fan;
mod fences;
mod fit;
mod flips;
mod ground;
mod mend;
mod notches;
mod patch;
mod polish;
mod regular;
pub(crate) mod repair;
pub mod report;
mod settled;
mod spikes;
mod stars;
mod steps;
mod thin;
mod tips;
mod triangle;
mod whole;

use std::sync::Arc;
use std::time::Instant;

use glam::DVec3;

use crate::cvt::density::{self, Count, DensityError, DensityOptions, DensitySource, Plan};
use crate::cvt::{Cvt, Iteration, Projection};
use crate::mesh::TriMesh;
use crate::mesh::adjacency::Adjacency;
use crate::mesh::apart::Apart;
use crate::mesh::attributes::{AttributeError, Attributes};
use crate::mesh::closest_point::ClosestPoint;
use crate::mesh::features::FeatureError;
use crate::mesh::measure::{Topology, quality_unless, topology_unless};
use crate::mesh::outliers;
use crate::mesh::sample::spread;
use crate::rvd::{Backend, RvdError, Surface, dual, on_threads_of};
use crate::token::{Stopped, Token};

pub use attributes::Provenance;
pub use report::Report;
use report::{
    DeviceFigures, FinalFigures, IterationFigures, MemoryFigures, RefineFigures, ResultFigures, RvdFigures, Timings,
    topology_changes,
};
use settled::{Exact, Settled};
use steps::Steps;
use whole::without_tears;

/// Where the first seeds come from.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub enum Seeds {
    /// So many, drawn on the surface ∝ √w from this random seed, spread out ([`spread`]).
    Sample {
        /// How many.
        points: usize,
        /// Random seed: the same number gives the same points everywhere.
        seed: u64,
    },
    /// These, caller's coordinates.
    Given(Vec<DVec3>),
    /// As many as the edge lengths of the density imply, drawn as `Sample`.
    Implied {
        /// Random seed.
        seed: u64,
    },
}

impl Seeds {
    /// The random seed unless somebody says otherwise.
    pub const RANDOM_SEED: u64 = 0;

    /// How many there are to be.
    pub fn count(&self) -> Count {
        match self {
            Self::Sample { points, .. } => Count::Points(*points),
            Self::Given(seeds) => Count::Points(seeds.len()),
            Self::Implied { .. } => Count::Implied,
        }
    }
}

/// Where the result's vertices go.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum Placement {
    /// Where the facets between them are nearest to the input in the mean, a little off the surface.
    #[default]
    Fitted,
    /// To their seeds, on the surface.
    Surface,
    /// To the centroids of their restricted cells, a little inside where the surface bulges.
    Centroids,
}

/// More points where the result is far from the input. The vertices of the result are to be
/// [`Placement::Fitted`].
///
/// Drawn seeds are drawn anew, for edges that are shorter where the last result was too far, up to five times. To given
/// seeds some are added, up to eight times.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Refine {
    /// How far the vertices of the input should be from the result at most, caller's units. Rounds end
    /// when that is so or when there are `max_points`; the report's `refine.missed` says how
    /// many places are farther away.
    pub tolerance: f64,
    /// The most seeds that there may be in all, at least as many as there are at first.
    pub max_points: usize,
}

impl Refine {
    /// Adds points until nothing is farther than `tolerance` away, or until there are twice as many as the `points` at first.
    pub fn new(tolerance: f64, points: usize) -> Self {
        Self { tolerance, max_points: points.saturating_mul(2) }
    }

    /// With another [`Self::max_points`].
    #[must_use]
    pub fn with_max_points(mut self, max_points: usize) -> Self {
        self.max_points = max_points;
        self
    }
}

/// What to do. Everything has a default but the seeds. The command and the service have the same defaults, read from here.
///
/// ```
/// use tessera::{DensityOptions, DensitySource, RemeshOptions, Seeds};
/// let density = DensityOptions::from_source(DensitySource::Curvature).with_gradation(0.5);
/// let options = RemeshOptions::new(Seeds::Sample { points: 5_000, seed: 1 }).with_density(density).with_newton(50);
/// ```
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct RemeshOptions {
    /// First seeds.
    pub seeds: Seeds,
    /// Lloyd steps; 5 by default.
    pub lloyd: usize,
    /// Quasi-Newton steps after them, at most; fewer where a test of convergence says so. 30 by
    /// default.
    pub newton: usize,
    /// How long edges should be, and where.
    pub density: DensityOptions,
    /// Where seeds go after each step. The last step always ends on the surface.
    pub projection: Projection,
    /// Where the result's vertices go.
    pub placement: Placement,
    /// Edges bent by more than this are creases, which the result keeps, degrees; 0 finds none, 30 by default. Creases and
    /// boundaries get seeds of their own where seeds are drawn; given seeds stay as they are.
    pub crease_angle_deg: f64,
    /// Edges that are creases whatever their angle, two vertices each.
    pub creases: Vec<[u32; 2]>,
    /// Adds seeds where the result is too far from the input; `None` adds none.
    pub refine: Option<Refine>,
    /// Whether boundaries get seeds of their own, so that they do not shrink.
    pub keep_boundaries: bool,
    /// Whether edges become shorter where the surface is too thin for their length, so that horns, fingers and bridges
    /// stay. Only where seeds are drawn, and not for lengths or weights that are given.
    pub keep_thin: bool,
    /// Whether to measure the result (Hausdorff distance and the like) for the report.
    pub measure: bool,
    /// What `mesh` carries and the result is to carry. Some, even if empty, asks for the provenance too.
    pub attributes: Option<Attributes>,
}

impl RemeshOptions {
    /// Edges bent by more than this are creases unless somebody says otherwise, degrees.
    pub const CREASE_ANGLE_DEG: f64 = 30.0;

    /// The defaults: 5 Lloyd steps and up to 30 quasi-Newton steps of a uniform density, measured.
    pub fn new(seeds: Seeds) -> Self {
        Self {
            seeds,
            lloyd: 5,
            newton: 30,
            density: DensityOptions::default(),
            projection: Projection::Free,
            placement: Placement::Fitted,
            crease_angle_deg: Self::CREASE_ANGLE_DEG,
            creases: Vec::new(),
            refine: None,
            keep_boundaries: true,
            keep_thin: true,
            measure: true,
            attributes: None,
        }
    }

    /// The defaults, for who asks for them and has no seeds yet.
    #[cfg(feature = "service")]
    pub(crate) fn usual() -> Self {
        Self::new(Seeds::Implied { seed: Seeds::RANDOM_SEED })
    }

    setters! {
        with_seeds(seeds: Seeds),
        with_lloyd(lloyd: usize),
        with_newton(newton: usize),
        with_density(density: DensityOptions),
        with_projection(projection: Projection),
        with_placement(placement: Placement),
        with_crease_angle_deg(crease_angle_deg: f64),
        with_creases(creases: Vec<[u32; 2]>),
        with_refine(refine: Refine => Some(refine)),
        with_keep_boundaries(keep_boundaries: bool),
        with_keep_thin(keep_thin: bool),
        with_measure(measure: bool),
        with_attributes(attributes: Attributes => Some(attributes)),
    }

    /// The seeds as they are, moved by so many Lloyd steps and nothing else, not measured.
    pub fn plain(seeds: Seeds, lloyd: usize) -> Self {
        Self {
            lloyd,
            newton: 0,
            placement: Placement::Surface,
            crease_angle_deg: 0.0,
            keep_boundaries: false,
            keep_thin: false,
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
    /// What `mesh` carries, if [`RemeshOptions::attributes`] was given.
    pub attributes: Option<Attributes>,
    /// For each vertex of `mesh`, where on the input it lies; empty if [`RemeshOptions::attributes`] was not given.
    pub provenance: Vec<Provenance>,
}

/// Why there is no remesh.
#[derive(Debug, Clone, thiserror::Error)]
#[non_exhaustive]
pub enum RemeshError {
    /// The diagram could not be had.
    #[error(transparent)]
    Rvd(#[from] RvdError),
    /// Creases that cannot be.
    #[error(transparent)]
    Feature(FeatureError),
    /// The wished density cannot be had.
    #[error(transparent)]
    Density(DensityError),
    /// Every facet of the surface lies back to back with another, and so does every triangle of the dual.
    #[error("the surface lies back to back with itself and has no thickness; remesh one of its sides")]
    NoThickness,
    /// The dual has no triangle, or only such as lie back to back: too few seeds for this surface.
    #[error(
        "the number of points, {seeds}, is too small for this surface: no triangulation of its topology has fewer than \
         {least} vertices, and one that is near it has many more; give more points, for example {}", 10 * least
    )]
    TooFewSeeds {
        /// How many there were.
        seeds: usize,
        /// The fewest vertices that a surface of the input's topology can have.
        least: usize,
    },
    /// Points are to be added where vertices are not [`Placement::Fitted`].
    #[error(
        "points are added where a fitted result is far from the surface; place the vertices so, or give no tolerance"
    )]
    RefineUnfitted,
    /// Points are to be added, and there are too many already.
    #[error(
        "there are {points} points before any is added, and at most {most} are allowed; allow more, or begin with fewer"
    )]
    RefineLimit {
        /// How many there are.
        points: usize,
        /// [`Refine::max_points`].
        most: usize,
    },
    /// The attributes are not the surface's.
    #[error(transparent)]
    Attributes(#[from] AttributeError),
}

impl RemeshError {
    /// So many seeds are too few for any surface.
    fn too_few(seeds: usize) -> Self {
        Self::TooFewSeeds { seeds, least: 3 }
    }

    /// The same error, for a surface of this topology.
    fn for_surface(self, surface: &Topology) -> Self {
        match self {
            Self::TooFewSeeds { seeds, .. } => Self::TooFewSeeds { seeds, least: fewest_vertices(surface) },
            error => error,
        }
    }
}

/// A bound from below on the vertices of a triangulation: three for a part with a boundary, four for one without, and
/// Heawood's bound for a connected surface without boundary, as 7 for a torus.
fn fewest_vertices(surface: &Topology) -> usize {
    let parts = surface.components.max(1);
    match (surface.boundary_edges, parts) {
        (0, 1) => ((7.0 + (49.0 - 24.0 * surface.euler.min(2) as f64).sqrt()) / 2.0).ceil() as usize,
        (0, _) => 4 * parts,
        _ => 3 * parts,
    }
}

impl From<Stopped> for RemeshError {
    fn from(reason: Stopped) -> Self {
        Self::Rvd(reason.into())
    }
}

impl From<FeatureError> for RemeshError {
    fn from(error: FeatureError) -> Self {
        match error {
            FeatureError::Stopped(reason) => reason.into(),
            error => Self::Feature(error),
        }
    }
}

impl From<DensityError> for RemeshError {
    fn from(error: DensityError) -> Self {
        match error {
            DensityError::Stopped(reason) => Self::Rvd(RvdError::Stopped(reason)),
            error => Self::Density(error),
        }
    }
}

/// What the caller hears while it waits. All methods have empty defaults.
pub trait Observer: Send {
    /// A stage began: "prepare", "sample", "iterations", "dual", "repair", "attributes" (if
    /// any were given), "measure".
    fn stage(&mut self, _name: &'static str) {}
    /// An iteration ended; `total` iterations are planned.
    fn iteration(&mut self, _iteration: &Iteration, _total: usize) {}
}

impl Observer for () {}

/// A stage begins.
fn enter(observer: &mut dyn Observer, token: &Token, stage: &'static str) {
    token.enter(stage);
    observer.stage(stage);
}

/// Remeshes `mesh` on `backend`.
///
/// # Errors
/// [`RemeshError`]; `Rvd(Stopped)` soon after `token` says so.
pub fn remesh(
    mesh: &TriMesh,
    options: &RemeshOptions,
    backend: &dyn Backend,
    observer: &mut dyn Observer,
    token: &Token,
) -> Result<Remesh, RemeshError> {
    on_threads_of(backend, || match remesh_here(mesh, options, backend, observer, token) {
        // As where all points lie along a spike. Given seeds are where they are.
        Err(error @ (RemeshError::TooFewSeeds { .. } | RemeshError::Rvd(RvdError::NoArea))) => {
            let near = outliers::draw_in(mesh).filter(|_| !matches!(options.seeds, Seeds::Given(_)));
            let Some(near) = near else { return Err(error) };
            let mut done = remesh_here(&near, options, backend, observer, token)?;
            spikes::put_back(&mut done, mesh, &near, token)?;
            Ok(done)
        }
        done => done,
    })
}

/// On the present threads.
fn remesh_here(
    mesh: &TriMesh,
    options: &RemeshOptions,
    backend: &dyn Backend,
    observer: &mut dyn Observer,
    token: &Token,
) -> Result<Remesh, RemeshError> {
    options.attributes.iter().try_for_each(|attributes| attributes.check_mesh(mesh))?;
    if options.refine.is_some() && options.placement != Placement::Fitted {
        return Err(RemeshError::RefineUnfitted);
    }
    let laps = Laps { clock: Clock::start(), timings: Timings::default() };
    enter(observer, token, "prepare");
    let (preprocessed, mut prepared) = rayon::join(|| without_tears(mesh, token), || prepare(mesh, options, token));
    let (input, whole) = preprocessed?;
    // Attributes are of the facets as given, and so are the places where vertices lie.
    let given = mesh;
    let mesh = whole.as_ref().unwrap_or(mesh);
    // A cell does not reach through to a part beside its own where none is beside another.
    let parts = input.topology.components;
    let apart = (parts > 1).then(|| between(mesh, parts, options)).flatten().and_then(|gap| Apart::of(mesh, gap));
    token.check()?;
    let ground = apart.as_ref().map_or(mesh, |apart| &apart.mesh);
    if whole.is_some() || apart.is_some() {
        prepared = prepare(ground, options, token);
    }
    if let (Some(Refine { max_points: most, .. }), Ok(Prepared { plan: Plan { points, .. }, .. })) =
        (options.refine, &prepared)
        && *points > most
    {
        return Err(RemeshError::RefineLimit { points: *points, most });
    }
    // Who says how long edges are is not contradicted.
    let free = !matches!(options.density.source, DensitySource::Sizes(_) | DensitySource::Weights(_));
    let keep_thin = options.keep_thin && free && options.placement == Placement::Fitted;
    let mut job = Job { mesh: ground, backend, token, observer, laps, keep_thin, topology: input.topology };
    let attempt = match (options.refine, &options.seeds) {
        (Some(refine), &(Seeds::Sample { seed, .. } | Seeds::Implied { seed })) => {
            prepared.and_then(|prepared| closer::find(&mut job, prepared, options, refine, seed))
        }
        _ => prepared.and_then(|prepared| job.attempt(prepared, options, options.refine.map(|r| r.tolerance))),
    };
    let attempt = attempt.map_err(|error| error.for_surface(&input.topology))?;
    let Job { observer, laps: Laps { mut clock, mut timings }, .. } = job;
    let Attempt { plan, kept, closest, mut built, mut seeds, seed, steps, device, device_bytes } = attempt;
    let Figures { converged, rvd, iterations, last, refine } = steps;
    let memory = MemoryFigures { host_peak_bytes: None, device_bytes };

    token.check()?;
    let broken = |e| RvdError::Internal(format!("a surface was valid where its parts were apart: {e}"));
    let beside = apart.as_ref().map(|apart| TriMesh::new(apart.mesh.positions().to_vec(), given.facets().to_vec()));
    let beside = beside.transpose().map_err(broken)?;
    let (attributes, provenance) = carried(beside.as_ref().unwrap_or(given), options, &built.mesh, observer, token)?;
    if let Some(apart) = &apart {
        built.mesh = apart.mesh_back(&built.mesh).map_err(broken)?;
        seeds.iter_mut().for_each(|p| *p = apart.back(*p));
    }
    // What answers for the parts apart does not for the input.
    let closest = closest.filter(|_| apart.is_none());
    timings.attributes = clock.lap();

    enter(observer, token, "measure");
    token.check()?;
    let result = &built.mesh;
    let quality = || options.measure.then(|| quality_unless(mesh, closest, result, token));
    let topology = || topology_unless(result, &Adjacency::new(result), token);
    let (topology, quality) = rayon::join(topology, quality);
    let (topology, quality) = (topology?, quality.transpose()?);
    let (vertices, facets) = (result.positions().len(), result.facets().len());
    let repair = built.repair;
    let figures = ResultFigures { vertices, facets, topology, quality, repair };
    timings.measure = clock.lap();
    timings.total = clock.total();
    let changes = topology_changes(&input.topology, &figures.topology);
    let report = Report {
        backend: backend.kind().name().into(),
        adapter: backend.adapter(),
        threads: backend.threads(),
        seed,
        converged,
        input,
        features: kept.figures(&built.curve_edges),
        rvd,
        device,
        iterations,
        last,
        refine,
        timings_ms: timings,
        memory,
        result: figures,
        topology_changes: changes,
        density: plan.figures,
    };
    let curve_edges = built.curve_edges.into_iter().flatten().collect();
    Ok(Remesh { mesh: built.mesh, vertex_seed: built.vertex_seed, curve_edges, seeds, report, attributes, provenance })
}

/// How far so many parts should be from each other: twice the length of edges, and a little of the surface. `None` where
/// seeds are given, since it is not known which part one is on, and where there are too few for each to become a surface.
fn between(mesh: &TriMesh, parts: usize, options: &RemeshOptions) -> Option<f64> {
    let (low, high) = mesh.bounds();
    // As on a flat surface without boundary.
    let even = |points: usize| (2.0 / 3f64.sqrt() * mesh.area() / points.max(1) as f64).sqrt();
    let edge = match (&options.seeds, &options.density) {
        (Seeds::Given(_), _) => return None,
        (Seeds::Sample { points, .. }, _) => even(*points),
        (_, DensityOptions { source: DensitySource::Sizes(sizes), .. }) => {
            sizes.iter().copied().fold(0.0, f64::max).min((high - low).length())
        }
        (_, density) => density.edge_length?,
    };
    // A tetrahedron has four.
    (edge <= even(4 * parts)).then(|| 2.0 * edge + 0.02 * (high - low).length())
}

/// What all attempts at one remesh share.
struct Job<'a, 'b> {
    mesh: &'a TriMesh,
    backend: &'b dyn Backend,
    token: &'b Token,
    observer: &'b mut dyn Observer,
    /// Of all attempts.
    laps: Laps,
    /// Edges become shorter where cells fail.
    keep_thin: bool,
    /// The input's.
    topology: Topology,
}

/// What took how long.
struct Laps {
    clock: Clock,
    timings: Timings,
}

/// A result, and how it came about.
struct Attempt<'a> {
    plan: Plan<'a>,
    kept: curves::Kept,
    closest: Option<ClosestPoint>,
    built: build::Built,
    /// Caller's coordinates.
    seeds: Vec<DVec3>,
    /// The random seed they were drawn from.
    seed: Option<u64>,
    steps: Figures,
    device: DeviceFigures,
    device_bytes: u64,
}

/// What the steps came to.
struct Figures {
    converged: bool,
    rvd: RvdFigures,
    iterations: Vec<IterationFigures>,
    last: FinalFigures,
    refine: RefineFigures,
}

impl<'a> Job<'a, '_> {
    /// From what is prepared for `options` to a surface, whose creases are not to be off by more than half of `tolerance`.
    fn attempt(
        &mut self,
        prepared: Prepared<'a>,
        options: &RemeshOptions,
        tolerance: Option<f64>,
    ) -> Result<Attempt<'a>, RemeshError> {
        let settled = self.settled(prepared, options)?;
        let Settled { plan, surface, kept, mut cvt, mut session, dual, seed, converged, last, .. } = settled;
        let Settled { rvd, iterations, refine, .. } = settled;
        let mut steps = Steps { options, observer: &mut *self.observer, token: self.token, rvd, iterations, refine };
        let exact = Exact { surface: &surface, session: &mut *session };
        let (built, seeds) = build(&plan.mesh, &kept, &mut cvt, (exact, dual), &mut steps, tolerance, &mut self.laps)?;
        let Steps { rvd, iterations, refine, .. } = steps;
        let device = DeviceFigures::new(cvt.device_work(), &iterations);
        let device_bytes = cvt.device_bytes();
        // What else it holds is not needed beside what the measures hold.
        let closest = cvt.into_closest();
        let steps = Figures { converged, rvd, iterations, last, refine };
        Ok(Attempt { plan, kept, closest, built, seeds, seed, steps, device, device_bytes })
    }
}

/// What steps begin with.
struct Prepared<'a> {
    plan: Plan<'a>,
    /// The surface that the plan is for,
    surface: Arc<Surface>,
    /// the curves on it,
    kept: curves::Kept,
    /// and what answers for its closest points, unit frame.
    closest: ClosestPoint,
}

/// All that depends on the mesh and the options alone.
fn prepare<'a>(mesh: &'a TriMesh, options: &RemeshOptions, token: &Token) -> Result<Prepared<'a>, RemeshError> {
    let plan = density::plan(mesh, &options.density, options.seeds.count(), token)?.divided(token)?;
    token.check()?;
    let surface = Arc::new(Surface::new(&plan.mesh, plan.weights.as_deref())?);
    token.check()?;
    let find = || curves::Kept::find(mesh, &plan, &surface, options, token);
    let (kept, closest) = rayon::join(find, || surface.closest_points());
    Ok(Prepared { kept: kept?, closest: closest?, plan, surface })
}

/// Times that seeds are added where a tolerance was given,
const ADDING_ROUNDS: usize = 8;
/// and that seeds are moved which are left without a vertex.
const LOST_ROUNDS: usize = 1;
/// The result of a round may be so much farther from the input than the one before, since another place may come out worse
/// than those that seeds were added to: more seeds are better all the same, unless it is much worse.
const ADDED_SLACK: f64 = 2.0;
/// And so much where fewer seeds are left without a vertex.
const LOST_SLACK: f64 = 1.25;

/// The result of the present seeds, whose dual is there, or of better ones as long as it is farther from the input than it
/// may be or seeds are left without a vertex, and the seeds that it is of, caller's coordinates.
fn build(
    mesh: &TriMesh,
    kept: &curves::Kept,
    cvt: &mut Cvt,
    (mut exact, mut dual): (Exact<'_>, dual::Dual),
    steps: &mut Steps<'_>,
    tolerance: Option<f64>,
    laps: &mut Laps,
) -> Result<(build::Built, Vec<DVec3>), RemeshError> {
    let options = steps.options;
    let surface = exact.surface;
    let rounds = match (options.refine, options.placement) {
        (Some(_), _) => ADDING_ROUNDS,
        (None, Placement::Fitted) if options.newton > 0 => LOST_ROUNDS,
        _ => 0,
    };
    let tolerance = tolerance.map(|t| t * surface.frame().scale);
    let first_added = cvt.len() as u32;
    let mut best: Option<(build::Draft, build::Missed, Vec<DVec3>)> = None;
    let placement = options.placement;
    let adds = options.refine.is_some();
    let token = steps.token;
    let source = build::Source { mesh, surface, kept, placement, first_added, tolerance, adds, token };
    let mut round = 0;
    loop {
        steps.token.check()?;
        enter(steps.observer, steps.token, "repair");
        // On the pool's threads as a whole, so that nobody waits for them to wake up at each part.
        let seeds = cvt.unit_seeds()?;
        let draft = rayon::scope(|_| source.draft(&dual, seeds))?;
        laps.timings.repair += laps.clock.lap();
        let missed = draft.missed();
        let is_better = |before: &build::Missed| match adds {
            true => missed.deviation < ADDED_SLACK * before.deviation,
            false => missed.lost.len() < before.lost.len() && missed.deviation < LOST_SLACK * before.deviation,
        };
        if best.as_ref().is_none_or(|(_, before, _)| is_better(before)) {
            steps.rvd.of_dual(&dual, surface);
            best = Some((draft, missed.clone(), cvt.seeds()?));
        }
        let goes_on = round < rounds
            && match adds {
                true => steps.add(cvt, &missed.places)?,
                false => steps.move_lost(cvt, &missed)?,
            };
        if !goes_on {
            break;
        }
        laps.timings.refine += laps.clock.lap();
        round += 1;
        enter(steps.observer, steps.token, "dual");
        dual = exact.dual(cvt, steps)?;
        laps.timings.dual += laps.clock.lap();
    }
    let (draft, _, seeds) = best.ok_or_else(|| RvdError::Internal("no result was built".to_owned()))?;
    let built = rayon::scope(|_| source.finish(draft))?;
    steps.refine.missed = built.missed;
    laps.timings.repair += laps.clock.lap();
    Ok((built, seeds))
}

/// The seeds that the options name, those of curves first, caller's coordinates, and the random seed they were
/// drawn from.
fn first_seeds(plan: &Plan<'_>, surface: &Surface, kept: &curves::Kept, seeds: &Seeds) -> (Vec<DVec3>, Option<u64>) {
    match *seeds {
        Seeds::Given(ref seeds) => (seeds.clone(), None),
        Seeds::Sample { seed, .. } | Seeds::Implied { seed } if kept.seeds.is_empty() => {
            let drawn = spread(&plan.mesh, plan.weights.as_deref(), None, plan.points, seed);
            (drawn.iter().map(|p| p.position).collect(), Some(seed))
        }
        Seeds::Sample { seed, .. } | Seeds::Implied { seed } => (kept.with_others(plan, surface, seed), Some(seed)),
    }
}

/// The input's attributes on the result, and where its vertices lie on the input, if asked for.
fn carried(
    mesh: &TriMesh,
    options: &RemeshOptions,
    result: &TriMesh,
    observer: &mut dyn Observer,
    token: &Token,
) -> Result<(Option<Attributes>, Vec<Provenance>), RemeshError> {
    let Some(attributes) = &options.attributes else { return Ok((None, Vec::new())) };
    enter(observer, token, "attributes");
    token.check()?;
    let closest = ClosestPoint::new(mesh);
    let provenance = attributes::provenance(&closest, result.positions(), token)?;
    token.check()?;
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
