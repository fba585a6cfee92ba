//! Corners of facets between edges that stay.
//!
//! Purpose: [`tips`] finds the corners of facets both sides of which are edges that stay, and groups the curves there by place.
//! Seeds in one distance on both sides give such a corner its facet.
//! Invariant: copies of a curve at other sheets are in the same group. Must not know: where seeds are.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;

use super::seams::Seams;
use crate::mesh::TriMesh;
use crate::mesh::adjacency::weld;
use crate::mesh::edges::undirected;
use crate::mesh::features::{Curve, Features};

/// The curves in each group, with the seed of the corner: (seed, curve).
pub(super) fn tips(features: &Features, mesh: &TriMesh, seams: Option<&Arc<Seams>>) -> Vec<Vec<(u32, u32)>> {
    let rims = || (0u32..).zip(&features.curves).filter(|(_, curve)| curve.is_rim && !curve.closed);
    let mut of_edge: HashMap<[u32; 2], &Curve> = HashMap::new();
    for (_, curve) in rims() {
        of_edge.extend(curve.vertices.windows(2).map(|pair| (undirected([pair[0], pair[1]]), curve)));
    }
    if of_edge.is_empty() {
        return Vec::new();
    }
    let place = |v: u32| seams.and_then(|seams| seams.class(v)).unwrap_or(v);
    let places = |curve: &Curve| undirected(curve.ends().map(place));
    let class = weld(mesh);
    // The curves at each place by those of their ends.
    let mut wanted: BTreeMap<u32, BTreeSet<[u32; 2]>> = BTreeMap::new();
    for [a, b, c] in mesh.facets().iter().map(|t| t.map(|v| class[v as usize])) {
        for [before, corner, after] in [[a, b, c], [b, c, a], [c, a, b]] {
            let curve = |other: u32| of_edge.get(&undirected([corner, other]));
            if let (Some(one), Some(two)) = (curve(before), curve(after))
                && one.vertices != two.vertices
            {
                wanted.entry(place(corner)).or_default().extend([places(one), places(two)]);
            }
        }
    }
    let mut groups: BTreeMap<u32, Vec<(u32, u32)>> = BTreeMap::new();
    for (number, curve) in rims() {
        for end in curve.ends() {
            let is_wanted = wanted.get(&place(end)).is_some_and(|curves| curves.contains(&places(curve)));
            if let (true, Ok(seed)) = (is_wanted, features.corners.binary_search(&end)) {
                groups.entry(place(end)).or_default().push((seed as u32, number));
            }
        }
    }
    groups.into_values().collect()
}
