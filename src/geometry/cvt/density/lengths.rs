//! Edge lengths that vary: from a source, within bounds; and how many points they need.
//!
//! Purpose: [`of_curvature`] has lengths up to a factor; [`bounded`] applies least lengths, gradation and ratio, and finds
//! the factor for a number of points. [`Outline`] has what the count for one length needs: area, length of the boundary, χ.
//! Invariant: no length is zero. The two directions of an outline are each other's inverse; no power of a length overflows. The
//! same bits with any number of threads. Must not know: weights, facets.

use glam::DVec3;

use super::curvature;
use super::net::Net;
use super::options::{DensityError, DensityOptions};
use super::size_field::SizeField;
use crate::mesh::TriMesh;
use crate::mesh::adjacency::{Adjacency, EdgeKind};
use crate::mesh::measure::topology_unless;
use crate::token::{Stopped, Token};

/// A surface is taken as no flatter than a ball of its own width, so that a plane has a length too.
const LEAST_CURVATURE: f64 = 1.0;

/// Lengths up to a factor. Normals are smoothed over half of the edge length that `points` even points have: what is
/// smaller cannot be kept anyway. At least one round, so that a scan's noise is not its curvature, at most 40.
pub(super) fn of_curvature(net: &Net, points: f64, token: &Token) -> Result<Vec<f64>, Stopped> {
    let radius = 0.5 * net.outline.edge_length(points) / net.outline.extent / net.mean_edge();
    // A round moves by 6/7 of an edge's square in the mean: six neighbours and the vertex itself.
    let rounds = (radius * radius * 7.0 / 6.0).ceil().clamp(1.0, 40.0);
    let curvature = curvature::largest(net, rounds as usize, token)?;
    let length = |k: f64| if k.is_nan() { f64::NAN } else { k.max(LEAST_CURVATURE).powf(-0.5) };
    Ok(curvature.into_iter().map(length).collect())
}

/// Lengths that a source could not tell (NaN) become the median; all in caller's units.
pub(super) fn fill_gaps(net: &Net, mut raw: Vec<f64>) -> Vec<f64> {
    let median = net.median(&raw);
    let median = if median > 0.0 { median } else { 1.0 };
    // A medial axis that runs through a vertex gives 0; the clamp decides how small that is.
    raw.iter_mut().for_each(|h| *h = if h.is_nan() { median } else { h.max(1e-9) } * net.outline.extent);
    raw
}

/// Adaptivity, and the bounds about the median; says how many lengths were outside.
pub(super) fn adapt(field: &mut SizeField, median: f64, options: &DensityOptions) -> usize {
    field.flatten(median, options.adaptivity);
    field.clamp(median / options.clamp, median * options.clamp)
}

/// How short lengths that are found may become: not shorter than the mesh's own edges. Between its vertices a mesh is
/// flat, so that shorter ones would show nothing of the surface, but they gather at each fold of a scan's noise, where feature
/// size tends to nothing. With this bound the mean distance from the surface is 7 and 16 % less by feature size (bunny with
/// 10,000 points and nefertiti with 50,000). Sheets that are close together count whatever they are made of.
pub(super) struct Least {
    pub(super) edge: Vec<f64>,
    /// Lengths between close sheets. They are scaled as the field is, and may be shorter than `edge`.
    pub(super) sheets: Option<SizeField>,
}

impl Least {
    fn at(&self, v: usize, factor: f64) -> f64 {
        self.sheets.as_ref().map_or(self.edge[v], |sheets| self.edge[v].min(factor * sheets.sizes[v]))
    }
}

/// Edges may be so much shorter than those of as many even points, even if the mesh has none as short.
const SHORTER: f64 = 0.5;

/// The length of the mesh's own edges at each vertex, caller's units, as far as `points` points can resolve.
pub(super) fn resolved(net: &Net, points: f64) -> Vec<f64> {
    let most = SHORTER * net.outline.edge_length(points);
    net.resolution().into_iter().map(|edge| (edge * net.outline.extent).min(most)).collect()
}

/// Lengths up and down from vertex to vertex are noise if they change by more per distance, as a large gradation allows.
const STEEPEST: f64 = 0.5;
/// A surface has noise if it is more than this share of the area: lengths drawn alone at each vertex have a quarter.
const NOISE: f64 = 0.02;
/// Smoothing of noisy lengths ends when those of no more than this share of the area are steeper than [`STEEPEST_LEFT`].
const NOISE_LEFT: f64 = 0.005;
/// Steepest change that smoothing may leave. On a torus with lengths of 100 : 1, it saves nine tenths of the time.
const STEEPEST_LEFT: f64 = 0.3;
/// Smoothing rounds, at most. The rest is measured after 1, 2, 4, ... rounds.
const SMOOTHING_ROUNDS: usize = 64;

