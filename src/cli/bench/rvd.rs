//! `tessera bench rvd`: passes of a diagram.
//!
//! Purpose: times of the passes by phase, seeds in and sums out, and for a GPU what each way of adding costs.
//! Invariant: what is timed is the exact diagram, every pass of it. Must not know: how a phase is done.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

use anyhow::Result;
use clap::Args;
use glam::DVec3;
use serde_json::{Value, json};

use super::args::{RunArgs, SeedsArgs, SurfaceArgs, Worker, by_step, head, report};
use super::measure::Spread;
use crate::given::{Words, words};
use geometry::cvt::density::DensityOptions;
use geometry::rvd::{Accumulate, CellSums, DeviceWork, PassStats, Session, SessionOptions, Strategy, Surface, Tuning};
use geometry::token::Token;
use gpu::diagram::{AccumulationMs, Gpu};
use jobs::executor::prepared::{Input, Prepared};
use picture::chart::{Figure, Series};

#[derive(Args, Debug)]
pub(super) struct RvdBenchArgs {
    #[command(flatten)]
    surface: SurfaceArgs,
    #[command(flatten)]
    seeds: SeedsArgs,
    #[command(flatten)]
    run: RunArgs,
    /// How a GPU finds the pairs of a facet.
    #[arg(long, default_value = "facet", value_parser = words(STRATEGIES))]
    strategy: Strategy,
    /// How a GPU adds pieces to their cells.
    #[arg(long, default_value = "auto", value_parser = words(WAYS_OF_ADDING))]
    accumulate: Accumulate,
}

const STRATEGIES: Words<Strategy> = &[
    ("facet", "Across bisectors, from each facet's first cell", Strategy::Facet),
    ("cell", "Each cell looks for its facets", Strategy::Cell),
    ("auto", "By cell where a facet is expected to meet more than 20 cells", Strategy::Auto),
];
const WAYS_OF_ADDING: Words<Accumulate> = &[
    ("direct", "Atomics to global memory", Accumulate::Direct),
    ("two-phase", "Partial sums of a workgroup first", Accumulate::TwoPhase),
    ("auto", "What measured better", Accumulate::Auto),
];

pub(super) fn run(args: &RvdBenchArgs) -> Result<()> {
    let token = args.run.begin()?;
    let (name, mesh) = args.surface.mesh()?;
    let (seeds, density) = (args.seeds.seeds(&args.run)?, DensityOptions::default());
    let worker = args.run.worker()?;
    let input = Input { mesh, density, seeds, creases: Vec::new(), attributes: None };
    let Prepared { surface, seeds, .. } = Prepared::new(input, &Token::default())?;
    let mut seeds: Vec<DVec3> = seeds.iter().map(|&p| surface.frame().to_unit(p)).collect();
    let tuning = Tuning { strategy: args.strategy, accumulate: args.accumulate, ..Tuning::default() };
    let options = SessionOptions { tuning, ..SessionOptions::new(seeds.len()) };
    let mut session = worker.backend.session(Arc::clone(&surface), options)?;
    for _ in 0..args.run.relax {
        step(session.as_mut(), &mut seeds, &token)?;
    }
    let timed = (0..args.run.iterations).map(|_| step(session.as_mut(), &mut seeds, &token));
    let steps = timed.collect::<Result<Vec<_>>>()?;
    drop(session);
    let iterations = args.run.iterations as usize;
    let adding = |gpu: &Arc<Gpu>| gpu.measure_accumulation(Arc::clone(&surface), &seeds, options, iterations, &token);
    let adding = worker.gpu.as_ref().map(adding).transpose()?;
    let case = Case { name, surface, points: seeds.len(), steps, adding };
    case.print(args, &worker)?;
    args.run.output.write(&report(std::slice::from_ref(&worker), vec![case.json(args)]), &case.figure(&worker))
}

/// As the command line has it.
fn name<T: PartialEq>(words: Words<T>, value: &T) -> Option<&'static str> {
    words.iter().find(|(.., known)| known == value).map(|(word, ..)| *word)
}

/// One Lloyd step: its whole time and what its pass did.
struct Step {
    ms: f64,
    stats: PassStats,
}

fn step(session: &mut dyn Session, seeds: &mut [DVec3], token: &Token) -> Result<Step> {
    let mut sums = CellSums::default();
    let begin = Instant::now();
    session.set_seeds(seeds)?;
    let mut stats = session.sums(&mut sums, token)?;
    let update = Instant::now();
    for (i, seed) in seeds.iter_mut().enumerate() {
        *seed = sums.centroid(i, *seed);
    }
    stats.update_ms += update.elapsed().as_secs_f64() * 1e3;
    Ok(Step { ms: begin.elapsed().as_secs_f64() * 1e3, stats })
}

