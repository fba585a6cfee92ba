//! Measures of one triangle.
//!
//! Purpose: the normal, the score and the size by which all rooms of the remesh judge a facet, and the shapes that they want
//! ([`Shapes`]).
//! Invariant: a triangle without area has the normal zero and no score above zero; no measure is NaN.
//! Must not know: which triangle it is.

use glam::DVec3;

use super::constants::*;
use crate::mesh::measure::{angles, facet_quality, least_angle};

/// Unit normal; zero for a triangle without area.
pub(super) fn unit_normal([a, b, c]: [DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a).normalize_or_zero()
}

pub(super) fn longest_side([a, b, c]: [DVec3; 3]) -> f64 {
    a.distance(b).max(b.distance(c)).max(c.distance(a))
}

/// The smallest angle in degrees, or [`DEGREES_PER_QUALITY`] times Q if that is less. Higher is better.
pub(super) fn score(corners: [DVec3; 3]) -> f64 {
    least_angle(corners).min(DEGREES_PER_QUALITY * facet_quality(corners))
}

/// The shape that triangles are to have.
#[derive(Clone, Copy)]
pub(super) struct Wanted {
    score: f64,
    /// The largest angle, degrees.
    largest: f64,
    /// Cotangents of the smallest and the largest angle.
    cotangents: [f64; 2],
}

impl Wanted {
    /// At least this score, and no angle larger than this, degrees.
    pub(super) fn new(score: f64, largest: f64) -> Self {
        let cotangent = |degrees: f64| degrees.to_radians().tan().recip();
        let rounding = 1.0 - BOUND_ROUNDING;
        Self { score, largest, cotangents: [cotangent(score) - rounding, cotangent(largest) + rounding] }
    }

    /// Whether a triangle lacks anything of it.
    pub(super) fn is_lacking(&self, corners: [DVec3; 3]) -> bool {
        self.lack(corners, facet_quality(corners)) > 0.0
    }

    /// What a triangle with this Q lacks of it, degrees; 0 if nothing. Most lack nothing: that needs no arc tangent.
    pub(super) fn lack(&self, corners: [DVec3; 3], quality: f64) -> f64 {
        let [a, b, c] = corners;
        let (u, v, w) = (b - a, c - b, a - c);
        let [most, least] = self.cotangents.map(|cotangent| cotangent * u.cross(w).length());
        let within = |dot: f64| -dot < most && -dot > least;
        if DEGREES_PER_QUALITY * quality >= self.score && within(u.dot(v)) && within(v.dot(w)) && within(w.dot(u)) {
            return 0.0;
        }
        let [smallest, largest] = angles(corners);
        (self.score - smallest.min(DEGREES_PER_QUALITY * quality)).max(largest - self.largest).max(0.0)
    }
}

/// Facets as they are wanted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Shapes {
    /// As wide as long.
    Round,
    /// As long as the cells are: edges are those of the dual.
    Slender,
    /// As they are nearest to the surface.
    Nearest(Norm),
}

/// Which distances a fit brings down.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Norm {
    MeanSquare,
    Largest,
}

impl Norm {
    /// Of the squared distances, where their sum stands for the norm.
    pub(super) fn power(self) -> i32 {
        match self {
            Self::MeanSquare => 1,
            Self::Largest => 4,
        }
    }
}

impl Shapes {
    /// Least score of a facet where distances are measured, or its own.
    pub(super) fn least_score(self) -> f64 {
        match self {
            Self::Round => LEAST_SCORE,
            Self::Slender | Self::Nearest(_) => SLENDER_SCORE,
        }
    }

    pub(super) fn wanted(self) -> Wanted {
        match self {
            Self::Round => Wanted::new(POOR_SCORE, POOR_ANGLE),
            Self::Slender | Self::Nearest(_) => Wanted::new(SLENDER_SCORE, SLENDER_ANGLE),
        }
    }
}

pub(super) fn perimeter([a, b, c]: [DVec3; 3]) -> f64 {
    a.distance(b) + b.distance(c) + c.distance(a)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_equilateral_triangle_has_the_highest_score() {
        let equilateral = [DVec3::ZERO, DVec3::X, DVec3::new(0.5, 0.75f64.sqrt(), 0.0)];
        assert!((score(equilateral) - DEGREES_PER_QUALITY).abs() < 1e-9);
        assert!(unit_normal(equilateral).distance(DVec3::Z) < 1e-12);
        assert!((perimeter(equilateral) - 3.0).abs() < 1e-12);
    }

    #[test]
    fn a_triangle_without_area_has_no_score() {
        for collapsed in [[DVec3::ONE; 3], [DVec3::ZERO, DVec3::X, 2.0 * DVec3::X]] {
            assert!(score(collapsed) <= 0.0);
            assert_eq!(unit_normal(collapsed), DVec3::ZERO);
        }
    }

    #[test]
    fn what_a_triangle_lacks_is_what_its_score_says() {
        let wanted = Wanted::new(37.0, 93.0);
        for (x, y) in (0..400).map(|k| (f64::from(k % 20) * 0.05, f64::from(k / 20) * 0.05 + 0.3)) {
            let corners = [DVec3::ZERO, DVec3::X, DVec3::new(x, y, 0.0)];
            let lack = (37.0 - score(corners)).max(angles(corners)[1] - 93.0).max(0.0);
            assert!((wanted.lack(corners, facet_quality(corners)) - lack).abs() < 1e-6, "{corners:?}");
        }
    }
}
