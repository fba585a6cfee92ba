//! One pass over a range of facets.
//!
//! Purpose: seed the list, run clip dispatches until it is drained, and begin again with more room where a set or the list was
//! full. Pairs that did not end get longer rows for `NeighboursExhausted`, more slots for `PolygonOverflow`, and f64 for the
//! rest; then they are put to the end of the list and launched again. What the device has seen to itself (the stages `lengthen`
//! and `overflow`) is not among them. Invariant: a pass that returns has every pair of its facets done, on the device or in
//! f64. Must not know: what each pair lacks.

use std::collections::HashMap;
use std::ops::Range;
use std::time::Instant;

use super::{GpuSession, Result};
use crate::buffers::write;
use crate::diagram::clip::{Launch, Pair, STEPS, Variant, Wants, by_cell, count_requeued};
use crate::diagram::layout::{Params, ROOT, State};
use crate::diagram::neighbours::Rows;
use crate::diagram::plan::{EXTRA_CANDIDATES, LARGE_BATCH};
use crate::diagram::space::DeviceSpace;
use geometry::rvd::{PassStats, elapsed_ms};
use geometry::token::Token;

/// A submission that took longer than this is not made longer.
const SUBMISSION_MS: f64 = 50.0;

impl<P: DeviceSpace> GpuSession<P> {
    /// Brings the pairs of all facets to their end, and adds them up.
    pub(crate) fn run_sums(&mut self, token: &Token, stats: &mut PassStats) -> Result<()> {
        match self.others.is_empty() {
            true => self.run_share(token, stats),
            false => self.run_shares(token, stats),
        }
    }

    /// The same of the facets that this device does.
    pub(super) fn run_share(&mut self, token: &Token, stats: &mut PassStats) -> Result<()> {
        loop {
            let mut done = PassStats::default();
            let ended = self.attempt_sums(token, &mut done);
            stats.add(&done);
            if ended? {
                return Ok(());
            }
        }
    }

    /// All windows from zero. `false` if a capacity had to grow.
    fn attempt_sums(&mut self, token: &Token, stats: &mut PassStats) -> Result<bool> {
        self.search_apart(token)?;
        let (mut finished, mut pairs) = (Vec::new(), 0);
        for k in 0..self.memory.windows.all.len() {
            self.memory.turn_to(k)?;
            if !self.attempt(self.memory.windows.facets(), Wants::Sums, token, stats)? {
                return Ok(false);
            }
            finished.append(&mut self.clip.pass.finished);
            pairs += std::mem::take(&mut self.clip.pass.pairs);
        }
        self.clip.pass.finished = finished;
        stats.pairs += pairs;
        Ok(true)
    }

    /// Where there are windows, rows and first cells come in submissions of their own: what a window lacks is
    /// then known before any is added up.
    fn search_apart(&mut self, token: &Token) -> Result<()> {
        self.ensure_memory()?;
        if self.memory.windows.all.len() > 1 {
            self.search_now(token)?;
            self.start_now(token)?;
            self.ensure_memory()?;
        }
        Ok(())
    }

    /// Brings the pairs of `facets`, as far as they are in one window, to their end; the list has them then.
    /// Returns where those facets end.
    pub(super) fn run_pairs(&mut self, facets: Range<u32>, token: &Token, stats: &mut PassStats) -> Result<u32> {
        loop {
            // Where a capacity has grown, windows may be smaller.
            self.search_apart(token)?;
            self.memory.turn_to(self.memory.windows.window_of(facets.start))?;
            let part = facets.start..facets.end.min(self.memory.windows.facets().end);
            if self.attempt(part.clone(), Wants::Pairs, token, stats)? {
                stats.pairs += self.clip.pass.pairs;
                return Ok(part.end);
            }
        }
    }

