//! The result as local improvement sees it.
//!
//! Purpose: [`Context`] is the triangulation, what may change of it, and the input to compare with; [`distance_at`] is the
//! distance from the input around one vertex, without a patch.
//! Invariant: nothing changes through it. Must not know: patches, what is improved.

use std::collections::HashSet;

use glam::DVec3;

use crate::remesh::distance::facet_set::{FacetSet, least_distance, sample_points};
use crate::remesh::distance::reference::Reference;
use crate::remesh::manifold::one_rings::EditedRings;
use crate::remesh::triangle::perimeter;
use crate::token::Token;

/// See the module's head.
pub(super) struct Context<'a> {
    pub(super) positions: &'a [DVec3],
    pub(super) facets: &'a [[u32; 3]],
    pub(super) rings: &'a EditedRings,
    pub(super) reference: &'a Reference<'a>,
    /// Vertices that may move.
    pub(super) movable: &'a [bool],
    pub(super) on_boundary: &'a [bool],
    /// Edges of curves, lower end first.
    pub(super) curves: &'a HashSet<[u32; 2]>,
    /// Where it is stopped, patches stay as they are and must not be used.
    pub(super) token: &'a Token,
}

impl Context<'_> {
    /// Inner vertices with less than 5 or more than 7 neighbours.
    pub(super) fn irregular(&self) -> impl Iterator<Item = u32> + '_ {
        let inner = (0..self.positions.len() as u32).filter(|&v| !self.on_boundary[v as usize]);
        inner.filter(|&v| !(5..=7).contains(&self.rings.of(v).len()))
    }
}

/// How far the result is from the input in and around the cell of vertex `v`, and the mean edge there. The distance is that of
/// [`super::patch::Patch::distance`] at its centre, without the cost of a patch.
pub(super) fn distance_at(context: &Context<'_>, v: u32) -> (f64, f64) {
    let reference = context.reference;
    let corners = |f: u32| context.facets[f as usize].map(|u| context.positions[u as usize]);
    let own_facets = context.rings.of(v);
    let mut ring: Vec<u32> = own_facets.iter().flat_map(|&f| context.facets[f as usize]).collect();
    ring.sort_unstable();
    ring.dedup();
    let mut wider: Vec<u32> = ring.iter().flat_map(|&u| context.rings.of(u)).copied().collect();
    wider.sort_unstable();
    wider.dedup();
    let wider: Vec<[DVec3; 3]> = wider.into_iter().map(corners).collect();
    let mut input: Vec<u32> = ring.iter().flat_map(|&u| reference.facets(u)).copied().collect();
    input.sort_unstable();
    input.dedup();
    let midpoints = reference.facets(v).iter().flat_map(|&f| edge_midpoints(reference.corners(f)));
    let here = context.positions[v as usize];
    let is_own = |p: &DVec3| {
        let own = here.distance(*p);
        ring.iter().all(|&u| u == v || context.positions[u as usize].distance(*p) > own)
    };
    let (mut farthest, mut hint) = (0.0f64, 0);
    for p in reference.vertices(v).iter().copied().chain(midpoints.filter(is_own)) {
        // Less than the farthest so far need not be known exactly.
        farthest = farthest.max(least_distance(p, &wider, f64::INFINITY, farthest, &mut hint));
    }
    let input = FacetSet::new(input.into_iter().map(|f| reference.corners(f)));
    let (groups, mut edge, mut hint) = (input.all_groups(), 0.0, 0);
    for &f in own_facets {
        edge += perimeter(corners(f)) / (3 * own_facets.len()) as f64;
        sample_points(corners(f))
            .for_each(|p| farthest = farthest.max(input.distance(p, &groups, &mut hint, farthest)));
    }
    (farthest.sqrt(), edge)
}

fn edge_midpoints([a, b, c]: [DVec3; 3]) -> [DVec3; 3] {
    [(a + b) / 2.0, (b + c) / 2.0, (c + a) / 2.0]
}
