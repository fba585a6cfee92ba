//! Seeds that are moved on the device.
//!
//! Purpose: [`Resident`] for a GPU session. The present point x, its gradient, the direction and the
//! history are buffers; each call is one submission where nothing has to be done again, and scalars
//! come back.
//! Invariant: a trial point goes into the pass's own seeds, so x is what it was until it is accepted.
//! Energy and area are added as integers, the rest in a fixed tree: the same bits on every run.
//! Gradients are stored times a power of two that makes a mean one about 1, far from what floats lose.
//! Must not know: what a search along the direction looks for.

use std::sync::Arc;
use std::time::Instant;

use glam::DVec3;

use super::buffers::OptimizerBuffers;
use super::layout::{self, DOTS, OptimizerParams, PAIRS, SUM_WORDS, State, Totals};
use super::pipelines::OptimizerBindings;
use super::plan::OptimizerPlan;
use super::relax;
use super::search::Place;
use super::{GpuSession, OnDevice, fixed, history::History, lane, pack};
use crate::gpu::buffers;
use crate::gpu::dispatch::{reduction, run};
use crate::gpu::limits::Limits;
use crate::rvd::clip::Integrals;
use crate::rvd::resident::{Look, Resident};
use crate::rvd::{CellSums, PassStats, RvdError, elapsed_ms};
use crate::token::Token;

/// What a session has once somebody moves its seeds.
pub(super) struct Moving {
    pub buffers: OptimizerBuffers,
    bindings: Option<OptimizerBindings>,
    held: Vec<bool>,
    history: History,
    /// The products in `history` are those of the present gradient.
    products_known: bool,
    /// There is a direction.
    directed: bool,
    /// The gradient is that of the present point, the other one that of the last trial.
    gradient_known: bool,
    ahead_known: bool,
    /// Whose sums the device has.
    sums_of: Option<Place>,
    /// Of the present pass, while it is one of a point.
    wanted: Option<Place>,
    /// A step is to follow the pass at once, if that ends with its first submission; it has.
    pub steps: bool,
    pub moved: bool,
    /// How many passes a submission may have.
    pub together: relax::Next,
    /// As read last.
    pub totals: Totals,
}

impl Moving {
    pub(super) fn device_bytes(&self) -> u64 {
        self.buffers.plan().total_bytes()
    }

    /// Whether the present pass ends with totals.
    pub(super) fn wants_totals(&self) -> bool {
        self.wanted.is_some()
    }

    /// The buffers that the stages were bound to are gone.
    pub(super) fn unbind(&mut self) {
        self.bindings = None;
    }

    /// Another pass took the sums' place.
    pub(super) fn sums_lost(&mut self) {
        self.sums_of = None;
    }

    fn forget(&mut self) {
        self.history.forget();
    }

    /// The present point is another.
    pub(super) fn leave(&mut self) {
        self.forget();
        self.gradient_known = false;
        self.products_known = false;
        self.ahead_known = false;
        self.sums_of = None;
    }
}

fn missing() -> RvdError {
    RvdError::Internal("seeds that are moved have no buffers".to_owned())
}

impl GpuSession {
    /// The buffers, and in them the seeds that were set last.
    pub(super) fn moving(&mut self) -> Result<&mut Moving, RvdError> {
        let device = Arc::clone(&self.device);
        if self.moving.is_none() {
            let plan = OptimizerPlan::new(self.max_seeds as u64, Limits::of(&device.limits()))?;
            self.moving = Some(Moving {
                buffers: OptimizerBuffers::new(&device, plan)?,
                bindings: None,
                held: Vec::new(),
                history: History::default(),
                products_known: false,
                directed: false,
                gradient_known: false,
                ahead_known: false,
                sums_of: None,
                wanted: None,
                steps: false,
                moved: false,
                together: relax::Next::new(self.together),
                totals: Totals::default(),
            });
        }
        let moving = self.moving.as_mut().ok_or_else(missing)?;
        if self.place == Place::Set {
            let points: Vec<layout::Seed> = self.seeds.iter().map(|&p| pack::record(p)).collect();
            buffers::write(&device, &moving.buffers.points, 0, &points)?;
            if moving.held.len() != points.len() {
                moving.held = vec![false; points.len()];
                buffers::write(&device, &moving.buffers.held, 0, &vec![0u32; points.len()])?;
            }
            moving.forget();
            moving.directed = false;
            moving.gradient_known = false;
            moving.ahead_known = false;
            moving.sums_of = None;
            // What was found of the seeds as set holds for them as points, but for what the host did in f64
            // with bits that the device does not see.
            self.place = Place::Point;
            self.moved();
        }
        self.moving.as_mut().ok_or_else(missing)
    }

