//! Density: how long edges should be, and where.
//!
//! Purpose: [`plan`] turns a wish ([`DensityOptions`]: uniform, weights, lengths, curvature, feature size) into what
//! the iterations take: weights linear in each facet, a surface whose facets are fine enough for that, and a
//! number of points. Edge length h needs weight h⁻⁴, and 2/√3 h⁻² points per area.
//! Invariant: lengths are bounded in ratio and slope (a spike cannot eat the budget), and what bounds them is
//! counted in [`DensityFigures`]. The same bits with any number of threads. O(n log n).
//! Must not know: backends, files, jobs.

mod curvature;
mod feature_size;
mod net;
mod normals;
mod outline;
mod refine;
mod size_field;

use std::borrow::Cow;

use serde::Serialize;

use crate::mesh::TriMesh;
use crate::token::{Stopped, Token};

pub use net::Net;
pub use outline::Outline;
pub(crate) use size_field::SizeField;

/// Where the density comes from.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub enum DensitySource {
    /// The same everywhere.
    #[default]
    Uniform,
    /// A weight per mesh vertex, taken as it is: finite, at least 0, not all 0; w ∝ h⁻⁴.
    Weights(Vec<f64>),
    /// A target edge length per mesh vertex, caller's units, finite and above 0; linear in each facet. They are
    /// kept if the points are [`Count::Implied`]; with another count only their ratios are.
    Sizes(Vec<f64>),
    /// h ∝ κ^(-1/2), κ the larger principal curvature, so that all edges depart from the surface by about
    /// the same: an edge of length h by h²κ/8. Edges are no shorter than the mesh's own, or than half of those of as many
    /// even points where its own are longer: there is no more of the surface to see.
    Curvature,
    /// h ∝ the distance to the medial axis: fine where the surface is thin, hollow or sharp. Edges are as short as with
    /// curvature, or shorter where two sheets are so close.
    FeatureSize,
}

impl DensitySource {
    /// "uniform", "weights", "sizes", "curvature" or "lfs".
    pub fn name(&self) -> &'static str {
        match self {
            Self::Uniform => "uniform",
            Self::Weights(_) => "weights",
            Self::Sizes(_) => "sizes",
            Self::Curvature => "curvature",
            Self::FeatureSize => "lfs",
        }
    }
}

/// What density is wished. [`Default`] is uniform.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct DensityOptions {
    /// Where it comes from.
    pub source: DensitySource,
    /// Target edge length, caller's units; read for [`Count::Implied`] unless lengths per vertex are given. With
    /// curvature or feature size, the points are as many as edges of this length everywhere would need.
    pub edge_length: Option<f64>,
    /// 0 makes lengths equal, 1 (the default) takes them as the source says; between, h is the median times
    /// (h / median) to this power. Not read for weights.
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

    /// Whether every number is in its range; lengths and weights per vertex are looked at later.
    ///
    /// # Errors
    /// `BadOption`.
    pub fn check(&self) -> Result<(), DensityError> {
        let bad = |name, value, range| Err(DensityError::BadOption { name, value, range });
        match *self {
            Self { edge_length: Some(h), .. } if !(h.is_finite() && h > 0.0) => {
                bad("edge length", h, "finite and above 0")
            }
            Self { adaptivity, .. } if !(0.0..=1.0).contains(&adaptivity) => {
                bad("adaptivity", adaptivity, "from 0 to 1")
            }
            Self { gradation, .. } if gradation.is_nan() || gradation <= 0.0 => bad("gradation", gradation, "above 0"),
            Self { clamp, .. } if clamp.is_nan() || clamp < 1.0 => bad("clamp", clamp, "at least 1"),
            Self { ratio, .. } if !(1.0..=1e4).contains(&ratio) => bad("ratio", ratio, "from 1 to 10000"),
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
    /// So many.
    Points(usize),
    /// As many as the edge lengths imply.
    Implied,
}

/// Why there is no density.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
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

/// What came of a density, for a report. Lengths are in the caller's units.
#[derive(Clone, Debug, PartialEq, Serialize)]
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
    /// Vertices whose length was outside the bounds ([`DensityOptions::clamp`], [`DensityOptions::ratio`], the mesh's own
    /// edges).
    pub clamped_vertices: usize,
    /// Vertices whose length was lowered for the sake of gradation.
    pub graded_vertices: usize,
    /// Share of the area whose lengths go up and down from vertex to vertex faster than triangles can follow, percent; 0 if it
    /// is no more than here and there.
    pub noise_percent: f64,
    /// Rounds that evened such lengths out between neighbours.
    pub smoothing_rounds: usize,
    /// Facets that the surface was divided into where weights change fast or facets are long beside the cells; as before
    /// if it was not.
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
    /// lengths vary: a facet costs by the pairs of cells that meet at it. For who does not ask which facet a piece is of.
    ///
    /// # Errors
    /// [`Stopped`].
    pub fn divided(self, token: &Token) -> Result<Self, Stopped> {
        let vertices = self.mesh.positions().len();
        // Weights that are too many or too few are refused by whoever makes a surface of them.
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
        let Some((fine, values)) = refine::shorten(&self.mesh, &lengths, values, most, token)? else {
            return Ok(self);
        };
        let figures = DensityFigures { facets: fine.facets().len(), ..self.figures };
        let weights = self.weights.map(|_| values);
        Ok(Plan { mesh: Cow::Owned(fine), weights, figures, ..self })
    }

    /// Target edge length per vertex of `mesh`, the caller's: those of the plan, or those that so many points have by
    /// its weights.
    ///
    /// # Errors
    /// [`Stopped`].
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
        let scaled = SizeField::new(&net, lengths.clone()).map(|field| {
            let factor = (field.points(&net) / self.points.max(1) as f64).sqrt();
            field.scaled(factor).into_sizes()
        });
        Ok(scaled.unwrap_or(lengths))
    }
}

