//! `tessera measure`: how good a mesh is, and how far it is from another.
//!
//! Purpose: the figures of a remesh for meshes that any program made. Must not know: how a remesh is made.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::Args;
use serde::Serialize;

use super::exit::{BadInput, NotWritten, Usage};
use super::picture::PictureArgs;
use super::say::SayArgs;
use super::{files, interrupt, say};
use geometry::cvt::density::check_metric;
use geometry::mesh::TriMesh;
use geometry::mesh::attributes::Attributes;
use geometry::mesh::crossings::{Crossings, crossings};
use geometry::mesh::io::{Format, RegionChoice};
use geometry::mesh::measure::{Quality, Topology, quality_and_distances, topology};
use geometry::mesh::metric::{MetricField, MetricFigures};
use geometry::token::{Stopped, Token};

/// Measure a mesh: its triangles, its topology, and how far it is from the mesh that it was made from.
///
/// Distances are Hausdorff and root mean square, both ways, in percent of the diagonal of ORIGINAL's box, at 100,000 random
/// points and all vertices of each surface.
#[derive(Args, Clone, Debug)]
pub(crate) struct MeasureArgs {
    /// The mesh to compare with; - is the standard input.
    #[arg(value_name = "ORIGINAL")]
    pub(crate) original: PathBuf,
    /// The mesh to measure, or -; without it, ORIGINAL itself is measured.
    #[arg(value_name = "REMESH")]
    pub(crate) remesh: Option<PathBuf>,
    /// Format of the standard input.
    #[arg(long, value_name = "FORMAT", value_parser = files::format())]
    pub(crate) input_format: Option<Format>,
    /// File with a metric at each vertex of ORIGINAL, as of remesh: the lengths of edges and the shapes of facets in it.
    #[arg(long, value_name = "FILE")]
    pub(crate) metric: Option<PathBuf>,
    #[command(flatten, next_help_heading = "Picture")]
    pub(crate) picture: PictureArgs,
    #[command(flatten)]
    pub(crate) say: SayArgs,
}

#[derive(Serialize)]
struct Measured {
    original: Surface,
    #[serde(skip_serializing_if = "Option::is_none")]
    remesh: Option<Surface>,
    quality: Quality,
    #[serde(skip_serializing_if = "Option::is_none")]
    metric: Option<MetricFigures>,
}

#[derive(Serialize)]
struct Surface {
    file: String,
    vertices: usize,
    facets: usize,
    area: f64,
    #[serde(flatten)]
    topology: Topology,
    crossings: Crossings,
}

impl Surface {
    fn new(path: &Path, mesh: &TriMesh, token: &Token) -> Result<Self, Stopped> {
        Ok(Self {
            file: path.display().to_string(),
            vertices: mesh.positions().len(),
            facets: mesh.facets().len(),
            area: mesh.area(),
            topology: topology(mesh),
            crossings: crossings(mesh, token)?,
        })
    }

    fn tell(&self, what: &str) -> Result<(), NotWritten> {
        let Self { file, vertices, facets, topology, .. } = self;
        let Topology { euler, components, boundary_loops, non_manifold_edges, non_manifold_vertices, .. } = topology;
        outln!(
            "{what:<12}{file}: {vertices} vertices, {facets} facets, χ {euler}, {components} components, {boundary_loops} boundaries"
        )?;
        if self.crossings.count > 0 {
            let [x, y, z] = self.crossings.places.first().copied().unwrap_or_default();
            outln!("            {} facets cross others, the first at {x:.4} {y:.4} {z:.4}", self.crossings.count)?;
        }
        if non_manifold_edges + non_manifold_vertices > 0 {
            outln!("            {non_manifold_edges} edges and {non_manifold_vertices} vertices are not manifold")?;
        }
        Ok(())
    }
}

pub(crate) fn run(args: &MeasureArgs) -> Result<()> {
    let token = Token::default();
    interrupt::cancel_on_signal(&token).context("cannot listen for signals")?;
    // The names of files say their formats.
    let named = |path: &PathBuf| files::Surface::new(path, args.input_format.filter(|_| path.as_os_str() == "-"));
    let read = |surface: &files::Surface| match args.picture.wants_regions() {
        true => surface.read_loaded(&RegionChoice::Named).map(|loaded| (loaded.mesh, loaded.attributes)),
        false => Ok((surface.read_mesh()?, None)),
    };
    if [Some(&args.original), args.remesh.as_ref()].into_iter().flatten().filter(|path| path.as_os_str() == "-").count()
        > 1
    {
        return Err(Usage("the standard input can be only one of the two".to_owned()).into());
    }
    args.picture.check()?;
    let surface = named(&args.original);
    args.metric.iter().try_for_each(|_| files::check_numbered(&surface, "--metric"))?;
    let (original, own) = read(&surface)?;
    let remesh = args.remesh.as_ref().map(|path| Ok::<_, anyhow::Error>((path, read(&named(path))?))).transpose()?;
    let (result, attributes) = remesh.as_ref().map_or((&original, &own), |(_, (mesh, carried))| (mesh, carried));
    let (quality, _) = quality_and_distances(&original, None, result, &token)?;
    let metric = args.metric.as_ref().map(|path| in_metric(path, (&surface, &original), result, &token)).transpose()?;
    args.picture.draw(result, attributes.as_ref().and_then(Attributes::regions), &[])?;
    let measured = Measured {
        original: Surface::new(&args.original, &original, &token)?,
        remesh: remesh.map(|(path, (mesh, _))| Surface::new(path, &mesh, &token)).transpose()?,
        quality,
        metric,
    };
    if args.say.json {
        say::json(&serde_json::to_value(&measured)?)?;
    }
    if args.say.summary() {
        measured.tell()?;
    }
    Ok(())
}

/// The figures of `result` in the metric that a file has for `original`.
fn in_metric(
    path: &Path,
    (surface, original): (&files::Surface, &TriMesh),
    result: &TriMesh,
    token: &Token,
) -> Result<MetricFigures> {
    let tensors = files::read_metric(path, surface, original)?;
    check_metric(&tensors, original.positions().len(), token)
        .map_err(|error| BadInput(format!("{}: {error}", path.display())))?;
    Ok(MetricFigures::of(&MetricField::new(original, &tensors, token)?, result, token)?)
}

impl Measured {
    fn tell(&self) -> Result<(), NotWritten> {
        self.original.tell("original")?;
        let Quality {
            q_min, q_avg, theta_min_deg, under_30_percent, v567_percent, hausdorff_percent, rms_percent, ..
        } = self.quality;
        if let Some(remesh) = &self.remesh {
            remesh.tell("remesh")?;
            outln!("distance    Hausdorff {hausdorff_percent:.3} %, RMS {rms_percent:.4} % of the diagonal")?;
        }
        outln!(
            "triangles   Q {q_min:.3} at least, {q_avg:.3} in the mean; angles {theta_min_deg:.1}° at least, {under_30_percent:.2} % under 30°"
        )?;
        if let Some(MetricFigures { unit_edges_percent, edge_least, edge_largest, quality_least, .. }) = self.metric {
            outln!(
                "metric      {unit_edges_percent:.2} % of the edges from 0.71 to 1.41, all from {edge_least:.2} to {edge_largest:.2}; shapes {quality_least:.3} at least"
            )?;
        }
        outln!("valence     {v567_percent:.2} % of the inner vertices have 5 to 7 neighbours")
    }
}
