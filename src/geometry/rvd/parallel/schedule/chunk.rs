//! Some facets, one task's share.
//!
//! Purpose: finds the pieces of a task's facets, in groups of as many members, and adds up what all tasks found.
//! Invariant: what comes of a facet depends on nothing beside it, and the sums not on how many blocks a task has.
//! Must not know: how tasks are shared out.

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use super::{NONE, Written};
use crate::knn::{NeighbourTable, Point};
use crate::rvd::clip::{Clipper, Integrals};
use crate::rvd::incident::{Diagram, FacetWalker};
use crate::rvd::parallel::candidates::members::{Chooser, Listed, Prune, choose_members};
use crate::rvd::parallel::candidates::{Lists, gather::Skin, list_builder::ListBuilder, verlet::Verlet};
use crate::rvd::parallel::divide::facets::{Found, InTurn, MEMBERS};
use crate::rvd::parallel::divide::{Number, UNIFORM, WEIGHTED};
use crate::rvd::parallel::order::Stretch;
use crate::rvd::{CellSums, PassStats, PieceBatch, incident};

/// What one task found. Reused from wave to wave.
#[derive(Default)]
pub(crate) struct Chunk<P> {
    /// Block by block, the integrals over the pieces of each cell that meets it.
    cells: Vec<(u32, Integrals<P>)>,
    pub pieces: PieceBatch,
    pub stats: PassStats,
    pub unlisted: u64,
}

/// Lists with fewer seeds than this, of facets much smaller than cells, have hardly one that another than the start beats.
const SHORT: usize = 10;

/// What is asked for of facets without lists.
#[derive(Clone, Copy)]
pub(crate) struct Task<'a, P: Point> {
    pub diagram: Diagram<'a, P>,
    /// The places about which seeds have their skin, if those are not where they are; then the index is of the places.
    pub about: Option<&'a [P]>,
    pub skin: Skin<'a>,
    /// Facets with many members are walked by rows.
    pub by_rows: bool,
    /// Seeds are spread evenly, and there are no rows.
    pub even: bool,
    pub block: usize,
}

impl<'a, P: Point> Task<'a, P> {
    pub(crate) fn listed(&self, facets: Stretch<'a, P>, starts: &'a [u32], lists: &'a Lists) -> Listed<'a, P> {
        Listed { diagram: self.diagram, facets, starts, lists, by_rows: self.by_rows }
    }
}

/// Facets that are walked between two looks at the token.
const ASKED: usize = 16;

#[derive(Default)]
pub(crate) struct Walkers<P: Point> {
    builder: ListBuilder<P>,
    /// Lists, before those that become Verlet lists are made shorter.
    lists: Lists,
    chooser: Chooser<P>,
    found: Found<P>,
    pub walker: FacetWalker<P>,
    written: Written<P>,
    to_walk: Vec<u32>,
    /// Pieces that are clipped alone: facet, and place among the integrals.
    to_clip: Vec<(u32, usize)>,
}

struct Divide<'a, P: Point> {
    stats: &'a mut PassStats,
    walkers: &'a mut Walkers<P>,
    listed: Listed<'a, P>,
}

impl<P: Point> WithSimd for Divide<'_, P> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { stats, walkers, listed } = self;
        choose_members(simd, &mut walkers.chooser, listed);
        walkers.written.begin(&walkers.chooser.members, &mut walkers.to_walk);
        walkers.to_clip.clear();
        if listed.diagram.surface.is_uniform() {
            walkers.divide::<S, UNIFORM>(simd, listed, stats);
        } else {
            walkers.divide::<S, WEIGHTED>(simd, listed, stats);
        }
    }
}

