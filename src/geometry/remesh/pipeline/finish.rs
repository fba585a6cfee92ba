//! The result of the best draft.
//!
//! Purpose: [`Extraction::finish`] recovers lost edges of curves, improves the places that need it, and gives the result in the
//! caller's coordinates.
//! Invariant: no place of the input ends up farther away than before; vertices that are fixed stay.
//! Must not know: seeds' steps, how a draft is made.

use super::extract::{Draft, Extraction, Fitted, mobility};
use crate::mesh::TriMesh;
use crate::remesh::RemeshError;
use crate::remesh::distance::hausdorff::{HausdorffEstimate, missed_places};
use crate::remesh::improve::editor::MeshEditor;
use crate::remesh::improve::places::{improve, recover_edge};
use crate::remesh::manifold::local_mesh::LocalMesh;
use crate::remesh::report::RepairFigures;

pub(super) struct Built {
    pub(super) mesh: TriMesh,
    pub(super) vertex_seed: Vec<u32>,
    /// For each segment of the curves the result's edge, if it is there.
    pub(super) curve_edges: Vec<Option<[u32; 2]>>,
    pub(super) repair: RepairFigures,
    /// Places of the input that it is still far from.
    pub(super) missed: usize,
}

impl<'a> Extraction<'a> {
    /// The draft improved locally, in the caller's coordinates.
    pub(super) fn finish(&self, mut draft: Draft<'a>) -> Result<Built, RemeshError> {
        let mut missed = 0;
        if let Some(mut fitted) = draft.fitted.take() {
            missed = self.improve(&mut draft, &mut fitted);
            self.token.check()?;
            let frame = self.surface.frame();
            let (positions, facets) = fitted.mesh.into_parts();
            draft.facets = facets;
            let moved = draft.positions.iter_mut().zip(positions).zip(&fitted.target.fixed);
            moved.filter(|(_, fixed)| !**fixed).for_each(|((p, u), _)| *p = frame.to_world(u));
        }
        let Draft { positions, facets, vertex_seed, curve_edges, repair, seeds, .. } = draft;
        // Only one thing can be wrong with it: seeds on a line leave no facet with an area.
        let mesh = TriMesh::new(positions, facets).map_err(|_| RemeshError::too_few(seeds))?;
        Ok(Built { mesh, vertex_seed, curve_edges, repair, missed })
    }

    /// Recovers edges of curves and improves the places that need it. Returns how many places are still far.
    fn improve(&self, draft: &mut Draft<'a>, fitted: &mut Fitted<'a>) -> usize {
        let absent = self.curves.missing(&draft.curve_edges, &draft.vertex_seed, |_| true);
        if !absent.is_empty() {
            let mobility = mobility(&fitted.mesh.positions, &draft.curve_edges, &fitted.target.fixed);
            let mut editor = MeshEditor::new(&mut fitted.mesh, &mobility, &fitted.reference, self.token);
            let recover = |&ends: &[u32; 2]| !self.token.is_stopped() && recover_edge(&mut editor, ends);
            if absent.into_iter().filter(recover).count() > 0 {
                self.find_curves(draft, &mut fitted.mesh);
                self.improve_shapes(&mut fitted.mesh, draft, &fitted.target.fixed, &fitted.envelope, false);
                let input = &fitted.target.input;
                let estimate = HausdorffEstimate::of(&fitted.mesh, input, self.tolerance, self.token);
                fitted.distances = estimate.by_vertex;
            }
        }
        let Fitted { mesh, target, reference, distances, .. } = fitted;
        let mobility = mobility(&mesh.positions, &draft.curve_edges, &target.fixed);
        let improved = improve(&mut MeshEditor::new(mesh, &mobility, reference, self.token), distances);
        let before = draft.missed.places.len();
        if improved == 0 && before == 0 {
            return 0;
        }
        self.find_curves(draft, mesh);
        // Improvement takes nothing farther away, but a place's nearest facet may have left the one-ring that is searched.
        missed_places(mesh, &target.input, self.tolerance, self.token).len().min(before)
    }

    /// Finds the edges of curves again, in the order of the facets. They stay from now on.
    fn find_curves(&self, draft: &mut Draft<'_>, mesh: &mut LocalMesh) {
        draft.curve_edges = self.curves.edges_in(mesh.facets(), &draft.vertex_seed);
        draft.curve_edges.iter().flatten().for_each(|&edge| mesh.keep(edge));
    }
}
