//! Random points of a surface.
//!
//! Purpose: points with a density ∝ √w: [`sample`], independent ones, for distances and as the seeds that benches begin at,
//! and [`spread`], the first seeds of a remesh: the surface is cut into pieces of one mass along a curve that goes through
//! all of it, and each piece has one point. Invariant: the same mesh, weights, count and seed give the same bits on every
//! platform and with any number of threads (ChaCha8, one stream; of the floating-point functions only those that IEEE 754
//! rounds correctly). Must not know: the use of the points.

use glam::DVec3;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use super::TriMesh;
use super::bvh::morton;
use super::closest_point::SurfacePoint;
use crate::token::{Stopped, Token};

/// `count` random points on `mesh`, ∝ area times √weight (linear in each facet), from `seed`. `weights` has a value a vertex;
/// without it, or with another length or no positive value, points are uniform. Values negative or not finite count as 0.
///
/// The density is exact within a facet as well: a facet is drawn ∝ area times the root of its largest weight, a point
/// uniformly in it, and the pair is kept with probability √(w / largest), which is at least 8/15 on average.
pub fn sample(mesh: &TriMesh, weights: Option<&[f64]>, count: usize, seed: u64) -> Vec<SurfacePoint> {
    let Some(masses) = Masses::weighted_or_not(mesh, weights) else { return Vec::new() };
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..count).map(|_| masses.draw(&mut rng)).collect()
}

struct Masses<'a> {
    mesh: &'a TriMesh,
    weights: Option<Vec<f64>>,
    /// Running sums of area times the root of the largest weight. Empty facets repeat a value.
    cumulative: Vec<f64>,
    total: f64,
    /// The last facet that is not empty.
    last: usize,
}

impl<'a> Masses<'a> {
    /// Without weights if these are not valid. `None` if no facet has a mass.
    fn weighted_or_not(mesh: &'a TriMesh, weights: Option<&[f64]>) -> Option<Self> {
        weights.and_then(|given| Self::new(mesh, Some(given))).or_else(|| Self::new(mesh, None))
    }

    fn new(mesh: &'a TriMesh, weights: Option<&[f64]>) -> Option<Self> {
        if weights.is_some_and(|given| given.len() != mesh.positions().len()) {
            return None;
        }
        let valid = |w: f64| if w.is_finite() && w > 0.0 { w } else { 0.0 };
        // Only ratios matter; scaled to at most 1 they cannot overflow. Unused vertices do not count.
        let used = |w: &[f64]| mesh.facets().iter().flatten().map(|&v| valid(w[v as usize])).fold(0.0, f64::max);
        let largest = weights.map_or(1.0, used);
        let weights: Option<Vec<f64>> = weights.map(|given| given.iter().map(|&w| valid(w) / largest).collect());
        let (low, high) = mesh.bounds();
        let extent = (high - low).max_element();
        let mut total = 0.0;
        let mut last = None;
        let mut cumulative = Vec::with_capacity(mesh.facets().len());
        for facet in 0..mesh.facets().len() {
            let [a, b, c] = mesh.corners(facet).map(|p| (p - low) / extent);
            let area = if mesh.is_degenerate(facet) { 0.0 } else { (b - a).cross(c - a).length() };
            let of_corners = |w: &Vec<f64>| mesh.facets()[facet].iter().map(|&v| w[v as usize]).fold(0.0, f64::max);
            let top = weights.as_ref().map_or(1.0, of_corners);
            let before = total;
            total += area * top.sqrt();
            if total > before {
                last = Some(facet);
            }
            cumulative.push(total);
        }
        last.map(|last| Self { mesh, weights, cumulative, total, last })
    }

    /// Weights of a facet's corners, the largest of the mesh 1.
    fn weights(&self, facet: usize) -> Option<[f64; 3]> {
        self.weights.as_ref().map(|weights| self.mesh.facets()[facet].map(|v| weights[v as usize]))
    }

    /// Area of a facet times the root of its largest weight.
    fn most(&self, facet: usize) -> f64 {
        self.cumulative[facet] - if facet > 0 { self.cumulative[facet - 1] } else { 0.0 }
    }