    /// Parameters of the stages that move seeds.
    pub(super) fn optimizer_params(&self) -> OptimizerParams {
        let s = &self.scales;
        let mass = if self.surface.is_uniform() { s.area } else { s.mass };
        let (least_area, most_area) = self.area_bounds();
        OptimizerParams {
            seeds: self.count as u32,
            groups: reduction(self.count as u64),
            uniform_weights: u32::from(self.surface.is_uniform()),
            moment_per_mass: (s.moment / mass) as f32,
            gradient_unit: (-2.0 * self.grain() / s.moment) as f32,
            directed: u32::from(self.moving.as_ref().is_some_and(|m| m.directed)),
            step: if let Place::Trial(step) = self.place { step } else { 0.0 },
            least_area,
            most_area,
            mean_mass: (self.surface.mass() / self.count as f64 * mass) as f32,
            ..OptimizerParams::default()
        }
    }

    /// What gradients are multiplied by: a power of two near n / (m h), which a gradient of a mean cell is not
    /// much larger than.
    fn grain(&self) -> f64 {
        let n = self.count as f64;
        let spacing = (self.surface.area() / n).sqrt();
        (n / (self.mass * spacing)).log2().round().clamp(-90.0, 90.0).exp2()
    }

    pub(super) fn write_optimizer_params(&self, params: OptimizerParams) -> Result<(), RvdError> {
        let moving = self.moving.as_ref().ok_or_else(missing)?;
        Ok(buffers::write(&self.device, &moving.buffers.params, 0, &[params])?)
    }

    /// Binds the stages, if they are not bound.
    pub(super) fn bind_optimizer(&mut self) -> Result<(), RvdError> {
        self.on_device()?;
        if let (Some(there), Some(moving)) = (&self.on_device, &mut self.moving)
            && moving.bindings.is_none()
        {
            moving.bindings =
                Some(OptimizerBindings::new(&self.device, &self.pipelines, &there.buffers, &moving.buffers)?);
        }
        Ok(())
    }

    /// What a stage is bound to. After [`Self::bind_optimizer`].
    pub(super) fn bound(&self) -> Result<(&Moving, &OptimizerBindings, &OnDevice), RvdError> {
        let moving = self.moving.as_ref().ok_or_else(missing)?;
        let bindings = moving.bindings.as_ref().ok_or_else(missing)?;
        Ok((moving, bindings, self.on_device.as_ref().ok_or_else(missing)?))
    }

    /// Encodes the seeds of the trial point.
    pub(super) fn encode_trial(&mut self, encoder: &mut wgpu::CommandEncoder) -> Result<(), RvdError> {
        self.write_optimizer_params(self.optimizer_params())?;
        self.bind_optimizer()?;
        let (_, bindings, _) = self.bound()?;
        let limits = Limits::of(&self.device.limits());
        let mut compute = self.device.pass(encoder, lane::NEIGHBOURS);
        run(&mut compute, &self.pipelines.trial, &bindings.trial, self.count as u64, limits);
        Ok(())
    }

    /// Encodes gradient and totals of the pass, if it is one of a point.
    pub(super) fn encode_totals(&mut self, encoder: &mut wgpu::CommandEncoder) -> Result<(), RvdError> {
        let Some(place) = self.moving.as_ref().and_then(|m| m.wanted) else { return Ok(()) };
        self.write_optimizer_params(self.optimizer_params())?;
        self.bind_optimizer()?;
        // Later submissions of a pass may lack what the host has done of it.
        let steps = self.moving.as_mut().is_some_and(|m| std::mem::take(&mut m.steps));
        self.encode_gradient(encoder, place, steps)
    }

