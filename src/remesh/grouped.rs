//! Things that belong to vertices, those of one vertex side by side.
//!
//! Purpose: [`Grouped`] holds a list for each vertex in flat arrays.
//! Invariant: the things of a vertex keep the order that they came in, whatever the number of threads.
//! Must not know: what the things are.

use rayon::prelude::*;

/// See the module's head.
#[derive(Clone, Debug, Default)]
pub(super) struct Grouped<T> {
    first: Vec<u32>,
    items: Vec<T>,
}

impl<T: Send> Grouped<T> {
    /// Thing `k` belongs to vertex `owners[k]` and is made by `make(k)`; owners that are no vertex (not below
    /// `vertices`) have none.
    pub(super) fn new(vertices: usize, owners: &[u32], make: impl Fn(usize) -> T + Sync) -> Self {
        let mut first = vec![0u32; vertices + 1];
        let known = || (0u32..).zip(owners).filter(|(_, v)| (**v as usize) < vertices);
        known().for_each(|(_, &v)| first[v as usize + 1] += 1);
        (0..vertices).for_each(|v| first[v + 1] += first[v]);
        let mut next = first.clone();
        let mut order = vec![0u32; first[vertices] as usize];
        for (k, &v) in known() {
            order[next[v as usize] as usize] = k;
            next[v as usize] += 1;
        }
        let items = order.par_iter().with_min_len(SHARE).map(|&k| make(k as usize)).collect();
        Self { first, items }
    }
}

/// Things that are not worth a task of their own.
const SHARE: usize = 1024;

impl<T> Grouped<T> {
    /// Those of vertex `v`.
    pub(super) fn of(&self, v: u32) -> &[T] {
        &self.items[self.range(v)]
    }

    /// Where those of vertex `v` are among [`Self::all`].
    pub(super) fn range(&self, v: u32) -> std::ops::Range<usize> {
        self.first[v as usize] as usize..self.first[v as usize + 1] as usize
    }

    /// All, by vertex.
    pub(super) fn all(&self) -> &[T] {
        &self.items
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn in_the_order_they_came() {
        let lists = Grouped::new(3, &[2, 0, 2, u32::MAX, 0], |k| 10 * k);
        assert_eq!([0, 1, 2].map(|v| lists.of(v).to_vec()), [vec![10, 40], vec![], vec![0, 20]]);
        assert_eq!((lists.range(2), lists.all()), (2..4, [10, 40, 0, 20].as_slice()));
    }
}
