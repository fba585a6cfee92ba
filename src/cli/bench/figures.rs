//! `tessera bench fig3`, how times grow, and `tessera bench fig4`, a fixed number of steps.
//!
//! Purpose: time against points on one mesh, and against facets with one number of points (\[HYWZ17\], Figure 3), with slopes by
//! decade; time of a fixed number of Lloyd steps against a few thousand points (Figure 4). Invariant: it ends: no case of Figure 3
//! takes much longer than its limit, and a backend that a case was too much for is left out of larger ones. Must not know: how a
//! step is taken, what a baseline does.

use std::time::Duration;

use anyhow::Result;
use clap::Args;
use serde_json::{Value, json};

use super::args::{RunArgs, SurfaceArgs, Worker, report, slopes};
use super::baselines::{self, BaselineArgs};
use super::measure::Load;
use crate::server::number;
use crate::shape::parse_facets;
use geometry::cvt::density::DensityOptions;
use geometry::mesh::TriMesh;
use geometry::mesh::shapes::Shape;
use geometry::token::Token;
use picture::chart::{Axis, Figure, Panel, Series};
use server::config::count;

#[derive(Args, Debug)]
pub(super) struct Fig3Args {
    #[command(flatten)]
    surface: SurfaceArgs,
    /// Points of the times against facets.
    #[arg(long, value_name = "N", default_value_t = 10_000, value_parser = count)]
    points: u32,
    /// The most points: 20, 50, 100, 200 and so on up to it.
    #[arg(long, value_name = "N", default_value_t = 1_000_000, value_parser = count)]
    max_points: u32,
    /// The most facets: 3000, 6000, 12000, 25000, 50000, 100000 and so on up to it, of a torus.
    #[arg(long, value_name = "N", default_value_t = 100_000,
          value_parser = facet_count)]
    max_facets: u32,
    /// Seconds for one case of one backend. When they are over, three steps are enough, and the backend is left out
    /// of larger cases.
    #[arg(long, value_name = "S", default_value_t = 10.0, value_parser = seconds)]
    time_limit: f64,
    #[command(flatten)]
    run: RunArgs,
}

fn seconds(text: &str) -> Result<f64, String> {
    number(text, 0.001..=86_400.0, "seconds from 0.001 to 86400 are needed")
}

/// One of the two curves.
struct Sweep {
    /// "points" or "facets".
    over: &'static str,
    title: String,
    /// By worker: (count, mean milliseconds).
    lines: Vec<Vec<(f64, f64)>>,
    cases: Vec<Value>,
    left_out: Vec<Value>,
}

pub(super) fn fig3(args: &Fig3Args) -> Result<()> {
    let token = args.run.begin()?;
    let fixed = args.surface.mesh()?;
    let workers = args.run.workers()?;
    let runner = Runner { args, workers: &workers, token: &token };
    let title = format!("{}, {} facets", fixed.0, fixed.1.facets().len());
    let points = counts(&[20, 50, 100, 200, 500], 10, args.max_points);
    let by_points = runner.sweep("points", title, &points, |n| (fixed.clone(), n))?;
    drop(fixed);
    let facets = counts(&[3_000, 6_000, 12_000, 25_000, 50_000, 100_000], 2, args.max_facets);
    let title = format!("torus, {} points", args.points);
    let by_facets = runner
        .sweep("facets", title, &facets, |n| (("torus".to_owned(), Shape::Torus.build(n as usize)), args.points))?;
    let sweeps = [by_points, by_facets];
    let slopes: Vec<Value> = sweeps.iter().flat_map(|sweep| sweep.slopes(&workers)).collect();
    let mut report = report(&workers, sweeps.iter().flat_map(|s| s.cases.clone()).collect());
    report["slopes"] = slopes.into();
    report["left_out"] = sweeps.iter().flat_map(|s| s.left_out.clone()).collect::<Vec<_>>().into();
    args.run.output.write(&report, &figure(&sweeps, &workers))
}

fn facet_count(text: &str) -> Result<u32, String> {
    parse_facets(text).map(|facets| facets as u32)
}

