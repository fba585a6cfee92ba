//! `tessera remesh`'s options, as the message and as the library's.
//!
//! Invariant: options that are set become the message that a server would get, and the library's options are made of that, by
//! the checks of streams and jobs. Defaults in the help are the library's; a test compares them. Must not know: which backend
//! works, files but those that options name.

use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::builder::{PathBufValueParser, TypedValueParser};
use clap::{ArgGroup, Args, ValueHint};

use crate::exit::{BadInput, Usage};
use crate::files::{self, Surface};
use crate::given::{self, Given, Words, words};
use crate::picture::PictureArgs;
use crate::say::SayArgs;
use crate::server::{EndpointArgs, number};
use geometry::cvt::density::{DensityOptions, DensitySource};
use geometry::mesh::TriMesh;
use geometry::mesh::attributes::Attributes;
use geometry::mesh::features::Features;
use geometry::mesh::io::{Format, RegionChoice};
use geometry::mesh::motion::Motion;
use geometry::mesh::parts::{Part, PartError, Zone};
use geometry::mesh::plane::Plane;
use geometry::remesh::{Anisotropy, RemeshOptions, Seeds};
use geometry::token::Token;
use server::config::{BackendArgs, count, whole};
use wire::counts::Bounds;
use wire::options::{self, Beside, ByVertex};
use wire::proto::{self, BoundaryRule, NonManifoldRule, Placement, Projection, ThinRule};
use wire::{WireError, names};

#[derive(Args, Debug)]
#[command(group(ArgGroup::new("size").required(true).multiple(true).args(["points", "facets", "edge_length", "sizes", "metric"])))]
pub(crate) struct RemeshArgs {
    /// The surfaces.
    #[arg(required = true, value_name = "INPUT", help = files::help_of("The surface", "several with --out-dir; - is the \
        standard input, whose format --input-format says"))]
    pub(super) input: Vec<PathBuf>,
    #[command(flatten)]
    pub(super) files: FileArgs,
    #[command(flatten)]
    pub(super) size: Given<SizeArgs>,
    #[command(flatten)]
    pub(super) shape: Given<ShapeArgs>,
    #[command(flatten)]
    pub(super) steps: Given<StepArgs>,
    #[command(flatten, next_help_heading = "Picture")]
    pub(super) picture: PictureArgs,
    #[command(flatten, next_help_heading = "Backend")]
    pub(super) backend: BackendArgs,
    #[command(flatten, next_help_heading = "Backend")]
    pub(super) at: EndpointArgs,
    #[command(flatten, next_help_heading = "Messages")]
    pub(super) say: SayArgs,
}

#[derive(Args, Debug)]
#[command(next_help_heading = "Files")]
pub(super) struct FileArgs {
    /// Where the remesh goes; the extension is the format. A file that is there is replaced once the remesh is whole. - is
    /// the standard output, whose format --format says.
    #[arg(short, long, value_name = "OUTPUT", required_unless_present = "out_dir")]
    pub(super) output: Option<PathBuf>,
    /// Folder where the remeshes go, each under the name of its input; it is made if need be. For any number of inputs: one that
    /// fails stops no other, and each has a line of output.
    #[arg(long, value_name = "DIR", conflicts_with = "output")]
    pub(super) out_dir: Option<PathBuf>,
    /// Format of what is written, where the name does not say it.
    #[arg(long, value_name = "FORMAT", value_parser = files::format())]
    pub(super) format: Option<Format>,
    /// Format of what is read, where the name does not say it.
    #[arg(long, value_name = "FORMAT", value_parser = files::format())]
    pub(super) input_format: Option<Format>,
    /// Let the output replace the input.
    #[arg(long)]
    pub(super) overwrite: bool,
    /// Write the report there, as JSON.
    #[arg(long, value_name = "FILE.json")]
    pub(super) report: Option<PathBuf>,
    /// Array of the input whose whole numbers are the regions of its facets: a cell array or a property of faces. Regions that a file
    /// names as such, as materials and physical groups, are kept without it; ignore leaves them aside.
    #[arg(long, value_name = "NAME|ignore", value_parser = regions, conflicts_with = "no_attributes")]
    pub(super) regions: Option<RegionChoice>,
    /// Leave aside normals, texture coordinates, colours, scalars and regions of the input.
    #[arg(long)]
    pub(super) no_attributes: bool,
}

