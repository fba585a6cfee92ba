//! Distances between the two surfaces in one place.
//!
//! Purpose: facets of the input as a patch sees them, points of the result at which its distance is taken, and the
//! distance around one vertex without a patch.
//! Invariant: distances are no less than the true ones. Must not know: how patches change.

use std::ops::Range;

use glam::DVec3;

use super::super::triangle::perimeter;
use super::Scene;
use crate::mesh::curve;

/// Rocks of a group, at least; as many as there are groups where there are many.
const GROUP: usize = 8;
/// Spheres are rounded by less than this share.
const ROUNDING: f64 = 1.0 + 1e-12;

/// Facets of the input, those that are near one another in groups.
pub(super) struct Rocks {
    rocks: Vec<Rock>,
    groups: Vec<Ball>,
    /// How many each group has, but for the last.
    of_group: usize,
}

/// A facet of the input.
struct Rock {
    corners: [DVec3; 3],
    ball: Ball,
}

/// A sphere around facets.
#[derive(Clone, Copy)]
struct Ball {
    centre: DVec3,
    radius: f64,
}

impl Ball {
    /// Around these points, as wide as it has to be.
    fn around(points: &[DVec3]) -> Self {
        let centre = points.iter().sum::<DVec3>() / points.len() as f64;
        let squared = points.iter().map(|p| p.distance_squared(centre)).fold(0.0, f64::max);
        Self { centre, radius: squared.sqrt() * ROUNDING }
    }

    /// Whether something of it may be nearer to `p` than `distance`.
    fn is_within(&self, distance: f64, p: DVec3) -> bool {
        let bound = distance + self.radius;
        p.distance_squared(self.centre) < bound * bound
    }
}

impl Rocks {
    /// Of facets with these corners. Coordinates are of the order of 1.
    pub(super) fn new(facets: impl Iterator<Item = [DVec3; 3]>) -> Self {
        let of = |corners: [DVec3; 3]| Rock { corners, ball: Ball::around(&corners) };
        let mut all: Vec<(u64, Rock)> = facets.map(of).map(|rock| (curve::along(rock.ball.centre), rock)).collect();
        // Stable: of two in one place the first stays first.
        all.sort_by_key(|r| r.0);
        let rocks: Vec<Rock> = all.into_iter().map(|r| r.1).collect();
        let group = |rocks: &[Rock]| Ball::around(&rocks.iter().flat_map(|rock| rock.corners).collect::<Vec<_>>());
        let of_group = GROUP.max(rocks.len().isqrt());
        let groups = rocks.chunks(of_group).map(group).collect();
        Self { rocks, groups, of_group }
    }

    /// The facets' corners.
    pub(super) fn corners(&self) -> impl Iterator<Item = [DVec3; 3]> + '_ {
        self.rocks.iter().map(|rock| rock.corners)
    }

    /// All groups.
    pub(super) fn all(&self) -> Vec<u32> {
        (0..self.groups.len() as u32).collect()
    }

    /// Groups of which something may be nearer to `p` than `distance`, or all if there are none.
    pub(super) fn near(&self, p: DVec3, distance: f64) -> Vec<u32> {
        let near = |g: &u32| self.groups[*g as usize].is_within(distance, p);
        let near: Vec<u32> = (0..self.groups.len() as u32).filter(near).collect();
        if near.is_empty() { self.all() } else { near }
    }

    /// Leaves those groups out of which nothing is nearer to `p` than `distance`.
    pub(super) fn retain(&self, groups: &mut Vec<u32>, p: DVec3, distance: f64) {
        groups.retain(|&g| self.groups[g as usize].is_within(distance, p));
    }

    fn of(&self, group: u32) -> Range<usize> {
        let first = group as usize * self.of_group;
        first..self.rocks.len().min(first + self.of_group)
    }

    /// Squared distance of `p` from those in `groups`, or something between that and `enough`; 0 if there are none.
    /// The one that `hint` says is looked at first, of whatever group, and the nearest one left there.
    pub(super) fn distance(&self, p: DVec3, groups: &[u32], hint: &mut u32, enough: f64) -> f64 {
        let Some(first) = self.rocks.get(*hint as usize) else { return 0.0 };
        let mut best = squared_distance(p, first.corners);
        if best < enough {
            return best;
        }
        let mut root = best.sqrt();
        for &group in groups {
            if !self.groups[group as usize].is_within(root, p) {
                continue;
            }
            for r in self.of(group) {
                let rock = &self.rocks[r];
                if !rock.ball.is_within(root, p) {
                    continue;
                }
                let squared = squared_distance(p, rock.corners);
                if squared < best {
                    (best, root, *hint) = (squared, squared.sqrt(), r as u32);
                    if best < enough {
                        return best;
                    }
                }
            }
        }
        best
    }
}

