//! Options of every benchmark, and where its figures go.
//!
//! Purpose: one set of options for all benchmarks: surface, seeds, steps, backend and files of figures; JSON and plots of one shape.
//! Invariant: a file that cannot be written is refused before anything is measured. Must not know: what is measured.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result};
use clap::Args;
use serde_json::{Value, json};

use crate::{backends, files, interrupt};
use geometry::mesh::TriMesh;
use geometry::mesh::shapes::Shape;
use geometry::remesh::Seeds;
use geometry::rvd::{Backend, BackendKind};
use geometry::token::Token;
use gpu::diagram::Gpu;
use picture::Size;
use picture::chart::{Axis, Figure, Panel, Series};
use server::config::BackendArg;
pub(super) use server::config::{BackendArgs, count, whole};

#[derive(Args, Debug)]
pub(super) struct SurfaceArgs {
    /// The surface, as `remesh` takes it; a torus if not given.
    #[arg(long, value_name = "FILE")]
    mesh: Option<PathBuf>,
    /// Facets of the torus.
    #[arg(long, value_name = "N", default_value_t = 20_000, conflicts_with = "mesh", value_parser = count)]
    facets: u32,
}

impl SurfaceArgs {
    pub(super) fn mesh(&self) -> Result<(String, TriMesh)> {
        mesh(self.mesh.as_deref(), Shape::Torus, self.facets as usize)
    }
}

#[derive(Args, Debug)]
pub(super) struct SeedsArgs {
    /// Seeds to draw.
    #[arg(long, value_name = "N", default_value_t = 10_000, value_parser = count)]
    points: u32,
    /// The seeds, `x y z` a line, instead.
    #[arg(long, value_name = "FILE.xyz", conflicts_with = "points")]
    seeds: Option<PathBuf>,
}

impl SeedsArgs {
    /// Those of the file, or such as are to be drawn.
    pub(super) fn seeds(&self, run: &RunArgs) -> Result<Seeds> {
        let given = self.seeds.as_deref().map(files::read_points).transpose()?;
        Ok(given.map_or_else(|| run.drawn(self.points), Seeds::Given))
    }
}

#[derive(Args, Debug)]
pub(super) struct RunArgs {
    /// Random seed of the points.
    #[arg(long, value_name = "N", default_value_t = Seeds::RANDOM_SEED, value_parser = whole::<u64>)]
    seed: u64,
    /// Lloyd steps before anything is timed; what warms up comes after them.
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = whole::<u32>)]
    pub(super) relax: u32,
    /// Steps of each kind that are timed.
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = count)]
    pub(super) iterations: u32,
    #[command(flatten)]
    backend: BackendArgs,
    #[command(flatten)]
    pub(super) output: OutputArgs,
}

impl RunArgs {
    /// Checks what can be checked before anything is read. Returns the token of the process.
    pub(super) fn begin(&self) -> Result<Token> {
        self.backend.check()?;
        self.output.check()?;
        token()
    }

    pub(super) fn drawn(&self, points: u32) -> Seeds {
        Seeds::Sample { points: points as usize, seed: self.seed }
    }

    pub(super) fn worker(&self) -> Result<Worker> {
        Worker::one(&self.backend)
    }

    /// All backends, or the one that is asked for; they are named in a line each, and keep time.
    pub(super) fn workers(&self) -> Result<Vec<Worker>> {
        let mut workers = Worker::all(&self.backend)?;
        workers.iter_mut().try_for_each(Worker::keep_time)?;
        workers.iter().try_for_each(|worker| outln!("{}", worker.describe()))?;
        Ok(workers)
    }
}

/// Set by Ctrl-C.
pub(super) fn token() -> Result<Token> {
    let token = Token::default();
    interrupt::cancel_on_signal(&token).context("cannot listen for signals")?;
    Ok(token)
}

/// A mesh and its name: a file's, or a shape of about `facets` facets.
pub(super) fn mesh(file: Option<&Path>, shape: Shape, facets: usize) -> Result<(String, TriMesh)> {
    Ok(match file {
        Some(path) => (path.file_stem().unwrap_or_default().to_string_lossy().into_owned(), files::read_mesh(path)?),
        None => (shape.to_string(), shape.build(facets)),
    })
}

#[derive(Args, Debug)]
pub(super) struct OutputArgs {
    /// Write the figures there, as JSON.
    #[arg(long, value_name = "FILE.json")]
    json: Option<PathBuf>,
    /// Draw them there.
    #[arg(long, value_name = "FILE.png")]
    plot: Option<PathBuf>,
}

impl OutputArgs {
    pub(super) fn check(&self) -> Result<()> {
        self.json.iter().try_for_each(|path| files::check_output(path, &[]))?;
        self.plot.iter().try_for_each(|path| files::check_output(path, &["png"]))
    }

