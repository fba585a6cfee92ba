//! Half-edges sorted by their edge, and sets of what edges connect.
//!
//! Purpose: [`EdgeGroups`] groups the facets by edge, in time linear in the facets for bounded valences; [`DisjointSets`] joins
//! numbers (union-find with path halving).
//! Invariant: edges ascend by (lower vertex, higher vertex), the half-edges of an edge by (facet, side), for any number of
//! threads. The root of a set is its lowest member. Must not know: coincident vertices, kinds of edges.

use super::MAX_ELEMENTS;
use crate::tasks;
use crate::token::{Stopped, Token};
use rayon::prelude::*;

/// Vertices that are one task.
const RUN: usize = 2048;

/// The ends of an edge, the lower one first, for both directions.
pub fn undirected([a, b]: [u32; 2]) -> [u32; 2] {
    [a.min(b), a.max(b)]
}

/// The sides of a facet: side e runs from corner e to the next.
pub fn sides([a, b, c]: [u32; 3]) -> [[u32; 2]; 3] {
    [[a, b], [b, c], [c, a]]
}

/// All half-edges of some facets. One is a number: the edge's higher vertex in 31 bits, the facet in 31, the side in 2.
pub(crate) struct EdgeGroups {
    /// For each vertex, the first half-edge with this vertex as the lower end; and the total.
    first: Vec<usize>,
    halves: Vec<u64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Half {
    pub facet: u32,
    pub side: usize,
}

impl EdgeGroups {
    /// Groups the half-edges of `facets`, each given with its number and its corners, which are below `vertices`.
    pub(crate) fn new(vertices: usize, facets: impl Iterator<Item = (usize, [u32; 3])> + Clone) -> Self {
        let nothing = |_| Self { first: vec![0; vertices + 1], halves: Vec::new() };
        Self::unless(vertices, facets, &Token::default()).unwrap_or_else(nothing)
    }

    /// As [`Self::new`], unless it is stopped.
    pub(crate) fn unless(
        vertices: usize,
        facets: impl Iterator<Item = (usize, [u32; 3])> + Clone,
        token: &Token,
    ) -> Result<Self, Stopped> {
        // Vertices and facets have numbers of 31 bits.
        const { assert!(MAX_ELEMENTS < 1 << 31) };
        let mut first = vec![0usize; vertices + 1];
        for (facet, corners) in facets.clone() {
            token.check_at(facet)?;
            sides(corners).iter().for_each(|&[a, b]| first[a.min(b) as usize + 1] += 1);
        }
        // Where each vertex' half-edges begin; they are filled in from there, which moves all by one.
        let mut total = 0;
        for slot in &mut first {
            total += *slot;
            *slot = total;
        }
        let mut halves = vec![0u64; total];
        for (facet, corners) in facets {
            token.check_at(facet)?;
            for (side, &[a, b]) in sides(corners).iter().enumerate() {
                let next = &mut first[a.min(b) as usize];
                halves[*next] = u64::from(a.max(b)) << 33 | (facet as u64) << 2 | side as u64;
                *next += 1;
            }
        }
        first.rotate_right(1);
        first[0] = 0;
        let mut runs = Vec::with_capacity(vertices / RUN + 1);
        let mut rest = halves.as_mut_slice();
        for run in first[..vertices].chunks(RUN).enumerate().map(|(k, run)| &first[k * RUN..=k * RUN + run.len()]) {
            let (here, after) = rest.split_at_mut(run[run.len() - 1] - run[0]);
            runs.push((run, here));
            rest = after;
        }
        runs.into_par_iter().for_each(|(first, mut rest)| {
            if token.is_stopped() {
                return;
            }
            for pair in first.windows(2) {
                let (here, after) = rest.split_at_mut(pair[1] - pair[0]);
                here.sort_unstable();
                rest = after;
            }
        });
        token.check()?;
        Ok(Self { first, halves })
    }

    /// Calls `visit` as [`Self::for_each`] does, on all threads. Each run of vertices has a list; the lists are in order.
    pub(crate) fn gather<T: Default + Send>(&self, visit: impl Fn(&mut T, u32, &[Half]) + Sync) -> Vec<T> {
        let vertices = self.first.len() - 1;
        let run = |k: usize| {
            let mut list = T::default();
            self.visit(k * RUN..vertices.min((k + 1) * RUN), |low, group| visit(&mut list, low, group));
            list
        };
        tasks::alone(vertices.div_ceil(RUN), run)
    }

    /// Calls `visit` with the lower vertex and the half-edges of each edge.
    pub(crate) fn for_each(&self, visit: impl FnMut(u32, &[Half])) {
        self.visit(0..self.first.len() - 1, visit);
    }

    fn visit(&self, vertices: std::ops::Range<usize>, mut visit: impl FnMut(u32, &[Half])) {
        let mut group = Vec::new();
        for (vertex, range) in vertices.clone().zip(self.first[vertices.start..=vertices.end].windows(2)) {
            for edge in self.halves[range[0]..range[1]].chunk_by(|a, b| a >> 33 == b >> 33) {
                group.clear();
                let half = |&h: &u64| Half { facet: (h >> 2) as u32 & (u32::MAX >> 1), side: (h & 3) as usize };
                group.extend(edge.iter().map(half));
                visit(vertex as u32, &group);
            }
        }
    }
}

/// Sets of the numbers from 0 to n - 1, each alone at first.
#[derive(Clone, Debug)]
pub(crate) struct DisjointSets(Vec<usize>);

impl DisjointSets {
    pub(crate) fn new(n: usize) -> Self {
        Self((0..n).collect())
    }

    pub(crate) fn len(&self) -> usize {
        self.0.len()
    }

    pub(crate) fn root(&mut self, mut i: usize) -> usize {
        while self.0[i] != i {
            self.0[i] = self.0[self.0[i]];
            i = self.0[i];
        }
        i
    }

    pub(crate) fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a), self.root(b));
        let (low, high) = (a.min(b), a.max(b));
        self.0[high] = low;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn in_order_and_whole() {
        let facets = [(0, [4, 2, 1]), (3, [1, 2, 0]), (7, [1, 2, 4]), (8, [3, 3, 0])];
        let mut found = Vec::new();
        let half = |facet, side| Half { facet, side };
        EdgeGroups::new(5, facets.into_iter()).for_each(|low, group| found.push((low, group.to_vec())));
        let expected = [
            (0, vec![half(3, 2)]),
            (0, vec![half(3, 1)]),
            (0, vec![half(8, 1), half(8, 2)]),
            (1, vec![half(0, 1), half(3, 0), half(7, 0)]),
            (1, vec![half(0, 2), half(7, 2)]),
            (2, vec![half(0, 0), half(7, 1)]),
            (3, vec![half(8, 0)]),
        ];
        assert_eq!(found, expected);
        let largest = (MAX_ELEMENTS - 1, [0, 1, MAX_ELEMENTS as u32 - 1]);
        assert_eq!(largest.0 as u64 & (u64::from(u32::MAX) >> 1), largest.0 as u64);
    }
}
