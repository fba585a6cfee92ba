//! A curve by arc length, and where vertices of a result lie on it.
//!
//! Purpose: [`Polyline`] finds the point at an arc length; [`Stretch`] is the part of a curve that an edge of the result stands for.
//! Invariant: arc lengths ascend along a curve; those of a closed one may be beyond its length and go on round.
//! Must not know: seeds, why vertices move.

use glam::DVec3;

#[derive(Clone, Debug)]
pub(crate) struct Polyline {
    points: Vec<DVec3>,
    along: Vec<f64>,
    closed: bool,
}

/// A part of a curve between two vertices of a result.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Stretch {
    pub(crate) curve: u32,
    /// Arc lengths of the two vertices.
    pub(crate) ends: [f64; 2],
}

impl Polyline {
    /// At least one point. A closed one ends where it begins.
    pub(crate) fn new(points: Vec<DVec3>, closed: bool) -> Self {
        let mut along = vec![0.0];
        points.windows(2).for_each(|w| along.push(along[along.len() - 1] + w[0].distance(w[1])));
        Self { points, along, closed }
    }

    pub(crate) fn length(&self) -> f64 {
        self.along[self.along.len() - 1]
    }

    /// The point at an arc length.
    pub(crate) fn at(&self, s: f64) -> DVec3 {
        let s = if self.closed && self.length() > 0.0 { s.rem_euclid(self.length()) } else { s };
        let k = self.along.partition_point(|&a| a <= s).clamp(1, (self.along.len() - 1).max(1));
        let (Some(&to), Some(&end)) = (self.points.get(k), self.along.get(k)) else { return self.points[0] };
        let width = end - self.along[k - 1];
        let t = if width > 0.0 { ((s - self.along[k - 1]) / width).clamp(0.0, 1.0) } else { 0.0 };
        if t == 1.0 { to } else { self.points[k - 1].lerp(to, t) }
    }

    /// The edge at an arc length, and where on it, 0 to 1; `None` if there is no edge.
    pub(crate) fn edge_at(&self, s: f64) -> Option<(usize, f64)> {
        let k = self.along.partition_point(|&a| a <= s).clamp(1, (self.along.len() - 1).max(1)) - 1;
        let width = self.along.get(k + 1)? - self.along[k];
        Some((k, if width > 0.0 { ((s - self.along[k]) / width).clamp(0.0, 1.0) } else { 0.0 }))
    }

    /// The arc length of the point nearest to `p`; the lowest of equals.
    pub(crate) fn nearest(&self, p: DVec3) -> f64 {
        let mut best = (f64::INFINITY, 0.0);
        for (k, w) in self.points.windows(2).enumerate() {
            let (way, own) = (w[1] - w[0], self.along[k + 1] - self.along[k]);
            let t = if own > 0.0 { ((p - w[0]).dot(way) / way.length_squared()).clamp(0.0, 1.0) } else { 0.0 };
            let squared = p.distance_squared(w[0] + t * way);
            if squared < best.0 {
                best = (squared, self.along[k] + t * own);
            }
        }
        best.1
    }

    /// The stretch from one arc length on to another one.
    pub(crate) fn stretch(&self, curve: u32, [from, to]: [f64; 2]) -> Stretch {
        let round = if self.closed && to <= from { self.length() } else { 0.0 };
        Stretch { curve, ends: [from, to + round] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arc_lengths_and_points_belong_together() {
        let square = [DVec3::ZERO, DVec3::X, DVec3::X + DVec3::Y, DVec3::Y, DVec3::ZERO];
        for closed in [false, true] {
            let line = Polyline::new(square.to_vec(), closed);
            assert_eq!(line.length(), 4.0);
            for k in 0..39 {
                let s = 0.05 + 0.1 * f64::from(k);
                assert!((line.nearest(line.at(s)) - s).abs() < 1e-12);
            }
            assert_eq!(line.at(4.5), if closed { 0.5 * DVec3::X } else { DVec3::ZERO });
        }
        assert_eq!(Polyline::new(square.to_vec(), true).stretch(3, [3.5, 0.5]).ends, [3.5, 4.5]);
        assert_eq!(Polyline::new(vec![DVec3::X], false).at(1.0), DVec3::X);
    }
}
