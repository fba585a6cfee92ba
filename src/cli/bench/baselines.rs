//! The methods that Figure 4 of \[HYWZ17\] compares with, beside the exact diagram.
//!
//! Purpose: `--baseline`: jump flooding on voxels (Rong and Tan 2006), on a geometry image (Rong et al. 2011), and clusters of the
//! voxels of a narrow band (Leung et al. 2015), on a GPU too; their times, memory, energies, errors and duals.
//! Invariant: all begin at the same seeds and take steps by the library's own iteration, on the same threads; the exact
//! diagram judges them. The library knows none of them. Must not know: what the exact diagram is made of.

mod band;
mod compare;
mod flood;
mod image;
mod session;
mod stages;
mod sums;
mod voxels;

use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use clap::Args;
use serde_json::{Value, json};

use self::band::Band;
use self::compare::{Dual, Judge, Labels, Verdict};
use self::flood::{Flood, OnDevice, OnHost, Samples};
use self::image::{Image, Texels};
use self::session::{Baseline, Clustering};
use self::voxels::{Grid, Voxels};
use super::args::Worker;
use super::measure::{Load, Timed};
use crate::exit::Usage;
use crate::given::{Words, words};
use geometry::cvt::StepKind;
use geometry::rvd::{Backend, BackendKind, RvdError, elapsed_ms, on_threads_of};
use geometry::token::Token;
use server::config::whole;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Method {
    Flood,
    Band,
    Image,
}

const METHODS: Words<Method> = &[
    ("jfa", "Jump flooding on all voxels of a grid, plain and from the labels of the last step", Method::Flood),
    ("band", "The exact nearest seed of each voxel near the surface", Method::Band),
    ("geometry-image", "Jump flooding on a geometry image, Lloyd and L-BFGS; for disks", Method::Image),
];

#[derive(Args, Debug)]
pub(super) struct BaselineArgs {
    /// A method of Figure 4 to measure beside the exact diagram. May be repeated.
    #[arg(long, value_parser = words(METHODS))]
    baseline: Vec<Method>,
    /// Voxels on each side of the grid of `jfa` and `band`, 8 to 1024.
    #[arg(long, value_name = "N", default_value_t = 128, value_parser = voxels, requires = "baseline")]
    voxels: u32,
    /// Layers of voxels of `band`, 1 to 16: those that the surface touches, and layers on both sides of them.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = shell, requires = "baseline")]
    shell: u32,
    /// Texels on each side of a geometry image, 16 to 8192.
    #[arg(long, value_name = "N", default_value_t = 512, value_parser = texels, requires = "baseline")]
    texels: u32,
}

fn within(text: &str, from: u32, to: u32) -> Result<u32, String> {
    let number = whole(text).ok().filter(|number| (from..=to).contains(number));
    number.ok_or_else(|| format!("a whole number from {from} to {to} is needed"))
}

fn voxels(text: &str) -> Result<u32, String> {
    within(text, 8, 1024)
}

fn shell(text: &str) -> Result<u32, String> {
    within(text, 1, 16)
}

fn texels(text: &str) -> Result<u32, String> {
    within(text, 16, 8192)
}

/// The name of the exact diagram among the methods.
pub(super) const EXACT: &str = "exact";

/// What a method did for one number of seeds.
pub(super) struct Row {
    pub(super) method: &'static str,
    points: usize,
    outcome: Outcome,
}

enum Outcome {
    Ran(Box<Ran>),
    /// With the reason.
    NotRun(String),
}

struct Ran {
    timed: Timed,
    prepare_ms: f64,
    bytes: Option<u64>,
    verdict: Verdict,
    /// Of a baseline.
    labels: Option<Labels>,
}

impl BaselineArgs {
    pub(super) fn is_empty(&self) -> bool {
        self.baseline.is_empty()
    }

    fn wants(&self, method: Method) -> bool {
        self.baseline.contains(&method)
    }

