//! Seeds on curves: corners, creases and boundaries.
//!
//! Purpose: a seed at every corner, and on every curve as many as its length asks for, at the centroids of
//! their own stretches of it: a centroidal Voronoi tessellation of one dimension. They are
//! held while the other seeds move, and the other seeds are kept clear of them, so that the dual has
//! every curve as a chain of edges (\[YLL*09\], section 5, has seeds of curves move with the rest; on a
//! curve of its own density the tessellation of one dimension is known at once and needs no other seed).
//! Invariant: with edge length h, density h⁻³ on a curve has the spacing that density h⁻⁴ has on the
//! surface: the weight w of a surface is w^(3/4) on its curves. Lengths are those of the unit frame.
//! Must not know: how curves were found, backends.

use glam::DVec3;

use crate::knn::SeedIndex;
use crate::mesh::features::{Curve, Features};
use crate::rvd::Surface;

/// Seeds of curves, the first of all seeds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CurveSeeds {
    /// Unit frame: corners first, then curve by curve.
    pub seeds: Vec<DVec3>,
    /// How many of them are corners.
    pub corners: usize,
    /// Neighbours on a curve.
    pub segments: Vec<Segment>,
}

/// Two neighbouring seeds of a curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    /// The seeds.
    pub ends: [u32; 2],
    /// The point of the curve half-way between them, unit frame.
    pub middle: DVec3,
    /// Which curve.
    pub curve: u32,
}

/// Steps of Lloyd's iteration on a curve whose density varies. It starts at equal shares of ∫ ds/h,
/// where the tessellation ends up as the seeds become many.
const STEPS: usize = 20;
/// Points at which the density is taken on each edge of a curve.
const PARTS: usize = 4;

/// The edge length in the unit frame that so many seeds will have where the weight is 1: 1/u of
/// (4/√3) u² ∫√w + u ∫_boundary w^(1/4) = 2n, since a triangulation of n vertices, of which b lie on the
/// boundary, has 2n - b - 2χ triangles of area √3/4 h².
pub fn edge_length(surface: &Surface, features: &Features, seeds: usize) -> f64 {
    use crate::mesh::features::CurveKind::Boundary;
    let boundary = features.curves.iter().filter(|c| c.kind == Boundary);
    let one: f64 = boundary.map(|c| Path::new(surface, c, 1.0).total()).sum();
    let two = 4.0 / 3f64.sqrt() * surface.root_mass();
    let u = 0.5 * ((one * one + 8.0 * two * seeds as f64).sqrt() - one) / two;
    1.0 / u
}

impl CurveSeeds {
    /// Seeds for all curves, about `edge` (where the weight is 1) apart.
    pub fn place(surface: &Surface, features: &Features, edge: f64) -> Self {
        let at = |v: u32| surface.positions()[v as usize];
        let mut all = Self { corners: features.corners.len(), ..Self::default() };
        all.seeds.extend(features.corners.iter().map(|&v| at(v)));
        let corner = |v: u32| features.corners.binary_search(&v).ok().map(|k| k as u32);
        let ends = |c: &Curve| {
            let (a, b) = (c.vertices[0], c.vertices[c.vertices.len() - 1]);
            (a.min(b), a.max(b))
        };
        let mut pairs: Vec<(u32, u32)> = features.curves.iter().filter(|c| !c.closed).map(ends).collect();
        pairs.sort_unstable();
        for (number, curve) in features.curves.iter().enumerate() {
            let path = Path::new(surface, curve, edge);
            // Fewer would give two edges the same ends.
            let least = match curve.closed {
                true => 3,
                false if ends(curve).0 == ends(curve).1 => 3,
                false if pairs.iter().filter(|&&p| p == ends(curve)).count() > 1 => 2,
                false => 1,
            };
            let count = (path.total().round() as usize).max(least);
            let places = path.tessellate(count, curve.closed, surface.is_uniform());
            let first = all.seeds.len() as u32;
            all.seeds.extend(places.iter().map(|&s| path.at(s)));
            let inner = (0..places.len() as u32).map(|k| first + k);
            let last = curve.vertices[curve.vertices.len() - 1];
            let mut chain: Vec<(u32, f64)> = inner.zip(places.iter().copied()).collect();
            if curve.closed {
                chain.extend(chain.first().map(|&(seed, s)| (seed, s + path.length())));
            } else if let (Some(a), Some(b)) = (corner(curve.vertices[0]), corner(last)) {
                chain.insert(0, (a, 0.0));
                chain.push((b, path.length()));
            }
            all.segments.extend(chain.windows(2).map(|w| Segment {
                ends: [w[0].0, w[1].0],
                middle: path.at(0.5 * (w[0].1 + w[1].1)),
                curve: number as u32,
            }));
        }
        all
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.seeds.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.seeds.is_empty()
    }

