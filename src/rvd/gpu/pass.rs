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

use super::search::Rows;
use super::{GpuSession, fixed, lane, pack};
use crate::gpu::buffers;
use crate::gpu::layout::{MEMBERS, NONE, Params, ROOT, SUM_WORDS, State, accumulate, code, failure};
use crate::gpu::plan::{Limits, dispatch};
use crate::rvd::{CancelFlag, PassStats, RvdError, elapsed_ms};

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
    /// Polygon vertices allowed at present.
    pub polygon: u32,
    /// Whether facets were done as a whole where that was possible.
    pub divided: bool,
    /// Whether cells entered facets of their own, so that the pieces are to be proved.
    pub by_cell: bool,
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
const STEPS: (u32, u32) = (8, 64);
/// The variant of `divide` has room for so many times the cells that a mean facet is expected to meet. More room
/// costs every facet time, less sends more of them through the list of pairs.
const ROOM: f64 = 1.1;
/// A submission that took longer than this is not made longer.
const SUBMISSION_MS: f64 = 50.0;

impl GpuSession {
    /// Brings the pairs of `facets` to their end.
    pub(super) fn run_pass(
        &mut self,
        facets: Range<u32>,
        wants: Wants,
        cancel: &CancelFlag,
        stats: &mut PassStats,
    ) -> Result<(), RvdError> {
        while !self.attempt(facets.clone(), wants, cancel, stats)? {}
        Ok(())
    }

    /// One attempt from zero. `false` if a capacity had to grow.
    fn attempt(
        &mut self,
        facets: Range<u32>,
        wants: Wants,
        cancel: &CancelFlag,
        stats: &mut PassStats,
    ) -> Result<bool, RvdError> {
        // Of a part of the surface most cells are elsewhere.
        let by_cell = self.grid.side > 0 && facets.len() == self.facets.len();
        if self.rows == Rows::Missing {
            self.promote()?;
        }
        self.pass = PassResult { polygon: self.first_polygon, by_cell, ..PassResult::default() };
        let Some(mut state) = self.launch_roots(facets, wants, cancel)? else { return Ok(false) };
        let mut variants = HashMap::new();
        loop {
            if state.list_overflow + state.cells_overflow > 0 {
                self.grow(state, stats)?;
                return Ok(false);
            }
            self.pass.length = state.length;
            if state.failures == 0 {
                break;
            }
            match self.relaunch(state, &mut variants, cancel, stats)? {
                Some(next) => state = next,
                None => return Ok(false),
            }
        }
        if self.pass.by_cell && !self.verify(state, stats)? {
            return Ok(false);
        }
        stats.pairs += u64::from(state.pieces) + self.pass.finished.len() as u64;
        Ok(true)
    }

    /// Clears what the pass uses, enters the facets' first cells and drains the list.
    /// `None` if the host took something over, so that the pass must begin anew.
    fn launch_roots(
        &mut self,
        facets: Range<u32>,
        wants: Wants,
        cancel: &CancelFlag,
    ) -> Result<Option<State>, RvdError> {
        let first = self.roots.partition_point(|r| r[0] < facets.start);
        let last = self.roots.partition_point(|r| r[0] < facets.end);
        // The rows of the host are in an order of its own.
        self.pass.divided = self.divides && wants == Wants::Sums && self.rows != Rows::Host;
        let by_both = self.pass.divided && self.pass.by_cell;
        let flags = pack::slot_count(&self.slots_log2);
        let roots = Params {
            propose_begin: first as u32,
            propose_count: (last - first) as u32,
            propose_root: ROOT,
            emit_count: if self.pass.by_cell { self.count as u32 } else { 0 },
            divided: if by_both { flags as u32 } else { NONE },
            ..self.params()
        };
        let slot = |f: u32| {
            let begin = u64::from(self.facets[f as usize].slot_begin);
            (begin * 4, (begin + (1 << self.slots_log2[f as usize])) * 4)
        };
        let cleared = (!facets.is_empty()).then(|| slot(facets.start).0..slot(facets.end - 1).1);
        let (seeds, facet_count) = (self.count, self.facets.len() as u64);
        let device = Arc::clone(&self.device);
        let buffers = &self.on_device()?.buffers;
        let mut encoder = device.encoder();
        if let Some(range) = cleared {
            encoder.clear_buffer(&buffers.slots, range.start, Some(range.end - range.start));
        }
        if by_both {
            encoder.clear_buffer(&buffers.slots, flags * 4, Some(facet_count * 4));
        }
        if wants == Wants::Sums {
            encoder.clear_buffer(&buffers.sums, 0, Some((seeds * SUM_WORDS * 4) as u64));
        }
        buffers::write(&device, &buffers.state, 0, &[State::default()])?;
        if last == first {
            device.run(encoder)?;
            return Ok(Some(State::default()));
        }
        self.drain(encoder, Some(roots), Variant::Registers, cancel)
    }

