//! Some facets, one task's share.
//!
//! Purpose: what a task writes down of its facets in order, and the sums of what all tasks wrote.
//! Facets are taken in groups of as many members.
//! Invariant: every cell adds its pieces up in the order of facets, whatever the number of threads and the width of a
//! processor's registers.
//! Must not know: how tasks are shared out.

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use super::facets::{Found, MEMBERS};
use super::gather::{Few, Gatherer, Slack};
use super::groups::{Chooser, Listed, Thin, choose_members};
use super::lanes::{Number, Row, WIDEST};
use super::lists::Lists;
use super::moments::{UNIFORM, WEIGHTED};
use crate::rvd::clip::{Clipper, Integrals};
use crate::rvd::incident::{Diagram, FacetWalker};
use crate::rvd::{Capacities, CellSums, PassStats, PieceBatch, start};

/// What one task found. Reused from wave to wave.
#[derive(Default)]
pub(super) struct Chunk {
    /// In the order of facets, of as many seeds as each has members; [`NONE`] where a member has no piece.
    seeds: Vec<u32>,
    integrals: Vec<Integrals>,
    /// Those of facets that were walked,
    walked: Vec<(u32, Integrals)>,
    /// and before which of the others they come.
    inserts: Vec<Insert>,
    pub pieces: PieceBatch,
    pub stats: PassStats,
    /// Facets that have no list that could be kept.
    pub unlisted: u64,
}

const NONE: u32 = u32::MAX;

struct Insert {
    before: usize,
    end: usize,
}

/// One thread's scratch memory.
#[derive(Default)]
pub(super) struct Walkers {
    gatherer: Gatherer,
    /// Lists before those of them that are to be kept are made shorter.
    lists: Lists,
    chooser: Chooser,
    found: Found,
    walker: FacetWalker,
    /// Where each facet's integrals begin.
    begin: Vec<u32>,
    to_walk: Vec<u32>,
    /// Pieces that are clipped alone: facet, and place among the integrals.
    to_clip: Vec<(u32, usize)>,
}

struct Divide<'a> {
    chunk: &'a mut Chunk,
    walkers: &'a mut Walkers,
    listed: Listed<'a>,
}

impl WithSimd for Divide<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { chunk, walkers, listed } = self;
        choose_members(simd, &mut walkers.chooser, listed);
        chunk.make_room(walkers, listed);
        if listed.diagram.surface.is_uniform() {
            chunk.divide::<S, UNIFORM>(simd, walkers, listed);
        } else {
            chunk.divide::<S, WEIGHTED>(simd, walkers, listed);
        }
    }
}

impl Chunk {
    fn begin(&mut self) {
        self.walked.clear();
        self.inserts.clear();
        self.pieces.clear();
        self.stats = PassStats::default();
        self.unlisted = 0;
    }

    /// Integrals over the pieces of the facets from `first` on, as many as there are `starts`, which become the
    /// facets' nearest seeds. Their lists are kept where there is slack.
    pub(super) fn sum(
        &mut self,
        walkers: &mut Walkers,
        (diagram, slack, by_rows): (Diagram<'_>, Slack<'_>, bool),
        first: u32,
        kept: &mut Lists,
        starts: &mut [u32],
        capacities: Capacities,
    ) {
        let mut lists = std::mem::take(&mut walkers.lists);
        lists.clear();
        let surface = diagram.surface;
        let most = if by_rows { Few::TO_DIVIDE } else { Few::TO_WALK };
        let mut unlisted = 0;
        for (facet, start) in (first..).zip(&mut *starts) {
            if surface.skips(facet as usize) {
                lists.push([]);
                continue;
            }
            let [a, b, c] = surface.facets()[facet as usize];
            let positions = surface.positions();
            let corner = [positions[a as usize], positions[b as usize], positions[c as usize]];
            let gatherer = &mut walkers.gatherer;
            let centroid = surface.centroid(facet);
            let (nearest, mut few) = gatherer.gather(diagram, (slack, most), &corner, centroid, *start);
            *start = nearest;
            if !few && slack.share > 0.0 {
                // Whether there are too many does not depend on what was before.
                unlisted += 1;
                (_, few) = gatherer.gather(diagram, (Slack::NONE, most), &corner, centroid, *start);
            }
            lists.push(gatherer.list().iter().copied().take(if few { usize::MAX } else { 0 }));
        }
        let mut of_chunk = &lists;
        if slack.share > 0.0 {
            let listed = Listed { diagram, first, starts, lists: &lists, capacities, by_rows };
            Arch::new().dispatch(Thin { chooser: &mut walkers.chooser, listed, slack, out: kept });
            of_chunk = kept;
        }
        self.sum_listed(walkers, Listed { diagram, first, starts, lists: of_chunk, capacities, by_rows });
        self.unlisted = unlisted;
        walkers.lists = lists;
    }

