//! The seeds that count on each facet, kept while no seed moves far.
//!
//! Purpose: a pass after one that moved every seed a little finds all cells without looking for neighbours,
//! as molecular dynamics keeps its neighbour lists (Verlet 1967). Seeds that converge move by a
//! hundredth of their spacing, so that a list serves several passes; the few that move farther are strays.
//! Invariant: lists are used while every other seed is within its slack of where it was when they were made; none
//! that counts is missing then. What comes of a facet is the same with a kept list and with a new one.
//! Must not know: what becomes of a list; surfaces.

use std::ops::Range;

use glam::DVec3;
use rayon::prelude::*;

use super::gather::Slack;
use super::strays::{Bounds, Strays};
use crate::knn::{NeighbourTable, SeedIndex};

/// A seed's slack is a share of the distance to this neighbour of it, which relaxed cells touch,
const NEIGHBOUR: usize = 6;
/// or of about as much by the area of its cell: the squared distance between relaxed seeds is 2/√3 of that.
const HEXAGON: f64 = 1.1547;
/// That is at least and at most so many times as wide as an average cell, as all that any seed could move is added to
/// where others are looked for.
const NARROW: f64 = 0.25;
const WIDE: f64 = 1.5;
/// Lists are made for so many moves like the last one of a seed that all but this share of them moved less than,
const MOVES: f64 = 6.0;
const FAR: f64 = 1.0 / 64.0;
/// with a slack of at most this share, as lists get longer with it, and of at least that.
const MOST: f64 = 0.2;
const LEAST: f64 = 0.03;
/// They are not made where the last move says that they would not serve twice.
const FAST: f64 = MOST / 2.0;
/// They are made anew where more than this share of the seeds are strays, and more than so many.
const ASTRAY: f64 = 1.0 / 32.0;
const A_FEW: usize = 2;
/// Seeds around a seed that are looked at for one that it could meet.
const MANY_AROUND: usize = 512;
/// Of its slack a seed may use so much, so that comparisons of distances are never near their roundings.
const USED: f64 = 1.0 - 1e-6;
/// Seeds per task.
const CHUNK: usize = 2048;

/// The lists of one chunk of facets, one after the other; an empty one where it would be too long.
#[derive(Default)]
pub(super) struct Lists {
    ends: Vec<u32>,
    seeds: Vec<u32>,
    /// Of each group of [`super::around::GROUP`] facets, who may be nearer to a corner than the seed that the facet starts
    /// with.
    pub bounds: Vec<Bounds>,
}

impl Lists {
    pub(super) fn clear(&mut self) {
        self.ends.clear();
        self.seeds.clear();
        self.bounds.clear();
    }

    pub(super) fn push(&mut self, list: impl IntoIterator<Item = u32>) {
        self.seeds.extend(list);
        self.ends.push(self.seeds.len() as u32);
    }

    /// Appends to the list that [`Self::end`] ends.
    #[inline(always)]
    pub(super) fn add(&mut self, seed: u32) {
        self.seeds.push(seed);
    }

    #[inline(always)]
    pub(super) fn end(&mut self) {
        self.ends.push(self.seeds.len() as u32);
    }

    /// Takes another one's lists, each in the order of its seeds' numbers.
    pub(super) fn take(&mut self, other: &mut Self) {
        std::mem::swap(self, other);
        self.bounds.clear();
        let mut begin = 0;
        for &end in &self.ends {
            self.seeds[begin as usize..end as usize].sort_unstable();
            begin = end;
        }
    }

    /// The list that was pushed last.
    pub(super) fn last_mut(&mut self) -> &mut [u32] {
        let begin = self.ends.len().checked_sub(2).map_or(0, |before| self.ends[before]);
        &mut self.seeds[begin as usize..]
    }

    /// How many seeds a list has.
    pub(super) fn mean_len(&self) -> usize {
        self.seeds.len() / self.ends.len().max(1)
    }

    /// Appends a range of another one's lists.
    pub(super) fn copy(&mut self, other: &Self, range: Range<usize>) {
        let (first, end) = (other.first(range.start), other.first(range.end));
        let shift = (self.seeds.len() as u32).wrapping_sub(first);
        self.seeds.extend_from_slice(&other.seeds[first as usize..end as usize]);
        self.ends.extend(other.ends[range].iter().map(|end| end.wrapping_add(shift)));
    }

