//! `tessera remesh`.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result};
use clap::{Args, ValueEnum};

use super::exit::{BadInput, Usage};
use super::picture::PictureArgs;
use super::progress::Progress;
use super::{backends, files, interrupt, remote, sizes};
use crate::config::BackendArgs;
use crate::cvt::Projection;
use crate::cvt::density::{DensityOptions, DensitySource};
use crate::mesh::TriMesh;
use crate::mesh::features::Features;
use crate::remesh::report::RepairFigures;
use crate::remesh::{Placement, Refine, RemeshOptions, Report, Seeds, remesh};
use crate::telemetry;
use crate::token::Token;

/// `tessera remesh`'s options.
#[derive(Args, Debug)]
pub(crate) struct RemeshArgs {
    /// The surface: .obj, .ply, .stl or .off.
    input: PathBuf,
    /// Where the remesh goes; the extension is the format.
    #[arg(short, long, value_name = "OUTPUT")]
    output: PathBuf,
    /// Number of seeds, about the number of vertices of the result. This, --edge-length or --sizes is required.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..), allow_negative_numbers = true)]
    #[arg(required_unless_present_any = ["edge_length", "sizes"], conflicts_with = "edge_length")]
    points: Option<u32>,
    /// Lloyd steps.
    #[arg(long, value_name = "N", default_value_t = 5)]
    lloyd: u32,
    /// Quasi-Newton (L-BFGS) steps after them, at most; they end when converged.
    #[arg(long, value_name = "N", default_value_t = 30)]
    newton: u32,
    /// Random seed of the first points.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Edges bent by more than this are creases that the remesh keeps; 0 keeps none.
    #[arg(long, value_name = "DEGREES", default_value_t = RemeshOptions::CREASE_ANGLE_DEG, value_parser = angle)]
    #[arg(allow_negative_numbers = true)]
    crease_angle: f64,
    /// File with edges that are creases whatever their angle: the numbers of two vertices of the input a line, from 0.
    #[arg(long, value_name = "FILE")]
    creases: Option<PathBuf>,
    /// Add points where a vertex of the input is farther than this from the remesh, in percent of the bounding
    /// box's diagonal; for --placement fitted.
    #[arg(long, value_name = "PERCENT", value_parser = positive, allow_negative_numbers = true)]
    max_deviation: Option<f64>,
    /// The most points that --max-deviation may come to; twice --points if not given.
    #[arg(long, value_name = "N", requires = "max_deviation", value_parser = clap::value_parser!(u32).range(1..))]
    max_points: Option<u32>,
    /// What happens to the boundaries of an open surface.
    #[arg(long, value_enum, default_value_t)]
    boundaries: BoundariesArg,
    /// What happens where the surface is too thin for edges as long as elsewhere.
    #[arg(long, value_enum, default_value_t)]
    thin: ThinArg,
    /// Where the vertices of the remesh go.
    #[arg(long, value_enum, default_value_t)]
    placement: PlacementArg,
    /// Where seeds go after each step. They end on the surface either way.
    #[arg(long, value_enum, default_value_t)]
    projection: ProjectionArg,
    /// Who works.
    #[command(flatten)]
    backend: BackendArgs,
    /// Let a server do the work, e.g. http://127.0.0.1:50051.
    #[arg(long, value_name = "URL")]
    endpoint: Option<String>,
    /// Write the report there, as JSON.
    #[arg(long, value_name = "FILE.json")]
    report: Option<PathBuf>,
    /// How it looks.
    #[command(flatten)]
    picture: PictureArgs,
    /// Leave aside normals, texture coordinates, colours and scalars of the input.
    #[arg(long)]
    no_attributes: bool,
    /// How lengths of edges vary.
    #[command(flatten)]
    density: DensityArgs,
}

