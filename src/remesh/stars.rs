//! The facets around each vertex of a triangulation that changes in places.
//!
//! Purpose: as [`Csr::one_rings`], and keeps up with facets that are replaced.
//! Invariant: facets of a vertex ascend. Must not know: why facets change.

use crate::mesh::csr::Csr;

/// A vertex whose facets are as they were.
const AS_BEFORE: u32 = u32::MAX;

/// See the module's head.
pub(super) struct Stars {
    base: Csr<u32>,
    /// By vertex, which of `changed` has its facets.
    place: Vec<u32>,
    changed: Vec<Vec<u32>>,
}

impl Stars {
    /// Of a triangulation as it is.
    pub(super) fn new(base: Csr<u32>) -> Self {
        Self { place: vec![AS_BEFORE; base.rows()], base, changed: Vec::new() }
    }

    /// Facets around vertex `v`, ascending.
    pub(super) fn of(&self, v: u32) -> &[u32] {
        self.changed.get(self.place[v as usize] as usize).map_or_else(|| self.base.of(v), Vec::as_slice)
    }

    /// Facet `f` had the corners `old` and has the corners `new`.
    pub(super) fn replace(&mut self, f: u32, old: [u32; 3], new: [u32; 3]) {
        for v in old {
            self.edit(v).retain(|&g| g != f);
        }
        for v in new {
            let list = self.edit(v);
            let at = list.partition_point(|&g| g < f);
            list.insert(at, f);
        }
    }

    fn edit(&mut self, v: u32) -> &mut Vec<u32> {
        let place = &mut self.place[v as usize];
        if *place == AS_BEFORE {
            *place = self.changed.len() as u32;
            self.changed.push(self.base.of(v).to_vec());
        }
        &mut self.changed[*place as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_turned_edge_changes_four_stars() {
        let mut stars = Stars::new(Csr::one_rings(4, &[[0, 1, 2], [1, 0, 3]]));
        stars.replace(0, [0, 1, 2], [0, 3, 2]);
        stars.replace(1, [1, 0, 3], [3, 1, 2]);
        assert_eq!([0, 1, 2, 3].map(|v| stars.of(v).to_vec()), [vec![0], vec![1], vec![0, 1], vec![0, 1]]);
    }
}
