//! The closest point of a small set of facets.
//!
//! Purpose: [`FacetSet`] finds the nearest of some facets, without the cost of a hierarchy over all. Facets that are near one
//! another form a group with a bounding sphere, so that most need not be looked at. Groups of slender facets have a box along
//! these too: they fill little of a sphere. [`sample_points`] are the points of a facet at
//! which its distance from others is taken.
//! Invariant: a distance is no less than the true one. Must not know: which facets these are.

use std::ops::Range;

use glam::DVec3;

use super::bvh::morton;
use super::normal;

/// Facets of a group, at least. Large sets have as many groups as facets in a group.
const FACETS_PER_GROUP: usize = 8;
/// Factor by which radii grow, so that rounding leaves nothing outside.
const SPHERE_ROUNDING: f64 = 1.0 + 1e-12;
/// Sets of fewer facets have no boxes: it takes as long to look at all.
const FACETS_WITH_BOXES: usize = 64;
/// A facet is slender if the square of its longest edge is more than this many times its area. Of ordinary ones it is 2 to 10.
const SLENDER: f64 = 64.0;
/// Margin of a box, for rounding; coordinates are of the order of 1.
const BOX_ROUNDING: f64 = 1e-12;
/// Intervals on an edge of a facet's grid of points. With 4, ridges in a facet stuck out a third farther than measured.
const GRID_INTERVALS: u32 = 6;

pub(crate) struct FacetSet {
    facets: Vec<BoundedFacet>,
    /// Spheres around consecutive facets.
    groups: Vec<BoundingSphere>,
    /// Boxes around the same; none unless there are slender facets.
    boxes: Vec<OrientedBox>,
    /// Facets of each group but the last.
    group_size: usize,
}

struct BoundedFacet {
    corners: [DVec3; 3],
    sphere: BoundingSphere,
}

#[derive(Clone, Copy)]
struct BoundingSphere {
    centre: DVec3,
    radius: f64,
}

impl BoundingSphere {
    /// Centred at their mean.
    fn around(points: &[DVec3]) -> Self {
        let centre = points.iter().sum::<DVec3>() / points.len() as f64;
        let squared = points.iter().map(|p| p.distance_squared(centre)).fold(0.0, f64::max);
        Self { centre, radius: squared.sqrt() * SPHERE_ROUNDING }
    }

    /// Whether something inside may be nearer to `p` than `distance`.
    fn reaches(&self, p: DVec3, distance: f64) -> bool {
        let bound = distance + self.radius;
        p.distance_squared(self.centre) < bound * bound
    }
}

/// A box along the longest edge in it.
struct OrientedBox {
    axes: [DVec3; 3],
    low: DVec3,
    high: DVec3,
}

impl OrientedBox {
    fn around(facets: &[BoundedFacet]) -> Self {
        let longest = |a: DVec3, b: DVec3| if b.length_squared() > a.length_squared() { b } else { a };
        let edges = facets.iter().flat_map(|facet| edges(facet.corners));
        let along = edges.fold(DVec3::ZERO, longest).normalize_or(DVec3::X);
        let up = facets.iter().map(|facet| normal(facet.corners)).fold(DVec3::ZERO, longest);
        let up = up.reject_from_normalized(along).try_normalize().unwrap_or_else(|| along.any_orthonormal_vector());
        let mut found = Self { axes: [along, up, along.cross(up)], low: DVec3::INFINITY, high: DVec3::NEG_INFINITY };
        for corner in facets.iter().flat_map(|facet| facet.corners) {
            let place = found.place(corner);
            (found.low, found.high) = (found.low.min(place - BOX_ROUNDING), found.high.max(place + BOX_ROUNDING));
        }
        found
    }

    fn place(&self, p: DVec3) -> DVec3 {
        DVec3::from_array(self.axes.map(|axis| axis.dot(p)))
    }

    /// Whether something inside may be nearer to `p` than `distance`.
    fn reaches(&self, p: DVec3, distance: f64) -> bool {
        let place = self.place(p);
        (self.low - place).max(place - self.high).max(DVec3::ZERO).length_squared() < distance * distance
    }
}

fn edges([a, b, c]: [DVec3; 3]) -> [DVec3; 3] {
    [b - a, c - b, a - c]
}

