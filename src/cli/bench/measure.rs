//! Steps that are timed.
//!
//! Purpose: who works ([`Worker`]), on what ([`Load`]), and the steps that are taken and timed ([`Timed`]).
//! Invariant: workers that are compared begin at the same seeds. What warms up is not counted.
//! Must not know: tables, plots.

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use glam::DVec3;
use serde_json::{Value, json};

use super::spread::Spread;
use crate::{backends, files, interrupt};
use geometry::cvt::density::DensityOptions;
use geometry::cvt::{Cvt, CvtOptions, Iteration, StepKind};
use geometry::mesh::TriMesh;
use geometry::mesh::shapes::Shape;
use geometry::remesh::Seeds;
use geometry::rvd::{Backend, BackendKind, DeviceWork, Surface};
use geometry::token::Token;
use gpu::diagram::Gpu;
use jobs::JobError;
use jobs::spec::{Input, Prepared};
pub(super) use server::config::{BackendArg, BackendArgs};

/// Steps of a kind before the first that is timed: buffers and rows of neighbours get their sizes.
const WARM_UP: usize = 2;
/// Steps that are timed whatever a limit says.
const FEWEST: usize = 3;

/// Set by Ctrl-C.
///
/// # Errors
/// The operating system refused.
pub(super) fn token() -> Result<Token> {
    let token = Token::default();
    interrupt::cancel_on_signal(&token).context("cannot listen for signals")?;
    Ok(token)
}

/// A backend that is measured.
pub(super) struct Worker {
    pub(super) backend: Arc<dyn Backend>,
    /// The same, if it is the GPU's.
    pub(super) gpu: Option<Arc<Gpu>>,
    /// The device's own clock times the phases.
    clock: bool,
}

impl Worker {
    fn on_gpu(gpu: Arc<Gpu>) -> Self {
        let backend: Arc<dyn Backend> = Arc::clone(&gpu) as Arc<dyn Backend>;
        Self { backend, gpu: Some(gpu), clock: false }
    }

    /// The one that the options ask for.
    pub(super) fn one(args: &BackendArgs) -> Result<Self> {
        if matches!(args.backend, BackendArg::Auto | BackendArg::Gpu)
            && let Ok(gpu) = backends::open_gpu(args)
        {
            return Ok(Self::on_gpu(gpu));
        }
        // Says why not, if only a GPU will do.
        Ok(Self { backend: backends::one(args)?, gpu: None, clock: false })
    }

    /// All that are there, if the options leave it open: GPU, parallel, serial.
    pub(super) fn all(args: &BackendArgs) -> Result<Vec<Self>> {
        if args.backend != BackendArg::Auto {
            return Ok(vec![Self::one(args)?]);
        }
        let mut workers = Vec::new();
        match backends::open_gpu(args) {
            Ok(gpu) => workers.push(Self::on_gpu(gpu)),
            Err(reason) => errln!("tessera: no GPU is measured: {reason}"),
        }
        for backend in [BackendArg::Parallel, BackendArg::Serial] {
            workers.push(Self::one(&BackendArgs { backend, ..args.clone() })?);
        }
        Ok(workers)
    }

    /// Has a GPU's own clock time the phases, if it has one.
    pub(super) fn keep_time(&mut self) -> Result<()> {
        if let Some(gpu) = &self.gpu {
            self.clock = gpu.keep_time()?;
        }
        Ok(())
    }

    /// "gpu", "parallel" or "serial".
    pub(super) fn name(&self) -> &'static str {
        self.backend.kind().name()
    }

    /// The same and what of the machine it uses.
    pub(super) fn describe(&self) -> String {
        let adapter = self.backend.adapter().map(|a| format!(" ({a})")).unwrap_or_default();
        match self.backend.threads() {
            1 => format!("{}{adapter}, 1 thread", self.name()),
            threads => format!("{}{adapter}, {threads} threads", self.name()),
        }
    }

    /// Who it is.
    pub(super) fn json(&self) -> Value {
        let (adapter, threads) = (self.backend.adapter(), self.backend.threads());
        json!({ "backend": self.name(), "adapter": adapter, "threads": threads })
    }

    /// Where the times of the phases come from.
    pub(super) fn phases_by(&self) -> &'static str {
        match (self.backend.kind(), self.clock) {
            (BackendKind::Gpu, true) => "device clock",
            // They are parts of one submission.
            (BackendKind::Gpu, false) => "none",
            _ => "wall clock",
        }
    }
}

