//! What a job is asked to do.
//!
//! Purpose: [`JobSpec`], with every option that the command line and the streams have.
//! Invariant: an option that is not set stays so, and means the default of the command line, which is read where the job is
//! done. Arrays are not here: they are blobs, named by their digests. New fields have a default, so that older records
//! are read; a field that is not known is refused.
//! Must not know: stores, messages, whether numbers make sense (`check`).

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::blob::Digest;
use geometry::cvt::density::{DensityOptions, DensitySource};
use geometry::remesh::{Placement, RemeshOptions, Seeds};

/// What a job is asked to do. [`check`](Self::check) makes a [`ValidSpec`](super::ValidSpec) of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JobSpec {
    /// The surface.
    pub mesh: MeshSource,
    /// The work.
    pub work: WorkSpec,
    /// Who should do it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub backend: Option<BackendName>,
    /// What the result comes as.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub result: Option<ResultFormat>,
    /// Jobs with a higher priority go first among those of their tenant; -100 to 100, 0 if not set.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub priority: Option<i32>,
    /// How long it may take.
    #[serde(default, skip_serializing_if = "Deadlines::is_empty")]
    pub deadlines: Deadlines,
    /// For the caller to find it again.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub labels: BTreeMap<String, String>,
    /// Whose it is.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub tenant: String,
    /// The same number and the same body give the same job again; empty if each request is a job of its own.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub request_id: String,
}

/// How long a job may take. Durations, so that the same request sent again is the same.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Deadlines {
    /// In the queue, milliseconds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub queue_ms: Option<u64>,
    /// At work, milliseconds, each attempt.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub run_ms: Option<u64>,
}

impl Deadlines {
    fn is_empty(&self) -> bool {
        *self == Self::default()
    }
}

/// The work of a job.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum WorkSpec {
    /// A whole remesh.
    Remesh(Box<RemeshWork>),
    /// A diagram.
    Rvd(RvdWork),
    /// A session without anybody at it: commands in a row.
    Cvt(CvtWork),
}

impl WorkSpec {
    /// "remesh", "rvd" or "cvt".
    pub fn name(&self) -> &'static str {
        match self {
            Self::Remesh(_) => "remesh",
            Self::Rvd(_) => "rvd",
            Self::Cvt(_) => "cvt",
        }
    }
}

/// Where the surface is.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum MeshSource {
    /// In a file as people have it.
    File {
        /// Its bytes.
        blob: Digest,
        /// What they are.
        format: MeshFormat,
        /// Whether a remesh carries over what the surface carries.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        attributes: Option<bool>,
    },
    /// In arrays as the streams send them.
    Arrays {
        /// Coordinates x y z of each vertex, F32 or F64.
        positions: ArrayRef,
        /// Three vertices of each facet, U32.
        facets: ArrayRef,
        /// What the surface carries and a remesh is to carry.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        attributes: Vec<AttributeRef>,
    },
}

/// The format of a surface's file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[allow(missing_docs)]
pub enum MeshFormat {
    Ply,
    Obj,
    Stl,
    Off,
    Vtk,
    Vtp,
    Msh,
    Mesh,
    Meshb,
    Glb,
    Gltf,
}

/// An array in a blob.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ArrayRef {
    /// Its bytes.
    pub blob: Digest,
    /// What they are.
    pub form: ArrayForm,
    /// Elements: vertices, facets, edges, values. 0 for text, whose lines are counted when it is read.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub count: u64,
}

fn is_zero(count: &u64) -> bool {
    *count == 0
}

/// The numbers of an array. Little-endian, packed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ArrayForm {
    /// IEEE 754 single precision.
    F32,
    /// IEEE 754 double precision.
    F64,
    /// Indices.
    U32,
    /// 0 to 255, colours only.
    U8,
    /// One element a line, as the command line's files of seeds, sizes and creases.
    Text,
}

/// What an attribute says of a surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AttributeKind {
    /// Normals.
    Normals,
    /// Texture coordinates, always by corner.
    TextureCoordinates,
    /// Colours of vertices.
    Colours,
    /// A number of each vertex, under a name.
    Scalar,
}

/// An attribute in blobs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AttributeRef {
    /// What it says.
    pub kind: AttributeKind,
    /// A scalar's name; empty for other kinds.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub name: String,
    /// The values.
    pub values: ArrayRef,
    /// Which value each corner of each facet has, U32; for normals and texture coordinates.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub corners: Option<ArrayRef>,
}

