//! Pairs that did not end.
//!
//! Purpose: longer rows for `NeighboursExhausted`, more slots for `PolygonOverflow`, f64 for the
//! rest; then the pairs are put to the end of the list and launched again. What the device has seen
//! to itself (the stages `lengthen` and `overflow`) does not come here.
//! Invariant: nothing is dropped. A relaunched pair sees a longer prefix of the same row, so
//! capacities cannot change its polygon.
//! Must not know: how a launch works.

use std::collections::HashMap;
use std::sync::Arc;

use rayon::prelude::*;

use super::layout::{COMPLETE, INDEX, Params, ROOT, State, code, failure};
use super::pass::Variant;
use super::plan::{EXTRA_CANDIDATES, LARGE_BATCH};
use super::search::{self, HostCopy, Rows};
use super::{GpuSession, fixed};
use crate::gpu::buffers;
use crate::gpu::limits::Limits;
use crate::knn::NeighbourRow;
use crate::rvd::cells::facet_edge;
use crate::rvd::incident::FacetWalker;
use crate::rvd::{PassStats, RvdError};
use crate::token::Token;

/// The longest row that is sent to the device.
const LONGEST_ROW: u32 = 4096;

type Pair = (u32, u32);

/// What is to be done with the pairs that failed.
#[derive(Default)]
struct Plans {
    again: Vec<Pair>,
    large: Vec<Pair>,
    finish: Vec<Pair>,
    rows: Vec<u32>,
    /// Pairs whose rows were too short, and whose polygons were too large.
    short: u64,
    overflowed: u64,
}

/// What became of a pair in f64.
#[derive(Default)]
struct Ended {
    sums: Vec<(u32, fixed::Units)>,
    candidates: Vec<[u32; 2]>,
    /// The whole facet was done.
    walked: bool,
}

impl GpuSession {
    /// Gives the failed pairs what they lack and launches them again. `None` if a buffer had to
    /// grow for it, so that the pass must begin anew.
    pub(super) fn relaunch(
        &mut self,
        state: State,
        variants: &mut HashMap<Pair, Variant>,
        token: &Token,
        stats: &mut PassStats,
    ) -> Result<Option<State>, RvdError> {
        let device = Arc::clone(&self.device);
        self.view()?;
        let buffers = &self.on_device()?.buffers;
        let failures: Vec<[u32; 2]> = buffers.staging.read(&device, &buffers.failures, 0..state.failures as usize)?;
        let plans = self.sort_out(&failures, variants);
        // The device's proof covers only what the device clips.
        let unproved: Vec<u32> =
            plans.finish.iter().map(|p| p.0).filter(|&f| self.pass.by_cell && self.is_by_cell(f)).collect();
        if !unproved.is_empty() {
            self.leave_to_propagation(unproved, stats)?;
            return Ok(None);
        }
        stats.relaunched_neighbours += plans.short;
        // From now on the device sees to it as far as it can.
        self.lacked.neighbours |= plans.short > 0;
        self.lacked.slots |= !plans.large.is_empty();
        stats.relaunched_polygon += plans.overflowed;
        if !self.lengthen(&plans.rows)? {
            return Ok(None);
        }
        let pieces = self.pass.finished.len();
        let candidates = self.finish(&plans.finish, token)?;
        stats.f64_finished += (self.pass.finished.len() - pieces) as u64;

        let mut state = State { failures: 0, requeued: 0, overflowed: 0, ..state };
        // At most one dispatch of the large variant at a time, so that no pair found meanwhile
        // goes through it: its last bits may differ from those of the registers.
        let again = plans.again.chunks(usize::MAX).map(|p| (p, Variant::Registers));
        let large = plans.large.chunks(LARGE_BATCH).map(|p| (p, Variant::Large));
        for (pairs, variant) in again.chain(large) {
            match self.launch_again(state, pairs, variant, token)? {
                Some(next) => state = next,
                None => return Ok(None),
            }
            if state.list_overflow + state.cells_overflow > 0 {
                return Ok(Some(state));
            }
        }
        for part in candidates.chunks(EXTRA_CANDIDATES as usize) {
            match self.launch_candidates(part, state, token)? {
                Some(next) => state = next,
                None => return Ok(None),
            }
            if state.list_overflow + state.cells_overflow > 0 {
                break;
            }
        }
        Ok(Some(state))
    }

