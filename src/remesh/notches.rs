//! Edges of boundaries that the dual lacks.
//!
//! Purpose: where the cell of a seed beside a boundary reaches it between two of the boundary's own, the dual goes from
//! one of these to the other by way of that seed, and the result lacks what lies outside: a notch. One facet fills it.
//! Invariant: only a rim that goes by way of one free vertex is filled; the facet is a fair one and bends little from
//! those beside it. The surface stays a manifold. Must not know: why a cell reaches a boundary.

use std::collections::HashSet;

use glam::DVec3;

use super::triangle::unit_normal;
use crate::mesh::csr::Csr;
use crate::mesh::measure::least_angle;

/// A notch whose facet had a smaller angle than this, degrees, is so flat that its edges are near the boundary: a
/// twentieth of them.
const LEAST_ANGLE: f64 = 12.0;
/// The cosine between its normal and those of the facets beside it, at least.
const LEAST_COSINE: f64 = 0.5;

/// Notches that have a vertex in common are filled in different passes; so many.
const PASSES: usize = 3;

/// Adds a facet for each pair of `wanted` rim vertices between which the rim goes by way of one other vertex that
/// `may_be_inside`. Returns how many were added.
pub(super) fn fill(
    positions: &[DVec3],
    facets: &mut Vec<[u32; 3]>,
    wanted: &[[u32; 2]],
    may_be_inside: impl Fn(u32) -> bool,
) -> usize {
    let before = facets.len();
    for _ in 0..PASSES {
        let rim = Rim { around: &Csr::one_rings(positions.len(), facets), facets };
        let way = |a: u32, b: u32| {
            let inside = rim.only_after(a).filter(|&x| x != b && rim.only_after(x) == Some(b));
            inside.map(|x| [a, b, x])
        };
        let (mut touched, mut added) = (HashSet::new(), Vec::new());
        for &[a, b] in wanted {
            let found = way(a, b).or_else(|| way(b, a)).filter(|&[a, b, x]| may_be_inside(x) && !rim.is_edge(a, b));
            if let Some(facet) = found.filter(|&facet| rim.is_fair(positions, facet))
                && !facet.iter().any(|v| touched.contains(v))
            {
                touched.extend(facet);
                added.push(facet);
            }
        }
        if added.is_empty() {
            break;
        }
        facets.extend(added);
    }
    facets.len() - before
}

struct Rim<'a> {
    around: &'a Csr<u32>,
    facets: &'a [[u32; 3]],
}

impl Rim<'_> {
    /// The facet that goes from `a` to `b`.
    fn facet(&self, a: u32, b: u32) -> Option<[u32; 3]> {
        let goes = |t: &[u32; 3]| (0..3).any(|k| t[k] == a && t[(k + 1) % 3] == b);
        self.around.of(a).iter().map(|&f| self.facets[f as usize]).find(goes)
    }

    fn is_edge(&self, a: u32, b: u32) -> bool {
        self.facet(a, b).is_some() || self.facet(b, a).is_some()
    }

    /// The vertex to which the rim goes on from `a`, if there is one and no more.
    fn only_after(&self, a: u32) -> Option<u32> {
        let next = |&f: &u32| {
            let t = self.facets[f as usize];
            (0..3).find(|&k| t[k] == a).map(|k| t[(k + 1) % 3])
        };
        let mut ways = self.around.of(a).iter().filter_map(next).filter(|&x| self.facet(x, a).is_none());
        ways.next().filter(|_| ways.next().is_none())
    }

    fn is_fair(&self, positions: &[DVec3], facet: [u32; 3]) -> bool {
        let corners = |t: [u32; 3]| t.map(|v| positions[v as usize]);
        let normal = |t: [u32; 3]| unit_normal(corners(t));
        let [a, b, x] = facet;
        let beside = [self.facet(a, x), self.facet(x, b)];
        least_angle(corners(facet)) >= LEAST_ANGLE
            && beside.into_iter().flatten().all(|t| normal(t).dot(normal(facet)) >= LEAST_COSINE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A rim 0, 2, 1 with 2 a little inside, and 3 and 4 behind.
    fn notched(depth: f64) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let at = |x: f64, y: f64| DVec3::new(x, y, 0.0);
        let positions = vec![at(0.0, 0.0), at(1.0, 0.0), at(0.5, depth), at(0.0, 1.0), at(1.0, 1.0)];
        (positions, vec![[0, 2, 3], [2, 1, 4], [2, 4, 3]])
    }

    #[test]
    fn a_notch_is_filled_whichever_end_is_named_first() {
        for wanted in [[0, 1], [1, 0]] {
            let (positions, mut facets) = notched(0.3);
            assert_eq!(fill(&positions, &mut facets, &[wanted], |_| true), 1);
            // The way of its neighbours: up.
            assert_eq!(facets[3], [0, 1, 2]);
            // It is there now.
            assert_eq!(fill(&positions, &mut facets, &[wanted], |_| true), 0);
        }
    }

    #[test]
    fn other_rims_stay() {
        let (positions, mut facets) = notched(0.3);
        assert_eq!(fill(&positions, &mut facets, &[[0, 1]], |v| v != 2), 0, "a vertex of another curve");
        assert_eq!(fill(&positions, &mut facets, &[[0, 4], [3, 2]], |_| true), 0, "these are edges or farther apart");
        let (positions, mut facets) = notched(0.02);
        assert_eq!(fill(&positions, &mut facets, &[[0, 1]], |_| true), 0, "too flat");
        let (mut positions, mut facets) = notched(0.3);
        positions[2].z = 2.0;
        assert_eq!(fill(&positions, &mut facets, &[[0, 1]], |_| true), 0, "it would be a fold");
        let (positions, mut facets) = notched(-0.3);
        assert_eq!(
            fill(&positions, &mut facets, &[[0, 1]], |_| true),
            0,
            "2 is outside: the facet would be turned over"
        );
    }
}
