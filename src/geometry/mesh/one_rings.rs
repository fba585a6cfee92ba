//! One-rings of a triangulation that changes in places.
//!
//! Purpose: [`OneRings`] has the facets around each vertex, as [`Csr::one_rings`], and follows edits.
//! Invariant: the facets of a vertex ascend. Must not know: why facets change.

use super::csr::Csr;

/// Marks a vertex with unchanged facets.
const UNCHANGED: u32 = u32::MAX;

/// See the module's head.
#[derive(Clone, Debug)]
pub(crate) struct OneRings {
    base: Csr<u32>,
    /// For each vertex the list of `changed` with its facets.
    list: Vec<u32>,
    changed: Vec<Vec<u32>>,
}

impl OneRings {
    /// The one-rings of all vertices.
    pub(crate) fn new(vertices: usize, facets: &[[u32; 3]]) -> Self {
        Self { list: vec![UNCHANGED; vertices], base: Csr::one_rings(vertices, facets), changed: Vec::new() }
    }

    /// Facets around vertex `v`, ascending.
    pub(crate) fn of(&self, v: u32) -> &[u32] {
        self.changed.get(self.list[v as usize] as usize).map_or_else(|| self.base.of(v), Vec::as_slice)
    }

    /// Facet `f` had the corners `old` and has the corners `new`.
    pub(crate) fn replace(&mut self, f: u32, old: [u32; 3], new: [u32; 3]) {
        for v in old {
            self.facets_mut(v).retain(|&g| g != f);
        }
        for v in new {
            let facets = self.facets_mut(v);
            let at = facets.partition_point(|&g| g < f);
            facets.insert(at, f);
        }
    }

    fn facets_mut(&mut self, v: u32) -> &mut Vec<u32> {
        let list = &mut self.list[v as usize];
        if *list == UNCHANGED {
            *list = self.changed.len() as u32;
            self.changed.push(self.base.of(v).to_vec());
        }
        &mut self.changed[*list as usize]
    }
}

/// Numbers in ascending order, each once.
pub(crate) fn ascending(numbers: impl IntoIterator<Item = u32>) -> Vec<u32> {
    let mut numbers: Vec<u32> = numbers.into_iter().collect();
    numbers.sort_unstable();
    numbers.dedup();
    numbers
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flip_changes_four_one_rings() {
        let mut rings = OneRings::new(4, &[[0, 1, 2], [1, 0, 3]]);
        rings.replace(0, [0, 1, 2], [0, 3, 2]);
        rings.replace(1, [1, 0, 3], [3, 1, 2]);
        assert_eq!([0, 1, 2, 3].map(|v| rings.of(v).to_vec()), [vec![0], vec![1], vec![0, 1], vec![0, 1]]);
    }
}
