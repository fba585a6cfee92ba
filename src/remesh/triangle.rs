//! Measures of one triangle.
//!
//! Purpose: the normal, the quality score and the size by which all rooms of the remesh judge a facet.
//! Invariant: a triangle without area has the normal zero and the score zero; no measure is NaN.
//! Must not know: which triangle it is.

use glam::DVec3;

use crate::mesh::measure::{facet_quality, least_angle};

/// Degrees that Q = 1 counts for in [`score`]. The smallest angle decides for slender triangles; obtuse ones, whose longest
/// edge is too long, score less than their smallest angle.
pub(super) const DEGREES_PER_QUALITY: f64 = 55.0;

/// Unit normal; zero for a triangle without area.
pub(super) fn unit_normal([a, b, c]: [DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a).normalize_or_zero()
}

/// The smallest angle in degrees, or [`DEGREES_PER_QUALITY`] times Q if that is less. Higher is better.
pub(super) fn score(corners: [DVec3; 3]) -> f64 {
    least_angle(corners).min(DEGREES_PER_QUALITY * facet_quality(corners))
}

/// The sum of its edges.
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
    fn a_triangle_without_area_has_the_score_zero() {
        for collapsed in [[DVec3::ONE; 3], [DVec3::ZERO, DVec3::X, 2.0 * DVec3::X]] {
            assert_eq!((score(collapsed), unit_normal(collapsed)), (0.0, DVec3::ZERO));
        }
    }
}
