//! `tessera bench fig4`: a fixed number of steps.
//!
//! Purpose: time of a fixed number of Lloyd steps against a few thousand points (\[HYWZ17\], Figure 4), from random seeds.
//! Invariant: all backends begin at the same seeds. Must not know: how a step is taken.

use std::time::Duration;

use anyhow::Result;
use clap::Args;

use super::args::{RunArgs, SurfaceArgs, report};
use super::measure::Load;
use geometry::cvt::density::DensityOptions;
use picture::chart::{Axis, Figure, Panel, Series};
use server::config::count;

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
    run: RunArgs,
}

pub(super) fn run(args: &Fig4Args) -> Result<()> {
    let token = args.run.begin()?;
    let mesh = args.surface.mesh()?;
    let title = format!("{}, {} facets: {} Lloyd steps", mesh.0, mesh.1.facets().len(), args.run.iterations);
    let workers = args.run.workers()?;
    outln!("{title}, seconds; milliseconds per step, means")?;
    let heads: String = workers.iter().map(|w| format!("{:>12} s{:>9} ms", w.name(), "")).collect();
    outln!("{:<10}{heads}", "points")?;
    let mut lines = vec![Vec::new(); workers.len()];
    let mut cases = Vec::new();
    for &points in &args.points {
        let seeds = args.run.drawn(points);
        let mut load = Load::new(mesh.clone(), seeds, DensityOptions::default())?;
        let mut line = format!("{points:<10}");
        let times = load.time_all(&workers, &args.run, Duration::MAX, &token)?;
        for (k, (worker, timed)) in workers.iter().zip(times).enumerate() {
            line += &format!("{:>14.3}{:>12.3}", timed.total_ms / 1e3, timed.step_ms().mean);
            lines[k].push((f64::from(points), timed.total_ms / 1e3));
            cases.push(timed.json(&load, worker));
        }
        outln!("{line}")?;
    }
    let series = workers.iter().zip(lines).map(|(worker, points)| Series { name: worker.describe(), points }).collect();
    let panel = Panel { x: Axis::linear("points"), y: Axis::linear("seconds"), series, ..Panel::default() };
    args.run.output.write(&report(&workers, cases), &Figure { title, panels: vec![panel] })
}