/// The `first`, and the last of them or the pattern of the first ones times `factor` and so on, up to `most`, which is the last.
fn counts(first: &[u32], factor: u32, most: u32) -> Vec<u32> {
    let mut all: Vec<u64> = first.iter().map(|&n| u64::from(n)).collect();
    // With a factor of 10 the pattern is that of one decade, with 2 only the last number goes on.
    let step = if factor == 10 { 3 } else { 1 };
    while all.last().is_some_and(|&n| n < u64::from(most)) {
        all.push(all[all.len() - step] * u64::from(factor));
    }
    let mut all: Vec<u32> = all.into_iter().filter(|&n| n < u64::from(most)).map(|n| n as u32).collect();
    all.push(most);
    all
}

struct Runner<'a> {
    args: &'a Fig3Args,
    workers: &'a [Worker],
    token: &'a Token,
}

impl Runner<'_> {
    fn sweep(
        &self,
        over: &'static str,
        title: String,
        counts: &[u32],
        case: impl Fn(u32) -> ((String, TriMesh), u32),
    ) -> Result<Sweep> {
        let (args, workers) = (self.args, self.workers);
        let limit = Duration::from_secs_f64(args.time_limit);
        let mut lines = vec![Vec::new(); workers.len()];
        let (mut cases, mut left_out) = (Vec::new(), Vec::new());
        let mut able = vec![true; workers.len()];
        outln!("{title}: milliseconds per Lloyd step, means")?;
        let heads: String = workers.iter().map(|w| format!("{:>14}", w.name())).collect();
        outln!("{over:<12}{heads}")?;
        for &n in counts {
            if !able.contains(&true) {
                left_out.extend(workers.iter().map(|w| json!({ "backend": w.name(), "over": over, over: n })));
                continue;
            }
            let (mesh, points) = case(n);
            let seeds = args.run.drawn(points);
            let mut load = Load::new(mesh, seeds, DensityOptions::default())?;
            let at_work = workers.iter().zip(&able).filter(|(_, able)| **able).map(|(worker, _)| worker);
            let mut times = load.time_all(at_work, &args.run, limit, self.token)?.into_iter();
            let count = if over == "points" { load.seeds.len() } else { load.facets };
            let mut line = format!("{count:<12}");
            for (k, worker) in workers.iter().enumerate() {
                let Some(timed) = able[k].then(|| times.next()).flatten() else {
                    line += &format!("{:>14}", "-");
                    left_out.push(json!({ "backend": worker.name(), "over": over, over: count }));
                    continue;
                };
                able[k] = !timed.cut;
                let ms = timed.step_ms().mean;
                line += &format!("{ms:>14.3}");
                lines[k].push((count as f64, ms));
                let mut case = timed.json(&load, worker);
                case["over"] = over.into();
                cases.push(case);
            }
            outln!("{line}")?;
        }
        let sweep = Sweep { over, title, lines, cases, left_out };
        sweep.print_slopes(workers)?;
        Ok(sweep)
    }
}

impl Sweep {
    fn print_slopes(&self, workers: &[Worker]) -> Result<()> {
        for (worker, line) in workers.iter().zip(&self.lines) {
            let slopes: Vec<String> =
                slopes(line).iter().map(|(from, to, slope)| format!("{slope:.2} from {from} to {to}")).collect();
            if !slopes.is_empty() {
                outln!("slope of log time over log {}, {}: {}", self.over, worker.name(), slopes.join(", "))?;
            }
        }
        if !self.left_out.is_empty() {
            outln!("{} cases are left out: the one before took longer than --time-limit", self.left_out.len())?;
        }
        Ok(())
    }

    fn slopes(&self, workers: &[Worker]) -> Vec<Value> {
        let of = |(worker, line): (&Worker, &Vec<(f64, f64)>)| {
            let (backend, over) = (worker.name(), self.over);
            let all = slopes(line).into_iter();
            all.map(
                |(from, to, slope)| json!({ "backend": backend, "over": over, "from": from, "to": to, "slope": slope }),
            )
            .collect::<Vec<_>>()
        };
        workers.iter().zip(&self.lines).flat_map(of).collect()
    }
}

fn figure(sweeps: &[Sweep], workers: &[Worker]) -> Figure {
    let panel = |sweep: &Sweep| {
        let line =
            |(worker, points): (&Worker, &Vec<(f64, f64)>)| Series { name: worker.describe(), points: points.clone() };
        Panel {
            title: sweep.title.clone(),
            x: Axis::log(sweep.over),
            y: Axis::log("ms per Lloyd step"),
            series: workers.iter().zip(&sweep.lines).map(line).collect(),
            ..Panel::default()
        }
    };
    Figure { title: "How times grow".to_owned(), panels: sweeps.iter().map(panel).collect() }
}

