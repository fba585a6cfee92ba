//! Distances between the two surfaces in one place.
//!
//! Purpose: facets of the input as a patch sees them, points of the result at which its distance is taken, and the
//! distance around one vertex without a patch.
//! Invariant: distances are no less than the true ones. Must not know: how patches change.

use glam::DVec3;

use super::Scene;

/// A facet of the input.
#[derive(Clone, Copy)]
pub(super) struct Rock {
    pub(super) corners: [DVec3; 3],
    pub(super) centre: DVec3,
    pub(super) radius: f64,
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
    let rocks: Vec<Rock> = rocks.into_iter().map(|f| Rock::new(scene.ground.corners(f))).collect();
    let (mut edge, mut hint) = (0.0, 0);
    for &f in star {
        let [a, b, c] = corners(f);
        edge += (a.distance(b) + b.distance(c) + c.distance(a)) / (3 * star.len()) as f64;
        for p in samples([a, b, c]) {
            let (mut best, mut root) = (f64::INFINITY, f64::INFINITY);
            let known = hint;
            for (k, rock) in rocks.get(known).into_iter().map(|r| (known, r)).chain(rocks.iter().enumerate()) {
                let bound = root + rock.radius;
                if p.distance_squared(rock.centre) < bound * bound {
                    let squared = squared_distance(p, rock.corners);
                    if squared < best {
                        (best, root, hint) = (squared, squared.sqrt(), k);
                        // Nearer than something else already.
                        if best <= far {
                            break;
                        }
                    }
                }
            }
            far = if best < f64::INFINITY { far.max(best) } else { far };
        }
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

impl Rock {
    pub(super) fn new(corners: [DVec3; 3]) -> Self {
        let centre = (corners[0] + corners[1] + corners[2]) / 3.0;
        Self { corners, centre, radius: corners.iter().map(|c| c.distance(centre)).fold(0.0, f64::max) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::closest_point::closest_on_facet;

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