    /// A pass at `place`, its gradient and its totals.
    pub(super) fn look(&mut self, place: Place, token: &Token) -> Result<Look, RvdError> {
        token.check()?;
        let before = self.work();
        let begin = Instant::now();
        if self.place != place {
            self.place = place;
            self.moved();
        }
        let moving = self.moving.as_mut().ok_or_else(missing)?;
        moving.sums_of = None;
        if place == Place::Point {
            moving.gradient_known = false;
            moving.products_known = false;
        }
        moving.ahead_known = false;
        moving.wanted = Some(place);
        let mut stats = PassStats::default();
        let ran = self.run_sums(token, &mut stats);
        stats.clip_ms = elapsed_ms(begin);
        let settled = ran.and_then(|()| self.complete_totals(&mut stats, token));
        let moving = self.moving.as_mut().ok_or_else(missing)?;
        moving.wanted = None;
        settled?;
        moving.sums_of = Some(place);
        moving.gradient_known |= place == Place::Point;
        moving.ahead_known = place != Place::Point;
        stats.duplicate_seeds = self.duplicates;
        self.meter(&before, &mut stats);
        Ok(self.describe(place, stats))
    }

    /// Puts what the host did of the pass into the device's sums, or all sums where pieces do not cover
    /// the surface, and makes the totals anew.
    fn complete_totals(&mut self, stats: &mut PassStats, token: &Token) -> Result<(), RvdError> {
        let mut words = None;
        if !self.pass.finished.is_empty() {
            words = Some(self.sum_words()?);
        }
        let mut area = self.area();
        if let Some(words) = &words {
            area = words.chunks_exact(SUM_WORDS).map(|c| limbs(c[10], c[11])).sum::<i64>() as f64 / self.scales.area;
        }
        if !self.covers(area, 0..self.facets.len() as u32) {
            let mut sums = CellSums::default();
            *stats = self.sums_in_f64(&mut sums, *stats, token)?;
            let mut exact = vec![0; self.count * SUM_WORDS];
            for (i, cell) in exact.chunks_exact_mut(SUM_WORDS).enumerate() {
                let (mass, moment, energy) = (sums.mass[i], sums.moment[i], sums.energy[i]);
                let whole = Integrals { mass, moment, energy, area: sums.area[i] };
                fixed::add(cell, &fixed::encode(&whole, &self.scales));
            }
            words = Some(exact);
        }
        let Some(words) = words else { return Ok(()) };
        self.pass.finished.clear();
        let device = Arc::clone(&self.device);
        buffers::write(&device, &self.on_device()?.buffers.sums, 0, &words)?;
        self.read_summary(device.encoder())?;
        Ok(())
    }

    /// Area by the totals.
    fn area(&self) -> f64 {
        let totals = self.moving.as_ref().map(|m| m.totals).unwrap_or_default();
        limbs(totals.area_low, totals.area_high) as f64 / self.scales.area
    }

    pub(super) fn describe(&self, place: Place, stats: PassStats) -> Look {
        let totals = self.moving.as_ref().map(|m| m.totals).unwrap_or_default();
        let grain = self.grain();
        Look {
            energy: limbs(totals.energy_low, totals.energy_high) as f64 / self.scales.energy,
            gradient_squared: f64::from(totals.gradient_squared) / grain / grain,
            slope: if place == Place::Point { 0.0 } else { f64::from(totals.slope) / grain },
            empty_cells: totals.empty as usize,
            area: self.area(),
            stats,
        }
    }

    /// Submits what `encoder` has and `products`, and takes them in as those of the pair in `slot`.
    fn learn(&mut self, mut encoder: wgpu::CommandEncoder, params: OptimizerParams) -> Result<(), RvdError> {
        let (_, bindings, _) = self.bound()?;
        {
            let mut compute = self.device.pass(&mut encoder, lane::UPDATE);
            compute.set_pipeline(&self.pipelines.partial_dots);
            compute.set_bind_group(0, &bindings.partial_dots, &[]);
            compute.dispatch_workgroups(params.groups, 1, 1);
            compute.set_pipeline(&self.pipelines.dots);
            compute.set_bind_group(0, &bindings.dots, &[]);
            compute.dispatch_workgroups(1, 1, 1);
        }
        let dots = self.read_dots(encoder)?;
        let moving = self.moving.as_mut().ok_or_else(missing)?;
        moving.history.learn(params.slot as usize, &dots);
        moving.products_known = true;
        Ok(())
    }

