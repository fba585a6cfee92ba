//! Vertices within straight edges of the boundary, taken out.
//!
//! Purpose: [`take_out`] removes vertices of the boundary that lie between their neighbours on it, and triangulates what their facets
//! leave by the worst shape that is best.
//! Invariant: a manifold stays one. No facet turns over. Must not know: why a vertex is not wanted.

use std::collections::HashSet;

use glam::DVec3;

use crate::mesh::csr::OneRings;
use crate::remesh::constants::{MOST_AROUND_TAKEN, TAKEN_COSINE};
use crate::remesh::triangle::{score, unit_normal};

/// Takes vertices out of a triangulation, in this order. Returns those that are out; no facet has them.
pub(crate) fn take_out(positions: &[DVec3], facets: &mut Vec<[u32; 3]>, vertices: &[u32]) -> HashSet<u32> {
    let mut rings = OneRings::new(positions.len(), facets);
    let mut gone = HashSet::new();
    let mut spare: HashSet<u32> = HashSet::new();
    for &v in vertices {
        let ring = rings.of(v).to_vec();
        let Some(around) = fan(facets, &ring, v) else { continue };
        let is_edge = |a: u32, b: u32| {
            let has = |f: &&u32| !ring.contains(f) && facets[**f as usize].contains(&b);
            rings.of(a).iter().any(|f| has(&f))
        };
        let Some(new) = triangulate(positions, &around, v, is_edge) else { continue };
        for (k, &f) in ring.iter().enumerate() {
            let old = facets[f as usize];
            match new.get(k) {
                Some(&t) => {
                    rings.replace(f, old, t);
                    facets[f as usize] = t;
                }
                None => {
                    rings.replace(f, old, []);
                    spare.insert(f);
                }
            }
        }
        gone.insert(v);
    }
    let mut f = 0;
    facets.retain(|_| {
        f += 1;
        !spare.contains(&(f - 1))
    });
    gone
}

/// The vertices around one of the boundary, in the order of its facets; `None` if these are no fan.
fn fan(facets: &[[u32; 3]], ring: &[u32], v: u32) -> Option<Vec<u32>> {
    let mut sides: Vec<[u32; 2]> = Vec::with_capacity(ring.len());
    for &f in ring {
        let t = facets[f as usize];
        let at = t.iter().position(|&corner| corner == v)?;
        sides.push([t[(at + 1) % 3], t[(at + 2) % 3]]);
    }
    let first = sides.iter().find(|side| !sides.iter().any(|other| other[1] == side[0]))?[0];
    let mut around = vec![first];
    while let Some(side) = sides.iter().find(|side| side[0] == around[around.len() - 1]) {
        if around.contains(&side[1]) {
            return None;
        }
        around.push(side[1]);
    }
    (around.len() == ring.len() + 1 && around.len() <= MOST_AROUND_TAKEN).then_some(around)
}

/// Facets between these vertices, of which the first and the last get an edge; `None` if any would face away from those around `v`, or
/// have an edge that there is elsewhere.
fn triangulate(
    positions: &[DVec3],
    around: &[u32],
    v: u32,
    is_edge: impl Fn(u32, u32) -> bool,
) -> Option<Vec<[u32; 3]>> {
    let at = |v: u32| positions[v as usize];
    let n = around.len();
    let facing: DVec3 = around.windows(2).map(|p| (at(p[0]) - at(v)).cross(at(p[1]) - at(v))).sum();
    let facing = facing.normalize_or_zero();
    // The edge is there already if the vertex has one facet alone, and must not be there otherwise.
    if is_edge(around[0], around[n - 1]) != (n == 2) {
        return None;
    }
    // The worst shape between two of the vertices, at its best, and the third corner of the facet at their edge.
    let mut best = vec![vec![(f64::INFINITY, 0usize); n]; n];
    for width in 2..n {
        for i in 0..n - width {
            let k = i + width;
            let mut found = (f64::NEG_INFINITY, i + 1);
            if width == n - 1 || !is_edge(around[i], around[k]) {
                for (j, from_j) in best.iter().enumerate().take(k).skip(i + 1) {
                    let corners = [i, j, k].map(|p| at(around[p]));
                    let own = match unit_normal(corners).dot(facing) {
                        cosine if cosine < TAKEN_COSINE => f64::NEG_INFINITY,
                        _ => score(corners),
                    };
                    let worst = own.min(best[i][j].0).min(from_j[k].0);
                    if worst > found.0 {
                        found = (worst, j);
                    }
                }
            }
            best[i][k] = found;
        }
    }
    // One facet without area was all that there was.
    if n > 2 && best[0][n - 1].0 == f64::NEG_INFINITY {
        return None;
    }
    let (mut facets, mut open) = (Vec::with_capacity(n - 2), vec![(0, n - 1)]);
    while let Some((i, k)) = open.pop() {
        if k > i + 1 {
            let j = best[i][k].1;
            facets.push([i, j, k].map(|p| around[p]));
            open.extend([(i, j), (j, k)]);
        }
    }
    Some(facets)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vertices_of_an_edge_are_taken_out() {
        // A strip with its lower edge in six parts.
        let below = (0..=6).map(|k| DVec3::new(f64::from(k), 0.0, 0.0));
        let above = (0..=6).map(|k| DVec3::new(f64::from(k), 1.0, 0.0));
        let positions: Vec<DVec3> = below.chain(above).collect();
        let mut facets: Vec<[u32; 3]> = (0..6).flat_map(|k| [[k, k + 1, k + 7], [k + 1, k + 8, k + 7]]).collect();
        let gone = take_out(&positions, &mut facets, &[1, 5, 2, 4, 3]);
        assert_eq!(gone.len(), 5);
        assert_eq!(facets.len(), 7);
        assert!(facets.iter().flatten().all(|v| !gone.contains(v)));
        let area = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| positions[v as usize]);
            0.5 * (b - a).cross(c - a).z
        };
        assert!(facets.iter().all(|t| area(t) > 0.0));
        assert!((facets.iter().map(area).sum::<f64>() - 6.0).abs() < 1e-12);
        assert!(facets.iter().any(|t| t.contains(&0) && t.contains(&6)), "{facets:?}");
    }

    #[test]
    fn a_vertex_with_one_facet_is_taken_out_with_it() {
        let positions = [[0.0, 0.0], [2.0, 0.0], [1.0, 1.0], [1.0, 0.0]].map(|[x, y]| DVec3::new(x, y, 0.0));
        let mut facets = vec![[0, 1, 2], [0, 3, 1]];
        assert_eq!(take_out(&positions, &mut facets, &[3]), HashSet::from([3]));
        assert_eq!(facets, [[0, 1, 2]]);
    }
}
