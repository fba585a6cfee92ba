//! The order in which facets are taken.
//!
//! Purpose: facets beside one another are taken one after the other, whatever order the mesh has them in, so that a
//! task meets few cells, and what it reads of vertices and seeds is at hand.
//! Invariant: every facet with area, once; the order depends on the surface alone.
//! Must not know: tasks, lists.

use rayon::prelude::*;

use crate::mesh::curve;
use crate::rvd::Surface;
use crate::rvd::incident::Diagram;

/// Facets that are looked at together at least.
const CHUNK: usize = 4096;

/// Facets, and a seed near each.
#[derive(Default)]
pub(super) struct Order {
    /// All facets with area along a curve that fills space, by their centroids.
    pub facets: Vec<u32>,
    /// Of each facet, and how many seeds there were when they were found.
    starts: Vec<u32>,
    seeds: usize,
}

impl Order {
    /// Puts the facets in order, if they are not.
    pub(super) fn begin(&mut self, surface: &Surface) {
        if !self.facets.is_empty() {
            return;
        }
        let all = (0..surface.facets().len() as u32).into_par_iter().with_min_len(CHUNK);
        let with_area = all.filter(|&f| !surface.skips(f as usize));
        let mut places: Vec<(u64, u32)> = with_area.map(|f| (curve::along(surface.centroid(f)), f)).collect();
        places.par_sort_unstable();
        places.into_par_iter().with_min_len(CHUNK).map(|(_, facet)| facet).collect_into_vec(&mut self.facets);
    }

    /// The facets, and a guess for each: the last answer, or else a seed not far away. With `better` the caller puts
    /// nearer seeds in their place.
    pub(super) fn guesses(&mut self, diagram: Diagram<'_>, better: bool) -> (&[u32], &mut [u32]) {
        if self.starts.is_empty() || self.seeds > diagram.seeds.len() {
            let near = |&facet: &u32| diagram.index.near(diagram.surface.centroid(facet));
            self.facets.par_iter().with_min_len(CHUNK).map(near).collect_into_vec(&mut self.starts);
            self.seeds = diagram.seeds.len();
        }
        if better {
            self.seeds = diagram.seeds.len();
        }
        (&self.facets, &mut self.starts)
    }
}