impl<P: Point> Walkers<P> {
    #[inline(always)]
    fn divide<S: Simd, const N: usize>(&mut self, simd: S, listed: Listed<'_, P>, stats: &mut PassStats) {
        let Self { chooser, found, written, to_walk, to_clip, .. } = self;
        let Chooser { facets, in_turn, groups, members, long } = chooser;
        let diagram = listed.diagram;
        groups.sort(MEMBERS, members.iter().map(|m| m.count_ones() as usize));
        for n in 1..=MEMBERS {
            for turn in InTurn::<P>::turns(groups.of(n), Number::<S>::LANES) {
                if let Some(group) = turn.set {
                    let given = in_turn.next(&turn);
                    for lane in 0..Number::<S>::LANES {
                        let at = group[lane.min(group.len() - 1)];
                        let vertices = listed.facets.vertices(at as usize);
                        given.set_facet(lane, &vertices);
                        if N == WEIGHTED {
                            given.set_weights(lane, &vertices);
                        }
                        let first = written.first(at);
                        let seeds = &mut written.seeds[first..][..n];
                        sorted(long.list(listed, at as usize), members[at as usize], seeds);
                        for (k, &seed) in seeds.iter().enumerate() {
                            given.set_seed(lane, k, diagram.seeds[seed as usize]);
                        }
                    }
                }
                let Some(group) = turn.read else { continue };
                facets.divide::<S, P, N>(simd, n, in_turn.present(&turn), found);
                for (lane, &at) in group.iter().enumerate() {
                    let first = written.first(at);
                    let (seeds, slots) = (&mut written.seeds[first..][..n], &mut written.integrals[first..][..n]);
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
                                stats.pairs += 1;
                            }
                            None => *seed = NONE,
                        }
                    }
                }
            }
        }
    }

    /// Clips pieces and walks facets that are left, among their members alone: what else a list holds would change roundings.
    fn walk(&mut self, listed: Listed<'_, P>, stats: &mut PassStats) {
        let Self { chooser: Chooser { members, long, .. }, walker, to_walk, to_clip, written, .. } = self;
        let Listed { diagram, facets, starts, lists, by_rows } = listed;
        for (k, &(at, slot)) in to_clip.iter().enumerate() {
            if k.is_multiple_of(ASKED) && walker.is_stopped() {
                break;
            }
            let among = long.among(listed, at as usize, members[at as usize]);
            let (seed, sum) = (&mut written.seeds[slot], &mut written.integrals[slot]);
            walker.clip(Some(&among.seeds), diagram, facets.facet(at as usize), *seed, stats);
            if walker.clipper().polygon().is_empty() {
                *seed = NONE;
            } else {
                *sum = walker.clipper().integrals();
                stats.pairs += 1;
            }
        }
        to_walk.sort_unstable();
        for (k, &at) in to_walk.iter().enumerate() {
            if k.is_multiple_of(ASKED) && walker.is_stopped() {
                break;
            }
            let at = at as usize;
            let (facet, centroid) = (facets.facet(at), facets.centroid(at));
            let visit = |i: u32, clipper: &Clipper<P>| written.walked.push((i, clipper.integrals()));
            // A facet with many members was not tried. It is walked by rows, if there are any.
            let many = !(1..=MEMBERS as u32).contains(&members[at].count_ones());
            if lists.get(at).is_empty() || many && by_rows {
                let start = incident::nearest(diagram, centroid, starts[at]);
                walker.walk(None, diagram, facet, start, stats, visit);
            } else {
                let among = long.among(listed, at, members[at]);
                let nearest = among.nearest(diagram, centroid);
                walker.walk(Some(&among.seeds), diagram, facet, nearest, stats, visit);
            }
            written.end_walk(at);
        }
    }
}

impl<P: Point> Chunk<P> {
    fn begin(&mut self) {
        self.cells.clear();
        self.pieces.clear();
        self.stats = PassStats::default();
        self.unlisted = 0;
    }

