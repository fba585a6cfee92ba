//! The cells that meet one facet (\[HYWZ17\], Algorithm 1), from its nearest seed on.
//!
//! Purpose: a seed whose cell holds the facet's centroid, found by walking the neighbour table from a guess and proved by the same
//! radius that ends a clip; the seeds' index answers where the table cannot. From there to all its cells, across the bisectors
//! that bound each piece; and the relaunch of every pair that runs out of something.
//! Invariant: the first cell is that of a nearest seed, never of a later duplicate. Which of several equal ones it is may depend on
//! the guess; the diagram does not. A guess that is to be made better promises nothing. When [`FacetWalker::walk`] returns, every
//! cell that meets the facet was visited once. Capacities only decide how often a pair is clipped, never what comes out of it.
//! Must not know: sums, threads, batches, how seeds that count on a facet were listed.

use std::collections::{HashMap, HashSet};
use std::iter::repeat_n;
use std::ops::Range;

use rayon::prelude::*;

use super::clip::Clipper;
use super::{Capacities, PairStatus, PassStats, Surface, refill};
use crate::knn::{NeighbourRow, NeighbourTable, Point, SeedIndex};
use crate::token::Token;

/// What every walk over one seed set reads.
#[derive(Clone, Copy)]
pub struct Diagram<'a, P: Point = glam::DVec3> {
    /// The surface.
    pub surface: &'a Surface<P>,
    /// Seeds, unit frame.
    pub seeds: &'a [P],
    /// Their index, for rows longer than the table's.
    pub index: &'a SeedIndex<P>,
    /// First rows.
    pub table: &'a NeighbourTable,
    /// First capacities.
    pub capacities: Capacities,
}

/// One thread's scratch memory for walking facets.
#[derive(Default)]
pub struct FacetWalker<P = glam::DVec3> {
    clipper: Clipper<P>,
    cells: CellList,
    long_rows: LongRows,
    listed: Listed,
}

/// Steps of one clip, beside those of its row.
const STEPS: usize = 64;

impl<P: Point> FacetWalker<P> {
    /// Visits every cell that meets `facet` with its non-empty polygon, beginning at `start`, whose cell holds a point of it. A
    /// `list` holds all seeds that could be nearest to some point of the facet; index and table are not read then.
    pub fn walk(
        &mut self,
        list: Option<&[u32]>,
        diagram: Diagram<'_, P>,
        facet: u32,
        start: u32,
        stats: &mut PassStats,
        mut visit: impl FnMut(u32, &Clipper<P>),
    ) {
        self.listed.set(list);
        self.cells.clear();
        self.cells.insert(start);
        let mut slots = diagram.capacities.cells.max(1);
        let mut next = 0;
        let mut found = false;
        let mut others = 0;
        loop {
            let Some(&i) = self.cells.order.get(next) else {
                // Where two seeds are equally far from the centroid but for a rounding, the start's cell may not meet
                // the facet, nor that of the seed that cut it last. One does: its neighbours', most often, or else any.
                let (row, rest) = match list {
                    None => (diagram.table.row(start).0, diagram.seeds.len()),
                    Some(list) => (list, 0),
                };
                let all = row.len() + rest;
                let no_area = || diagram.surface.facet_area(facet) == 0.0;
                if found || others == all || no_area() || self.clipper.is_stopped_after(1) {
                    break;
                }
                self.cells.insert(row.get(others).copied().unwrap_or((others.max(row.len()) - row.len()) as u32));
                others += 1;
                continue;
            };
            next += 1;
            let status = self.clip_by(list.is_some(), diagram, facet, i, stats);
            if status == PairStatus::NonFinite && self.clipper.token.is_told_to_stop() {
                break;
            }
            let polygon = self.clipper.polygon();
            if polygon.is_empty() {
                if !found {
                    // A start that only touches the facet: the seed that took the last of it is nearer.
                    self.cells.insert(self.clipper.cutter);
                }
                continue;
            }
            found = true;
            stats.pairs += 1;
            visit(i, &self.clipper);
            for v in polygon {
                if super::cells::facet_edge(v.edge).is_none() {
                    self.cells.insert(v.edge);
                }
            }
            while self.cells.order.len() > slots {
                // The list grows in place, so nothing has to be clipped again.
                stats.relaunched_cells += (self.cells.order.len() - slots) as u64;
                slots *= 2;
            }
        }
    }

