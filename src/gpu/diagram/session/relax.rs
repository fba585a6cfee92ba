//! Lloyd steps without the host.
//!
//! Purpose: a pass and the step that follows from it in one submission, and, where passes end cleanly, many of both
//! in one: [`Resident::relax`](geometry::rvd::Resident::relax). The journal has what each pass came to, and is read
//! with the last.
//! Invariant: the same bits as one by one. The stage `may_step` lets a step follow only where the host would have
//! nothing to do; a pass that is not so leaves the seeds where they are, and all that comes after it in the submission
//! does nothing. The host then does that pass as it always does.
//! Must not know: how a pass is done again.

use std::mem::offset_of;
use std::time::Instant;

use super::{GpuSession, rooms};
use crate::diagram::clip::{Launch, Variant, Wants, count_requeued};
use crate::diagram::layout::{ENTRY_BYTES, State, Totals};
use crate::diagram::neighbours::{Place, Rows};
use crate::diagram::optimizer::Step;
use geometry::rvd::{DeviceWork, Evaluation, PassStats, RvdError, elapsed_ms};
use geometry::token::Token;

impl GpuSession {
    /// At least one step, and at most `steps`, in one submission where nothing has to be done again. None from a
    /// point with empty cells, whose evaluation is then the last.
    pub(super) fn take_steps(
        &mut self,
        steps: usize,
        evaluations: &mut Vec<Evaluation>,
        token: &Token,
    ) -> Result<(), RvdError> {
        token.check()?;
        self.open_optimizer()?;
        self.ensure_memory()?;
        // Windows come one after another, and facets that are found by cell have to be proved first.
        let alone = self.memory.windows.all.len() == 1 && self.clip.near.side == 0;
        let together = steps.min(self.optimizer.there()?.batch.count);
        let before = self.work();
        let begin = Instant::now();
        if alone && together > 1 {
            let taken = self.take_together(together, evaluations)?;
            self.optimizer.there()?.batch.learn(together, taken, elapsed_ms(begin));
            if taken > 0 {
                return Ok(());
            }
        }
        let (mut evaluation, taken) = self.evaluate_and_step(alone, token)?;
        if evaluation.empty_cells == 0 && !taken {
            self.step_to_centroids()?;
        }
        self.optimizer.there()?.batch.learn(1, usize::from(taken), elapsed_ms(begin));
        evaluation.stats.device = self.work().since(&before);
        evaluations.push(evaluation);
        Ok(())
    }

    /// A pass, and a step with it if the pass is `alone` in its submission. Whether the step was taken.
    fn evaluate_and_step(&mut self, alone: bool, token: &Token) -> Result<(Evaluation, bool), RvdError> {
        self.optimizer.there()?.step = if alone { Step::Wanted } else { Step::No };
        let evaluation = self.evaluate_at(Place::Point, token);
        let taken = std::mem::replace(&mut self.optimizer.there()?.step, Step::No) == Step::Taken;
        if taken {
            self.point_changed();
        }
        Ok((evaluation?, taken))
    }

    /// `count` passes and steps in one submission. How many of them were clean, and so were taken.
    fn take_together(&mut self, count: usize, evaluations: &mut Vec<Evaluation>) -> Result<usize, RvdError> {
        let before = self.work();
        let begin = Instant::now();
        let (passes, roots) = self.submit_together(count)?;
        let taken = passes.iter().take_while(|pass| pass.0.halt == 0).count();
        let clip_ms = elapsed_ms(begin) / taken.max(1) as f64;
        let first = evaluations.len();
        for (state, totals) in passes.into_iter().take(taken) {
            let mut stats = PassStats { clip_ms, pairs: state.pieces.into(), ..PassStats::default() };
            stats.duplicate_seeds = state.duplicates.into();
            count_requeued(&state, &mut stats);
            stats.device = self.clip.count_facets(&state, roots);
            self.optimizer.there()?.totals = totals;
            evaluations.push(self.optimizer.describe(rooms!(self), Place::Point, stats));
        }
        if let Some(evaluation) = evaluations.get_mut(first) {
            // What the submission took is put down to its first pass.
            let DeviceWork { divided_facets, paired_facets, .. } = evaluation.stats.device;
            evaluation.stats.device = DeviceWork { divided_facets, paired_facets, ..self.work().since(&before) };
        }
        Ok(taken)
    }

    /// State and totals of `count` passes and steps in one submission, and the first cells that each entered.
    fn submit_together(&mut self, count: usize) -> Result<(Vec<(State, Totals)>, u32), RvdError> {
        // Where long stages are submitted on the way, a stop would leave steps without an evaluation.
        let to_the_end = Token::default();
        self.point_changed();
        self.neighbours.place = Place::Point;
        self.clip.begin(false);
        self.clip.choose(Wants::Sums, Rows::Missing);
        let facets = self.facets();
        let params = self.clip.roots_params(&self.cx, &self.memory, &self.neighbours, &facets);
        let launch = Launch { candidates: Some(params), variant: Variant::Registers, steps: self.clip.steps };
        self.ensure_memory()?;
        let of_optimizer = self.optimizer.params(rooms!(self));
        self.optimizer.prepare(rooms!(self), of_optimizer)?;
        self.clip.write_params(&self.cx, &self.memory, params)?;
        self.clip.write_state(&self.cx, &self.memory, State::default())?;
        let seeds = self.neighbours.count;
        let size = size_of::<State>() as u64;
        let mut encoder = self.cx.device.encoder();
        for k in 0..count as u64 {
            let state = self.memory.there()?.buffers.state.clone();
            // All of the summary but what stops the rest.
            let halt = offset_of!(State, halt) as u64;
            encoder.clear_buffer(&state, 0, Some(halt));
            encoder.clear_buffer(&state, halt + 4, Some(size - halt - 4));
            self.clip.encode_clears(&self.memory, &mut encoder, &facets, Some(seeds))?;
            self.encode_search(&mut encoder, &to_the_end)?;
            self.neighbours.encode_first_cells(&self.cx, &self.memory, &mut encoder, &to_the_end)?;
            self.clip.encode_clip(&self.cx, &self.memory, seeds, &mut encoder, &launch, &to_the_end)?;
            self.optimizer.encode_gradient(rooms!(self), &mut encoder, Place::Point, true)?;
            let buffers = &self.optimizer.there()?.buffers;
            let at = k * ENTRY_BYTES;
            encoder.copy_buffer_to_buffer(&state, 0, &buffers.journal, at, size);
            encoder.copy_buffer_to_buffer(&buffers.totals, 0, &buffers.journal, at + size, ENTRY_BYTES - size);
        }
        let mut passes: Vec<(State, Totals)> = Vec::with_capacity(count);
        let journal = (&self.optimizer.there()?.buffers.journal, 0, count as u64 * ENTRY_BYTES);
        let staging = &self.memory.there()?.buffers.staging;
        staging.read_parts(&self.cx.device, encoder, &[journal], |bytes| {
            passes.extend(bytes.chunks_exact(ENTRY_BYTES as usize).map(|entry| {
                let (state, totals) = entry.split_at(size_of::<State>());
                (bytemuck::pod_read_unaligned(state), bytemuck::pod_read_unaligned(totals))
            }));
        })?;
        Ok((passes, params.enqueue_count))
    }
}