    pub(super) fn write(&self, report: &Value, figure: &Figure) -> Result<()> {
        if let Some(path) = &self.json {
            files::write_json(path, report)?;
        }
        if let Some(path) = &self.plot {
            let size = Size::new(800 * figure.panels.len().max(1) as u32, 600)?;
            figure.write(size, path).with_context(|| format!("cannot draw {}", path.display()))?;
        }
        Ok(())
    }
}

/// Milliseconds of a worker, step by step.
pub(super) fn by_step(title: String, worker: &Worker, step: &str, series: Vec<Series>) -> Figure {
    let (x, y) = (Axis::linear(step), Axis::linear("ms"));
    Figure { title, panels: vec![Panel { title: worker.describe(), x, y, series, ..Panel::default() }] }
}

/// The report of cases that `workers` did. The first is the one that a program reads if it knows of one only.
pub(super) fn report(workers: &[Worker], cases: Vec<Value>) -> Value {
    let all: Vec<Value> = workers.iter().map(Worker::json).collect();
    let mut report = all.first().cloned().unwrap_or_else(|| json!({}));
    report["backends"] = all.into();
    report["cases"] = cases.into();
    report
}

pub(super) fn head() -> String {
    format!("{:<22}{:>10}{:>10}{:>10}{:>10}", "ms", "min", "median", "max", "mean")
}

/// `a / b`, if that says anything.
pub(super) fn ratio(a: f64, b: f64) -> Option<f64> {
    (a > 0.0 && b > 0.0).then(|| a / b)
}

/// Slopes of log y over log x by decades of x: (from, to, slope by least squares), where two points or more are.
pub(super) fn slopes(points: &[(f64, f64)]) -> Vec<(f64, f64, f64)> {
    let logs: Vec<(f64, f64)> =
        points.iter().filter(|p| p.0 > 0.0 && p.1 > 0.0).map(|p| (p.0.log10(), p.1.log10())).collect();
    let ends = logs.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), p| (a.min(p.0), b.max(p.0)));
    if ends.0 >= ends.1 {
        return Vec::new();
    }
    let slack = 1e-9;
    let decade = |k: i32| {
        let (from, to) = (f64::from(k), f64::from(k + 1));
        let inside: Vec<_> = logs.iter().filter(|p| (from - slack..=to + slack).contains(&p.0)).collect();
        let n = inside.len() as f64;
        let (mx, my) = inside.iter().fold((0.0, 0.0), |(x, y), p| (x + p.0 / n, y + p.1 / n));
        let (xx, xy) =
            inside.iter().fold((0.0, 0.0), |(xx, xy), p| (xx + (p.0 - mx) * (p.0 - mx), xy + (p.0 - mx) * (p.1 - my)));
        (inside.len() > 1 && xx > 0.0).then(|| (10f64.powi(k), 10f64.powi(k + 1), xy / xx))
    };
    (ends.0.floor() as i32..ends.1.ceil() as i32).filter_map(decade).collect()
}

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

    /// Of any backend but the GPU's.
    pub(super) fn on_cpu(backend: Arc<dyn Backend>) -> Self {
        Self { backend, gpu: None, clock: false }
    }

    /// The one that the options ask for.
    pub(super) fn one(args: &BackendArgs) -> Result<Self> {
        if matches!(args.backend, BackendArg::Auto | BackendArg::Gpu)
            && let Ok(gpu) = backends::gpu(args)
        {
            return Ok(Self::on_gpu(gpu));
        }
        // Says why not, if only a GPU will do.
        Ok(Self::on_cpu(backends::one(args)?))
    }

    /// All that are there, if the options leave it open: GPU, parallel, serial.
    pub(super) fn all(args: &BackendArgs) -> Result<Vec<Self>> {
        if args.backend != BackendArg::Auto {
            return Ok(vec![Self::one(args)?]);
        }
        let mut workers = Vec::new();
        match backends::gpu(args) {
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

    pub(super) fn json(&self) -> Value {
        let (adapter, threads) = (self.backend.adapter(), self.backend.threads());
        json!({ "backend": self.name(), "adapter": adapter, "threads": threads })
    }

    pub(super) fn phases_by(&self) -> &'static str {
        match (self.backend.kind(), self.clock) {
            (BackendKind::Gpu, true) => "device clock",
            // They are parts of one submission.
            (BackendKind::Gpu, false) => "none",
            _ => "wall clock",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slopes_are_those_of_powers() {
        let line: Vec<(f64, f64)> = [20.0, 50.0, 100.0, 200.0, 1000.0]
            .iter()
            .map(|&x: &f64| (x, if x <= 100.0 { 7.0 } else { 0.07 * x }))
            .collect();
        let found = slopes(&line);
        assert_eq!(found.len(), 2);
        assert_eq!((found[0].0, found[0].1), (10.0, 100.0));
        assert!(found[0].2.abs() < 1e-12);
        assert!((found[1].2 - 1.0).abs() < 1e-9, "{found:?}");
        for none in [&[][..], &[(5.0, 1.0)], &[(5.0, 0.0), (7.0, 1.0)], &[(5.0, 1.0), (5.0, 2.0)]] {
            assert_eq!(slopes(none), []);
        }
    }
}
