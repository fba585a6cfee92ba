//! One pass over a range of facets.
//!
//! Purpose: seed the list, run clip dispatches until it is drained, hand failures to
//! [`super::relaunch`], and begin again with more room where a set or the list was full.
//! Invariant: a pass that returns has every pair of its facets done, on the device or in f64.
//! Must not know: what failures need.

use std::collections::{HashMap, HashSet};
use std::ops::Range;
use std::sync::Arc;
use std::time::Instant;

use super::layout::{MEMBERS, NONE, Params, ROOT, SUM_WORDS, State, accumulate, code, failure};
use super::plan::size;
use super::search::Rows;
use super::{GpuSession, fixed, lane, pack};
use crate::gpu::buffers;
use crate::gpu::dispatch::{ARGUMENTS_BYTES, Stage};
use crate::gpu::limits::Limits;
use crate::rvd::{PassStats, RvdError, elapsed_ms};
use crate::token::Token;

/// What a pass leaves beside the sums on the device.
#[derive(Default)]
pub(super) struct PassResult {
    /// Pieces that the host clipped: seed and sums.
    pub finished: Vec<(u32, fixed::Units)>,
    /// Facets that the host walked as a whole.
    pub walked: HashSet<u32>,
    /// Parts of the list that repeat earlier pairs.
    pub repeats: Vec<Range<u32>>,
    /// Pairs in the list, repeats included.
    pub length: u32,
    /// Pieces.
    pub pairs: u64,
    /// Polygon vertices allowed at present.
    pub polygon: u32,
    /// Whether facets were done as a whole where that was possible.
    pub divided: bool,
    /// Whether cells entered facets of their own, so that the pieces are to be proved.
    pub by_cell: bool,
    /// What the device itself sees to where pairs lack it.
    pub mends: Lacked,
}

/// What pairs did not end for.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Lacked {
    /// Longer rows.
    pub neighbours: bool,
    /// More slots for a polygon than there are in registers.
    pub slots: bool,
}

/// Counts the pairs that the device launched again.
pub(super) fn count_retaken(state: &State, stats: &mut PassStats) {
    stats.relaunched_neighbours += u64::from(state.requeued - state.overflowed);
    stats.relaunched_polygon += u64::from(state.overflowed);
}

/// What a pass is for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Wants {
    /// Sums and the list of pairs.
    Sums,
    /// The list of pairs; what the sums hold is of no use.
    Pairs,
}

/// Which variant of the clip stage a launch uses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Variant {
    /// Polygon in registers.
    Registers,
    /// Polygon in many indexed slots.
    Large,
}

/// Clip dispatches per submission: at first, and at most.
pub(super) const STEPS: (u32, u32) = (8, 64);
/// However few the last pass needed.
const FEWEST_STEPS: u32 = 3;
/// Clip dispatches for what comes of pairs with large polygons.
const STEPS_AGAIN: u32 = 4;
/// The variant of `divide` has room for so many times the cells that a mean facet is expected to meet. More room
/// costs every facet time, less sends more of them through the list of pairs.
const ROOM: f64 = 1.1;
/// A submission that took longer than this is not made longer.
const SUBMISSION_MS: f64 = 50.0;

impl GpuSession {
    /// Brings the pairs of all facets to their end, and adds them up.
    pub(super) fn run_sums(&mut self, token: &Token, stats: &mut PassStats) -> Result<(), RvdError> {
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
        for k in 0..self.layout.windows().len() {
            self.layout.turn_to(k);
            if !self.attempt(self.layout.facets(), Wants::Sums, token, stats)? {
                return Ok(false);
            }
            finished.append(&mut self.pass.finished);
            pairs += std::mem::take(&mut self.pass.pairs);
        }
        self.pass.finished = finished;
        stats.pairs += pairs;
        Ok(true)
    }

