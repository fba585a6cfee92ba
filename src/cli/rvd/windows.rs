//! `tessera rvd --memory-mib`: a surface larger than memory, read in windows.
//!
//! Purpose: plans the memory, prints the plan, and computes the sums of the cells window by window. Invariant: nothing is allocated
//! for the surface or the seeds before the plan is printed. Must not know: how windows are read.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, Result};
use clap::Args;
use glam::DVec3;
use serde_json::{Value, json};

use super::RvdArgs;
use crate::exit::{BadInput, NoInput, Usage};
use crate::progress::{Plan as Stages, Progress};
use crate::remesh::ms;
use crate::{files, interrupt, say};
use geometry::mesh::io::lists;
use geometry::mesh::out_of_core::{MeshFile, MeshFileError, Scratch};
use geometry::remesh::Seeds;
use geometry::remesh::report::{RvdFigures, to_json};
use geometry::rvd::out_of_core::{FacetFile, OutOfCoreError, Plan, Wanted};
use geometry::rvd::{Capacities, CellSums, Evaluation, Parallel, RvdError, Session, SessionOptions};
use geometry::token::Token;
use jobs::memory;
use server::config::{BackendArg, whole};

#[derive(Args, Debug)]
#[command(next_help_heading = "Large surfaces")]
pub(super) struct WindowArgs {
    /// Read the surface in windows, so that this process takes at most so much memory, in MiB. The file is binary .ply or .stl; there are
    /// sums and centroids, and no pieces (docs/large-surfaces.md).
    #[arg(long, value_name = "N", value_parser = whole::<u64>)]
    pub(super) memory_mib: Option<u64>,
    /// Folder for scratch files, which take up to ten times the file; the plan says how much. Not one in memory. The system's folder for
    /// temporary files if not given.
    #[arg(long, value_name = "DIR", requires = "memory_mib")]
    scratch: Option<std::path::PathBuf>,
}

/// Refuses what a surface in windows has not.
pub(super) fn check(args: &RvdArgs) -> Result<()> {
    if args.windows.memory_mib.is_none() {
        return Ok(());
    }
    let refuse = |option: &str, why: &str| Err(Usage(format!("{option} with --memory-mib: {why}")).into());
    if args.files.output.is_some() {
        return refuse("--output", "a surface that is read in windows has sums and no pieces; write --centroids");
    }
    if args.picture.picture.is_some() {
        return refuse("--picture", "a surface that is read in windows has sums and no pieces");
    }
    if args.at.endpoint.is_some() {
        return refuse("--endpoint", "windows are read on this machine; send a smaller surface, or leave one out");
    }
    if matches!(args.backend.backend, BackendArg::Gpu | BackendArg::Serial) {
        return refuse("--backend", "windows are read by the backend `parallel`");
    }
    if args.input.as_os_str() == "-" {
        return refuse("-", "windows are read from a file");
    }
    Ok(())
}