    /// The same from lists that hold.
    pub(super) fn sum_listed(&mut self, walkers: &mut Walkers, listed: Listed<'_>) {
        self.begin();
        walkers.chooser.begin(listed);
        Arch::new().dispatch(Divide { chunk: self, walkers, listed });
        self.walk(walkers, listed);
    }

    /// Gives every facet with a usable number of members room for their integrals; the others are to be walked.
    fn make_room(&mut self, walkers: &mut Walkers, listed: Listed<'_>) {
        let Walkers { chooser: Chooser { members, .. }, begin, to_walk, to_clip, .. } = walkers;
        begin.clear();
        to_walk.clear();
        to_clip.clear();
        let mut end = 0;
        for (at, members) in members.iter().enumerate() {
            begin.push(end);
            let n = members.count_ones();
            if (1..=MEMBERS as u32).contains(&n) {
                end += n;
            } else if !listed.diagram.surface.skips(listed.first as usize + at) {
                to_walk.push(at as u32);
            }
        }
        // Each gets its value, so that what is there from an earlier wave may stay until then.
        self.seeds.resize(end as usize, NONE);
        self.integrals.resize(end as usize, Integrals::default());
    }

    /// Divides all facets with members among them.
    #[inline(always)]
    fn divide<S: Simd, const N: usize>(&mut self, simd: S, walkers: &mut Walkers, listed: Listed<'_>) {
        let Walkers { chooser: Chooser { facets, groups, members, long }, found, begin, to_walk, to_clip, .. } =
            walkers;
        let Listed { diagram, first, .. } = listed;
        groups.sort(MEMBERS, members.iter().map(|m| m.count_ones() as usize));
        let mut weight = [Row([1.0; WIDEST]); 3];
        for n in 1..=MEMBERS {
            for group in groups.of(n).chunks(Number::<S>::LANES) {
                for lane in 0..Number::<S>::LANES {
                    let at = group[lane.min(group.len() - 1)];
                    facets.set_corners(lane, diagram.surface, first + at);
                    if N == WEIGHTED {
                        let vertex = diagram.surface.facets()[(first + at) as usize];
                        for (weight, v) in weight.iter_mut().zip(vertex) {
                            weight.0[lane % WIDEST] = diagram.surface.weights()[v as usize];
                        }
                    }
                    let list = long.list(listed, at as usize);
                    let mut seeds = [0; MEMBERS];
                    let mut left = members[at as usize];
                    for k in 0..n {
                        let seed = list[left.trailing_zeros() as usize];
                        left &= left - 1;
                        // In the order of their numbers, in which kept lists are already.
                        let mut k = k;
                        while k > 0 && seeds[k - 1] > seed {
                            seeds[k] = seeds[k - 1];
                            k -= 1;
                        }
                        seeds[k] = seed;
                    }
                    self.seeds[begin[at as usize] as usize..][..n].copy_from_slice(&seeds[..n]);
                    for (k, &seed) in seeds[..n].iter().enumerate() {
                        facets.set_seed(lane, k, diagram.seeds[seed as usize]);
                    }
                }
                facets.divide::<S, N>(simd, n, &weight, found);
                for (lane, &at) in group.iter().enumerate() {
                    let first = begin[at as usize] as usize;
                    let (seeds, slots) = (&mut self.seeds[first..][..n], &mut self.integrals[first..][..n]);
                    if found.unsure.0[lane] != 0.0 {
                        seeds.fill(NONE);
                        to_walk.push(at);
                        continue;
                    }
                    for (k, ((seed, slot), piece)) in seeds.iter_mut().zip(slots).zip(&found.pieces).enumerate() {
                        match piece.get(lane) {
                            Some(_) if piece.is_small(lane) => to_clip.push((at, first + k)),
                            Some(integrals) => {
                                *slot = integrals;
                                self.stats.pairs += 1;
                            }
                            None => *seed = NONE,
                        }
                    }
                }
            }
        }
    }