fn is_slender(facet: &BoundedFacet) -> bool {
    let longest = edges(facet.corners).into_iter().map(DVec3::length_squared).fold(0.0, f64::max);
    longest > 0.5 * SLENDER * normal(facet.corners).length()
}

impl FacetSet {
    /// A set of facets with these corners. Coordinates are of the order of 1.
    pub(crate) fn new(facets: impl Iterator<Item = [DVec3; 3]>) -> Self {
        let bounded = |corners: [DVec3; 3]| BoundedFacet { corners, sphere: BoundingSphere::around(&corners) };
        let along_curve = |facet: BoundedFacet| (morton(facet.sphere.centre), facet);
        let mut all: Vec<(u64, BoundedFacet)> = facets.map(bounded).map(along_curve).collect();
        // Stable: of two facets in one place the first stays first.
        all.sort_by_key(|r| r.0);
        let facets: Vec<BoundedFacet> = all.into_iter().map(|r| r.1).collect();
        let around = |group: &[BoundedFacet]| {
            BoundingSphere::around(&group.iter().flat_map(|facet| facet.corners).collect::<Vec<_>>())
        };
        let group_size = FACETS_PER_GROUP.max(facets.len().isqrt());
        let groups = facets.chunks(group_size).map(around).collect();
        let has_boxes = facets.len() >= FACETS_WITH_BOXES && facets.iter().any(is_slender);
        let chunks = facets.chunks(group_size).filter(|_| has_boxes);
        let boxes = chunks.map(OrientedBox::around).collect();
        Self { facets, groups, boxes, group_size }
    }

    /// Whether a facet of a group may be nearer to `p` than `distance`.
    fn reaches(&self, group: u32, p: DVec3, distance: f64) -> bool {
        let group = group as usize;
        self.groups[group].reaches(p, distance) && self.boxes.get(group).is_none_or(|b| b.reaches(p, distance))
    }

    pub(crate) fn corners(&self) -> impl Iterator<Item = [DVec3; 3]> + '_ {
        self.facets.iter().map(|facet| facet.corners)
    }

    pub(crate) fn all_groups(&self) -> Vec<u32> {
        (0..self.groups.len() as u32).collect()
    }

    /// Groups with facets that may be nearer to `p` than `distance`; all groups if there is none.
    pub(crate) fn groups_near(&self, p: DVec3, distance: f64) -> Vec<u32> {
        let near = |g: &u32| self.reaches(*g, p, distance);
        let near: Vec<u32> = (0..self.groups.len() as u32).filter(near).collect();
        if near.is_empty() { self.all_groups() } else { near }
    }

    /// Keeps the `groups` with facets that may be nearer to `p` than `distance`.
    pub(crate) fn retain_near(&self, groups: &mut Vec<u32>, p: DVec3, distance: f64) {
        groups.retain(|&g| self.reaches(g, p, distance));
    }

    fn facets_of(&self, group: u32) -> Range<usize> {
        let first = group as usize * self.group_size;
        first..self.facets.len().min(first + self.group_size)
    }

    /// Squared distance of `p` from the facets in `groups`, or a number between that and `enough`. 0 if the set is empty.
    /// `hint` is the facet to look at first, of any group; the nearest one found is left there.
    pub(crate) fn distance(&self, p: DVec3, groups: &[u32], hint: &mut u32, enough: f64) -> f64 {
        let Some(first) = self.facets.get(*hint as usize) else { return 0.0 };
        let mut best = squared_distance(p, first.corners);
        if best < enough {
            return best;
        }
        let mut root = best.sqrt();
        for &group in groups {
            if !self.reaches(group, p, root) {
                continue;
            }
            for f in self.facets_of(group) {
                let facet = &self.facets[f];
                if !facet.sphere.reaches(p, root) {
                    continue;
                }
                let squared = squared_distance(p, facet.corners);
                if squared < best {
                    (best, root, *hint) = (squared, squared.sqrt(), f as u32);
                    if best < enough {
                        return best;
                    }
                }
            }
        }
        best
    }
}

