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

use std::collections::BTreeSet;

use glam::DVec3;

use crate::knn::{NeighbourRow, SeedIndex};
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
    /// Curves between two corners that are much shorter than an edge.
    short: Vec<u32>,
}

/// Two neighbouring seeds of a curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    /// The seeds.
    pub ends: [u32; 2],
    /// Points of the curve between them, evenly spaced, unit frame.
    pub between: [DVec3; BETWEEN],
    /// Which curve.
    pub curve: u32,
    /// The edge length wished for there, unit frame.
    pub edge: f64,
}

/// Points between two neighbours on a curve; odd, so that one is in the middle.
pub const BETWEEN: usize = 7;

impl Segment {
    /// The point of the curve half-way between its seeds, unit frame.
    pub fn middle(&self) -> DVec3 {
        self.between[BETWEEN / 2]
    }
}

/// Steps of Lloyd's iteration on a curve whose density varies. It starts at equal shares of ∫ ds/h,
/// where the tessellation ends up as the seeds become many.
const STEPS: usize = 20;
/// Points at which the density is taken on each edge of a curve.
const PARTS: usize = 4;
/// Where a curve bends, its seeds come closer together, until a chord leaves it by at most this share of h,
const SAGITTA: f64 = 0.035;
/// but not closer than this share of h.
const LEAST_SHARE: f64 = 0.6;
/// Two curves are too close where seeds of them are nearer than this share of their spacing.
const CROWDED: f64 = 0.45;
/// or, where they are beside a common corner, than this share.
const ACUTE: f64 = 0.3;
/// Creases that leave a corner at less than this, degrees, stay only if bent by more than that, degrees.
const LEAST_CORNER: f64 = 32.0;
const MEANT: f64 = 55.0;
/// A deviation of a chord counts for so much of a difference in length.
const KINKS: f64 = 15.0;
const KINK_SWEEPS: usize = 4;
/// A curve between two corners is too short for its edge at this share of h.
const SHORT: f64 = 0.65;
/// A chord leaves its curve by at most this share of an edge,
const DEVIATION: f64 = 0.15;
/// unless one of its parts would be shorter than this share.
const SHORTEST_PART: f64 = 0.5;
/// Points of a running mean on either side.
const MEAN_OF: i32 = 4;
/// No segment is longer than so many h: a seed beside its middle would take a part of the curve.
const LONGEST: f64 = 1.2;

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
            if !curve.closed && path.total() < SHORT {
                all.short.push(number as u32);
            }
            // Fewer would give two edges the same ends.
            let least = match curve.closed {
                true => 3,
                false if ends(curve).0 == ends(curve).1 => 3,
                false if pairs.iter().filter(|&&p| p == ends(curve)).count() > 1 => 2,
                false => 1,
            };
            let total = path.total();
            let count = (total.round() as usize).max((total / LONGEST).ceil() as usize).max(least);
            let places = path.tessellate(count);
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
                between: std::array::from_fn(|k| {
                    path.at(w[0].1 + (k + 1) as f64 / (BETWEEN + 1) as f64 * (w[1].1 - w[0].1))
                }),
                curve: number as u32,
                edge: path.edge_at(0.5 * (w[0].1 + w[1].1)),
            }));
        }
        all
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.seeds.len()
    }

    /// Puts a seed at a point between the ends of a segment, after all others; the segment becomes two. Returns where
    /// it is.
    pub fn split(&mut self, segment: u32, at: usize) -> DVec3 {
        let new = self.seeds.len() as u32;
        let Segment { ends: [a, b], between, curve, edge } = self.segments[segment as usize];
        let middle = between[at];
        self.seeds.push(middle);
        // Points evenly along what is known of each part.
        let half = |from: DVec3, to: DVec3, inner: &[DVec3]| {
            let mut known = vec![from];
            known.extend_from_slice(inner);
            known.push(to);
            std::array::from_fn(|k| {
                let t = (k + 1) as f64 / (BETWEEN + 1) as f64 * (known.len() - 1) as f64;
                let before = (t as usize).min(known.len() - 2);
                known[before].lerp(known[before + 1], t - before as f64)
            })
        };
        let (start, end) = (self.seeds[a as usize], self.seeds[b as usize]);
        let first = half(start, middle, &between[..at]);
        let second = half(middle, end, &between[at + 1..]);
        self.segments[segment as usize] = Segment { ends: [a, new], between: first, curve, edge };
        self.segments.push(Segment { ends: [new, b], between: second, curve, edge });
        middle
    }

    /// Splits segments whose chord leaves the curve by more than a seventh of an edge, where it is
    /// farthest away and both parts are long enough.
    pub fn follow_bends(&mut self) {
        let mut next = 0;
        while let Some(&segment) = self.segments.get(next) {
            let [a, b] = segment.ends.map(|e| self.seeds[e as usize]);
            let way = (b - a).normalize_or_zero();
            let off = |p: DVec3| (p - a - way * way.dot(p - a)).length();
            let long = |p: DVec3| p.distance(a).min(p.distance(b)) > SHORTEST_PART * segment.edge;
            let far = (0..BETWEEN)
                .filter(|&k| long(segment.between[k]) && off(segment.between[k]) > DEVIATION * segment.edge)
                .max_by(|&j, &k| off(segment.between[j]).total_cmp(&off(segment.between[k])));
            match far {
                Some(at) => {
                    self.split(next as u32, at);
                }
                None => next += 1,
            }
        }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.seeds.is_empty()
    }

    /// Seeds that come between two neighbours on a curve: (seed, segment), each seed once. Their cells hold a part
    /// of the curve, and the dual may have the curve no more. On a straight curve such a seed is nearer to
    /// the middle of the segment than its ends are.
    pub fn intruders(&self, seeds: &[DVec3]) -> Vec<(u32, u32)> {
        let index = SeedIndex::new(seeds);
        let mut found = Vec::new();
        for (k, segment) in self.segments.iter().enumerate() {
            for p in segment.between {
                let nearest = index.nearest(p);
                let own = segment.ends.map(|e| seeds[e as usize].distance(p));
                if nearest as usize >= self.seeds.len() && seeds[nearest as usize].distance(p) < own[0].min(own[1]) {
                    found.push((nearest, k as u32));
                }
            }
        }
        found.sort_unstable();
        found.dedup_by_key(|f| f.0);
        found
    }

    /// Creases to leave out because they run so close to another curve that a triangulation has no room
    /// between them: of two that come within half of their spacing and do not meet there, the less
    /// bent one; one that was given, or a boundary, never.
    pub fn crowded(&self, features: &Features) -> BTreeSet<u32> {
        let mut on = vec![Vec::new(); self.seeds.len()];
        let mut reach = vec![0.0f64; self.seeds.len()];
        for s in &self.segments {
            let spacing = self.seeds[s.ends[0] as usize].distance(self.seeds[s.ends[1] as usize]);
            for e in s.ends {
                on[e as usize].push(s.curve);
                reach[e as usize] = reach[e as usize].max(CROWDED * spacing);
            }
        }
        let meet: BTreeSet<(u32, u32)> =
            self.segments.iter().map(|s| (s.ends[0].min(s.ends[1]), s.ends[0].max(s.ends[1]))).collect();
        // Seeds next to a common corner are close because their curves meet there.
        let mut beside = vec![Vec::new(); self.corners];
        for s in &self.segments {
            for (a, b) in [(s.ends[0], s.ends[1]), (s.ends[1], s.ends[0])] {
                if (a as usize) < self.corners {
                    beside[a as usize].push(b);
                }
            }
        }
        let index = SeedIndex::new(&self.seeds);
        let mut row = NeighbourRow::default();
        let mut out = self.acute(features);
        let may_go = |c: u32| features.curves[c as usize].angle_deg < 180.0;
        out.extend(self.short.iter().copied().filter(|&c| may_go(c)));
        for i in 0..self.seeds.len() as u32 {
            index.row(i, 16, &mut row);
            let near = |&&j: &&u32| self.seeds[j as usize].distance(self.seeds[i as usize]) < reach[i as usize];
            for &j in row.seeds.iter().take_while(near) {
                let joined =
                    meet.contains(&(i.min(j), i.max(j))) || beside.iter().any(|b| b.contains(&i) && b.contains(&j));
                let apart = self.seeds[j as usize].distance(self.seeds[i as usize]);
                if joined && apart > ACUTE / CROWDED * reach[i as usize] {
                    continue;
                }
                let candidates = on[i as usize].iter().chain(&on[j as usize]);
                let weakest = candidates
                    .map(|&c| (features.curves[c as usize].angle_deg, c))
                    .filter(|(_, c)| may_go(*c))
                    .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
                out.extend(weakest.map(|(_, c)| c));
            }
        }
        out
    }

    /// Of two creases that leave a corner at an acute angle the less bent one, where that is a fold of a scan
    /// rather than an edge of a part: the triangle between them could not be better than the angle.
    fn acute(&self, features: &Features) -> BTreeSet<u32> {
        let mut leaving = vec![Vec::new(); self.corners];
        for s in &self.segments {
            let bend = features.curves[s.curve as usize].ends_deg;
            for (a, b, bend) in [(s.ends[0], s.ends[1], bend[0]), (s.ends[1], s.ends[0], bend[1])] {
                if let Some(list) = leaving.get_mut(a as usize) {
                    let way = (self.seeds[b as usize] - self.seeds[a as usize]).normalize_or_zero();
                    list.push((way, bend, s.curve));
                }
            }
        }
        let mut out = BTreeSet::new();
        for list in leaving {
            for (k, &(way, bend, c)) in list.iter().enumerate() {
                for &(other, other_bend, d) in &list[..k] {
                    let (weaker, bend) = if bend < other_bend { (c, bend) } else { (d, other_bend) };
                    if way.dot(other) > LEAST_CORNER.to_radians().cos() && bend < MEANT {
                        out.insert(weaker);
                    }
                }
            }
        }
        out
    }

    /// Moves intruders away from their segments, to the distance that the next row of a regular
    /// triangulation has. Returns how many there were. One pass: who was pushed may intrude elsewhere.
    pub fn push_out(&self, seeds: &mut [DVec3]) -> usize {
        let intruders = self.intruders(seeds);
        for &(seed, segment) in &intruders {
            let segment = &self.segments[segment as usize];
            let (ends, middle) = (segment.ends, segment.middle());
            let along = seeds[ends[1] as usize] - seeds[ends[0] as usize];
            let away = seeds[seed as usize] - middle;
            // Across the curve, where there is such a direction.
            let across = away - along * (away.dot(along) / along.length_squared().max(f64::MIN_POSITIVE));
            let way = across.try_normalize().or_else(|| away.try_normalize()).unwrap_or(DVec3::X);
            seeds[seed as usize] = middle + 0.75 * along.length() * way;
        }
        intruders.len()
    }

    /// Where other seeds may begin: farther from every curve seed and every middle of a segment than three
    /// quarters of the spacing there.
    pub fn clearance(&self) -> Clearance {
        let mut reach = vec![0.0f64; self.seeds.len()];
        let mut places = self.seeds.clone();
        let mut middles = Vec::new();
        for s in &self.segments {
            let d = self.seeds[s.ends[0] as usize].distance(self.seeds[s.ends[1] as usize]);
            s.ends.iter().for_each(|&e| reach[e as usize] = reach[e as usize].max(0.75 * d));
            places.push(s.middle());
            middles.push(0.75 * d);
        }
        reach.extend(middles);
        Clearance { index: SeedIndex::new(&places), places, reach }
    }
}