/// Name of a phase and its milliseconds.
type Phase = (&'static str, fn(&PassStats) -> f64);

const PHASES: [Phase; 4] = [
    ("neighbours", |s| s.neighbours_ms),
    ("start", |s| s.start_ms),
    ("clip", |s| s.clip_ms),
    ("update", |s| s.update_ms),
];

struct Case {
    name: String,
    surface: Arc<Surface>,
    points: usize,
    steps: Vec<Step>,
    adding: Option<AccumulationMs>,
}

impl Case {
    fn phases(&self) -> [(&'static str, Spread); 4] {
        PHASES.map(|(name, of)| (name, Spread::of(self.steps.iter().map(|s| of(&s.stats)))))
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
        let without = of(&adding.without).median;
        let row = |name, times: &[f64]| {
            let spread = of(times);
            let share = 1.0 - without / spread.median;
            (name, spread, share)
        };
        Some([
            row("direct", &adding.direct),
            row("two-phase", &adding.two_phase),
            row("without adding", &adding.without),
        ])
    }

    fn print(&self, args: &RvdBenchArgs, worker: &Worker) -> Result<()> {
        let (Self { name, points, .. }, RunArgs { iterations, relax, .. }) = (self, &args.run);
        let (facets, by) = (self.surface.facets().len(), worker.describe());
        outln!("{name}: {facets} facets, {points} points; {by}; {iterations} iterations after {relax}")?;
        let total = self.total();
        let pairs = total.pairs as f64 / self.steps.len() as f64;
        let (again, ended) = (total.relaunched(), total.f64_finished);
        outln!("{pairs:.1} pairs an iteration, {again} relaunched and {ended} finished in f64 in all")?;
        outln!("{}", head())?;
        for (name, spread) in &self.phases() {
            outln!("{}", spread.row(name))?;
        }
        outln!("{}", Spread::of(self.steps.iter().map(|s| s.ms)).row("iteration"))?;
        for (name, spread, share) in self.adding().iter().flatten() {
            outln!("{}   {:>5.1} % of it is adding", spread.row(name), share * 100.0)?;
        }
        Ok(())
    }

    fn figure(&self, worker: &Worker) -> Figure {
        let line = |name: &str, of: &dyn Fn(&Step) -> f64| Series {
            name: name.to_owned(),
            points: self.steps.iter().enumerate().map(|(k, s)| (k as f64 + 1.0, of(s))).collect(),
        };
        let mut series = vec![line("iteration", &|s| s.ms)];
        series.extend(PHASES.map(|(name, of)| line(name, &|s| of(&s.stats))));
        let title = format!("{}: {} facets, {} points", self.name, self.surface.facets().len(), self.points);
        by_step(title, worker, "iteration", series)
    }

    fn json(&self, args: &RvdBenchArgs) -> Value {
        let phases = self.phases();
        let means: BTreeMap<_, _> = phases.iter().map(|(name, spread)| (name, spread.mean)).collect();
        let spreads: BTreeMap<_, _> = phases.into_iter().collect();
        let total = self.total();
        let adding = self.adding().map(|rows| {
            let [direct, two_phase, without] = rows.map(|(_, s, share)| json!({ "ms": s, "share": share }));
            json!({ "direct": direct, "two_phase": two_phase, "without": without })
        });
        json!({
            "mesh": self.name,
            "facets": self.surface.facets().len(),
            "points": self.points,
            "relax": args.run.relax,
            "iterations": self.steps.len(),
            "strategy": name(STRATEGIES, &args.strategy),
            "accumulate": name(WAYS_OF_ADDING, &args.accumulate),
            "iteration_ms": Spread::of(self.steps.iter().map(|s| s.ms)),
            "phases_ms": means,
            "phases_spread_ms": spreads,
            "pairs": total.pairs / self.steps.len().max(1) as u64,
            "relaunched_pairs": total.relaunched(),
            "relaunched_facets": total.relaunched_facets,
            "f64_finished_pairs": total.f64_finished,
            "device_most": self.steps.iter().fold(DeviceWork::default(), |most, s| {
                most.with(&s.stats.device, u64::max)
            }),
            "accumulation": adding,
            "exact": true,
        })
    }
}