    /// Where the list at `at` begins.
    fn first(&self, at: usize) -> u32 {
        if at == 0 { 0 } else { self.ends[at - 1] }
    }

    /// How many lists there are.
    pub(super) fn len(&self) -> usize {
        self.ends.len()
    }

    /// The list of the facet at `at` of the chunk.
    pub(super) fn get(&self, at: usize) -> &[u32] {
        &self.seeds[self.first(at) as usize..self.ends[at] as usize]
    }
}

/// All lists, and the seeds that they hold for.
#[derive(Default)]
pub(super) struct KeptLists {
    /// Of each chunk of so many facets.
    chunks: Vec<Lists>,
    facets: usize,
    /// Whether there are lists.
    there: bool,
    share: f64,
    /// Whether lists come without rows, and how wide a cell is then on average.
    even: bool,
    length: f64,
    /// Of each seed the distance to a neighbour when rows were last made, or else about that of its cell.
    width: Vec<f64>,
    /// Of each cell at the last pass.
    area: Vec<f64>,
    /// The most slack that a seed can have where that is known.
    most: f64,
    /// Where the seeds were when the lists were made,
    made_at: Vec<DVec3>,
    /// and at the last pass.
    last: Vec<DVec3>,
    /// Seeds that could come to lie on each other within their slack.
    close: Vec<[u32; 2]>,
    /// Whether the index, and the rows, of the seeds as they were then are still there.
    indexed: bool,
    strays: Strays,
    moves: Vec<f64>,
}

/// What lists that are kept are about.
#[derive(Clone, Copy)]
pub(super) struct Kept<'a> {
    /// Where the seeds were when the lists were made.
    pub made_at: &'a [DVec3],
    pub slack: Slack<'a>,
    pub strays: &'a Strays,
    /// Whether lists come without rows.
    pub even: bool,
}

impl KeptLists {
    /// Whether the lists, so many facets to a chunk, hold for these seeds, but for a few strays. The index must
    /// be there for those.
    pub(super) fn hold(&mut self, seeds: &[DVec3], facets: usize) -> bool {
        if !self.there || self.facets != facets || self.made_at.len() > seeds.len() {
            return false;
        }
        let slack = slack(self.share, self.most, &self.width);
        let strays = self.strays.find(seeds, &self.made_at, slack, USED);
        let few = strays == 0 || self.indexed && (strays <= A_FEW || strays as f64 <= ASTRAY * seeds.len() as f64);
        few && self.close.iter().all(|&[i, j]| seeds[i as usize] != seeds[j as usize]) && !self.strays.meet(seeds)
    }

    /// The index and the rows are others now.
    pub(super) fn lose_index(&mut self) {
        self.indexed = false;
    }

    /// None are made now.
    pub(super) fn leave(&mut self) {
        self.there = false;
        self.share = 0.0;
    }

    /// Chooses the slack of lists that are to be made now, from the new rows of these seeds.
    pub(super) fn choose(&mut self, seeds: &[DVec3], table: &NeighbourTable) {
        self.leave();
        self.even = false;
        self.width.resize(seeds.len(), 0.0);
        // Rows that are too short for it leave no width, and a later twin has none; lists are not kept then.
        self.width.par_iter_mut().enumerate().with_min_len(CHUNK).for_each(|(i, width)| {
            let neighbour = table.row(i as u32).0.get(NEIGHBOUR - 1);
            *width = neighbour.map_or(0.0, |&j| seeds[i].distance(seeds[j as usize]));
        });
        let share = self.share_for(seeds);
        if share > 0.0 && self.width.par_iter().all(|&width| width > 0.0) {
            self.begin(seeds, share);
            self.find_close(seeds, |i, _, out| {
                out.extend(table.row(i).0.iter().take(NEIGHBOUR - 1));
                true
            });
        }
    }