    /// Seeds that come between two neighbours on a curve: (seed, segment). Their cells hold a part of
    /// the curve, and the dual may have the curve no more. On a straight curve such a seed is nearer to the
    /// middle of the segment than its ends are.
    pub fn intruders(&self, seeds: &[DVec3], index: &SeedIndex) -> Vec<(u32, u32)> {
        let mut found = Vec::new();
        for (k, segment) in self.segments.iter().enumerate() {
            let nearest = index.nearest(segment.middle);
            if nearest as usize >= self.seeds.len() {
                let reach = segment.ends.map(|e| seeds[e as usize].distance(segment.middle));
                if seeds[nearest as usize].distance(segment.middle) < reach[0].min(reach[1]) {
                    found.push((nearest, k as u32));
                }
            }
        }
        found
    }

    /// Moves intruders away from their segments, to the distance that the next row of a regular
    /// triangulation has. Returns how many there were. One pass: who was pushed may intrude elsewhere.
    pub fn push_out(&self, seeds: &mut [DVec3]) -> usize {
        let intruders = self.intruders(seeds, &SeedIndex::new(seeds));
        for &(seed, segment) in &intruders {
            let Segment { ends, middle, .. } = self.segments[segment as usize];
            let along = seeds[ends[1] as usize] - seeds[ends[0] as usize];
            let away = seeds[seed as usize] - middle;
            // Across the curve, where there is such a direction.
            let across = away - along * (away.dot(along) / along.length_squared().max(f64::MIN_POSITIVE));
            let way = across.try_normalize().or_else(|| away.try_normalize()).unwrap_or(DVec3::X);
            seeds[seed as usize] = middle + 0.75 * along.length() * way;
        }
        intruders.len()
    }

    /// A distance for each curve seed and each middle of a segment within which no other seed should begin:
    /// three quarters of the spacing there.
    pub fn clearance(&self) -> (Vec<DVec3>, Vec<f64>) {
        let mut reach = vec![0.0f64; self.seeds.len()];
        let mut middles = (Vec::new(), Vec::new());
        for s in &self.segments {
            let d = self.seeds[s.ends[0] as usize].distance(self.seeds[s.ends[1] as usize]);
            s.ends.iter().for_each(|&e| reach[e as usize] = reach[e as usize].max(0.75 * d));
            middles.0.push(s.middle);
            middles.1.push(0.75 * d);
        }
        (self.seeds.iter().copied().chain(middles.0).collect(), reach.into_iter().chain(middles.1).collect())
    }
}

/// A curve by arc length, with ∫ ds/h, ∫ ds/h³ and ∫ s ds/h³ up to each of its points.
struct Path {
    points: Vec<DVec3>,
    /// Arc length.
    along: Vec<f64>,
    /// ∫ ds/h: how many edges fit.
    edges: Vec<f64>,
    mass: Vec<f64>,
    moment: Vec<f64>,
}

impl Path {
    fn new(surface: &Surface, curve: &Curve, edge: f64) -> Self {
        let mut path =
            Self { points: Vec::new(), along: Vec::new(), edges: Vec::new(), mass: Vec::new(), moment: Vec::new() };
        let mut last: Option<(DVec3, f64)> = None;
        for v in curve.round() {
            let (p, w) = (surface.positions()[v as usize], surface.weights()[v as usize]);
            match last {
                None => path.push(p, 0.0, 0.0, edge),
                Some((q, u)) => (1..=PARTS).for_each(|k| {
                    let t = k as f64 / PARTS as f64;
                    let before = (k - 1) as f64 / PARTS as f64;
                    path.push(q.lerp(p, t), u + before * (w - u), u + t * (w - u), edge);
                }),
            }
            last = Some((p, w));
        }
        path
    }

