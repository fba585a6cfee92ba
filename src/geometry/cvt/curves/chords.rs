//! Where to cut a curve into chords that stay close to it.
//!
//! Purpose: the boundary of a scan zigzags at the scale of its facets; even chords leave it by a fifth of their length. Of
//! all choices of its points, [`cut`] finds that whose chords are about as long as the target and leave it least: dynamic
//! programming, as for the polygons of Perez and Vidal (1994), with a cost of length beside that of deviation.
//! Invariant: deterministic; chords are no shorter and no longer than stated shares of the target length.
//! Must not know: surfaces, seeds.

use glam::DVec3;

use crate::tasks;
use crate::token::{Stopped, Token};

/// Deviation of a chord from its curve that costs [`DEVIATION_COST`], share of the target length.
pub(super) const TOLERANCE: f64 = 0.095;
/// Cost of a chord that deviates by [`TOLERANCE`]. Its length costs the squared logarithm of its share of the target.
const DEVIATION_COST: f64 = 0.3;
/// Shortest and longest chord, target lengths.
const MIN_CHORD: f64 = 0.5;
const MAX_CHORD: f64 = 1.5;
/// Longest curve between the ends of a chord, as a multiple of the chord. A curve that zigzags more is cut there.
const MAX_DETOUR: f64 = 2.5;

/// A curve by points in order; a closed one repeats its first point at the end.
pub(super) struct Line<'a> {
    pub(super) points: &'a [DVec3],
    /// Target length at each point.
    pub(super) target: &'a [f64],
    pub(super) closed: bool,
}

impl Line<'_> {
    /// How far the curve from one point to another leaves the chord between them.
    fn deviation(&self, i: usize, j: usize) -> f64 {
        let n = self.points.len() - 1;
        let at = |k: usize| if k > n { self.points[k - n] } else { self.points[k] };
        let (a, b) = (at(i), at(j));
        let chord = b - a;
        let squared = chord.length_squared();
        let off = |p: DVec3| {
            let t = if squared > 0.0 { ((p - a).dot(chord) / squared).clamp(0.0, 1.0) } else { 0.0 };
            p.distance_squared(a + t * chord)
        };
        (i + 1..j).map(|k| off(at(k))).fold(0.0, f64::max).sqrt()
    }

    /// The cost of the chord from point `i` to point `j`, if it may be.
    fn cost(&self, i: usize, j: usize) -> Option<f64> {
        let n = self.points.len() - 1;
        let wrap = |k: usize| if k > n { k - n } else { k };
        let target = 0.5 * (self.target[wrap(i)] + self.target[wrap(j)]);
        let share = self.points[wrap(i)].distance(self.points[wrap(j)]) / target;
        if !(MIN_CHORD..=MAX_CHORD).contains(&share) {
            return None;
        }
        let off = self.deviation(i, j) / (TOLERANCE * target);
        Some(share.ln().powi(2) + DEVIATION_COST * off.powi(6))
    }

    /// Chords that end in each point: (first point, cost). Points of a second round follow those of a closed curve.
    fn chords(&self, token: &Token) -> Result<Vec<Vec<(usize, f64)>>, Stopped> {
        let n = self.points.len() - 1;
        let end = if self.closed { 2 * n } else { n };
        let mut along = vec![0.0];
        for k in 1..=end {
            let (p, q) = (self.points[(k - 1) % n], self.points[(k - 1) % n + 1]);
            along.push(along[k - 1] + p.distance(q));
        }
        let first = if self.closed { n } else { 1 };
        let of = |j: usize| {
            let reach = MAX_DETOUR * MAX_CHORD * self.target[if j > n { j - n } else { j }];
            let near = (j.saturating_sub(n)..j).rev().take_while(|&i| along[j] - along[i] <= reach);
            let cost = |(n, i)| match token.check_at(256 * n) {
                Ok(()) => self.cost(i, j).map(|cost| Ok((i, cost))),
                Err(stopped) => Some(Err(stopped)),
            };
            near.enumerate().filter_map(cost).collect()
        };
        tasks::try_map(end + 1, || (), |(), j| if j < first { Ok(Vec::new()) } else { of(j) })
    }
}