    /// The same without rows, where no seeds are crowded; cells are as large as at the last pass, and `area` on average.
    pub(super) fn choose_evenly(&mut self, seeds: &[DVec3], index: &SeedIndex, area: f64) {
        self.leave();
        self.even = true;
        self.length = (HEXAGON * area).sqrt();
        self.width.clear();
        let width = |&area: &f64| (HEXAGON * area).sqrt().clamp(NARROW * self.length, WIDE * self.length);
        self.width.extend(self.area.iter().map(width));
        self.width.resize(seeds.len(), self.length);
        let share = self.share_for(seeds);
        if share > 0.0 && index.duplicates() == 0 {
            self.begin(seeds, share);
            self.find_close(seeds, |i, most, out| {
                let p = seeds[i as usize];
                index.in_box(p - most, p + most, MANY_AROUND, out)
            });
        }
    }

    /// The share for these seeds after their last move; 0 where no lists are to be made.
    fn share_for(&mut self, seeds: &[DVec3]) -> f64 {
        // New seeds are behind the others.
        if self.last.is_empty() || self.last.len() > seeds.len() {
            return 0.0;
        }
        let moved = |i: usize| self.last[i].distance(seeds[i]) / self.width[i];
        let indices = (0..self.last.len()).into_par_iter().with_min_len(CHUNK);
        indices.map(moved).collect_into_vec(&mut self.moves);
        let most = self.moves.len() - 1;
        let nth = most - (FAR * most as f64) as usize;
        let &mut moved = self.moves.select_nth_unstable_by(nth, f64::total_cmp).1;
        if moved <= FAST { (MOVES * moved).clamp(LEAST, MOST) } else { 0.0 }
    }

    fn begin(&mut self, seeds: &[DVec3], share: f64) {
        self.share = share;
        self.most = if self.even { share * WIDE * self.length } else { f64::INFINITY };
        self.indexed = true;
        self.made_at.clear();
        self.made_at.extend_from_slice(seeds);
    }

    /// What was chosen, and the lists of so many chunks of so many facets.
    pub(super) fn split(&mut self, chunks: usize, facets: usize) -> (Kept<'_>, &mut [Lists]) {
        self.facets = facets;
        self.chunks.resize_with(chunks, Lists::default);
        let slack = slack(self.share, self.most, &self.width);
        (Kept { made_at: &self.made_at, slack, strays: &self.strays, even: self.even }, &mut self.chunks)
    }

    /// A pass over these seeds is done, with cells of such areas; whether it made a list for every facet.
    pub(super) fn end_pass(&mut self, seeds: &[DVec3], area: &[f64], made: bool) {
        self.last.clear();
        self.last.extend_from_slice(seeds);
        self.area.clear();
        self.area.extend_from_slice(area);
        self.there |= made && self.share > 0.0;
    }

    /// Finds pairs of seeds that could meet, among those within a distance that `around` finds: with rows, one is in the
    /// other's row before the neighbour that gives the width, as slacks are a small part of that. There will be no lists
    /// where `around` cannot say.
    fn find_close(&mut self, seeds: &[DVec3], around: impl Fn(u32, f64, &mut Vec<u32>) -> bool + Sync) {
        let slack = slack(self.share, self.most, &self.width);
        let find = |chunk: usize| {
            let (mut near, mut pairs) = (Vec::new(), Vec::new());
            for i in chunk * CHUNK..seeds.len().min((chunk + 1) * CHUNK) {
                let own = slack.of(i as u32);
                let most = slack.farthest(own, 0.0, own);
                near.clear();
                if !around(i as u32, most, &mut near) {
                    return None;
                }
                let reach = |j: u32| own + slack.of(j);
                let close = |&&j: &&u32| i < j as usize && seeds[i].distance(seeds[j as usize]) <= reach(j);
                pairs.extend(near.iter().filter(close).map(|&j| [i as u32, j]));
            }
            Some(pairs)
        };
        let chunks: Option<Vec<_>> = (0..seeds.len().div_ceil(CHUNK)).into_par_iter().map(find).collect();
        self.close.clear();
        match chunks {
            Some(pairs) => self.close.extend(pairs.iter().flatten()),
            None => self.leave(),
        }
    }
}

/// The slack of seeds.
fn slack(share: f64, most: f64, width: &[f64]) -> Slack<'_> {
    Slack { share, width, most }
}
