//! The closest point in a one-ring.
//!
//! Purpose: [`RingQuery`] answers for many points that belong to one vertex. A lower bound for each facet, from the planes of
//! its wedge, decides which facets need an exact answer.
//! Invariant: the answer is that of looking at all facets, the first of equally near ones. Must not know: what the points are.

use glam::DVec3;

use crate::mesh::closest_point::closest_on_facet;
use crate::remesh::constants::{BOUND_ROUNDING, ZERO_LENGTH_SQUARED, ZERO_SQUARED};
use crate::remesh::manifold::local_mesh::LocalMesh;

/// The larger of two numbers that are not NaN; `f64::max` also asks for NaN.
fn larger(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

/// One facet of the ring. It lies in the wedge between its two sides at the vertex.
struct Wedge {
    facet: u32,
    ids: [u32; 3],
    corners: [DVec3; 3],
    /// The normal of the facet, and those of the two sides at the vertex, in the plane and inwards.
    normals: [DVec3; 3],
    /// One over the squared length of each; 0 for a length of zero.
    inverse_squares: [f64; 3],
}

/// See the module's head. One query serves one vertex after the other.
#[derive(Default)]
pub(crate) struct RingQuery {
    centre: DVec3,
    wedges: Vec<Wedge>,
    bounds: Vec<f64>,
}

/// The nearest point of a one-ring.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Nearest {
    /// Squared distance; infinite if there are no facets.
    pub(crate) squared: f64,
    /// The facet; `u32::MAX` if there are none.
    pub(crate) facet: u32,
    /// Barycentric coordinates.
    pub(crate) weights: [f64; 3],
}

impl RingQuery {
    /// From now on, answers for the one-ring of vertex `v`.
    pub(crate) fn move_to(&mut self, mesh: &LocalMesh, v: u32) {
        self.centre = mesh.positions[v as usize];
        self.wedges.clear();
        self.wedges.extend(mesh.ring(v).iter().map(|&facet| {
            let ids = mesh.facets()[facet as usize];
            let corners = mesh.corners(facet);
            let k = ids.iter().position(|&u| u == v).unwrap_or(0);
            let (to, from) = (corners[(k + 1) % 3] - corners[k], corners[(k + 2) % 3] - corners[k]);
            let normal = to.cross(from);
            let normals = [normal, normal.cross(to), from.cross(normal)];
            let over = |squared: f64| if squared > ZERO_LENGTH_SQUARED { 1.0 / squared } else { 0.0 };
            let square = normal.length_squared();
            let inverse_squares = [square, square * to.length_squared(), square * from.length_squared()].map(over);
            Wedge { facet, ids, corners, normals, inverse_squares }
        }));
    }

    /// The nearest facet to `p`.
    pub(crate) fn nearest(&mut self, p: DVec3) -> Nearest {
        let d = p - self.centre;
        self.bounds.clear();
        let (mut first, mut least) = (0, f64::INFINITY);
        for (k, wedge) in self.wedges.iter().enumerate() {
            let [off, left, right] = wedge.normals.map(|normal| normal.dot(d));
            let (left, right) = (larger(-left, 0.0), larger(-right, 0.0));
            let tangential = larger(left * left * wedge.inverse_squares[1], right * right * wedge.inverse_squares[2]);
            let bound = off * off * wedge.inverse_squares[0] + tangential;
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
            if k != first && bound * BOUND_ROUNDING <= best.squared + ZERO_SQUARED {
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
    use std::collections::HashSet;

    use super::*;

    #[test]
    fn the_same_as_looking_at_all() {
        let number = |k: u32| f64::from(k.wrapping_mul(2_654_435_761) >> 8) / f64::from(1 << 24) - 0.5;
        let point = |k: u32| DVec3::new(number(3 * k), number(3 * k + 1), number(3 * k + 2));
        let mut query = RingQuery::default();
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
            query.move_to(&LocalMesh::new(positions.clone(), facets.clone(), HashSet::new()), 0);
            for k in 0..50 {
                let p = 2.0 * point(100_000 + 50 * round + k);
                let all = facets.iter().map(|t| closest_on_facet(p, t.map(|v| positions[v as usize]), *t).0);
                let (facet, squared) =
                    all.enumerate().reduce(|a, b| if b.1 < a.1 { b } else { a }).unwrap_or((0, f64::INFINITY));
                let found = query.nearest(p);
                assert_eq!((found.facet as usize, found.squared), (facet, squared));
            }
        }
        query.move_to(&LocalMesh::new(vec![DVec3::ZERO], Vec::new(), HashSet::new()), 0);
        assert_eq!(query.nearest(DVec3::ONE).facet, u32::MAX);
    }
}