/// See [`CurveSeeds::clearance`].
pub struct Clearance {
    index: SeedIndex,
    places: Vec<DVec3>,
    reach: Vec<f64>,
}

impl Clearance {
    /// Whether a seed may begin at `p`, unit frame.
    pub fn holds(&self, p: DVec3) -> bool {
        let k = self.index.nearest(p) as usize;
        p.distance(self.places[k]) >= self.reach[k]
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
    closed: bool,
    /// Length of the running mean.
    smooth: Vec<f64>,
    /// 1/h as wished for.
    wish: Vec<f64>,
}

impl Path {
    fn new(surface: &Surface, curve: &Curve, edge: f64) -> Self {
        let (mut points, mut along, mut per_length) = (Vec::new(), vec![0.0], Vec::new());
        let mut last: Option<(DVec3, f64)> = None;
        for v in curve.round() {
            let (p, w) = (surface.positions()[v as usize], surface.weights()[v as usize]);
            let from = last.map_or(PARTS, |_| 1);
            let (q, u) = last.unwrap_or((p, w));
            for k in from..=PARTS {
                let t = k as f64 / PARTS as f64;
                if let Some(&before) = points.last() {
                    let next = q.lerp(p, t);
                    along.push(along[along.len() - 1] + next.distance(before));
                }
                points.push(q.lerp(p, t));
                per_length.push((u + t * (w - u)).powf(0.25) / edge);
            }
            last = Some((p, w));
        }
        let mut path = Self {
            points,
            along,
            edges: Vec::new(),
            mass: Vec::new(),
            moment: Vec::new(),
            closed: curve.closed,
            smooth: vec![0.0],
            wish: Vec::new(),
        };
        path.smooth_length(&per_length);
        let fine: Vec<f64> = (0..per_length.len()).map(|k| per_length[k] / path.shortening(k, per_length[k])).collect();
        path.accumulate(&fine);
        path.wish = per_length;
        path
    }

