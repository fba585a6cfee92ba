//! `tessera bench cvt`: steps of an iteration.
//!
//! Purpose: what a Lloyd step and a quasi-Newton step take, and their evaluations, with one density or two.
//! Invariant: both kinds begin at the same seeds, in every round; what is compared was timed in the same round, as machines
//! change their speed from one minute to the next. Must not know: how a step is taken.

use std::time::Duration;

use anyhow::Result;
use clap::Args;
use serde_json::{Value, json};

use super::args::{RunArgs, SeedsArgs, SurfaceArgs, Worker, by_step, head, ratio, report};
use super::measure::{Load, Spread, Timed};
use crate::given::words;
use crate::remesh::DENSITIES;
use geometry::cvt::StepKind;
use geometry::cvt::density::{DensityOptions, DensitySource};
use geometry::mesh::TriMesh;
use geometry::rvd::PhasesMs;
use picture::chart::{Figure, Series};
pub(super) use server::config::count;

#[derive(Args, Debug)]
pub(super) struct CvtBenchArgs {
    #[command(flatten)]
    surface: SurfaceArgs,
    #[command(flatten)]
    seeds: SeedsArgs,
    #[command(flatten)]
    run: RunArgs,
    /// Times that they are timed, in turn. Ratios are the middle ones of the rounds'.
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = count)]
    rounds: u32,
    /// Compare adaptive seeds of this density with uniform ones: on the surface as it is, and with those facets halved that
    /// are for this density, where it changes fast beside them or they are much longer than the edges it asks for.
    #[arg(long, default_value = "uniform", value_parser = words(DENSITIES))]
    density: DensitySource,
}

/// One density's figures.
struct Measured {
    /// The density, and whose facets.
    name: String,
    load: Load,
    /// Lloyd and quasi-Newton steps, by round.
    rounds: Vec<[Timed; 2]>,
    /// Lloyd and quasi-Newton steps of all rounds.
    all: [Timed; 2],
}

const UNLIMITED: Duration = Duration::MAX;

pub(super) fn run(args: &CvtBenchArgs) -> Result<()> {
    let token = args.run.begin()?;
    let mesh = args.surface.mesh()?;
    let seeds = args.seeds.seeds(&args.run)?;
    let mut worker = args.run.worker()?;
    worker.keep_time()?;
    let load = |name: &str, mesh: (String, TriMesh), density: &DensitySource| -> Result<(String, Load)> {
        let mut load = Load::new(mesh, seeds.clone(), DensityOptions::from_source(density.clone()))?;
        load.relax(&worker, args.run.relax as usize, UNLIMITED, &token)?;
        Ok((name.to_owned(), load))
    };
    let mut loads = vec![load("uniform", mesh.clone(), &DensitySource::Uniform)?];
    if args.density != DensitySource::Uniform {
        let adaptive = load(args.density.name(), mesh.clone(), &args.density)?;
        let is_divided = adaptive.1.surface.facets().len() != mesh.1.facets().len();
        let divided = is_divided.then(|| adaptive.1.mesh()).transpose()?;
        loads.push(adaptive);
        if let Some(divided) = divided {
            loads.push(load("uniform on these facets", (mesh.0, divided), &DensitySource::Uniform)?);
        }
    }
    let time = |load: &Load, kind| load.time(&worker, kind, args.run.iterations as usize, UNLIMITED, &token);
    let mut rounds: Vec<Vec<[Timed; 2]>> = loads.iter().map(|_| Vec::new()).collect();
    for _ in 0..args.rounds {
        for ((_, load), rounds) in loads.iter().zip(&mut rounds) {
            rounds.push([time(load, StepKind::Lloyd)?, time(load, StepKind::Lbfgs)?]);
        }
    }
    let of = |((name, load), rounds): ((String, Load), Vec<[Timed; 2]>)| {
        let all = [StepKind::Lloyd, StepKind::Lbfgs];
        let all = std::array::from_fn(|k| Timed::joined(all[k], rounds.iter().map(|round| &round[k])));
        Measured { name, load, rounds, all }
    };
    let measured: Vec<Measured> = loads.into_iter().zip(rounds).map(of).collect();
    measured.iter().try_for_each(|m| m.print(&worker))?;
    let cases = measured.iter().flat_map(|m| m.all.each_ref().map(|timed| timed.json(&m.load, &worker)));
    let mut report = report(std::slice::from_ref(&worker), cases.collect());
    let evaluations = measured.iter().map(|m| (m.name.clone(), json!(m.evaluation_ratio())));
    report["rounds"] = args.rounds.into();
    report["lbfgs_evaluation_per_lloyd_evaluation"] = evaluations.collect::<serde_json::Map<_, _>>().into();
    // Of these two or three, the second is adaptive.
    for (key, uniform) in [("adaptive_per_uniform", 0), ("adaptive_per_uniform_on_its_facets", 2)] {
        if let (Some(adaptive), Some(uniform)) = (measured.get(1), measured.get(uniform)) {
            report[key] = adaptive.compared_with(uniform)?;
        }
    }
    args.run.output.write(&report, &figure(&measured, &worker))
}

