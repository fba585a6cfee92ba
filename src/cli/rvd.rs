//! `tessera rvd`.

mod windows;

use std::fs::File;
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, Result};
use clap::{ArgGroup, Args};
use glam::DVec3;
use serde_json::Value;
use tempfile::NamedTempFile;

use super::exit::{NotWritten, Usage};
use super::given::{self, Given};
use super::picture::PictureArgs;
use super::progress::{Plan, Progress};
use super::remesh::args::{points, usage};
use super::remesh::ms;
use super::remote::{RvdResult, Sink, Wants};
use super::say::SayArgs;
use super::server::EndpointArgs;
use super::{backends, files, interrupt, remote, say};
use geometry::cvt::density::DensityOptions;
use geometry::mesh::TriMesh;
use geometry::mesh::io::Format;
use geometry::remesh::Seeds;
use geometry::remesh::report::to_json;
use geometry::rvd::PieceBatch;
use geometry::rvd::cells::CellWriter;
use geometry::token::Token;
use jobs::executor::diagram::Diagram;
use jobs::executor::prepared::{Input, Prepared};
use jobs::{BackendInfo, memory};
use server::config::{BackendArgs, whole};
use wire::counts::Bounds;
use wire::options::{self, Beside};
use wire::proto::{DiagramOptions, RemeshOptions};

#[derive(Args, Debug)]
#[command(group(ArgGroup::new("of").required(true).args(["seeds", "points"])))]
pub(crate) struct RvdArgs {
    /// The surface.
    #[arg(help = files::help_of("The surface", "- is the standard input"))]
    input: PathBuf,
    /// Format of the surface, where its name does not say it.
    #[arg(long, value_name = "FORMAT", value_parser = files::format())]
    input_format: Option<Format>,
    #[command(flatten)]
    seeds: Given<SeedArgs>,
    /// Lloyd steps before the diagram: every seed to the centroid of its cell.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = whole::<u32>, help_heading = "Steps")]
    lloyd: u32,
    #[command(flatten)]
    files: FileArgs,
    #[command(flatten, next_help_heading = "Picture")]
    picture: PictureArgs,
    #[command(flatten)]
    windows: windows::WindowArgs,
    /// Draw the seeds as dots in the picture, where the surface is next to them.
    #[arg(long, requires = "picture", help_heading = "Picture")]
    dots: bool,
    #[command(flatten, next_help_heading = "Backend")]
    backend: BackendArgs,
    #[command(flatten, next_help_heading = "Backend")]
    at: EndpointArgs,
    #[command(flatten, next_help_heading = "Messages")]
    say: SayArgs,
}

#[derive(Args, Debug)]
#[command(next_help_heading = "Seeds (--seeds or --points is required)")]
pub(super) struct SeedArgs {
    /// The seeds, `x y z` a line.
    #[arg(long, value_name = "FILE.xyz")]
    pub(super) seeds: Option<PathBuf>,
    /// Number of seeds to draw instead: 1000, 10k, or 50% of the surface's vertices.
    #[arg(long, value_name = "N|P%", value_parser = points, allow_negative_numbers = true)]
    pub(super) points: Option<String>,
    /// Random seed of the points.
    #[arg(long, value_name = "N", default_value_t = Seeds::RANDOM_SEED, value_parser = whole::<u64>)]
    pub(super) seed: u64,
}

#[derive(Args, Debug)]
#[command(next_help_heading = "Files")]
struct FileArgs {
    /// Write the pieces there: polygons with their seed, their facet and a colour.
    #[arg(short, long, value_name = "CELLS.ply")]
    output: Option<PathBuf>,
    /// Write the centroids there, `x y z` a line, in seed order; an empty cell's is its seed.
    #[arg(long, value_name = "FILE.xyz")]
    centroids: Option<PathBuf>,
    /// Write the report there, as JSON.
    #[arg(long, value_name = "FILE.json")]
    report: Option<PathBuf>,
}

impl Given<SeedArgs> {
    /// The options that are set, without outputs, and the seeds of them; given ones are empty. Errors: what cannot be
    /// whatever the surface.
    pub(super) fn asked(&self) -> Result<(DiagramOptions, Seeds)> {
        let RemeshOptions { points, points_percent, seed, .. } = given::message(&[&self.set])?;
        let message = DiagramOptions { points, points_percent, seed, outputs: Vec::new() };
        let beside = Beside { seeds: self.seeds.is_some().then_some(0), ..Beside::default() };
        let diagram = options::diagram(&message, beside, &Bounds::WIDEST).map_err(usage)?;
        Ok((message, diagram.seeds))
    }
}