/// Weights below this share of the largest stand for edges a hundred times as long.
const LEAST_WEIGHT: f64 = 1e-8;

/// Makes the wished density of `mesh`.
///
/// # Errors
/// [`DensityError`]. Weights are checked where they are used, by `Surface::new`.
pub fn plan<'a>(
    mesh: &'a TriMesh,
    options: &DensityOptions,
    count: Count,
    token: &Token,
) -> Result<Plan<'a>, DensityError> {
    options.check()?;
    match &options.source {
        DensitySource::Uniform | DensitySource::Weights(_) => level(mesh, options, count, token),
        DensitySource::Sizes(_) | DensitySource::Curvature | DensitySource::FeatureSize => {
            varying(mesh, options, count, token)
        }
    }
}

/// Uniform, and weights as they are.
fn level<'a>(
    mesh: &'a TriMesh,
    options: &DensityOptions,
    count: Count,
    token: &Token,
) -> Result<Plan<'a>, DensityError> {
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
        clamped_vertices: 0,
        graded_vertices: 0,
        noise_percent: 0.0,
        smoothing_rounds: 0,
        facets: mesh.facets().len(),
    };
    Ok(Plan { mesh: Cow::Borrowed(mesh), weights, sizes: None, points, figures })
}

/// Lengths that vary.
fn varying<'a>(
    mesh: &'a TriMesh,
    options: &DensityOptions,
    count: Count,
    token: &Token,
) -> Result<Plan<'a>, DensityError> {
    let net = Net::new(mesh, token)?;
    let target = match (count, options.edge_length, &options.source) {
        (Count::Points(points), ..) => Some(points as f64),
        (Count::Implied, _, DensitySource::Sizes(_)) => None,
        (Count::Implied, Some(edge), _) => Some(net.outline.points(edge)),
        (Count::Implied, None, _) => return Err(DensityError::NoCount),
    };
    match (count, target) {
        (Count::Points(points), _) => _ = within(points, options.max_points)?,
        (_, Some(target)) => _ = rounded(target, options.max_points)?,
        _ => {}
    }
    token.check()?;
    let (raw, sheets) = match &options.source {
        DensitySource::Sizes(sizes) => (sizes.clone(), None),
        DensitySource::FeatureSize => {
            let size = feature_size::local(&net, token)?;
            (size.all, Some(size.between_sheets))
        }
        _ => (of_curvature(&net, target.unwrap_or(1.0), token)?, None),
    };
    let given = matches!(options.source, DensitySource::Sizes(_));
    let mut field = SizeField::new(&net, if given { raw } else { whole(&net, raw) })?;
    let mut sheets = sheets.map(|sheets| SizeField::new(&net, whole(&net, sheets))).transpose()?;
    token.check()?;
    let median = field.median(&net);
    let clamped = adapt(&mut field, median, options);
    sheets.iter_mut().for_each(|sheets| _ = adapt(sheets, median, options));
    let least = match target {
        Some(target) if !given => Some(Least { edge: resolved(&net, target), sheets }),
        _ => None,
    };
    let (Bounded { field, graded, outside, points }, noise, smoothing_rounds) =
        without_noise(field, least.as_ref(), &net, options, target, token)?;
    token.check()?;
    let points_implied = points;
    let points = match count {
        Count::Points(points) => points,
        Count::Implied => rounded(target.unwrap_or(points_implied), options.max_points)?,
    };
    let divided = refine::refine(mesh, &net, field.sizes(), most_facets(mesh, points), token)?;
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
        None => (Cow::Borrowed(mesh), SizeField::weights_of(field.sizes())),
    };
    Ok(Plan { mesh, weights: Some(weights), sizes: Some(field.into_sizes()), points, figures })
}