    /// Measures what is wanted for the seeds of `load`; `times` are those of the workers' own steps.
    pub(super) fn measure(
        &self,
        load: &Load,
        workers: &[Worker],
        times: Vec<Timed>,
        steps: usize,
        token: &Token,
    ) -> Result<Vec<Row>> {
        let is_parallel = |worker: &Worker| worker.backend.kind() == BackendKind::Parallel;
        let at = workers.iter().position(is_parallel).unwrap_or(0);
        let Some((worker, exact)) = workers.get(at).zip(times.into_iter().nth(at)) else { return Ok(Vec::new()) };
        let run = Run { load, by: &worker.backend, steps, judge: Judge::new(&load.surface, &worker.backend, token)? };
        let verdict = run.judge.seeds(&exact.seeds, token)?;
        let ran = Ran { timed: exact, prepare_ms: 0.0, bytes: None, verdict, labels: None };
        let mut rows = vec![run.row(EXACT, Outcome::Ran(Box::new(ran)))];
        let surface = &load.surface;
        let device = workers.iter().find_map(|worker| worker.gpu.as_ref()).map(|gpu| gpu.device());
        let count = load.seeds.len();
        if self.wants(Method::Flood) {
            for (name, warm) in [("jfa", false), ("jfa, warm", true)] {
                let made = |run: &Run<'_>| -> Result<_> {
                    let voxels = self.voxels(run, flood::BYTES, 1)?;
                    Ok(Flood::new(voxels, surface, warm, OnHost::new(Samples::cube(self.voxels))))
                };
                rows.push(run.of(name, made, token)?);
            }
            for (name, warm) in [("jfa, GPU", false), ("jfa, warm, GPU", true)] {
                let Some(device) = device else { break };
                let made = |run: &Run<'_>| -> Result<_> {
                    let voxels = self.voxels(run, 0, 1)?;
                    let labels = OnDevice::new(device, Samples::cube(self.voxels), Some(&voxels.codes), count);
                    let labels = labels.map_err(RvdError::from).context("--voxels: the labels on the GPU");
                    Ok(Flood::new(voxels, surface, warm, labels?))
                };
                rows.push(run.of(name, made, token)?);
            }
        }
        if self.wants(Method::Band) {
            let made = |run: &Run<'_>| -> Result<_> { Ok(Band::new(self.band(run)?, surface, band::OnHost)) };
            rows.push(run.of("band", made, token)?);
            if let Some(device) = device {
                let made = |run: &Run<'_>| -> Result<_> {
                    let voxels = self.band(run)?;
                    let search = band::OnDevice::new(device, &voxels, count);
                    let search = search.map_err(RvdError::from).context("--voxels: the search on the GPU");
                    Ok(Band::new(voxels, surface, search?))
                };
                rows.push(run.of("band, GPU", made, token)?);
            }
        }
        if self.wants(Method::Image) {
            for row in [("geometry-image", StepKind::Lloyd), ("geometry-image, L-BFGS", StepKind::Lbfgs)] {
                let labels = |samples: &Samples| Ok(OnHost::new(samples.clone()));
                rows.push(self.image(&run, row, labels, token)?);
            }
            for row in [("geometry-image, GPU", StepKind::Lloyd), ("geometry-image, L-BFGS, GPU", StepKind::Lbfgs)] {
                let Some(device) = device else { break };
                let labels = |samples: &Samples| {
                    let labels = OnDevice::new(device, samples.clone(), None, count);
                    labels.map_err(RvdError::from).context("--texels: the labels on the GPU")
                };
                rows.push(self.image(&run, row, labels, token)?);
            }
        }
        Ok(rows)
    }

    /// Steps of a kind on the texels of the surface, if it has some.
    fn image<L: flood::Labels + 'static>(
        &self,
        run: &Run<'_>,
        (method, kind): (&'static str, StepKind),
        labels: impl FnOnce(&Samples) -> Result<L>,
        token: &Token,
    ) -> Result<Row> {
        let begin = Instant::now();
        Ok(match on_threads_of(run.by.as_ref(), || Texels::new(&run.judge.mesh, self.texels, token))? {
            Ok(texels) => {
                let labels = labels(&texels.samples)?;
                run.timed(method, kind, Image::new(texels, labels), begin, token)?
            }
            Err(reason) => run.row(method, Outcome::NotRun(reason.to_string())),
        })
    }

    /// The voxels of the surface and the layers around them.
    fn band(&self, run: &Run<'_>) -> Result<Voxels> {
        Ok(self.voxels(run, 0, u64::from(2 * self.shell - 1))?.widened(self.shell - 1))
    }

    /// The surface's voxels, if there is memory for them with so many layers, and for `of_all` bytes a voxel of the grid.
    fn voxels(&self, run: &Run<'_>, of_all: u64, layers: u64) -> Result<Voxels> {
        let grid = Grid::new(&run.load.surface, self.voxels);
        check(layers * grid.plan(&run.load.surface, of_all), limit())?;
        Ok(Voxels::new(&run.load.surface, grid))
    }

    /// The options that figures depend on.
    pub(super) fn json(&self) -> Value {
        json!({ "voxels": self.voxels, "shell": self.shell, "texels": self.texels })
    }
}