/// Which implementation should do the work.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BackendName {
    /// What the server was configured for.
    Auto,
    /// The GPU, or failure.
    Gpu,
    /// Double precision on all threads.
    Parallel,
    /// Double precision on one thread.
    Serial,
}

/// What the result comes as.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum ResultFormat {
    /// The surface as a file.
    File(MeshFormat),
    /// Arrays as the streams send them.
    Arrays,
}

/// Where seeds come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum SeedSource {
    /// They are drawn.
    Sampled {
        /// How many; as many as the density's edge lengths imply if not set.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        points: Option<u64>,
        /// The same number gives the same points everywhere.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        random_seed: Option<u64>,
    },
    /// Coordinates x y z of each seed, F32, F64 or text.
    Given(ArrayRef),
}

/// Where a density comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DensityKind {
    /// The same everywhere.
    Uniform,
    /// The given weights.
    Weights,
    /// The given edge lengths.
    EdgeLengths,
    /// Short edges where the surface bends.
    Curvature,
    /// Short edges where it is thin, hollow or sharp.
    FeatureSize,
}

/// How long edges should be, and where.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DensitySpec {
    /// Where it comes from; not set: the array that is given, else uniform.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source: Option<DensityKind>,
    /// Target edge length, where the points are not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub edge_length: Option<f64>,
    /// Target edge length of each vertex, F64 or text.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub edge_lengths: Option<ArrayRef>,
    /// Weight of each vertex, F64.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub weights: Option<ArrayRef>,
    /// From 0, uniform, to 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub adaptivity: Option<f64>,
    /// The most that lengths may grow per distance.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gradation: Option<f64>,
}

impl DensitySpec {
    pub(super) fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Where it comes from.
    pub fn kind(&self) -> DensityKind {
        match (self.source, self.edge_lengths, self.weights) {
            (Some(kind), ..) => kind,
            (None, Some(_), _) => DensityKind::EdgeLengths,
            (None, None, Some(_)) => DensityKind::Weights,
            (None, None, None) => DensityKind::Uniform,
        }
    }

    /// The same for the library, with the arrays that were read.
    pub fn options(&self, source: DensitySource) -> DensityOptions {
        let mut options = DensityOptions::from_source(source);
        options.edge_length = self.edge_length;
        options.adaptivity = self.adaptivity.unwrap_or(options.adaptivity);
        options.gradation = self.gradation.unwrap_or(options.gradation);
        options
    }
}

/// Where seeds go after each step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ProjectionRule {
    /// They stay where the step put them.
    Free,
    /// To the closest point of the surface.
    OnSurface,
}

/// Where the vertices of a remesh go.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PlacementRule {
    /// Where the facets between them are nearest to the input in the mean.
    Fitted,
    /// On the input.
    Surface,
    /// To the centroids of their cells.
    Centroids,
}

/// What happens to boundaries.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BoundaryRule {
    /// They get seeds of their own.
    Keep,
    /// The rim settles where cells end.
    Free,
}

/// What happens where the surface is thin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ThinRule {
    /// Edges become shorter there.
    Finer,
    /// Edges are as long as elsewhere.
    Even,
}

/// How much is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MeasureRule {
    /// Topology only.
    Topology,
    /// Topology, shape and distance.
    Full,
}

/// How far the result may be from the surface.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Tolerance {
    /// The caller's units.
    Length(f64),
    /// Percent of the diagonal of the surface's box.
    DiagonalPercent(f64),
}

/// Seeds that are added where the result is far from the surface.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RefineSpec {
    /// How far it may be.
    pub tolerance: Tolerance,
    /// The most seeds in all; not set: twice as many as at first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_points: Option<u64>,
}

/// A whole remesh.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RemeshWork {
    /// The first seeds.
    pub seeds: SeedSource,
    /// How long edges should be, and where.
    #[serde(default, skip_serializing_if = "DensitySpec::is_empty")]
    pub density: DensitySpec,
    /// Lloyd steps.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lloyd_steps: Option<u32>,
    /// Quasi-Newton steps after them, at most.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub newton_steps: Option<u32>,
    /// Where seeds go after each step.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub projection: Option<ProjectionRule>,
    /// Where vertices go.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub placement: Option<PlacementRule>,
    /// Edges bent by more than this are creases, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub crease_angle_deg: Option<f64>,
    /// Edges that are creases whatever their angle: two vertices each, U32 or text.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub creases: Option<ArrayRef>,
    /// What happens to boundaries.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub boundaries: Option<BoundaryRule>,
    /// What happens where the surface is thin.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub thin: Option<ThinRule>,
    /// Seeds that are added.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub refinement: Option<RefineSpec>,
    /// How much is measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measure: Option<MeasureRule>,
}

