//! Edge lengths that vary: from a source, within bounds; and how many points they need.
//!
//! Purpose: [`of_curvature`] has lengths up to a factor; [`bounded`] applies least lengths, gradation and ratio, and finds
//! the factor for a number of points.
//! Invariant: no length is zero. The same bits with any number of threads. Must not know: weights, facets.

use super::curvature;
use super::net::Net;
use super::options::{DensityError, DensityOptions};
use super::size_field::SizeField;
use crate::token::{Stopped, Token};

/// A surface is taken as no flatter than a ball of its own width, so that a plane has a length too.
const LEAST_CURVATURE: f64 = 1.0;

/// Lengths up to a factor. Normals are smoothed over half of the edge length that `points` even points have: what is
/// smaller cannot be kept anyway. At least one round, so that a scan's noise is not its curvature, at most 40. `rims`: [`Net::rims`].
pub(super) fn of_curvature(net: &Net, rims: &[[u32; 2]], points: f64, token: &Token) -> Result<Vec<f64>, Stopped> {
    let length = |k: [f64; 2]| k[0].abs().max(LEAST_CURVATURE).powf(-0.5);
    of_principal(net, rims, points, length, token)
}

/// Triangles are at most so many times as long as wide.
pub(crate) const LONGEST: f64 = 8.0;

/// Lengths up to a factor by the Gaussian curvature, to the power of minus `power`. No rim is smoothed by itself: scans have straight
/// rims beside jagged ones, and with the smaller curvature less noisy there their results are farther off (bunny, 0.16 to 0.20 %).
pub(super) fn of_error(net: &Net, points: f64, power: f64, token: &Token) -> Result<Vec<f64>, Stopped> {
    let gauss = |[larger, smaller]: [f64; 2]| {
        let least = LEAST_CURVATURE.max(larger.abs()) / LONGEST;
        (larger * smaller).abs().max(least * least)
    };
    of_principal(net, &[], points, |k| gauss(k).powf(-power), token)
}

fn of_principal(
    net: &Net,
    rims: &[[u32; 2]],
    points: f64,
    length: impl Fn([f64; 2]) -> f64,
    token: &Token,
) -> Result<Vec<f64>, Stopped> {
    let radius = 0.5 * net.outline.edge_length(points) / net.outline.extent / net.mean_edge();
    // A round moves by 6/7 of an edge's square in the mean: six neighbours and the vertex itself.
    let rounds = (radius * radius * 7.0 / 6.0).ceil().clamp(1.0, 40.0);
    let curvature = curvature::of(net, rims, rounds as usize, token)?;
    Ok(curvature.into_iter().map(|k| if k[0].is_nan() { f64::NAN } else { length(k) }).collect())
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

/// What bounds lengths that are found, beside the options.
#[derive(Clone, Copy)]
pub(super) struct Limits<'a> {
    pub(super) least: Option<&'a Least>,
    /// Lengths of zones, by vertex, as `beside`.
    pub(super) of_zones: &'a [f64],
    /// Lengths that edges have already, by vertex: NaN where there are none. Nothing if there are none at all.
    pub(super) beside: &'a [f64],
}

/// Beside edges that have their lengths already, others are as long, but no more than so many times as long as they would be, and no
/// less than this part. A triangle on a longer edge is slender, and points would gather at a shorter one.
const LONGEST_BESIDE: f64 = 2.0;
const SHORTEST_BESIDE: f64 = 1.0 / 50.0;

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
    limits: Limits<'_>,
    net: &Net,
    options: &DensityOptions,
    target: Option<f64>,
    token: &Token,
) -> Result<(Bounded, f64, usize), DensityError> {
    let mut found = bounded(base.clone(), limits, net, options, target, token)?;
    let noise = if options.gradation > STEEPEST { found.field.noise(net, STEEPEST) } else { 0.0 };
    let mut rounds = 0;
    let mut has_noise = noise > NOISE;
    while has_noise && rounds < SMOOTHING_ROUNDS {
        for _ in 0..rounds.max(1) {
            token.check()?;
            base.smooth(net);
            rounds += 1;
        }
        found = bounded(base.clone(), limits, net, options, target, token)?;
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
    limits: Limits<'_>,
    net: &Net,
    options: &DensityOptions,
    target: Option<f64>,
    token: &Token,
) -> Result<Bounded, DensityError> {
    let once = |factor: f64| -> Result<Bounded, Stopped> {
        let mut field = if factor == 1.0 { base.clone() } else { base.scaled(factor) };
        let raised = limits.least.map_or(0, |least| field.raise(|v| least.at(v, factor)));
        field.put(limits.of_zones, [0.0, f64::INFINITY]);
        field.put(limits.beside, [SHORTEST_BESIDE, LONGEST_BESIDE]);
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