    /// Goes on to `p`; the weight is `before` where the path is and `after` there.
    fn push(&mut self, p: DVec3, before: f64, after: f64, edge: f64) {
        let Some(&q) = self.points.last() else {
            self.points.push(p);
            [&mut self.along, &mut self.edges, &mut self.mass, &mut self.moment]
                .into_iter()
                .for_each(|list| list.push(0.0));
            return;
        };
        let last = self.points.len() - 1;
        let step = q.distance(p);
        let (s, t) = (self.along[last], self.along[last] + step);
        let (a, b) = (before.powf(0.25) / edge, after.powf(0.25) / edge);
        let (ma, mb) = (a * a * a, b * b * b);
        self.points.push(p);
        self.along.push(t);
        self.edges.push(self.edges[last] + 0.5 * (a + b) * step);
        self.mass.push(self.mass[last] + 0.5 * (ma + mb) * step);
        self.moment.push(self.moment[last] + 0.5 * (ma * s + mb * t) * step);
    }

    fn length(&self) -> f64 {
        self.along[self.along.len() - 1]
    }

    /// How many edges fit.
    fn total(&self) -> f64 {
        self.edges[self.edges.len() - 1]
    }

    /// The point at an arc length, that of a closed curve going round.
    fn at(&self, s: f64) -> DVec3 {
        let s = if s > self.length() { s - self.length() } else { s };
        let k = self.along.partition_point(|&a| a <= s).clamp(1, self.along.len() - 1);
        let width = self.along[k] - self.along[k - 1];
        let t = if width > 0.0 { ((s - self.along[k - 1]) / width).clamp(0.0, 1.0) } else { 0.0 };
        if t == 1.0 { self.points[k] } else { self.points[k - 1] + t * (self.points[k] - self.points[k - 1]) }
    }

    /// Arc lengths of the seeds of `count` segments, without those at the ends; a closed curve has its first
    /// one where it begins.
    fn tessellate(&self, count: usize, closed: bool, uniform: bool) -> Vec<f64> {
        let share = self.total() / count as f64;
        let mut places: Vec<f64> = match share > 0.0 {
            true => (1..count).map(|k| interpolate(&self.edges, &self.along, share * k as f64)).collect(),
            // A curve without weight anywhere is divided by length.
            false => (1..count).map(|k| self.length() * k as f64 / count as f64).collect(),
        };
        if !uniform && !places.is_empty() {
            self.relax(&mut places);
        }
        if closed {
            places.insert(0, 0.0);
        }
        places
    }

    /// Lloyd's iteration of inner seeds between two that stay at the ends.
    fn relax(&self, places: &mut [f64]) {
        for _ in 0..STEPS {
            let mut bounds = vec![0.5 * places[0]];
            bounds.extend(places.windows(2).map(|p| 0.5 * (p[0] + p[1])));
            bounds.push(0.5 * (places[places.len() - 1] + self.length()));
            for (k, place) in places.iter_mut().enumerate() {
                let of = |list: &[f64]| {
                    interpolate(&self.along, list, bounds[k + 1]) - interpolate(&self.along, list, bounds[k])
                };
                let (mass, moment) = (of(&self.mass), of(&self.moment));
                if mass > 0.0 {
                    *place = (moment / mass).clamp(bounds[k], bounds[k + 1]);
                }
            }
        }
    }
}

/// y at x, both lists ascending.
fn interpolate(xs: &[f64], ys: &[f64], x: f64) -> f64 {
    let k = xs.partition_point(|&a| a <= x).clamp(1, xs.len() - 1);
    let width = xs[k] - xs[k - 1];
    let t = if width > 0.0 { ((x - xs[k - 1]) / width).clamp(0.0, 1.0) } else { 0.0 };
    ys[k - 1] + t * (ys[k] - ys[k - 1])
}