    /// Clips one pair with as many neighbours and polygon vertices as it takes; `list` as for [`Self::walk`]. Returns the last
    /// status: `Done`, or `NonFinite` with an empty polygon, where the token is stopped too.
    pub fn clip(
        &mut self,
        list: Option<&[u32]>,
        diagram: Diagram<'_, P>,
        facet: u32,
        i: u32,
        stats: &mut PassStats,
    ) -> PairStatus {
        self.listed.set(list);
        self.clip_by(list.is_some(), diagram, facet, i, stats)
    }

    fn clip_by(
        &mut self,
        listed: bool,
        diagram: Diagram<'_, P>,
        facet: u32,
        i: u32,
        stats: &mut PassStats,
    ) -> PairStatus {
        let Diagram { surface, seeds, index, table, capacities } = diagram;
        let mut slots = capacities.polygon.max(4);
        // Of a table without rows there is nothing to try first.
        let no_rows = !listed && table.is_empty();
        let mut k = if no_rows { capacities.neighbours.max(1) } else { 0 };
        loop {
            let row = match k {
                _ if listed => self.listed.row(seeds, i, k > 0),
                0 => table.row(i),
                _ => self.long_rows.row(index, i, k),
            };
            // Where many seeds are near one another, rows are long.
            if self.clipper.is_stopped_after(row.0.len() + STEPS) {
                self.clipper.polygon.clear();
                return PairStatus::NonFinite;
            }
            match self.clipper.clip(surface, facet, seeds, i, row, slots) {
                PairStatus::NeighboursExhausted => {
                    // Not from what came alone: a row without its ties at the end may be as short as the last, or empty.
                    k = (k.max(row.0.len()).max(capacities.neighbours).max(1) + 1) * 4;
                    stats.relaunched_neighbours += 1;
                }
                PairStatus::PolygonOverflow => {
                    slots *= 2;
                    stats.relaunched_polygon += 1;
                }
                status => return status,
            }
        }
    }

    /// Forgets rows of earlier seeds. From now on walks end early where `token` is stopped; check it before using what they found.
    pub fn reset(&mut self, token: &Token) {
        self.long_rows = LongRows::default();
        self.clipper.token = token.clone();
    }

    /// Whether walks are to end.
    pub fn is_stopped(&mut self) -> bool {
        self.clipper.is_stopped_after(Token::STRIDE)
    }

    /// The clipper with the polygon of the last pair.
    pub fn clipper(&self) -> &Clipper<P> {
        &self.clipper
    }
}

/// All seeds that count on one facet, and rows of them.
#[derive(Default)]
struct Listed {
    seeds: Vec<u32>,
    /// The others from each of them, nearest first, one after the other; as many as are sorted.
    rows: Vec<u32>,
    sorted: Vec<usize>,
    keys: Vec<(f64, u32)>,
}

impl Listed {
    /// A cell has hardly more neighbours on a facet.
    const FIRST: usize = 16;

    fn set(&mut self, list: Option<&[u32]>) {
        let Some(list) = list else { return };
        list.clone_into(&mut self.seeds);
        refill(&mut self.sorted, repeat_n(0, list.len()));
        self.rows.resize(list.len() * list.len(), 0);
    }

    /// The nearest others, in the order of a table's row, or `all`; and whether these are all. A cut that changes
    /// nothing apart, a walk does the same with either.
    fn row<P: Point>(&mut self, seeds: &[P], i: u32, all: bool) -> (&[u32], bool) {
        // A walk visits listed seeds alone.
        let Some(at) = self.seeds.iter().position(|&j| j == i) else { return (&[], true) };
        let n = self.seeds.len() - 1;
        let row = &mut self.rows[at * n..(at + 1) * n];
        let wanted = if all { n } else { n.min(Self::FIRST) };
        if self.sorted[at] < wanted {
            self.keys.clear();
            let origin = seeds[i as usize];
            let key = |&j: &u32| (origin.distance_squared(seeds[j as usize]), j);
            self.keys.extend(self.seeds.iter().filter(|&&j| j != i).map(key));
            let order = |a: &(f64, u32), b: &(f64, u32)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
            if wanted < n {
                self.keys.select_nth_unstable_by(wanted, order);
            }
            self.keys[..wanted].sort_unstable_by(order);
            for (slot, key) in row.iter_mut().zip(&self.keys[..wanted]) {
                *slot = key.1;
            }
            self.sorted[at] = wanted;
        }
        (&row[..wanted], wanted == n)
    }
}

/// Cells of one facet in the order they were found, each once.
#[derive(Default)]
struct CellList {
    order: Vec<u32>,
    /// Takes over from a linear search where a facet meets many cells.
    set: HashSet<u32>,
}

impl CellList {
    const LINEAR: usize = 24;