/// A surface and seeds on it.
pub(super) struct Load {
    pub(super) name: String,
    pub(super) surface: Arc<Surface>,
    /// How many facets the mesh has; the surface's may be divided.
    pub(super) facets: usize,
    /// Caller's coordinates.
    pub(super) seeds: Vec<DVec3>,
    /// "uniform", "curvature" or "lfs".
    pub(super) density: &'static str,
    /// Lloyd steps that the seeds were moved by.
    pub(super) relaxed: usize,
}

/// A mesh and its name: a file's, or a shape of about so many facets.
pub(super) fn mesh(file: Option<&Path>, shape: Shape, facets: usize) -> Result<(String, TriMesh)> {
    Ok(match file {
        Some(path) => (path.file_stem().unwrap_or_default().to_string_lossy().into_owned(), files::read_mesh(path)?),
        None => (shape.to_string(), shape.build(facets)),
    })
}

impl Load {
    /// Prepares the surface as a remesh does, and draws the seeds, if they are to be drawn.
    pub(super) fn new(mesh: (String, TriMesh), seeds: Seeds, density: DensityOptions) -> Result<Self> {
        Self::of(mesh, seeds, density, |input| Prepared::for_steps(input, &Token::default()))
    }

    /// The same of the mesh's own facets.
    pub(super) fn undivided(mesh: (String, TriMesh), seeds: Seeds) -> Result<Self> {
        Self::of(mesh, seeds, DensityOptions::default(), |input| Prepared::new(input, &Token::default()))
    }

    fn of(
        (name, mesh): (String, TriMesh),
        seeds: Seeds,
        density: DensityOptions,
        prepare: impl FnOnce(Input) -> Result<Prepared, JobError>,
    ) -> Result<Self> {
        let (source, facets) = (density.source.name(), mesh.facets().len());
        let input = Input { mesh, density, seeds, creases: Vec::new(), attributes: None };
        let Prepared { surface, seeds, .. } = prepare(input)?;
        Ok(Self { name, surface, facets, seeds: seeds.to_vec(), density: source, relaxed: 0 })
    }

    /// The surface as it was prepared: its facets may have been divided for a density.
    pub(super) fn mesh(&self) -> Result<TriMesh> {
        let positions = self.surface.positions().iter().map(|&p| self.surface.frame().to_world(p)).collect();
        Ok(TriMesh::new(positions, self.surface.facets().to_vec())?)
    }

    /// Moves the seeds by so many Lloyd steps, fewer if `limit` is over.
    pub(super) fn relax(&mut self, by: &Worker, steps: usize, limit: Duration, token: &Token) -> Result<()> {
        let begin = Instant::now();
        let mut cvt = self.cvt(by)?;
        let mut taken = 0;
        while taken < steps && begin.elapsed() < limit {
            taken += cvt.relax(steps - taken, token)?.len();
        }
        if taken > 0 {
            self.seeds = cvt.seeds()?;
        }
        self.relaxed += taken;
        Ok(())
    }

    fn cvt(&self, by: &Worker) -> Result<Cvt> {
        let surface = Arc::clone(&self.surface);
        Ok(Cvt::new(by.backend.as_ref(), surface, &self.seeds, CvtOptions::default())?)
    }

    /// Takes `steps` steps that are timed, and some before them that are not; fewer, but three, if `limit` is over.
    pub(super) fn time(
        &self,
        by: &Worker,
        kind: StepKind,
        steps: usize,
        limit: Duration,
        token: &Token,
    ) -> Result<Timed> {
        let mut cvt = self.cvt(by)?;
        let mut take = |most| match kind {
            StepKind::Lloyd => cvt.relax(most, token),
            StepKind::Lbfgs => cvt.lbfgs(token).map(|step| vec![step]),
        };
        let begin = Instant::now();
        let mut warmed = 0;
        while warmed < WARM_UP {
            warmed += take(WARM_UP - warmed)?.len();
        }
        let (first, mut taken) = (Instant::now(), Vec::with_capacity(steps));
        while taken.len() < steps && (taken.len() < FEWEST || begin.elapsed() < limit) {
            taken.append(&mut take(steps - taken.len())?);
        }
        let total_ms = first.elapsed().as_secs_f64() * 1e3;
        let cut = taken.len() < steps && taken.len() <= FEWEST;
        let last = cvt.present(token)?;
        Ok(Timed { kind, steps: taken, total_ms, cut, energy_ratio: last.energy_ratio })
    }
}

