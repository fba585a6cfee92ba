//! The remesh: options, result, errors, and the call.
//!
//! Purpose: one call from a surface and a count to a new surface and a report. The rooms below do the work: `pipeline` has
//! the stages in their order, `features` the curves to keep, `manifold` the combinatorics, `fit` the placement of the
//! vertices, `improve` local changes, `metric` unit edges in a metric, `distance` the distances between both surfaces, `attributes` what the mesh carries.
//! Invariant: the result is oriented as the input; what could not be kept is in the report.
//! Must not know: files, jobs, the network.

pub mod attributes;
mod constants;
mod distance;
mod features;
mod fit;
mod improve;
mod lift;
mod manifold;
mod metric;
mod pipeline;
pub mod report;
mod triangle;
mod warnings;

use glam::DVec3;

use crate::cvt::density::{Count, DensityError, DensityOptions, DensitySource};
use crate::cvt::{Iteration, Projection};
use crate::mesh::TriMesh;
use crate::mesh::adjacency::{Adjacency, EdgeKind};
use crate::mesh::attributes::{AttributeError, Attributes};
use crate::mesh::features::FeatureError;
use crate::mesh::measure::{Topology, topology_unless};
use crate::mesh::motion::Motion;
use crate::mesh::parts::{Part, PartError};
use crate::mesh::plane::Plane;
use crate::rvd::RvdError;
use crate::token::{Stopped, Token};

pub use attributes::Provenance;
pub use pipeline::remesh;
pub use report::{Report, Warning};

/// Most of what a remesh does may fail so.
type Result<T, E = RemeshError> = std::result::Result<T, E>;

/// Where the first seeds come from.
#[derive(Clone, Debug)]
pub enum Seeds {
    /// Drawn on the surface ∝ √w and spread out ([`crate::mesh::sample::spread`]).
    Sample {
        /// How many.
        points: usize,
        /// Random seed: the same number gives the same points everywhere.
        seed: u64,
    },
    /// Given, in the caller's coordinates.
    Given(Vec<DVec3>),
    /// As many as the edge lengths of the density imply, drawn as `Sample`.
    Implied {
        /// Random seed.
        seed: u64,
    },
    /// As many as go with the surface, drawn as `Sample`. For a remesh.
    Share {
        /// How many, by the surface.
        of: Share,
        /// Random seed.
        seed: u64,
    },
}

/// A number of points by the surface that is remeshed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Share {
    /// Percent of its vertices, above 0.
    Percent(f64),
    /// As many as make about so many facets.
    Facets(usize),
}

impl Share {
    /// The number of points, at least 1. Of `F` facets with edges of length `h`, on a surface of Euler characteristic `χ` with
    /// boundaries of length `L`, there are `(F + L/h) / 2 + χ` vertices, by Euler's formula.
    pub fn points(self, mesh: &TriMesh) -> usize {
        let Self::Facets(facets) = self else { return self.of_vertices(mesh.positions().len()) };
        let adjacency = Adjacency::new(mesh);
        let topology = topology_unless(mesh, &adjacency, &Token::default()).unwrap_or_default();
        let length = |half_edge: usize| {
            let corners = mesh.corners(half_edge / 3);
            corners[half_edge % 3].distance(corners[(half_edge + 1) % 3])
        };
        let half_edges = 0..3 * mesh.facets().len();
        let boundary: f64 = half_edges.filter(|&h| adjacency.kind(h) == EdgeKind::Boundary).map(length).sum();
        // Of equilateral triangles.
        let edge = (4.0 / 3f64.sqrt() * mesh.area() / facets.max(1) as f64).sqrt();
        let on_boundary = if edge > 0.0 { boundary / edge } else { 0.0 };
        (0.5 * (facets as f64 + on_boundary) + topology.euler as f64).round().max(1.0) as usize
    }

    /// About as many, for a surface with so many vertices.
    pub fn of_vertices(self, vertices: usize) -> usize {
        match self {
            Self::Percent(percent) => (percent / 100.0 * vertices as f64).round().max(1.0) as usize,
            Self::Facets(facets) => facets / 2 + 1,
        }
    }
}

impl Seeds {
    /// The default random seed.
    pub const RANDOM_SEED: u64 = 0;