/// Squared distance of `p` from a facet, region by region. Slivers may come out a little too far.
pub(super) fn squared_distance(p: DVec3, [a, b, c]: [DVec3; 3]) -> f64 {
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

/// The least of `other` and the squared distances of `p` from some facets; any number below `enough` if it is below
/// that. The facet that `hint` says is looked at first, and the nearest one left there.
pub(super) fn least_distance(p: DVec3, facets: &[[DVec3; 3]], other: f64, enough: f64, hint: &mut usize) -> f64 {
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

/// How far the result is from the input in and around the cell of vertex `v`, and its mean edge: what
/// [`Patch::distance`] says of the middle, sooner.
pub(in crate::remesh) fn distance_at(scene: &Scene<'_>, v: u32) -> (f64, f64) {
    let corners = |f: u32| scene.facets[f as usize].map(|u| scene.positions[u as usize]);
    let star = scene.stars.of(v);
    let mut ring: Vec<u32> = star.iter().flat_map(|&f| scene.facets[f as usize]).collect();
    ring.sort_unstable();
    ring.dedup();
    let mut wider: Vec<u32> = ring.iter().flat_map(|&u| scene.stars.of(u)).copied().collect();
    wider.sort_unstable();
    wider.dedup();
    let wider: Vec<[DVec3; 3]> = wider.into_iter().map(corners).collect();
    let mut rocks: Vec<u32> = ring.iter().flat_map(|&u| scene.ground.facets(u)).copied().collect();
    rocks.sort_unstable();
    rocks.dedup();
    let own = scene.ground.facets(v).iter().flat_map(|&f| middles(scene.ground.corners(f)));
    let here = scene.positions[v as usize];
    let beside = |p: &DVec3| {
        let own = here.distance(*p);
        ring.iter().all(|&u| u == v || scene.positions[u as usize].distance(*p) > own)
    };
    let (mut far, mut hint) = (0.0f64, 0);
    for p in scene.ground.tips(v).iter().copied().chain(own.filter(beside)) {
        // What is not as far as something else already need not be known.
        far = far.max(least_distance(p, &wider, f64::INFINITY, far, &mut hint));
    }
    let rocks = Rocks::new(rocks.into_iter().map(|f| scene.ground.corners(f)));
    let (groups, mut edge, mut hint) = (rocks.all(), 0.0, 0);
    for &f in star {
        edge += perimeter(corners(f)) / (3 * star.len()) as f64;
        samples(corners(f)).for_each(|p| far = far.max(rocks.distance(p, &groups, &mut hint, far)));
    }
    (far.sqrt(), edge)
}

/// Middles of the edges of a facet.
fn middles([a, b, c]: [DVec3; 3]) -> [DVec3; 3] {
    [(a + b) / 2.0, (b + c) / 2.0, (c + a) / 2.0]
}

/// Steps to an edge of the points of a facet at which its distance from the input is taken. With four, and a few points
/// within, ridges that run through a facet stuck out a third farther than was seen.
const GRID: u32 = 6;

/// Those points of a facet of the result.
pub(super) fn samples([a, b, c]: [DVec3; 3]) -> impl Iterator<Item = DVec3> {
    let share = |k: u32| f64::from(k) / f64::from(GRID);
    (0..=GRID).flat_map(move |i| (0..=GRID - i).map(move |j| share(GRID - i - j) * a + share(i) * b + share(j) * c))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::closest_point::closest_on_facet;

    #[test]
    fn the_nearest_rock_is_found_whatever_is_looked_at_first() {
        let number = |k: u32| f64::from(k.wrapping_mul(2_654_435_761) >> 16) / 65_536.0;
        let point = |k: u32| DVec3::new(number(3 * k), number(3 * k + 1), number(3 * k + 2));
        for facets in [0, 1, 7, 8, 9, 200] {
            let corners = |k: u32| [0, 1, 2].map(|c| point(7 * k) + 0.1 * point(7 * k + c + 1));
            let rocks = Rocks::new((0..facets).map(corners));
            assert_eq!(rocks.corners().count(), facets as usize);
            let mut hint = 0;
            for k in 0..500 {
                let p = 2.0 * point(k + 5000) - 0.5;
                let want = rocks.corners().map(|t| squared_distance(p, t)).fold(f64::INFINITY, f64::min);
                let want = if facets == 0 { 0.0 } else { want };
                assert_eq!(rocks.distance(p, &rocks.all(), &mut hint, 0.0), want);
                let mut near = rocks.near(p, want.sqrt() * 1.1);
                assert_eq!(rocks.distance(p, &near, &mut hint, 0.0), want);
                rocks.retain(&mut near, p, want.sqrt() * 1.01);
                assert_eq!(rocks.distance(p, &near, &mut 0, 0.0), want);
                let some = rocks.distance(p, &near, &mut 0, 2.0 * want);
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
