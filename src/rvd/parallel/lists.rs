//! The seeds that count on each facet, kept while no seed moves far.
//!
//! Purpose: a pass after one that moved every seed a little finds all cells without looking for neighbours,
//! as molecular dynamics keeps its neighbour lists (Verlet 1967). Seeds that converge move by a
//! hundredth of their spacing, so that a list serves several passes; the few that move farther are strays. Moves go on as
//! they went, so that lists are made about places ahead of the seeds, and serve until these have left them behind.
//! Invariant: lists are used while every other seed is within its slack of the place about which they were made for it;
//! none that counts is missing then. What comes of a facet is the same with a kept list and with a new one.
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
/// That is at least so many times as wide as an average cell, as cells may be empty,
const NARROW: f64 = 1.0 / 32.0;
/// and at most so many times, as all that any seed could move is added to where others are looked for.
const WIDE: f64 = 1.5;
/// Lists are made for so many moves like the last one of a seed that all but this share of them moved less than,
const MOVES: f64 = 6.0;
const FAR: f64 = 1.0 / 64.0;
/// with a slack of at most this share, as lists get longer with it, and of at least that.
const MOST: f64 = 0.2;
const LEAST: f64 = 0.03;
/// They are not made after a move farther than that; the next one is often shorter, as a quasi-Newton step goes.
const FAST: f64 = MOST;
/// Seeds whose last two moves are alike, by the cosine between them, go on (.95 to .998 from one Lloyd step to the next, .4
/// to .9 of quasi-Newton steps), and lists are made about places ahead of them, by at most this share of their slack, so
/// that they serve for nearly twice as long.
const ALIKE: f64 = 0.5;
const AHEAD: f64 = 0.8;
/// Lists are made anew where more than this share of the seeds are strays, and more than so many.
const ASTRAY: f64 = 1.0 / 32.0;
const A_FEW: usize = 2;
/// Seeds around a seed that are looked at for one that it could meet; beside a crowd there are many.
const MANY_AROUND: usize = 4096;
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

    /// Appends a list of so many, which are to be written there.
    #[inline(always)]
    pub(super) fn end(&mut self, len: usize) -> &mut [u32] {
        let begin = self.seeds.len();
        self.seeds.resize(begin + len, 0);
        self.ends.push(self.seeds.len() as u32);
        &mut self.seeds[begin..]
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
    /// The places about which the seeds have their slack: where they were when the lists were made, or were expected to go,
    made_at: Vec<DVec3>,
    /// where they were at the last pass,
    last: Vec<DVec3>,
    /// and at the one before.
    before: Vec<DVec3>,
    /// The next so many times that lists are made nothing is expected.
    blind: usize,
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
    /// The places about which the seeds have their slack.
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
        let few = if self.indexed { A_FEW.max((ASTRAY * seeds.len() as f64) as usize) } else { 0 };
        self.hold_but_for(few, seeds)
    }

    /// The same for so many strays at most.
    fn hold_but_for(&mut self, strays: usize, seeds: &[DVec3]) -> bool {
        let slack = slack(self.share, self.most, &self.width);
        self.strays.find(seeds, &self.made_at, (slack, USED), strays)
            && self.close.iter().all(|&[i, j]| seeds[i as usize] != seeds[j as usize])
            && !self.strays.meet(seeds)
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
            self.find_close(|i, _, _, out| {
                out.extend(table.row(i).0.iter().take(NEIGHBOUR - 1));
                true
            });
        }
    }

    /// The same without rows, where no seeds are crowded; cells are as large as at the last pass, and `area` on average.
    pub(super) fn choose_evenly(&mut self, seeds: &[DVec3], index: &SeedIndex, area: f64) {
        self.leave();
        self.widths_of_cells(seeds.len(), area);
        let share = self.share_for(seeds);
        if share > 0.0 && index.duplicates() == 0 {
            self.begin(seeds, share);
            self.find_close_evenly(index);
        }
    }

    /// The same for seeds that are about to move on as they moved last, if they are. Lists are to be made about places that
    /// lie ahead of them, which are returned; [`Self::check`] says whether they may.
    pub(super) fn look_ahead(&mut self, seeds: &[DVec3], area: f64) -> Option<&[DVec3]> {
        self.leave();
        if self.blind > 0 {
            self.blind -= 1;
            return None;
        }
        if self.before.is_empty() || self.last.len() != seeds.len() || self.before.len() != seeds.len() {
            return None;
        }
        let goes_on = self.goes_on(seeds)?;
        self.widths_of_cells(seeds.len(), area);
        let moved = self.moved(seeds);
        let way = moved * goes_on_for(goes_on, 2.0 * MOVES);
        // They may go on as fast as they went, or turn.
        let share = (0.5 * way.max(MOVES * moved)).clamp(LEAST, MOST);
        if moved * (goes_on + goes_on * goes_on) > (1.0 + AHEAD) * MOST || moved == 0.0 {
            return None;
        }
        self.begin(seeds, share);
        let moves = (0.5 * way).min(AHEAD * share) / moved;
        let Self { made_at, last, width, .. } = self;
        made_at.par_iter_mut().enumerate().with_min_len(CHUNK).for_each(|(i, p)| {
            let on = moves * (*p - last[i]);
            let most = AHEAD * share * width[i];
            *p += on * (most / on.length()).min(1.0);
        });
        Some(&self.made_at)
    }

    /// Whether lists about places with this index hold for seeds there.
    pub(super) fn check(&mut self, seeds: &[DVec3], index: &SeedIndex) -> bool {
        if index.is_even() && index.duplicates() == 0 {
            self.find_close_evenly(index);
            return self.share > 0.0 && self.hold_but_for(0, seeds);
        }
        false
    }

    /// Looking ahead did not do.
    pub(super) fn be_blind(&mut self, passes: usize) {
        self.leave();
        self.blind = passes;
    }

    /// How much of their last moves but one the seeds made again with their last ones, at most all; nothing if many turned.
    fn goes_on(&self, seeds: &[DVec3]) -> Option<f64> {
        let each = seeds.par_chunks(CHUNK).zip(self.last.par_chunks(CHUNK)).zip(self.before.par_chunks(CHUNK));
        let sums = each.map(|((now, last), before)| {
            let moves = now.iter().zip(last).zip(before).map(|((&now, &last), &before)| (now - last, last - before));
            moves.fold([0.0; 3], |[ab, aa, bb], (a, b)| {
                [ab + a.dot(b), aa + a.length_squared(), bb + b.length_squared()]
            })
        });
        // Chunk by chunk in their order: the same number on any number of threads.
        let sums: Vec<[f64; 3]> = sums.collect();
        let [ab, aa, bb] = sums.iter().fold([0.0; 3], |sum, more| [0, 1, 2].map(|k| sum[k] + more[k]));
        (ab > ALIKE * (aa * bb).sqrt()).then(|| (ab / bb).min(1.0))
    }

    /// Widths by cells as large as at the last pass, and `area` on average.
    fn widths_of_cells(&mut self, seeds: usize, area: f64) {
        self.even = true;
        self.length = (HEXAGON * area).sqrt();
        self.width.clear();
        let width = |&area: &f64| (HEXAGON * area).sqrt().clamp(NARROW * self.length, WIDE * self.length);
        self.width.extend(self.area.iter().map(width));
        self.width.resize(seeds, self.length);
    }

    /// The share for these seeds after their last move; 0 where no lists are to be made.
    fn share_for(&mut self, seeds: &[DVec3]) -> f64 {
        // New seeds are behind the others.
        if self.last.is_empty() || self.last.len() > seeds.len() {
            return 0.0;
        }
        let moved = self.moved(seeds);
        if moved <= FAST { (MOVES * moved).clamp(LEAST, MOST) } else { 0.0 }
    }

    /// What all but some seeds moved less than, in widths.
    fn moved(&mut self, seeds: &[DVec3]) -> f64 {
        let moved = |i: usize| self.last[i].distance(seeds[i]) / self.width[i];
        let indices = (0..self.last.len()).into_par_iter().with_min_len(CHUNK);
        indices.map(moved).collect_into_vec(&mut self.moves);
        let most = self.moves.len() - 1;
        let nth = most - (FAR * most as f64) as usize;
        *self.moves.select_nth_unstable_by(nth, f64::total_cmp).1
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
        std::mem::swap(&mut self.before, &mut self.last);
        self.last.clear();
        self.last.extend_from_slice(seeds);
        self.area.clear();
        self.area.extend_from_slice(area);
        self.there |= made && self.share > 0.0;
    }

    /// The same without rows, with the index of the places where lists are made.
    fn find_close_evenly(&mut self, index: &SeedIndex) {
        self.find_close(|_, p, most, out| {
            index.each_in_box(p - most, p + most, MANY_AROUND, |j, q| {
                if p.distance_squared(q) <= most * most {
                    out.push(j);
                }
            })
        });
    }

    /// Finds pairs of seeds that could meet. Of two, the one with more slack has the other within twice that, among those
    /// that `around` finds; with rows that is before the neighbour that gives its width, as slacks are a small part of
    /// that. So seeds that are crowded beside wide cells are looked for from these few. There will be no lists where
    /// `around` cannot say.
    fn find_close(&mut self, around: impl Fn(u32, DVec3, f64, &mut Vec<u32>) -> bool + Sync) {
        let slack = slack(self.share, self.most, &self.width);
        let seeds = &self.made_at;
        let find = |chunk: usize| {
            let (mut near, mut pairs) = (Vec::new(), Vec::new());
            for i in chunk * CHUNK..seeds.len().min((chunk + 1) * CHUNK) {
                let own = slack.of(i as u32);
                near.clear();
                if !around(i as u32, seeds[i], 2.0 * own, &mut near) {
                    return None;
                }
                let close = |&&j: &&u32| {
                    let other = slack.of(j);
                    (other, j) < (own, i as u32) && seeds[i].distance(seeds[j as usize]) <= own + other
                };
                pairs.extend(near.iter().filter(close).map(|&j| [i as u32, j]));
            }
            Some(pairs)
        };
        let chunks: Option<Vec<_>> =
            (0..seeds.len().div_ceil(CHUNK)).into_par_iter().with_max_len(1).map(find).collect();
        self.close.clear();
        match chunks {
            Some(pairs) => self.close.extend(pairs.iter().flatten()),
            None => self.leave(),
        }
    }
}

