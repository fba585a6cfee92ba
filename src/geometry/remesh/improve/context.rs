//! The result as local improvement sees it.
//!
//! Purpose: [`Context`] is the triangulation, what may change of it, and the input to compare with; [`distance_at`] is the
//! distance from the input around one vertex, without a patch.
//! Invariant: nothing changes through it. Must not know: patches, what is improved.

use glam::DVec3;

use crate::mesh::csr::ascending;
use crate::mesh::facet_set::{FacetSet, least_distance, sample_points};
use crate::remesh::distance::reference::Reference;
use crate::remesh::manifold::local_mesh::LocalMesh;
use crate::remesh::triangle::perimeter;
use crate::token::Token;

#[derive(Clone, Copy)]
pub(super) struct Context<'a> {
    pub(super) mesh: &'a LocalMesh,
    pub(super) reference: &'a Reference<'a>,
    /// Vertices that may move.
    pub(super) movable: &'a [bool],
    /// Where it is stopped, patches stay as they are and must not be used.
    pub(super) token: &'a Token,
}

/// How far the result is from the input in and around the cell of vertex `v`, and the mean edge there. The distance is that of
/// [`super::patch::Patch::distance`] at its centre, without the cost of a patch.
pub(super) fn distance_at(context: &Context<'_>, v: u32) -> (f64, f64) {
    let Context { mesh, reference, .. } = *context;
    let (own_facets, ring) = (mesh.ring(v), mesh.neighbours(v));
    let wider: Vec<[DVec3; 3]> = mesh.facets_around(&ring).into_iter().map(|f| mesh.corners(f)).collect();
    let input = ascending(ring.iter().flat_map(|&u| reference.facets(u)).copied());
    let midpoints = reference.facets(v).iter().flat_map(|&f| edge_midpoints(reference.corners(f)));
    let here = mesh.positions[v as usize];
    let is_own = |p: &DVec3| {
        let own = here.distance(*p);
        ring.iter().all(|&u| u == v || mesh.positions[u as usize].distance(*p) > own)
    };
    let (mut farthest, mut hint) = (0.0f64, 0);
    for p in reference.vertices(v).iter().copied().chain(midpoints.filter(is_own)) {
        // Less than the farthest so far need not be known exactly.
        farthest = farthest.max(least_distance(p, &wider, f64::INFINITY, farthest, &mut hint));
    }
    let input = FacetSet::new(input.into_iter().map(|f| reference.corners(f)));
    let (groups, mut edge, mut hint) = (input.all_groups(), 0.0, 0);
    for &f in own_facets {
        edge += perimeter(mesh.corners(f)) / (3 * own_facets.len()) as f64;
        sample_points(mesh.corners(f))
            .for_each(|p| farthest = farthest.max(input.distance(p, &groups, &mut hint, farthest)));
    }
    (farthest.sqrt(), edge)
}

fn edge_midpoints([a, b, c]: [DVec3; 3]) -> [DVec3; 3] {
    [(a + b) / 2.0, (b + c) / 2.0, (c + a) / 2.0]
}