/// The diagram of a surface in windows.
pub(super) fn run(args: &RvdArgs, limit_mib: u64) -> Result<()> {
    let start = Instant::now();
    let token = Token::default();
    interrupt::cancel_on_signal(&token).context("cannot listen for signals")?;
    let format = files::Surface::new(&args.input, args.input_format).format(files::INPUT_FORMAT)?;
    let source = MeshFile::open(&args.input, format).map_err(|error| refused(args, error.into()))?;
    let (count, seed) = match (&args.seeds.seeds, args.seeds.asked()?.1) {
        (Some(path), _) => (count_points(path)?, None),
        (None, Seeds::Sample { points, seed }) => (points, Some(seed)),
        _ => return Err(Usage("--points in percent with --memory-mib: give a number".to_owned()).into()),
    };
    let threads = rayon::current_num_threads();
    let wanted = Wanted {
        seeds: count,
        drawn: seed.is_some(),
        moves: args.lloyd > 0,
        neighbours: Capacities::default().neighbours,
        threads,
        limit_bytes: limit_mib.saturating_mul(1 << 20),
    };
    let plan = Plan::new(&source, &wanted).map_err(|error| refused(args, error))?;
    if args.say.summary() {
        tell(&plan)?;
    }
    let progress = Progress::begin(&args.input, args.say.quiet);
    progress.plan(Stages::rvd(source.facets(), count * (1 + args.lloyd as usize), false));
    progress.stage("prepare", 0, 0);
    let temporary = std::env::temp_dir();
    let scratch = Scratch::new(args.windows.scratch.as_deref().unwrap_or(&temporary));
    let facets = FacetFile::new(source, &plan, &scratch, &token).map_err(|error| refused(args, error))?;
    let prepare_ms = ms(start);
    let sampling = Instant::now();
    let mut seeds = match (&args.seeds.seeds, seed) {
        (Some(path), _) => read_points(path, count)?,
        (None, seed) => facets.sample(count, seed.unwrap_or_default(), &token).map_err(|error| refused(args, error))?,
    };
    seeds.iter_mut().for_each(|p| *p = facets.frame().to_unit(*p));
    let sample_ms = ms(sampling);
    let facets = Arc::new(facets);
    let computing = Instant::now();
    let backend = Parallel::new(Some(threads))?;
    let mut session = backend.windowed_session(Arc::clone(&facets), SessionOptions::new(count));
    session.set_seeds(&seeds)?;
    let mut figures = RvdFigures::default();
    let mut steps = Vec::new();
    for step in 0..args.lloyd {
        let evaluation = lloyd(&mut *session, &token)?;
        figures.add_pass(&evaluation.stats);
        let ratio = evaluation.energy / facets.hexagonal_energy(count);
        progress.iteration(u64::from(step), u64::from(args.lloyd), ratio);
        steps.push(iteration(&evaluation, ratio, facets.frame().scale));
    }
    if args.lloyd > 0 {
        resident(&mut *session)?.read(&mut seeds)?;
        session.set_seeds(&seeds)?;
        // As seeds in the caller's coordinates are.
        seeds.iter_mut().for_each(|p| *p = facets.frame().to_unit(facets.frame().to_world(*p)));
    }
    progress.stage("diagram", 0, 0);
    let mut sums = CellSums::default();
    let stats = session.sums(&mut sums, &token)?;
    figures.add_pass(&stats);
    figures.pairs = stats.pairs;
    let square = facets.frame().scale * facets.frame().scale;
    figures.area = sums.area.iter().map(|area| area / square).sum();
    figures.empty_cells = sums.area.iter().filter(|area| **area <= 0.0).count();
    let compute_ms = ms(computing);
    let writing = Instant::now();
    progress.stage("write", 0, 0);
    if let Some(path) = &args.files.centroids {
        seeds.iter_mut().enumerate().for_each(|(i, p)| *p = facets.frame().to_world(sums.centroid(i, *p)));
        files::write_points(path, &seeds)?;
    }
    let report = json!({
        "backend": "parallel", "adapter": null, "threads": threads, "seed": seed, "seeds": count, "converged": false,
        "input": {
            "vertices": facets.vertices(), "facets": facets.facets(), "degenerate_facets": facets.degenerate_facets(),
            "area": facets.world_area(),
        },
        "rvd": to_json(&figures)?,
        "energy_ratio": sums.energy.iter().sum::<f64>() / facets.hexagonal_energy(count),
        "iterations": steps,
        "timings_ms": {
            "prepare": prepare_ms, "sample": sample_ms, "iterations": compute_ms, "write": ms(writing), "total": ms(start),
        },
        "memory": { "host_peak_bytes": memory::peak_memory_bytes(), "device_bytes": 0, "plan": to_json(&plan)? },
    });
    if let Some(path) = &args.files.report {
        files::write_json(path, &report)?;
    }
    drop(progress);
    if args.say.json {
        say::json(&report)?;
    }
    if args.say.summary() {
        super::summary(args, &report, ms(start))?;
        if let Some(peak) = memory::peak_memory_bytes() {
            outln!("memory: {} MiB at the peak, {} planned", peak >> 20, plan.total_bytes >> 20)?;
        }
    }
    Ok(())
}