    fn draw(&self, rng: &mut ChaCha8Rng) -> SurfacePoint {
        loop {
            let Draw { target, barycentric: [u, v, w] } = Draw::next(rng, self.total);
            let facet = self.cumulative.partition_point(|&sum| sum <= target).min(self.last);
            if let Some([wa, wb, wc]) = self.weights(facet) {
                let density = u * wa + v * wb + w * wc;
                let chance = uniform(rng);
                // chance < √(density / top), without a division.
                if chance * chance * wa.max(wb).max(wc) >= density {
                    continue;
                }
            }
            return self.point(facet, [u, v, w]);
        }
    }

    fn point(&self, facet: usize, barycentric: [f64; 3]) -> SurfacePoint {
        let position = position(self.mesh.corners(facet), barycentric);
        SurfacePoint { position, facet: facet as u32, barycentric }
    }
}

fn position([a, b, c]: [DVec3; 3], barycentric: [f64; 3]) -> DVec3 {
    a + (b - a) * barycentric[1] + (c - a) * barycentric[2]
}

/// What a point is drawn by: it lies in the first facet with which the masses of facets sum up to more than `target`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Draw {
    pub(crate) target: f64,
    barycentric: [f64; 3],
}

impl Draw {
    fn next(rng: &mut ChaCha8Rng, total: f64) -> Self {
        Self { target: uniform(rng) * total, barycentric: in_triangle(rng) }
    }

    /// The point in a facet with these corners.
    pub(crate) fn point(&self, corners: [DVec3; 3]) -> DVec3 {
        position(corners, self.barycentric)
    }
}

/// What the points of [`sample`] are drawn by without weights, for facets of this mass in all.
pub(crate) fn draws(count: usize, seed: u64, total: f64) -> impl Iterator<Item = Draw> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..count).map(move |_| Draw::next(&mut rng, total))
}

/// Barycentric coordinates of a random point of a triangle, uniform.
fn in_triangle(rng: &mut ChaCha8Rng) -> [f64; 3] {
    let (mut v, mut w) = (uniform(rng), uniform(rng));
    if v + w > 1.0 {
        (v, w) = (1.0 - v, 1.0 - w);
    }
    [(1.0 - v - w).max(0.0), v, w]
}

/// Uniform in [0, 1), 53 bits.
fn uniform(rng: &mut ChaCha8Rng) -> f64 {
    (rng.next_u64() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
}

/// Least number of times that a facet with weights is quartered: within the parts the weight counts as constant.
const LEVELS: i32 = 3;
/// Most times that a facet is quartered; it is until a part holds a fourth of a point.
const MOST_LEVELS: i32 = 20;
const FINER: f64 = 4.0;

/// Draws `count` random points on `mesh` with the density of [`sample`], spread out: every part of the surface has
/// its share to within a few points. Independent points miss it by the root of their number. Such errors are long waves of
/// the density, which iterations remove last. A facet's mass is a quadrature at four of its points.
///
/// `weights` is as in [`sample`]. `regions` has a number for each facet (all the same if `None`). Facets of one
/// number follow each other, so that each region has its share to within one point. Points have the order of the curve:
/// facets by their region and the Morton order of their middles, places in a facet by its quarters, the quarters of these
/// and so on (Basu and Owen, *Low discrepancy constructions in the triangle*, SIAM J. Numer. Anal. 2015, section 3).
pub fn spread(
    mesh: &TriMesh,
    weights: Option<&[f64]>,
    regions: Option<&[u32]>,
    count: usize,
    seed: u64,
) -> Vec<SurfacePoint> {
    spread_unless(mesh, (weights, regions), count, seed, &Token::default()).unwrap_or_default()
}

/// As [`spread`], unless it is stopped.
pub fn spread_unless(
    mesh: &TriMesh,
    (weights, regions): (Option<&[f64]>, Option<&[u32]>),
    count: usize,
    seed: u64,
    token: &Token,
) -> Result<Vec<SurfacePoint>, Stopped> {
    let Some(masses) = Masses::weighted_or_not(mesh, weights) else { return Ok(Vec::new()) };
    token.check()?;
    let curve = Curve::through(&masses, regions, token)?;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut place = 0;
    let point = |k: usize| {
        // Each takes up to 20 quarterings.
        token.check_at(8 * k)?;
        let share = (k as f64 + uniform(&mut rng)) / count as f64;
        place = curve.place_after(place, share);
        Ok(curve.point(place, share, count, &mut rng))
    };
    (0..count).map(point).collect()
}

/// A part of a facet: the barycentric coordinates of its corners.
type Part = [[f64; 3]; 3];

const WHOLE: Part = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// A way through all of a surface.
struct Curve<'a> {
    masses: &'a Masses<'a>,
    /// Facets with a mass.
    facets: Vec<u32>,
    sums: Vec<f64>,
}