/// Where to cut, ascending, without the ends of an open line; `None` if it cannot be cut so, or not into `least` parts.
pub(super) fn cut(line: &Line<'_>, least: usize, token: &Token) -> Result<Option<Vec<usize>>, Stopped> {
    let Some(n) = line.points.len().checked_sub(1).filter(|&n| n > 1) else { return Ok(None) };
    let chords = line.chords(token)?;
    let best = if line.closed {
        let mut best: Option<(f64, Vec<usize>)> = None;
        // Some cut is within the longest chord from the beginning.
        let mut passed = 0.0;
        for start in 0..n {
            token.check()?;
            if start > 0 {
                passed += line.points[start].distance(line.points[start - 1]);
            }
            if passed > MAX_CHORD * line.target[0] {
                break;
            }
            // Chords of one round are those of the next, n points on.
            let chord = |j: usize| {
                let (from, back) = if j < n { (j + n, n) } else { (j, 0) };
                chords[from].iter().filter(move |c| c.0 >= back + start).map(move |c| (c.0 - back, c.1))
            };
            if let Some(found) = shortest(start, start + n, chord)
                && best.as_ref().is_none_or(|b| found.0 < b.0)
            {
                best = Some(found);
            }
        }
        best.map(|(_, mut path)| {
            path.pop();
            path.iter_mut().for_each(|k| *k %= n);
            path.sort_unstable();
            path
        })
    } else {
        shortest(0, n, |j| chords[j].iter().copied()).map(|(_, path)| path[1..path.len() - 1].to_vec())
    };
    let parts = |best: &Vec<usize>| if line.closed { best.len() } else { best.len() + 1 };
    Ok(best.filter(|best| parts(best) >= least))
}

/// The path from `start` to `end` that costs least, through ascending points.
fn shortest<I: Iterator<Item = (usize, f64)>>(
    start: usize,
    end: usize,
    chords: impl Fn(usize) -> I,
) -> Option<(f64, Vec<usize>)> {
    let mut known = vec![(f64::INFINITY, start); end - start + 1];
    known[0].0 = 0.0;
    for j in start + 1..=end {
        for (i, cost) in chords(j) {
            if i >= start && !(i == start && j == end) {
                let total = known[i - start].0 + cost;
                if total < known[j - start].0 {
                    known[j - start] = (total, i);
                }
            }
        }
    }
    let total = known[end - start].0;
    if total == f64::INFINITY {
        return None;
    }
    let mut path = vec![end];
    let mut here = end;
    while here > start {
        here = known[here - start].1;
        path.push(here);
    }
    path.reverse();
    Some((total, path))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A zigzag of teeth of this height, half as wide as long, along a line or around a circle of this length.
    fn zigzag(length: f64, height: f64, closed: bool) -> Vec<DVec3> {
        let n = (4.0 * length) as usize * 2;
        let point = |k: usize| {
            let (s, off) = (k as f64 / n as f64, if k % 4 == 2 { height } else { 0.0 });
            let radius = length / std::f64::consts::TAU;
            let (sin, cos) = (s * std::f64::consts::TAU).sin_cos();
            if closed { (radius + off) * DVec3::new(cos, sin, 0.0) } else { DVec3::new(s * length, off, 0.0) }
        };
        (0..=n).map(|k| if closed { point(k % n) } else { point(k) }).collect()
    }

    #[test]
    fn chords_of_a_zigzag_stay_close_to_it() {
        for closed in [false, true] {
            let points = zigzag(12.0, 0.2, closed);
            let target = vec![1.0; points.len()];
            let line = Line { points: &points, target: &target, closed };
            let cuts = cut(&line, 1, &Token::default()).unwrap().unwrap();
            let mut ends = cuts.clone();
            if closed {
                ends.push(cuts[0] + points.len() - 1);
            } else {
                ends.insert(0, 0);
                ends.push(points.len() - 1);
            }
            let n = points.len() - 1;
            for w in ends.windows(2) {
                let share = points[w[0] % n].distance(points[if w[1] == n { n } else { w[1] % n }]);
                assert!((MIN_CHORD..=MAX_CHORD).contains(&share), "{closed}: a chord of {share}");
                // Teeth are 0.2 high, by which chords from foot to foot leave them; their sides are too short for chords.
                assert!(line.deviation(w[0], w[1]) < 0.17, "{closed}: {w:?}");
            }
        }
    }

    #[test]
    fn what_is_smooth_is_cut_evenly_and_what_is_short_not_at_all() {
        let points = zigzag(10.0, 0.0, false);
        let target = vec![1.0; points.len()];
        let cuts =
            cut(&Line { points: &points, target: &target, closed: false }, 1, &Token::default()).unwrap().unwrap();
        assert_eq!(cuts, (1..10).map(|k| 8 * k).collect::<Vec<_>>());
        let long = vec![30.0; points.len()];
        assert_eq!(cut(&Line { points: &points, target: &long, closed: false }, 1, &Token::default()).unwrap(), None);
        assert_eq!(
            cut(&Line { points: &points[..1], target: &target, closed: true }, 3, &Token::default()).unwrap(),
            None
        );
    }
}
