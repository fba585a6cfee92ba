//! The seeds whose cells may meet a facet.
//!
//! Purpose: lists of seeds for every facet, which serve several passes as Verlet lists: `gather` finds them from rows of
//! neighbours or one by one, `neighbourhood` for several facets at once, `list_builder` for a task; `verlet` says how long
//! they hold, but for the seeds that have `escaped`; `members` leaves those that count.
//! Invariant: no seed whose cell meets a facet is missing from its list. Must not know: integrals, tasks.

pub(super) mod escaped;
pub(super) mod gather;
pub(super) mod list_builder;
pub(super) mod members;
pub(super) mod neighbourhood;
pub(super) mod verlet;

use std::ops::Range;

use escaped::Bounds;

/// The lists of one chunk of facets, one after the other; an empty one where it would be too long.
#[derive(Default)]
pub(crate) struct Lists {
    ends: Vec<u32>,
    seeds: Vec<u32>,
    /// Per group of [`neighbourhood::GROUP`] facets, the box of seeds that may be nearer to a corner than a facet's start.
    pub bounds: Vec<Bounds>,
}

impl Lists {
    pub(crate) fn clear(&mut self) {
        self.ends.clear();
        self.seeds.clear();
        self.bounds.clear();
    }

    pub(crate) fn push(&mut self, list: impl IntoIterator<Item = u32>) {
        self.seeds.extend(list);
        self.ends.push(self.seeds.len() as u32);
    }

    /// Appends a list of `len` seeds to be written.
    #[inline(always)]
    pub(crate) fn end(&mut self, len: usize) -> &mut [u32] {
        let begin = self.seeds.len();
        self.seeds.resize(begin + len, 0);
        self.ends.push(self.seeds.len() as u32);
        &mut self.seeds[begin..]
    }

    pub(crate) fn mean_len(&self) -> usize {
        self.seeds.len() / self.ends.len().max(1)
    }

    /// Appends a range of another one's lists.
    pub(crate) fn copy(&mut self, other: &Self, range: Range<usize>) {
        let (first, end) = (other.first(range.start), other.first(range.end));
        let shift = (self.seeds.len() as u32).wrapping_sub(first);
        self.seeds.extend_from_slice(&other.seeds[first as usize..end as usize]);
        self.ends.extend(other.ends[range].iter().map(|end| end.wrapping_add(shift)));
    }

    fn first(&self, at: usize) -> u32 {
        if at == 0 { 0 } else { self.ends[at - 1] }
    }

    pub(crate) fn len(&self) -> usize {
        self.ends.len()
    }

    pub(crate) fn get(&self, at: usize) -> &[u32] {
        &self.seeds[self.first(at) as usize..self.ends[at] as usize]
    }
}
