//! Facets shared out to threads, and their sums.
//!
//! Purpose: a [`chunk`] is a task's share of the facets. Facets are divided in any order; their pieces are written down where they
//! belong, and then added up in one order.
//! Invariant: a cell adds its pieces within a block up in the order of facets, and nothing else decides its bits: no sum depends on
//! how facets are shared out. Must not know: how seeds are listed, how pieces are found.

pub(super) mod chunk;

use std::iter::repeat_n;

use super::divide::facets::MEMBERS;
use crate::knn::Point;
use crate::rvd::{clip::Integrals, refill};

/// Stands where a member has no piece.
pub(super) const NONE: u32 = u32::MAX;

#[derive(Default)]
pub(super) struct Written<P> {
    /// Of as many seeds as each facet has members; [`NONE`] where a member has no piece.
    pub seeds: Vec<u32>,
    pub integrals: Vec<Integrals<P>>,
    /// Where those of each facet begin, and the end of the last.
    begin: Vec<u32>,
    pub walked: Vec<(u32, Integrals<P>)>,
    /// Of each facet that was walked its place, and the end of its pieces among those.
    inserts: Vec<(usize, usize)>,
    /// Of each seed its place among a block's cells, or [`NONE`].
    place: Vec<u32>,
}

impl<P: Point> Written<P> {
    /// Gives every facet with a usable number of members room for their integrals; the others are to be walked.
    pub(super) fn begin(&mut self, members: &[u32], to_walk: &mut Vec<u32>) {
        self.begin.clear();
        self.walked.clear();
        self.inserts.clear();
        to_walk.clear();
        let mut end = 0;
        for (at, members) in members.iter().enumerate() {
            self.begin.push(end);
            let n = members.count_ones();
            if (1..=MEMBERS as u32).contains(&n) {
                end += n;
            } else {
                to_walk.push(at as u32);
            }
        }
        self.begin.push(end);
        // Each gets its value, so that what is there from an earlier task may stay until then.
        self.seeds.resize(end as usize, NONE);
        self.integrals.resize(end as usize, Integrals::default());
    }

    #[inline(always)]
    pub(super) fn first(&self, at: u32) -> usize {
        self.begin[at as usize] as usize
    }

    /// What was walked since belongs to the facet at `at`. Facets come in order.
    pub(super) fn end_walk(&mut self, at: usize) {
        self.inserts.push((at, self.walked.len()));
    }

    /// Appends the sums of all cells in blocks of `block` facets. `seeds` is the number of seeds.
    pub(super) fn add_blocks(&mut self, block: usize, seeds: usize, out: &mut Vec<(u32, Integrals<P>)>) {
        if self.place.len() != seeds {
            refill(&mut self.place, repeat_n(NONE, seeds));
        }
        let Self { seeds, integrals, begin, walked, inserts, place } = self;
        let facets = begin.len() - 1;
        let mut inserts = inserts.iter().peekable();
        let (mut at, mut from) = (0, 0);
        for last in (0..facets).step_by(block).map(|first| facets.min(first + block)) {
            let mut sums = Block { place, first: out.len(), out };
            while let Some(&(place, end)) = inserts.next_if(|insert| insert.0 < last) {
                let before = begin[place] as usize;
                sums.add(&seeds[at..before], &integrals[at..before]);
                walked[from..end].iter().for_each(|(seed, sum)| sums.add_one(*seed, sum));
                (at, from) = (before, end);
            }
            let end = begin[last] as usize;
            sums.add(&seeds[at..end], &integrals[at..end]);
            sums.end();
            at = end;
        }
    }
}

struct Block<'a, P> {
    place: &'a mut [u32],
    first: usize,
    out: &'a mut Vec<(u32, Integrals<P>)>,
}

impl<P: Point> Block<'_, P> {
    #[inline(always)]
    fn add(&mut self, seeds: &[u32], integrals: &[Integrals<P>]) {
        seeds.iter().zip(integrals).filter(|(seed, _)| **seed != NONE).for_each(|(seed, sum)| self.add_one(*seed, sum));
    }

    #[inline(always)]
    fn add_one(&mut self, seed: u32, sum: &Integrals<P>) {
        let place = &mut self.place[seed as usize];
        if *place == NONE {
            *place = (self.out.len() - self.first) as u32;
            self.out.push((seed, *sum));
        } else {
            let to = &mut self.out[self.first + *place as usize].1;
            to.mass += sum.mass;
            to.moment += sum.moment;
            to.energy += sum.energy;
            to.area += sum.area;
        }
    }

    fn end(self) {
        self.out[self.first..].iter().for_each(|(seed, _)| self.place[*seed as usize] = NONE);
    }
}
