//! Verlet lists: the seeds that count on each facet, while no seed moves far.
//!
//! Purpose: a pass after one that moved every seed a little finds all cells without a search for neighbours,
//! as molecular dynamics does with its neighbour lists (Verlet 1967). Seeds that converge move by a hundredth of their spacing,
//! so a list serves several passes. The few seeds that move farther have escaped. Moves continue as they went, so lists are made
//! about places ahead of the seeds, and serve until the seeds have left them behind.
//! Invariant: lists are used while every seed that has not escaped is within its skin of the place about which they were made.
//! No seed that counts is missing then. What comes of a facet is the same with an old list and with a new one.
//! Must not know: what becomes of a list; surfaces.

use rayon::prelude::*;

use super::{Lists, escaped::Escaped, gather::Skin};
use crate::knn::{NeighbourTable, Point, SeedIndex};

/// A seed's skin is a share of the distance to this neighbour; relaxed cells touch it.
const NEIGHBOUR: usize = 6;
/// Squared distance between relaxed seeds over the cell's area: 2/√3. It gives the skin where no neighbour is known.
const HEXAGON: f64 = 1.1547;
/// Least width, in widths of an average cell, since cells may be empty.
const NARROW: f64 = 1.0 / 32.0;
/// Largest width, in widths of an average cell, since the largest skin widens every search.
const WIDE: f64 = 1.5;
/// Moves that lists are made for, each as long as the last move of all seeds but a share of [`FAR`].
const MOVES: f64 = 6.0;
const FAR: f64 = 1.0 / 64.0;
/// Largest and least skin, as shares: lists get longer with it.
const MOST: f64 = 0.2;
const LEAST: f64 = 0.03;
/// No lists are made after a longer move than this. The next move is often shorter, as quasi-Newton steps go.
const FAST: f64 = MOST;
/// Cosine between two moves from which on a seed is expected to continue: 0.95 to 0.998 between Lloyd steps, 0.4 to 0.9
/// between quasi-Newton steps. Lists are then made ahead of it, by at most [`AHEAD`] of its skin, and serve nearly twice.
const ALIKE: f64 = 0.5;
const AHEAD: f64 = 0.8;
/// Lists are rebuilt if more than this share of the seeds has escaped, and more than [`A_FEW`].
const ESCAPED: f64 = 1.0 / 32.0;
const A_FEW: usize = 2;
/// Seeds to examine around a seed for one that it could meet; dense seeds have many.
const MANY_AROUND: usize = 4096;
/// Share of its skin that a seed may use, so that comparisons of distances are never near their rounding.
const USED: f64 = 1.0 - 1e-6;
/// Seeds per task.
const CHUNK: usize = 2048;

#[derive(Default)]
pub(crate) struct VerletLists<P> {
    /// Lists by chunk of `facets` facets.
    chunks: Vec<Lists>,
    facets: usize,
    there: bool,
    share: f64,
    /// Whether lists come without rows, and how wide a cell is then on average.
    even: bool,
    length: f64,
    /// Distance of each seed to a neighbour when rows were last made, or an estimate by the area of its cell.
    width: Vec<f64>,
    /// Area of each cell in the last pass.
    area: Vec<f64>,
    /// Largest skin of a seed, where that is known.
    most: f64,
    /// Centre of each seed's skin: its place when the lists were made, or the place that was expected.
    made_at: Vec<P>,
    /// Seeds in the last pass, and in the pass before the last.
    last: Vec<P>,
    before: Vec<P>,
    /// Number of list builds left in which no moves are expected.
    blind: usize,
    /// Pairs of seeds that could meet within their skins.
    close: Vec<[u32; 2]>,
    /// Whether the index and the rows of the lists' seeds still exist.
    pub indexed: bool,
    escaped: Escaped<P>,
    moves: Vec<f64>,
}

/// What Verlet lists hold for.
#[derive(Clone, Copy)]
pub(crate) struct Verlet<'a, P> {
    pub made_at: &'a [P],
    pub skin: Skin<'a>,
    pub escaped: &'a Escaped<P>,
    pub even: bool,
}