fn tell(plan: &Plan) -> Result<()> {
    let mib = |bytes: u64| bytes.div_ceil(1 << 20);
    outln!(
        "plan: {} MiB of {}: program {}; then {} to prepare, or seeds {} (their index {} more), rows {}, sums {} and a window {}",
        mib(plan.total_bytes),
        mib(plan.limit_bytes),
        mib(plan.program_bytes),
        mib(plan.prepare_bytes),
        mib(plan.seed_bytes),
        mib(plan.indexing_bytes),
        mib(plan.row_bytes),
        mib(plan.sum_bytes),
        mib(plan.window_bytes),
    )?;
    outln!(
        "plan: {} windows of {} facets; file {} MiB, scratch files up to {} MiB",
        plan.windows,
        plan.window_facets,
        mib(plan.file_bytes),
        mib(plan.scratch_bytes),
    )?;
    Ok(())
}

fn resident(session: &mut dyn Session) -> Result<&mut dyn geometry::rvd::Resident, RvdError> {
    session.resident().ok_or_else(|| RvdError::Internal("this session moves no seeds".to_owned()))
}

/// Every seed to the centroid of its cell; one without a cell stays.
fn lloyd(session: &mut dyn Session, token: &Token) -> Result<Evaluation, RvdError> {
    let resident = resident(session)?;
    let evaluation = resident.evaluate(token)?;
    resident.to_centroids()?;
    Ok(evaluation)
}

/// A step's figures, in the caller's units.
fn iteration(step: &Evaluation, ratio: f64, scale: f64) -> Value {
    let stats = &step.stats;
    json!({
        "kind": "lloyd", "energy": step.energy / scale / scale / scale / scale, "energy_ratio": ratio,
        "gradient_norm": step.gradient_squared.sqrt() / scale / scale / scale, "area": step.area / scale / scale,
        "empty_cells": step.empty_cells, "neighbours_ms": stats.neighbours_ms, "start_ms": stats.start_ms,
        "clip_ms": stats.clip_ms, "update_ms": stats.update_ms,
    })
}

fn refused(args: &RvdArgs, error: OutOfCoreError) -> anyhow::Error {
    match error {
        OutOfCoreError::File(MeshFileError::Read(cause)) => NoInput { path: args.input.clone(), cause }.into(),
        OutOfCoreError::File(MeshFileError::Stopped(stopped)) => RvdError::from(stopped).into(),
        OutOfCoreError::File(MeshFileError::Scratch { .. }) => crate::exit::NotWritten(error.to_string()).into(),
        OutOfCoreError::File(MeshFileError::DoesNotFit { .. }) | OutOfCoreError::DoesNotFit { .. } => {
            Usage(format!("--memory-mib: {error}")).into()
        }
        OutOfCoreError::File(error) => BadInput(format!("{}: {error}", args.input.display())).into(),
        OutOfCoreError::Rvd(error) => error.into(),
    }
}

/// Visits the lines of a file of points that hold one.
fn each_line(path: &Path, mut visit: impl FnMut(&str) -> Result<()>) -> Result<()> {
    let failed = |cause| NoInput { path: path.to_owned(), cause };
    let mut lines = BufReader::new(std::fs::File::open(path).map_err(failed)?);
    let mut line = Vec::new();
    loop {
        line.clear();
        if lines.read_until(b'\n', &mut line).map_err(failed)? == 0 {
            return Ok(());
        }
        let text = std::str::from_utf8(&line)
            .map_err(|_| BadInput(format!("{}: this is no text in UTF-8", path.display())))?;
        if !matches!(text.trim_start().bytes().next(), None | Some(b'#')) {
            visit(text)?;
        }
    }
}

fn count_points(path: &Path) -> Result<usize> {
    let mut count = 0;
    each_line(path, |_| {
        count += 1;
        Ok(())
    })?;
    if count == 0 { files::read_points(path).map(|points| points.len()) } else { Ok(count) }
}

/// Reads so many points, `x y z` a line, without holding the text.
fn read_points(path: &Path, count: usize) -> Result<Vec<DVec3>> {
    let mut points = Vec::with_capacity(count);
    let mut is_whole = true;
    each_line(path, |line| {
        match lists::points(line, 1, &Token::default()) {
            Ok(point) => points.extend(point),
            Err(_) => is_whole = false,
        }
        Ok(())
    })?;
    // The reader of the whole file names the line.
    if is_whole && points.len() == count { Ok(points) } else { files::read_points(path) }
}
