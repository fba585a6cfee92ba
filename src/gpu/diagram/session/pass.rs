//! One pass over a range of facets.
//!
//! Purpose: seed the list, run clip dispatches until it is drained, hand failures to
//! [`super::relaunch`], and begin again with more room where a set or the list was full.
//! Invariant: a pass that returns has every pair of its facets done, on the device or in f64.
//! Must not know: what failures need.

use std::collections::HashMap;
use std::ops::Range;
use std::time::Instant;

use super::GpuSession;
use crate::diagram::clip::{Launch, STEPS, Variant, Wants, count_requeued};
use crate::diagram::layout::{Params, State};
use crate::diagram::neighbours::Rows;
use geometry::rvd::{PassStats, RvdError, elapsed_ms};
use geometry::token::Token;

/// A submission that took longer than this is not made longer.
const SUBMISSION_MS: f64 = 50.0;

impl GpuSession {
    /// Brings the pairs of all facets to their end, and adds them up.
    pub(crate) fn run_sums(&mut self, token: &Token, stats: &mut PassStats) -> Result<(), RvdError> {
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
    fn attempt_sums(&mut self, token: &Token, stats: &mut PassStats) -> Result<bool, RvdError> {
        self.search_apart(token)?;
        let (mut finished, mut pairs) = (Vec::new(), 0);
        for k in 0..self.memory.windows.all.len() {
            self.memory.windows.present = k;
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
    fn search_apart(&mut self, token: &Token) -> Result<(), RvdError> {
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
    pub(super) fn run_pairs(
        &mut self,
        facets: Range<u32>,
        token: &Token,
        stats: &mut PassStats,
    ) -> Result<u32, RvdError> {
        loop {
            // Where a capacity has grown, windows may be smaller.
            self.search_apart(token)?;
            self.memory.windows.present = self.memory.windows.window_of(facets.start);
            let part = facets.start..facets.end.min(self.memory.windows.facets().end);
            if self.attempt(part.clone(), Wants::Pairs, token, stats)? {
                stats.pairs += self.clip.pass.pairs;
                return Ok(part.end);
            }
        }
    }

    /// One attempt from zero at facets of the window at work. `false` if a capacity had to grow.
    fn attempt(
        &mut self,
        facets: Range<u32>,
        wants: Wants,
        token: &Token,
        stats: &mut PassStats,
    ) -> Result<bool, RvdError> {
        // Of a part of the surface most cells are elsewhere.
        let by_cell = self.clip.near.side > 0 && facets.len() == self.memory.facets.len();
        if self.neighbours.rows == Rows::Missing {
            self.clip.promote(&self.cx, &mut self.memory)?;
        }
        self.clip.begin(by_cell);
        let Some(mut state) = self.launch_roots(facets, wants, token)? else { return Ok(false) };
        let mut variants = HashMap::new();
        count_requeued(&state, stats);
        loop {
            if state.list_overflow + state.cells_overflow > 0 {
                self.clip.grow(&self.cx, &mut self.memory, self.neighbours.count, state, stats)?;
                self.release()?;
                return Ok(false);
            }
            self.clip.pass.length = state.length;
            if state.failures == state.requeued {
                break;
            }
            match self.relaunch(state, &mut variants, token, stats)? {
                Some(next) => state = next,
                None => return Ok(false),
            }
        }
        if self.clip.pass.by_cell && !self.verify(state, stats, token)? {
            return Ok(false);
        }
        self.clip.pass.pairs = u64::from(state.pieces) + self.clip.pass.finished.len() as u64;
        Ok(true)
    }

    /// Clears what the pass uses, enters the facets' first cells and drains the list.
    /// `None` if the host took something over, so that the pass must begin anew.
    fn launch_roots(&mut self, facets: Range<u32>, wants: Wants, token: &Token) -> Result<Option<State>, RvdError> {
        self.ensure_memory()?;
        self.clip.choose(wants, self.neighbours.rows);
        let roots = self.clip.roots_params(&self.cx, &self.memory, &self.neighbours, &facets);
        let mut encoder = self.cx.device.encoder();
        let begins = wants == Wants::Sums && self.memory.windows.present == 0;
        let sums = begins.then_some(self.neighbours.count);
        self.clip.encode_clears(&self.memory, &mut encoder, &facets, sums)?;
        self.clip.write_state(&self.cx, &self.memory, State::default())?;
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
    ) -> Result<Option<State>, RvdError> {
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

    /// One submission: rows and first cells if the device lacks them, candidates, by facet and by cell,
    /// then indirect arguments and clip step by step, then the totals if they are wanted. Returns the summary,
    /// or `None` if the host took something over.
    fn submit(
        &mut self,
        mut encoder: wgpu::CommandEncoder,
        launch: &Launch,
        token: &Token,
    ) -> Result<Option<State>, RvdError> {
        let params = launch.candidates.unwrap_or_else(|| self.params());
        self.ensure_memory()?;
        self.clip.write_params(&self.cx, &self.memory, params)?;
        let search = self.neighbours.rows == Rows::Missing;
        let start = !self.neighbours.first_cells.are_known();
        if search {
            self.encode_search(&mut encoder, token)?;
        }
        if start {
            self.neighbours.encode_first_cells(&self.cx, &self.memory, &mut encoder, token)?;
        }
        let seeds = self.neighbours.count;
        self.clip.encode_clip(&self.cx, &self.memory, seeds, &mut encoder, launch, token)?;
        let state = self.read_summary(encoder)?;
        let done = (!search || self.take_search_result(&state, token)?)
            && (!start || self.neighbours.take_first_cells(&self.cx, &self.memory, &state)?);
        Ok(done.then_some(state))
    }

    /// Whether all pieces that cells entered are proved; if not, their facets are left to
    /// propagation and the pass begins anew.
    fn verify(&mut self, state: State, stats: &mut PassStats, token: &Token) -> Result<bool, RvdError> {
        self.ensure_memory()?;
        let unproved = self.clip.unproved(&self.cx, &self.memory, &self.neighbours, state, token)?;
        if unproved.is_empty() {
            return Ok(true);
        }
        self.clip.leave_to_propagation(&self.cx, &mut self.memory, unproved, stats)?;
        Ok(false)
    }
}