    /// Integrals over the facets' pieces, added up block by block; `starts` become the nearest listed seeds. Lists become Verlet
    /// lists where there is a skin. Returns whether all could be listed, or walked by rows; nothing is summed otherwise.
    pub(crate) fn sum(
        &mut self,
        walkers: &mut Walkers<P>,
        task: Task<'_, P>,
        (facets, starts): (Stretch<'_, P>, &mut [u32]),
        kept: &mut Lists,
    ) -> bool {
        let Task { about, skin, by_rows, even, block, .. } = task;
        let diagram = Diagram { seeds: about.unwrap_or(task.diagram.seeds), ..task.diagram };
        let mut lists = std::mem::take(&mut walkers.lists);
        lists.clear();
        let unlisted = match even {
            true => walkers.builder.list_evenly(diagram, skin, (facets, starts), &mut lists),
            false => Some(walkers.builder.list(diagram, skin, by_rows, (facets, starts), &mut lists)),
        };
        // A list without skin holds for seeds that are where they were when it was made.
        let unlisted = unlisted.filter(|&n| n == 0 || about.is_none());
        if let Some(unlisted) = unlisted {
            let mut of_chunk = &lists;
            if !skin.is_none() {
                if even && lists.mean_len() < SHORT {
                    std::mem::swap(kept, &mut lists);
                } else {
                    let listed = Listed { diagram, ..task.listed(facets, starts, &lists) };
                    Arch::new().dispatch(Prune { chooser: &mut walkers.chooser, listed, skin, out: kept });
                    std::mem::swap(&mut kept.bounds, &mut lists.bounds);
                }
                of_chunk = kept;
            }
            self.sum_listed(walkers, task.listed(facets, starts, of_chunk), block);
            self.unlisted = unlisted;
        }
        walkers.lists = lists;
        unlisted.is_some()
    }

    /// The same from lists that hold but for escaped seeds. Nothing is summed, and `false`, if a facet with such got no list.
    pub(crate) fn sum_from_lists(
        &mut self,
        walkers: &mut Walkers<P>,
        listed: Listed<'_, P>,
        (verlet, table): (Verlet<'_, P>, &NeighbourTable),
        block: usize,
    ) -> bool {
        if !walkers.builder.meets_escaped(listed.lists, verlet) {
            self.sum_listed(walkers, listed, block);
            return true;
        }
        let mut lists = std::mem::take(&mut walkers.lists);
        let diagram = Diagram { seeds: verlet.made_at, table, ..listed.diagram };
        let done = walkers.builder.renew(listed, diagram, verlet, &mut lists);
        if done {
            self.sum_listed(walkers, Listed { lists: &lists, ..listed }, block);
        }
        walkers.lists = lists;
        done
    }

    fn sum_listed(&mut self, walkers: &mut Walkers<P>, listed: Listed<'_, P>, block: usize) {
        self.begin();
        walkers.chooser.begin(listed);
        Arch::new().dispatch(Divide { stats: &mut self.stats, walkers, listed });
        walkers.walk(listed, &mut self.stats);
        walkers.written.add_blocks(block, listed.diagram.seeds.len(), &mut self.cells);
    }

    /// Pieces of the facets from `first` on, whose nearest seeds are `starts`; with `flat` of those without area too.
    pub(crate) fn cut(
        &mut self,
        walkers: &mut Walkers<P>,
        diagram: Diagram<'_, P>,
        first: u32,
        starts: &[u32],
        flat: bool,
    ) {
        self.begin();
        let surface = diagram.surface;
        let Self { pieces, stats, .. } = self;
        for (k, (facet, &start)) in (first..).zip(starts).enumerate() {
            if k.is_multiple_of(ASKED) && walkers.walker.is_stopped() {
                break;
            }
            if if flat { surface.joins(facet as usize) } else { !surface.skips(facet as usize) } {
                walkers.walker.walk(None, diagram, facet, start, stats, |i, clipper| {
                    let origin = diagram.seeds[i as usize];
                    pieces.push(facet, i, clipper.polygon().iter().map(|v| ((origin + v.p).place(), v.w, v.edge)));
                });
            }
        }
        pieces.sort();
    }
}

/// As many seeds of a list as `members` says, in the order of their numbers.
#[inline(always)]
fn sorted(list: &[u32], mut members: u32, out: &mut [u32]) {
    let mut next = || {
        let seed = list[members.trailing_zeros() as usize];
        members &= members - 1;
        seed
    };
    match out {
        // Without a jump that depends on the order, for most facets.
        [one] => *one = next(),
        [one, two] => {
            let (a, b) = (next(), next());
            (*one, *two) = (a.min(b), a.max(b));
        }
        [one, two, three] => {
            let (a, b, c) = (next(), next(), next());
            let (low, high) = (a.min(b), a.max(b));
            (*one, *two, *three) = (low.min(c), low.max(high.min(c)), high.max(c));
        }
        more => {
            more.iter_mut().for_each(|seed| *seed = next());
            more.sort_unstable();
        }
    }
}

/// Every thread owns a range of seeds and reads everything, so each cell is added up in the order of blocks without a lock.
pub(crate) fn add_up<P: Point>(out: &mut CellSums<P>, chunks: &[Chunk<P>]) {
    let share = out.mass.len().div_ceil(rayon::current_num_threads()).max(1);
    out.mass
        .par_chunks_mut(share)
        .zip(out.moment.par_chunks_mut(share))
        .zip(out.energy.par_chunks_mut(share).zip(out.area.par_chunks_mut(share)))
        .enumerate()
        .for_each(|(part, ((mass, moment), (energy, area)))| {
            let base = (part * share) as u32;
            for chunk in chunks {
                for (seed, sum) in &chunk.cells {
                    // Another thread's seeds are beyond the end.
                    let local = seed.wrapping_sub(base) as usize;
                    if local < mass.len() {
                        mass[local] += sum.mass;
                        moment[local] += sum.moment;
                        energy[local] += sum.energy;
                        area[local] += sum.area;
                    }
                }
            }
        });
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use glam::DVec3;

    use super::*;
    use crate::knn::{SeedIndex, Threads};
    use crate::mesh::shapes::Shape;
    use crate::rvd::parallel::candidates::gather::{Few, Gatherer, Search};
    use crate::rvd::parallel::order::Order;
    use crate::rvd::{Capacities, Surface};

    /// What a chunk of all facets finds with registers of one kind.
    fn found<S: Simd>(simd: S, listed: Listed<'_, DVec3>) -> Vec<(u32, Integrals)> {
        let (mut stats, mut walkers, mut all) = (PassStats::default(), Walkers::default(), Vec::new());
        walkers.chooser.begin(listed);
        simd.vectorize(Divide { stats: &mut stats, walkers: &mut walkers, listed });
        walkers.walk(listed, &mut stats);
        // Facet by facet, so that nothing is lost in sums.
        walkers.written.add_blocks(1, listed.diagram.seeds.len(), &mut all);
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
            let capacities = Capacities::default();
            let diagram = Diagram { surface: &surface, seeds: &seeds, index: &index, table: &table, capacities };
            let (mut lists, mut gatherer) = (Lists::default(), Gatherer::default());
            let mut order = Order::default();
            order.begin(&surface);
            let facets = order.all();
            for at in 0..facets.len() {
                let (corner, centroid) = (facets.corners(at), facets.centroid(at));
                let search = Search { diagram, skin: Skin::NONE, few: Few::TO_WALK };
                let (_, few) = gatherer.gather(search, &corner, centroid, index.near(centroid));
                assert!(few);
                lists.push(gatherer.list.iter().copied());
            }
            let starts = vec![0; facets.len()];
            let listed = Listed { diagram, facets, starts: &starts, lists: &lists, by_rows: false };
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