    /// Measures the length by the curve's running mean over h: the zigzag of a scan's rim is longer than
    /// what a chain of edges can follow.
    fn smooth_length(&mut self, per_length: &[f64]) {
        let total = self.length();
        let mean: Vec<DVec3> = (0..self.points.len())
            .map(|k| {
                let mut reach = (0.5 / per_length[k]).min(total / 3.0);
                if !self.closed {
                    // The ends stay where they are.
                    reach = reach.min(self.along[k]).min(total - self.along[k]);
                }
                let part = |j: i32| self.at(self.along[k] + reach * f64::from(j) / MEAN_OF as f64);
                (-MEAN_OF..=MEAN_OF).map(part).sum::<DVec3>() / f64::from(2 * MEAN_OF + 1)
            })
            .collect();
        for k in 1..self.points.len() {
            // Points of a zigzag stay in order.
            let step = mean[k].distance(mean[k - 1]).max(1e-6 * (self.along[k] - self.along[k - 1]));
            self.smooth.push(self.smooth[k - 1] + step);
        }
    }

    /// By how much the spacing is to shrink at point `k`, where 1/h is `per_length`, so that chords stay close
    /// to the curve: ℓ² κ / 8 <= [`SAGITTA`] h.
    fn shortening(&self, k: usize, per_length: f64) -> f64 {
        let reach = (0.5 / per_length).min(self.length() / 3.0);
        let (here, s) = (self.points[k], self.along[k]);
        let ends = (s - reach, s + reach);
        if !self.closed && (ends.0 < 0.0 || ends.1 > self.length()) {
            return 1.0;
        }
        let (back, ahead) = (here - self.at(ends.0), self.at(ends.1) - here);
        let turn = back.cross(ahead).length().atan2(back.dot(ahead));
        let bend = turn / (reach * per_length);
        if bend > 8.0 * SAGITTA { (8.0 * SAGITTA / bend).sqrt().max(LEAST_SHARE) } else { 1.0 }
    }

