//! `tessera rvd`.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, Result};
use clap::Args;
use glam::DVec3;

use super::cell_file::CellFile;
use super::exit::Usage;
use super::picture::PictureArgs;
use super::progress::Progress;
use super::{backends, files, interrupt, remote};
use crate::config::BackendArgs;
use crate::cvt::density::DensityOptions;
use crate::job::BackendInfo;
use crate::job::diagram::Diagram;
use crate::job::spec::{Input, Prepared};
use crate::mesh::TriMesh;
use crate::remesh::Seeds;
use crate::rvd::PieceBatch;
use crate::telemetry;
use crate::token::Token;

/// `tessera rvd`'s options.
#[derive(Args, Debug)]
pub(crate) struct RvdArgs {
    /// The surface: .obj, .ply, .stl or .off.
    input: PathBuf,
    /// The seeds, `x y z` a line.
    #[arg(long, value_name = "FILE.xyz", required_unless_present = "points", conflicts_with = "points")]
    seeds: Option<PathBuf>,
    /// Draw so many seeds instead.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    points: Option<u32>,
    /// Random seed of the points.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Write the pieces there: polygons with their seed, their facet and a colour.
    #[arg(short, long, value_name = "CELLS.ply")]
    output: Option<PathBuf>,
    /// Write the centroids there, `x y z` a line, in seed order; an empty cell's is its seed.
    #[arg(long, value_name = "FILE.xyz")]
    centroids: Option<PathBuf>,
    /// Write the report there, as JSON.
    #[arg(long, value_name = "FILE.json")]
    report: Option<PathBuf>,
    /// Who works.
    #[command(flatten)]
    backend: BackendArgs,
    /// Let a server do the work, e.g. http://127.0.0.1:50051.
    #[arg(long, value_name = "URL")]
    endpoint: Option<String>,
    /// How it looks.
    #[command(flatten)]
    picture: PictureArgs,
    /// Draw the seeds as dots in the picture, where the surface is next to them.
    #[arg(long, requires = "picture")]
    dots: bool,
}

/// What came out, wherever it was computed.
pub(crate) struct RvdResult {
    /// One a seed; empty if not wanted.
    pub(crate) centroids: Vec<DVec3>,
    /// The report.
    pub(crate) report: serde_json::Value,
}

/// Runs it.
pub(crate) fn run(args: &RvdArgs) -> Result<()> {
    args.backend.check()?;
    args.output.iter().try_for_each(|path| files::check_output(path, &["ply"]))?;
    args.centroids.iter().chain(&args.report).try_for_each(|path| files::check_output(path, &[]))?;
    let outputs = [args.output.as_deref(), args.centroids.as_deref(), args.report.as_deref(), args.picture.path()];
    let inputs = [Some(args.input.as_path()), args.seeds.as_deref()];
    files::check_apart(inputs.into_iter().flatten(), outputs.into_iter().flatten())?;
    args.picture.check_for_cells()?;
    if args.dots && args.endpoint.is_some() && args.seeds.is_none() {
        let text = "--dots with --endpoint: the server draws the points and keeps them; give them with --seeds";
        return Err(Usage(text.to_owned()).into());
    }
    let start = Instant::now();
    let mesh = files::read_mesh(&args.input)?;
    let seeds = match (&args.seeds, args.points) {
        (Some(path), _) => Seeds::Given(files::read_points(path)?),
        (None, points) => Seeds::Sample { points: points.unwrap_or(1) as usize, seed: args.seed },
    };
    let read_ms = start.elapsed().as_secs_f64() * 1e3;
    // Without any file the sums give the figures.
    let pieces = args.output.is_some() || args.picture.wanted();
    let wants = Wants { cells: pieces, centroids: args.centroids.is_some() || !pieces };
    let mut cells = args.output.as_deref().map(CellFile::create).transpose()?;
    let (count, given) = match &seeds {
        Seeds::Given(points) => (points.len(), Arc::new(points.clone())),
        Seeds::Sample { points, .. } => (*points, Arc::default()),
        Seeds::Implied { .. } => (0, Arc::default()),
    };
    let mut picture = args.picture.begin(&mesh, count, args.dots)?;
    let mut sink = |batch: &PieceBatch| {
        picture.iter_mut().for_each(|picture| picture.append(batch));
        cells.as_mut().map_or(Ok(()), |file| file.append(batch))
    };
    let (mut result, seeds) = match &args.endpoint {
        None => here(args, mesh, seeds, wants, &mut sink)?,
        Some(endpoint) => (remote::rvd(endpoint, &mesh, seeds, wants, args.backend.backend, &mut sink)?, given),
    };
    let writing = Instant::now();
    if let Some(file) = cells {
        file.finish()?;
    }
    if let Some(picture) = picture {
        picture.finish(&seeds)?;
    }
    if let Some(path) = &args.centroids {
        files::write_points(path, &result.centroids)?;
    }
    if args.endpoint.is_none() {
        let timings = &mut result.report["timings_ms"];
        timings["read"] = read_ms.into();
        timings["write"] = (writing.elapsed().as_secs_f64() * 1e3).into();
        timings["total"] = (start.elapsed().as_secs_f64() * 1e3).into();
    }
    if args.endpoint.is_none() {
        result.report["memory"]["host_peak_bytes"] = telemetry::peak_memory_bytes().into();
    }
    if let Some(path) = &args.report {
        files::write_json(path, &result.report)?;
    }
    let (rvd, report) = (&result.report["rvd"], &result.report);
    println!(
        "{} seeds, {} pieces, {} empty cells, area {}, by {}, {:.0} ms",
        report["seeds"],
        rvd["pairs"],
        rvd["empty_cells"],
        rvd["area"],
        report["backend"].as_str().unwrap_or("?"),
        report["timings_ms"]["total"].as_f64().unwrap_or(0.0)
    );
    Ok(())
}

/// Takes each batch of pieces as it comes, caller's coordinates.
pub(crate) type Sink<'a> = &'a mut dyn FnMut(&PieceBatch) -> Result<()>;

/// What is to be computed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Wants {
    /// The pieces.
    pub(crate) cells: bool,
    /// The centroids.
    pub(crate) centroids: bool,
}

/// The diagram, and its seeds.
fn here(
    args: &RvdArgs,
    mesh: TriMesh,
    seeds: Seeds,
    wants: Wants,
    sink: Sink<'_>,
) -> Result<(RvdResult, Arc<Vec<DVec3>>)> {
    let token = Token::default();
    interrupt::cancel_on_signal(&token).context("cannot listen for signals")?;
    let backend = backends::one(&args.backend)?;
    let progress = Progress::new();
    progress.stage("prepare", 0, 0);
    let prepared = Prepared::new(
        Input { mesh, density: DensityOptions::default(), seeds, creases: Vec::new(), attributes: None },
        &token,
    )?;
    token.check()?;
    progress.stage("diagram", 0, 0);
    let mut diagram = Diagram::open(&prepared, backend.as_ref())?;
    let centroids = if wants.centroids { diagram.sums(&token)?.centroids } else { Vec::new() };
    if wants.cells {
        while let Some(batch) = diagram.batch(&token)? {
            sink(&batch)?;
            let (done, total) = diagram.progress();
            progress.stage("diagram", done, total);
        }
    }
    let report = serde_json::to_value(diagram.report(&prepared, &BackendInfo::of(backend.as_ref())))?;
    Ok((RvdResult { centroids, report }, Arc::clone(&prepared.seeds)))
}
