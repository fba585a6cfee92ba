//! `tessera bench`: how long what takes.
//!
//! Purpose: times of the passes of a diagram by phase, as a table and as JSON, and for a GPU what
//! each way of adding costs.
//! Invariant: what is timed is the exact diagram, every pass of it. Times are printed and never
//! judged. Must not know: how a phase is done.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, Result};
use clap::{Args, Subcommand, ValueEnum};
use glam::DVec3;
use serde_json::{Value, json};

use super::{backends, files, interrupt};
use crate::config::{BackendArg, BackendArgs};
use crate::cvt::density::DensityOptions;
use crate::job::spec::{Input, Prepared};
use crate::mesh::shapes::Shape;
use crate::remesh::Seeds;
use crate::rvd::gpu::{AccumulationMs, Gpu};
use crate::rvd::{
    Accumulate, Backend, CancelFlag, CellSums, PassStats, Session, SessionOptions, Strategy, Surface, Tuning,
};

/// `tessera bench`'s options.
#[derive(Args, Debug)]
pub(crate) struct BenchArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Passes of the restricted Voronoi diagram, by phase.
    Rvd(RvdBenchArgs),
}

#[derive(Args, Debug)]
struct RvdBenchArgs {
    /// The surface: .obj, .ply, .stl or .off; a torus if not given.
    #[arg(long, value_name = "FILE")]
    mesh: Option<PathBuf>,
    /// Facets of the torus.
    #[arg(long, value_name = "N", default_value_t = 20_000, conflicts_with = "mesh",
          value_parser = clap::value_parser!(u32).range(1..))]
    facets: u32,
    /// Seeds to draw.
    #[arg(long, value_name = "N", default_value_t = 10_000, value_parser = clap::value_parser!(u32).range(1..))]
    points: u32,
    /// Random seed of the points.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// The seeds, `x y z` a line, instead.
    #[arg(long, value_name = "FILE.xyz", conflicts_with = "points")]
    seeds: Option<PathBuf>,
    /// Lloyd steps before anything is timed.
    #[arg(long, value_name = "N", default_value_t = 20)]
    relax: u32,
    /// Lloyd steps that are timed, and passes of each way of adding.
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..))]
    iterations: u32,
    /// Who works.
    #[command(flatten)]
    backend: BackendArgs,
    /// How a GPU finds the pairs of a facet.
    #[arg(long, value_enum, default_value_t)]
    strategy: StrategyArg,
    /// How a GPU adds pieces to their cells.
    #[arg(long, value_enum, default_value_t)]
    accumulate: AccumulateArg,
    /// Write the figures there, as JSON.
    #[arg(long, value_name = "FILE.json")]
    json: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, Default, ValueEnum)]
enum StrategyArg {
    /// Across bisectors, from each facet's first cell.
    #[default]
    Facet,
    /// Each cell looks for its facets.
    Cell,
    /// By cell where a facet is expected to meet more than 20 cells.
    Auto,
}

#[derive(Clone, Copy, Debug, Default, ValueEnum)]
enum AccumulateArg {
    /// Atomics to global memory.
    Direct,
    /// Partial sums of a workgroup first.
    TwoPhase,
    /// What measured better.
    #[default]
    Auto,
}

/// Runs it.
pub(crate) fn run(args: &BenchArgs) -> Result<()> {
    match &args.what {
        What::Rvd(args) => rvd(args),
    }
}

