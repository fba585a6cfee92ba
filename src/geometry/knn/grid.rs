//! A uniform grid over the seeds.
//!
//! Purpose: rows and nearest seeds from the few cells around a place, where seeds are spread evenly enough over a surface.
//! Invariant: an answer is given only if no seed outside the searched cells can belong to it; it is then the one that
//! [`super`] promises. Otherwise the caller must search. Must not know: the kd-tree.

use rayon::prelude::*;

use super::{NeighbourRow, Threads, squared_distance};

type Point = [f64; 3];

/// Seeds sorted by their cell.
#[derive(Default)]
pub(super) struct Grid {
    origin: [f64; 3],
    /// Cells per unit of length.
    inverse: f64,
    cells: [usize; 3],
    /// Seeds that share a seed's cell, on average.
    occupancy: f64,
    /// First place of each cell, x running fastest, and the end of the last.
    begin: Vec<u32>,
    /// Seed at each place; the hidden ones at the end.
    order: Vec<u32>,
    /// Position at each place, without the hidden ones.
    points: Vec<Point>,
    place: Vec<u32>,
}

/// One thread's memory for finding rows: squared distance (upper half of its bits) and place.
#[derive(Default)]
pub(super) struct Scratch {
    keys: Vec<u64>,
    ranges: Vec<(u32, u32)>,
}

/// A block of cells, both ends included.
#[derive(Clone, Copy)]
struct Block {
    low: [usize; 3],
    high: [usize; 3],
}

impl Block {
    /// Lines of cells along x.
    fn lines(self) -> usize {
        (self.high[2] - self.low[2] + 1) * (self.high[1] - self.low[1] + 1)
    }
}

/// Mean number of seeds in a seed's cell, of 2.5 spacings: the cells around hold the 16 nearest of all, the 24 of most.
const OCCUPANCY: f64 = 6.0;
/// Occupancy above which rows of neighbours are found sooner than all seeds in a box.
const EVEN: f64 = 30.0;
/// Occupancy above which a tree is faster.
const DENSE: f64 = 64.0;
/// Cells per seed, at most.
const CELLS: usize = 8;
/// Cells along an axis, at most, so that a place in the grid has 30 bits left for its fraction.
const ALONG: f64 = (1 << 20) as f64;
/// Relative reduction of the distances that cells prove: far more than the rounding of a place in the grid.
const ROUNDING: f64 = 1e-6;
/// Radii of the blocks around a seed's cell, in cells, tried one after the other.
const RINGS: [usize; 8] = [1, 2, 3, 4, 6, 8, 11, 15];
/// More seeds than this in a block, for each one wanted: a tree is faster.
const CANDIDATES: usize = 64;
/// Seeds per task.
const CHUNK: usize = 4096;
/// The part of a key that is the distance.
const DISTANCE: u64 = !0 << 32;

impl Grid {
    /// A grid over finite points; `None` if a grid of equal cells does not suit them.
    pub(super) fn new(points: &[Point], threads: Threads) -> Option<Self> {
        let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for p in points {
            for c in 0..3 {
                low[c] = low[c].min(p[c]);
                high[c] = high[c].max(p[c]);
            }
        }
        let extent = [0, 1, 2].map(|c| high[c] - low[c]);
        let longest = extent.iter().fold(0.0, |a: f64, &b| a.max(b));
        // Squares of distances must neither overflow nor vanish; and one place needs no grid.
        if !(1e-100..1e100).contains(&longest) {
            return None;
        }
        let n = points.len();
        // Half of the box's surface: about the area of its content, exact for a sheet.
        let area = extent[0] * extent[1] + extent[1] * extent[2] + extent[2] * extent[0];
        let mut size = 3.0 * (area / n as f64).sqrt();
        let mut grid = Self { origin: low, ..Self::default() };
        let mut cell = Vec::new();
        for last in [false, false, true] {
            size = grid.lay(size, extent, longest, n);
            grid.sort_into(points, &mut cell, threads);
            let occupancy = grid.begin.windows(2).map(|w| f64::from(w[1] - w[0]).powi(2)).sum::<f64>() / n as f64;
            if last || (OCCUPANCY / 1.25..OCCUPANCY * 1.25).contains(&occupancy) {
                if occupancy > DENSE {
                    return None;
                }
                grid.occupancy = occupancy;
                break;
            }
            size *= (OCCUPANCY / occupancy).sqrt();
        }
        grid.place_all(points, &cell, threads);
        Some(grid)
    }