    fn read_dots(&self, encoder: wgpu::CommandEncoder) -> Result<[f32; DOTS], RvdError> {
        let (moving, _, there) = self.bound()?;
        let mut dots = [0.0; DOTS];
        there.buffers.staging.read_with(&self.device, encoder, &moving.buffers.dots, 0..DOTS, |read: &[f32]| {
            dots.copy_from_slice(read);
        })?;
        Ok(dots)
    }

    /// The direction and its slope.
    fn combine(&mut self) -> Result<f64, RvdError> {
        // The masses are those of the last pass, which may have been of another point.
        let moving = self.moving()?;
        if !moving.gradient_known || moving.sums_of != Some(Place::Point) {
            self.look(Place::Point, &Token::default())?;
        }
        if let Place::Trial(_) = self.place {
            // The same step along another direction is another point.
            self.place = Place::Point;
            self.moved();
        }
        self.bind_optimizer()?;
        let moving = self.moving.as_ref().ok_or_else(missing)?;
        if !moving.products_known && !moving.history.is_empty() {
            let slot = moving.history.free_slot();
            let params =
                OptimizerParams { slot: slot as u32, used: moving.history.used(slot), ..self.optimizer_params() };
            self.write_optimizer_params(params)?;
            self.learn(self.device.encoder(), params)?;
        }
        let grain = self.grain();
        let moving = self.moving.as_mut().ok_or_else(missing)?;
        moving.history.settle();
        let mut c = moving.history.direction();
        if moving.history.is_empty() {
            // The gradient is stored with its grain, and is divided by masses over their mean; with a history its scale
            // has both in it.
            c[2 * PAIRS] *= 0.5 * self.count as f64 / (grain * self.surface.mass());
        }
        let mut coefficients = [[0.0; 4]; 5];
        for (k, c) in c.into_iter().enumerate() {
            coefficients[k / 4][k % 4] = c as f32;
        }
        let params = OptimizerParams { coefficients, ..self.optimizer_params() };
        self.write_optimizer_params(params)?;
        let mut encoder = self.device.encoder();
        let (_, bindings, _) = self.bound()?;
        {
            let mut compute = self.device.pass(&mut encoder, lane::UPDATE);
            compute.set_pipeline(&self.pipelines.direction);
            compute.set_bind_group(0, &bindings.direction, &[]);
            compute.dispatch_workgroups(params.groups, 1, 1);
            compute.set_pipeline(&self.pipelines.dots);
            compute.set_bind_group(0, &bindings.dots, &[]);
            compute.dispatch_workgroups(1, 1, 1);
        }
        let slope = f64::from(self.read_dots(encoder)?[0]) / grain;
        let moving = self.moving.as_mut().ok_or_else(missing)?;
        moving.directed = true;
        moving.ahead_known = false;
        Ok(slope)
    }

    /// The trial point becomes the present one.
    fn keep(&mut self) -> Result<(), RvdError> {
        let trial = matches!(self.place, Place::Trial(_));
        let moving = self.moving.as_ref().filter(|m| trial && m.ahead_known && m.gradient_known);
        let moving = moving.ok_or_else(|| RvdError::Internal("no trial point to accept".to_owned()))?;
        let slot = moving.history.free_slot();
        let params = OptimizerParams { slot: slot as u32, used: moving.history.used(slot), ..self.optimizer_params() };
        self.write_optimizer_params(params)?;
        self.bind_optimizer()?;
        let (moving, bindings, there) = self.bound()?;
        let limits = Limits::of(&self.device.limits());
        let mut encoder = self.device.encoder();
        {
            let mut compute = self.device.pass(&mut encoder, lane::UPDATE);
            run(&mut compute, &self.pipelines.accept, &bindings.accept, self.count as u64, limits);
        }
        let bytes = (self.count * size_of::<layout::Seed>()) as u64;
        encoder.copy_buffer_to_buffer(&there.buffers.seeds, 0, &moving.buffers.points, 0, bytes);
        self.learn(encoder, params)?;
        // The rows and sums are those of these very seeds.
        self.place = Place::Point;
        let moving = self.moving.as_mut().ok_or_else(missing)?;
        moving.history.take(slot);
        moving.ahead_known = false;
        moving.sums_of = Some(Place::Point);
        Ok(())
    }