    /// Runs clip steps until the list is drained or something is full. `proposals` are entered
    /// first; the first step uses `variant`, the others registers.
    pub(super) fn drain(
        &mut self,
        mut encoder: wgpu::CommandEncoder,
        proposals: Option<Params>,
        mut variant: Variant,
        cancel: &CancelFlag,
    ) -> Result<Option<State>, RvdError> {
        let mut params = proposals;
        let mut steps = if variant == Variant::Large { 1 } else { STEPS.0 };
        loop {
            cancel.check()?;
            let begin = Instant::now();
            let Some(state) = self.submit(encoder, params.take(), variant, steps, cancel)? else { return Ok(None) };
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

    /// One submission: rows and first cells if the device lacks them, proposals, by facet and by cell,
    /// then `steps` times prepare and clip, then the figures if they are wanted. Returns the summary,
    /// or `None` if the host took something over.
    fn submit(
        &mut self,
        mut encoder: wgpu::CommandEncoder,
        proposals: Option<Params>,
        variant: Variant,
        steps: u32,
        cancel: &CancelFlag,
    ) -> Result<Option<State>, RvdError> {
        let params = proposals.unwrap_or_else(|| self.params());
        let (device, pipelines) = (Arc::clone(&self.device), Arc::clone(&self.pipelines));
        let limits = Limits::of(&device.limits());
        let shared = self.accumulate == accumulate::TWO_PHASE;
        buffers::write(&device, &self.on_device()?.buffers.params, 0, &[params])?;
        let (search, start) = (self.rows == Rows::Missing, !self.started);
        if search {
            self.encode_search(&mut encoder)?;
        }
        if start {
            self.encode_start(&mut encoder)?;
        }
        self.on_device()?;
        let there = self.on_device.as_ref().ok_or_else(|| RvdError::Internal("no buffers".to_owned()))?;
        {
            let mut compute = device.pass(&mut encoder, lane::CLIP);
            if proposals.is_some() && params.propose_root != 0 && self.pass.divided {
                let (size, weighted) = (self.divide_size(), usize::from(!self.surface.is_uniform()));
                let (divide, bindings) = (&pipelines.divide[size][weighted], &there.bindings.divide[size][weighted]);
                run(&mut compute, divide, bindings, params.propose_count.into(), limits);
            } else if proposals.is_some() {
                run(&mut compute, &pipelines.propose, &there.bindings.propose, params.propose_count.into(), limits);
            }
            if params.emit_count > 0 {
                run(&mut compute, &pipelines.reach, &there.bindings.reach, params.emit_count.into(), limits);
            }
            let (clip, bindings) = match variant {
                Variant::Registers if shared => (&pipelines.clip_shared, &there.bindings.clip_shared),
                Variant::Registers => (&pipelines.clip, &there.bindings.clip),
                Variant::Large => (&pipelines.clip_large, &there.bindings.clip_large),
            };
            for _ in 0..steps {
                compute.set_pipeline(&pipelines.prepare);
                compute.set_bind_group(0, &there.bindings.prepare, &[]);
                compute.dispatch_workgroups(1, 1, 1);
                compute.set_pipeline(clip);
                compute.set_bind_group(0, bindings, &[]);
                compute.dispatch_workgroups_indirect(&there.buffers.arguments, 0);
            }
        }
        let state = self.read_summary(encoder)?;
        let settled = (!search || self.settle_search(&state, cancel)?) && (!start || self.settle_start(&state)?);
        Ok(settled.then_some(state))
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
    fn verify(&mut self, state: State, stats: &mut PassStats) -> Result<bool, RvdError> {
        let params = Params { emit_count: state.length, ..self.params() };
        let (device, pipelines) = (Arc::clone(&self.device), Arc::clone(&self.pipelines));
        let limits = Limits::of(&device.limits());
        let there = self.on_device()?;
        let buffers = &there.buffers;
        buffers::write(&device, &buffers.params, 0, &[params])?;
        buffers::write(&device, &buffers.state, 0, &[State { failures: 0, ..state }])?;
        let mut encoder = device.encoder();
        {
            let mut compute = device.pass(&mut encoder, lane::CLIP);
            run(&mut compute, &pipelines.verify, &there.bindings.verify, state.length.into(), limits);
        }
        let mut unproved = 0;
        buffers.read_with(&device, encoder, &buffers.state, 0..1, |s: &[State]| unproved = s[0].failures)?;
        if unproved == 0 {
            return Ok(true);
        }
        let failures: Vec<[u32; 2]> = buffers.read(&device, &buffers.failures, 0..unproved as usize)?;
        self.leave_to_propagation(failures.iter().map(|&e| failure(e).0).collect(), stats)?;
        Ok(false)
    }

    /// More slots for the facets whose sets were full, a longer list if it was. What has grown
    /// stays for the life of the session.
    fn grow(&mut self, state: State, stats: &mut PassStats) -> Result<(), RvdError> {
        stats.relaunched_cells += u64::from(state.cells_overflow) + u64::from(state.list_overflow);
        if state.cells_overflow > 0 {
            let slots_before = pack::slot_count(&self.slots_log2);
            let device = Arc::clone(&self.device);
            let stored = (state.failures as usize).min(self.counts.pairs as usize);
            let buffers = &self.on_device()?.buffers;
            let failures: Vec<[u32; 2]> = buffers.read(&device, &buffers.failures, 0..stored)?;
            let full: HashSet<u32> =
                failures.iter().map(|&e| failure(e)).filter(|f| f.2 == code::CELLS).map(|f| f.0).collect();
            for facet in full {
                // Four times as many, but never more than all seeds need.
                let most = (self.count * 2).next_power_of_two().ilog2() as u8;
                let log2 = &mut self.slots_log2[facet as usize];
                *log2 = (*log2 + 2).min(most.max(*log2 + 1));
            }
            let flags = self.counts.slots - slots_before;
            self.counts.slots = pack::slot_count(&self.slots_log2) + flags;
            pack::assign_slots(&mut self.facets, &self.slots_log2);
        }
        if state.list_overflow > 0 {
            self.grow_list(u64::from(state.length));
        }
        self.release()
    }

    /// Room for `pairs` pairs and half as many again.
    pub(super) fn grow_list(&mut self, pairs: u64) {
        self.counts.pairs = (self.counts.pairs * 2).max(pairs + pairs / 2);
    }
}

/// Dispatches a stage over `items`.
pub(super) fn run(
    compute: &mut wgpu::ComputePass<'_>,
    pipeline: &wgpu::ComputePipeline,
    bindings: &wgpu::BindGroup,
    items: u64,
    limits: Limits,
) {
    let [x, y] = dispatch(items, limits);
    compute.set_pipeline(pipeline);
    compute.set_bind_group(0, bindings, &[]);
    compute.dispatch_workgroups(x, y, 1);
}
