//! The result while patches of it change.
//!
//! Purpose: [`MeshEditor`] hands out the result for patches to be made of, and puts changed patches back. It makes
//! independent patches at the same time ([`MeshEditor::change_each`]).
//! Invariant: the result is that of changing one patch after the other, whatever the number of threads.
//! Must not know: what makes a patch better.

use std::collections::{HashMap, HashSet};

use glam::DVec3;
use rayon::prelude::*;

use super::angles::Mobility;
use super::context::Context;
use super::patch::Patch;
use crate::mesh::csr::Csr;
use crate::mesh::edges::undirected;
use crate::remesh::distance::reference::Reference;
use crate::remesh::manifold::one_rings::EditedRings;
use crate::token::Token;

/// Patches that are made at the same time, at most.
const PATCHES_AT_ONCE: usize = 64;
/// Waiting vertices among which independent ones are sought.
const LOOK_AHEAD: usize = 128;

/// See the module's head.
pub(in crate::remesh) struct MeshEditor<'a> {
    positions: &'a mut [DVec3],
    facets: &'a mut [[u32; 3]],
    rings: EditedRings,
    reference: &'a Reference<'a>,
    movable: Vec<bool>,
    on_boundary: Vec<bool>,
    /// Edges that stay, lower end first.
    curves: HashSet<[u32; 2]>,
    /// Patches that were put back so far.
    edits: u32,
    /// By vertex, the number of the last edit that had it; 0 if none had.
    last_edit: Vec<u32>,
    token: &'a Token,
}

/// Vertices around which nothing better was found, with the number of edits by then.
#[derive(Default)]
pub(in crate::remesh) struct Exhausted(HashMap<u32, u32>);

impl<'a> MeshEditor<'a> {
    /// Edges in `curves` (lower end first) stay.
    pub(in crate::remesh) fn new(
        positions: &'a mut [DVec3],
        facets: &'a mut [[u32; 3]],
        mobility: &[Mobility],
        (curves, reference): (HashSet<[u32; 2]>, &'a Reference<'a>),
        token: &'a Token,
    ) -> Self {
        let rings = Csr::one_rings(positions.len(), facets);
        let on_boundary = boundary_vertices(facets, &rings, positions.len());
        let is_movable = |(mobility, boundary): (&Mobility, &bool)| *mobility == Mobility::Free && !boundary;
        let movable = mobility.iter().zip(&on_boundary).map(is_movable).collect();
        let (rings, last_edit) = (EditedRings::new(rings), vec![0; positions.len()]);
        Self { positions, facets, rings, reference, movable, on_boundary, curves, edits: 0, last_edit, token }
    }

    pub(super) fn context(&self) -> Context<'_> {
        let Self { positions, facets, rings, reference, movable, on_boundary, curves, token, .. } = self;
        Context { positions, facets, rings, reference, movable, on_boundary, curves, token }
    }

    pub(super) fn is_stopped(&self) -> bool {
        self.token.is_stopped()
    }

    pub(super) fn put_back(&mut self, patch: &Patch) {
        patch.apply(self.positions, self.facets, &mut self.rings);
        self.edits += 1;
        patch.vertices.iter().for_each(|&v| self.last_edit[v as usize] = self.edits);
    }

    /// From now on an edge stays.
    pub(super) fn keep(&mut self, ends: [u32; 2]) {
        self.curves.insert(undirected(ends));
    }

    /// Nothing better was found around `v`.
    pub(super) fn give_up(&self, v: u32, exhausted: &mut Exhausted) {
        exhausted.0.insert(v, self.edits);
    }

    /// Puts back what `better` makes of the patch around each of `vertices`, one after the other. Independent patches are made at
    /// the same time; a vertex that depends on one before it waits. A vertex without a better patch is `exhausted`, and not
    /// tried again before something around it changes. Returns how many patches were put back.
    pub(super) fn change_each(
        &mut self,
        vertices: &[u32],
        exhausted: &mut Exhausted,
        better: impl Fn(&Context<'_>, u32) -> Option<Patch> + Sync,
    ) -> usize {
        let mut done = 0;
        let mut waiting = vertices.to_vec();
        while !waiting.is_empty() && !self.token.is_stopped() {
            let next = self.take_independent(&mut waiting, exhausted);
            let context = self.context();
            let made: Vec<Option<Patch>> = next.par_iter().with_max_len(1).map(|&v| better(&context, v)).collect();
            for (v, patch) in next.into_iter().zip(made) {
                if let Some(patch) = patch {
                    self.put_back(&patch);
                    done += 1;
                } else {
                    self.give_up(v, exhausted);
                }
            }
        }
        done
    }

    /// Takes out the first vertices whose patches depend on nothing that those before them could change. Drops exhausted ones.
    fn take_independent(&self, waiting: &mut Vec<u32>, exhausted: &Exhausted) -> Vec<u32> {
        let context = self.context();
        let (mut claimed, mut next, mut looked_at) = (HashSet::new(), Vec::new(), 0);
        waiting.retain(|&v| {
            if looked_at == LOOK_AHEAD || next.len() == PATCHES_AT_ONCE {
                return true;
            }
            looked_at += 1;
            let needed = dependencies(&context, v);
            if exhausted.0.get(&v).is_some_and(|&then| !self.is_changed(&needed, then)) {
                return false;
            }
            let is_independent = needed.iter().all(|u| !claimed.contains(u));
            claimed.extend(needed);
            if is_independent {
                next.push(v);
            }
            !is_independent
        });
        next
    }

    /// Whether any of some vertices was in a patch that was put back after so many edits.
    fn is_changed(&self, vertices: &[u32], edits: u32) -> bool {
        vertices.iter().any(|&v| self.last_edit[v as usize] > edits)
    }

    /// Whether nothing better was found around a vertex, and nothing there has changed since.
    pub(super) fn is_exhausted(&self, v: u32, exhausted: &Exhausted) -> bool {
        exhausted.0.get(&v).is_some_and(|&then| !self.is_changed(&dependencies(&self.context(), v), then))
    }
}

/// Vertices that the patch around one depends on: its own, and the corners of all facets around these.
fn dependencies(context: &Context<'_>, centre: u32) -> Vec<u32> {
    let ring = |vertices: &[u32]| {
        let facets = vertices.iter().flat_map(|&v| context.rings.of(v));
        let mut ring: Vec<u32> = facets.flat_map(|&f| context.facets[f as usize]).collect();
        ring.sort_unstable();
        ring.dedup();
        ring
    };
    ring(&ring(&ring(&[centre])))
}

/// Whether each vertex is on an edge with one facet.
fn boundary_vertices(facets: &[[u32; 3]], rings: &Csr<u32>, vertices: usize) -> Vec<bool> {
    let mut boundary = vec![false; vertices];
    for t in facets {
        for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
            let runs_back = |f: &u32| {
                let t = facets[*f as usize];
                (0..3).any(|k| t[k] == b && t[(k + 1) % 3] == a)
            };
            // The smaller of the two one-rings: one of them may be very large.
            let end = if rings.of(a).len() <= rings.of(b).len() { a } else { b };
            if !rings.of(end).iter().any(runs_back) {
                boundary[a as usize] = true;
                boundary[b as usize] = true;
            }
        }
    }
    boundary
}