    /// Chooses the cells: of `size`, or larger where there would be too many. Returns their size.
    fn lay(&mut self, size: f64, extent: [f64; 3], longest: f64, n: usize) -> f64 {
        let mut size = size.max(longest / ALONG);
        loop {
            let cells = extent.map(|e| (e / size).floor() + 1.0);
            if cells.iter().product::<f64>() <= (n * CELLS + 64) as f64 {
                self.cells = cells.map(|c| c as usize);
                self.inverse = 1.0 / size;
                return size;
            }
            size *= 1.125;
        }
    }

    /// Finds the cell of every point and counts them: `begin` gets the end of each cell.
    fn sort_into(&mut self, points: &[Point], cell: &mut Vec<u32>, threads: Threads) {
        let of = |p: &Point| {
            let [x, y, z] = self.cell(self.at(p));
            ((z * self.cells[1] + y) * self.cells[0] + x) as u32
        };
        *cell = mapped(points, threads, of);
        self.begin.clear();
        self.begin.resize(self.cells.iter().product::<usize>() + 1, 0);
        for &c in cell.iter() {
            self.begin[c as usize + 1] += 1;
        }
        let mut sum = 0;
        for b in &mut self.begin {
            sum += *b;
            *b = sum;
        }
    }

    /// Gives every point its place, in the order of the indices within a cell.
    fn place_all(&mut self, points: &[Point], cell: &[u32], threads: Threads) {
        let mut next = self.begin.clone();
        self.order.resize(points.len(), 0);
        self.place.clear();
        self.place.extend(cell.iter().enumerate().map(|(i, &c)| {
            let at = next[c as usize];
            next[c as usize] += 1;
            self.order[at as usize] = i as u32;
            at
        }));
        self.points = mapped(&self.order, threads, |&i| points[i as usize]);
    }

    pub(super) fn is_even(&self) -> bool {
        self.occupancy <= EVEN
    }

    /// `(later, earliest)` for every seed that lies exactly on an earlier one, in order of `later`.
    pub(super) fn duplicates(&self) -> Vec<(u32, u32)> {
        let mut pairs = Vec::new();
        for cell in self.begin.windows(2) {
            let (begin, end) = (cell[0] as usize, cell[1] as usize);
            for later in begin + 1..end {
                if let Some(first) = (begin..later).find(|&p| self.points[p] == self.points[later]) {
                    pairs.push((self.order[later], self.order[first]));
                }
            }
        }
        pairs.sort_unstable();
        pairs
    }

    /// Takes the later duplicates out of their cells.
    pub(super) fn hide(&mut self, pairs: &[(u32, u32)]) {
        let mut hidden = vec![false; self.order.len()];
        for &(later, _) in pairs {
            hidden[self.place[later as usize] as usize] = true;
        }
        let (mut kept, mut from) = (0, 0);
        for c in 1..self.begin.len() {
            let end = self.begin[c] as usize;
            for (p, _) in (from..end).zip(&hidden[from..end]).filter(|(_, hidden)| !**hidden) {
                (self.order[kept], self.points[kept]) = (self.order[p], self.points[p]);
                kept += 1;
            }
            from = end;
            self.begin[c] = kept as u32;
        }
        self.points.truncate(kept);
        self.order.truncate(kept);
        self.order.extend(pairs.iter().map(|p| p.0));
        for (p, &i) in self.order.iter().enumerate() {
            self.place[i as usize] = p as u32;
        }
    }

    pub(super) fn order(&self) -> &[u32] {
        &self.order
    }

