//! What density is asked for, and why there is none.
//!
//! Invariant: the defaults are those of the command and the service. An error names what the caller gave, and what it may be.
//! Must not know: surfaces.

use crate::mesh::parts::{PartError, Zone};
use crate::mesh::tensor::Tensor;
use crate::token::Stopped;

/// The largest ratio of two lengths: weights, their fourth power, have to be within single precision.
pub(super) const MOST_RATIO: f64 = 1e4;

/// Where the density comes from.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum DensitySource {
    /// The same everywhere.
    #[default]
    Uniform,
    /// A weight per mesh vertex, taken as it is: finite, at least 0, not all 0; w ∝ h⁻⁴.
    Weights(Vec<f64>),
    /// A target edge length per mesh vertex, caller's units, finite and above 0; linear in each facet. They are
    /// kept if the points are [`Count::Implied`]; with another count only their ratios are.
    Sizes(Vec<f64>),
    /// Length by curvature: h ∝ κ^(-1/2), where κ is the larger principal curvature. All edges then deviate from the surface
    /// by about the same: an edge of length h by h²κ/8. Edges are no shorter than those of the mesh. Where the edges of the
    /// mesh are longer than those of as many evenly spaced points, the limit is half of the latter.
    Curvature,
    /// Length by local feature size: h ∝ the distance to the medial axis. Edges are short where the surface is thin, hollow
    /// or sharp. They are as short as by curvature, or shorter between close sheets.
    FeatureSize,
    /// Length for the least mean of squared distances from the surface by triangles of the best shape: h ∝ |K|^(-1/6), where K is
    /// the Gaussian curvature, or k₁²/64 where that is larger: triangles are at most eight times as long as wide. For
    /// anisotropic remeshes. Creases are those that even points of the same number resolve.
    Error,
    /// The same for the least largest distance: h ∝ |K|^(-1/4).
    ErrorMax,
    /// A metric per mesh vertex, caller's units: an edge e has the length √(eᵀ M e), and is to have length 1. Points are as dense
    /// as unit triangles need them, and neither adaptivity, clamp nor gradation is read. A remesh also gives facets their shape
    /// in the metric. With a count of points, all lengths are scaled for it.
    Metric(Vec<Tensor>),
}

impl DensitySource {
    /// "uniform", "weights", "sizes", "curvature", "lfs", "error", "error_max" or "metric".
    pub fn name(&self) -> &'static str {
        match self {
            Self::Uniform => "uniform",
            Self::Weights(_) => "weights",
            Self::Sizes(_) => "sizes",
            Self::Curvature => "curvature",
            Self::FeatureSize => "lfs",
            Self::Error => "error",
            Self::ErrorMax => "error_max",
            Self::Metric(_) => "metric",
        }
    }
}

/// Which density is asked for. [`Default`] is uniform.
#[derive(Clone, Debug, PartialEq)]
pub struct DensityOptions {
    /// Where it comes from.
    pub source: DensitySource,
    /// Parts whose edges have lengths of their own, whatever the number of points; of several at a place the shortest counts. Lengths
    /// around grow by [`Self::gradation`]. Not for weights and metrics, which are taken as they are.
    pub zones: Vec<Zone>,
    /// Target edge length, caller's units; read for [`Count::Implied`] unless lengths per vertex are given. With
    /// curvature or feature size, the points are as many as edges of this length everywhere would need.
    pub edge_length: Option<f64>,
    /// 0 makes lengths equal, 1 (the default) takes the source's; between, they are the median times (h / median) to this
    /// power. Not read for weights.
    pub adaptivity: f64,
    /// The most that a length may grow per distance along the mesh's edges, above 0; infinite for no bound.
    /// 0.3 by default: from one ring of triangles to the next, lengths grow by about a quarter. Where lengths jump
    /// by ten, 0.3 took 9 % more points than no bound and left no angle under 30 degrees, of 1.6 % of the
    /// triangles without; 0.1 took 27 % more and brought nothing beside. Not read for weights.
    pub gradation: f64,
    /// Lengths below the median over this, or above the median times this, are brought there; at least 1. The
    /// median is by area, not by vertices. 32 by default. Not read for weights.
    pub clamp: f64,
    /// The largest length is at most this times the smallest; the large ones are lowered, which costs few
    /// points. At least 1, at most 1e4, so that weights stay within single precision. 100 by default.
    pub ratio: f64,
    /// The most points that lengths may imply, or that may be asked for. 10⁸ by default.
    pub max_points: usize,
}

impl Default for DensityOptions {
    fn default() -> Self {
        Self {
            source: DensitySource::Uniform,
            zones: Vec::new(),
            edge_length: None,
            adaptivity: 1.0,
            gradation: 0.3,
            clamp: 32.0,
            ratio: 100.0,
            max_points: 100_000_000,
        }
    }
}

impl DensityOptions {
    /// The defaults: uniform.
    pub fn new() -> Self {
        Self::default()
    }

    setters! {
        with_source(source: DensitySource),
        with_zones(zones: Vec<Zone>),
        with_edge_length(edge_length: f64 => Some(edge_length)),
        with_adaptivity(adaptivity: f64),
        with_gradation(gradation: f64),
        with_clamp(clamp: f64),
        with_ratio(ratio: f64),
        with_max_points(max_points: usize),
    }

    /// Everything else as by default.
    pub fn from_source(source: DensitySource) -> Self {
        Self { source, ..Self::default() }
    }

