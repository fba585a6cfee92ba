//! A curve by arc length, and where its seeds go.
//!
//! Purpose: [`Path`] knows how many edges fit on a curve and puts as many seeds on it: a centroidal tessellation of one
//! dimension, its seeds at kinks near them; where its chords would leave the curve all the same, at the cuts of [`chords`].
//! Invariant: seeds ascend along the curve. Must not know: other curves, the surface's seeds.

use glam::DVec3;

use super::{INNER_POINTS, chords};
use crate::mesh::features::Curve;
use crate::rvd::Surface;
use crate::token::{Stopped, Token};

/// Steps of Lloyd's iteration where the density varies. It starts at equal shares of ∫ ds/h, the limit for many seeds.
const LLOYD_STEPS: usize = 20;
/// Points at which the density is sampled on each edge of a curve.
const SAMPLES_PER_EDGE: usize = 4;
/// Seeds come closer together at a bend until a chord leaves the curve by at most this share of h.
const SAGITTA: f64 = 0.035;
/// Least distance of seeds at a bend, share of h.
const MIN_SPACING: f64 = 0.6;
/// Weight of a chord's deviation beside a difference in length.
const DEVIATION_WEIGHT: f64 = 15.0;
const KINK_PASSES: usize = 4;
/// Points of a running mean on either side.
const MEAN_POINTS: i32 = 4;
/// Points per target length at which a curve may be cut, beside its vertices.
const POINTS_PER_EDGE: f64 = 12.0;

/// A curve by arc length, with ∫ ds/h, ∫ ds/h³ and ∫ s ds/h³ up to each of its points.
#[derive(Default)]
pub(super) struct Path {
    points: Vec<DVec3>,
    /// Arc length.
    along: Vec<f64>,
    /// ∫ ds/h: how many edges fit.
    edges: Vec<f64>,
    /// 1/h³, linear between points, and its integrals.
    density: Vec<f64>,
    mass: Vec<f64>,
    moment: Vec<f64>,
    closed: bool,
    /// Length of the running mean.
    smooth: Vec<f64>,
    /// The target 1/h.
    target: Vec<f64>,
}

impl Path {
    /// Where `stretch` has a number for each vertex, a curve is so much longer there for its seeds.
    pub(super) fn new(surface: &Surface, curve: &Curve, stretch: &[f64], edge: f64) -> Self {
        let (mut points, mut along, mut per_length) = (Vec::new(), vec![0.0], Vec::new());
        let mut last: Option<(DVec3, f64)> = None;
        for v in curve.round() {
            let p = surface.positions()[v as usize];
            let w = surface.weights()[v as usize] * stretch.get(v as usize).map_or(1.0, |s| s.powi(4));
            let from = last.map_or(SAMPLES_PER_EDGE, |_| 1);
            let (q, u) = last.unwrap_or((p, w));
            for k in from..=SAMPLES_PER_EDGE {
                let t = k as f64 / SAMPLES_PER_EDGE as f64;
                let next = q.lerp(p, t);
                along.extend(points.last().map(|&before| along[along.len() - 1] + next.distance(before)));
                points.push(next);
                per_length.push((u + t * (w - u)).powf(0.25) / edge);
            }
            last = Some((p, w));
        }
        let mut path = Self { points, along, closed: curve.closed, smooth: vec![0.0], ..Self::default() };
        path.smooth_length(&per_length);
        let fine: Vec<f64> = (0..per_length.len()).map(|k| per_length[k] / path.shortening(k, per_length[k])).collect();
        path.accumulate(&fine);
        path.target = per_length;
        path
    }