#[derive(Args, Debug)]
#[command(next_help_heading = "Size (--points, --facets, --edge-length, --sizes or --metric is required)")]
pub(crate) struct SizeArgs {
    /// Number of seeds, about the number of vertices of the result: 10000, 10k, or 50% of the input's vertices.
    #[arg(long, value_name = "N|P%", value_parser = points, allow_negative_numbers = true)]
    #[arg(conflicts_with_all = ["edge_length", "facets"])]
    pub(crate) points: Option<String>,
    /// About how many facets the result has, instead of --points.
    #[arg(long, value_name = "N", value_parser = count, allow_negative_numbers = true, conflicts_with = "edge_length")]
    pub(crate) facets: Option<u32>,
    /// Length of the edges, in the input's units, instead of --points. If --density is not uniform: as many points
    /// as edges of this length everywhere would need.
    #[arg(long, value_name = "H", value_parser = positive, conflicts_with = "sizes", allow_negative_numbers = true)]
    pub(crate) edge_length: Option<f64>,
    /// File with the length of the edges at each vertex of the input, one number a line in the order of the
    /// input's vertices. With --points only the ratios are kept.
    #[arg(long, value_name = "FILE")]
    pub(crate) sizes: Option<PathBuf>,
    /// File with a metric at each vertex of the input: edges get length 1 in it. Medit .sol, VTK point arrays of 6 or 9 numbers, .npy of
    /// shape (n, 6) or (n, 3, 3), or six numbers a line: m11 m12 m22 m13 m23 m33. With --points it is scaled for their number.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["sizes", "edge_length", "density", "gradation", "adaptivity"])]
    #[arg(conflicts_with_all = ["anisotropy", "max_deviation"])]
    pub(crate) metric: Option<PathBuf>,
    /// Where short edges go.
    #[arg(long, default_value = "uniform", value_parser = words(DENSITIES), conflicts_with = "sizes")]
    pub(crate) density: DensitySource,
    /// The most that edge lengths grow per distance.
    #[arg(long, value_name = "G", default_value_t = DensityOptions::default().gradation, value_parser = positive)]
    #[arg(allow_negative_numbers = true)]
    pub(crate) gradation: f64,
    /// Length of the edges in a part, as often as there are parts: box:X0,Y0,Z0,X1,Y1,Z1=H, sphere:X,Y,Z,R=H, facets:0-99=H, or a region:
    /// NAME=H. Around it lengths grow by --gradation.
    #[arg(long, value_name = "PART=H", value_parser = zone, allow_negative_numbers = true, conflicts_with = "metric")]
    pub(crate) size_in: Vec<Zone>,
    /// 0 for edges of one length, 1 for lengths as --density or --sizes says.
    #[arg(long, value_name = "A", default_value_t = DensityOptions::default().adaptivity)]
    #[arg(allow_negative_numbers = true)]
    pub(crate) adaptivity: f64,
    /// As few points as keep input and remesh this near at all samples of both, in percent of the bounding box's diagonal;
    /// for --placement fitted.
    #[arg(long, value_name = "PERCENT", value_parser = positive, allow_negative_numbers = true)]
    pub(crate) max_deviation: Option<f64>,
    /// The most points that --max-deviation may come to; twice --points if not given.
    #[arg(long, value_name = "N", requires = "max_deviation", value_parser = count)]
    pub(crate) max_points: Option<u32>,
}

impl SizeArgs {
    /// Which arrays are given.
    pub(crate) fn beside(&self) -> Beside {
        Beside { edge_lengths: self.sizes.is_some(), metric: self.metric.is_some(), ..Beside::default() }
    }
}