    /// Clips the pieces and walks the facets that are left, among their members alone: what else a list holds would
    /// change roundings.
    fn walk(&mut self, walkers: &mut Walkers, listed: Listed<'_>) {
        let Walkers { chooser: Chooser { members, long, .. }, walker, to_walk, to_clip, begin, .. } = walkers;
        let Listed { diagram, first, starts, lists, capacities, by_rows } = listed;
        let Self { seeds, integrals, walked, inserts, stats, .. } = self;
        for &(at, slot) in &*to_clip {
            let among = long.among(listed, at as usize, members[at as usize]);
            let (seed, sum) = (&mut seeds[slot], &mut integrals[slot]);
            walker.clip_listed(&among.seeds, diagram, first + at, *seed, capacities, stats);
            if walker.clipper().polygon().is_empty() {
                *seed = NONE;
            } else {
                *sum = walker.clipper().integrals();
                stats.pairs += 1;
            }
        }
        to_walk.sort_unstable();
        for &at in &*to_walk {
            let (facet, at) = (first + at, at as usize);
            let centroid = diagram.surface.centroid(facet);
            let visit = |i: u32, clipper: &Clipper| walked.push((i, clipper.integrals()));
            // Who has many members was not tried, and is found by rows, if there are any.
            let many = !(1..=MEMBERS as u32).contains(&members[at].count_ones());
            if lists.get(at).is_empty() || many && by_rows {
                let start = start::nearest(diagram, centroid, starts[at]);
                walker.walk(diagram, facet, start, capacities, stats, visit);
            } else {
                let among = long.among(listed, at, members[at]);
                let nearest = among.nearest(diagram, centroid);
                walker.walk_listed(&among.seeds, diagram, facet, nearest, capacities, stats, visit);
            }
            inserts.push(Insert { before: begin[at] as usize, end: walked.len() });
        }
    }

    /// All integrals, in the order of facets.
    #[inline(always)]
    fn each(&self, mut visit: impl FnMut(u32, &Integrals)) {
        let (mut at, mut from) = (0, 0);
        for insert in &self.inserts {
            let before = self.seeds[at..insert.before].iter().zip(&self.integrals[at..insert.before]);
            before.for_each(|(seed, sum)| visit(*seed, sum));
            self.walked[from..insert.end].iter().for_each(|(seed, sum)| visit(*seed, sum));
            (at, from) = (insert.before, insert.end);
        }
        self.seeds[at..].iter().zip(&self.integrals[at..]).for_each(|(seed, sum)| visit(*seed, sum));
    }

    /// Pieces of the facets from `first` on, as many as there are `starts`, their nearest seeds; of those without area
    /// too if they are wanted.
    pub(super) fn cut(
        &mut self,
        walkers: &mut Walkers,
        diagram: Diagram<'_>,
        first: u32,
        starts: &[u32],
        capacities: Capacities,
        flat: bool,
    ) {
        self.begin();
        let surface = diagram.surface;
        let Self { pieces, stats, .. } = self;
        for (facet, &start) in (first..).zip(starts) {
            if if flat { surface.joins(facet as usize) } else { !surface.skips(facet as usize) } {
                walkers.walker.walk(diagram, facet, start, capacities, stats, |i, clipper| {
                    let origin = diagram.seeds[i as usize];
                    pieces.push(facet, i, clipper.polygon().iter().map(|v| (origin + v.p, v.w, v.edge)));
                });
            }
        }
        pieces.sort();
    }
}