fn rvd(args: &RvdBenchArgs) -> Result<()> {
    args.backend.check()?;
    args.json.iter().try_for_each(|path| files::check_output(path, &[]))?;
    let (name, mesh) = match &args.mesh {
        Some(path) => (path.file_stem().unwrap_or_default().to_string_lossy().into_owned(), files::read_mesh(path)?),
        None => ("torus".to_owned(), Shape::Torus.build(args.facets as usize)),
    };
    let seeds = match &args.seeds {
        Some(path) => Seeds::Given(files::read_points(path)?),
        None => Seeds::Sample { points: args.points as usize, seed: args.seed },
    };
    let cancel = CancelFlag::default();
    interrupt::cancel_on_signal(&cancel).context("cannot listen for signals")?;
    let (backend, gpu) = open(&args.backend)?;
    let Prepared { surface, seeds, .. } = Prepared::new(Input {
        mesh,
        density: DensityOptions::default(),
        seeds,
        creases: Vec::new(),
        attributes: None,
    })?;
    let mut seeds: Vec<DVec3> = seeds.iter().map(|&p| surface.frame().to_unit(p)).collect();
    let options = SessionOptions { tuning: tuning(args), ..SessionOptions::new(seeds.len()) };
    let mut session = backend.session(Arc::clone(&surface), options)?;
    for _ in 0..args.relax {
        step(session.as_mut(), &mut seeds, &cancel)?;
    }
    let mut steps = Vec::new();
    for _ in 0..args.iterations {
        steps.push(step(session.as_mut(), &mut seeds, &cancel)?);
    }
    drop(session);
    let adding = match &gpu {
        Some(gpu) => {
            Some(gpu.measure_accumulation(Arc::clone(&surface), &seeds, options, args.iterations as usize, &cancel)?)
        }
        None => None,
    };
    let case = Case { name, surface, points: seeds.len(), steps, adding, tuning: options.tuning };
    case.print(args, backend.as_ref());
    if let Some(path) = &args.json {
        let report = json!({
            "backend": backend.kind().name(),
            "adapter": backend.adapter(),
            "threads": backend.threads(),
            "cases": [case.json(args)],
        });
        files::write_json(path, &report)?;
    }
    Ok(())
}

/// A backend, and itself once more if it is the GPU's.
type Opened = (Arc<dyn Backend>, Option<Arc<Gpu>>);

fn open(args: &BackendArgs) -> Result<Opened> {
    if matches!(args.backend, BackendArg::Auto | BackendArg::Gpu)
        && let Ok(gpu) = backends::open_gpu(args)
    {
        let backend: Arc<dyn Backend> = Arc::clone(&gpu) as Arc<dyn Backend>;
        return Ok((backend, Some(gpu)));
    }
    // Says why not, if only a GPU will do.
    Ok((backends::one(args)?, None))
}

fn tuning(args: &RvdBenchArgs) -> Tuning {
    Tuning {
        strategy: match args.strategy {
            StrategyArg::Facet => Strategy::Facet,
            StrategyArg::Cell => Strategy::Cell,
            StrategyArg::Auto => Strategy::Auto,
        },
        accumulate: match args.accumulate {
            AccumulateArg::Direct => Accumulate::Direct,
            AccumulateArg::TwoPhase => Accumulate::TwoPhase,
            AccumulateArg::Auto => Accumulate::Auto,
        },
    }
}

/// One Lloyd step: its whole time and what its pass did.
struct Step {
    ms: f64,
    stats: PassStats,
}

fn step(session: &mut dyn Session, seeds: &mut [DVec3], cancel: &CancelFlag) -> Result<Step> {
    let mut sums = CellSums::default();
    let begin = Instant::now();
    session.set_seeds(seeds)?;
    let mut stats = session.sums(&mut sums, cancel)?;
    let update = Instant::now();
    for (i, seed) in seeds.iter_mut().enumerate() {
        *seed = sums.centroid(i, *seed);
    }
    stats.update_ms += update.elapsed().as_secs_f64() * 1e3;
    Ok(Step { ms: begin.elapsed().as_secs_f64() * 1e3, stats })
}

struct Case {
    name: String,
    surface: Arc<Surface>,
    points: usize,
    steps: Vec<Step>,
    adding: Option<AccumulationMs>,
    tuning: Tuning,
}

/// Least, middle and most.
struct Spread([f64; 3]);

impl Spread {
    fn of(values: impl Iterator<Item = f64>) -> Self {
        let mut sorted: Vec<f64> = values.collect();
        sorted.sort_unstable_by(f64::total_cmp);
        let at = |k: usize| sorted.get(k).copied().unwrap_or(0.0);
        Self([at(0), at(sorted.len() / 2), at(sorted.len().saturating_sub(1))])
    }

    fn json(&self) -> Value {
        json!({ "min": self.0[0], "median": self.0[1], "max": self.0[2] })
    }
}