    /// One attempt from zero at facets of the window at work. `false` if a capacity had to grow.
    fn attempt(&mut self, facets: Range<u32>, wants: Wants, token: &Token, stats: &mut PassStats) -> Result<bool> {
        // Of a part of the surface most cells are elsewhere.
        let by_cell = self.clip.near.side > 0 && facets.len() == self.memory.facets.len();
        if self.neighbours.rows == Rows::Missing {
            self.clip.promote(&mut self.memory)?;
        }
        self.clip.begin(by_cell);
        let Some(mut state) = self.launch_roots(facets, wants, token)? else { return Ok(false) };
        let mut variants = HashMap::new();
        count_requeued(&state, stats);
        loop {
            if state.list_overflow + state.cells_overflow > 0 {
                self.clip.grow(&mut self.memory, self.neighbours.count, state, stats)?;
                self.release()?;
                return Ok(false);
            }
            self.clip.pass.length = state.length;
            if state.failures == state.requeued {
                break;
            }
            let Some(next) = self.relaunch(state, &mut variants, token, stats)? else { return Ok(false) };
            state = next;
        }
        if self.clip.pass.by_cell && !self.verify(state, stats, token)? {
            return Ok(false);
        }
        self.clip.pass.pairs = u64::from(state.pieces) + self.clip.pass.finished.len() as u64;
        Ok(true)
    }

    /// Clears what the pass uses, enters the facets' first cells and drains the list.
    /// `None` if the host took something over, so that the pass must begin anew.
    fn launch_roots(&mut self, facets: Range<u32>, wants: Wants, token: &Token) -> Result<Option<State>> {
        self.ensure_memory()?;
        self.clip.choose(wants, self.neighbours.rows);
        let roots = self.clip.roots_params(&self.memory, &self.neighbours, &facets);
        let mut encoder = self.cx.device.encoder();
        let begins = wants == Wants::Sums && self.memory.windows.present == 0;
        let sums = begins.then_some(self.neighbours.count);
        self.clip.encode_clears(&self.memory, &mut encoder, &facets, sums)?;
        self.memory.write_state(State::default())?;
        if roots.enqueue_count == 0 {
            return self.read_summary(encoder).map(Some);
        }
        let state = self.drain(encoder, Some(roots), Variant::Registers, token)?;
        if let Some(state) = &state {
            self.clip.learn_steps(state.rounds);
            if wants == Wants::Sums {
                self.clip.count_facets(state, roots.enqueue_count);
            }
        }
        Ok(state)
    }

    /// Runs clip steps until the list is drained or something is full. `candidates` are entered
    /// first; the first step uses `variant`, the others registers.
    pub(super) fn drain(
        &mut self,
        mut encoder: wgpu::CommandEncoder,
        candidates: Option<Params>,
        variant: Variant,
        token: &Token,
    ) -> Result<Option<State>> {
        let steps = if variant == Variant::Large { 1 } else { self.clip.steps };
        let mut launch = Launch { candidates, variant, steps };
        loop {
            token.check()?;
            let begin = Instant::now();
            let Some(state) = self.submit(encoder, &launch, token)? else { return Ok(None) };
            if state.list_overflow + state.cells_overflow > 0 || state.head >= state.length {
                return Ok(Some(state));
            }
            let steps = match launch.variant {
                Variant::Large => STEPS.0,
                Variant::Registers if elapsed_ms(begin) < SUBMISSION_MS => (launch.steps * 2).min(STEPS.1),
                Variant::Registers => launch.steps,
            };
            launch = Launch { candidates: None, variant: Variant::Registers, steps };
            encoder = self.cx.device.encoder();
        }
    }

    /// One submission: rows and first cells if the device lacks them, candidates, clip step by step, then the totals if they
    /// are wanted. `None` if the host took something over.
    fn submit(&mut self, mut encoder: wgpu::CommandEncoder, launch: &Launch, token: &Token) -> Result<Option<State>> {
        let params = launch.candidates.unwrap_or_else(|| self.params());
        self.ensure_memory()?;
        self.memory.write_params(params)?;
        let search = self.neighbours.rows == Rows::Missing;
        let start = !self.neighbours.first_cells.known;
        if search {
            self.encode_search(&mut encoder, token)?;
        }
        if start {
            self.neighbours.encode_first_cells(&self.memory, &mut encoder, token)?;
        }
        let seeds = self.neighbours.count;
        self.clip.encode_clip(&self.memory, seeds, &mut encoder, launch, token)?;
        let state = self.read_summary(encoder)?;
        let done = (!search || self.take_search_result(&state, token)?)
            && (!start || self.neighbours.take_first_cells(&self.memory, &state)?);
        Ok(done.then_some(state))
    }

