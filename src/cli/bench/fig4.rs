//! `tessera bench fig4`: a fixed number of steps.
//!
//! Purpose: time of so many Lloyd steps against a few thousand points (\[HYWZ17\], Figure 4), from random seeds.
//! Invariant: all backends begin at the same seeds. Must not know: how a step is taken.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::Result;
use clap::Args;

use super::measure::{Load, Worker, mesh, token};
use super::output::{OutputArgs, report};
use crate::config::{BackendArgs, count, whole};
use crate::cvt::StepKind;
use crate::cvt::density::DensityOptions;
use crate::mesh::shapes::Shape;
use crate::picture::chart::{Axis, Figure, Panel, Series};
use crate::remesh::Seeds;

/// `tessera bench fig4`'s options.
#[derive(Args, Debug)]
pub(super) struct Fig4Args {
    /// The surface: .obj, .ply, .stl or .off; a torus if not given.
    #[arg(long, value_name = "FILE")]
    mesh: Option<PathBuf>,
    /// Facets of the torus.
    #[arg(long, value_name = "N", default_value_t = 20_000, conflicts_with = "mesh",
          value_parser = count)]
    facets: u32,
    /// Numbers of seeds to draw.
    #[arg(long, value_name = "N,N,...", value_delimiter = ',', value_parser = count,
          default_value = "1000,2000,3000,4000,5000,6000,7000,8000,9000")]
    points: Vec<u32>,
    /// Random seed of the points.
    #[arg(long, value_name = "N", default_value_t = Seeds::RANDOM_SEED, value_parser = whole::<u64>)]
    seed: u64,
    /// Lloyd steps before anything is timed; two more of each backend warm up.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = whole::<u32>)]
    relax: u32,
    /// Lloyd steps that are timed.
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = count)]
    iterations: u32,
    /// Who works: auto measures all that are there.
    #[command(flatten)]
    backend: BackendArgs,
    /// Files to write.
    #[command(flatten)]
    output: OutputArgs,
}

/// Runs it.
pub(super) fn run(args: &Fig4Args) -> Result<()> {
    args.backend.check()?;
    args.output.check()?;
    let mesh = mesh(args.mesh.as_deref(), Shape::Torus, args.facets as usize)?;
    let title = format!("{}, {} facets: {} Lloyd steps", mesh.0, mesh.1.facets().len(), args.iterations);
    let token = token()?;
    let mut workers = Worker::all(&args.backend)?;
    workers.iter_mut().try_for_each(Worker::keep_time)?;
    workers.iter().try_for_each(|worker| outln!("{}", worker.describe()))?;
    outln!("{title}, seconds; milliseconds per step, means")?;
    let heads: String = workers.iter().map(|w| format!("{:>12} s{:>9} ms", w.name(), "")).collect();
    outln!("{:<10}{heads}", "points")?;
    let mut lines = vec![Vec::new(); workers.len()];
    let mut cases = Vec::new();
    for &points in &args.points {
        let seeds = Seeds::Sample { points: points as usize, seed: args.seed };
        let mut load = Load::new(mesh.clone(), seeds, DensityOptions::default())?;
        let mut line = format!("{points:<10}");
        for (k, worker) in workers.iter().enumerate() {
            if k == 0 {
                load.relax(worker, args.relax as usize, Duration::MAX, &token)?;
            }
            let timed = load.time(worker, StepKind::Lloyd, args.iterations as usize, Duration::MAX, &token)?;
            line += &format!("{:>14.3}{:>12.3}", timed.total_ms / 1e3, timed.step_ms().mean);
            lines[k].push((f64::from(points), timed.total_ms / 1e3));
            cases.push(timed.json(&load, worker));
        }
        outln!("{line}")?;
    }
    let series = workers.iter().zip(lines).map(|(worker, points)| Series { name: worker.describe(), points }).collect();
    let panel = Panel {
        title: String::new(),
        x: Axis { label: "points".to_owned(), log: false },
        y: Axis { label: "seconds".to_owned(), log: false },
        series,
        groups: Vec::new(),
    };
    args.output.write(&report(&workers, cases), &Figure { title, panels: vec![panel] })
}