impl Case {
    fn phases(&self) -> [(&'static str, Spread); 4] {
        let of = |phase: fn(&PassStats) -> f64| Spread::of(self.steps.iter().map(|s| phase(&s.stats)));
        [
            ("neighbours", of(|s| s.neighbours_ms)),
            ("start", of(|s| s.start_ms)),
            ("clip", of(|s| s.clip_ms)),
            ("update", of(|s| s.update_ms)),
        ]
    }

    fn total(&self) -> PassStats {
        let mut total = PassStats::default();
        self.steps.iter().for_each(|s| total.add(&s.stats));
        total
    }

    /// (name, times, share of the clip phase that adding takes), by medians.
    fn adding(&self) -> Option<[(&'static str, Spread, f64); 3]> {
        let adding = self.adding.as_ref()?;
        let of = |times: &[f64]| Spread::of(times.iter().copied());
        let without = of(&adding.without).0[1];
        let row = |name, times: &[f64]| {
            let spread = of(times);
            let share = 1.0 - without / spread.0[1];
            (name, spread, share)
        };
        Some([
            row("direct", &adding.direct),
            row("two-phase", &adding.two_phase),
            row("without adding", &adding.without),
        ])
    }

    fn print(&self, args: &RvdBenchArgs, backend: &dyn Backend) {
        println!(
            "{}: {} facets, {} points; {}{}, {} threads; {} iterations after {}",
            self.name,
            self.surface.facets().len(),
            self.points,
            backend.kind().name(),
            backend.adapter().map(|a| format!(" ({a})")).unwrap_or_default(),
            backend.threads(),
            args.iterations,
            args.relax
        );
        let total = self.total();
        println!(
            "{:.1} pairs an iteration, {} relaunched and {} finished in f64 in all",
            total.pairs as f64 / self.steps.len() as f64,
            total.relaunched(),
            total.f64_finished
        );
        println!("{:<16}{:>10}{:>10}{:>10}", "ms", "min", "median", "max");
        let row = |name: &str, s: &Spread| format!("{name:<16}{:>10.3}{:>10.3}{:>10.3}", s.0[0], s.0[1], s.0[2]);
        for (name, spread) in &self.phases() {
            println!("{}", row(name, spread));
        }
        println!("{}", row("iteration", &Spread::of(self.steps.iter().map(|s| s.ms))));
        for (name, spread, share) in self.adding().iter().flatten() {
            println!("{}   {:>5.1} % of it is adding", row(name, spread), share * 100.0);
        }
    }

    fn json(&self, args: &RvdBenchArgs) -> Value {
        let phases = self.phases();
        let by = |value: &dyn Fn(&Spread) -> Value| {
            Value::Object(phases.iter().map(|(name, s)| ((*name).to_owned(), value(s))).collect())
        };
        let total = self.total();
        let adding = self.adding().map(|rows| {
            let [direct, two_phase, without] = rows.map(|(_, s, share)| json!({ "ms": s.json(), "share": share }));
            json!({ "direct": direct, "two_phase": two_phase, "without": without })
        });
        json!({
            "mesh": self.name,
            "facets": self.surface.facets().len(),
            "points": self.points,
            "relax": args.relax,
            "iterations": self.steps.len(),
            "strategy": format!("{:?}", self.tuning.strategy).to_lowercase(),
            "accumulate": match self.tuning.accumulate {
                Accumulate::Direct => "direct",
                Accumulate::TwoPhase => "two-phase",
                Accumulate::Auto => "auto",
            },
            "iteration_ms": Spread::of(self.steps.iter().map(|s| s.ms)).json(),
            "phases_ms": by(&|s| json!(s.0[1])),
            "phases_spread_ms": by(&Spread::json),
            "pairs": total.pairs / self.steps.len().max(1) as u64,
            "relaunched_pairs": total.relaunched(),
            "relaunched_facets": total.relaunched_facets,
            "f64_finished_pairs": total.f64_finished,
            "accumulation": adding,
            "exact": true,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spread_is_least_middle_and_most() {
        assert_eq!(Spread::of([3.0, 1.0, 2.0].into_iter()).0, [1.0, 2.0, 3.0]);
        assert_eq!(Spread::of([5.0].into_iter()).0, [5.0; 3]);
        assert_eq!(Spread::of(std::iter::empty()).0, [0.0; 3]);
    }
}