    /// Where there are windows, rows and first cells come in submissions of their own: what a window lacks is
    /// then known before any is added up.
    fn search_apart(&mut self, token: &Token) -> Result<(), RvdError> {
        self.on_device()?;
        if self.layout.windows().len() > 1 {
            self.search_now(token)?;
            self.start_now(token)?;
            self.on_device()?;
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
            self.layout.turn_to(self.layout.window_of(facets.start));
            let part = facets.start..facets.end.min(self.layout.facets().end);
            if self.attempt(part.clone(), Wants::Pairs, token, stats)? {
                stats.pairs += self.pass.pairs;
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
        let by_cell = self.grid.side > 0 && facets.len() == self.facets.len();
        if self.rows == Rows::Missing {
            self.promote()?;
        }
        self.pass = PassResult { polygon: self.first_polygon, by_cell, ..PassResult::default() };
        let Some(mut state) = self.launch_roots(facets, wants, token)? else { return Ok(false) };
        let mut variants = HashMap::new();
        count_retaken(&state, stats);
        loop {
            if state.list_overflow + state.cells_overflow > 0 {
                self.grow(state, stats)?;
                return Ok(false);
            }
            self.pass.length = state.length;
            if state.failures == state.requeued {
                break;
            }
            match self.relaunch(state, &mut variants, token, stats)? {
                Some(next) => state = next,
                None => return Ok(false),
            }
        }
        if self.pass.by_cell && !self.verify(state, stats, token)? {
            return Ok(false);
        }
        self.pass.pairs = u64::from(state.pieces) + self.pass.finished.len() as u64;
        Ok(true)
    }

    /// Clears what the pass uses, enters the facets' first cells and drains the list.
    /// `None` if the host took something over, so that the pass must begin anew.
    fn launch_roots(&mut self, facets: Range<u32>, wants: Wants, token: &Token) -> Result<Option<State>, RvdError> {
        self.on_device()?;
        // The rows of the host are in an order of its own.
        self.pass.divided = self.divides && wants == Wants::Sums && self.rows != Rows::Host;
        // Rows that are longer already may not be made again, and a list of which pieces are made has no pair twice.
        if wants == Wants::Sums && self.rows == Rows::Missing {
            self.pass.mends = self.lacked;
        }
        let roots = self.roots_params(&facets);
        let device = Arc::clone(&self.device);
        let mut encoder = device.encoder();
        self.encode_clears(&mut encoder, &facets, wants == Wants::Sums && self.layout.present() == 0);
        buffers::write(&device, &self.on_device()?.buffers.state, 0, &[State::default()])?;
        if roots.enqueue_count == 0 {
            return self.read_summary(encoder).map(Some);
        }
        let state = self.drain(encoder, Some(roots), Variant::Registers, token)?;
        if let Some(state) = &state {
            self.steps = (state.rounds + 2).clamp(FEWEST_STEPS, STEPS.1);
            if wants == Wants::Sums {
                self.count_facets(state, roots.enqueue_count);
            }
        }
        Ok(state)
    }

    /// Parameters of a pass over `facets` of the window at work.
    pub(super) fn roots_params(&self, facets: &Range<u32>) -> Params {
        let present = self.roots_of(facets);
        let first = present.start - self.roots_of(&self.layout.facets()).start;
        let by_both = self.pass.divided && self.pass.by_cell;
        Params {
            enqueue_begin: first as u32,
            enqueue_count: present.len() as u32,
            enqueue_root: ROOT,
            emit_count: if self.pass.by_cell { self.count as u32 } else { 0 },
            divided: if by_both { self.first_flag() as u32 } else { NONE },
            ..self.params()
        }
    }

    /// The slot where it begins to say which facets are divided.
    fn first_flag(&self) -> u64 {
        self.counts.slots - if self.grid.side > 0 { self.counts.window } else { 0 }
    }

    /// Clears what a pass over `facets` uses; the sums too if it `begins` them.
    pub(super) fn encode_clears(&self, encoder: &mut wgpu::CommandEncoder, facets: &Range<u32>, begins: bool) {
        let Some(there) = &self.on_device else { return };
        let buffers = &there.buffers;
        if let (Some(first), Some(last)) = (facets.clone().next(), facets.clone().next_back()) {
            let begin = u64::from(self.facets[first as usize].slot_begin);
            let end = u64::from(self.facets[last as usize].slot_begin) + (1 << self.slots_log2[last as usize]);
            encoder.clear_buffer(&buffers.slots, begin * 4, Some((end - begin) * 4));
        }
        if self.pass.divided && self.pass.by_cell {
            encoder.clear_buffer(&buffers.slots, self.first_flag() * 4, Some(self.counts.window * 4));
        }
        if begins {
            encoder.clear_buffer(&buffers.sums, 0, Some((self.count * SUM_WORDS * 4) as u64));
        }
    }

    /// Runs clip steps until the list is drained or something is full. `candidates` are entered
    /// first; the first step uses `variant`, the others registers.
    pub(super) fn drain(
        &mut self,
        mut encoder: wgpu::CommandEncoder,
        candidates: Option<Params>,
        mut variant: Variant,
        token: &Token,
    ) -> Result<Option<State>, RvdError> {
        let mut params = candidates;
        let mut steps = if variant == Variant::Large { 1 } else { self.steps };
        loop {
            token.check()?;
            let begin = Instant::now();
            let Some(state) = self.submit(encoder, params.take(), variant, steps, token)? else { return Ok(None) };
            if state.list_overflow + state.cells_overflow > 0 || state.head >= state.length {
                return Ok(Some(state));
            }
            steps = match variant {
                Variant::Large => STEPS.0,
                Variant::Registers if elapsed_ms(begin) < SUBMISSION_MS => (steps * 2).min(STEPS.1),
                Variant::Registers => steps,
            };
            variant = Variant::Registers;
            encoder = self.device.encoder();
        }
    }

    /// One submission: rows and first cells if the device lacks them, candidates, by facet and by cell,
    /// then `steps` times indirect arguments and clip, then the totals if they are wanted. Returns the summary,
    /// or `None` if the host took something over.
    fn submit(
        &mut self,
        mut encoder: wgpu::CommandEncoder,
        candidates: Option<Params>,
        variant: Variant,
        steps: u32,
        token: &Token,
    ) -> Result<Option<State>, RvdError> {
        let params = candidates.unwrap_or_else(|| self.params());
        let device = Arc::clone(&self.device);
        buffers::write(&device, &self.on_device()?.buffers.params, 0, &[params])?;
        let (search, start) = (self.rows == Rows::Missing, !self.started);
        if search {
            self.encode_search(&mut encoder, token)?;
        }
        if start {
            self.encode_start(&mut encoder, token)?;
        }
        self.on_device()?;
        self.encode_clip(&mut encoder, candidates.as_ref(), variant, steps, token)?;
        let state = self.read_summary(encoder)?;
        let settled =
            (!search || self.take_search_result(&state, token)?) && (!start || self.take_first_cells(&state)?);
        Ok(settled.then_some(state))
    }

    /// Encodes the candidates' arrival, by facet and by cell, then `steps` times indirect arguments and clip.
    pub(super) fn encode_clip(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        candidates: Option<&Params>,
        variant: Variant,
        steps: u32,
        token: &Token,
    ) -> Result<(), RvdError> {
        let (device, pipelines) = (&self.device, &self.pipelines);
        let limits = Limits::of(&device.limits());
        let shared = self.accumulate == accumulate::TWO_PHASE;
        let there = self.on_device.as_ref().ok_or_else(|| RvdError::Internal("no buffers".to_owned()))?;
        let window = &there.bindings.windows[self.layout.present()];
        let mut entries = Vec::with_capacity(2);
        let mut enter = |pipeline, bindings, items: u32, size| {
            entries.push(Stage { pipeline, bindings, items: items.into(), size, arguments: None });
        };
        if let Some(params) = candidates {
            if params.enqueue_root != 0 && self.pass.divided {
                let (room, weighted) = (self.divide_size(), usize::from(!self.surface.is_uniform()));
                let (divide, bindings) = (&pipelines.divide[room][weighted], &window.divide[room][weighted]);
                let size = if room < 2 && weighted == 0 { size::FACET } else { size::SEARCH };
                enter(divide, bindings, params.enqueue_count, size);
            } else {
                enter(&pipelines.enqueue, &window.enqueue, params.enqueue_count, size::ITEM);
            }
            if params.emit_count > 0 {
                enter(&pipelines.reach, &window.reach, params.emit_count, size::SEARCH);
            }
        }
        let long = entries.iter().any(Stage::is_long);
        if long {
            there.encode(device, encoder, lane::CLIP, &entries, token)?;
        }
        {
            let mut compute = device.pass(encoder, lane::CLIP);
            if !long {
                entries.iter().for_each(|stage| stage.run(&mut compute, limits));
            }
            let (clip, bindings) = match variant {
                Variant::Registers if shared => (&pipelines.clip_shared, &window.clip_shared),
                Variant::Registers => (&pipelines.clip, &window.clip),
                Variant::Large => (&pipelines.clip_large, &window.clip_large),
            };
            let taken = |compute: &mut wgpu::ComputePass<'_>, taking, with, clip, bindings| {
                compute.set_pipeline(taking);
                compute.set_bind_group(0, with, &[]);
                compute.dispatch_workgroups(1, 1, 1);
                compute.set_pipeline(clip);
                compute.set_bind_group(0, bindings, &[]);
                compute.dispatch_workgroups_indirect(&there.buffers.arguments, 0);
            };
            let mends =
                if candidates.is_some_and(|p| p.enqueue_root != 0) { self.pass.mends } else { Lacked::default() };
            let step = |compute: &mut wgpu::ComputePass<'_>| {
                taken(compute, &pipelines.indirect_arguments, &there.bindings.indirect_arguments, clip, bindings);
                if mends.neighbours {
                    compute.set_pipeline(&pipelines.lengthen);
                    compute.set_bind_group(0, &there.bindings.lengthen, &[]);
                    compute.dispatch_workgroups_indirect(&there.buffers.arguments, ARGUMENTS_BYTES);
                }
            };
            // What failed in one step is seen by the next, and comes again in the one after.
            let steps = steps + u32::from(mends.neighbours);
            (0..steps).for_each(|_| step(&mut compute));
            // With fewer slots allowed than there are, the host allows more first.
            if mends.slots && self.first_polygon as usize == self.slots {
                let (large, bindings) = (&pipelines.clip_large, &window.clip_large);
                taken(&mut compute, &pipelines.overflow, &there.bindings.overflow, large, bindings);
                (0..STEPS_AGAIN).for_each(|_| step(&mut compute));
            }
        }
        Ok(())
    }

