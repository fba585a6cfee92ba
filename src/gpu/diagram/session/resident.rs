//! Seeds that are moved on the device.
//!
//! Purpose: [`Resident`] for a GPU session: passes at the present point and at trial points, and what the optimizer makes of
//! them. Each call is one submission where nothing has to be done again, and scalars come back.
//! Invariant: the optimizer is asked only when the device has the sums and gradients that it needs.
//! Must not know: what a search along the direction looks for.

use std::time::Instant;

use glam::DVec3;

use super::{GpuSession, rooms};
use crate::buffers::write;
use crate::diagram::clip::fixed;
use crate::diagram::layout::SUM_WORDS;
use crate::diagram::neighbours::Place;
use geometry::rvd::clip::Integrals;
pub(super) use geometry::rvd::resident::{Evaluation, Resident};
use geometry::rvd::{CellSums, PassStats, RvdError, elapsed_ms};
use geometry::token::Token;

impl GpuSession {
    /// Makes the optimizer's buffers, and puts the seeds there that were set last.
    pub(super) fn open_optimizer(&mut self) -> Result<(), RvdError> {
        self.optimizer.open(&self.cx)?;
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
    pub(super) fn evaluate_at(&mut self, place: Place, token: &Token) -> Result<Evaluation, RvdError> {
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
        self.meter(&before, &mut stats);
        Ok(self.optimizer.describe(rooms!(self), place, stats))
    }

    /// Puts what the host did of the pass into the device's sums, or all sums where pieces do not cover
    /// the surface, and makes the totals anew.
    fn complete_totals(&mut self, stats: &mut PassStats, token: &Token) -> Result<(), RvdError> {
        let mut words = None;
        if !self.clip.pass.finished.is_empty() {
            self.ensure_memory()?;
            words = Some(self.clip.sum_words(&self.cx, &self.memory, self.neighbours.count)?);
        }
        let mut area = self.optimizer.area(rooms!(self));
        if let Some(words) = &words {
            let limbs = |cell: &[u32]| ((u64::from(cell[11]) << 32) | u64::from(cell[10])) as i64;
            area = words.chunks_exact(SUM_WORDS).map(limbs).sum::<i64>() as f64 / self.clip.scales.area;
        }
        if !self.clip.covers(&self.cx, area, self.facets()) {
            let mut sums = CellSums::default();
            *stats = self.sums_in_f64(&mut sums, *stats, token)?;
            let mut exact = vec![0; self.neighbours.count * SUM_WORDS];
            for (i, cell) in exact.chunks_exact_mut(SUM_WORDS).enumerate() {
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

    fn find_direction(&mut self) -> Result<f64, RvdError> {
        self.open_optimizer()?;
        // The masses are those of the last pass, which may have been of another point.
        if !self.optimizer.there()?.has_gradient_and_sums() {
            self.evaluate_at(Place::Point, &Token::default())?;
        }
        if let Place::Trial(_) = self.neighbours.place {
            // The same step along another direction is another point.
            self.neighbours.place = Place::Point;
            self.seeds_changed();
        }
        self.ensure_memory()?;
        self.optimizer.find_direction(rooms!(self))
    }

    fn accept_trial(&mut self) -> Result<(), RvdError> {
        let trial = matches!(self.neighbours.place, Place::Trial(_));
        if !trial || !self.optimizer.moving().is_some_and(|m| m.has_trial()) {
            return Err(RvdError::Internal("no trial point to accept".to_owned()));
        }
        self.ensure_memory()?;
        self.optimizer.accept(rooms!(self))?;
        // The rows and sums are those of these very seeds.
        self.neighbours.place = Place::Point;
        Ok(())
    }

    /// Moves the seeds to their cells' centroids.
    pub(super) fn step_to_centroids(&mut self) -> Result<(), RvdError> {
        self.open_optimizer()?;
        if !self.optimizer.there()?.has_sums() {
            self.evaluate_at(Place::Point, &Token::default())?;
        }
        self.ensure_memory()?;
        self.optimizer.step_to_centroids(rooms!(self))?;
        self.point_changed();
        Ok(())
    }
}

impl Resident for GpuSession {
    fn hold(&mut self, held: &[bool]) -> Result<(), RvdError> {
        let count = self.neighbours.count;
        self.open_optimizer()?;
        if held.len() != count {
            return Err(RvdError::Internal(format!("{} seeds are held or not, of {count}", held.len())));
        }
        self.optimizer.there()?.hold(&self.cx, held)
    }

    fn evaluate(&mut self, token: &Token) -> Result<Evaluation, RvdError> {
        self.on_pool(|session| {
            session.open_optimizer()?;
            session.evaluate_at(Place::Point, token)
        })
    }

    fn to_centroids(&mut self) -> Result<(), RvdError> {
        self.on_pool(|session| session.step_to_centroids())
    }

    fn relax(&mut self, steps: usize, evaluations: &mut Vec<Evaluation>, token: &Token) -> Result<(), RvdError> {
        self.on_pool(|session| session.take_steps(steps.max(1), evaluations, token))
    }

    fn search_direction(&mut self) -> Result<f64, RvdError> {
        self.on_pool(|session| session.find_direction())
    }

    fn probe(&mut self, step: f64, token: &Token) -> Result<Evaluation, RvdError> {
        self.on_pool(|session| {
            session.open_optimizer()?;
            if !session.optimizer.there()?.directed {
                return Err(RvdError::Internal("no direction to try".to_owned()));
            }
            session.evaluate_at(Place::Trial(step as f32), token)
        })
    }

    fn accept(&mut self) -> Result<(), RvdError> {
        self.on_pool(|session| session.accept_trial())
    }

    fn clear_history(&mut self) {
        self.optimizer.clear_history();
    }

    fn read(&mut self, out: &mut Vec<DVec3>) -> Result<(), RvdError> {
        self.open_optimizer()?;
        self.ensure_memory()?;
        let points = self.optimizer.read_points(rooms!(self))?;
        out.clear();
        out.extend(points.iter().map(|p| DVec3::from_array(p.position())));
        Ok(())
    }

    fn read_sums(&mut self, out: &mut CellSums) -> Result<(), RvdError> {
        self.on_pool(|session| {
            session.open_optimizer()?;
            if !session.optimizer.there()?.has_sums() {
                session.evaluate_at(Place::Point, &Token::default())?;
            }
            session.download_sums(out)
        })
    }
}