    /// How many seeds there will be.
    pub fn count(&self) -> Count {
        match self {
            Self::Sample { points, .. } => Count::Points(*points),
            Self::Given(seeds) => Count::Points(seeds.len()),
            Self::Implied { .. } | Self::Share { .. } => Count::Implied,
        }
    }

    /// How many are drawn, if that is said as a number.
    pub fn drawn(&self) -> Option<usize> {
        if let Self::Sample { points, .. } = self { Some(*points) } else { None }
    }

    /// The random seed of drawn ones; the default for given ones.
    pub fn random_seed(&self) -> u64 {
        match self {
            Self::Sample { seed, .. } | Self::Implied { seed } | Self::Share { seed, .. } => *seed,
            Self::Given(_) => Self::RANDOM_SEED,
        }
    }

    /// A share as the number of points that it is for `mesh`; others as they are.
    pub fn resolve(&mut self, mesh: &TriMesh) {
        if let &mut Self::Share { of, seed } = self {
            *self = Self::Sample { points: of.points(mesh), seed };
        }
    }
}

/// Where the result's vertices go.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Placement {
    /// To where the mean distance of the facets from the input is least, a little off the surface.
    #[default]
    Fitted,
    /// To their seeds, on the surface.
    Surface,
    /// To the centroids of their restricted cells, a little inside where the surface bulges.
    Centroids,
}

/// How much longer cells may be along the direction in which the surface bends least.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Anisotropy {
    /// Cells as wide as long.
    #[default]
    None,
    /// Cells are as wide as long on the surface lifted by its normals times this share of the bounding box's diagonal (Lévy and
    /// Bonneel 2012): a cell where the curvatures are k₁ and k₂ is √((1 + s²k₁²) / (1 + s²k₂²)) times as long as wide.
    Share(f64),
    /// As long as the best triangles for their number are, √(k₁/k₂), where the surface is curved twice, and up to eight times as
    /// long as wide where it bends one way: the length of the lift is |k₁k₂|^(-1/2), and at most √63/k₁.
    Auto,
}

impl Anisotropy {
    /// The shares that there may be. With the diagonal itself a sphere's cells are already as long as wide again.
    pub const SHARES: std::ops::RangeInclusive<f64> = 0.0..=10.0;
}

/// A bound on the distance of result and input. Needs [`Placement::Fitted`].
///
/// The distance is measured both ways, at samples of facets, edges and vertices. Drawn seeds are drawn again, up to nine times,
/// with shorter edges where the last result was too far; rounds go on while points and progress remain. A result that is still
/// too far is never farther than as many points with a uniform density or one by curvature. Once the bound is reached, up to ten
/// rounds have longer edges where the result is nearer than that, as long as points are saved. The number of seeds that is asked
/// for does not matter then, but for the default of `max_points`. Edge lengths that are given are never longer than given. Given
/// seeds stay, and seeds are added to them. [`report::RefineFigures::ended`] says what ended it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Refine {
    /// The largest distance between input and result. The report's `refine.out_of_tolerance` counts samples farther away.
    pub tolerance: Tolerance,
    /// The most seeds in all: at least as many as there are at first; twice as many if not set.
    pub max_points: Option<usize>,
}

/// How far a result may be from its input, above 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Tolerance {
    /// Caller's units.
    Length(f64),
    /// Percent of the diagonal of the input's bounding box.
    DiagonalPercent(f64),
}

impl Tolerance {
    /// Caller's units, for `mesh`.
    fn length(self, mesh: &TriMesh) -> f64 {
        match self {
            Self::Length(length) => length,
            Self::DiagonalPercent(percent) => {
                // Scaled, so that no square overflows.
                let (low, high) = mesh.bounds();
                let extent = (high - low).max_element();
                percent / 100.0 * (((high - low) / extent).length() * extent)
            }
        }
    }
}

impl Refine {
    /// Adds points until nothing is farther away than `tolerance`, or until there are twice as many as at first.
    pub fn new(tolerance: Tolerance) -> Self {
        Self { tolerance, max_points: None }
    }

    setters! { with_max_points(max_points: usize => Some(max_points)) }
}

/// A [`Refine`] whose numbers are known.
#[derive(Clone, Copy, Debug)]
struct Limits {
    tolerance: f64,
    max_points: usize,
}

impl From<Limits> for Refine {
    fn from(Limits { tolerance, max_points }: Limits) -> Self {
        Self::new(Tolerance::Length(tolerance)).with_max_points(max_points)
    }
}