    /// Measures the length by the curve's running mean over h: no chain of edges follows the zigzag of a scan's rim.
    fn smooth_length(&mut self, per_length: &[f64]) {
        let total = self.length();
        let mean: Vec<DVec3> = (0..self.points.len())
            .map(|k| {
                let mut reach = (0.5 / per_length[k]).min(total / 3.0);
                if !self.closed {
                    // The ends stay where they are.
                    reach = reach.min(self.along[k]).min(total - self.along[k]);
                }
                let part = |j: i32| self.at(self.along[k] + reach * f64::from(j) / MEAN_POINTS as f64);
                (-MEAN_POINTS..=MEAN_POINTS).map(part).sum::<DVec3>() / f64::from(2 * MEAN_POINTS + 1)
            })
            .collect();
        for k in 1..self.points.len() {
            // Points of a zigzag stay in order.
            let step = mean[k].distance(mean[k - 1]).max(1e-6 * (self.along[k] - self.along[k - 1]));
            self.smooth.push(self.smooth[k - 1] + step);
        }
    }

    /// By how much the spacing shrinks at point `k`, with 1/h `per_length`, for close chords: ℓ² κ / 8 <= [`SAGITTA`] h.
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
        if bend > 8.0 * SAGITTA { (8.0 * SAGITTA / bend).sqrt().max(MIN_SPACING) } else { 1.0 }
    }

    fn accumulate(&mut self, per_length: &[f64]) {
        self.density = per_length.iter().map(|a| a * a * a).collect();
        [&mut self.edges, &mut self.mass, &mut self.moment].into_iter().for_each(|list| list.push(0.0));
        for k in 1..self.points.len() {
            let (s, t) = (self.smooth[k - 1], self.smooth[k]);
            self.edges.push(self.edges[k - 1] + 0.5 * (per_length[k - 1] + per_length[k]) * (t - s));
            let [mass, moment] = integrals((s, self.density[k - 1]), (t, self.density[k]));
            self.mass.push(self.mass[k - 1] + mass);
            self.moment.push(self.moment[k - 1] + moment);
        }
    }

    /// ∫ ds/h³ and ∫ s ds/h³ up to a smoothed length, between points too: edges of a mesh may have many seeds.
    fn up_to(&self, s: f64) -> [f64; 2] {
        let k = self.smooth.partition_point(|&a| a <= s).clamp(1, self.smooth.len() - 1);
        let (from, to) = (self.smooth[k - 1], self.smooth[k]);
        let s = s.clamp(from, to);
        let t = if to > from { (s - from) / (to - from) } else { 0.0 };
        let density = self.density[k - 1] + t * (self.density[k] - self.density[k - 1]);
        let [mass, moment] = integrals((from, self.density[k - 1]), (s, density));
        [self.mass[k - 1] + mass, self.moment[k - 1] + moment]
    }

    pub(super) fn length(&self) -> f64 {
        self.along[self.along.len() - 1]
    }

    fn smooth_total(&self) -> f64 {
        self.smooth[self.smooth.len() - 1]
    }

    pub(super) fn is_closed(&self) -> bool {
        self.closed
    }

    /// How far two arc lengths are apart, the shorter way round a closed curve.
    pub(super) fn apart(&self, s: f64, t: f64) -> f64 {
        let apart = (s - t).abs();
        if self.closed { apart.min((self.length() - apart).abs()) } else { apart }
    }

    pub(super) fn total(&self) -> f64 {
        self.edges[self.edges.len() - 1]
    }

    /// The target edge length at an arc length.
    pub(super) fn edge_at(&self, s: f64) -> f64 {
        let s = if self.closed { s.rem_euclid(self.length()) } else { s };
        let k = self.along.partition_point(|&a| a <= s).min(self.along.len() - 1);
        1.0 / self.target[k]
    }

    /// The point at an arc length, that of a closed curve going round.
    pub(super) fn at(&self, s: f64) -> DVec3 {
        let s = if self.closed { s.rem_euclid(self.length()) } else { s };
        let k = self.along.partition_point(|&a| a <= s).clamp(1, self.along.len() - 1);
        let width = self.along[k] - self.along[k - 1];
        let t = if width > 0.0 { ((s - self.along[k - 1]) / width).clamp(0.0, 1.0) } else { 0.0 };
        if t == 1.0 { self.points[k] } else { self.points[k - 1] + t * (self.points[k] - self.points[k - 1]) }
    }

    /// Points between two arc lengths, evenly spaced, but at a vertex of the curve if one is near: no tip is missed.
    pub(super) fn between(&self, s: f64, t: f64) -> [DVec3; INNER_POINTS] {
        let step = (t - s) / (INNER_POINTS + 1) as f64;
        std::array::from_fn(|k| {
            let even = s + (k + 1) as f64 * step;
            let round = if self.closed { even.div_euclid(self.length()) * self.length() } else { 0.0 };
            let after = self.along.partition_point(|&a| a <= even - round).min(self.along.len() - 1);
            let vertices =
                [after / SAMPLES_PER_EDGE * SAMPLES_PER_EDGE, after.div_ceil(SAMPLES_PER_EDGE) * SAMPLES_PER_EDGE];
            let apart = |v: usize| (self.along[v] + round - even).abs();
            let near = if apart(vertices[0]) < apart(vertices[1]) { vertices[0] } else { vertices[1] };
            if apart(near) < 0.5 * step { self.points[near] } else { self.at(even) }
        })
    }

    /// Arc lengths of the seeds of `count` segments, ascending, without those at the ends; a closed curve has its first
    /// one near where it begins, on either side of it.
    pub(super) fn tessellate(&self, count: usize, least: usize, token: &Token) -> Result<Vec<f64>, Stopped> {
        let share = self.total() / count as f64;
        let mut places: Vec<f64> = match share > 0.0 {
            true => (1..count).map(|k| interpolate(&self.edges, &self.smooth, share * k as f64)).collect(),
            // A curve without weight anywhere is divided by length.
            false => (1..count).map(|k| self.smooth_total() * k as f64 / count as f64).collect(),
        };
        if !places.is_empty() {
            self.relax(&mut places, token)?;
        }
        places.iter_mut().for_each(|s| *s = interpolate(&self.smooth, &self.along, *s));
        if self.closed {
            // Before the others look for kinks: the first and the last one are its neighbours.
            places.insert(0, 0.0);
        }
        self.snap_to_kinks(&mut places, token)?;
        if self.leaves(&places) { Ok(self.cut(least, token)?.unwrap_or(places)) } else { Ok(places) }
    }

    /// Whether a chord between neighbours leaves the curve by more than it should.
    fn leaves(&self, places: &[f64]) -> bool {
        let mut ends = places.to_vec();
        if self.closed {
            ends.extend(places.first().map(|s| s + self.length()));
        } else {
            ends.insert(0, 0.0);
            ends.push(self.length());
        }
        let off = |w: &[f64]| self.deviation(w[0], w[1]) > chords::TOLERANCE * self.edge_at(0.5 * (w[0] + w[1]));
        ends.windows(2).any(off)
    }

    /// Arc lengths at which the curve is cut into chords that stay close to it ([`chords`]).
    fn cut(&self, least: usize, token: &Token) -> Result<Option<Vec<f64>>, Stopped> {
        // Where vertices are close to each other there need be no points between them, and not all of them.
        let edges = self.edges[self.edges.len() - 1];
        let (vertices, most) = ((self.points.len() - 1) / SAMPLES_PER_EDGE, (POINTS_PER_EDGE * edges).ceil() as usize);
        let even = |n: usize| (0..=n).map(|k| self.length() * k as f64 / n as f64).collect();
        let mut at: Vec<f64> = match vertices {
            n if n > most => even(most),
            n if SAMPLES_PER_EDGE * n > 2 * most => self.along.iter().step_by(SAMPLES_PER_EDGE).copied().collect(),
            _ => self.along.clone(),
        };
        if 2 * at.len() < most {
            at = at.windows(2).flat_map(|w| (0..4).map(|k| w[0] + f64::from(k) / 4.0 * (w[1] - w[0]))).collect();
            at.push(self.length());
        }
        let points: Vec<DVec3> = at.iter().map(|&s| self.at(s)).collect();
        let target: Vec<f64> = at.iter().map(|&s| self.edge_at(s)).collect();
        let line = chords::Line { points: &points, target: &target, closed: self.closed };
        let cuts = chords::cut(&line, least, token)?;
        Ok(cuts.map(|cuts| cuts.into_iter().map(|k| at[k]).collect()))
    }

    /// Moves seeds to kinks of the curve near them, where the chords then follow it better: each in turn to the vertex
    /// between its neighbours for which Σ (ℓ/ℓ₀ - 1)² + DEVIATION_WEIGHT (deviation/ℓ₀)² over its two chords ℓ is least.
    fn snap_to_kinks(&self, places: &mut [f64], token: &Token) -> Result<(), Stopped> {
        let length = self.length();
        let neighbours = |places: &[f64], k: usize| {
            let before = match k.checked_sub(1) {
                Some(k) => places[k],
                None if self.closed => places[places.len() - 1] - length,
                None => 0.0,
            };
            let after = match places.get(k + 1) {
                Some(&s) => s,
                None if self.closed => places[0] + length,
                None => length,
            };
            (before, after)
        };
        for _ in 0..KINK_PASSES {
            let mut is_changed = false;
            for k in 0..places.len() {
                token.check_at(64 * k)?;
                let (before, after) = neighbours(places, k);
                let ends = [self.at(before), self.at(after)];
                let goal = 0.5 * ends[0].distance(ends[1]).max(0.25 * (after - before));
                // `None` if it is not less than `most`: the lengths alone decide that for most vertices.
                let cost = |s: f64, most: f64| {
                    let lengths = ends.map(|end| (self.at(s).distance(end) / goal - 1.0).powi(2));
                    if lengths[0] + lengths[1] >= most {
                        return None;
                    }
                    let off = |s, t| DEVIATION_WEIGHT * (self.deviation(s, t) / goal).powi(2);
                    let cost = (lengths[0] + off(before, s)) + (lengths[1] + off(s, after));
                    (cost < most).then_some(cost)
                };
                let (low, high) = (before + 0.2 * (after - before), after - 0.2 * (after - before));
                let (mut least, mut best) = (cost(places[k], f64::INFINITY).unwrap_or(f64::INFINITY), places[k]);
                for turn in [-length, 0.0, length].into_iter().filter(|t| self.closed || *t == 0.0) {
                    let from =
                        self.along.partition_point(|&s| s + turn <= low).div_ceil(SAMPLES_PER_EDGE) * SAMPLES_PER_EDGE;
                    let vertices = (from..self.along.len()).step_by(SAMPLES_PER_EDGE).map(|v| self.along[v] + turn);
                    for s in vertices.take_while(|s| *s < high) {
                        (least, best) = cost(s, least).map_or((least, best), |cost| (cost, s));
                    }
                }
                is_changed |= places[k] != best;
                places[k] = best;
            }
            if !is_changed {
                break;
            }
        }
        Ok(())
    }

    /// How far the curve from s to t leaves the line through both.
    pub(super) fn deviation(&self, s: f64, t: f64) -> f64 {
        let (a, b) = (self.at(s), self.at(t));
        let way = (b - a).normalize_or_zero();
        let off = |p: DVec3| (p - a - way * way.dot(p - a)).length();
        let inner = (1..=INNER_POINTS).map(|k| self.at(s + k as f64 / (INNER_POINTS + 1) as f64 * (t - s)));
        inner.map(off).fold(0.0, f64::max)
    }

    /// Lloyd's iteration of inner seeds between two that stay at the ends.
    fn relax(&self, places: &mut [f64], token: &Token) -> Result<(), Stopped> {
        for _ in 0..LLOYD_STEPS {
            token.check()?;
            let mut bounds = vec![0.5 * places[0]];
            bounds.extend(places.windows(2).map(|p| 0.5 * (p[0] + p[1])));
            bounds.push(0.5 * (places[places.len() - 1] + self.smooth_total()));
            for (k, place) in places.iter_mut().enumerate() {
                let [before, after] = [self.up_to(bounds[k]), self.up_to(bounds[k + 1])];
                let (mass, moment) = (after[0] - before[0], after[1] - before[1]);
                if mass > 0.0 {
                    *place = (moment / mass).clamp(bounds[k], bounds[k + 1]);
                }
            }
        }
        Ok(())
    }
}

