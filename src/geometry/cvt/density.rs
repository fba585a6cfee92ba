//! Density: how long edges should be, and where.
//!
//! Purpose: [`plan`] turns [`DensityOptions`] (uniform, weights, lengths, curvature, feature size, metric) into what
//! the iterations take: weights linear in each facet, a surface whose facets are fine enough for that, and a
//! number of points. Edge length h needs weight h⁻⁴, and 2/√3 h⁻² points per area.
//! Invariant: lengths are bounded in ratio and slope (a spike cannot eat the budget), and what bounds them is
//! counted in [`DensityFigures`]. The same bits with any number of threads. O(n log n).
//! Must not know: backends, files, jobs.

mod curvature;
mod expected;
mod feature_size;
mod lengths;
mod metric;
mod net;
mod normals;
mod options;
mod outline;
mod refine;
mod size_field;
mod zones;

use std::borrow::Cow;

use glam::DVec3;
use serde::Serialize;

use crate::mesh::TriMesh;
use crate::token::{Stopped, Token};

pub(crate) use curvature::principal;
pub use expected::Expected;
pub(crate) use lengths::LONGEST;
pub use metric::check as check_metric;
pub use net::Net;
pub use options::{Count, DensityError, DensityOptions, DensitySource};
pub use outline::Outline;
pub(crate) use size_field::SizeField;

use lengths::{Bounded, Least, Limits, adapt, fill_gaps, of_curvature, of_error, resolved, without_noise};
use options::MOST_RATIO;

/// What came of a density, for a report. Lengths are in the caller's units.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct DensityFigures {
    /// See [`DensitySource::name`].
    pub source: &'static str,
    /// Points that the lengths imply, not rounded; absent for weights.
    pub points_implied: Option<f64>,
    /// Smallest target edge length; absent for weights.
    pub edge_least: Option<f64>,
    /// The one that half of the area has at most.
    pub edge_median: Option<f64>,
    /// Largest.
    pub edge_largest: Option<f64>,
    /// Vertices whose length was out of bounds ([`DensityOptions::clamp`], [`DensityOptions::ratio`], the mesh's edges).
    pub clamped_vertices: usize,
    /// Vertices whose length was lowered for the sake of gradation.
    pub graded_vertices: usize,
    /// Share of the area whose lengths go up and down from vertex to vertex too fast for triangles, percent; 0 if little.
    pub noise_percent: f64,
    /// Rounds that evened such lengths out between neighbours.
    pub smoothing_rounds: usize,
    /// Facets, after those where weights change fast, or that are long beside the cells, were divided, if any was.
    pub facets: usize,
}

/// What the iterations take.
#[derive(Clone, Debug)]
pub struct Plan<'a> {
    /// The surface, its facets divided where the density changes fast or, after [`Plan::divided`], they are long beside
    /// the cells; the first vertices are the caller's.
    pub mesh: Cow<'a, TriMesh>,
    /// One weight per vertex of `mesh`; none if uniform.
    pub weights: Option<Vec<f64>>,
    /// Target edge length per vertex of the caller's mesh, as it was bounded; none for weights and uniform.
    pub sizes: Option<Vec<f64>>,
    /// How many points to draw.
    pub points: usize,
    /// For a report.
    pub figures: DensityFigures,
}

impl<'a> Plan<'a> {
    /// The same with facets divided that are long beside the cells, if most of the surface is of these, as they are already where
    /// lengths vary: a facet costs by the pairs of cells that meet at it. Pieces then name the divided facets.
    pub fn divided(self, token: &Token) -> Result<Self, Stopped> {
        let vertices = self.mesh.positions().len();
        // `Surface::new` refuses a wrong number of weights.
        let wrong = self.weights.as_ref().is_some_and(|weights| weights.len() != vertices);
        if self.sizes.is_some() || self.points == 0 || wrong {
            return Ok(self);
        }
        let most = most_facets(&self.mesh, self.points);
        let lengths = match (&self.weights, self.figures.edge_median) {
            (None, Some(edge)) => vec![edge; vertices],
            _ => self.lengths(&self.mesh, token)?,
        };
        let values = self.weights.as_deref().unwrap_or(&[]);
        let Some((fine, values)) = refine::shorten(&self.mesh, &lengths, values, most, token)? else { return Ok(self) };
        let figures = DensityFigures { facets: fine.facets().len(), ..self.figures };
        let weights = self.weights.map(|_| values);
        Ok(Plan { mesh: Cow::Owned(fine), weights, figures, ..self })
    }

    /// The edges of the plan's mesh that make up `edges` of the caller's.
    pub fn edges(&self, edges: &[[u32; 2]], token: &Token) -> Result<Vec<[u32; 2]>, Stopped> {
        refine::divided(&self.mesh, edges, token)
    }