/// What to do. Everything but the seeds has a default. The command and the service read their defaults here.
///
/// ```
/// use tessera::{DensityOptions, DensitySource, RemeshOptions, Seeds};
/// let density = DensityOptions::from_source(DensitySource::Curvature).with_gradation(0.5);
/// let options = RemeshOptions::new(Seeds::Sample { points: 5_000, seed: 1 }).with_density(density).with_newton(50);
/// ```
#[derive(Clone, Debug)]
pub struct RemeshOptions {
    /// First seeds.
    pub seeds: Seeds,
    /// Lloyd steps; 5 by default.
    pub lloyd: usize,
    /// Quasi-Newton steps after them, at most. A test of convergence may end them earlier. 30 by default.
    pub newton: usize,
    /// How long edges should be, and where.
    pub density: DensityOptions,
    /// Where seeds go after each step. The last step always ends on the surface.
    pub projection: Projection,
    /// Where the result's vertices go.
    pub placement: Placement,
    /// Edges bent by more than this are creases, which the result keeps, degrees; 0 finds none, 30 by default. Creases and
    /// boundaries get seeds of their own where seeds are drawn; given seeds stay as they are.
    pub crease_angle_deg: f64,
    /// Edges that are creases whatever their angle, two vertices each.
    pub creases: Vec<[u32; 2]>,
    /// Adds seeds where the result is too far from the input; `None` adds none.
    pub refine: Option<Refine>,
    /// Whether boundaries get seeds of their own, so that they do not shrink.
    pub keep_boundaries: bool,
    /// Whether edges become shorter where the surface is too thin for their length, so that horns, fingers and bridges
    /// stay. Only where seeds are drawn, and not for lengths or weights that are given.
    pub keep_thin: bool,
    /// How far boundaries may be apart that are joined, up to 0.4 of their edges. `None` joins only what rounding separates.
    pub weld: Option<Tolerance>,
    /// Whether sheets that meet in edges of three or more facets have their vertices there in common, as the input has. Otherwise
    /// each sheet has its own, in the same places.
    pub keep_non_manifold: bool,
    /// Parts that stay as they are: their facets come first in the result, with the vertices and the order that they have. Facets that
    /// touch a box or a ball are of it. The number of points counts all vertices of the result. Sheets that meet have their vertices in
    /// common, as for [`Self::keep_non_manifold`].
    pub keep: Vec<Part>,
    /// Parts that are remeshed; all else stays as for [`Self::keep`]. Facets are of a box or a ball if they are in it wholly. All of the
    /// surface if empty.
    pub only: Vec<Part>,
    /// Whether boundaries keep their vertices and edges.
    pub keep_rims: bool,
    /// Whether a remesh is refused that would drop a crease or a boundary ([`RemeshError::CreasesDropped`]), or lack an edge of one
    /// ([`RemeshError::CreasesBroken`]). Otherwise the report counts both. Where seeds are given no curve is sought.
    pub strict_creases: bool,
    /// A plane at which the result is symmetric: the half of the surface that its normal points to is remeshed, and the other half is its
    /// mirror image ([`Plane::reflect`]). Vertices of the seam are in the plane, and both halves have them.
    pub mirror: Option<Plane>,
    /// Motions that take boundaries of the surface to others: the result has the same vertices and edges on both, moved
    /// ([`Motion::apply`]).
    pub periodic: Vec<Motion>,
    /// How long cells may be along the surface's lines of least curvature.
    pub anisotropy: Anisotropy,
    /// Whether to measure the result (Hausdorff distance and the like) for the report.
    pub measure: bool,
    /// Whether the result carries where on the input its vertices lie: the scalars `source_facet`, a number from 0, and
    /// `source_barycentric`, three coordinates in that facet. They take the place of others of these names.
    pub source_map: bool,
    /// What `mesh` carries and the result is to carry. Some, even if empty, asks for the provenance too.
    pub attributes: Option<Attributes>,
}

impl RemeshOptions {
    /// The default of [`Self::crease_angle_deg`].
    pub const CREASE_ANGLE_DEG: f64 = 30.0;