#[derive(Args, Debug)]
#[command(next_help_heading = "Shape of the result")]
pub(crate) struct ShapeArgs {
    /// Edges bent by more than this are creases that the remesh keeps; 0 keeps none.
    #[arg(long, value_name = "DEGREES", default_value_t = RemeshOptions::usual().crease_angle_deg)]
    #[arg(value_parser = angle, allow_negative_numbers = true)]
    pub(crate) crease_angle: f64,
    /// File with edges that are creases whatever their angle: the numbers of two vertices of the input a line, from 0. Or
    /// strict: refuse if a crease or a boundary cannot be kept; ./strict is a file of that name. May be repeated.
    #[arg(long, value_name = "FILE|strict", value_parser = creases(), value_hint = ValueHint::AnyPath)]
    pub(crate) creases: Vec<Creases>,
    /// Join boundaries that are at most this far apart: a length, or percent of the bounding box's diagonal, as 0.01%.
    #[arg(long, value_name = "DISTANCE", value_parser = distance, allow_negative_numbers = true)]
    pub(crate) weld: Option<String>,
    /// What happens at edges of three or more facets, where sheets meet.
    #[arg(long, default_value = "cut", value_parser = words(NON_MANIFOLD))]
    pub(crate) non_manifold: NonManifoldRule,
    /// Part that stays as it is, to the bit; as often as there are parts: box:X0,Y0,Z0,X1,Y1,Z1 or sphere:X,Y,Z,R with the facets that
    /// touch it, facets:0-99,205 or facets:@FILE, vertices:7,12 for vertices alone, or a region by its name or number. The result begins
    /// with its facets.
    #[arg(long, value_name = "PART", value_parser = part, allow_negative_numbers = true)]
    pub(crate) keep: Vec<Part>,
    /// Part that is remeshed, as for --keep, with the facets that are in a box or ball wholly; all else stays as it is.
    #[arg(long, value_name = "PART", value_parser = part, allow_negative_numbers = true)]
    pub(crate) only: Vec<Part>,
    /// Leave the vertices and edges of boundaries as they are.
    #[arg(long)]
    pub(crate) keep_rims: bool,
    /// Make the result symmetric at a plane: x, y or z, x=C for the coordinate C, or NX,NY,NZ,D. The half that the normal points to is
    /// remeshed (-x: the one with the smaller x), and the other half is its mirror image, to the bit.
    #[arg(long, value_name = "PLANE", allow_hyphen_values = true)]
    pub(crate) mirror: Option<Plane>,
    /// Motion that takes boundaries of the surface to others, as often as there are motions: translate:DX,DY,DZ, or rotate:DEGREES,AXIS
    /// with the axis x, y, z, DX,DY,DZ, or DX,DY,DZ,PX,PY,PZ through a place. Both get the same vertices and edges, moved.
    #[arg(long, value_name = "MOTION")]
    pub(crate) periodic: Vec<Motion>,
    /// Write where on the input each vertex lies: the scalars source_facet and source_barycentric.
    #[arg(long)]
    pub(crate) source_map: bool,
    /// What happens to the boundaries of an open surface.
    #[arg(long, default_value = "keep", value_parser = words(BOUNDARIES))]
    pub(crate) boundaries: BoundaryRule,
    /// What happens where the surface is too thin for edges as long as elsewhere.
    #[arg(long, default_value = "finer", value_parser = words(THIN))]
    pub(crate) thin: ThinRule,
    /// Longer facets where the surface bends less: by how much normals lift the surface, as a share of its diagonal, 0 to 10, or
    /// auto, by its curvature.
    #[arg(long, value_name = "S|auto", default_value = "0", value_parser = lift, allow_negative_numbers = true)]
    pub(crate) anisotropy: String,
    /// Where the vertices of the remesh go.
    #[arg(long, default_value = "fitted", value_parser = words(PLACEMENTS))]
    pub(crate) placement: Placement,
}

impl ShapeArgs {
    /// Files with edges that are creases.
    pub(crate) fn crease_files(&self) -> impl Iterator<Item = &Path> {
        self.creases.iter().filter_map(|given| match given {
            Creases::File(path) => Some(path.as_path()),
            Creases::Strict => None,
        })
    }

    pub(crate) fn has_crease_files(&self) -> bool {
        self.crease_files().next().is_some()
    }
}

/// What is said of creases.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Creases {
    /// None is dropped, and no boundary either.
    Strict,
    /// A file names edges.
    File(PathBuf),
}

impl From<PathBuf> for Creases {
    fn from(path: PathBuf) -> Self {
        if path.as_os_str() == "strict" { Self::Strict } else { Self::File(path) }
    }
}

fn creases() -> impl TypedValueParser<Value = Creases> {
    PathBufValueParser::new().map(Creases::from)
}