    /// Target edge length per vertex of `mesh`, the caller's: those of the plan, or what its points have by its weights.
    pub fn lengths(&self, mesh: &TriMesh, token: &Token) -> Result<Vec<f64>, Stopped> {
        if let Some(sizes) = &self.sizes {
            return Ok(sizes.clone());
        }
        let vertices = mesh.positions().len();
        let Some(weights) = self.weights.as_ref() else {
            return Ok(vec![Outline::new(mesh, token)?.edge_length(self.points as f64); vertices]);
        };
        let top = weights.iter().copied().fold(0.0, f64::max);
        let by_weight = |w: &f64| (w / top).max(LEAST_WEIGHT).powf(-0.25);
        let lengths: Vec<f64> = weights[..vertices].iter().map(by_weight).collect();
        // No length is refused: weights were checked when the surface was made, and none is too small here.
        let net = Net::new(mesh, token)?;
        let factor = |field: &SizeField| (field.points(&net) / self.points.max(1) as f64).sqrt();
        let scaled = SizeField::new(&net, lengths.clone()).map(|field| field.scaled(factor(&field)).sizes);
        Ok(scaled.unwrap_or(lengths))
    }
}

/// Weights below this share of the largest stand for edges a hundred times as long.
const LEAST_WEIGHT: f64 = 1e-8;

/// Makes the density of `mesh` that `options` ask for. Weights are checked where they are used, by `Surface::new`.
pub fn plan<'a>(
    mesh: &'a TriMesh,
    options: &DensityOptions,
    count: Count,
    token: &Token,
) -> Result<Plan<'a>, DensityError> {
    plan_beside(mesh, options, count, Beside::default(), token)
}

/// What a density takes into account beside its options.
#[derive(Clone, Copy, Default)]
pub(crate) struct Beside<'a> {
    /// Lengths that edges have already at some vertices, caller's units: there the density is near theirs, which no weights that are
    /// given, and no metric, are.
    pub(crate) lengths: &'a [(u32, f64)],
    /// Where a place of the surface was before its sheets were moved apart.
    pub(crate) before: Option<&'a Before<'a>>,
}

/// Where a place was.
pub(crate) type Before<'a> = dyn Fn(DVec3) -> DVec3 + Sync + 'a;

/// [`plan`], with what is beside the options.
pub(crate) fn plan_beside<'a>(
    mesh: &'a TriMesh,
    options: &DensityOptions,
    count: Count,
    beside: Beside<'_>,
    token: &Token,
) -> Result<Plan<'a>, DensityError> {
    options.check()?;
    if !options.zones.is_empty() {
        return zones::plan(mesh, options, count, beside, token);
    }
    match &options.source {
        DensitySource::Weights(_) => level(mesh, options, count, token),
        DensitySource::Uniform if beside.lengths.is_empty() => level(mesh, options, count, token),
        _ => varying(mesh, options, count, (beside, &[]), token),
    }
}

type Planned<'a> = Result<Plan<'a>, DensityError>;

fn level<'a>(mesh: &'a TriMesh, options: &DensityOptions, count: Count, token: &Token) -> Planned<'a> {
    let outline = Outline::new(mesh, token)?;
    let implied = match (count, options.edge_length) {
        (Count::Points(points), _) => points as f64,
        (Count::Implied, Some(edge)) => outline.points(edge),
        (Count::Implied, None) => return Err(DensityError::NoCount),
    };
    let points = match count {
        Count::Points(points) => within(points, options.max_points)?,
        Count::Implied => rounded(implied, options.max_points)?,
    };
    let weights = match &options.source {
        DensitySource::Weights(weights) => Some(weights.clone()),
        _ => None,
    };
    let edge = (weights.is_none() && points > 0).then(|| outline.edge_length(implied));
    let figures = DensityFigures {
        source: options.source.name(),
        points_implied: edge.map(|_| implied),
        edge_least: edge,
        edge_median: edge,
        edge_largest: edge,
        facets: mesh.facets().len(),
        ..DensityFigures::default()
    };
    Ok(Plan { mesh: Cow::Borrowed(mesh), weights, sizes: None, points, figures })
}