/// Where edges are short and where long.
#[derive(Args, Debug)]
struct DensityArgs {
    /// Where short edges go.
    #[arg(long, value_enum, default_value_t, conflicts_with = "sizes")]
    density: DensityArg,
    /// Length of the edges, in the input's units, instead of --points. If --density is not uniform: as many points
    /// as edges of this length everywhere would need.
    #[arg(long, value_name = "H", value_parser = positive, conflicts_with = "sizes", allow_negative_numbers = true)]
    edge_length: Option<f64>,
    /// File with the length of the edges at each vertex of the input, one number a line in the order of the
    /// input's vertices. With --points only the ratios are kept.
    #[arg(long, value_name = "FILE")]
    sizes: Option<PathBuf>,
    /// The most that edge lengths grow per distance.
    #[arg(long, value_name = "G", default_value_t = DensityOptions::default().gradation, value_parser = positive)]
    #[arg(allow_negative_numbers = true)]
    gradation: f64,
    /// 0 for edges of one length, 1 for lengths as --density or --sizes says.
    #[arg(long, value_name = "A", default_value_t = 1.0, allow_negative_numbers = true)]
    adaptivity: f64,
}

/// Where short edges go.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum DensityArg {
    /// Edges of one length.
    #[default]
    Uniform,
    /// Where the surface bends.
    Curvature,
    /// Where the surface is thin, hollow or sharp: local feature size.
    Lfs,
}

impl DensityArg {
    /// The same, for the library.
    pub(crate) fn source(self) -> DensitySource {
        match self {
            Self::Uniform => DensitySource::Uniform,
            Self::Curvature => DensitySource::Curvature,
            Self::Lfs => DensitySource::FeatureSize,
        }
    }
}

fn positive(text: &str) -> Result<f64, String> {
    let number = text.parse::<f64>().map_err(|error| error.to_string())?;
    if number.is_finite() && number > 0.0 { Ok(number) } else { Err("a finite number above 0 is needed".to_owned()) }
}

fn angle(text: &str) -> Result<f64, String> {
    let number = text.parse::<f64>().map_err(|error| error.to_string())?;
    if (0.0..=180.0).contains(&number) { Ok(number) } else { Err("an angle from 0 to 180 is needed".to_owned()) }
}

impl DensityArgs {
    /// What the options say of `mesh`, which was read from `input`.
    fn options(&self, input: &Path, mesh: &TriMesh) -> Result<DensityOptions> {
        let source = match (&self.sizes, self.density) {
            (Some(path), _) => DensitySource::Sizes(sizes::read(path, input, mesh)?),
            (None, density) => density.source(),
        };
        let (edge_length, gradation, adaptivity) = (self.edge_length, self.gradation, self.adaptivity);
        Ok(DensityOptions { edge_length, gradation, adaptivity, ..DensityOptions::from_source(source) })
    }
}

/// What happens to boundaries.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum BoundariesArg {
    /// They get vertices of their own and stay where they are.
    #[default]
    Keep,
    /// The rim settles where the cells end, about half an edge inside.
    Free,
}

/// What happens where the surface is thin.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum ThinArg {
    /// Edges become shorter there, so that horns, fingers, strips and bridges stay. Not if --sizes says how long they are.
    #[default]
    Finer,
    /// Edges are as long as elsewhere; what is too thin for them may be missing.
    Even,
}

/// Where seeds go.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum ProjectionArg {
    /// Where the step takes them, near the surface.
    #[default]
    Free,
    /// To the closest point of the surface; a quasi-Newton step then begins without a history.
    Surface,
}

/// Where vertices go.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum PlacementArg {
    /// Where the facets between them are nearest to the input in the mean.
    #[default]
    Fitted,
    /// On the input surface.
    Surface,
    /// To the centroids of their cells.
    Centroids,
}

impl PlacementArg {
    fn placement(self) -> Placement {
        match self {
            Self::Fitted => Placement::Fitted,
            Self::Surface => Placement::Surface,
            Self::Centroids => Placement::Centroids,
        }
    }
}