    /// Whether all pieces that cells entered are proved; if not, their facets are left to propagation and the pass begins anew.
    fn verify(&mut self, state: State, stats: &mut PassStats, token: &Token) -> Result<bool> {
        self.ensure_memory()?;
        let unproved = self.clip.unproved(&self.memory, &self.neighbours, state, token)?;
        if unproved.is_empty() {
            return Ok(true);
        }
        self.clip.leave_to_propagation(&mut self.memory, unproved, stats)?;
        Ok(false)
    }

    /// Gives the failed pairs what they lack and launches them again. `None` if a buffer had to
    /// grow for it, so that the pass must begin anew.
    pub(super) fn relaunch(
        &mut self,
        state: State,
        variants: &mut HashMap<Pair, Variant>,
        token: &Token,
        stats: &mut PassStats,
    ) -> Result<Option<State>> {
        self.view()?;
        let failures: Vec<[u32; 2]> = self.memory.read(|b| &b.failures, 0..state.failures as usize)?;
        let retries = self.clip.sort_out(&self.memory, &self.neighbours, &failures, variants);
        // The device's proof covers only what the device clips.
        let finished = retries.finish.iter().map(|pair| pair.0);
        let unproved: Vec<u32> =
            finished.filter(|&f| self.clip.pass.by_cell && by_cell::is_by_cell(&self.memory, f)).collect();
        if !unproved.is_empty() {
            self.clip.leave_to_propagation(&mut self.memory, unproved, stats)?;
            return Ok(None);
        }
        stats.relaunched_neighbours += retries.short;
        // From now on the device sees to it as far as it can.
        self.clip.shortages.neighbours |= retries.short > 0;
        self.clip.shortages.slots |= !retries.large.is_empty();
        stats.relaunched_polygon += retries.overflowed;
        if !self.neighbours.lengthen(&mut self.memory, &retries.rows)? {
            self.release()?;
            return Ok(None);
        }
        let pieces = self.clip.pass.finished.len();
        let candidates = self.clip.finish(&self.neighbours, &retries.finish, token)?;
        stats.f64_finished += (self.clip.pass.finished.len() - pieces) as u64;

        let mut state = State { failures: 0, requeued: 0, overflowed: 0, ..state };
        // At most one dispatch of the large variant at a time, so that no pair found meanwhile
        // goes through it: its last bits may differ from those of the registers.
        let again = retries.again.chunks(usize::MAX).map(|p| (p, Variant::Registers));
        let large = retries.large.chunks(LARGE_BATCH).map(|p| (p, Variant::Large));
        for (pairs, variant) in again.chain(large) {
            let Some(next) = self.launch_again(state, pairs, variant, token)? else { return Ok(None) };
            state = next;
            if state.list_overflow + state.cells_overflow > 0 {
                return Ok(Some(state));
            }
        }
        for part in candidates.chunks(EXTRA_CANDIDATES as usize) {
            let Some(next) = self.launch_candidates(part, state, token)? else { return Ok(None) };
            state = next;
            if state.list_overflow + state.cells_overflow > 0 {
                break;
            }
        }
        Ok(Some(state))
    }

    fn launch_again(&mut self, state: State, pairs: &[Pair], variant: Variant, token: &Token) -> Result<Option<State>> {
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
        self.memory.write_state(next)?;
        self.clip.pass.repeats.push(state.length..end as u32);
        let encoder = self.cx.device.encoder();
        self.drain(encoder, None, variant, token)
    }

    fn launch_candidates(&mut self, candidates: &[[u32; 2]], state: State, token: &Token) -> Result<Option<State>> {
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
        self.memory.write_state(State { head: state.length, ..state })?;
        let encoder = self.cx.device.encoder();
        self.drain(encoder, Some(params), Variant::Registers, token)
    }
}
