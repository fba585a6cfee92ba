//! Collapses of edges that are too short.
//!
//! Purpose: one pass over the edges, the shortest first. Of its two ends, the one goes whose edges fit better afterwards.
//! Invariant: the module's above; no edge becomes too long. Must not know: other passes.

use super::{Adapting, Mobility};
use crate::remesh::Result;
use crate::remesh::constants::*;
use crate::tasks;

struct Proposal {
    length: f64,
    from: u32,
    to: u32,
}

impl Adapting<'_> {
    /// Collapses short edges. Returns how many.
    pub(super) fn collapse(&mut self) -> Result<usize> {
        let propose = |&edge: &[u32; 2]| {
            let length = self.length(edge);
            if length >= COLLAPSE_LENGTH || self.token.is_stopped() {
                return None;
            }
            let ways = [edge, [edge[1], edge[0]]].map(|[from, to]| (self.longest_after(from, to), from, to));
            let best = ways.into_iter().min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)))?;
            (best.0 <= LONGEST_NEW && self.keeps_shape(best.1, best.2)).then_some(Proposal {
                length,
                from: best.1,
                to: best.2,
            })
        };
        let edges = self.mesh.edges();
        let mut proposals: Vec<Proposal> = tasks::flat_map(edges.len(), |k| propose(&edges[k]));
        self.token.check()?;
        proposals.sort_by(|a, b| a.length.total_cmp(&b.length).then((a.from, a.to).cmp(&(b.from, b.to))));
        let mut touched = vec![false; self.sites.len()];
        let mut count = 0;
        for Proposal { from, to, .. } in proposals {
            let footprint = self.mesh.neighbours(from);
            if footprint.iter().any(|&v| touched[v as usize]) {
                continue;
            }
            footprint.iter().for_each(|&v| touched[v as usize] = true);
            self.rails.collapse(&self.mesh, from, to);
            self.mesh.collapse(from, to);
            count += 1;
        }
        if count > 0 {
            self.compact();
        }
        Ok(count)
    }

    /// The longest edge at `to` that a collapse makes; infinite where it is not allowed.
    fn longest_after(&self, from: u32, to: u32) -> f64 {
        let may_go = match self.mobility[from as usize] {
            Mobility::Fixed => false,
            Mobility::Along => self.rails.middle([from, to]).is_some(),
            Mobility::Free => true,
        };
        if !may_go || !self.mesh.may_collapse(from, to) {
            return f64::INFINITY;
        }
        let others = self.mesh.neighbours(from).into_iter().filter(|&u| u != from && u != to);
        others.map(|u| self.length([u, to])).fold(0.0, f64::max)
    }

    /// Whether the facets around keep a shape, and face as the input does.
    fn keeps_shape(&self, from: u32, to: u32) -> bool {
        let new = self.mesh.collapse_corners(from, to);
        let least = |t: [u32; 3], least: f64| self.quality(t).min(least);
        let now = new.iter().fold(f64::INFINITY, |all, &(_, t)| least(t, all));
        let before = new.iter().fold(f64::INFINITY, |all, &(f, _)| least(self.mesh.facets()[f as usize], all));
        if now < POOR_QUALITY && now < before {
            return false;
        }
        let corners: Vec<_> = new.iter().map(|&(_, t)| self.mesh.places(t)).collect();
        self.face(&corners, self.mesh.ring(from).iter().map(|&f| self.mesh.corners(f)))
    }
}