/// Adds what the chunks wrote down. Every thread owns a range of seeds and reads everything, so
/// that each cell is added up in facet order without a lock.
pub(super) fn add_up(out: &mut CellSums, chunks: &[Chunk]) {
    let share = out.mass.len().div_ceil(rayon::current_num_threads()).max(1);
    out.mass
        .par_chunks_mut(share)
        .zip(out.moment.par_chunks_mut(share))
        .zip(out.energy.par_chunks_mut(share).zip(out.area.par_chunks_mut(share)))
        .enumerate()
        .for_each(|(part, ((mass, moment), (energy, area)))| {
            let base = (part * share) as u32;
            for chunk in chunks {
                chunk.each(|seed, sum| {
                    // No piece, and another thread's seeds, are beyond the end.
                    let local = seed.wrapping_sub(base) as usize;
                    if local < mass.len() {
                        mass[local] += sum.mass;
                        moment[local] += sum.moment;
                        energy[local] += sum.energy;
                        area[local] += sum.area;
                    }
                });
            }
        });
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use glam::DVec3;

    use super::*;
    use crate::knn::{NeighbourTable, SeedIndex, Threads};
    use crate::mesh::shapes::Shape;
    use crate::rvd::Surface;

    /// What a chunk of all facets finds with registers of one kind.
    fn found<S: Simd>(simd: S, listed: Listed<'_>) -> Vec<(u32, Integrals)> {
        let (mut chunk, mut walkers) = (Chunk::default(), Walkers::default());
        chunk.begin();
        walkers.chooser.begin(listed);
        simd.vectorize(Divide { chunk: &mut chunk, walkers: &mut walkers, listed });
        chunk.walk(&mut walkers, listed);
        let mut all = Vec::new();
        chunk.each(|seed, sum| all.push((seed, *sum)));
        all.retain(|(seed, _)| *seed != NONE);
        all
    }

    #[test]
    fn the_width_of_registers_changes_no_bit() {
        let mesh = Shape::Torus.build(3000);
        let weights: Vec<f64> = (0..mesh.positions().len()).map(|v| 0.25 + (v % 5) as f64).collect();
        for weights in [None, Some(&weights[..])] {
            let surface = Surface::new(&mesh, weights).unwrap();
            // Some facets meet one cell, some many, and some corners are seeds, so that rounding could decide.
            let seeds: Vec<DVec3> = (0..surface.facets().len() as u32)
                .filter(|f| f % 3 == 0 || f % 400 < 100)
                .map(|f| surface.centroid(f))
                .chain(surface.positions().iter().copied().step_by(7))
                .collect();
            let index = SeedIndex::new(&seeds);
            let mut table = NeighbourTable::default();
            assert!(table.fill(&index, 24, Threads::One, &|| false));
            let diagram = Diagram { surface: &surface, seeds: &seeds, index: &index, table: &table };
            let (mut lists, mut gatherer) = (Lists::default(), Gatherer::default());
            for facet in 0..surface.facets().len() as u32 {
                let corner = surface.facets()[facet as usize].map(|v| surface.positions()[v as usize]);
                let centroid = surface.centroid(facet);
                let (_, few) =
                    gatherer.gather(diagram, (Slack::NONE, Few::TO_WALK), &corner, centroid, index.near(centroid));
                assert!(few);
                lists.push(gatherer.list().iter().copied());
            }
            let starts = vec![0; surface.facets().len()];
            let listed = Listed {
                diagram,
                first: 0,
                starts: &starts,
                lists: &lists,
                capacities: Capacities::default(),
                by_rows: false,
            };
            let want = found(pulp::Scalar::new(), listed);
            let area: f64 = want.iter().map(|(_, sum)| sum.area).sum();
            assert!((area - surface.area()).abs() < 1e-13, "{area}");
            #[cfg(target_arch = "x86_64")]
            {
                if let Some(simd) = pulp::x86::V3::try_new() {
                    assert!(found(simd, listed) == want, "four lanes");
                }
                if let Some(simd) = pulp::x86::V4::try_new() {
                    assert!(found(simd, listed) == want, "eight lanes");
                }
            }
            #[cfg(target_arch = "aarch64")]
            if let Some(simd) = pulp::aarch64::Neon::try_new() {
                assert!(found(simd, listed) == want, "two lanes");
            }
        }
    }
}