    /// The defaults: 5 Lloyd steps and up to 30 quasi-Newton steps of a uniform density, measured.
    pub fn new(seeds: Seeds) -> Self {
        Self {
            seeds,
            lloyd: 5,
            newton: 30,
            density: DensityOptions::default(),
            projection: Projection::Free,
            placement: Placement::Fitted,
            crease_angle_deg: Self::CREASE_ANGLE_DEG,
            creases: Vec::new(),
            weld: None,
            keep_non_manifold: false,
            keep: Vec::new(),
            only: Vec::new(),
            keep_rims: false,
            strict_creases: false,
            mirror: None,
            periodic: Vec::new(),
            refine: None,
            keep_boundaries: true,
            keep_thin: true,
            anisotropy: Anisotropy::None,
            measure: true,
            source_map: false,
            attributes: None,
        }
    }

    /// The defaults, for a caller that has no seeds yet.
    pub fn usual() -> Self {
        Self::new(Seeds::Implied { seed: Seeds::RANDOM_SEED })
    }

    setters! {
        with_seeds(seeds: Seeds),
        with_lloyd(lloyd: usize),
        with_newton(newton: usize),
        with_density(density: DensityOptions),
        with_projection(projection: Projection),
        with_placement(placement: Placement),
        with_crease_angle_deg(crease_angle_deg: f64),
        with_creases(creases: Vec<[u32; 2]>),
        with_weld(weld: Tolerance => Some(weld)),
        with_keep_non_manifold(keep_non_manifold: bool),
        with_keep(keep: Vec<Part>),
        with_only(only: Vec<Part>),
        with_keep_rims(keep_rims: bool),
        with_strict_creases(strict_creases: bool),
        with_mirror(mirror: Plane => Some(mirror)),
        with_periodic(periodic: Vec<Motion>),
        with_refine(refine: Refine => Some(refine)),
        with_keep_boundaries(keep_boundaries: bool),
        with_keep_thin(keep_thin: bool),
        with_anisotropy(anisotropy: Anisotropy),
        with_measure(measure: bool),
        with_source_map(source_map: bool),
        with_attributes(attributes: Attributes => Some(attributes)),
    }

    /// Keeps vertices that a file names where they are. Says so if seeds or a metric leave no room for that.
    pub fn keep_vertices(&mut self, vertices: &[u32]) -> Option<AttributeError> {
        let has_room = !matches!(self.seeds, Seeds::Given(_))
            && !matches!(self.density.source, DensitySource::Metric(_))
            && self.mirror.is_none()
            && self.periodic.is_empty();
        match vertices {
            [] => None,
            _ if has_room => {
                self.keep.push(Part::Vertices(vertices.iter().copied().collect()));
                None
            }
            _ => Some(AttributeError::Unreadable {
                attribute: format!("{} required vertices", vertices.len()),
                message: "seeds, a metric, a mirror plane and periodic boundaries leave them aside".to_owned(),
            }),
        }
    }

    /// Whether some of the surface's edges stay as they are.
    fn keeps_parts(&self) -> bool {
        self.keep_rims || !(self.keep.is_empty() && self.only.is_empty())
    }

    /// Lloyd steps and nothing else: no curves, no fit, no measurement.
    pub fn plain(seeds: Seeds, lloyd: usize) -> Self {
        Self {
            lloyd,
            newton: 0,
            placement: Placement::Surface,
            crease_angle_deg: 0.0,
            keep_boundaries: false,
            keep_thin: false,
            measure: false,
            ..Self::new(seeds)
        }
    }
}

/// A remesh and how it came about.
#[derive(Clone, Debug)]
pub struct Remesh {
    /// The new surface, caller's coordinates, oriented as the input.
    pub mesh: TriMesh,
    /// For each vertex of `mesh`, the seed whose cell it stands for.
    pub vertex_seed: Vec<u32>,
    /// Edges of `mesh` that lie on creases and boundaries that were kept, two vertices each.
    pub curve_edges: Vec<[u32; 2]>,
    /// The last seeds, on the surface, caller's coordinates.
    pub seeds: Vec<DVec3>,
    /// Figures.
    pub report: Report,
    /// What `mesh` carries, if [`RemeshOptions::attributes`] was given.
    pub attributes: Option<Attributes>,
    /// For each vertex of `mesh`, where on the input it lies; empty if [`RemeshOptions::attributes`] was not given.
    pub provenance: Vec<Provenance>,
}