    /// Whether every number is in its range; lengths and weights per vertex are checked later.
    pub fn check(&self) -> Result<(), DensityError> {
        let bad = |name, value, range| Err(DensityError::BadOption { name, value, range });
        match *self {
            Self { edge_length: Some(h), .. } if !(h.is_finite() && h > 0.0) => {
                bad("edge length", h, "finite and above 0")
            }
            Self { ref zones, .. } if zones.iter().any(|zone| !(zone.length.is_finite() && zone.length > 0.0)) => {
                let odd = zones.iter().map(|zone| zone.length).find(|h| !(h.is_finite() && *h > 0.0));
                bad("the edge length of a zone", odd.unwrap_or(f64::NAN), "finite and above 0")
            }
            Self { ref zones, source: DensitySource::Weights(_) | DensitySource::Metric(_), .. }
                if !zones.is_empty() =>
            {
                Err(DensityError::ZonesBeside { other: self.source.name() })
            }
            Self { adaptivity: a, .. } if !(0.0..=1.0).contains(&a) => bad("adaptivity", a, "from 0 to 1"),
            Self { gradation, .. } if gradation.is_nan() || gradation <= 0.0 => bad("gradation", gradation, "above 0"),
            Self { clamp, .. } if clamp.is_nan() || clamp < 1.0 => bad("clamp", clamp, "at least 1"),
            Self { ratio, .. } if !(1.0..=MOST_RATIO).contains(&ratio) => bad("ratio", ratio, "from 1 to 10000"),
            _ => Ok(()),
        }
    }
}

impl From<Option<Vec<f64>>> for DensityOptions {
    /// Weights if there are any, else uniform.
    fn from(weights: Option<Vec<f64>>) -> Self {
        Self::from_source(weights.map_or(DensitySource::Uniform, DensitySource::Weights))
    }
}

/// How many points there are to be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Count {
    /// This number.
    Points(usize),
    /// As many as the edge lengths imply.
    Implied,
}

/// Why there is no density.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DensityError {
    /// The list of edge lengths is not as long as the list of vertices.
    #[error("{given} edge lengths for {vertices} vertices; give one per vertex")]
    SizeCount {
        /// How many were given.
        given: usize,
        /// How many vertices there are.
        vertices: usize,
    },
    /// An edge length is not one.
    #[error("the edge length of vertex {vertex} is {value}; lengths are finite and above 0")]
    BadSize {
        /// The vertex, from 0.
        vertex: usize,
        /// What was given.
        value: f64,
    },
    /// The list of metric tensors is not as long as the list of vertices.
    #[error("{given} metric tensors for {vertices} vertices; give one per vertex of the surface that is remeshed")]
    MetricCount {
        /// How many were given.
        given: usize,
        /// How many vertices there are.
        vertices: usize,
    },
    /// A number of a metric tensor is NaN or infinite.
    #[error("the metric tensor of vertex {vertex} has a number that is not finite; give six finite numbers")]
    MetricNotFinite {
        /// The vertex, from 0.
        vertex: usize,
    },
    /// A metric tensor is not positive definite: some direction has no length.
    #[error(
        "the metric tensor of vertex {vertex} is not positive definite: its least eigenvalue is {least}; give a tensor whose \
         eigenvalues 1/h² are all above 0, that across the surface too"
    )]
    MetricNotPositive {
        /// The vertex, from 0.
        vertex: usize,
        /// Its least eigenvalue.
        least: f64,
    },
    /// Lengths that a metric tensor stands for are no numbers.
    #[error(
        "the metric tensor of vertex {vertex} stands for lengths too small or too large for numbers; scale the metric"
    )]
    MetricRange {
        /// The vertex, from 0.
        vertex: usize,
    },
    /// An option is outside its range.
    #[error("{name} is {value}; it must be {range}")]
    BadOption {
        /// "edge length", "adaptivity", "gradation", "clamp" or "ratio".
        name: &'static str,
        /// What was given.
        value: f64,
        /// What it may be.
        range: &'static str,
    },
    /// Zones say how long edges are, and so does something that is taken as it is.
    #[error(
        "edge lengths of parts are given beside {other}, which says how long all edges are; leave one of the two out"
    )]
    ZonesBeside {
        /// "weights" or "metric".
        other: &'static str,
    },
    /// The edges of zones need more points than there are.
    #[error(
        "the edge lengths of parts need about {needed} points, and there are {points}; give more points, or longer edges"
    )]
    ZonesNeed {
        /// How many they need, with what lies around them.
        needed: usize,
        /// How many there are.
        points: usize,
    },
    /// A zone's part is not there.
    #[error(transparent)]
    Part(#[from] PartError),
    /// Neither a number of points nor anything that implies one.
    #[error("nothing says how many points there should be; give their number, an edge length, or one per vertex")]
    NoCount,
    /// The lengths need more points than are allowed.
    #[error("these edge lengths need about {implied:.3e} points, and at most {limit} are allowed; make them longer")]
    TooManyPoints {
        /// How many they need.
        implied: f64,
        /// How many there may be.
        limit: usize,
    },
    /// More points than are allowed.
    #[error("{points} points, and at most {limit} are allowed; give fewer")]
    PointLimit {
        /// How many were asked for.
        points: usize,
        /// How many there may be.
        limit: usize,
    },
    /// The caller asked to stop, or a limit was reached.
    #[error(transparent)]
    Stopped(#[from] Stopped),
}