/// The integrals of a density that is linear between two (length, density), and of the length times it.
fn integrals((s, a): (f64, f64), (t, b): (f64, f64)) -> [f64; 2] {
    let width = t - s;
    [0.5 * (a + b) * width, width / 6.0 * (a * (2.0 * s + t) + b * (s + 2.0 * t))]
}

/// Linear interpolation of `ys` at `x`; `xs` and `ys` ascend.
fn interpolate(xs: &[f64], ys: &[f64], x: f64) -> f64 {
    let k = xs.partition_point(|&a| a <= x).clamp(1, xs.len() - 1);
    let width = xs[k] - xs[k - 1];
    let t = if width > 0.0 { ((x - xs[k - 1]) / width).clamp(0.0, 1.0) } else { 0.0 };
    ys[k - 1] + t * (ys[k] - ys[k - 1])
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::mesh::TriMesh;
    use crate::mesh::features::{FeatureOptions, Features};
    use crate::mesh::shapes::Shape;

    /// The sides of a square of two facets.
    fn sides(weights: Option<&[f64]>) -> (Surface, Vec<Curve>) {
        let mesh: TriMesh = Shape::Square.build(2);
        let surface = Surface::new(&mesh, weights).unwrap();
        let options = FeatureOptions { turn_reach: 0.1, ..FeatureOptions::default() };
        let curves = Features::find(&mesh, surface.positions(), &options, &Token::default()).unwrap().curves;
        assert_eq!(curves.len(), 4);
        (surface, curves)
    }

    #[test]
    fn seeds_are_even_on_edges_that_have_many() {
        let (surface, curves) = sides(None);
        for curve in &curves {
            for count in [2, 3, 7, 15, 200] {
                let side = Path::new(&surface, curve, &[], 1.0);
                let path = Path::new(&surface, curve, &[], side.length() / count as f64);
                let mut places = path.tessellate(count, 1, &Token::default()).unwrap();
                places.insert(0, 0.0);
                places.push(path.length());
                assert_eq!(places.len(), count + 1);
                for w in places.windows(2) {
                    let share = (w[1] - w[0]) / path.length() * count as f64;
                    assert!((share - 1.0).abs() < 1e-9, "{count}: {share}");
                }
            }
        }
    }

    #[test]
    fn seeds_are_as_close_as_the_weights_ask_within_one_edge_too() {
        // Edges half as long at one end as at the other.
        let (surface, curves) = sides(Some(&[1.0, 1.0, 16.0, 16.0]));
        for curve in &curves {
            let ends = [curve.vertices[0], curve.vertices[1]].map(|v| surface.weights()[v as usize]);
            let one = Path::new(&surface, curve, &[], 1.0).total();
            let path = Path::new(&surface, curve, &[], one / 60.0);
            let mut places = path.tessellate(60, 1, &Token::default()).unwrap();
            places.insert(0, 0.0);
            places.push(path.length());
            let lengths: Vec<f64> = places.windows(2).map(|w| w[1] - w[0]).collect();
            let ratio = (lengths[0] / lengths[59]) / (ends[1] / ends[0]).powf(0.25);
            // Seeds begin at even distances within each quarter of an edge. At the coarse end the mean of 1/h over the first
            // one is 0.62 where it is 0.5 at the end, 24 % more; the iteration reduces that (13 to 16 % are left).
            assert!((ratio - 1.0).abs() < 0.2, "{ratio}: {lengths:?}");
            let jump = lengths.windows(2).map(|w| (w[1] / w[0] - 1.0).abs()).fold(0.0, f64::max);
            assert!(jump < 0.1, "{jump}: {lengths:?}");
        }
    }
}