#[derive(Args, Debug)]
#[command(mut_arg("relax", |arg| arg.default_value("0")), mut_arg("iterations", |arg| arg.default_value("100")))]
pub(super) struct Fig4Args {
    #[command(flatten)]
    surface: SurfaceArgs,
    /// Numbers of seeds to draw.
    #[arg(long, value_name = "N,N,...", value_delimiter = ',', value_parser = count,
          default_value = "1000,2000,3000,4000,5000,6000,7000,8000,9000")]
    points: Vec<u32>,
    #[command(flatten)]
    baselines: BaselineArgs,
    #[command(flatten)]
    run: RunArgs,
}

pub(super) fn fig4(args: &Fig4Args) -> Result<()> {
    let token = args.run.begin()?;
    let mesh = args.surface.mesh()?;
    let title = format!("{}, {} facets: {} Lloyd steps", mesh.0, mesh.1.facets().len(), args.run.iterations);
    let workers = args.run.workers()?;
    outln!("{title}, seconds; milliseconds per step, means")?;
    let heads: String = workers.iter().map(|w| format!("{:>12} s{:>9} ms", w.name(), "")).collect();
    outln!("{:<10}{heads}", "points")?;
    let mut lines = vec![Vec::new(); workers.len()];
    let (mut cases, mut rows) = (Vec::new(), Vec::new());
    let mut of_baselines: Vec<Series> = Vec::new();
    for &points in &args.points {
        let seeds = args.run.drawn(points);
        let mut load = Load::new(mesh.clone(), seeds, DensityOptions::default())?;
        let mut line = format!("{points:<10}");
        let times = load.time_all(&workers, &args.run, Duration::MAX, &token)?;
        for (k, (worker, timed)) in workers.iter().zip(&times).enumerate() {
            line += &format!("{:>14.3}{:>12.3}", timed.total_ms / 1e3, timed.step_ms().mean);
            lines[k].push((f64::from(points), timed.total_ms / 1e3));
            cases.push(timed.json(&load, worker));
        }
        outln!("{line}")?;
        if !args.baselines.is_empty() {
            outln!("{}", baselines::head())?;
            for row in args.baselines.measure(&load, &workers, times, args.run.iterations as usize, &token)? {
                outln!("{}", row.line())?;
                rows.push(row.json(&load));
                let Some(at) = row.at().filter(|_| row.method != baselines::EXACT) else { continue };
                match of_baselines.iter_mut().find(|series| series.name == row.method) {
                    Some(series) => series.points.push(at),
                    None => of_baselines.push(Series { name: row.method.to_owned(), points: vec![at] }),
                }
            }
        }
    }
    let exact = workers.iter().zip(lines).map(|(worker, points)| Series { name: worker.describe(), points });
    // Baselines take many times as long, or as short.
    let y = if of_baselines.is_empty() { Axis::linear("seconds") } else { Axis::log("seconds") };
    let series = exact.chain(of_baselines).collect();
    let panel = Panel { x: Axis::linear("points"), y, series, ..Panel::default() };
    let mut report = report(&workers, cases);
    if !args.baselines.is_empty() {
        report["baseline_options"] = args.baselines.json();
        report["baselines"] = rows.into();
    }
    args.run.output.write(&report, &Figure { title, panels: vec![panel] })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_go_up_to_the_most() {
        let points = |most| counts(&[20, 50, 100, 200, 500], 10, most);
        assert_eq!(points(1_000_000).len(), 15);
        assert_eq!(points(1_000_000)[12..], [200_000, 500_000, 1_000_000]);
        assert_eq!(points(100), [20, 50, 100]);
        assert_eq!(points(130), [20, 50, 100, 130]);
        assert_eq!(points(7), [7]);
        let facets = |most| counts(&[3_000, 6_000, 12_000, 25_000, 50_000, 100_000], 2, most);
        assert_eq!(facets(100_000), [3_000, 6_000, 12_000, 25_000, 50_000, 100_000]);
        assert_eq!(facets(300_000)[5..], [100_000, 200_000, 300_000]);
        assert_eq!(*points(u32::MAX).last().unwrap(), u32::MAX);
    }
}
