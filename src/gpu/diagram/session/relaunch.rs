//! Pairs that did not end, launched again.
//!
//! Purpose: longer rows for `NeighboursExhausted`, more slots for `PolygonOverflow`, f64 for the
//! rest; then the pairs are put to the end of the list and launched again. What the device has seen
//! to itself (the stages `lengthen` and `overflow`) does not come here.
//! Invariant: nothing is dropped. Must not know: what each pair lacks.

use std::collections::HashMap;

use super::GpuSession;
use crate::buffers::write;
use crate::diagram::clip::{Pair, Variant, by_cell};
use crate::diagram::layout::{Params, ROOT, State};
use crate::diagram::plan::{EXTRA_CANDIDATES, LARGE_BATCH};
use geometry::rvd::{PassStats, RvdError};
use geometry::token::Token;

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
        self.view()?;
        let failures = self.clip.read_failures(&self.cx, &self.memory, state.failures)?;
        let retries = self.clip.sort_out(&self.cx, &self.memory, &self.neighbours, &failures, variants);
        // The device's proof covers only what the device clips.
        let finished = retries.finish.iter().map(|pair| pair.0);
        let unproved: Vec<u32> =
            finished.filter(|&f| self.clip.pass.by_cell && by_cell::is_by_cell(&self.memory, f)).collect();
        if !unproved.is_empty() {
            self.clip.leave_to_propagation(&self.cx, &mut self.memory, unproved, stats)?;
            return Ok(None);
        }
        stats.relaunched_neighbours += retries.short;
        // From now on the device sees to it as far as it can.
        self.clip.shortages.neighbours |= retries.short > 0;
        self.clip.shortages.slots |= !retries.large.is_empty();
        stats.relaunched_polygon += retries.overflowed;
        if !self.neighbours.lengthen(&self.cx, &mut self.memory, &retries.rows)? {
            self.release()?;
            return Ok(None);
        }
        let pieces = self.clip.pass.finished.len();
        let candidates = self.clip.finish(&self.cx, &self.neighbours, &retries.finish, token)?;
        stats.f64_finished += (self.clip.pass.finished.len() - pieces) as u64;

        let mut state = State { failures: 0, requeued: 0, overflowed: 0, ..state };
        // At most one dispatch of the large variant at a time, so that no pair found meanwhile
        // goes through it: its last bits may differ from those of the registers.
        let again = retries.again.chunks(usize::MAX).map(|p| (p, Variant::Registers));
        let large = retries.large.chunks(LARGE_BATCH).map(|p| (p, Variant::Large));
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

    fn launch_again(
        &mut self,
        state: State,
        pairs: &[Pair],
        variant: Variant,
        token: &Token,
    ) -> Result<Option<State>, RvdError> {
        let end = u64::from(state.length) + pairs.len() as u64;
        if end > self.memory.counts.pairs {
            self.memory.grow_list(end);
            self.release()?;
            return Ok(None);
        }
        let first = &self.neighbours.host.first;
        let root = |facet: u32, seed: u32| if first[facet as usize] == seed { ROOT } else { 0 };
        let entries: Vec<[u32; 2]> = pairs.iter().map(|&(f, i)| [f, i | root(f, i)]).collect();
        let next = State { head: state.length, length: end as u32, ..state };
        self.ensure_memory()?;
        write(&self.cx.device, &self.memory.there()?.buffers.list, state.length as usize, &entries)?;
        self.clip.write_state(&self.cx, &self.memory, next)?;
        self.clip.pass.repeats.push(state.length..end as u32);
        let encoder = self.cx.device.encoder();
        self.drain(encoder, None, variant, token)
    }

    fn launch_candidates(
        &mut self,
        candidates: &[[u32; 2]],
        state: State,
        token: &Token,
    ) -> Result<Option<State>, RvdError> {
        // Behind the first cells.
        let first = self.memory.windows.facets().len();
        let params = Params {
            enqueue_begin: first as u32,
            enqueue_count: candidates.len() as u32,
            enqueue_root: 0,
            ..self.params()
        };
        self.ensure_memory()?;
        write(&self.cx.device, &self.memory.window()?.candidates, first, candidates)?;
        // The failures were read; the device's count of them was not reset if nothing ran since.
        self.clip.write_state(&self.cx, &self.memory, State { head: state.length, ..state })?;
        let encoder = self.cx.device.encoder();
        self.drain(encoder, Some(params), Variant::Registers, token)
    }
}
