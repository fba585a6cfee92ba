//! Local improvement of a result.
//!
//! Purpose: one set of operators ([`LocalMesh`]), one search for a better place of a vertex ([`places_around`], [`cheapest`],
//! [`Steps`]) and one objective ([`objective`]) for all of it. [`shapes`] improves the worst triangles of the whole result, where
//! distances need not be measured, and keeps edges near their curves; [`places`] improves what is left, in a [`Queue`]:
//! irregular vertices, and places far from the input. Each of these is a [`patch`] on which several ways are tried ([`trial`]).
//! [`flat`] puts vertices that a crease beside them draws off a flat face back into it.
//! [`MeshEditor`] hands out the result for patches to be made of and puts changed patches back. It knows which patches are
//! independent, and where nothing has changed since it was last tried.
//! Invariant: a manifold stays one, no facet turns over, edges of curves stay. Independent patches may be made at the same time:
//! the result is that of making one after the other. The same bits whatever the number of threads.
//! Must not know: seeds, diagrams, files.

pub(super) mod exchange;
pub(super) mod flat;
mod objective;
mod patch;
pub(super) mod places;
pub(super) mod shapes;
mod trial;

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashSet};

use glam::DVec3;

use super::constants::{DIRECTIONS, MAX_HALVINGS, NORMAL_STEP};
use super::distance::Reference;
use super::manifold::LocalMesh;
use super::triangle::{Shapes, perimeter};
use crate::mesh::csr::ascending;
use crate::mesh::facet_set::{FacetSet, least_distance, sample_points};
use crate::token::Token;
use patch::Patch;
use shapes::Mobility;

#[derive(Clone, Copy)]
pub(super) struct Context<'a> {
    pub(super) mesh: &'a LocalMesh,
    pub(super) reference: &'a Reference<'a>,
    /// Vertices that may move.
    pub(super) movable: &'a [bool],
    pub(super) shapes: Shapes,
    /// Where it is stopped, patches stay as they are and must not be used.
    pub(super) token: &'a Token,
}

/// How far the result is from the input in and around the cell of vertex `v`, and the mean edge there. The distance is that of
/// [`patch::Patch::distance`] at its centre, without the cost of a patch.
pub(super) fn distance_at(context: &Context<'_>, v: u32) -> (f64, f64) {
    let Context { mesh, reference, .. } = *context;
    let (own_facets, ring) = (mesh.ring(v), mesh.neighbours(v));
    let wider: Vec<[DVec3; 3]> = mesh.facets_around(&ring).into_iter().map(|f| mesh.corners(f)).collect();
    let input = ascending(ring.iter().flat_map(|&u| reference.facets.of(u)).copied());
    let midpoints = reference.facets.of(v).iter().flat_map(|&f| edge_midpoints(reference.corners(f)));
    let here = mesh.positions[v as usize];
    let is_own = |p: &DVec3| {
        let own = here.distance(*p);
        ring.iter().all(|&u| u == v || mesh.positions[u as usize].distance(*p) > own)
    };
    let (mut farthest, mut hint) = (0.0f64, 0);
    for p in reference.vertices.of(v).iter().copied().chain(midpoints.filter(is_own)) {
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

/// Places one step away: in the plane of `x` and `y`, then to either side of it.
pub(super) fn places_around(here: DVec3, step: f64, [x, y]: [DVec3; 2]) -> impl Iterator<Item = DVec3> {
    let in_plane = (0..DIRECTIONS).map(move |k| {
        let (sin, cos) = (k as f64 / DIRECTIONS as f64 * std::f64::consts::TAU).sin_cos();
        cos * x + sin * y
    });
    let up = NORMAL_STEP * x.cross(y);
    in_plane.chain([up, -up]).map(move |way| here + step * way)
}

/// The first of the cheapest places, with its cost; that which is given if none costs less by `gain`. `cost` may answer any
/// number that is not less than its second argument if the cost is not less.
pub(super) fn cheapest(
    given: (f64, DVec3),
    gain: f64,
    places: impl Iterator<Item = DVec3>,
    mut cost: impl FnMut(DVec3, f64) -> f64,
) -> (f64, DVec3) {
    places.fold(given, |best, p| {
        let most = best.0 - gain;
        let cost = cost(p, most);
        if cost < most { (cost, p) } else { best }
    })
}

/// How often the step of each vertex was halved.
#[derive(Clone)]
pub(super) struct Steps(Vec<u8>);

impl Steps {
    pub(super) fn new(vertices: usize) -> Self {
        Self(vec![0; vertices])
    }

    /// The share of the first step that a vertex tries next; `None` if it has tried all.
    pub(super) fn next(&self, v: u32) -> Option<f64> {
        let halvings = self.0[v as usize];
        (halvings < MAX_HALVINGS).then(|| 0.5f64.powi(halvings.into()))
    }

    pub(super) fn halve(&mut self, v: u32) {
        self.0[v as usize] += 1;
    }

    /// Something around a vertex has changed: it tries its last step again.
    pub(super) fn renew(&mut self, v: u32) {
        self.0[v as usize] = self.0[v as usize].min(MAX_HALVINGS - 1);
    }
}

/// A vertex, and how bad it is. Vertices of a higher kind come first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct Place<K> {
    pub(super) kind: K,
    /// Numbers from zero on have the order of their bits.
    bits: u64,
    vertex: Reverse<u32>,
}

pub(super) type Queue<K> = BinaryHeap<Place<K>>;

impl<K> Place<K> {
    /// `badness` is not negative.
    pub(super) fn new(kind: K, vertex: u32, badness: f64) -> Self {
        Self { kind, bits: badness.max(0.0).to_bits(), vertex: Reverse(vertex) }
    }

    pub(super) fn vertex(&self) -> u32 {
        self.vertex.0
    }

    pub(super) fn badness(&self) -> f64 {
        f64::from_bits(self.bits)
    }
}

pub(crate) struct MeshEditor<'a> {
    mesh: &'a mut LocalMesh,
    reference: &'a Reference<'a>,
    movable: Vec<bool>,
    shapes: Shapes,
    /// Patches that were put back so far.
    pub(super) edits: u32,
    /// By vertex, the number of the last edit that had it; 0 if none had.
    last_edit: Vec<u32>,
    token: &'a Token,
}

