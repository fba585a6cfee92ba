//! Lloyd steps without the host.
//!
//! Purpose: a pass and the step that follows from it in one submission, and, where passes end cleanly, many of both
//! in one: [`Resident::relax`](crate::rvd::Resident::relax). The journal has what each pass came to, and is read
//! with the last.
//! Invariant: the same bits as one by one. The stage `may_step` lets a step follow only where the host would have
//! nothing to do; a pass that is not so leaves the seeds where they are, and all that comes after it in the submission
//! does nothing. The host then does that pass as it always does.
//! Must not know: how a pass is done again.

use std::mem::offset_of;
use std::sync::Arc;
use std::time::Instant;

use super::layout::{ENTRY_BYTES, State, Totals};
use super::pass::{PassResult, Variant, count_retaken};
use super::plan::PASSES;
use super::search::Place;
use super::{GpuSession, OnDevice, lane};
use crate::gpu::buffers;
use crate::gpu::dispatch::{reduction, run};
use crate::gpu::limits::Limits;
use crate::rvd::{Look, PassStats, RvdError, Together, elapsed_ms};
use crate::token::Token;

/// A submission of several passes is not to take longer, by what the last ones took.
const SUBMISSION_MS: f64 = 100.0;

/// How many passes the next submission may have.
pub(super) struct Next {
    count: usize,
    by: Together,
}

impl Next {
    pub(super) fn new(by: Together) -> Self {
        Self { count: 1, by }
    }

    /// `taken` passes out of `tried` were clean, in `ms` altogether: twice as many next time, or one.
    fn learn(&mut self, tried: usize, taken: usize, ms: f64) {
        let most = match self.by {
            Together::ByTime => (SUBMISSION_MS * taken as f64 / ms.max(1e-3)) as usize,
            Together::AtMost(most) => most,
        };
        self.count = if taken < tried { 1 } else { (2 * tried).max(self.count).min(most).clamp(1, PASSES) };
    }
}

impl GpuSession {
    /// At least one step, and at most `steps`, in one submission where nothing has to be done again. None from a
    /// point with empty cells, whose look is then the last.
    pub(super) fn take_steps(&mut self, steps: usize, looks: &mut Vec<Look>, token: &Token) -> Result<(), RvdError> {
        token.check()?;
        self.moving()?;
        self.on_device()?;
        // Windows come one after another, and facets that are found by cell have to be proved first.
        let alone = self.layout.windows().len() == 1 && self.grid.side == 0;
        let together = steps.min(self.moving()?.together.count);
        let before = self.work();
        let begin = Instant::now();
        if alone && together > 1 {
            let taken = self.take_together(together, looks)?;
            self.moving()?.together.learn(together, taken, elapsed_ms(begin));
            if taken > 0 {
                return Ok(());
            }
        }
        let mut look = self.look_and_step(alone, token)?;
        let moved = std::mem::take(&mut self.moving()?.moved);
        if look.empty_cells == 0 && !moved {
            self.centre()?;
        }
        self.moving()?.together.learn(1, usize::from(moved), elapsed_ms(begin));
        look.stats.set_device_work(self.work().since(&before));
        looks.push(look);
        Ok(())
    }

    fn look_and_step(&mut self, alone: bool, token: &Token) -> Result<Look, RvdError> {
        let moving = self.moving()?;
        (moving.steps, moving.moved) = (alone, false);
        let look = self.look(Place::Point, token);
        let moving = self.moving()?;
        moving.steps = false;
        if moving.moved {
            self.left();
        }
        look
    }

