//! A surface in the making.
//!
//! Purpose: [`Draft`] numbers vertices by their positions. Invariant: no two vertices are in one place, and no facet names one
//! twice. Must not know: what is made.

use std::collections::HashMap;

use glam::DVec3;

use crate::mesh::TriMesh;

#[derive(Default)]
pub(super) struct Draft {
    positions: Vec<DVec3>,
    facets: Vec<[u32; 3]>,
    /// Vertices by the bits of their positions.
    numbers: HashMap<[u64; 3], u32>,
}

impl Draft {
    /// The vertex in this place.
    pub(super) fn vertex(&mut self, position: DVec3) -> u32 {
        // Adding 0 makes 0 of -0.
        let position = position + DVec3::ZERO;
        *self.numbers.entry(position.to_array().map(f64::to_bits)).or_insert_with(|| {
            self.positions.push(position);
            self.positions.len() as u32 - 1
        })
    }

    /// A triangle, unless two of its corners are the same. Corners counter-clockwise from outside.
    pub(super) fn facet(&mut self, [a, b, c]: [u32; 3]) {
        if a != b && b != c && c != a {
            self.facets.push([a, b, c]);
        }
    }

    /// A convex polygon as a fan from its first corner. Corners counter-clockwise from outside.
    pub(super) fn fan(&mut self, corners: &[u32]) {
        (2..corners.len()).for_each(|k| self.facet([corners[0], corners[k - 1], corners[k]]));
    }

    pub(super) fn finish(self) -> TriMesh {
        TriMesh::assemble(self.positions, self.facets)
    }
}
