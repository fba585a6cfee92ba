//! The input as the result's vertices see it.
//!
//! Purpose: for each vertex of a result the input's facets that its cell meets and the input's vertices in it, so
//! that distances between the two surfaces can be had in one place without a search over all of either.
//! Invariant: depends on the diagram alone. Must not know: how the result is changed.

use glam::DVec3;

use super::tips::Tip;
use crate::mesh::csr::Csr;
use crate::rvd::Surface;

/// See the module's head.
pub(super) struct Ground<'a> {
    surface: &'a Surface,
    facets: Csr<u32>,
    tips: Csr<DVec3>,
}

impl<'a> Ground<'a> {
    /// `cells`: result vertex and input facet that meet; `tips`: the input's vertices.
    pub(super) fn new(surface: &'a Surface, vertices: usize, cells: &[(u32, u32)], tips: &[Tip]) -> Self {
        let tips: Vec<(u32, DVec3)> = tips.iter().map(|t| (t.vertex, t.position)).collect();
        Self { surface, facets: Csr::from_pairs(vertices, cells), tips: Csr::from_pairs(vertices, &tips) }
    }

    /// Input facets that the cell of result vertex `v` meets.
    pub(super) fn facets(&self, v: u32) -> &[u32] {
        self.facets.of(v)
    }

    /// Input vertices in the cell of result vertex `v`, unit frame.
    pub(super) fn tips(&self, v: u32) -> &[DVec3] {
        self.tips.of(v)
    }

    /// Corners of an input facet, unit frame.
    pub(super) fn corners(&self, facet: u32) -> [DVec3; 3] {
        self.surface.facets()[facet as usize].map(|v| self.surface.positions()[v as usize])
    }
}