/// [`bounded`], after lengths that are noise are evened out, as long as there is any; with the share of the area that was noise,
/// and how many rounds it took. With such lengths a result has poor triangles all over, and takes long to improve.
pub(super) fn without_noise(
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

pub(super) struct Bounded {
    pub(super) field: SizeField,
    pub(super) graded: usize,
    pub(super) outside: usize,
    pub(super) points: f64,
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

/// 2/√3: points per area where edges have length 1, as each owns a hexagon of area √3/2.
pub(super) const POINTS_PER_AREA: f64 = 1.154_700_538_379_251_6;

/// Area, boundary and χ of a surface.
///
/// A triangulation with b vertices on the boundary has T = 2n - b - 2χ triangles. With equilateral ones
/// of edge length h, T = 4A/(√3 h²) and b = ℓ/h, so n = (2/√3) A/h² + ℓ/(2h) + χ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outline {
    /// Longest side of the bounding box, caller's units.
    pub(super) extent: f64,
    /// In units of `extent`².
    pub(super) area: f64,
    /// Length of all boundary edges, in units of `extent`.
    pub(super) boundary: f64,
    pub(super) euler: f64,
}

impl Outline {
    /// Measures `mesh`.
    pub fn new(mesh: &TriMesh, token: &Token) -> Result<Self, Stopped> {
        let adjacency = Adjacency::new(mesh);
        token.check()?;
        Self::of(mesh, &adjacency, token)
    }

    pub(super) fn of(mesh: &TriMesh, adjacency: &Adjacency, token: &Token) -> Result<Self, Stopped> {
        let (low, high) = mesh.bounds();
        let extent = (high - low).max_element();
        let boundary = boundary_edges(mesh, adjacency).map(|[a, b]| ((a - b) / extent).length()).sum();
        // In the box of side 1: the area of a mesh scaled by 1e-200 is no number.
        let area = (0..mesh.facets().len())
            .filter(|&f| !mesh.is_degenerate(f))
            .map(|f| mesh.corners(f).map(|p| (p - low) / extent))
            .map(|[a, b, c]| 0.5 * (b - a).cross(c - a).length())
            .sum();
        token.check()?;
        let euler = topology_unless(mesh, adjacency, token)?.euler as f64;
        Ok(Self { extent, area, boundary, euler })
    }

    /// The number of points that edges of length `edge` (caller's units) need, not rounded.
    pub fn points(&self, edge: f64) -> f64 {
        let h = edge / self.extent;
        self.count(POINTS_PER_AREA * self.area / h / h, self.boundary / h)
    }

    /// The edge length, caller's units, that `points` points have if they are spread evenly.
    pub fn edge_length(&self, points: f64) -> f64 {
        let area = POINTS_PER_AREA * self.area;
        let half = 0.5 * self.boundary;
        // n h² - ℓ/2 h - (2/√3) A = 0, with χ bounded as in `count`.
        let n = (points - self.euler).max(0.5 * points).min(2.0 * points);
        let h = (0.5 * half + (0.25 * half * half + n * area).sqrt()) / n;
        h * self.extent
    }

    /// Points from the two integrals: over the area, and over the boundary. χ is taken into account as long as
    /// it changes them by no more than a factor of two: a torn surface may have a χ of any size.
    pub(super) fn count(&self, cells: f64, boundary: f64) -> f64 {
        let flat = cells + 0.5 * boundary;
        // Lengths so small that they vanish beside the extent: 0 of a boundary over 0.
        if flat.is_nan() {
            return f64::INFINITY;
        }
        (flat + self.euler).max(0.5 * flat).min(2.0 * flat).max(1.0)
    }
}

fn boundary_edges<'a>(mesh: &'a TriMesh, adjacency: &'a Adjacency) -> impl Iterator<Item = [DVec3; 2]> + 'a {
    let halves = (0..3 * mesh.facets().len()).filter(|&half| adjacency.kind(half) == EdgeKind::Boundary);
    halves.map(|half| {
        let corners = mesh.corners(half / 3);
        [corners[half % 3], corners[(half % 3 + 1) % 3]]
    })
}