/// Three quarters of what this machine has; without a figure, 16 GiB.
fn limit() -> u64 {
    jobs::memory::machine_memory_bytes().map_or(16 << 30, |bytes| bytes / 4 * 3)
}

fn check(needed: u64, limit: u64) -> Result<(), Usage> {
    if needed <= limit {
        return Ok(());
    }
    let [needed, limit] = [needed, limit].map(|bytes| bytes as f64 / 1e9);
    Err(Usage(format!("the voxels need {needed:.1} GB and {limit:.1} GB can be had; give fewer with --voxels")))
}

struct Run<'a> {
    load: &'a Load,
    by: &'a Arc<dyn Backend>,
    steps: usize,
    judge: Judge,
}

impl Run<'_> {
    fn row(&self, method: &'static str, outcome: Outcome) -> Row {
        Row { method, points: self.load.seeds.len(), outcome }
    }

    /// Lloyd steps on a clustering.
    fn of<C: Clustering + 'static>(
        &self,
        method: &'static str,
        make: impl FnOnce(&Self) -> Result<C> + Send,
        token: &Token,
    ) -> Result<Row> {
        let begin = Instant::now();
        let clustering = on_threads_of(self.by.as_ref(), || make(self))?;
        self.timed(method, StepKind::Lloyd, clustering, begin, token)
    }

    fn timed(
        &self,
        method: &'static str,
        kind: StepKind,
        clustering: impl Clustering + 'static,
        begin: Instant,
        token: &Token,
    ) -> Result<Row> {
        let prepare_ms = elapsed_ms(begin);
        let baseline = Arc::new(Baseline::new(clustering, self.by));
        let worker = Worker::on_cpu(Arc::clone(&baseline) as Arc<dyn Backend>);
        let timed = self.load.time(&worker, kind, self.steps, Duration::MAX, token)?;
        let verdict = self.judge.seeds(&timed.seeds, token)?;
        let clustering = baseline.clustering();
        let labels = Some(self.judge.labels(&*clustering, &timed.seeds, token)?);
        let ran = Ran { timed, prepare_ms, bytes: Some(clustering.bytes()), verdict, labels };
        Ok(self.row(method, Outcome::Ran(Box::new(ran))))
    }
}

pub(super) fn head() -> String {
    let dual = |whose: &str| format!("{:>11}{:>7}{:>7}{:>6}", format!("{whose} Qmin"), "Qavg", "θmin", "bad");
    let figures = format!("{:>9}{:>9}{:>9}{:>8}{:>8}", "ms", "MB", "E/E_hex", "area %", "label %");
    format!("{:<8}{:<28}{figures}{}{}", "points", "method", dual("own"), dual("exact"))
}

impl Row {
    /// A line under [`head`].
    pub(super) fn line(&self) -> String {
        let begin = format!("{:<8}{:<28}", self.points, self.method);
        let ran = match &self.outcome {
            Outcome::NotRun(reason) => return format!("{begin} not run: {reason}"),
            Outcome::Ran(ran) => ran,
        };
        let number = |value: Option<f64>, width: usize, digits: usize| match value {
            Some(value) => format!("{value:>width$.digits$}"),
            None => format!("{:>width$}", "-"),
        };
        let labels = ran.labels.as_ref();
        let figures = [
            number(Some(ran.timed.step_ms().mean), 9, 3),
            number(ran.bytes.map(|bytes| bytes as f64 / 1e6), 9, 1),
            number(Some(ran.verdict.energy_ratio), 9, 4),
            number(labels.map(|l| l.wrong_area), 8, 2),
            number(labels.map(|l| l.wrong_labels), 8, 3),
        ];
        let dual = |dual: Option<Dual>| {
            let of = |figure: fn(&Dual) -> f64, width, digits| number(dual.as_ref().map(figure), width, digits);
            let [q_min, q_avg] = [of(|d| d.quality.q_min, 11, 3), of(|d| d.quality.q_avg, 7, 3)];
            q_min + &q_avg + &of(|d| d.quality.theta_min_deg, 7, 1) + &of(|d| d.non_manifold_edges as f64, 6, 0)
        };
        begin + &figures.concat() + &dual(labels.and_then(|l| l.dual)) + &dual(ran.verdict.exact_dual)
    }