/// Why there is no remesh.
#[derive(Debug, Clone, thiserror::Error)]
pub enum RemeshError {
    /// The diagram could not be computed.
    #[error(transparent)]
    Rvd(#[from] RvdError),
    /// The options for creases cannot be met.
    #[error(transparent)]
    Feature(FeatureError),
    /// The density cannot be met.
    #[error(transparent)]
    Density(DensityError),
    /// [`Anisotropy::Share`] is outside of [`Anisotropy::SHARES`].
    #[error("the lift is {share} diagonals long; a share from 0 to 10 is needed")]
    BadLift {
        /// The share that was given.
        share: f64,
    },
    /// Every facet of the surface lies back to back with another, and so does every triangle of the dual.
    #[error("the surface lies back to back with itself and has no thickness; remesh one of its sides")]
    NoThickness,
    /// As [`Self::TooFewSeeds`], where an edge length says how many seeds there are.
    #[error("an edge length of {length} is too long for this surface; give a shorter one, for example {fits}")]
    EdgeTooLong {
        /// As given, caller's units.
        length: f64,
        /// One that fits.
        fits: f64,
    },
    /// The dual has no triangle, or only such as lie back to back: too few seeds for this surface.
    #[error(
        "the number of points, {seeds}, is too small for this surface: no triangulation of its topology has fewer than \
         {least} vertices, and one that is near it has many more; give more points, for example {}", 10 * least
    )]
    TooFewSeeds {
        /// How many there were.
        seeds: usize,
        /// The fewest vertices that a surface of the input's topology can have.
        least: usize,
    },
    /// Points are to be added where vertices are not [`Placement::Fitted`].
    #[error(
        "points are added where a fitted result is far from the surface; place the vertices so, or give no tolerance"
    )]
    RefineUnfitted,
    /// Points are to be added, and there are too many already.
    #[error(
        "there are {points} points before any is added, and at most {most} are allowed; allow more, or begin with fewer"
    )]
    RefineLimit {
        /// How many there are.
        points: usize,
        /// [`Refine::max_points`].
        most: usize,
    },
    /// Two options exclude each other.
    #[error("{one} is given beside {other}; leave one of the two out")]
    Beside {
        /// "a metric", "a mirror plane" or "periodic boundaries".
        one: &'static str,
        /// The other one, for example "seeds".
        other: &'static str,
    },
    /// No facet is on the side of the mirror plane that is remeshed.
    #[error("no facet is on the side of {plane} that is remeshed; turn the plane's normal, or check its place")]
    NothingOnSide {
        /// The plane.
        plane: Plane,
    },
    /// Facets lie in the mirror plane.
    #[error(
        "{facets} facets lie in the mirror plane {plane}, where both halves meet; take them out of the surface, or move the plane"
    )]
    FacetsInPlane {
        /// How many facets.
        facets: usize,
        /// The plane.
        plane: Plane,
    },
    /// Points are too few for the curves in the mirror plane.
    #[error(
        "the points are too few near the mirror plane {plane}, where curves of the surface are close to each other; give more points, shorter \
         edges, or another plane"
    )]
    SeamLost {
        /// The plane.
        plane: Plane,
    },
    /// A motion takes no boundary to another.
    #[error("{motion} takes no edge of a boundary to another boundary, within {reach:.1e}; check its numbers")]
    NotPeriodic {
        /// The motion.
        motion: Motion,
        /// How far both may be apart, caller's units.
        reach: f64,
    },
    /// The result has not the same edges on both boundaries of a pair.
    #[error(
        "{edges} edges of periodic boundaries are not in the result, the first at {} {} {}; give more points", .place.x, .place.y, .place.z
    )]
    PeriodicLost {
        /// How many edges.
        edges: usize,
        /// The middle of one.
        place: DVec3,
    },
    /// A part of the surface is not there.
    #[error(transparent)]
    Part(#[from] PartError),
    /// Parts are to stay, and seeds are given.
    #[error("seeds are given, and parts of the surface are to stay; give a number of points, or keep nothing")]
    KeptBesideSeeds,
    /// All of the surface is to stay.
    #[error(
        "all facets of the surface stay: too much is kept, or no facet lies wholly in what alone is to be remeshed"
    )]
    AllKept,
    /// Vertices of one part lie on edges of another, and one of the two is to stay.
    #[error(
        "{edges} edges have vertices of other facets on them, where a part is to stay: the rest cannot be divided there; remesh the \
         input without keeping anything first, or keep nothing beside them"
    )]
    KeptAcrossJunction {
        /// How many edges.
        edges: usize,
    },
    /// Vertices that stay are more than the points that were asked for.
    #[error(
        "{rims} vertices stay, and {points} points are too few beside them; give more points, for example {}, or shorter edges",
        2 * rims.max(points)
    )]
    TooFewForRims {
        /// How many points there are.
        points: usize,
        /// How many vertices stay.
        rims: usize,
    },
    /// The result does not meet what stays.
    #[error(
        "{edges} edges of the parts that stay are not in the result, the first at {} {} {}; keep the facets around them too, or give \
         more points", .place.x, .place.y, .place.z
    )]
    RimsMissed {
        /// How many edges.
        edges: usize,
        /// The middle of one.
        place: DVec3,
    },
    /// Creases or boundaries are not in the result, and [`RemeshOptions::strict_creases`] asks for all.
    #[error(
        "{curves} of the creases and boundaries could not be kept, {length:.4} long in all, the longest at \
         {:.4} {:.4} {:.4}; give more points, or leave strict creases out", .place.x, .place.y, .place.z
    )]
    CreasesDropped {
        /// How many curves.
        curves: usize,
        /// Their length, caller's units.
        length: f64,
        /// A vertex in the middle of the longest.
        place: DVec3,
    },
    /// Edges of creases or boundaries are missing in the result, and [`RemeshOptions::strict_creases`] asks for all.
    #[error(
        "{edges} edges of {curves} creases and boundaries are missing in the result; give more points, or leave strict creases out"
    )]
    CreasesBroken {
        /// How many curves.
        curves: usize,
        /// How many edges.
        edges: usize,
    },
    /// The attributes are not the surface's.
    #[error(transparent)]
    Attributes(#[from] AttributeError),
}