    /// `count` passes and steps in one submission. How many of them were clean, and so were taken.
    fn take_together(&mut self, count: usize, looks: &mut Vec<Look>) -> Result<usize, RvdError> {
        // Where long stages are submitted on the way, steps are taken that no look would tell of.
        let to_the_end = Token::default();
        let before = self.work();
        let begin = Instant::now();
        let device = Arc::clone(&self.device);
        self.left();
        self.place = Place::Point;
        self.pass = PassResult { polygon: self.first_polygon, divided: self.divides, ..PassResult::default() };
        self.pass.mends = self.lacked;
        let facets = 0..self.facets.len() as u32;
        let params = self.roots_params(&facets);
        self.write_optimizer_params(self.optimizer_params())?;
        self.bind_optimizer()?;
        let b = &self.on_device()?.buffers;
        buffers::write(&device, &b.params, 0, &[params])?;
        buffers::write(&device, &b.state, 0, &[State::default()])?;
        let mut encoder = device.encoder();
        for k in 0..count as u64 {
            let Some(OnDevice { buffers: b, .. }) = &self.on_device else { break };
            // All of the summary but what stops the rest.
            let (halt, size) = (offset_of!(State, halt) as u64, size_of::<State>() as u64);
            encoder.clear_buffer(&b.state, 0, Some(halt));
            encoder.clear_buffer(&b.state, halt + 4, Some(size - halt - 4));
            self.encode_clears(&mut encoder, &facets, true);
            self.encode_search(&mut encoder, &to_the_end)?;
            self.encode_start(&mut encoder, &to_the_end)?;
            self.encode_clip(&mut encoder, Some(&params), Variant::Registers, self.steps, &to_the_end)?;
            self.encode_gradient(&mut encoder, Place::Point, true)?;
            let (moving, _, there) = self.bound()?;
            let (at, journal) = (k * ENTRY_BYTES, &moving.buffers.journal);
            encoder.copy_buffer_to_buffer(&there.buffers.state, 0, journal, at, size);
            encoder.copy_buffer_to_buffer(&moving.buffers.totals, 0, journal, at + size, ENTRY_BYTES - size);
        }
        let mut passes: Vec<(State, Totals)> = Vec::with_capacity(count);
        let (moving, _, there) = self.bound()?;
        let journal = (&moving.buffers.journal, 0, count as u64 * ENTRY_BYTES);
        there.buffers.staging.read_parts(&device, encoder, &[journal], |bytes| {
            passes.extend(bytes.chunks_exact(ENTRY_BYTES as usize).map(|entry| {
                let (state, totals) = entry.split_at(size_of::<State>());
                (bytemuck::pod_read_unaligned(state), bytemuck::pod_read_unaligned(totals))
            }));
        })?;
        let taken = passes.iter().take_while(|pass| pass.0.halt == 0).count();
        let clip_ms = elapsed_ms(begin) / taken.max(1) as f64;
        let first = looks.len();
        for (state, totals) in passes.into_iter().take(taken) {
            let mut stats = PassStats { clip_ms, pairs: state.pieces.into(), ..PassStats::default() };
            stats.duplicate_seeds = state.duplicates.into();
            count_retaken(&state, &mut stats);
            let work = self.count_facets(&state, params.enqueue_count);
            stats.set_device_work(work);
            self.moving()?.totals = totals;
            looks.push(self.describe(Place::Point, stats));
        }
        if let Some(look) = looks.get_mut(first) {
            // What the submission took is put down to its first pass.
            let (own, all) = (look.stats.device_work(), self.work().since(&before));
            let (divided_facets, paired_facets) = (own.divided_facets, own.paired_facets);
            look.stats.set_device_work(crate::rvd::DeviceWork { divided_facets, paired_facets, ..all });
        }
        Ok(taken)
    }

    /// Encodes gradient and totals, and a step if `steps` says so and the pass is at its end.
    pub(super) fn encode_gradient(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        place: Place,
        steps: bool,
    ) -> Result<(), RvdError> {
        let limits = Limits::of(&self.device.limits());
        let (_, bindings, _) = self.bound()?;
        let gradient = if place == Place::Point { &bindings.gradient } else { &bindings.gradient_ahead };
        let mut compute = self.device.pass(encoder, lane::UPDATE);
        compute.set_pipeline(&self.pipelines.gradient);
        compute.set_bind_group(0, gradient, &[]);
        compute.dispatch_workgroups(reduction(self.count as u64), 1, 1);
        compute.set_pipeline(&self.pipelines.totals);
        compute.set_bind_group(0, &bindings.totals, &[]);
        compute.dispatch_workgroups(1, 1, 1);
        if steps {
            compute.set_pipeline(&self.pipelines.may_step);
            compute.set_bind_group(0, &bindings.may_step, &[]);
            compute.dispatch_workgroups(1, 1, 1);
            run(&mut compute, &self.pipelines.centroids, &bindings.centroids, self.count as u64, limits);
        }
        Ok(())
    }

    /// The present point is another: what was known of it is of no use.
    pub(super) fn left(&mut self) {
        self.moved();
        if let Some(moving) = &mut self.moving {
            moving.leave();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clean_passes_double_within_the_time_and_others_begin_anew() {
        let mut together = Next::new(Together::ByTime);
        let mut seen = Vec::new();
        for _ in 0..7 {
            seen.push(together.count);
            together.learn(together.count, together.count, 1.0);
        }
        assert_eq!(seen, [1, 2, 4, 8, 16, 32, 32]);
        together.learn(32, 3, 10.0);
        assert_eq!(together.count, 1);
        together.learn(1, 1, 20.0);
        together.learn(2, 2, 40.0);
        together.learn(4, 4, 80.0);
        assert_eq!(together.count, 5);
        // Fewer than might have been.
        together.learn(3, 3, 6.0);
        assert_eq!(together.count, 6);
        together.learn(1, 1, 500.0);
        assert_eq!(together.count, 1);
        let mut together = Next::new(Together::AtMost(4));
        for count in [1, 2, 4, 4] {
            assert_eq!(together.count, count);
            together.learn(count, count, 1e6);
        }
        together.learn(4, 3, 1.0);
        assert_eq!(together.count, 1);
    }
}
