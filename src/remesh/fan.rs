//! The nearest of the facets around a vertex, for many points.
//!
//! Purpose: [`Fan`] answers for all points that belong to one vertex. A few products tell how near a facet can be at
//! all, and most facets need not be looked at closer.
//! Invariant: the answer is that of looking at all of them, the first of equal ones. Must not know: what the points
//! are.

use glam::DVec3;

use crate::mesh::closest_point::closest_on_facet;
use crate::mesh::csr::Csr;

/// Bounds are trusted but for their rounding: this share, and this squared distance in a unit box.
const TRUST: f64 = 1.0 - 1e-9;
const NOTHING: f64 = 1e-24;

/// Squares below this have no inverse that could be trusted.
const LEAST: f64 = 1e-200;

/// Without a look for NaN.
fn larger(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

/// One facet around the vertex: it lies within the wedge between two of its sides.
struct Wedge {
    facet: u32,
    ids: [u32; 3],
    corners: [DVec3; 3],
    /// A normal, and within the plane those of the two sides that meet in the vertex, inwards.
    ways: [DVec3; 3],
    /// One over the square of the length of each; 0 where there is none.
    scales: [f64; 3],
}

/// See the module's head. Can be used for one vertex after the other.
#[derive(Default)]
pub(super) struct Fan {
    middle: DVec3,
    wedges: Vec<Wedge>,
    bounds: Vec<f64>,
}

/// The nearest point of some facets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Nearest {
    /// Squared distance; infinite if there are no facets.
    pub(super) squared: f64,
    /// The facet; `u32::MAX` if there are none.
    pub(super) facet: u32,
    /// Barycentric coordinates.
    pub(super) weights: [f64; 3],
}

impl Fan {
    /// Looks at the facets around vertex `v` from now on.
    pub(super) fn turn_to(&mut self, positions: &[DVec3], facets: &[[u32; 3]], around: &Csr<u32>, v: u32) {
        self.middle = positions[v as usize];
        self.wedges.clear();
        self.wedges.extend(around.of(v).iter().map(|&facet| {
            let ids = facets[facet as usize];
            let corners = ids.map(|u| positions[u as usize]);
            let k = ids.iter().position(|&u| u == v).unwrap_or(0);
            let (to, from) = (corners[(k + 1) % 3] - corners[k], corners[(k + 2) % 3] - corners[k]);
            let normal = to.cross(from);
            let ways = [normal, normal.cross(to), from.cross(normal)];
            let over = |squared: f64| if squared > LEAST { 1.0 / squared } else { 0.0 };
            let square = normal.length_squared();
            let scales = [square, square * to.length_squared(), square * from.length_squared()].map(over);
            Wedge { facet, ids, corners, ways, scales }
        }));
    }

    /// The nearest facet to `p`.
    pub(super) fn nearest(&mut self, p: DVec3) -> Nearest {
        let d = p - self.middle;
        self.bounds.clear();
        let (mut first, mut least) = (0, f64::INFINITY);
        for (k, wedge) in self.wedges.iter().enumerate() {
            let [off, left, right] = wedge.ways.map(|way| way.dot(d));
            let (left, right) = (larger(-left, 0.0), larger(-right, 0.0));
            let aside = larger(left * left * wedge.scales[1], right * right * wedge.scales[2]);
            let bound = off * off * wedge.scales[0] + aside;
            self.bounds.push(bound);
            if bound < least {
                (first, least) = (k, bound);
            }
        }
        let look = |k: usize| {
            let wedge = &self.wedges[k];
            let (squared, weights) = closest_on_facet(p, wedge.corners, wedge.ids);
            Nearest { squared, facet: wedge.facet, weights }
        };
        if self.wedges.is_empty() {
            return Nearest { squared: f64::INFINITY, facet: u32::MAX, weights: [0.0; 3] };
        }
        let (mut best, mut place) = (look(first), first);
        for (k, &bound) in self.bounds.iter().enumerate() {
            if k != first && bound * TRUST <= best.squared + NOTHING {
                let here = look(k);
                if here.squared < best.squared || (here.squared == best.squared && k < place) {
                    (best, place) = (here, k);
                }
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_as_looking_at_all() {
        let number = |k: u32| f64::from(k.wrapping_mul(2_654_435_761) >> 8) / f64::from(1 << 24) - 0.5;
        let point = |k: u32| DVec3::new(number(3 * k), number(3 * k + 1), number(3 * k + 2));
        let mut fan = Fan::default();
        for round in 0..200 {
            // A bumpy wheel; one in four has a facet without area.
            let mut positions = vec![0.1 * point(round)];
            positions.extend((0..7).map(|k| {
                let (sin, cos) = (f64::from(k) / 7.0 * std::f64::consts::TAU).sin_cos();
                DVec3::new(cos, sin, 0.0) + 0.4 * point(1000 + 7 * round + k)
            }));
            if round % 4 == 0 {
                positions[3] = positions[4];
            }
            let facets: Vec<[u32; 3]> = (0..7).map(|k| [1 + k, 1 + (k + 1) % 7, 0]).collect();
            let around = Csr::one_rings(8, &facets);
            fan.turn_to(&positions, &facets, &around, 0);
            for k in 0..50 {
                let p = 2.0 * point(100_000 + 50 * round + k);
                let all = facets.iter().map(|t| closest_on_facet(p, t.map(|v| positions[v as usize]), *t).0);
                let (facet, squared) =
                    all.enumerate().reduce(|a, b| if b.1 < a.1 { b } else { a }).unwrap_or((0, f64::INFINITY));
                let found = fan.nearest(p);
                assert_eq!((found.facet as usize, found.squared), (facet, squared));
            }
        }
        fan.turn_to(&[DVec3::ZERO], &[], &Csr::one_rings(1, &[]), 0);
        assert_eq!(fan.nearest(DVec3::ONE).facet, u32::MAX);
    }
}