impl RvdArgs {
    /// The seeds for a surface.
    pub(super) fn seeds(&self, mesh: &TriMesh) -> Result<Seeds> {
        let (_, mut seeds) = self.seeds.asked()?;
        seeds.resolve(mesh);
        Ok(match &self.seeds.seeds {
            Some(path) => Seeds::Given(files::read_points(path)?),
            None => seeds,
        })
    }
}

pub(crate) fn run(args: &RvdArgs) -> Result<()> {
    check(args)?;
    backends::on_threads(&args.backend, || match args.windows.memory_mib {
        Some(limit_mib) => windows::run(args, limit_mib),
        None => work(args),
    })
}

fn work(args: &RvdArgs) -> Result<()> {
    let start = Instant::now();
    let server = args.at.server()?;
    let mut progress = Progress::begin(&args.input, args.say.quiet);
    let mesh = files::Surface::new(&args.input, args.input_format).read_mesh()?;
    let seeds = args.seeds(&mesh)?;
    let read_ms = ms(start);
    let FileArgs { output, centroids, report } = &args.files;
    // Without any file the sums give the figures.
    let pieces = output.is_some() || args.picture.picture.is_some();
    let wants = Wants { cells: pieces, centroids: centroids.is_some() || !pieces };
    let mut cells = output.as_deref().map(CellFile::create).transpose()?;
    let (count, given) = match &seeds {
        Seeds::Given(points) => (points.len(), Arc::new(points.clone())),
        Seeds::Sample { points, .. } => (*points, Arc::default()),
        Seeds::Implied { .. } | Seeds::Share { .. } => (0, Arc::default()),
    };
    progress.plan(Plan::rvd(mesh.facets().len(), count, server.is_some()));
    let mut picture = args.picture.begin(&mesh, count, args.dots)?;
    let mut sink = |batch: &PieceBatch| {
        picture.iter_mut().for_each(|picture| picture.append(batch));
        cells.as_mut().map_or(Ok(()), |file| file.append(batch))
    };
    let (mut result, seeds) = match &server {
        None => here(args, mesh, seeds, wants, &mut progress, &mut sink)?,
        Some(server) => {
            let at = (server, args.backend.backend);
            (remote::rvd(at, (&mesh, seeds), wants, &progress, &mut sink)?, given)
        }
    };
    let writing = Instant::now();
    progress.stage("write", 0, 0);
    if let Some(file) = cells {
        file.finish()?;
    }
    if let Some(picture) = picture {
        picture.finish(&seeds)?;
    }
    if let Some(path) = centroids {
        files::write_points(path, &result.centroids)?;
    }
    if server.is_none() {
        let timings = &mut result.report["timings_ms"];
        (timings["read"], timings["write"], timings["total"]) = (read_ms.into(), ms(writing).into(), ms(start).into());
        result.report["memory"]["host_peak_bytes"] = memory::peak_memory_bytes().into();
    }
    if let Some(path) = report {
        files::write_json(path, &result.report)?;
    }
    drop(progress);
    if args.say.json {
        say::json(&result.report)?;
    }
    if args.say.summary() {
        summary(args, &result.report, ms(start))?;
    }
    Ok(())
}

fn check(args: &RvdArgs) -> Result<()> {
    let FileArgs { output, centroids, report } = &args.files;
    args.backend.check()?;
    output.iter().try_for_each(|path| files::check_output(path, &["ply"]))?;
    centroids.iter().chain(report).try_for_each(|path| files::check_output(path, &[]))?;
    let outputs = [output.as_deref(), centroids.as_deref(), report.as_deref(), args.picture.picture.as_deref()];
    let inputs = [Some(args.input.as_path()), args.seeds.seeds.as_deref()];
    files::check_apart(inputs.into_iter().flatten(), outputs.into_iter().flatten())?;
    args.picture.check_for_cells()?;
    windows::check(args)?;
    if args.lloyd > 0 && args.at.endpoint.is_some() {
        let text = "--lloyd with --endpoint: a server's diagram has no steps; leave one out";
        return Err(Usage(text.to_owned()).into());
    }
    if args.dots && args.at.endpoint.is_some() && args.seeds.seeds.is_none() {
        let text = "--dots with --endpoint: the server draws the points and keeps them; give them with --seeds";
        return Err(Usage(text.to_owned()).into());
    }
    Ok(())
}