    pub(super) fn centre(&mut self) -> Result<(), RvdError> {
        if self.moving()?.sums_of != Some(Place::Point) {
            self.look(Place::Point, &Token::default())?;
        }
        self.write_optimizer_params(self.optimizer_params())?;
        self.bind_optimizer()?;
        let (_, bindings, there) = self.bound()?;
        // The pass is at its end, whatever its first submissions came to.
        buffers::write(&self.device, &there.buffers.state, 0, &[State::default()])?;
        let limits = Limits::of(&self.device.limits());
        let mut encoder = self.device.encoder();
        {
            let mut compute = self.device.pass(&mut encoder, lane::UPDATE);
            run(&mut compute, &self.pipelines.centroids, &bindings.centroids, self.count as u64, limits);
        }
        self.device.run(encoder)?;
        self.left();
        Ok(())
    }
}

fn limbs(low: u32, high: u32) -> i64 {
    ((u64::from(high) << 32) | u64::from(low)) as i64
}

impl Resident for GpuSession {
    fn hold(&mut self, held: &[bool]) -> Result<(), RvdError> {
        let (device, count) = (Arc::clone(&self.device), self.count);
        let moving = self.moving()?;
        if held.len() != count {
            return Err(RvdError::Internal(format!("{} seeds are held or not, of {count}", held.len())));
        }
        let words: Vec<u32> = held.iter().map(|&h| u32::from(h)).collect();
        buffers::write(&device, &moving.buffers.held, 0, &words)?;
        moving.held = held.to_vec();
        moving.forget();
        moving.directed = false;
        moving.gradient_known = false;
        moving.ahead_known = false;
        Ok(())
    }

    fn evaluate(&mut self, token: &Token) -> Result<Look, RvdError> {
        let pool = Arc::clone(&self.pool);
        pool.install(|| {
            self.moving()?;
            self.look(Place::Point, token)
        })
    }

    fn to_centroids(&mut self) -> Result<(), RvdError> {
        let pool = Arc::clone(&self.pool);
        pool.install(|| self.centre())
    }

    fn relax(&mut self, steps: usize, looks: &mut Vec<Look>, token: &Token) -> Result<(), RvdError> {
        let pool = Arc::clone(&self.pool);
        pool.install(|| self.take_steps(steps.max(1), looks, token))
    }

    fn direct(&mut self) -> Result<f64, RvdError> {
        let pool = Arc::clone(&self.pool);
        pool.install(|| self.combine())
    }

    fn probe(&mut self, step: f64, token: &Token) -> Result<Look, RvdError> {
        let pool = Arc::clone(&self.pool);
        pool.install(|| {
            if !self.moving()?.directed {
                return Err(RvdError::Internal("no direction to try".to_owned()));
            }
            self.look(Place::Trial(step as f32), token)
        })
    }

    fn accept(&mut self) -> Result<(), RvdError> {
        let pool = Arc::clone(&self.pool);
        pool.install(|| self.keep())
    }

    fn forget(&mut self) {
        if let Some(moving) = &mut self.moving {
            moving.forget();
        }
    }

    fn read(&mut self, out: &mut Vec<DVec3>) -> Result<(), RvdError> {
        let (device, n) = (Arc::clone(&self.device), self.count);
        self.moving()?;
        self.on_device()?;
        let moving = self.moving.as_ref().ok_or_else(missing)?;
        let there = self.on_device.as_ref().ok_or_else(missing)?;
        let points: Vec<layout::Seed> = there.buffers.staging.read(&device, &moving.buffers.points, 0..n)?;
        out.clear();
        out.extend(points.iter().map(|p| DVec3::from_array(p.position())));
        Ok(())
    }

    fn read_sums(&mut self, out: &mut CellSums) -> Result<(), RvdError> {
        let pool = Arc::clone(&self.pool);
        pool.install(|| {
            if self.moving()?.sums_of != Some(Place::Point) {
                self.look(Place::Point, &Token::default())?;
            }
            self.download_sums(out)
        })
    }
}