    /// Entries of the table at most.
    fn most_entries(&self) -> u64 {
        Limits::of(&self.device.limits()).seen_bytes() / 4
    }

    fn sort_out(&mut self, failures: &[[u32; 2]], variants: &mut HashMap<Pair, Variant>) -> Plans {
        let mut plans = Plans::default();
        let mut short = Vec::new();
        let all_slots = self.pass.polygon as usize == self.slots;
        for &entry in failures {
            let Some((facet, seed, why)) = failure(entry) else { continue };
            let pair = (facet, seed);
            let length = self.host.records[seed as usize].row_length & INDEX;
            match why {
                code::NEIGHBOURS if length < LONGEST_ROW => {
                    plans.rows.push(seed);
                    short.push(pair);
                }
                code::POLYGON if variants.get(&pair) != Some(&Variant::Large) => {
                    plans.overflowed += 1;
                    self.pass.polygon = self.slots as u32;
                    let variant = if all_slots { Variant::Large } else { Variant::Registers };
                    variants.insert(pair, variant);
                    if all_slots { &mut plans.large } else { &mut plans.again }.push(pair);
                }
                _ => plans.finish.push(pair),
            }
        }
        plans.rows.sort_unstable();
        plans.rows.dedup();
        let longer =
            |&i: &u32| (self.host.records[i as usize].row_length & INDEX).max(1).saturating_mul(4).min(LONGEST_ROW);
        let entries = self.host.packed_end as u64 + plans.rows.iter().map(|i| u64::from(longer(i))).sum::<u64>();
        if entries <= self.most_entries() {
            plans.short = short.len() as u64;
            for pair in short {
                let large = variants.get(&pair) == Some(&Variant::Large);
                if large { &mut plans.large } else { &mut plans.again }.push(pair);
            }
        } else {
            // The table would be more than the device can see.
            plans.rows.clear();
            plans.finish.append(&mut short);
        }
        // The device lists failures in no order; the host works in one.
        for list in [&mut plans.again, &mut plans.large, &mut plans.finish] {
            list.sort_unstable();
        }
        plans
    }

    /// Four times longer rows for `seeds`, behind the table. `false` if the table had to grow.
    fn lengthen(&mut self, seeds: &[u32]) -> Result<bool, RvdError> {
        let HostCopy { index, records, far, .. } = &self.host;
        let query = |&i: &u32| {
            let mut row = NeighbourRow::default();
            let known = (records[i as usize].row_length & INDEX) as usize;
            // Rows stop short of ties, so the next length counts from what was asked for.
            let mut k = (known.max(1) * 4).min(LONGEST_ROW as usize);
            loop {
                index.row(i, k, &mut row);
                if !far {
                    search::in_device_order(i, records, &mut row);
                }
                if row.complete || row.seeds.len() > known {
                    return row;
                }
                // All of them at one distance: only a row that reaches past them says more.
                k *= 4;
            }
        };
        let rows: Vec<NeighbourRow> = seeds.par_iter().map(query).collect();
        let mut tail = Vec::new();
        for (&i, row) in seeds.iter().zip(&rows) {
            let record = &mut self.host.records[i as usize];
            record.row_begin = (self.host.packed_end + tail.len()) as u32;
            record.row_length = row.seeds.len() as u32 | if row.complete { COMPLETE } else { 0 };
            tail.extend_from_slice(&row.seeds);
        }
        let first = self.host.packed_end;
        self.host.packed_end += tail.len();
        if self.rows == Rows::Host {
            self.host.packed.extend_from_slice(&tail);
        }
        if self.host.packed_end as u64 > self.counts.table {
            let end = self.host.packed_end as u64;
            self.counts.table = (end * 3 / 2).min(self.most_entries()).max(end);
            self.release()?;
            return Ok(false);
        }
        let device = Arc::clone(&self.device);
        // One write costs as much as copying a few hundred records.
        let all = (seeds.len() * 256 > self.host.records.len()).then(|| self.host.records.clone());
        let changed: Vec<_> = seeds.iter().map(|&i| (i, self.host.records[i as usize])).collect();
        let buffers = &self.on_device()?.buffers;
        buffers::write(&device, &buffers.table, first, &tail)?;
        match all {
            Some(records) => buffers::write(&device, &buffers.seeds, 0, &records)?,
            None => {
                for (i, record) in changed {
                    buffers::write(&device, &buffers.seeds, i as usize, &[record])?;
                }
            }
        }
        Ok(true)
    }