/// A facet is divided only where it is as large as a cell or so: a few for each point.
fn most_facets(mesh: &TriMesh, points: usize) -> usize {
    (mesh.facets().len() + 64 * points + 1000).min(crate::mesh::MAX_ELEMENTS)
}

/// As many points as are allowed at most.
fn within(points: usize, limit: usize) -> Result<usize, DensityError> {
    if points <= limit { Ok(points) } else { Err(DensityError::PointLimit { points, limit }) }
}

/// Rounds a number of points.
fn rounded(points: f64, limit: usize) -> Result<usize, DensityError> {
    if points.is_finite() && points.round() <= limit as f64 {
        return Ok(points.round().max(1.0) as usize);
    }
    Err(DensityError::TooManyPoints { implied: points, limit })
}

/// A surface is taken as no flatter than a ball of its own width, so that a plane has a length too.
const LEAST_CURVATURE: f64 = 1.0;

/// Lengths up to a factor. Normals are smoothed over half of the edge length that `points` even points have: what is
/// smaller cannot be kept anyway. At least one round, so that a scan's noise is not its curvature, at most 40.
fn of_curvature(net: &Net, points: f64, token: &Token) -> Result<Vec<f64>, Stopped> {
    let radius = 0.5 * net.outline.edge_length(points) / net.outline.extent / net.mean_edge();
    // A round moves by 6/7 of an edge's square in the mean: six neighbours and the vertex itself.
    let rounds = (radius * radius * 7.0 / 6.0).ceil().clamp(1.0, 40.0);
    let curvature = curvature::largest(net, rounds as usize, token)?;
    let length = |k: f64| if k.is_nan() { f64::NAN } else { k.max(LEAST_CURVATURE).powf(-0.5) };
    Ok(curvature.into_iter().map(length).collect())
}

/// Lengths that a source could not tell (NaN) become the median; all in caller's units.
fn whole(net: &Net, mut raw: Vec<f64>) -> Vec<f64> {
    let median = net.median(&raw);
    let median = if median > 0.0 { median } else { 1.0 };
    // A medial axis that runs through a vertex gives 0; the clamp decides how small that is.
    raw.iter_mut().for_each(|h| *h = if h.is_nan() { median } else { h.max(1e-9) } * net.outline.extent);
    raw
}

/// Adaptivity, and the bounds about the median; says how many lengths were outside.
fn adapt(field: &mut SizeField, median: f64, options: &DensityOptions) -> usize {
    field.flatten(median, options.adaptivity);
    field.clamp(median / options.clamp, median * options.clamp)
}

/// How short lengths that are found may become: not shorter than the mesh's own edges. Between its vertices a mesh is
/// flat, so that shorter ones would show nothing of the surface, but they gather at each fold of a scan's noise, where feature
/// size tends to nothing. With this bound the mean distance from the surface is 7 and 16 % less by feature size (bunny with
/// 10,000 points and nefertiti with 50,000). Sheets that are close together count whatever they are made of.
struct Least {
    /// The least length at each vertex,
    edge: Vec<f64>,
    /// unless these ask for less, once they are scaled as the field is.
    sheets: Option<SizeField>,
}