/// Squared distance of `p` from a facet, by Voronoi regions of its corners and edges. Rounding may make slivers a little too far.
pub(crate) fn squared_distance(p: DVec3, [a, b, c]: [DVec3; 3]) -> f64 {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    let (va, vb, vc) = (d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2);
    if d1 <= 0.0 && d2 <= 0.0 {
        return ap.length_squared();
    }
    if d3 >= 0.0 && d4 <= d3 {
        return bp.length_squared();
    }
    if d6 >= 0.0 && d5 <= d6 {
        return cp.length_squared();
    }
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return (ap - ab * (d1 / (d1 - d3))).length_squared();
    }
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return (ap - ac * (d2 / (d2 - d6))).length_squared();
    }
    if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        return (bp - (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)))).length_squared();
    }
    let whole = va + vb + vc;
    (ap - ab * (vb / whole) - ac * (vc / whole)).length_squared()
}

/// The least of `other` and the squared distances of `p` from some facets, or a number between that and `enough`. `hint` is
/// the facet to look at first; the nearest one found is left there.
pub(crate) fn least_distance(p: DVec3, facets: &[[DVec3; 3]], other: f64, enough: f64, hint: &mut usize) -> f64 {
    let (mut least, first) = (other, *hint);
    for k in std::iter::once(first).chain((0..facets.len()).filter(|&k| k != first)) {
        let squared = squared_distance(p, facets[k]);
        if squared < least {
            (least, *hint) = (squared, k);
            if least < enough {
                break;
            }
        }
    }
    least
}

pub(crate) fn sample_points([a, b, c]: [DVec3; 3]) -> impl Iterator<Item = DVec3> {
    let share = |k: u32| f64::from(k) / f64::from(GRID_INTERVALS);
    (0..=GRID_INTERVALS).flat_map(move |i| {
        (0..=GRID_INTERVALS - i).map(move |j| share(GRID_INTERVALS - i - j) * a + share(i) * b + share(j) * c)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::closest_point::closest_on_facet;

    #[test]
    fn the_nearest_facet_is_found_whatever_is_looked_at_first() {
        let number = |k: u32| f64::from(k.wrapping_mul(2_654_435_761) >> 16) / 65_536.0;
        let point = |k: u32| DVec3::new(number(3 * k), number(3 * k + 1), number(3 * k + 2));
        for (facets, is_slender) in
            [(0, false), (1, false), (7, false), (8, true), (9, false), (200, false), (200, true)]
        {
            // Slender ones are side by side, as in a fan.
            let needle = |k: u32| {
                [DVec3::ZERO, point(5), point(5) + 1e-3 * DVec3::Y].map(|p| p + 0.01 * point(6) * f64::from(k))
            };
            let ordinary = |k: u32| [0, 1, 2].map(|c| point(7 * k) + 0.1 * point(7 * k + c + 1));
            let set = FacetSet::new((0..facets).map(|k| if is_slender { needle(k) } else { ordinary(k) }));
            assert!(!set.boxes.is_empty() || !is_slender || facets < 64);
            assert_eq!(set.corners().count(), facets as usize);
            let mut hint = 0;
            for k in 0..500 {
                let p = 2.0 * point(k + 5000) - 0.5;
                let want = set.corners().map(|t| squared_distance(p, t)).fold(f64::INFINITY, f64::min);
                let want = if facets == 0 { 0.0 } else { want };
                assert_eq!(set.distance(p, &set.all_groups(), &mut hint, 0.0), want);
                let mut near = set.groups_near(p, want.sqrt() * 1.1);
                assert_eq!(set.distance(p, &near, &mut hint, 0.0), want);
                set.retain_near(&mut near, p, want.sqrt() * 1.01);
                assert_eq!(set.distance(p, &near, &mut 0, 0.0), want);
                let some = set.distance(p, &near, &mut 0, 2.0 * want);
                assert!(some == want || some < 2.0 * want);
            }
        }
    }

    #[test]
    fn distances_are_those_of_the_closest_points() {
        let number = |k: u32| f64::from(k.wrapping_mul(2_654_435_761) >> 16) / 65_536.0;
        let point = |k: u32| DVec3::new(number(3 * k), number(3 * k + 1), number(3 * k + 2));
        for k in 0..2000 {
            let (p, t) = (point(4 * k), [point(4 * k + 1), point(4 * k + 2), point(4 * k + 3)]);
            let (want, got) = (closest_on_facet(p, t, [0, 1, 2]).0, squared_distance(p, t));
            // Coordinates up to 1, facets no thinner than random ones are.
            assert!((want - got).abs() < 1e-9, "{k}: {got} and not {want}");
        }
    }
}