    fn clear(&mut self) {
        self.order.clear();
        self.set.clear();
    }

    fn insert(&mut self, seed: u32) {
        if self.order.len() < Self::LINEAR {
            if !self.order.contains(&seed) {
                self.order.push(seed);
            }
            return;
        }
        if self.set.is_empty() {
            self.set.extend(&self.order);
        }
        if self.set.insert(seed) {
            self.order.push(seed);
        }
    }
}

/// Rows longer than the table's, kept for the neighbouring facets of the same cell.
#[derive(Default)]
struct LongRows {
    rows: HashMap<u32, (usize, NeighbourRow)>,
    stored: usize,
}

impl LongRows {
    /// Most neighbours that are kept: 4 MiB.
    const LIMIT: usize = 1 << 20;

    fn row<P: Point>(&mut self, index: &SeedIndex<P>, i: u32, k: usize) -> (&[u32], bool) {
        if self.stored > Self::LIMIT {
            self.rows.clear();
            self.stored = 0;
        }
        let entry = self.rows.entry(i).or_default();
        if entry.0 < k {
            self.stored -= entry.1.seeds.len();
            index.row(i, k, &mut entry.1);
            entry.0 = k;
            self.stored += entry.1.seeds.len();
        }
        (&entry.1.seeds, entry.1.complete)
    }
}

/// Facets per task. Part of no result.
const CHUNK: usize = 512;
/// Facets between two looks at the token.
const ASKED: usize = 32;

/// The first cells of a range of facets, kept as guesses for when the seeds have moved.
#[derive(Debug, Default)]
pub struct Starts {
    facets: Range<u32>,
    seeds: Vec<u32>,
}

impl Starts {
    /// Finds those of `facets` on all threads of the present pool, from the last answer or from the one before where that is
    /// near, or else by the index. Ends early where `token` is stopped; the answers are then of no use.
    pub fn find<P: Point>(&mut self, diagram: Diagram<'_, P>, facets: Range<u32>, token: &Token) -> &mut [u32] {
        let guessed = self.facets == facets;
        self.seeds.resize(facets.len(), 0);
        self.seeds.par_chunks_mut(CHUNK).enumerate().for_each(|(c, part)| {
            let mut last = None;
            for (k, start) in part.iter_mut().enumerate() {
                if k.is_multiple_of(ASKED) && token.is_stopped() {
                    return;
                }
                let q = diagram.surface.centroid(facets.start + (c * CHUNK + k) as u32);
                let old = Some(*start).filter(|&s| guessed && (s as usize) < diagram.seeds.len());
                // Facets in a row are often beside each other.
                *start = match old.or_else(|| last.filter(|&s| is_beside(diagram, q, s))) {
                    Some(guess) => nearest(diagram, q, guess),
                    None => diagram.index.nearest(q),
                };
                last = Some(*start);
            }
        });
        self.facets = facets;
        &mut self.seeds
    }
}

/// Whether a walk from seed `s` to `q` is short: `q` is no farther away than the last neighbour in the table.
fn is_beside<P: Point>(diagram: Diagram<'_, P>, q: P, s: u32) -> bool {
    let here = diagram.seeds[s as usize];
    let last = diagram.table.row(s).0.last();
    last.is_some_and(|&j| q.distance_squared(here) <= here.distance_squared(diagram.seeds[j as usize]))
}

/// A nearest seed of `q`, from the guess `from`. Seeds nearer to q than x_i lie within 2|q - x_i|
/// of x_i, so the row of i, nearest first, need not be read beyond that.
pub(super) fn nearest<P: Point>(diagram: Diagram<'_, P>, q: P, from: u32) -> u32 {
    let Diagram { seeds, index, table, .. } = diagram;
    let mut i = first_duplicate(diagram, from);
    let mut best = q.distance_squared(seeds[i as usize]);
    'walk: loop {
        let (row, complete) = table.row(i);
        let origin = seeds[i as usize];
        for &j in row {
            let x = seeds[j as usize];
            if x.distance_squared(origin) > 4.0 * best {
                return i;
            }
            let distance = q.distance_squared(x);
            if distance < best {
                (i, best) = (j, distance);
                continue 'walk;
            }
        }
        return if complete { i } else { index.nearest(q) };
    }
}

/// The earliest seed at the place of seed `i`. A later one has no cell, and no neighbour but it.
fn first_duplicate<P: Point>(diagram: Diagram<'_, P>, i: u32) -> u32 {
    match diagram.table.row(i).0 {
        [first, ..] if diagram.seeds[*first as usize] == diagram.seeds[i as usize] => *first,
        _ => i,
    }
}