/// Runs it.
pub(crate) fn run(args: &RemeshArgs) -> Result<()> {
    args.backend.check()?;
    files::check_output(&args.output, &["obj", "ply", "stl", "off"])?;
    args.report.iter().try_for_each(|path| files::check_output(path, &[]))?;
    // A surface may be replaced by its remesh.
    let others = [args.creases.as_deref(), args.density.sizes.as_deref()];
    let kept = [args.input.as_path(), args.output.as_path()].into_iter().chain(others.into_iter().flatten());
    files::check_apart(kept, [args.report.as_deref(), args.picture.path()].into_iter().flatten())?;
    if args.density.sizes.is_some() {
        sizes::check_format(&args.input, "--sizes")?;
    }
    if args.creases.is_some() {
        sizes::check_format(&args.input, "--creases")?;
    }
    args.picture.check()?;
    if args.max_deviation.is_some() && args.placement.placement() != Placement::Fitted {
        return Err(Usage("--max-deviation is for --placement fitted; give one of them alone".to_owned()).into());
    }
    let start = Instant::now();
    let (mesh, attributes) = match args.no_attributes {
        true => (files::read_mesh(&args.input)?, None),
        false => files::read_loaded(&args.input)?,
    };
    let options = RemeshOptions { attributes, ..options(args, &mesh)? };
    let read_ms = ms(start);
    match &args.endpoint {
        None => here(args, &mesh, &options, start, read_ms),
        Some(endpoint) => there(args, &mesh, &options, endpoint),
    }
}

/// What the arguments say of `mesh`.
fn options(args: &RemeshArgs, mesh: &TriMesh) -> Result<RemeshOptions> {
    let density = args.density.options(&args.input, mesh)?;
    density.check().map_err(|error| Usage(error.to_string()))?;
    let (low, high) = mesh.bounds();
    let extent = (high - low).max_element();
    let diagonal = ((high - low) / extent).length() * extent;
    let most = args.max_points.or(args.points.map(|n| n.saturating_mul(2)));
    if let (Some(points), Some(most)) = (args.points, args.max_points)
        && most < points
    {
        return Err(Usage(format!("--max-points {most} is less than --points {points}")).into());
    }
    let refine = match (args.max_deviation, most) {
        (Some(percent), Some(most)) => {
            Some(Refine { tolerance: percent / 100.0 * diagonal, max_points: most as usize })
        }
        (Some(_), None) => return Err(Usage("--max-deviation without --points needs --max-points".to_owned()).into()),
        (None, _) => None,
    };
    let creases = args.creases.as_ref().map(|path| {
        let edges = sizes::read_edges(path, &args.input, mesh)?;
        // Before a server is asked.
        Features::check(mesh, args.crease_angle, &edges, &Token::default())
            .map_err(|e| BadInput(format!("{}: {e} (numbers of the surface as it was read)", path.display())))?;
        Ok::<_, anyhow::Error>(edges)
    });
    Ok(RemeshOptions {
        creases: creases.transpose()?.unwrap_or_default(),
        lloyd: args.lloyd as usize,
        newton: args.newton as usize,
        crease_angle_deg: args.crease_angle,
        keep_boundaries: args.boundaries == BoundariesArg::Keep,
        keep_thin: args.thin == ThinArg::Finer,
        placement: args.placement.placement(),
        projection: match args.projection {
            ProjectionArg::Free => Projection::Free,
            ProjectionArg::Surface => Projection::OnSurface,
        },
        refine,
        density,
        ..RemeshOptions::new(match args.points {
            Some(points) => Seeds::Sample { points: points as usize, seed: args.seed },
            None => Seeds::Implied { seed: args.seed },
        })
    })
}

fn here(args: &RemeshArgs, mesh: &TriMesh, options: &RemeshOptions, start: Instant, read_ms: f64) -> Result<()> {
    let token = Token::default();
    interrupt::cancel_on_signal(&token).context("cannot listen for signals")?;
    let backend = backends::one(&args.backend)?;
    let mut progress = Progress::new();
    let done = remesh(mesh, options, backend.as_ref(), &mut progress, &token);
    drop(progress);
    let mut done = done?;
    let writing = Instant::now();
    files::write_loaded(&args.output, &done.mesh, done.attributes.as_ref())?;
    args.picture.draw(&done.mesh, &done.curve_edges)?;
    let timings = &mut done.report.timings_ms;
    (timings.read, timings.write, timings.total) = (read_ms, ms(writing), ms(start));
    done.report.memory.host_peak_bytes = telemetry::peak_memory_bytes();
    if let Some(path) = &args.report {
        files::write_json(path, &done.report)?;
    }
    print(&done.report, args.max_deviation.is_some());
    Ok(())
}

