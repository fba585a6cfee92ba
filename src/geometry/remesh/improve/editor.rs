//! The result while patches of it change.
//!
//! Purpose: [`MeshEditor`] hands out the result for patches to be made of, and puts changed patches back. It knows which patches
//! are independent, and where nothing has changed since it was last tried.
//! Invariant: independent patches may be made at the same time: the result is that of making one after the other.
//! Must not know: what makes a patch better.

use std::collections::HashSet;

use super::context::Context;
use super::patch::Patch;
use super::shapes::Mobility;
use crate::remesh::distance::reference::Reference;
use crate::remesh::manifold::local_mesh::LocalMesh;
use crate::token::Token;

pub(crate) struct MeshEditor<'a> {
    mesh: &'a mut LocalMesh,
    reference: &'a Reference<'a>,
    movable: Vec<bool>,
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
        reference: &'a Reference<'a>,
        token: &'a Token,
    ) -> Self {
        let is_movable = |(m, v): (&Mobility, u32)| *m == Mobility::Free && !mesh.is_on_boundary(v);
        let movable = mobility.iter().zip(0..).map(is_movable).collect();
        let last_edit = vec![0; mesh.positions.len()];
        Self { mesh, reference, movable, edits: 0, last_edit, token }
    }

    pub(super) fn context(&self) -> Context<'_> {
        Context { mesh: self.mesh, reference: self.reference, movable: &self.movable, token: self.token }
    }

    pub(super) fn put_back(&mut self, patch: &Patch) {
        self.mesh.put_back(&patch.mesh, &patch.facet_ids, &patch.vertices);
        self.edits += 1;
        patch.vertices.iter().for_each(|&v| self.last_edit[v as usize] = self.edits);
    }

    /// From now on an edge stays.
    pub(super) fn keep(&mut self, ends: [u32; 2]) {
        self.mesh.keep(ends);
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