    /// Which variant of `divide` suits the facets.
    /// By the surface and the number of seeds alone: another variant may round differently.
    fn divide_size(&self) -> usize {
        let h2 = self.surface.area() / self.count.max(1) as f64;
        let mean = pack::mean_cells(self.lengths, h2);
        MEMBERS.iter().position(|&m| ROOM * mean <= f64::from(m)).unwrap_or(MEMBERS.len() - 1)
    }

    /// Whether all pieces that cells entered are proved; if not, their facets are left to
    /// propagation and the pass begins anew.
    fn verify(&mut self, state: State, stats: &mut PassStats, token: &Token) -> Result<bool, RvdError> {
        let params = Params { emit_count: state.length, ..self.params() };
        let (device, pipelines) = (Arc::clone(&self.device), Arc::clone(&self.pipelines));
        let window = self.layout.present();
        let there = self.on_device()?;
        let buffers = &there.buffers;
        buffers::write(&device, &buffers.params, 0, &[params])?;
        buffers::write(&device, &buffers.state, 0, &[State { failures: 0, ..state }])?;
        let mut encoder = device.encoder();
        let (pipeline, bindings) = (&pipelines.verify, &there.bindings.windows[window].verify);
        let stage = Stage { pipeline, bindings, items: state.length.into(), size: size::ITEM, arguments: None };
        there.encode(&device, &mut encoder, lane::CLIP, &[stage], token)?;
        let mut unproved = 0;
        buffers.staging.read_with(&device, encoder, &buffers.state, 0..1, |s: &[State]| unproved = s[0].failures)?;
        if unproved == 0 {
            return Ok(true);
        }
        let failures: Vec<[u32; 2]> = buffers.staging.read(&device, &buffers.failures, 0..unproved as usize)?;
        self.leave_to_propagation(failures.iter().filter_map(|&e| failure(e)).map(|f| f.0).collect(), stats)?;
        Ok(false)
    }

    /// More slots for the facets whose sets were full, a longer list if it was. What has grown
    /// stays for the life of the session.
    fn grow(&mut self, state: State, stats: &mut PassStats) -> Result<(), RvdError> {
        stats.relaunched_cells += u64::from(state.cells_overflow) + u64::from(state.list_overflow);
        if state.cells_overflow > 0 {
            let device = Arc::clone(&self.device);
            let stored = (state.failures as usize).min(self.counts.pairs as usize);
            let buffers = &self.on_device()?.buffers;
            let failures: Vec<[u32; 2]> = buffers.staging.read(&device, &buffers.failures, 0..stored)?;
            let full: HashSet<u32> =
                failures.iter().filter_map(|&e| failure(e)).filter(|f| f.2 == code::CELLS).map(|f| f.0).collect();
            for facet in full {
                // Four times as many, but never more than all seeds need.
                let most = (self.count * 2).next_power_of_two().ilog2() as u8;
                let log2 = &mut self.slots_log2[facet as usize];
                *log2 = (*log2 + 2).min(most.max(*log2 + 1));
            }
        }
        if state.list_overflow > 0 {
            self.grow_list(u64::from(state.length));
        }
        self.release()
    }
}