impl<P: Point> VerletLists<P> {
    /// Whether the lists, in chunks of `facets`, hold but for a few escaped seeds, for which the index must be there.
    pub(crate) fn hold(&mut self, seeds: &[P], facets: usize) -> bool {
        if !self.there || self.facets != facets || self.made_at.len() > seeds.len() {
            return false;
        }
        let few = if self.indexed { A_FEW.max((ESCAPED * seeds.len() as f64) as usize) } else { 0 };
        self.hold_but_for(few, seeds)
    }

    fn hold_but_for(&mut self, escaped: usize, seeds: &[P]) -> bool {
        let skin = skin(self.share, self.most, &self.width);
        self.escaped.find(seeds, &self.made_at, (skin, USED), escaped)
            && self.close.iter().all(|&[i, j]| seeds[i as usize] != seeds[j as usize])
            && !self.escaped.meet(seeds)
    }

    pub(crate) fn leave(&mut self) {
        self.there = false;
        self.share = 0.0;
    }

    /// Chooses the skin of lists that are to be made now, from the new rows of these seeds.
    pub(crate) fn choose(&mut self, seeds: &[P], table: &NeighbourTable) {
        self.leave();
        self.even = false;
        self.width.resize(seeds.len(), 0.0);
        // Rows that are too short for it leave no width, and a later duplicate has none; there are no Verlet lists then.
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

    /// The same without rows, where no seeds are dense; cells are as large as at the last pass, and `area` on average.
    pub(crate) fn choose_evenly(&mut self, seeds: &[P], index: &SeedIndex<P>, area: f64) {
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
    pub(crate) fn look_ahead(&mut self, seeds: &[P], area: f64) -> Option<&[P]> {
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
            let on = (*p - last[i]) * moves;
            let most = AHEAD * share * width[i];
            *p += on * (most / on.length()).min(1.0);
        });
        Some(&self.made_at)
    }

    /// Whether lists about places with this index hold for seeds there.
    pub(crate) fn check(&mut self, seeds: &[P], index: &SeedIndex<P>) -> bool {
        if index.is_even() && index.duplicates() == 0 {
            self.find_close_evenly(index);
            return self.share > 0.0 && self.hold_but_for(0, seeds);
        }
        false
    }

    /// Looking ahead did not do.
    pub(crate) fn be_blind(&mut self, passes: usize) {
        self.leave();
        self.blind = passes;
    }

