//! Flips towards equilateral facets in the metric.
//!
//! Purpose: passes over the edges, the largest gain first. An edge is flipped if the worse of its two facets gains.
//! Invariant: the module's above. Must not know: other passes.

use super::Adapting;
use crate::remesh::Result;
use crate::remesh::constants::*;
use crate::remesh::manifold::Flip;
use crate::tasks;

impl Adapting<'_> {
    /// Flips edges while that helps.
    pub(super) fn flip(&mut self) -> Result<()> {
        let mut changed: Vec<u32> = (0..self.mesh.facets().len() as u32).collect();
        for _ in 0..METRIC_FLIPPING_PASSES {
            let of =
                |k: usize| (0..3).filter_map(|side| self.better_flip(changed[k], side, &changed)).collect::<Vec<_>>();
            let mut proposals: Vec<(f64, Flip)> = tasks::flat_map(changed.len(), of);
            self.token.check()?;
            proposals.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.facets.cmp(&b.1.facets)));
            let mut touched = vec![false; self.sites.len()];
            let mut corners = Vec::new();
            for (_, flip) in proposals {
                let [[a, d, c], [_, b, _]] = flip.corners;
                let footprint = [a, b, c, d];
                if footprint.iter().any(|&v| touched[v as usize]) {
                    continue;
                }
                footprint.iter().for_each(|&v| touched[v as usize] = true);
                self.mesh.apply(&flip);
                corners.extend(footprint);
            }
            if corners.is_empty() {
                break;
            }
            changed = self.mesh.facets_around(&corners);
        }
        Ok(())
    }

    /// A flip of a side of `f` that makes the worse facet better, and by how much. Edges between two of the facets `all` once.
    fn better_flip(&self, f: u32, side: usize, all: &[u32]) -> Option<(f64, Flip)> {
        let flip = self.mesh.flip_any(f, side, METRIC_VALENCES)?;
        let other = flip.facets[1];
        if other < f && all.binary_search(&other).is_ok() || self.token.is_stopped() {
            return None;
        }
        let least = |pair: [[u32; 3]; 2]| self.quality(pair[0]).min(self.quality(pair[1]));
        let before = flip.facets.map(|f| self.mesh.facets()[f as usize]);
        let gain = least(flip.corners) - least(before);
        if gain < LEAST_FLIP_GAIN {
            return None;
        }
        let new = flip.corners.map(|t| self.mesh.places(t));
        self.face(&new, before.iter().map(|&t| self.mesh.places(t))).then_some((gain, flip))
    }
}