fn summary(args: &RvdArgs, report: &Value, total_ms: f64) -> Result<(), NotWritten> {
    let rvd = &report["rvd"];
    let at = args.at.endpoint.as_ref().map(|url| format!(" at {url}")).unwrap_or_default();
    // A figure that is no number is left out: a server may say anything.
    let figure = |value: &Value, before: &str, after: &str| match value.is_number() {
        true => format!("{before}{value}{after}"),
        false => String::new(),
    };
    outln!(
        "{}: {}{}{}{}by {}{at}, {total_ms:.0} ms",
        args.files.output.as_ref().unwrap_or(&args.input).display(),
        figure(&report["seeds"], "", " seeds, "),
        figure(&rvd["pairs"], "", " pieces, "),
        figure(&rvd["empty_cells"], "", " empty cells, "),
        figure(&rvd["area"], "area ", ", "),
        report["backend"].as_str().unwrap_or("?"),
    )
}

fn here(
    args: &RvdArgs,
    mesh: TriMesh,
    seeds: Seeds,
    wants: Wants,
    progress: &mut Progress,
    sink: Sink<'_>,
) -> Result<(RvdResult, Arc<Vec<DVec3>>)> {
    let token = Token::default();
    interrupt::cancel_on_signal(&token).context("cannot listen for signals")?;
    let backend = backends::one(&args.backend)?;
    progress.stage("prepare", 0, 0);
    let prepared = Prepared::new(
        Input { mesh, density: DensityOptions::default(), seeds, creases: Vec::new(), attributes: None },
        &token,
    )?;
    token.check()?;
    let mut diagram = Diagram::open(&prepared, backend.as_ref())?;
    for step in 0..args.lloyd {
        let ratio = diagram.lloyd(backend.as_ref(), &token)?;
        progress.iteration(u64::from(step), u64::from(args.lloyd), ratio);
    }
    progress.stage("diagram", 0, 0);
    let centroids = if wants.centroids { diagram.sums(backend.as_ref(), &token)?.centroids } else { Vec::new() };
    if wants.cells {
        while let Some(batch) = diagram.batch(backend.as_ref(), &token)? {
            sink(&batch)?;
            let (done, total) = diagram.progress();
            progress.stage("diagram", done, total);
        }
    }
    let report = to_json(&diagram.report(&prepared, &BackendInfo::of(backend.as_ref())))?;
    Ok((RvdResult { centroids, report }, diagram.seeds()))
}

pub(crate) struct CellFile {
    path: PathBuf,
    writer: CellWriter<BufWriter<NamedTempFile>, File>,
}

impl CellFile {
    /// Begins a file that will be `path`.
    pub(crate) fn create(path: &Path) -> Result<Self> {
        let begin = || {
            let vertices = BufWriter::new(files::begin(path)?);
            let folder = vertices.get_ref().path().parent().unwrap_or(Path::new("."));
            let polygons = tempfile::tempfile_in(folder)?;
            CellWriter::new(vertices, polygons)
        };
        let writer = begin().map_err(|e| files::unwritten(path, &e))?;
        Ok(Self { path: path.to_owned(), writer })
    }

    pub(crate) fn append(&mut self, cells: &PieceBatch) -> Result<()> {
        Ok(self.writer.append(cells).map_err(|e| files::unwritten(&self.path, &e))?)
    }

    /// Gives the file its name.
    pub(crate) fn finish(self) -> Result<()> {
        let Self { path, writer } = self;
        let finish = || {
            let file = writer.finish()?.into_inner().map_err(io::IntoInnerError::into_error)?;
            files::keep(file.into_temp_path(), &path)
        };
        Ok(finish().map_err(|e| files::unwritten(&path, &e))?)
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    #[test]
    fn a_file_has_its_name_once_it_is_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cells.ply");
        let mut file = CellFile::create(&path).unwrap();
        let mut batch = PieceBatch::default();
        batch.push(7, 3, [DVec3::X, DVec3::Y, DVec3::Z].map(|p| (p, 1.0, 0)));
        file.append(&batch).unwrap();
        assert!(!path.exists(), "not before it is whole");
        file.finish().unwrap();
        let bytes = std::fs::read(&path).unwrap();
        assert!(bytes.starts_with(b"ply\n") && bytes.len() == 512 + 3 * 24 + 24, "{}", bytes.len());
    }
}