    /// How much of their last moves but one the seeds made again with their last ones, at most all; nothing if many turned.
    fn goes_on(&self, seeds: &[P]) -> Option<f64> {
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
    fn share_for(&mut self, seeds: &[P]) -> f64 {
        // New seeds are behind the others.
        if self.last.is_empty() || self.last.len() > seeds.len() {
            return 0.0;
        }
        let moved = self.moved(seeds);
        if moved <= FAST { (MOVES * moved).clamp(LEAST, MOST) } else { 0.0 }
    }

    /// What all but some seeds moved less than, in widths.
    fn moved(&mut self, seeds: &[P]) -> f64 {
        let moved = |i: usize| self.last[i].distance(seeds[i]) / self.width[i];
        let indices = (0..self.last.len()).into_par_iter().with_min_len(CHUNK);
        indices.map(moved).collect_into_vec(&mut self.moves);
        let most = self.moves.len() - 1;
        let nth = most - (FAR * most as f64) as usize;
        *self.moves.select_nth_unstable_by(nth, f64::total_cmp).1
    }

    fn begin(&mut self, seeds: &[P], share: f64) {
        self.share = share;
        self.most = if self.even { share * WIDE * self.length } else { f64::INFINITY };
        self.indexed = true;
        seeds.clone_into(&mut self.made_at);
    }

    /// What was chosen, and the lists by chunk of `facets` facets.
    pub(crate) fn split(&mut self, chunks: usize, facets: usize) -> (Verlet<'_, P>, &mut [Lists]) {
        self.facets = facets;
        self.chunks.resize_with(chunks, Lists::default);
        let skin = skin(self.share, self.most, &self.width);
        (Verlet { made_at: &self.made_at, skin, escaped: &self.escaped, even: self.even }, &mut self.chunks)
    }

    /// A pass over these seeds is done, with cells of such areas; whether it made a list for every facet.
    pub(crate) fn end_pass(&mut self, seeds: &[P], area: &[f64], made: bool) {
        std::mem::swap(&mut self.before, &mut self.last);
        seeds.clone_into(&mut self.last);
        area.clone_into(&mut self.area);
        self.there |= made && self.share > 0.0;
    }

    /// The same without rows, with the index of the places where lists are made.
    fn find_close_evenly(&mut self, index: &SeedIndex<P>) {
        self.find_close(|_, p, most, out| {
            index.each_in_box(p.place() - most, p.place() + most, MANY_AROUND, |j, q| {
                if p.distance_squared(q) <= most * most {
                    out.push(j);
                }
            })
        });
    }

    /// Finds pairs of seeds that could meet. Of two, the one with more skin has the other within twice that, among those that
    /// `around` finds; with rows that is before the neighbour that gives its width, as skins are a small part of that. So dense
    /// seeds beside wide cells are looked for from the few seeds of these. There will be no lists where `around` cannot say.
    fn find_close(&mut self, around: impl Fn(u32, P, f64, &mut Vec<u32>) -> bool + Sync) {
        let skin = skin(self.share, self.most, &self.width);
        let seeds = &self.made_at;
        let find = |chunk: usize| {
            let (mut near, mut pairs) = (Vec::new(), Vec::new());
            for i in chunk * CHUNK..seeds.len().min((chunk + 1) * CHUNK) {
                let own = skin.of(i as u32);
                near.clear();
                if !around(i as u32, seeds[i], 2.0 * own, &mut near) {
                    return None;
                }
                let close = |&&j: &&u32| {
                    let other = skin.of(j);
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

/// How far a seed comes in this number of moves, as a multiple of its last one, if each is `goes_on` times the one before.
fn goes_on_for(goes_on: f64, moves: f64) -> f64 {
    match goes_on < 1.0 {
        true => goes_on * (1.0 - goes_on.powf(moves)) / (1.0 - goes_on),
        false => moves,
    }
}

fn skin(share: f64, most: f64, width: &[f64]) -> Skin<'_> {
    Skin { share, width, most }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    #[test]
    fn seeds_that_could_meet_are_found_beside_dense_ones() {
        // A wide grid, and between four of its seeds cells of a fiftieth the width: too many within the widest skin.
        let wide = (0..900).map(|k| DVec3::new((k % 30) as f64, (k / 30) as f64, 0.0));
        let dense = (0..900).map(|k| DVec3::new(14.2 + (k % 30) as f64 / 50.0, 14.2 + (k / 30) as f64 / 50.0, 0.0));
        let last: Vec<DVec3> = wide.chain(dense).collect();
        let area: Vec<f64> = (0..last.len()).map(|i| if i < 900 { 1.0 } else { 1.0 / 2500.0 }).collect();
        let mut lists = VerletLists::default();
        lists.end_pass(&last, &area, false);
        let moved = |i: usize| 0.02 * area[i].sqrt() * DVec3::new((i as f64).sin(), (i as f64).cos(), 0.0);
        let seeds: Vec<DVec3> = last.iter().enumerate().map(|(i, &p)| p + moved(i)).collect();
        let mean = area.iter().sum::<f64>() / area.len() as f64;
        lists.choose_evenly(&seeds, &SeedIndex::new(&seeds), mean);
        assert!((0.1..0.2).contains(&lists.share), "{}", lists.share);
        // So wide that a dense seed could meet a wide one.
        lists.share = 0.4;
        lists.find_close_evenly(&SeedIndex::new(&seeds));
        let skin = skin(lists.share, lists.most, &lists.width);
        let mut want = Vec::new();
        for i in 0..seeds.len() as u32 {
            let meets = |&j: &u32| seeds[i as usize].distance(seeds[j as usize]) <= skin.of(i) + skin.of(j);
            want.extend((0..i).filter(meets).map(|j| [j, i]));
        }
        let mut found: Vec<[u32; 2]> = lists.close.iter().map(|&[i, j]| [i.min(j), i.max(j)]).collect();
        found.sort_unstable();
        want.sort_unstable();
        assert!(found == want && want.iter().any(|&[i, j]| i < 900 && j >= 900), "{} for {}", found.len(), want.len());
    }
}