impl<'a> MeshEditor<'a> {
    pub(crate) fn new(
        mesh: &'a mut LocalMesh,
        mobility: &[Mobility],
        shapes: Shapes,
        reference: &'a Reference<'a>,
        token: &'a Token,
    ) -> Self {
        let is_movable = |(m, v): (&Mobility, u32)| *m == Mobility::Free && !mesh.is_on_boundary(v);
        let movable = mobility.iter().zip(0..).map(is_movable).collect();
        let last_edit = vec![0; mesh.positions.len()];
        Self { mesh, reference, movable, shapes, edits: 0, last_edit, token }
    }

    pub(super) fn context(&self) -> Context<'_> {
        let Self { reference, movable, shapes, token, .. } = self;
        Context { mesh: self.mesh, reference, movable, shapes: *shapes, token }
    }

    fn put_back(&mut self, patch: &Patch) {
        self.mesh.put_back(&patch.mesh, &patch.facet_ids, &patch.vertices);
        self.edits += 1;
        patch.vertices.iter().for_each(|&v| self.last_edit[v as usize] = self.edits);
    }

    /// Whether anything that the patch around `v` depends on has changed since this number of edits.
    pub(super) fn has_changed(&self, v: u32, edits: u32) -> bool {
        self.dependencies(v).into_iter().any(|u| self.last_edit[u as usize] > edits)
    }

    /// Whether the patch around `v` depends on nothing that the patches of those `claimed` could change. Claims it.
    pub(super) fn claim(&self, v: u32, claimed: &mut HashSet<u32>) -> bool {
        let needed = self.dependencies(v);
        let is_independent = needed.iter().all(|u| !claimed.contains(u));
        claimed.extend(needed);
        is_independent
    }

    /// Vertices that the patch around one depends on: its own, and the corners of all facets around these.
    fn dependencies(&self, centre: u32) -> Vec<u32> {
        let near = self.mesh.neighbours(centre);
        self.mesh.corners_around(&self.mesh.corners_around(&near))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ever_shorter_steps_find_the_least_cost() {
        let goal = DVec3::new(0.3, -0.2, 0.1);
        let cost = |p: DVec3, _: f64| p.distance(goal);
        let (mut steps, mut here) = (Steps::new(1), DVec3::ZERO);
        while let Some(share) = steps.next(0) {
            let places = places_around(here, 0.2 * share, [DVec3::X, DVec3::Y]);
            let (_, best) = cheapest((cost(here, 0.0), here), 1e-4, places, cost);
            if best == here {
                steps.halve(0);
            }
            here = best;
        }
        assert!(here.distance(goal) < 0.03, "{here}");
        steps.renew(0);
        assert_eq!(steps.next(0), Some(0.125));
    }
}
