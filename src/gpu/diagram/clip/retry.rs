//! What becomes of pairs that did not end.
//!
//! Purpose: sorts failed pairs into those that get a longer row, those that get more slots and those finished in f64, and
//! finishes the last. Invariant: nothing is dropped. A pair that is launched again sees a longer prefix of the same row, so
//! capacities cannot change its polygon. Must not know: how pairs are launched.

use std::collections::{HashMap, HashSet};

use rayon::prelude::*;

use super::{Clip, Result, Variant, fixed};
use crate::diagram::layout::{INDEX, State, code, failure};
use crate::diagram::memory::Memory;
use crate::diagram::neighbours::{LONGEST_ROW, Neighbours};
use crate::diagram::pipelines::SLOTS;
use crate::diagram::space::{DeviceSpace, SeedRecord};
use geometry::rvd::PassStats;
use geometry::rvd::cells::facet_edge;
use geometry::rvd::incident::FacetWalker;
use geometry::token::Token;

pub(crate) type Pair = (u32, u32);

/// What is to be done with the pairs that failed.
#[derive(Default)]
pub(crate) struct Retries {
    pub again: Vec<Pair>,
    /// Launched again with more slots.
    pub large: Vec<Pair>,
    pub finish: Vec<Pair>,
    /// Seeds that get longer rows.
    pub rows: Vec<u32>,
    /// Pairs whose rows were too short, and whose polygons were too large.
    pub short: u64,
    pub overflowed: u64,
}

/// What became of a pair in f64.
struct Ended<P: DeviceSpace> {
    sums: Vec<(u32, fixed::Units<P>)>,
    candidates: Vec<[u32; 2]>,
    walked: bool,
}

impl<P: DeviceSpace> Clip<P> {
    /// `variants` has the pairs whose polygons were too large before.
    pub(crate) fn sort_out(
        &mut self,
        memory: &Memory<P>,
        neighbours: &Neighbours<P>,
        failures: &[[u32; 2]],
        variants: &mut HashMap<Pair, Variant>,
    ) -> Retries {
        let mut retries = Retries::default();
        let mut short = Vec::new();
        let all_slots = self.pass.polygon as usize == SLOTS;
        for &entry in failures {
            let Some((facet, seed, why)) = failure(entry) else { continue };
            let pair = (facet, seed);
            let length = neighbours.host.records[seed as usize].row().1 & INDEX;
            match why {
                code::NEIGHBOURS if length < LONGEST_ROW => {
                    retries.rows.push(seed);
                    short.push(pair);
                }
                code::POLYGON if variants.get(&pair) != Some(&Variant::Large) => {
                    retries.overflowed += 1;
                    self.pass.polygon = SLOTS as u32;
                    let variant = if all_slots { Variant::Large } else { Variant::Registers };
                    variants.insert(pair, variant);
                    if all_slots { &mut retries.large } else { &mut retries.again }.push(pair);
                }
                _ => retries.finish.push(pair),
            }
        }
        retries.rows.sort_unstable();
        retries.rows.dedup();
        let entries = neighbours.host.packed_end as u64
            + retries.rows.iter().map(|&i| u64::from(neighbours.longer(i))).sum::<u64>();
        if entries <= memory.most_entries() {
            retries.short = short.len() as u64;
            for pair in short {
                let large = variants.get(&pair) == Some(&Variant::Large);
                if large { &mut retries.large } else { &mut retries.again }.push(pair);
            }
        } else {
            // The table would be more than the device can see.
            retries.rows.clear();
            retries.finish.append(&mut short);
        }
        // The device lists failures in no order; the host works in one.
        for list in [&mut retries.again, &mut retries.large, &mut retries.finish] {
            list.sort_unstable();
        }
        retries
    }

    /// Clips pairs in f64 and notes their sums. Returns the cells across their bisectors. A pair
    /// that began its facet is finished with the whole facet: the device found nothing there.
    pub(crate) fn finish(
        &mut self,
        neighbours: &Neighbours<P>,
        pairs: &[Pair],
        token: &Token,
    ) -> Result<Vec<[u32; 2]>> {
        let end = |walker: &mut FacetWalker<P>, &pair: &Pair| {
            token.check()?;
            Ok(self.end_pair(neighbours, walker, pair))
        };
        let ended: Result<Vec<Ended<P>>> = pairs.par_iter().map_init(FacetWalker::default, end).collect();
        let mut candidates = Vec::new();
        for (&(facet, _), mut ended) in pairs.iter().zip(ended?) {
            self.pass.finished.append(&mut ended.sums);
            candidates.append(&mut ended.candidates);
            if ended.walked {
                self.pass.walked.insert(facet);
            }
        }
        Ok(candidates)
    }

    fn end_pair(&self, neighbours: &Neighbours<P>, walker: &mut FacetWalker<P>, (facet, seed): Pair) -> Ended<P> {
        // The walker counts what it does again; the device's relaunches are what is reported.
        let mut ignored = PassStats::default();
        let mut ended = Ended { sums: Vec::new(), candidates: Vec::new(), walked: false };
        let diagram = neighbours.diagram();
        if neighbours.host.first[facet as usize] == seed {
            walker.walk(None, diagram, facet, seed, &mut ignored, |i, clipper| {
                ended.sums.push((i, fixed::encode(&clipper.integrals(), &self.scales)));
            });
            ended.walked = true;
            return ended;
        }
        walker.clip(None, diagram, facet, seed, &mut ignored);
        let clipper = walker.clipper();
        if !clipper.polygon().is_empty() {
            ended.sums.push((seed, fixed::encode(&clipper.integrals(), &self.scales)));
            let labels = clipper.polygon().iter().map(|v| v.edge).filter(|&j| facet_edge(j).is_none());
            ended.candidates.extend(labels.map(|j| [facet, j]));
        }
        ended
    }

    /// More slots for the facets whose sets were full, a longer list if it was, when buffers are allocated next.
    pub(crate) fn grow(&self, memory: &mut Memory<P>, seeds: usize, state: State, stats: &mut PassStats) -> Result<()> {
        stats.relaunched_cells += u64::from(state.cells_overflow) + u64::from(state.list_overflow);
        if state.cells_overflow > 0 {
            let stored = u64::from(state.failures).min(memory.counts.pairs) as usize;
            let failures: Vec<[u32; 2]> = memory.read(|b| &b.failures, 0..stored)?;
            let full: HashSet<u32> =
                failures.iter().filter_map(|&e| failure(e)).filter(|f| f.2 == code::CELLS).map(|f| f.0).collect();
            for facet in full {
                // Four times as many, but never more than all seeds need.
                let most = (seeds * 2).next_power_of_two().ilog2() as u8;
                let log2 = &mut memory.slots_log2[facet as usize];
                *log2 = (*log2 + 2).min(most.max(*log2 + 1));
            }
        }
        if state.list_overflow > 0 {
            memory.grow_list(u64::from(state.length));
        }
        Ok(())
    }
}