    fn accumulate(&mut self, per_length: &[f64]) {
        [&mut self.edges, &mut self.mass, &mut self.moment].into_iter().for_each(|list| list.push(0.0));
        for k in 1..self.points.len() {
            let (s, t) = (self.smooth[k - 1], self.smooth[k]);
            let (a, b) = (per_length[k - 1], per_length[k]);
            let (ma, mb) = (a * a * a, b * b * b);
            self.edges.push(self.edges[k - 1] + 0.5 * (a + b) * (t - s));
            self.mass.push(self.mass[k - 1] + 0.5 * (ma + mb) * (t - s));
            self.moment.push(self.moment[k - 1] + 0.5 * (ma * s + mb * t) * (t - s));
        }
    }

    fn length(&self) -> f64 {
        self.along[self.along.len() - 1]
    }

    fn smooth_total(&self) -> f64 {
        self.smooth[self.smooth.len() - 1]
    }

    /// How many edges fit.
    fn total(&self) -> f64 {
        self.edges[self.edges.len() - 1]
    }

    /// The edge length wished for at an arc length.
    fn edge_at(&self, s: f64) -> f64 {
        let s = if self.closed { s.rem_euclid(self.length()) } else { s };
        let k = self.along.partition_point(|&a| a <= s).min(self.along.len() - 1);
        1.0 / self.wish[k]
    }

