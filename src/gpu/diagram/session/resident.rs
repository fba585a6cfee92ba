//! Seeds that are moved on the device.
//!
//! Purpose: [`Resident`] for a GPU session: passes at the present point and at trial points, and what the optimizer makes of
//! them. Each call is one submission where nothing has to be done again, and scalars come back. [`Resident::relax`] has a pass and
//! the Lloyd step that follows from it in one submission, and, where passes end cleanly, many of both in one. The journal has what
//! each pass came to, and is read with the last.
//! Invariant: the optimizer is asked only when the device has the sums and gradients that it needs. Lloyd steps have the same bits
//! as one by one. The stage `may_step` lets a step follow only where the host would have nothing to do; a pass that is not so leaves
//! the seeds where they are, and all that comes after it in the submission does nothing. The host then does that pass as always.
//! Must not know: what a search along the direction looks for, how a pass is done again.

use std::mem::offset_of;
use std::time::Instant;

use super::{GpuSession, Result, finished, rooms};
use crate::buffers::write;
use crate::diagram::clip::{Launch, Variant, Wants, count_requeued, fixed};
use crate::diagram::layout::{ENTRY_BYTES, State, Totals};
use crate::diagram::neighbours::{Place, Rows};
use crate::diagram::optimizer::{Step, limbs};
use crate::diagram::space::DeviceSpace;
use geometry::rvd::clip::Integrals;
pub(super) use geometry::rvd::resident::{Evaluation, Resident};
use geometry::rvd::{CellSums, DeviceWork, PassStats, RvdError, elapsed_ms};
use geometry::token::Token;

impl<P: DeviceSpace> GpuSession<P> {
    /// Makes the optimizer's buffers, and puts the seeds there that were set last.
    pub(super) fn open_optimizer(&mut self) -> Result<()> {
        self.optimizer.open(&self.cx, &self.memory)?;
        if self.neighbours.place == Place::Set {
            self.optimizer.take_seeds(&self.cx, &self.neighbours)?;
            // What was found of the seeds as set holds for them as points, but for what the host did in f64
            // with bits that the device does not see.
            self.neighbours.place = Place::Point;
            self.seeds_changed();
        }
        Ok(())
    }

    /// The present point is another: what was known of it is of no use.
    pub(super) fn point_changed(&mut self) {
        self.seeds_changed();
        self.optimizer.point_changed();
    }

    /// A pass at `place`, its gradient and its totals.
    pub(super) fn evaluate_at(&mut self, place: Place, token: &Token) -> Result<Evaluation> {
        token.check()?;
        let before = self.work();
        let begin = Instant::now();
        if self.neighbours.place != place {
            self.neighbours.place = place;
            self.seeds_changed();
        }
        self.optimizer.there()?.begin_pass(place);
        let mut stats = PassStats::default();
        let ran = self.run_sums(token, &mut stats);
        stats.clip_ms = elapsed_ms(begin);
        let done = ran.and_then(|()| self.complete_totals(&mut stats, token));
        let moving = self.optimizer.there()?;
        moving.end_pass();
        done?;
        moving.pass_done(place);
        stats.duplicate_seeds = self.neighbours.duplicates;
        stats.device += self.work().since(&before);
        Ok(self.optimizer.describe(rooms!(self), place, stats))
    }

    /// Puts what the host did of the pass into the device's sums, or all sums where pieces do not cover
    /// the surface, and makes the totals anew.
    fn complete_totals(&mut self, stats: &mut PassStats, token: &Token) -> Result<()> {
        let mut words = None;
        if !self.clip.pass.finished.is_empty() {
            self.ensure_memory()?;
            words = Some(self.clip.sum_words(&self.memory, self.neighbours.count)?);
        }
        let mut area = self.optimizer.area(rooms!(self));
        if let Some(words) = &words {
            let areas =
                words.chunks_exact(P::SUM_WORDS).map(|cell| limbs(cell[P::SUM_WORDS - 2], cell[P::SUM_WORDS - 1]));
            area = areas.sum::<i64>() as f64 / self.clip.scales.area;
        }
        if !self.clip.covers(area, self.facets()) {
            let mut sums = CellSums::default();
            *stats = finished(*stats, self.in_f64()?.sums(&mut sums, token)?);
            let mut exact = vec![0; self.neighbours.count * P::SUM_WORDS];
            for (i, cell) in exact.chunks_exact_mut(P::SUM_WORDS).enumerate() {
                let (mass, moment, energy) = (sums.mass[i], sums.moment[i], sums.energy[i]);
                let whole = Integrals { mass, moment, energy, area: sums.area[i] };
                fixed::add(cell, &fixed::encode(&whole, &self.clip.scales));
            }
            words = Some(exact);
        }
        let Some(words) = words else { return Ok(()) };
        self.clip.pass.finished.clear();
        self.ensure_memory()?;
        write(&self.cx.device, &self.memory.there()?.buffers.sums, 0, &words)?;
        self.read_summary(self.cx.device.encoder())?;
        Ok(())
    }

    pub(super) fn step_to_centroids(&mut self) -> Result<()> {
        self.open_optimizer()?;
        if !self.optimizer.there()?.has_sums() {
            self.evaluate_at(Place::Point, &Token::default())?;
        }
        self.ensure_memory()?;
        self.optimizer.step_to_centroids(rooms!(self))?;
        self.point_changed();
        Ok(())
    }

