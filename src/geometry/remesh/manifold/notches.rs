//! Boundary edges that a triangulation lacks, since a vertex lies between their ends.
//!
//! Purpose: [`close`] adds the facets that bring such edges, where these face as their neighbours do and are no slivers; it returns the
//! vertices that have to be taken out elsewhere.
//! Invariant: a manifold stays one. Must not know: why an edge has to be there.

use std::collections::{HashMap, HashSet};

use glam::DVec3;

use crate::mesh::edges::sides;
use crate::remesh::constants::{MOST_IN_NOTCH, WIDEST_NOTCH_COSINE};

/// `missing` are the ends of edges, `may_fill` says which vertices may lie between. With `all`, slivers are added too.
pub(crate) fn close(
    positions: &[DVec3],
    facets: &mut Vec<[u32; 3]>,
    missing: &[[u32; 2]],
    may_fill: impl Fn(u32) -> bool,
    all: bool,
) -> Vec<u32> {
    let halves: HashSet<[u32; 2]> = facets.iter().flat_map(|&t| sides(t)).collect();
    // The facet at each half-edge of the boundary, and where that ends; only where one begins.
    let mut next: HashMap<u32, Option<(u32, u32)>> = HashMap::new();
    for (f, &t) in facets.iter().enumerate() {
        for [a, b] in sides(t).into_iter().filter(|&[a, b]| !halves.contains(&[b, a])) {
            next.entry(a).and_modify(|known| *known = None).or_insert(Some((b, f as u32)));
        }
    }
    let path = |from: u32, to: u32| {
        let mut all = vec![from];
        let mut beside = Vec::new();
        while all.len() <= MOST_IN_NOTCH + 1 {
            let &(v, f) = next.get(&all[all.len() - 1])?.as_ref()?;
            all.push(v);
            beside.push(f);
            if v == to {
                return Some((all, beside)).filter(|(all, _)| all.len() > 2);
            }
            if !may_fill(v) {
                return None;
            }
        }
        None
    };
    let at = |v: u32| positions[v as usize];
    let normal = |[a, b, c]: [u32; 3]| (at(b) - at(a)).cross(at(c) - at(a));
    let (mut added, mut out) = (Vec::new(), Vec::new());
    let mut met: HashSet<u32> = HashSet::new();
    for &[a, b] in missing {
        let Some((path, beside)) = path(a, b).or_else(|| path(b, a)) else { continue };
        let (from, to) = (path[0], path[path.len() - 1]);
        let inner = &path[1..path.len() - 1];
        if inner.iter().any(|&v| !met.insert(v)) {
            continue;
        }
        let fan: Vec<[u32; 3]> = path[1..].windows(2).map(|pair| [from, pair[1], pair[0]]).collect();
        let facing: DVec3 = beside.iter().map(|&f| normal(facets[f as usize])).sum();
        let faces = fan.iter().all(|&t| normal(t).dot(facing) > 0.0);
        let is_wide = |&v: &u32| {
            (at(from) - at(v)).normalize_or_zero().dot((at(to) - at(v)).normalize_or_zero()) < WIDEST_NOTCH_COSINE
        };
        if faces && (all || inner.len() == 1 && !inner.iter().any(is_wide)) {
            added.extend(fan);
        } else {
            out.extend(inner);
        }
    }
    facets.extend(added);
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_notch_is_filled_and_a_flat_one_is_named() {
        for (depth, fills) in [(1.0, true), (0.1, false), (-0.1, false)] {
            let positions = [(0.0, 0.0), (2.0, 0.0), (1.0, depth), (1.0, 3.0)].map(|(x, y)| DVec3::new(x, y, 0.0));
            let mut facets = vec![[0, 2, 3], [2, 1, 3]];
            let out = close(&positions, &mut facets, &[[1, 0]], |v| v == 2, false);
            assert_eq!((facets.len(), out.is_empty()), (if fills { 3 } else { 2 }, fills), "{depth}");
            if !fills {
                assert_eq!(out, [2], "{depth}");
                close(&positions, &mut facets, &[[1, 0]], |v| v == 2, true);
                assert_eq!(facets.len() == 3, depth > 0.0, "{depth}");
            }
            assert!(!fills || facets[2] == [0, 1, 2]);
        }
    }
}