impl RemeshWork {
    /// From these seeds, with nothing else said.
    pub fn new(seeds: SeedSource) -> Self {
        Self {
            seeds,
            density: DensitySpec::default(),
            lloyd_steps: None,
            newton_steps: None,
            projection: None,
            placement: None,
            crease_angle_deg: None,
            creases: None,
            boundaries: None,
            thin: None,
            refinement: None,
            measure: None,
        }
    }

    /// The options that are numbers and rules, over the library's defaults. Creases, attributes and refinement need the
    /// surface and are left to who has read it.
    pub fn options(&self, seeds: Seeds, source: DensitySource) -> RemeshOptions {
        let usual = RemeshOptions::new(seeds);
        let steps = |given: Option<u32>, usual: usize| given.map_or(usual, |steps| steps as usize);
        RemeshOptions {
            density: self.density.options(source),
            lloyd: steps(self.lloyd_steps, usual.lloyd),
            newton: steps(self.newton_steps, usual.newton),
            projection: self.projection.map_or(usual.projection, ProjectionRule::projection),
            placement: self.placement.map_or(usual.placement, |placement| match placement {
                PlacementRule::Fitted => Placement::Fitted,
                PlacementRule::Surface => Placement::Surface,
                PlacementRule::Centroids => Placement::Centroids,
            }),
            crease_angle_deg: self.crease_angle_deg.unwrap_or(usual.crease_angle_deg),
            keep_boundaries: self.boundaries.map_or(usual.keep_boundaries, |rule| rule == BoundaryRule::Keep),
            keep_thin: self.thin.map_or(usual.keep_thin, |rule| rule == ThinRule::Finer),
            measure: self.measure.map_or(usual.measure, |rule| rule == MeasureRule::Full),
            // All are named, so that a new option is not forgotten here.
            seeds: usual.seeds,
            creases: usual.creases,
            refine: usual.refine,
            attributes: usual.attributes,
        }
    }
}

impl ProjectionRule {
    /// The same for the library.
    pub fn projection(self) -> geometry::cvt::Projection {
        match self {
            Self::Free => geometry::cvt::Projection::Free,
            Self::OnSurface => geometry::cvt::Projection::OnSurface,
        }
    }
}

/// What a diagram gives.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RvdOutput {
    /// The pieces.
    Cells,
    /// Centroids, one a seed.
    Centroids,
    /// Masses, areas and energies.
    Sums,
}

/// A diagram.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RvdWork {
    /// The seeds.
    pub seeds: SeedSource,
    /// Weight of each vertex, F64.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub weights: Option<ArrayRef>,
    /// What is wanted; none means cells.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub outputs: Vec<RvdOutput>,
}

/// A session's commands in a row.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CvtWork {
    /// The first seeds.
    pub seeds: SeedSource,
    /// How long edges should be, and where.
    #[serde(default, skip_serializing_if = "DensitySpec::is_empty")]
    pub density: DensitySpec,
    /// Where seeds go after each step.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub projection: Option<ProjectionRule>,
    /// Room for so many seeds; not set: as many as at first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_seeds: Option<u64>,
    /// What is done, in this order.
    pub commands: Vec<CvtCommand>,
}

/// A command of a session.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum CvtCommand {
    /// Take steps.
    Step {
        /// How many.
        iterations: u32,
        /// Which; not set: Lloyd's.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        kind: Option<StepKindName>,
        /// Whether seeds are a result; not set: not those of this command.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        seeds: Option<SendSeeds>,
    },
    /// Change the seeds: all of these or none.
    Edit {
        /// In this order.
        edits: Vec<SeedChange>,
        /// Whether seeds are a result.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        seeds: Option<SendSeeds>,
    },
}

/// Kinds of steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StepKindName {
    /// Every seed to the centroid of its cell.
    Lloyd,
    /// One quasi-Newton step.
    Lbfgs,
}

/// When seeds are a result. Those at the end always are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SendSeeds {
    /// Not at all.
    Never,
    /// After the command.
    Last,
    /// After each of its steps.
    Each,
}

/// One change of the seeds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum SeedChange {
    /// A seed goes to another place.
    Move {
        /// Which.
        index: u32,
        /// Where.
        to: [f64; 3],
    },
    /// A new seed, with the next index.
    Add([f64; 3]),
    /// The seed goes; the last one takes its index.
    Remove(u32),
}