    /// At least one step, and at most `steps`, in one submission where nothing has to be done again. None from a
    /// point with empty cells, whose evaluation is then the last.
    pub(super) fn take_steps(&mut self, steps: usize, evaluations: &mut Vec<Evaluation>, token: &Token) -> Result<()> {
        token.check()?;
        self.open_optimizer()?;
        self.ensure_memory()?;
        // Windows come one after another, facets that are found by cell have to be proved first, and sums of other devices come by
        // the host.
        let alone = self.memory.windows.all.len() == 1 && self.clip.near.side == 0 && self.others.is_empty();
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
    fn evaluate_and_step(&mut self, alone: bool, token: &Token) -> Result<(Evaluation, bool)> {
        self.optimizer.there()?.step = if alone { Step::Wanted } else { Step::No };
        let evaluation = self.evaluate_at(Place::Point, token);
        let taken = std::mem::replace(&mut self.optimizer.there()?.step, Step::No) == Step::Taken;
        if taken {
            self.point_changed();
        }
        Ok((evaluation?, taken))
    }

    /// `count` passes and steps in one submission. How many of them were clean, and so were taken.
    fn take_together(&mut self, count: usize, evaluations: &mut Vec<Evaluation>) -> Result<usize> {
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
    fn submit_together(&mut self, count: usize) -> Result<(Vec<(State, Totals)>, u32)> {
        // Where long stages are submitted on the way, a stop would leave steps without an evaluation.
        let to_the_end = Token::default();
        self.point_changed();
        self.neighbours.place = Place::Point;
        self.clip.begin(false);
        self.clip.choose(Wants::Sums, Rows::Missing);
        let facets = self.facets();
        let params = self.clip.roots_params(&self.memory, &self.neighbours, &facets);
        let launch = Launch { candidates: Some(params), variant: Variant::Registers, steps: self.clip.steps };
        self.ensure_memory()?;
        let of_optimizer = self.optimizer.params(rooms!(self));
        self.optimizer.prepare(rooms!(self), of_optimizer)?;
        self.memory.write_params(params)?;
        self.memory.write_state(State::default())?;
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
            self.neighbours.encode_first_cells(&self.memory, &mut encoder, &to_the_end)?;
            self.clip.encode_clip(&self.memory, seeds, &mut encoder, &launch, &to_the_end)?;
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

impl<P: DeviceSpace> Resident<P> for GpuSession<P> {
    fn hold(&mut self, held: &[bool]) -> Result<()> {
        let count = self.neighbours.count;
        self.open_optimizer()?;
        if held.len() != count {
            return Err(RvdError::Internal(format!("{} seeds are held or not, of {count}", held.len())));
        }
        self.optimizer.there()?.hold(&self.cx, held)
    }

    fn evaluate(&mut self, token: &Token) -> Result<Evaluation> {
        self.on_pool(|session| {
            session.open_optimizer()?;
            session.evaluate_at(Place::Point, token)
        })
    }

    fn to_centroids(&mut self) -> Result<()> {
        self.on_pool(|session| session.step_to_centroids())
    }

    fn relax(&mut self, steps: usize, evaluations: &mut Vec<Evaluation>, token: &Token) -> Result<()> {
        self.on_pool(|session| session.take_steps(steps.max(1), evaluations, token))
    }

    fn search_direction(&mut self) -> Result<f64> {
        self.on_pool(|session| {
            session.open_optimizer()?;
            // The masses are those of the last pass, which may have been of another point.
            if !session.optimizer.there()?.has_gradient_and_sums() {
                session.evaluate_at(Place::Point, &Token::default())?;
            }
            if let Place::Trial(_) = session.neighbours.place {
                // The same step along another direction is another point.
                session.neighbours.place = Place::Point;
                session.seeds_changed();
            }
            session.ensure_memory()?;
            session.optimizer.find_direction(rooms!(session))
        })
    }

    fn probe(&mut self, step: f64, token: &Token) -> Result<Evaluation> {
        self.on_pool(|session| {
            session.open_optimizer()?;
            if !session.optimizer.there()?.directed {
                return Err(RvdError::Internal("no direction to try".to_owned()));
            }
            session.evaluate_at(Place::Trial(step as f32), token)
        })
    }

    fn accept(&mut self) -> Result<()> {
        self.on_pool(|session| {
            let trial = matches!(session.neighbours.place, Place::Trial(_));
            if !trial || !session.optimizer.moving.as_ref().is_some_and(|m| m.has_trial()) {
                return Err(RvdError::Internal("no trial point to accept".to_owned()));
            }
            session.ensure_memory()?;
            session.optimizer.accept(rooms!(session))?;
            // The rows and sums are those of these very seeds.
            session.neighbours.place = Place::Point;
            Ok(())
        })
    }

    fn clear_history(&mut self) {
        self.optimizer.clear_history();
    }

    fn read(&mut self, out: &mut Vec<P>) -> Result<()> {
        self.open_optimizer()?;
        self.ensure_memory()?;
        let points = self.optimizer.read_points(rooms!(self))?;
        out.clear();
        out.extend(points.iter().map(P::of_record));
        Ok(())
    }

    fn read_sums(&mut self, out: &mut CellSums<P>) -> Result<()> {
        self.on_pool(|session| {
            session.open_optimizer()?;
            if !session.optimizer.there()?.has_sums() {
                session.evaluate_at(Place::Point, &Token::default())?;
            }
            session.download_sums(out)
        })
    }
}