    /// The row of seed `i`, not hidden, about `k` long and at least about `least`; `false` if the cells do not prove it.
    pub(super) fn row(
        &self,
        i: u32,
        (least, k): (usize, usize),
        scratch: &mut Scratch,
        out: &mut NeighbourRow,
    ) -> bool {
        let (own, n) = (self.place[i as usize], self.points.len());
        let p = &self.points[own as usize];
        let wanted = k.saturating_add(1);
        out.complete = wanted >= n;
        let enough = wanted.min(n);
        let least = enough.min(least.saturating_add(1));
        let at = self.at(p);
        let cell = self.cell(at);
        if out.complete {
            scratch.ranges.clear();
            scratch.ranges.push((0, n as u32));
            self.read(p, f64::INFINITY, scratch);
        } else {
            let proved = RINGS.iter().any(|&ring| {
                let block = self.around(cell, ring);
                let count = self.ranges(block, &mut scratch.ranges);
                if count < least || count > enough.saturating_mul(CANDIDATES) {
                    return false;
                }
                self.read(p, self.proved(at, block), scratch);
                scratch.keys.len() >= least
            });
            if !proved {
                return false;
            }
        }
        let enough = enough.min(scratch.keys.len());
        self.arrange(p, enough, &mut scratch.keys);
        let mut keys = &scratch.keys[..];
        if !out.complete {
            // All seeds nearer than the last one are present; others may be as far.
            let distance = |key: u64| squared_distance(p, &self.points[key as u32 as usize]);
            let last = distance(keys[enough - 1]);
            keys = &keys[..enough - 1];
            while let [rest @ .., key] = keys
                && distance(*key) >= last
            {
                keys = rest;
            }
        }
        out.seeds.clear();
        out.seeds.extend(keys.iter().map(|&k| k as u32).filter(|&q| q != own).map(|q| self.order[q as usize]));
        true
    }

    /// Sorts the `enough` nearest of `keys` to the front; others may follow.
    fn arrange(&self, p: &Point, enough: usize, keys: &mut Vec<u64>) {
        // Not many more are sorted sooner than they are set apart.
        if keys.len() > 2 * enough {
            let last = *keys.select_nth_unstable(enough - 1).1 & DISTANCE;
            let mut end = enough;
            for q in enough..keys.len() {
                if keys[q] & DISTANCE == last {
                    keys.swap(q, end);
                    end += 1;
                }
            }
            keys.truncate(end);
        }
        keys.sort_unstable();
        // If the upper halves are equal, the whole distance decides, and then the seed.
        let whole = |key: u64| {
            let q = key as u32 as usize;
            (squared_distance(p, &self.points[q]), self.order[q])
        };
        if keys.windows(2).any(|w| (w[0] ^ w[1]) & DISTANCE == 0) {
            for run in keys.chunk_by_mut(|a, b| (a ^ b) & DISTANCE == 0).filter(|run| run.len() > 1) {
                run.sort_unstable_by(|&a, &b| {
                    let (a, b) = (whole(a), whole(b));
                    a.0.total_cmp(&b.0).then(a.1.cmp(&b.1))
                });
            }
        }
    }

    /// The only nearest seed of a point; `None` if the cells around it do not prove it, or if it is not unique.
    pub(super) fn nearest(&self, p: &Point) -> Option<u32> {
        let at = self.at(p);
        let cell = self.cell(at);
        let mut best = self.first_of_rings(cell, p, 3);
        // No seed that is nearer lies outside these cells.
        let reach = best.squared.sqrt() * self.inverse * (1.0 + ROUNDING) + ROUNDING;
        let block = Block { low: self.cell(at.map(|x| x - reach)), high: self.cell(at.map(|x| x + reach)) };
        if best.squared == f64::INFINITY || block.lines() > 25 {
            return None;
        }
        best.several = false;
        self.visit(block, p, &mut best);
        (!best.several).then(|| self.order[best.place as usize])
    }

    /// A seed of the cells around a point, the nearest of the first that have any; `None` if none has.
    pub(super) fn near(&self, p: &Point) -> Option<u32> {
        let cell = self.cell(self.at(p));
        let best = self.first_of_rings(cell, p, 2);
        (best.squared < f64::INFINITY).then(|| self.order[best.place as usize])
    }

    /// Calls `found` with seeds and places of all cells that meet a box; `false` early if seeds or lines of cells exceed `most`.
    #[inline(always)]
    pub(super) fn in_box(&self, low: &Point, high: &Point, most: usize, mut found: impl FnMut(u32, &Point)) -> bool {
        // A place and an end of the box may be rounded apart by this.
        let (low, high) = (self.at(low).map(|x| x - ROUNDING), self.at(high).map(|x| x + ROUNDING));
        let block = Block { low: self.cell(low), high: self.cell(high) };
        let mut left = most;
        if block.lines() > most {
            return false;
        }
        for z in block.low[2]..=block.high[2] {
            for y in block.low[1]..=block.high[1] {
                let (begin, end) = self.range(block, y, z);
                let places = begin as usize..end as usize;
                let Some(fewer) = left.checked_sub(places.len()) else { return false };
                left = fewer;
                self.order[places.clone()].iter().zip(&self.points[places]).for_each(|(&seed, p)| found(seed, p));
            }
        }
        true
    }