impl<'a> Curve<'a> {
    fn through(masses: &'a Masses<'a>, regions: Option<&[u32]>, token: &Token) -> Result<Self, Stopped> {
        let mesh = masses.mesh;
        let (low, high) = mesh.bounds();
        // Halves first: bounds may be as far apart as numbers go.
        let (middle, half) = (low * 0.5 + high * 0.5, (high * 0.5 - low * 0.5).max_element());
        let place = |f: u32| {
            let [a, b, c] = mesh.corners(f as usize).map(|p| (p - middle) / half);
            morton((a + b + c) / 3.0)
        };
        let with_mass = (0..mesh.facets().len() as u32).filter(|&f| masses.most(f as usize) > 0.0);
        let region = |f: u32| regions.and_then(|r| r.get(f as usize)).copied().unwrap_or(0);
        let mut order: Vec<(u32, u64, u32)> = with_mass.map(|f| (region(f), place(f), f)).collect();
        token.check()?;
        order.sort_unstable();
        token.check()?;
        let facets: Vec<u32> = order.into_iter().map(|(_, _, f)| f).collect();
        let mut total = 0.0;
        let sum = |&f: &u32| {
            total += mass(masses, f as usize);
            total
        };
        let sums = facets.iter().map(sum).collect();
        Ok(Self { masses, facets, sums })
    }

    fn total(&self) -> f64 {
        self.sums.last().copied().unwrap_or(0.0)
    }

    /// The facet in which this share of the mass ends, which is not before `place`.
    fn place_after(&self, place: usize, share: f64) -> usize {
        let target = share * self.total();
        let ahead = self.sums[place..].iter().position(|&sum| sum > target);
        ahead.map_or(self.sums.len() - 1, |ahead| place + ahead)
    }

    fn point(&self, place: usize, share: f64, count: usize, rng: &mut ChaCha8Rng) -> SurfacePoint {
        let before = if place > 0 { self.sums[place - 1] } else { 0.0 };
        let (facet, mass) = (self.facets[place] as usize, self.sums[place] - before);
        let rest = if mass > 0.0 { (share * self.total() - before) / mass } else { 0.5 };
        let part = self.part(facet, rest.clamp(0.0, 1.0), FINER * count as f64 * mass / self.total());
        let inside = in_triangle(rng);
        let barycentric = [0, 1, 2].map(|k| (0..3).map(|corner| inside[corner] * part[corner][k]).sum());
        self.masses.point(facet, barycentric)
    }

    /// The part of a facet, of at least `parts` parts, that contains this share of its mass.
    fn part(&self, facet: usize, mut rest: f64, parts: f64) -> Part {
        let weights = self.masses.weights(facet);
        let (least, mut part) = (if weights.is_some() { LEVELS } else { 0 }, WHOLE);
        for level in 0..MOST_LEVELS {
            if level >= least && 4f64.powi(level) >= parts {
                break;
            }
            let quarters = quarters(&part);
            let masses = quarters.map(|q| root_in_middle(weights, &q));
            let mut target = rest * masses.iter().sum::<f64>();
            // The last one, should rounding leave something.
            let mut chosen = 0;
            while chosen < 3 && target >= masses[chosen] {
                target -= masses[chosen];
                chosen += 1;
            }
            rest = if masses[chosen] > 0.0 { (target / masses[chosen]).clamp(0.0, 1.0) } else { 0.5 };
            part = quarters[chosen];
        }
        part
    }
}

/// Mass of a facet: its area times the mean root of its weight, about.
fn mass(masses: &Masses<'_>, facet: usize) -> f64 {
    let Some(weights) = masses.weights(facet) else { return masses.most(facet) };
    let top = weights[0].max(weights[1]).max(weights[2]).sqrt();
    let roots = quarters(&WHOLE).map(|q| root_in_middle(Some(weights), &q));
    masses.most(facet) * (roots.iter().sum::<f64>() / (4.0 * top))
}