#[derive(Args, Debug)]
#[command(next_help_heading = "Steps")]
pub(crate) struct StepArgs {
    /// Lloyd steps.
    #[arg(long, value_name = "N", default_value_t = RemeshOptions::usual().lloyd as u32, value_parser = whole::<u32>)]
    pub(crate) lloyd: u32,
    /// Quasi-Newton (L-BFGS) steps after them, at most; they end when converged.
    #[arg(long, value_name = "N", default_value_t = RemeshOptions::usual().newton as u32, value_parser = whole::<u32>)]
    pub(crate) newton: u32,
    /// Where seeds go after each step. They end on the surface either way.
    #[arg(long, default_value = "free", value_parser = words(PROJECTIONS))]
    pub(crate) projection: Projection,
    /// Random seed of the first points.
    #[arg(long, value_name = "N", default_value_t = Seeds::RANDOM_SEED, value_parser = whole::<u64>)]
    pub(crate) seed: u64,
}

/// Where short edges go.
pub(crate) const DENSITIES: Words<DensitySource> = &[
    ("uniform", "Edges of one length", DensitySource::Uniform),
    ("curvature", "Where the surface bends", DensitySource::Curvature),
    ("lfs", "Where the surface is thin, hollow or sharp: local feature size", DensitySource::FeatureSize),
    ("error", "Where it lowers the mean distance most; for --anisotropy", DensitySource::Error),
    ("error-max", "Where it lowers the largest distance most; for --anisotropy", DensitySource::ErrorMax),
];

fn regions(text: &str) -> Result<RegionChoice, String> {
    match text {
        "" => Err("the name of an array is needed, or ignore".to_owned()),
        "ignore" => Ok(RegionChoice::Ignore),
        name => Ok(RegionChoice::Array(name.to_owned())),
    }
}

fn positive(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number: &f64| number.is_finite() && *number > 0.0);
    number.ok_or_else(|| "a finite number above 0 is needed".to_owned())
}

fn angle(text: &str) -> Result<f64, String> {
    number(text, 0.0..=180.0, "an angle from 0 to 180 is needed")
}

fn distance(text: &str) -> Result<String, String> {
    positive(text.trim().strip_suffix('%').unwrap_or(text)).map(|_| text.to_owned())
}

/// A part, whose list of numbers may be in a file: `facets:@FILE`.
fn part(text: &str) -> Result<Part, String> {
    listed(text)?.parse().map_err(|error: PartError| error.to_string())
}

/// The text of a part, with the numbers of the file that it names.
fn listed(text: &str) -> Result<String, String> {
    let in_file = |kind: &str| Some((kind.to_owned(), text.strip_prefix(kind)?.strip_prefix('@')?));
    let Some((kind, path)) = ["facets:", "vertices:"].into_iter().find_map(in_file) else { return Ok(text.to_owned()) };
    let list = std::fs::read_to_string(path).map_err(|cause| format!("{path}: {cause}"))?;
    let lines = list.lines().map(|line| line.split('#').next().unwrap_or_default());
    let is_between = |c: char| c == ',' || c.is_whitespace();
    let numbers: Vec<&str> = lines.flat_map(|line| line.split(is_between)).filter(|n| !n.is_empty()).collect();
    Ok(kind + &numbers.join(","))
}

fn zone(text: &str) -> Result<Zone, String> {
    let text = match text.rsplit_once('=') {
        Some((part, length)) => format!("{}={length}", listed(part)?),
        None => text.to_owned(),
    };
    text.parse().map_err(|error: PartError| error.to_string())
}

fn lift(text: &str) -> Result<String, String> {
    if text != "auto" {
        number(text, Anisotropy::SHARES, "a share of the diagonal from 0 to 10 is needed, or auto")?;
    }
    Ok(text.to_owned())
}

