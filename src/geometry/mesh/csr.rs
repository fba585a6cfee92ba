//! Compressed sparse rows (CSR).
//!
//! Purpose: [`Csr`] holds a list for each row in two flat arrays. The row is a vertex in most uses: the facets of its one-ring
//! ([`Csr::one_rings`]), samples that belong to it ([`Csr::group`]). [`OneRings`] follows edits of a triangulation.
//! Invariant: the items of a row keep their order, for any number of threads. Must not know: the items.

use crate::tasks;
use std::ops::Range;

/// A list for each row.
#[derive(Clone, Debug, Default)]
pub struct Csr<T> {
    /// Where each row begins in `items`; and their number.
    first: Vec<u32>,
    items: Vec<T>,
}

/// A counting sort: where each row begins, and the numbers of the items, row by row. Item `k` belongs to the `k`-th of `owners`; an
/// owner that is not below `rows` has no row, and its item is left out.
fn sorted(rows: usize, owners: impl Iterator<Item = u32> + Clone) -> (Vec<u32>, Vec<u32>) {
    let mut first = vec![0u32; rows + 1];
    let known = || (0u32..).zip(owners.clone()).filter(|(_, row)| (*row as usize) < rows);
    known().for_each(|(_, row)| first[row as usize + 1] += 1);
    (0..rows).for_each(|row| first[row + 1] += first[row]);
    let mut next = first.clone();
    let mut order = vec![0u32; first[rows] as usize];
    for (item, row) in known() {
        order[next[row as usize] as usize] = item;
        next[row as usize] += 1;
    }
    (first, order)
}

impl Csr<u32> {
    /// The facets around each vertex, ascending.
    pub fn one_rings(vertices: usize, facets: &[[u32; 3]]) -> Self {
        let (first, corners) = sorted(vertices, facets.as_flattened().iter().copied());
        Self { first, items: corners.into_iter().map(|corner| corner / 3).collect() }
    }
}

impl<T: Default + Send> Csr<T> {
    /// Item `k` belongs to row `owners[k]` and is made by `make(k)`. Owners that are not below `rows` get no item.
    pub(crate) fn group(rows: usize, owners: &[u32], make: impl Fn(usize) -> T + Sync) -> Self {
        let (first, order) = sorted(rows, owners.iter().copied());
        let items = tasks::map(order.len(), |k| make(order[k] as usize));
        Self { first, items }
    }
}

impl<T: Copy> Csr<T> {
    /// Items with the row of each.
    pub(crate) fn from_pairs(rows: usize, pairs: &[(u32, T)]) -> Self {
        let (first, order) = sorted(rows, pairs.iter().map(|pair| pair.0));
        Self { first, items: order.into_iter().map(|k| pairs[k as usize].1).collect() }
    }
}

impl<T> Csr<T> {
    /// The items of a row.
    pub fn of(&self, row: u32) -> &[T] {
        &self.items[self.range(row)]
    }

    /// Where the items of a row are among [`Self::all`].
    pub(crate) fn range(&self, row: u32) -> Range<usize> {
        self.first[row as usize] as usize..self.first[row as usize + 1] as usize
    }

    pub(crate) fn all(&self) -> &[T] {
        &self.items
    }

    pub(crate) fn all_mut(&mut self) -> &mut [T] {
        &mut self.items
    }
}

const UNCHANGED: u32 = u32::MAX;

/// One-rings as of [`Csr::one_rings`], of a triangulation that changes in places.
#[derive(Clone, Debug)]
pub(crate) struct OneRings {
    base: Csr<u32>,
    /// For each vertex the list of `changed` with its facets.
    list: Vec<u32>,
    changed: Vec<Vec<u32>>,
}

impl OneRings {
    pub(crate) fn new(vertices: usize, facets: &[[u32; 3]]) -> Self {
        Self { list: vec![UNCHANGED; vertices], base: Csr::one_rings(vertices, facets), changed: Vec::new() }
    }

    pub(crate) fn of(&self, v: u32) -> &[u32] {
        self.changed.get(self.list[v as usize] as usize).map_or_else(|| self.base.of(v), Vec::as_slice)
    }

    /// A facet has other corners. Without old ones it is new, without new ones it is no more.
    pub(crate) fn replace(&mut self, f: u32, old: impl IntoIterator<Item = u32>, new: impl IntoIterator<Item = u32>) {
        for v in old {
            self.facets_mut(v).retain(|&g| g != f);
        }
        for v in new {
            let facets = self.facets_mut(v);
            let at = facets.partition_point(|&g| g < f);
            facets.insert(at, f);
        }
    }

    /// Adds a vertex without facets, after all others.
    pub(crate) fn push(&mut self) {
        self.list.push(self.changed.len() as u32);
        self.changed.push(Vec::new());
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
    fn items_keep_the_order_in_which_they_came() {
        let lists = Csr::group(3, &[2, 0, 2, u32::MAX, 0], |k| 10 * k);
        assert_eq!([0, 1, 2].map(|row| lists.of(row).to_vec()), [vec![10, 40], vec![], vec![0, 20]]);
        assert_eq!((lists.range(2), lists.all()), (2..4, [10, 40, 0, 20].as_slice()));
        let pairs = Csr::from_pairs(3, &[(2, 'a'), (0, 'b'), (2, 'c')]);
        assert_eq!([0, 1, 2].map(|row| pairs.of(row).to_vec()), [vec!['b'], vec![], vec!['a', 'c']]);
    }

    #[test]
    fn facets_of_a_one_ring_ascend() {
        let rings = Csr::one_rings(5, &[[0, 1, 2], [2, 1, 3], [0, 2, 3]]);
        assert_eq!(
            [0, 1, 2, 3, 4].map(|v| rings.of(v).to_vec()),
            [vec![0, 2], vec![0, 1], vec![0, 1, 2], vec![1, 2], vec![]]
        );
    }

    #[test]
    fn a_flip_changes_four_one_rings() {
        let mut rings = OneRings::new(4, &[[0, 1, 2], [1, 0, 3]]);
        rings.replace(0, [0, 1, 2], [0, 3, 2]);
        rings.replace(1, [1, 0, 3], [3, 1, 2]);
        assert_eq!([0, 1, 2, 3].map(|v| rings.of(v).to_vec()), [vec![0], vec![1], vec![0, 1], vec![0, 1]]);
    }
}
