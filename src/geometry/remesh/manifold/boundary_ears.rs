//! Ears of the boundary that the dual lacks.
//!
//! Purpose: where the cell of an inner seed reaches the boundary between two of the boundary's own seeds, the dual's boundary
//! goes around it by way of that seed. [`fill`] adds the missing facet, an ear: the boundary has its edge again. [`close_gaps`]
//! fills small holes that the surface has not, ear by ear.
//! Invariant: [`fill`] adds an ear only where the boundary goes by way of one free vertex, if the ear is well shaped and nearly in
//! the plane of its neighbours. The surface stays a manifold. Must not know: why a cell reaches a boundary.

use std::collections::HashSet;

use glam::DVec3;

use crate::mesh::csr::Csr;
use crate::mesh::measure::least_angle;
use crate::remesh::constants::{LEAST_EAR_ANGLE, LEAST_EAR_COSINE};
use crate::remesh::triangle::unit_normal;
use crate::token::{Stopped, Token};

/// Adds an ear for each `wanted` pair that the boundary joins by one other vertex that `may_be_inside`. Returns how many.
pub(crate) fn fill(
    positions: &[DVec3],
    facets: &mut Vec<[u32; 3]>,
    wanted: &[[u32; 2]],
    may_be_inside: impl Fn(u32) -> bool,
) -> usize {
    let before = facets.len();
    // Ears that have a vertex in common are added in different passes. What was added is an edge from then on.
    loop {
        let boundary = Boundary { rings: &Csr::one_rings(positions.len(), facets), facets };
        let ear = |a: u32, b: u32| {
            let inside = boundary.only_after(a).filter(|&x| x != b && boundary.only_after(x) == Some(b));
            inside.map(|x| [a, b, x])
        };
        let (mut touched, mut added) = (HashSet::new(), Vec::new());
        for &[a, b] in wanted {
            let found =
                ear(a, b).or_else(|| ear(b, a)).filter(|&[a, b, x]| may_be_inside(x) && !boundary.is_edge(a, b));
            if let Some(facet) = found.filter(|&facet| boundary.is_fair(positions, facet))
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

/// Vertices around a gap, at most.
const MOST_AROUND: usize = 64;

/// Closes gaps along creases: the diagrams on the two sides of a lifted crease need not pass from one seed to the next at the same
/// places, and where a third seed comes between on one side alone, the dual has a small loop there. Loops with an edge of the
/// surface's own boundary stay. Returns how many facets were added.
pub(crate) fn close_gaps(
    positions: &[DVec3],
    facets: &mut Vec<[u32; 3]>,
    is_rim: impl Fn([u32; 2]) -> bool,
    token: &Token,
) -> Result<usize, Stopped> {
    let before = facets.len();
    let boundary = Boundary { rings: &Csr::one_rings(positions.len(), facets), facets };
    let (mut seen, mut added) = (HashSet::<u32>::new(), Vec::new());
    for first in 0..positions.len() as u32 {
        token.check_at(first as usize)?;
        if seen.contains(&first) {
            continue;
        }
        let mut around = vec![first];
        while let Some(next) = boundary.only_after(around[around.len() - 1]) {
            if next == first || around.len() > MOST_AROUND || around.contains(&next) {
                break;
            }
            around.push(next);
        }
        let edges = || (0..around.len()).map(|k| [around[k], around[(k + 1) % around.len()]]);
        let closed = around.len() >= 3 && boundary.only_after(around[around.len() - 1]) == Some(first);
        if closed && around.len() <= MOST_AROUND && !edges().any(&is_rim) {
            seen.extend(&around);
            added.extend(boundary.ears(positions, around));
        }
    }
    facets.extend(added);
    Ok(facets.len() - before)
}

/// The edges with one facet.
struct Boundary<'a> {
    rings: &'a Csr<u32>,
    facets: &'a [[u32; 3]],
}

impl Boundary<'_> {
    /// The facet that goes from `a` to `b`.
    fn facet(&self, a: u32, b: u32) -> Option<[u32; 3]> {
        let goes = |t: &[u32; 3]| (0..3).any(|k| t[k] == a && t[(k + 1) % 3] == b);
        // One of the two one-rings may be very large.
        let [a_ring, b_ring] = [a, b].map(|v| self.rings.of(v));
        let ring = if a_ring.len() <= b_ring.len() { a_ring } else { b_ring };
        ring.iter().map(|&f| self.facets[f as usize]).find(goes)
    }

    fn is_edge(&self, a: u32, b: u32) -> bool {
        self.facet(a, b).is_some() || self.facet(b, a).is_some()
    }

    /// The vertex to which the boundary goes on from `a`, if there is exactly one.
    fn only_after(&self, a: u32) -> Option<u32> {
        let next = |&f: &u32| {
            let t = self.facets[f as usize];
            (0..3).find(|&k| t[k] == a).map(|k| t[(k + 1) % 3])
        };
        let mut nexts = self.rings.of(a).iter().filter_map(next).filter(|&x| self.facet(x, a).is_none());
        nexts.next().filter(|_| nexts.next().is_none())
    }

    /// Facets that fill a loop: the best shaped ear first, whose new edge is none yet. None if it cannot be filled.
    fn ears(&self, positions: &[DVec3], mut around: Vec<u32>) -> Vec<[u32; 3]> {
        let mut facets = Vec::new();
        while around.len() > 3 {
            let n = around.len();
            let ear = |k: usize| [around[(k + 1) % n], around[k], around[(k + n - 1) % n]];
            let is_new = |k: &usize| !self.is_edge(around[(k + 1) % n], around[(k + n - 1) % n]);
            let angle = |k: usize| least_angle(ear(k).map(|v| positions[v as usize]));
            let best = (0..n).filter(is_new).max_by(|&a, &b| angle(a).total_cmp(&angle(b)));
            let Some(best) = best else { return Vec::new() };
            facets.push(ear(best));
            around.remove(best);
        }
        facets.push([around[2], around[1], around[0]]);
        facets
    }

    fn is_fair(&self, positions: &[DVec3], facet: [u32; 3]) -> bool {
        let corners = |t: [u32; 3]| t.map(|v| positions[v as usize]);
        let normal = |t: [u32; 3]| unit_normal(corners(t));
        let [a, b, x] = facet;
        let beside = [self.facet(a, x), self.facet(x, b)];
        least_angle(corners(facet)) >= LEAST_EAR_ANGLE
            && beside.into_iter().flatten().all(|t| normal(t).dot(normal(facet)) >= LEAST_EAR_COSINE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A boundary 0, 2, 1 with 2 a little inside, and 3 and 4 behind.
    fn without_ear(depth: f64) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let at = |x: f64, y: f64| DVec3::new(x, y, 0.0);
        let positions = vec![at(0.0, 0.0), at(1.0, 0.0), at(0.5, depth), at(0.0, 1.0), at(1.0, 1.0)];
        (positions, vec![[0, 2, 3], [2, 1, 4], [2, 4, 3]])
    }

    #[test]
    fn an_ear_is_added_whichever_end_is_named_first() {
        for wanted in [[0, 1], [1, 0]] {
            let (positions, mut facets) = without_ear(0.3);
            assert_eq!(fill(&positions, &mut facets, &[wanted], |_| true), 1);
            // Oriented as its neighbours.
            assert_eq!(facets[3], [0, 1, 2]);
            // It is there now.
            assert_eq!(fill(&positions, &mut facets, &[wanted], |_| true), 0);
        }
    }

    #[test]
    fn other_boundaries_stay() {
        let (positions, mut facets) = without_ear(0.3);
        assert_eq!(fill(&positions, &mut facets, &[[0, 1]], |v| v != 2), 0, "a vertex of another curve");
        assert_eq!(fill(&positions, &mut facets, &[[0, 4], [3, 2]], |_| true), 0, "these are edges or farther apart");
        let (positions, mut facets) = without_ear(0.02);
        assert_eq!(fill(&positions, &mut facets, &[[0, 1]], |_| true), 0, "too flat");
        let (mut positions, mut facets) = without_ear(0.3);
        positions[2].z = 2.0;
        assert_eq!(fill(&positions, &mut facets, &[[0, 1]], |_| true), 0, "it would be a fold");
        let (positions, mut facets) = without_ear(-0.3);
        assert_eq!(
            fill(&positions, &mut facets, &[[0, 1]], |_| true),
            0,
            "2 is outside: the facet would be turned over"
        );
    }
}