/// Steps that were timed.
pub(super) struct Timed {
    /// As was asked for; a step that failed as such is one of Lloyd's.
    pub(super) kind: StepKind,
    pub(super) steps: Vec<Iteration>,
    /// From the first to the last.
    pub(super) total_ms: f64,
    /// A limit ended it after the fewest steps.
    pub(super) cut: bool,
    /// After the last.
    pub(super) energy_ratio: f64,
}

/// Names of the phases, and what else a step takes.
pub(super) const PHASES: [&str; 5] = ["neighbours", "start", "clip", "update", "rest"];

impl Timed {
    /// Those of several rounds, each of which began at the same seeds.
    pub(super) fn joined<'a>(kind: StepKind, rounds: impl Iterator<Item = &'a Self>) -> Self {
        let none = Self { kind, steps: Vec::new(), total_ms: 0.0, cut: false, energy_ratio: 0.0 };
        rounds.fold(none, |mut all, round| {
            all.steps.extend_from_slice(&round.steps);
            all.total_ms += round.total_ms;
            all.cut |= round.cut;
            Self { energy_ratio: round.energy_ratio, ..all }
        })
    }

    /// Times of the steps.
    pub(super) fn step_ms(&self) -> Spread {
        Spread::of(self.steps.iter().map(|s| s.ms))
    }

    /// Times of the steps by their evaluations: passes over the diagram and what follows from each.
    pub(super) fn evaluation_ms(&self) -> Spread {
        Spread::of(self.steps.iter().map(|s| s.ms / s.evaluations.max(1) as f64))
    }

    /// Passes of all steps.
    pub(super) fn evaluations(&self) -> usize {
        self.steps.iter().map(|s| s.evaluations).sum()
    }

    /// Quasi-Newton steps that failed and were Lloyd's.
    pub(super) fn fallbacks(&self) -> usize {
        self.steps.iter().filter(|s| s.kind != self.kind).count()
    }

    /// Times of the phases, and the rest: launches, round trips, vectors of a quasi-Newton step.
    pub(super) fn phases(&self) -> [(&'static str, Spread); 5] {
        let times = |s: &Iteration| {
            let [a, b, c, d] = [s.stats.neighbours_ms, s.stats.start_ms, s.stats.clip_ms, s.stats.update_ms];
            [a, b, c, d, (s.ms - a - b - c - d).max(0.0)]
        };
        std::array::from_fn(|k| (PHASES[k], Spread::of(self.steps.iter().map(|s| times(s)[k]))))
    }

    /// The most that a step had a device do.
    pub(super) fn device(&self) -> DeviceWork {
        self.steps.iter().fold(DeviceWork::default(), |most, s| most.with(&s.stats.device_work(), u64::max))
    }

    /// As a case of a report.
    pub(super) fn json(&self, load: &Load, by: &Worker) -> Value {
        let mut case = by.json();
        let phases = self.phases();
        let by_phase = |value: &dyn Fn(&Spread) -> Value| {
            Value::Object(phases.iter().map(|(name, s)| ((*name).to_owned(), value(s))).collect())
        };
        let sum = |of: fn(&Iteration) -> u64| self.steps.iter().map(of).sum::<u64>();
        let fields = [
            ("mesh", json!(load.name)),
            ("facets", json!(load.facets)),
            ("facets_divided_into", json!(load.surface.facets().len())),
            ("points", json!(load.seeds.len())),
            ("density", json!(load.density)),
            ("kind", json!(self.kind.name())),
            ("relax", json!(load.relaxed)),
            ("iterations", json!(self.steps.len())),
            ("iteration_ms", self.step_ms().json()),
            ("evaluations", json!(self.evaluations())),
            ("evaluation_ms", self.evaluation_ms().json()),
            ("lloyd_fallbacks", json!(self.fallbacks())),
            ("total_ms", json!(self.total_ms)),
            ("energy_ratio", json!(self.energy_ratio)),
            ("phases_ms", by_phase(&|s| json!(s.mean))),
            ("phases_spread_ms", by_phase(&Spread::json)),
            ("phases_by", json!(by.phases_by())),
            ("pairs", json!(sum(|s| s.stats.pairs) / self.evaluations().max(1) as u64)),
            ("relaunched_pairs", json!(sum(|s| s.stats.relaunched()))),
            ("f64_finished_pairs", json!(sum(|s| s.stats.f64_finished))),
            ("device_most", json!(self.device())),
            ("exact", json!(true)),
        ];
        for (name, value) in fields {
            case[name] = value;
        }
        case
    }
}