const BOUNDARIES: Words<BoundaryRule> = &[
    ("keep", "They get vertices of their own and stay where they are", BoundaryRule::Keep),
    ("free", "The rim settles where the cells end, about half an edge inside", BoundaryRule::Free),
];
const NON_MANIFOLD: Words<NonManifoldRule> = &[
    (
        "cut",
        "Each sheet has vertices of its own there, in the same places: the result is a manifold",
        NonManifoldRule::Cut,
    ),
    ("keep", "The sheets have these vertices in common, as in the input", NonManifoldRule::Keep),
];
const THIN: Words<ThinRule> = &[
    (
        "finer",
        "Edges become shorter there, so that horns, fingers, strips and bridges stay. Not if --sizes says how long they are",
        ThinRule::Finer,
    ),
    ("even", "Edges are as long as elsewhere; what is too thin for them may be missing", ThinRule::Even),
];
const PROJECTIONS: Words<Projection> = &[
    ("free", "Where the step takes them, near the surface", Projection::Free),
    (
        "surface",
        "To the closest point of the surface; a quasi-Newton step then begins without a history",
        Projection::Surface,
    ),
];
const PLACEMENTS: Words<Placement> = &[
    ("fitted", "Where the facets between them are nearest to the input in the mean", Placement::Fitted),
    ("surface", "On the input surface", Placement::Surface),
    ("centroids", "To the centroids of their cells", Placement::Centroids),
];

/// The options that are set, as a message.
pub(crate) fn message(
    size: &Given<SizeArgs>,
    shape: &Given<ShapeArgs>,
    steps: &Given<StepArgs>,
) -> Result<proto::RemeshOptions> {
    let mut message = given::message(&[&size.set, &shape.set, &steps.set])?;
    // The numbers of files, not their names.
    (message.keep, message.only) = (texts(&shape.keep), texts(&shape.only));
    message.strict_creases = shape.creases.contains(&Creases::Strict);
    if let Some(density) = &mut message.density {
        density.size_in = texts(&size.size_in);
    }
    Ok(message)
}

fn texts<T: ToString>(all: &[T]) -> Vec<String> {
    all.iter().map(T::to_string).collect()
}

/// A number of points, or percent of the vertices.
pub(crate) fn points(text: &str) -> Result<String, String> {
    match text.trim().strip_suffix('%') {
        Some(percent) => positive(percent).map(|_| text.to_owned()),
        None => count(text).map(|_| text.to_owned()),
    }
}

pub(crate) fn usage(error: WireError) -> anyhow::Error {
    let text = error.under("options").to_string();
    Usage(names::in_text(&text, flag).unwrap_or(text)).into()
}

/// `max_points` as `--max-points`. Percent of the vertices are given as points.
pub(crate) fn flag(name: &str) -> String {
    let name = name.strip_suffix("_percent").unwrap_or(name);
    format!("--{}", name.replace('_', "-"))
}

impl RemeshArgs {
    /// The options that are set, and the library's of them. Arrays are empty. Errors: what cannot be whatever the surface.
    pub(crate) fn asked(&self) -> Result<(proto::RemeshOptions, RemeshOptions)> {
        let message = message(&self.size, &self.shape, &self.steps)?;
        let beside = self.size.beside();
        let options = options::remesh(&message, beside, &Bounds::of_library()).map_err(usage)?;
        Ok((message, options))
    }

    /// The same of `mesh`, which carries `attributes`, and whose file names `creases`.
    pub(crate) fn options(
        &self,
        mesh: &TriMesh,
        attributes: Option<Attributes>,
        creases: Vec<[u32; 2]>,
    ) -> Result<(proto::RemeshOptions, RemeshOptions)> {
        let (message, mut options) = self.asked()?;
        // Lists go by the vertices of the one input.
        let path = self.input.first().map_or(Path::new(""), PathBuf::as_path);
        let input = &Surface::new(path, self.files.input_format);
        let lengths = self.size.sizes.as_ref().map(|path| files::read_lengths(path, input, mesh)).transpose()?;
        let metric = self.size.metric.as_ref().map(|path| files::read_metric(path, input, mesh)).transpose()?;
        let arrays = ByVertex { edge_lengths: lengths, metric, ..ByVertex::default() };
        options::fill(&mut options, Vec::new(), arrays);
        files::renumber(&mut options.keep, input, mesh)?;
        options.creases = creases;
        for path in self.shape.crease_files() {
            let edges = files::read_edges(path, input, mesh)?;
            // Before a server is asked.
            Features::check(mesh, options.crease_angle_deg, &edges, &Token::default())
                .map_err(|e| BadInput(format!("{}: {e} (numbers of the surface as it was read)", path.display())))?;
            options.creases.extend(edges);
        }
        options.attributes = attributes;
        Ok((message, options))
    }
}