    /// The point at an arc length, that of a closed curve going round.
    fn at(&self, s: f64) -> DVec3 {
        let s = if self.closed { s.rem_euclid(self.length()) } else { s };
        let k = self.along.partition_point(|&a| a <= s).clamp(1, self.along.len() - 1);
        let width = self.along[k] - self.along[k - 1];
        let t = if width > 0.0 { ((s - self.along[k - 1]) / width).clamp(0.0, 1.0) } else { 0.0 };
        if t == 1.0 { self.points[k] } else { self.points[k - 1] + t * (self.points[k] - self.points[k - 1]) }
    }

    /// Arc lengths of the seeds of `count` segments, ascending, without those at the ends; a closed curve has its first
    /// one near where it begins, on either side of it.
    fn tessellate(&self, count: usize) -> Vec<f64> {
        let share = self.total() / count as f64;
        let mut places: Vec<f64> = match share > 0.0 {
            true => (1..count).map(|k| interpolate(&self.edges, &self.smooth, share * k as f64)).collect(),
            // A curve without weight anywhere is divided by length.
            false => (1..count).map(|k| self.smooth_total() * k as f64 / count as f64).collect(),
        };
        if !places.is_empty() {
            self.relax(&mut places);
        }
        places.iter_mut().for_each(|s| *s = interpolate(&self.smooth, &self.along, *s));
        if self.closed {
            // Before the others look for kinks: the first and the last one are its neighbours.
            places.insert(0, 0.0);
        }
        self.follow_kinks(&mut places);
        places
    }

    /// Moves seeds to kinks of the curve near them, where the chords then follow it better: each in turn to
    /// the vertex between its neighbours for which Σ (ℓ/ℓ₀ - 1)² + KINKS (deviation/ℓ₀)² over its two
    /// chords ℓ is least.
    fn follow_kinks(&self, places: &mut [f64]) {
        let length = self.length();
        let neighbours = |places: &[f64], k: usize| {
            let before = if k > 0 {
                places[k - 1]
            } else if self.closed {
                places[places.len() - 1] - length
            } else {
                0.0
            };
            let after = match places.get(k + 1) {
                Some(&s) => s,
                None if self.closed => places[0] + length,
                None => length,
            };
            (before, after)
        };
        for _ in 0..KINK_SWEEPS {
            for k in 0..places.len() {
                let (before, after) = neighbours(places, k);
                let goal = 0.5 * self.at(before).distance(self.at(after)).max(0.25 * (after - before));
                let cost = |s: f64| self.chord(before, s, goal) + self.chord(s, after, goal);
                let (low, high) = (before + 0.2 * (after - before), after - 0.2 * (after - before));
                let mut best = (cost(places[k]), places[k]);
                for turn in [-length, 0.0, length].into_iter().filter(|t| self.closed || *t == 0.0) {
                    let from = self.along.partition_point(|&s| s + turn <= low).div_ceil(PARTS) * PARTS;
                    let vertices = (from..self.along.len()).step_by(PARTS).map(|v| self.along[v] + turn);
                    for s in vertices.take_while(|s| *s < high) {
                        let c = cost(s);
                        if c < best.0 {
                            best = (c, s);
                        }
                    }
                }
                places[k] = best.1;
            }
        }
    }

    /// What a chord from s to t costs that should be `goal` long.
    fn chord(&self, s: f64, t: f64, goal: f64) -> f64 {
        let (a, b) = (self.at(s), self.at(t));
        let way = (b - a).normalize_or_zero();
        let off = |p: DVec3| (p - a - way * way.dot(p - a)).length();
        let inner = (1..=BETWEEN).map(|k| self.at(s + k as f64 / (BETWEEN + 1) as f64 * (t - s)));
        let deviation = inner.map(off).fold(0.0, f64::max);
        (a.distance(b) / goal - 1.0).powi(2) + KINKS * (deviation / goal).powi(2)
    }

    /// Lloyd's iteration of inner seeds between two that stay at the ends.
    fn relax(&self, places: &mut [f64]) {
        for _ in 0..STEPS {
            let mut bounds = vec![0.5 * places[0]];
            bounds.extend(places.windows(2).map(|p| 0.5 * (p[0] + p[1])));
            bounds.push(0.5 * (places[places.len() - 1] + self.smooth_total()));
            for (k, place) in places.iter_mut().enumerate() {
                let of = |list: &[f64]| {
                    interpolate(&self.smooth, list, bounds[k + 1]) - interpolate(&self.smooth, list, bounds[k])
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