/// A part's quarters, each but the last beside the one before.
fn quarters([a, b, c]: &Part) -> [Part; 4] {
    let middle = |p: &[f64; 3], q: &[f64; 3]| [0, 1, 2].map(|k| 0.5 * (p[k] + q[k]));
    let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
    [[*a, ab, ca], [bc, ca, ab], [ab, *b, bc], [ca, bc, *c]]
}

/// The root of the weight in the middle of a part.
fn root_in_middle(weights: Option<[f64; 3]>, part: &Part) -> f64 {
    let Some([a, b, c]) = weights else { return 1.0 };
    let at = |p: &[f64; 3]| p[0] * a + p[1] * b + p[2] * c;
    (part.iter().map(at).sum::<f64>() / 3.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes::Shape;

    /// How far the numbers of points left of a few lines are from their shares, at most.
    fn error(points: &[SurfacePoint], share_left_of: impl Fn(f64) -> f64) -> f64 {
        let lines = (1..20).map(|k| f64::from(k) / 20.0);
        let there = |x: f64| points.iter().filter(|p| p.position.x < x).count() as f64;
        lines.map(|x| (there(x) - points.len() as f64 * share_left_of(x)).abs()).fold(0.0, f64::max)
    }

    #[test]
    fn every_part_has_its_share() {
        // A square of two facets, and one of many; corners at 0 and 1.
        for shape in [Shape::Square, Shape::Plane] {
            let mesh = shape.build(2000);
            let (low, high) = mesh.bounds();
            assert_eq!((low.x, high.x), (0.0, 1.0), "{shape}");
            let points = spread(&mesh, None, None, 4000, 3);
            assert_eq!(points.len(), 4000);
            // A line meets some 60 pieces; of independent points 32 are too many in the mean.
            let off = error(&points, |x| x);
            assert!(off < 16.0, "{shape}: {off}");
            assert_eq!(points, spread(&mesh, None, None, 4000, 3));
            assert_ne!(points, spread(&mesh, None, None, 4000, 4));
        }
    }

    #[test]
    fn weights_are_followed_within_a_facet_too() {
        // w = x, so that the density is √x, in two facets.
        let mesh = Shape::Square.build(2);
        let weights: Vec<f64> = mesh.positions().iter().map(|p| p.x).collect();
        let points = spread(&mesh, Some(&weights), None, 4000, 5);
        let off = error(&points, |x| x.powf(1.5));
        // The quadrature of a facet's mass alone makes a few in a hundred; beside these the parts' steps.
        assert!(off < 60.0, "{off}");
        let none = vec![0.0; weights.len()];
        assert_eq!(spread(&mesh, Some(&none), None, 10, 4), spread(&mesh, None, None, 10, 4));
    }

    #[test]
    fn a_region_has_its_share_to_within_one() {
        // Every third facet of a torus, wherever it is.
        let mesh = Shape::Torus.build(900);
        let regions: Vec<u32> = (0..mesh.facets().len() as u32).map(|f| f % 3).collect();
        let area = |f: usize| {
            let [a, b, c] = mesh.corners(f);
            (b - a).cross(c - a).length() / 2.0
        };
        let points = spread(&mesh, None, Some(&regions), 500, 7);
        for region in 0..3 {
            let share: f64 = (0..regions.len()).filter(|&f| regions[f] == region).map(area).sum::<f64>() / mesh.area();
            let there = points.iter().filter(|p| regions[p.facet as usize] == region).count() as f64;
            assert!((there - 500.0 * share).abs() <= 1.0, "{there} for {}", 500.0 * share);
        }
    }

    #[test]
    fn points_lie_where_they_say() {
        for shape in [Shape::Torus, Shape::Slivers, Shape::Sheets] {
            let mesh = shape.build(300);
            for p in spread(&mesh, None, None, 1000, 1) {
                let [a, b, c] = mesh.corners(p.facet as usize);
                let [u, v, w] = p.barycentric;
                assert!((a * u + b * v + c * w).distance(p.position) < 1e-12, "{shape}");
                assert!((u + v + w - 1.0).abs() < 1e-12 && u.min(v).min(w) >= 0.0, "{shape}");
            }
        }
        assert!(spread(&Shape::Torus.build(300), None, None, 0, 1).is_empty());
    }
}
