//! The input as the result's vertices see it.
//!
//! Purpose: for each vertex of a result the input's facets that its cell meets and the input's vertices in it, so
//! that distances between the two surfaces can be had in one place without a search over all of either.
//! Invariant: depends on the diagram alone. Must not know: how the result is changed.

use glam::DVec3;

use super::tips::Tip;
use crate::rvd::Surface;

/// See the module's head.
pub(super) struct Ground<'a> {
    surface: &'a Surface,
    facets: Lists<u32>,
    tips: Lists<DVec3>,
}

impl<'a> Ground<'a> {
    /// `cells`: result vertex and input facet that meet; `tips`: the input's vertices.
    pub(super) fn new(surface: &'a Surface, vertices: usize, cells: &[(u32, u32)], tips: &[Tip]) -> Self {
        let tips: Vec<(u32, DVec3)> = tips.iter().map(|t| (t.vertex, t.position)).collect();
        Self { surface, facets: Lists::new(vertices, cells, 0), tips: Lists::new(vertices, &tips, DVec3::ZERO) }
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

/// A list for each vertex, in flat arrays.
struct Lists<T> {
    first: Vec<u32>,
    items: Vec<T>,
}

impl<T: Copy> Lists<T> {
    fn new(vertices: usize, pairs: &[(u32, T)], filler: T) -> Self {
        let mut first = vec![0u32; vertices + 1];
        pairs.iter().for_each(|p| first[p.0 as usize + 1] += 1);
        (0..vertices).for_each(|v| first[v + 1] += first[v]);
        let mut next = first.clone();
        let mut items = vec![filler; pairs.len()];
        for &(v, item) in pairs {
            items[next[v as usize] as usize] = item;
            next[v as usize] += 1;
        }
        Self { first, items }
    }

    fn of(&self, v: u32) -> &[T] {
        &self.items[self.first[v as usize] as usize..self.first[v as usize + 1] as usize]
    }
}