fn there(args: &RemeshArgs, mesh: &TriMesh, options: &RemeshOptions, endpoint: &str) -> Result<()> {
    let job = remote::RemeshJob { mesh, options, backend: args.backend.backend };
    let done = remote::remesh(endpoint, &job)?;
    files::write_loaded(&args.output, &done.mesh, done.attributes.as_ref())?;
    args.picture.draw(&done.mesh, &done.curve_edges)?;
    if let Some(path) = &args.report {
        files::write_json(path, &done.report)?;
    }
    let result = &done.report["result"];
    println!(
        "{} vertices, {} facets, by {} at {endpoint}",
        result["vertices"], result["facets"], done.report["backend"]
    );
    Ok(())
}

/// What a person wants to know at the end; `bounded` if it was said how far the result may be.
fn print(report: &Report, bounded: bool) {
    let (input, result, rvd) = (&report.input, &report.result, &report.rvd);
    let by = report.adapter.as_deref().unwrap_or("CPU");
    println!("backend     {} ({by}), {} threads", report.backend, report.threads);
    println!("input       {} vertices, {} facets, χ {}", input.vertices, input.facets, input.topology.euler);
    if input.stitched_vertices > 0 {
        let moved = input.stitched_vertices;
        println!(
            "            {moved} vertices of its boundaries were nearly in the same place as others and moved there"
        );
    }
    if input.spare_facets > 0 {
        println!("            {} facets lay on others, corner on corner, and were left out", input.spare_facets);
    }
    if input.turned_facets > 0 {
        println!("            {} facets were oriented unlike their neighbours and turned over", input.turned_facets);
    }
    println!("result      {} vertices, {} facets, χ {}", result.vertices, result.facets, result.topology.euler);
    let features = &report.features;
    if features.given_up > 0 && features.creases == 0 {
        let (curves, what) = (features.given_up, if features.boundaries == 0 { " and boundaries" } else { "" });
        println!("            {curves} creases{what} were given up: they are too close together for so few points");
    }
    let RepairFigures { seeds_without_vertex: without, further_vertices: further, .. } = result.repair;
    if without + further > 0 {
        println!(
            "            {without} points have no vertex, {further} vertices share one: the surface is thin there"
        );
    }
    if let Some(last) = report.iterations.last() {
        println!("iterations  {}, E/E_hex before the last {:.5}", report.iterations.len(), last.energy_ratio);
    }
    let density = &report.density;
    if let (Some(least), Some(median), Some(largest)) = (density.edge_least, density.edge_median, density.edge_largest)
    {
        println!("lengths     {}: target {least:.4e} to {largest:.4e}, median {median:.4e}", density.source);
    }
    if report.refine.thin_rounds > 0 {
        println!("            shorter where the surface is too thin for others");
    }
    println!("pairs       {}, launched again {}, empty cells {}", rvd.pairs, rvd.relaunched_pairs, rvd.empty_cells);
    if let Some(q) = &result.quality {
        println!(
            "quality     Q min {:.4}, mean {:.4}; angle min {:.2}°, mean {:.2}°",
            q.q_min, q.q_avg, q.theta_min_deg, q.theta_avg_deg
        );
        println!("            under 30° {:.2} %; valence 5-7 {:.2} %", q.under_30_percent, q.v567_percent);
        println!("distance    Hausdorff {:.4} %, RMS {:.4} % of the diagonal", q.hausdorff_percent, q.rms_percent);
    }
    println!(
        "topology    {} boundary edges, {} non-manifold edges, {} non-manifold vertices",
        result.topology.boundary_edges, result.topology.non_manifold_edges, result.topology.non_manifold_vertices
    );
    if !report.topology_changes.is_empty() {
        let odd = input.topology.non_manifold_edges + input.topology.non_manifold_vertices;
        let why = if odd > 0 { "the input is no manifold, as the result is" } else { "more points keep more" };
        println!("changed     {}; {why}", report.topology_changes.join(", "));
    }
    let refine = &report.refine;
    if refine.added_seeds > 0 {
        println!("added       {} points, where the result was too far from the input", refine.added_seeds);
    }
    if bounded && refine.missed > 0 {
        println!("missed      {} places are still farther than asked; more --max-points bring more", refine.missed);
    }
    if let Some(bytes) = report.memory.host_peak_bytes {
        let mib = |bytes: u64| bytes >> 20;
        println!("memory      {} MiB, {} MiB on the device", mib(bytes), mib(report.memory.device_bytes));
    }
    println!("time        {:.0} ms", report.timings_ms.total);
}

fn ms(since: Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1e3
}