    /// Points, and seconds of all steps; `None` if it was not run.
    pub(super) fn at(&self) -> Option<(f64, f64)> {
        match &self.outcome {
            Outcome::Ran(ran) => Some((self.points as f64, ran.timed.total_ms / 1e3)),
            Outcome::NotRun(_) => None,
        }
    }

    pub(super) fn json(&self, load: &Load) -> Value {
        let (mesh, facets) = (&load.name, load.facets);
        let mut row = json!({ "method": self.method, "mesh": mesh, "facets": facets, "points": self.points });
        let ran = match &self.outcome {
            Outcome::NotRun(reason) => {
                row["not_run"] = reason.as_str().into();
                return row;
            }
            Outcome::Ran(ran) => ran,
        };
        let labels = ran.labels.as_ref();
        let fields = [
            ("exact", json!(labels.is_none())),
            ("kind", json!(ran.timed.kind.name())),
            ("iterations", json!(ran.timed.steps.len())),
            ("iteration_ms", json!(ran.timed.step_ms())),
            ("evaluations", json!(ran.timed.evaluations())),
            ("total_ms", json!(ran.timed.total_ms)),
            ("prepare_ms", json!(ran.prepare_ms)),
            ("memory_bytes", json!(ran.bytes)),
            ("own_energy_ratio", json!(ran.timed.energy_ratio)),
            ("energy_ratio", json!(ran.verdict.energy_ratio)),
            ("wrong_area_percent", json!(labels.map(|l| l.wrong_area))),
            ("wrong_labels_percent", json!(labels.map(|l| l.wrong_labels))),
            ("own_dual", json!(labels.and_then(|l| l.dual))),
            ("exact_dual", json!(ran.verdict.exact_dual)),
        ];
        for (name, value) in fields {
            row[name] = value;
        }
        row
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use geometry::mesh::TriMesh;
    use geometry::mesh::sample::sample;
    use geometry::mesh::shapes::Shape;
    use geometry::remesh::Seeds;
    use geometry::rvd::{CellSums, Parallel, SessionOptions, Surface};

    /// Random points of a surface, unit frame.
    pub(super) fn seeds_on(surface: &Surface, count: usize) -> Vec<DVec3> {
        let mesh = TriMesh::new(surface.positions().to_vec(), surface.facets().to_vec()).unwrap();
        sample(&mesh, None, count, 7).iter().map(|p| p.position).collect()
    }

    #[test]
    fn the_same_bits_with_any_number_of_threads() {
        let mesh = Shape::Hills.build(2000);
        let surface = Arc::new(Surface::new(&mesh, None).unwrap());
        let flat = TriMesh::new(surface.positions().to_vec(), surface.welded().to_vec()).unwrap();
        let voxels = || Voxels::new(&surface, Grid::new(&surface, 32));
        let seeds = seeds_on(&surface, 150);
        type Labelled = Vec<(DVec3, f64, u32)>;
        type Make = Box<dyn FnOnce(&Arc<dyn Backend>) -> Baseline>;
        let all = || -> Vec<Make> {
            let texels = Texels::new(&flat, 64, &Token::default()).unwrap().ok().unwrap();
            let flooded = OnHost::new(texels.samples.clone());
            let image = Image::new(texels, flooded);
            let flood = Flood::new(voxels(), &surface, true, OnHost::new(Samples::cube(32)));
            let band = Band::new(voxels().widened(1), &surface, band::OnHost);
            vec![
                Box::new(move |by| Baseline::new(flood, by)),
                Box::new(move |by| Baseline::new(band, by)),
                Box::new(move |by| Baseline::new(image, by)),
            ]
        };
        let run = |threads: usize| -> Vec<(CellSums, Labelled)> {
            let by: Arc<dyn Backend> = Arc::new(Parallel::new(Some(threads)).unwrap());
            let of = |make: Make| {
                let baseline = make(&by);
                let mut session = baseline.session(Arc::clone(&surface), SessionOptions::new(seeds.len())).unwrap();
                let (mut sums, mut seeds) = (CellSums::default(), seeds.clone());
                for _ in 0..3 {
                    session.set_seeds(&seeds).unwrap();
                    session.sums(&mut sums, &Token::default()).unwrap();
                    seeds = (0..).zip(&seeds).map(|(i, &seed)| sums.centroid(i, seed)).collect();
                }
                (sums, baseline.clustering().samples())
            };
            all().into_iter().map(of).collect()
        };
        assert!(run(1) == run(2));
    }

    #[test]
    fn steps_on_labels_come_near_the_exact_energy() {
        let load = |shape: Shape| {
            let mesh = (shape.to_string(), shape.build(2000));
            Load::new(mesh, Seeds::Sample { points: 150, seed: 1 }, Default::default()).unwrap()
        };
        let by: Arc<dyn Backend> = Arc::new(Parallel::new(Some(2)).unwrap());
        let workers = [Worker::on_cpu(Arc::clone(&by))];
        let args = |baseline| BaselineArgs { baseline, voxels: 48, shell: 1, texels: 128 };
        let token = Token::default();
        let exact = |load: &Load| load.time(&workers[0], StepKind::Lloyd, 15, Duration::MAX, &token).unwrap();
        for (shape, methods) in
            [(Shape::Torus, vec![Method::Flood, Method::Band, Method::Image]), (Shape::Hills, vec![Method::Image])]
        {
            let load = load(shape);
            let args = args(methods);
            let rows = args.measure(&load, &workers, vec![exact(&load)], 15, &token).unwrap();
            let names: Vec<&str> = rows.iter().map(|row| row.method).collect();
            let image = ["geometry-image", "geometry-image, L-BFGS"];
            assert!(names.ends_with(&image) && names[0] == "exact", "{names:?}");
            let mut best = 0.0;
            for row in &rows {
                match &row.outcome {
                    Outcome::NotRun(reason) => {
                        assert!(shape == Shape::Torus && image.contains(&row.method), "{}: {reason}", row.method);
                        assert!(row.line().contains("not run: the surface is no disk"), "{}", row.line());
                    }
                    Outcome::Ran(ran) => {
                        let energy = ran.verdict.energy_ratio;
                        best = if row.method == "exact" { energy } else { best };
                        assert!(energy < best + 0.05, "{}: {energy} for {best}", row.method);
                        assert!((ran.timed.energy_ratio / energy - 1.0).abs() < 0.1, "{}", row.line());
                        let exact = ran.verdict.exact_dual.unwrap();
                        assert_eq!(exact.non_manifold_edges, 0, "{}", row.line());
                        if let Some(labels) = &ran.labels {
                            assert!(labels.wrong_area < 20.0 && labels.wrong_labels < 1.0, "{}", row.line());
                            assert!(labels.dual.unwrap().quality.q_avg > 0.7 && ran.bytes > Some(0), "{}", row.line());
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn voxels_beyond_the_memory_are_refused() {
        let surface = Surface::new(&Shape::Sphere.build(1000), None).unwrap();
        let needed = Grid::new(&surface, 1024).plan(&surface, flood::BYTES);
        assert!(needed > 8 << 30 && needed < 16 << 30, "{needed}");
        let error = check(needed, 1 << 30).unwrap_err();
        assert!(error.to_string().contains("--voxels"), "{error}");
        let made = |n: u32| {
            let voxels = Voxels::new(&surface, Grid::new(&surface, n));
            Flood::new(voxels, &surface, false, OnHost::new(Samples::cube(n))).bytes()
        };
        assert!([16, 64].iter().all(|&n| made(n) <= Grid::new(&surface, n).plan(&surface, flood::BYTES)));
    }
}