fn varying<'a>(
    mesh: &'a TriMesh,
    options: &DensityOptions,
    count: Count,
    (beside, of_zones): (Beside<'_>, &[f64]),
    token: &Token,
) -> Planned<'a> {
    let net = Net::new(mesh, token)?;
    let in_metric = matches!(options.source, DensitySource::Metric(_));
    // A metric is taken as it is.
    let free = in_metric.then(|| DensityOptions {
        gradation: f64::INFINITY,
        clamp: f64::INFINITY,
        ratio: MOST_RATIO,
        ..DensityOptions::default()
    });
    // What is asked for in so many words is not lengthened or shortened.
    let wide = (!of_zones.is_empty()).then(|| DensityOptions { ratio: MOST_RATIO, ..options.clone() });
    let bounds = free.as_ref().or(wide.as_ref()).unwrap_or(options);
    let target = match (count, options.edge_length, &options.source) {
        (Count::Points(points), ..) => Some(points as f64),
        (Count::Implied, _, DensitySource::Sizes(_) | DensitySource::Metric(_)) => None,
        // Edges have this length where no others are near.
        (Count::Implied, Some(_), DensitySource::Uniform) => None,
        (Count::Implied, Some(edge), _) => Some(net.outline.points(edge)),
        (Count::Implied, None, _) => return Err(DensityError::NoCount),
    };
    match (count, target) {
        (Count::Points(points), _) => _ = within(points, options.max_points)?,
        (_, Some(target)) => _ = rounded(target, options.max_points)?,
        _ => {}
    }
    token.check()?;
    let place = |v: usize| beside.before.map_or(mesh.positions()[v], |before| before(mesh.positions()[v]));
    let (raw, sheets) = match &options.source {
        DensitySource::Sizes(sizes) => (sizes.clone(), None),
        DensitySource::Uniform => {
            let edge = options.edge_length.unwrap_or(net.outline.extent);
            (vec![edge; net.vertices()], None)
        }
        DensitySource::Metric(tensors) => (metric::lengths(&net, tensors, token)?, None),
        DensitySource::FeatureSize => {
            let size = feature_size::local(&net, token)?;
            (size.all, Some(size.between_sheets))
        }
        DensitySource::Error => (of_error(&net, target.unwrap_or(1.0), 1.0 / 6.0, token)?, None),
        DensitySource::ErrorMax => (of_error(&net, target.unwrap_or(1.0), 0.25, token)?, None),
        _ => (of_curvature(&net, &net.rims(place), target.unwrap_or(1.0), token)?, None),
    };
    let given = in_metric || matches!(options.source, DensitySource::Sizes(_) | DensitySource::Uniform);
    let mut field = SizeField::new(&net, if given { raw } else { fill_gaps(&net, raw) })?;
    let mut sheets = sheets.map(|sheets| SizeField::new(&net, fill_gaps(&net, sheets))).transpose()?;
    token.check()?;
    let median = field.median(&net);
    let clamped = adapt(&mut field, median, bounds);
    sheets.iter_mut().for_each(|sheets| _ = adapt(sheets, median, bounds));
    let least = match target {
        Some(target) if !given => Some(Least { edge: resolved(&net, target), sheets }),
        _ => None,
    };
    let lengths = if in_metric { Vec::new() } else { net.by_vertex(beside.lengths) };
    let limits = Limits { least: least.as_ref(), of_zones, beside: &lengths };
    let (Bounded { field, graded, outside, points }, noise, smoothing_rounds) =
        without_noise(field, limits, &net, bounds, target, token)?;
    token.check()?;
    let points_implied = points;
    match count {
        Count::Points(asked) if !of_zones.is_empty() && points > MOST_OF_ZONES * asked as f64 => {
            return Err(DensityError::ZonesNeed { needed: points.ceil() as usize, points: asked });
        }
        _ => {}
    }
    let points = match count {
        Count::Points(points) => points,
        Count::Implied => {
            // Zones have their lengths, also where they need more points than the rest was to have.
            let of_zones = if of_zones.is_empty() { 0.0 } else { points_implied };
            rounded(target.map_or(points_implied, |target| target.max(of_zones)), options.max_points)?
        }
    };
    let divided = refine::refine(mesh, &net, &field.sizes, most_facets(mesh, points), token)?;
    let figures = DensityFigures {
        source: options.source.name(),
        points_implied: Some(points_implied),
        edge_least: Some(field.least()),
        edge_median: Some(field.median(&net)),
        edge_largest: Some(field.largest()),
        clamped_vertices: clamped + outside,
        graded_vertices: graded,
        noise_percent: 100.0 * noise,
        smoothing_rounds,
        facets: divided.as_ref().map_or(mesh, |(fine, _)| fine).facets().len(),
    };
    let (mesh, weights) = match divided {
        Some((fine, sizes)) => (Cow::Owned(fine), SizeField::weights_of(&sizes)),
        None => (Cow::Borrowed(mesh), SizeField::weights_of(&field.sizes)),
    };
    Ok(Plan { mesh, weights: Some(weights), sizes: Some(field.sizes), points, figures })
}

/// A facet is divided only where it is as large as a cell or so: a few for each point.
fn most_facets(mesh: &TriMesh, points: usize) -> usize {
    (mesh.facets().len() + 64 * points + 1000).min(crate::mesh::MAX_ELEMENTS)
}

/// Zones may need so many times the points that there are: rounding, and what the search for a factor leaves.
const MOST_OF_ZONES: f64 = 1.05;

fn within(points: usize, limit: usize) -> Result<usize, DensityError> {
    if points <= limit { Ok(points) } else { Err(DensityError::PointLimit { points, limit }) }
}

fn rounded(points: f64, limit: usize) -> Result<usize, DensityError> {
    if points.is_finite() && points.round() <= limit as f64 {
        return Ok(points.round().max(1.0) as usize);
    }
    Err(DensityError::TooManyPoints { implied: points, limit })
}