    /// Clips pairs in f64 and notes their sums. Returns the cells across their bisectors. A pair
    /// that began its facet is finished with the whole facet: the device found nothing there.
    fn finish(&mut self, pairs: &[Pair], token: &Token) -> Result<Vec<[u32; 2]>, RvdError> {
        let end = |walker: &mut FacetWalker, &pair: &Pair| {
            token.check()?;
            Ok(self.end_pair(walker, pair))
        };
        let ended: Result<Vec<Ended>, RvdError> = pairs.par_iter().map_init(FacetWalker::default, end).collect();
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

    fn end_pair(&self, walker: &mut FacetWalker, (facet, seed): Pair) -> Ended {
        // The walker counts what it does again; the device's relaunches are what is reported.
        let mut ignored = PassStats::default();
        let mut ended = Ended::default();
        if self.host.first[facet as usize] == seed {
            walker.walk(self.diagram(), facet, seed, self.capacities, &mut ignored, |i, clipper| {
                ended.sums.push((i, fixed::encode(&clipper.integrals(), &self.scales)));
            });
            ended.walked = true;
            return ended;
        }
        walker.clip_to_end(self.diagram(), facet, seed, self.capacities, &mut ignored);
        let clipper = walker.clipper();
        if !clipper.polygon().is_empty() {
            ended.sums.push((seed, fixed::encode(&clipper.integrals(), &self.scales)));
            let labels = clipper.polygon().iter().map(|v| v.edge).filter(|&j| facet_edge(j).is_none());
            ended.candidates.extend(labels.map(|j| [facet, j]));
        }
        ended
    }

    fn launch_again(
        &mut self,
        state: State,
        pairs: &[Pair],
        variant: Variant,
        token: &Token,
    ) -> Result<Option<State>, RvdError> {
        let end = u64::from(state.length) + pairs.len() as u64;
        if end > self.counts.pairs {
            self.grow_list(end);
            self.release()?;
            return Ok(None);
        }
        let root = |facet: u32, seed: u32| if self.host.first[facet as usize] == seed { ROOT } else { 0 };
        let entries: Vec<[u32; 2]> = pairs.iter().map(|&(f, i)| [f, i | root(f, i)]).collect();
        let next = State { head: state.length, length: end as u32, ..state };
        let device = Arc::clone(&self.device);
        let buffers = &self.on_device()?.buffers;
        buffers::write(&device, &buffers.list, state.length as usize, &entries)?;
        buffers::write(&device, &buffers.state, 0, &[next])?;
        self.pass.repeats.push(state.length..end as u32);
        let encoder = device.encoder();
        self.drain(encoder, None, variant, token)
    }

    fn launch_candidates(
        &mut self,
        candidates: &[[u32; 2]],
        state: State,
        token: &Token,
    ) -> Result<Option<State>, RvdError> {
        // Behind the first cells.
        let first = self.layout.facets().len();
        let params = Params {
            enqueue_begin: first as u32,
            enqueue_count: candidates.len() as u32,
            enqueue_root: 0,
            ..self.params()
        };
        let device = Arc::clone(&self.device);
        self.on_device()?;
        buffers::write(&device, &self.window()?.candidates, first, candidates)?;
        let buffers = &self.on_device()?.buffers;
        // The failures were read; the device's count of them was not reset if nothing ran since.
        buffers::write(&device, &buffers.state, 0, &[State { head: state.length, ..state }])?;
        let encoder = device.encoder();
        self.drain(encoder, Some(params), Variant::Registers, token)
    }
}