impl RemeshError {
    /// Too few seeds for a surface of any topology.
    fn too_few(seeds: usize) -> Self {
        Self::TooFewSeeds { seeds, least: 3 }
    }

    /// The same error, for a surface of this topology and area, and edges of this length if points are not counted.
    fn for_surface(self, surface: &Topology, area: f64, edge_length: Option<f64>) -> Self {
        match self {
            Self::TooFewSeeds { seeds, .. } => {
                let least = surface.fewest_vertices();
                // N equilateral triangles around vertices have the area N √3/2 h².
                let fits = (2.0 / 3f64.sqrt() * area / (10 * least) as f64).sqrt();
                match edge_length {
                    // Two digits are enough.
                    Some(length) => Self::EdgeTooLong { length, fits: format!("{fits:.1e}").parse().unwrap_or(fits) },
                    None => Self::TooFewSeeds { seeds, least },
                }
            }
            error => error,
        }
    }
}

impl From<Stopped> for RemeshError {
    fn from(reason: Stopped) -> Self {
        Self::Rvd(reason.into())
    }
}

impl From<FeatureError> for RemeshError {
    fn from(error: FeatureError) -> Self {
        match error {
            FeatureError::Stopped(reason) => reason.into(),
            error => Self::Feature(error),
        }
    }
}

impl From<DensityError> for RemeshError {
    fn from(error: DensityError) -> Self {
        match error {
            DensityError::Stopped(reason) => Self::Rvd(RvdError::Stopped(reason)),
            error => Self::Density(error),
        }
    }
}

/// Hears of the progress of a remesh. All methods have empty defaults.
pub trait Observer: Send {
    /// A stage began: "prepare", "sample", "iterations", "dual", "repair", "attributes" (if any were given), "measure".
    fn stage(&mut self, _name: &'static str) {}
    /// An iteration ended; `total` iterations are planned.
    fn iteration(&mut self, _iteration: &Iteration, _total: usize) {}
    /// Whether [`seeds`](Self::seeds) is to be called after the next step. Lloyd steps are then taken one by one, and seeds
    /// are read back from a device; the result has the same bits.
    fn wants_seeds(&mut self) -> bool {
        false
    }
    /// Where the seeds are after `steps` steps, in the caller's coordinates.
    fn seeds(&mut self, _steps: usize, _seeds: &[DVec3]) {}
}

impl Observer for () {}