impl Least {
    fn at(&self, v: usize, factor: f64) -> f64 {
        self.sheets.as_ref().map_or(self.edge[v], |sheets| self.edge[v].min(factor * sheets.sizes()[v]))
    }
}

/// Edges may be so much shorter than those of as many even points, even if the mesh has none as short.
const SHORTER: f64 = 0.5;

/// The length of the mesh's own edges at each vertex, caller's units, as far as so many points can tell.
fn resolved(net: &Net, points: f64) -> Vec<f64> {
    let most = SHORTER * net.outline.edge_length(points);
    net.resolution().into_iter().map(|edge| (edge * net.outline.extent).min(most)).collect()
}

/// Lengths that go up and down from vertex to vertex are noise if they change by more than this per distance. Such may be left with
/// a larger [`DensityOptions::gradation`] alone.
const STEEPEST: f64 = 0.5;
/// A surface has noise if it is more than this share of the area: of lengths that are drawn by themselves at each vertex it is a
/// quarter.
const NOISE: f64 = 0.02;
/// Once there is noise, lengths are evened out until no more than this share of the area
const NOISE_LEFT: f64 = 0.005;
/// changes by more than this. On a torus of 6,000 facets with lengths of 100 : 1, 1,000 points take a tenth of the time then.
const STEEPEST_LEFT: f64 = 0.3;
/// Rounds in which lengths are evened out, at most. What is left is looked at after 1, 2, 4, ... of them.
const SMOOTHING_ROUNDS: usize = 64;

/// [`bounded`], after lengths that are noise are evened out, as long as there is any; with the share of the area that was noise,
/// and how many rounds it took. With such lengths a result has poor triangles all over, and takes long to improve.
fn without_noise(
    mut base: SizeField,
    least: Option<&Least>,
    net: &Net,
    options: &DensityOptions,
    target: Option<f64>,
    token: &Token,
) -> Result<(Bounded, f64, usize), DensityError> {
    let mut found = bounded(base.clone(), least, net, options, target, token)?;
    let noise = if options.gradation > STEEPEST { found.field.noise(net, STEEPEST) } else { 0.0 };
    let mut rounds = 0;
    let mut has_noise = noise > NOISE;
    while has_noise && rounds < SMOOTHING_ROUNDS {
        for _ in 0..rounds.max(1) {
            token.check()?;
            base.smooth(net);
            rounds += 1;
        }
        found = bounded(base.clone(), least, net, options, target, token)?;
        has_noise = found.field.noise(net, STEEPEST_LEFT) > NOISE_LEFT;
    }
    Ok((found, if rounds > 0 { noise } else { 0.0 }, rounds))
}

struct Bounded {
    field: SizeField,
    graded: usize,
    outside: usize,
    points: f64,
}

/// Least lengths, gradation and ratio; with a target, the factor for which that many points come out (within half a
/// percent: the rest is the same for all points). Lengths and distances are compared, so the factor has to be found.
fn bounded(
    base: SizeField,
    least: Option<&Least>,
    net: &Net,
    options: &DensityOptions,
    target: Option<f64>,
    token: &Token,
) -> Result<Bounded, DensityError> {
    let once = |factor: f64| -> Result<Bounded, Stopped> {
        let mut field = if factor == 1.0 { base.clone() } else { base.scaled(factor) };
        let raised = least.map_or(0, |least| field.raise(|v| least.at(v, factor)));
        let graded = field.grade(net, options.gradation, token)?;
        let lowered = field.clamp(0.0, field.least() * options.ratio);
        let points = field.points(net);
        Ok(Bounded { field, graded, outside: raised + lowered, points })
    };
    let Some(target) = target else { return Ok(once(1.0)?) };
    let mut factor = (base.points(net) / target).sqrt();
    let mut found = once(factor)?;
    // How many points a factor takes away: its square, less where lengths cannot be shorter. In logarithms.
    let mut slope = 2.0;
    for _ in 0..20 {
        token.check()?;
        let off = (found.points / target).ln();
        if off.abs() < 0.005 {
            break;
        }
        let step = off / slope;
        factor *= step.exp();
        let before = found.points;
        found = once(factor)?;
        slope = ((before / found.points).ln() / step).clamp(0.25, 4.0);
    }
    Ok(found)
}