impl Measured {
    /// An evaluation of a quasi-Newton step against one of a Lloyd step.
    fn evaluation_ratio(&self) -> Option<f64> {
        let of = |[lloyd, lbfgs]: &[Timed; 2]| ratio(lbfgs.evaluation_ms().mean, lloyd.evaluation_ms().mean);
        middle(self.rounds.iter().map(of))
    }

    /// How much longer its steps take than those of another, as printed.
    fn compared_with(&self, other: &Self) -> Result<Value> {
        let kinds = ["lloyd", "lbfgs"].into_iter().enumerate().map(|(k, kind)| {
            let of = |ms: fn(&Timed) -> Spread| {
                middle(self.rounds.iter().zip(&other.rounds).map(|(a, b)| ratio(ms(&a[k]).mean, ms(&b[k]).mean)))
            };
            let (step, evaluation) = (of(Timed::step_ms), of(Timed::evaluation_ms));
            let text = |r: Option<f64>| r.map_or("-".to_owned(), |r| format!("{r:.2}"));
            outln!("{} : {}, {kind}: step {}, evaluation {}", self.name, other.name, text(step), text(evaluation))?;
            Ok((kind.to_owned(), json!({ "iteration": step, "evaluation": evaluation })))
        });
        Ok(kinds.collect::<Result<serde_json::Map<_, _>>>()?.into())
    }

    fn print(&self, worker: &Worker) -> Result<()> {
        let Self { name, load, rounds, all: [lloyd, lbfgs] } = self;
        outln!(
            "{}, {}: {} facets{}, {} points; {}; {} steps of each kind in {} rounds after {}; phases by {}",
            load.name,
            name,
            load.facets,
            match load.surface.facets().len() {
                facets if facets == load.facets => String::new(),
                facets => format!(" divided into {facets}"),
            },
            load.seeds.len(),
            worker.describe(),
            lloyd.steps.len(),
            rounds.len(),
            load.relaxed,
            worker.phases_by(),
        )?;
        outln!("{}", head())?;
        for (timed, name) in [(lloyd, "Lloyd"), (lbfgs, "L-BFGS")] {
            outln!("{}", timed.step_ms().row(&format!("{name} step")))?;
            outln!("{}", timed.evaluation_ms().row(&format!("{name} evaluation")))?;
            if worker.phases_by() != "none" {
                for (phase, spread) in &timed.phases() {
                    outln!("{}", spread.row(&format!("  {phase}")))?;
                }
            }
            let per_step = timed.evaluations() as f64 / timed.steps.len().max(1) as f64;
            let fallbacks = match timed.fallbacks() {
                0 => String::new(),
                n => format!(", {n} steps failed and were Lloyd's"),
            };
            outln!("  {per_step:.2} evaluations a step{fallbacks}; E / E_hex ends at {:.4}", timed.energy_ratio)?;
            if worker.gpu.is_some() {
                let most = timed.device();
                let all: u64 = timed.steps.iter().map(|s| s.stats.device_submissions).sum();
                outln!("  {:.2} submissions a step", all as f64 / timed.steps.len().max(1) as f64)?;
                outln!(
                    "  at most {} submissions, {} allocations, {} bytes up and {} bytes back a step",
                    most.device_submissions,
                    most.device_allocations,
                    most.uploaded_bytes,
                    most.read_back_bytes
                )?;
            }
        }
        if let Some(longest) = worker.gpu.as_ref().and_then(|gpu| gpu.longest_passes()) {
            let PhasesMs { neighbours, start, clip, update } = longest;
            outln!(
                "longest passes of the device: neighbours {neighbours:.1} ms, start {start:.1}, clip {clip:.1}, update {update:.1}"
            )?;
        }
        if let Some(ratio) = self.evaluation_ratio() {
            outln!("an evaluation, L-BFGS : Lloyd = {ratio:.3}")?;
        }
        Ok(())
    }
}

/// The middle one of ratios, if all are there.
fn middle(ratios: impl Iterator<Item = Option<f64>>) -> Option<f64> {
    let all: Option<Vec<f64>> = ratios.collect();
    all.filter(|all| !all.is_empty()).map(|all| Spread::of(all.into_iter()).median)
}

fn figure(measured: &[Measured], worker: &Worker) -> Figure {
    let line = |density: &str, timed: &Timed| Series {
        name: format!("{}, {density}", if timed.kind == StepKind::Lloyd { "Lloyd" } else { "L-BFGS" }),
        points: timed.steps.iter().enumerate().map(|(k, s)| (k as f64 + 1.0, s.ms)).collect(),
    };
    let series = measured.iter().flat_map(|m| m.rounds.last().map(|round| round.each_ref().map(|t| line(&m.name, t))));
    let title = measured.first().map(|m| {
        let facets = m.load.facets;
        format!("{}: {facets} facets, {} points", m.load.name, m.load.seeds.len())
    });
    by_step(title.unwrap_or_default(), worker, "step", series.flatten().collect())
}