    /// The nearest seed of the first block around a cell, with at most `rings` rings, that has any.
    fn first_of_rings(&self, cell: [usize; 3], p: &Point, rings: usize) -> Nearest {
        let mut best = Nearest { squared: f64::INFINITY, place: 0, several: false };
        for ring in 0..rings {
            self.visit(self.around(cell, ring), p, &mut best);
            if best.squared < f64::INFINITY {
                break;
            }
        }
        best
    }

    fn visit(&self, block: Block, p: &Point, best: &mut Nearest) {
        for z in block.low[2]..=block.high[2] {
            for y in block.low[1]..=block.high[1] {
                let (begin, end) = self.range(block, y, z);
                for place in begin..end {
                    let squared = squared_distance(p, &self.points[place as usize]);
                    if squared < best.squared {
                        *best = Nearest { squared, place, several: false };
                    } else if squared == best.squared && place != best.place {
                        best.several = true;
                    }
                }
            }
        }
    }

    /// Coordinates in cells.
    fn at(&self, p: &Point) -> [f64; 3] {
        [0, 1, 2].map(|c| (p[c] - self.origin[c]) * self.inverse)
    }

    /// The cell there, or the nearest one.
    fn cell(&self, at: [f64; 3]) -> [usize; 3] {
        // A cast turns negative numbers and NaN into zero.
        [0, 1, 2].map(|c| (at[c] as usize).min(self.cells[c] - 1))
    }

    fn around(&self, cell: [usize; 3], ring: usize) -> Block {
        Block {
            low: cell.map(|c| c.saturating_sub(ring)),
            high: [0, 1, 2].map(|c| (cell[c] + ring).min(self.cells[c] - 1)),
        }
    }

    /// No seed outside the block is within this distance; squared.
    fn proved(&self, at: [f64; 3], block: Block) -> f64 {
        let mut reach = f64::INFINITY;
        for (c, at) in at.into_iter().enumerate() {
            if block.low[c] > 0 {
                reach = reach.min(at - block.low[c] as f64);
            }
            if block.high[c] + 1 < self.cells[c] {
                reach = reach.min((block.high[c] + 1) as f64 - at);
            }
        }
        let reach = (reach * (1.0 - ROUNDING) / self.inverse).max(0.0);
        reach * reach
    }

    /// The places of the block's cells at `y` and `z`: one range, as x runs fastest.
    fn range(&self, block: Block, y: usize, z: usize) -> (u32, u32) {
        let line = (z * self.cells[1] + y) * self.cells[0];
        (self.begin[line + block.low[0]], self.begin[line + block.high[0] + 1])
    }

    /// Appends all places of a block; returns their number.
    fn ranges(&self, block: Block, out: &mut Vec<(u32, u32)>) -> usize {
        out.clear();
        let mut count = 0;
        for z in block.low[2]..=block.high[2] {
            for y in block.low[1]..=block.high[1] {
                let range = self.range(block, y, z);
                if range.0 < range.1 {
                    count += (range.1 - range.0) as usize;
                    out.push(range);
                }
            }
        }
        count
    }

    /// The keys of all places in the ranges within the given squared distance.
    fn read(&self, p: &Point, within: f64, scratch: &mut Scratch) {
        let keys = &mut scratch.keys;
        let count: u32 = scratch.ranges.iter().map(|r| r.1 - r.0).sum();
        keys.clear();
        keys.resize(count as usize, 0);
        let mut found = 0;
        for &(begin, end) in &scratch.ranges {
            for (q, place) in self.points[begin as usize..end as usize].iter().zip(begin..) {
                // Always written, seldom kept: no branch to guess.
                let squared = squared_distance(p, q);
                keys[found] = (squared.to_bits() & DISTANCE) | u64::from(place);
                found += usize::from(squared <= within);
            }
        }
        keys.truncate(found);
    }
}

fn mapped<T: Sync, U: Send>(items: &[T], threads: Threads, map: impl Fn(&T) -> U + Sync + Send) -> Vec<U> {
    match threads {
        Threads::One => items.iter().map(map).collect(),
        Threads::Pool => items.par_iter().with_min_len(CHUNK).map(map).collect(),
    }
}

struct Nearest {
    squared: f64,
    place: u32,
    /// Whether another one is as near.
    several: bool,
}