/// How far a seed comes in so many moves, as a multiple of its last one, if each is `goes_on` times the one before.
fn goes_on_for(goes_on: f64, moves: f64) -> f64 {
    match goes_on < 1.0 {
        true => goes_on * (1.0 - goes_on.powf(moves)) / (1.0 - goes_on),
        false => moves,
    }
}

/// The slack of seeds.
fn slack(share: f64, most: f64, width: &[f64]) -> Slack<'_> {
    Slack { share, width, most }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seeds_that_could_meet_are_found_beside_a_crowd() {
        // A wide grid, and between four of its seeds so many cells of a fiftieth the width that whoever looks as far as the
        // widest slack goes sees too many.
        let wide = (0..900).map(|k| DVec3::new((k % 30) as f64, (k / 30) as f64, 0.0));
        let crowd = (0..900).map(|k| DVec3::new(14.2 + (k % 30) as f64 / 50.0, 14.2 + (k / 30) as f64 / 50.0, 0.0));
        let last: Vec<DVec3> = wide.chain(crowd).collect();
        let area: Vec<f64> = (0..last.len()).map(|i| if i < 900 { 1.0 } else { 1.0 / 2500.0 }).collect();
        let mut lists = KeptLists::default();
        lists.end_pass(&last, &area, false);
        let moved = |i: usize| 0.02 * area[i].sqrt() * DVec3::new((i as f64).sin(), (i as f64).cos(), 0.0);
        let seeds: Vec<DVec3> = last.iter().enumerate().map(|(i, &p)| p + moved(i)).collect();
        let mean = area.iter().sum::<f64>() / area.len() as f64;
        lists.choose_evenly(&seeds, &SeedIndex::new(&seeds), mean);
        assert!((0.1..0.2).contains(&lists.share), "{}", lists.share);
        // So wide that a crowded seed could meet a wide one.
        lists.share = 0.4;
        lists.find_close_evenly(&SeedIndex::new(&seeds));
        let slack = slack(lists.share, lists.most, &lists.width);
        let mut want = Vec::new();
        for i in 0..seeds.len() as u32 {
            let meets = |&j: &u32| seeds[i as usize].distance(seeds[j as usize]) <= slack.of(i) + slack.of(j);
            want.extend((0..i).filter(meets).map(|j| [j, i]));
        }
        let mut found: Vec<[u32; 2]> = lists.close.iter().map(|&[i, j]| [i.min(j), i.max(j)]).collect();
        found.sort_unstable();
        want.sort_unstable();
        assert!(found == want && want.iter().any(|&[i, j]| i < 900 && j >= 900), "{} for {}", found.len(), want.len());
    }
}
