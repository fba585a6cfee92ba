//! Seeds that are moved on the device.
//!
//! Purpose: the present point x, its gradient, the search direction and the quasi-Newton history are buffers; the stages on
//! them move seeds, and scalars come back. Invariant: a trial point goes into the pass's own seeds, so x is what it was until
//! it is accepted. Energy and area are added as integers, the rest in a fixed tree: the same bits on every run. Gradients are
//! stored times a power of two that makes a mean one about 1, far from what floats lose. Must not know: what a search along the
//! direction looks for, and when passes are run.

mod history;
mod moving;

use super::clip::Clip;
use super::lane;
use super::layout::{self, DOTS, OptimizerParams, PAIRS};
use super::memory::{Memory, OnDevice, OptimizerBindings};
use super::neighbours::{Neighbours, Place};
use super::space::DeviceSpace;
use super::{Context, Result};
use crate::buffers::write;
use crate::dispatch::{reduction, run, run_groups};
use geometry::rvd::resident::Evaluation;
use geometry::rvd::{PassStats, RvdError, Together};
pub(super) use moving::Step;
use moving::{Gradient, Moving};

pub(super) struct Rooms<'a, P: DeviceSpace> {
    pub cx: &'a Context<P>,
    pub memory: &'a Memory<P>,
    pub neighbours: &'a Neighbours<P>,
    pub clip: &'a Clip<P>,
}

impl<P: DeviceSpace> Clone for Rooms<'_, P> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<P: DeviceSpace> Copy for Rooms<'_, P> {}

fn missing() -> RvdError {
    RvdError::Internal("seeds that are moved have no buffers".to_owned())
}

pub(super) fn limbs(low: u32, high: u32) -> i64 {
    ((u64::from(high) << 32) | u64::from(low)) as i64
}

pub(super) struct Optimizer {
    together: Together,
    /// The state of moved seeds, once there are any.
    pub moving: Option<Moving>,
}

impl Optimizer {
    pub(super) fn new(together: Together) -> Self {
        Self { together, moving: None }
    }

    pub(super) fn there(&mut self) -> Result<&mut Moving> {
        self.moving.as_mut().ok_or_else(missing)
    }

    /// For as many seeds as there is room for.
    pub(super) fn open<P: DeviceSpace>(&mut self, cx: &Context<P>, memory: &Memory<P>) -> Result<()> {
        if self.moving.is_none() {
            self.moving = Some(Moving::new(cx, memory.counts.seeds, self.together)?);
        }
        Ok(())
    }

    /// The seeds as set become the present point.
    pub(super) fn take_seeds<P: DeviceSpace>(&mut self, cx: &Context<P>, neighbours: &Neighbours<P>) -> Result<()> {
        let moving = self.there()?;
        let points = neighbours.records();
        write(&cx.device, &moving.buffers.points, 0, &points)?;
        if moving.held.len() != points.len() {
            moving.held = vec![false; points.len()];
            write(&cx.device, &moving.buffers.held, 0, &vec![0u32; points.len()])?;
        }
        moving.begin_anew();
        moving.sums_of = None;
        Ok(())
    }

    /// The buffers that the stages were bound to are gone.
    pub(super) fn memory_lost(&mut self) {
        if let Some(moving) = &mut self.moving {
            moving.bindings = None;
        }
    }

    /// Another pass took the sums' place.
    pub(super) fn sums_lost(&mut self) {
        if let Some(moving) = &mut self.moving {
            moving.sums_of = None;
        }
    }

    pub(super) fn point_changed(&mut self) {
        if let Some(moving) = &mut self.moving {
            moving.history.clear();
            moving.gradient = Gradient::Unknown;
            moving.trial_gradient_known = false;
            moving.sums_of = None;
        }
    }

    pub(super) fn clear_history(&mut self) {
        if let Some(moving) = &mut self.moving {
            moving.history.clear();
        }
    }

    pub(super) fn device_bytes(&self) -> u64 {
        self.moving.as_ref().map_or(0, |moving| moving.buffers.plan.total_bytes())
    }

    pub(super) fn params<P: DeviceSpace>(&self, rooms: Rooms<'_, P>) -> OptimizerParams {
        let (surface, s) = (&rooms.cx.surface, &rooms.clip.scales);
        let count = rooms.neighbours.count;
        let mass = if surface.is_uniform() { s.area } else { s.mass };
        let (least_area, most_area) = rooms.clip.area_bounds();
        OptimizerParams {
            seeds: count as u32,
            groups: reduction(count as u64),
            uniform_weights: u32::from(surface.is_uniform()),
            moment_per_mass: (s.moment / mass) as f32,
            gradient_unit: (-2.0 * grain(rooms) / s.moment) as f32,
            directed: u32::from(self.moving.as_ref().is_some_and(|m| m.directed)),
            step: if let Place::Trial(step) = rooms.neighbours.place { step } else { 0.0 },
            least_area,
            most_area,
            mean_mass: (surface.mass() / count as f64 * mass) as f32,
            ..OptimizerParams::default()
        }
    }

    /// Tells the stages `params`, and binds them if they are not bound.
    pub(super) fn prepare<P: DeviceSpace>(&mut self, rooms: Rooms<'_, P>, params: OptimizerParams) -> Result<()> {
        let moving = self.moving.as_mut().ok_or_else(missing)?;
        write(&rooms.cx.device, &moving.buffers.params, 0, &[params])?;
        if moving.bindings.is_none() {
            let there = rooms.memory.there()?;
            let (device, pipelines) = (&rooms.cx.device, &rooms.cx.pipelines);
            moving.bindings = Some(OptimizerBindings::new(device, pipelines, &there.buffers, &moving.buffers)?);
        }
        Ok(())
    }

    /// What a stage is bound to. After [`Self::prepare`].
    fn bound<'a, P: DeviceSpace>(
        &'a self,
        memory: &'a Memory<P>,
    ) -> Result<(&'a Moving, &'a OptimizerBindings, &'a OnDevice)> {
        let moving = self.moving.as_ref().ok_or_else(missing)?;
        let bindings = moving.bindings.as_ref().ok_or_else(missing)?;
        Ok((moving, bindings, memory.there()?))
    }

    pub(super) fn encode_point<P: DeviceSpace>(
        &self,
        rooms: Rooms<'_, P>,
        encoder: &mut wgpu::CommandEncoder,
    ) -> Result<()> {
        if let Some(moving) = &self.moving {
            let bytes = (rooms.neighbours.count * size_of::<P::Seed>()) as u64;
            let seeds = &rooms.memory.there()?.buffers.seeds;
            encoder.copy_buffer_to_buffer(&moving.buffers.points, 0, seeds, 0, bytes);
        }
        Ok(())
    }

    pub(super) fn encode_trial<P: DeviceSpace>(
        &mut self,
        rooms: Rooms<'_, P>,
        encoder: &mut wgpu::CommandEncoder,
    ) -> Result<()> {
        self.prepare(rooms, self.params(rooms))?;
        let (cx, (_, bindings, _)) = (rooms.cx, self.bound(rooms.memory)?);
        let mut compute = cx.device.pass(encoder, lane::NEIGHBOURS);
        run(&mut compute, &cx.pipelines.trial, &bindings.trial, rooms.neighbours.count as u64, cx.limits());
        Ok(())
    }

    /// Encodes gradient and totals of the pass, if it is one of a point.
    pub(super) fn encode_totals<P: DeviceSpace>(
        &mut self,
        rooms: Rooms<'_, P>,
        encoder: &mut wgpu::CommandEncoder,
    ) -> Result<()> {
        let Some(place) = self.moving.as_ref().and_then(|m| m.totals_of) else { return Ok(()) };
        self.prepare(rooms, self.params(rooms))?;
        // Later submissions of a pass may lack what the host has done of it.
        let moving = self.there()?;
        let steps = moving.step == Step::Wanted;
        if steps {
            moving.step = Step::No;
        }
        self.encode_gradient(rooms, encoder, place, steps)
    }

    /// Encodes gradient and totals, and a step if `steps` says so and the pass is complete.
    pub(super) fn encode_gradient<P: DeviceSpace>(
        &self,
        rooms: Rooms<'_, P>,
        encoder: &mut wgpu::CommandEncoder,
        place: Place,
        steps: bool,
    ) -> Result<()> {
        let (cx, count) = (rooms.cx, rooms.neighbours.count as u64);
        let (_, bindings, _) = self.bound(rooms.memory)?;
        let gradient = if place == Place::Point { &bindings.gradient } else { &bindings.gradient_ahead };
        let mut compute = cx.device.pass(encoder, lane::UPDATE);
        run_groups(&mut compute, &cx.pipelines.gradient, gradient, [reduction(count), 1]);
        run_groups(&mut compute, &cx.pipelines.totals, &bindings.totals, [1, 1]);
        if steps {
            run_groups(&mut compute, &cx.pipelines.may_step, &bindings.may_step, [1, 1]);
            run(&mut compute, &cx.pipelines.centroids, &bindings.centroids, count, cx.limits());
        }
        Ok(())
    }

    pub(super) fn step_to_centroids<P: DeviceSpace>(&mut self, rooms: Rooms<'_, P>) -> Result<()> {
        self.prepare(rooms, self.params(rooms))?;
        // The pass is complete, whatever its first submissions came to.
        rooms.memory.write_state(layout::State::default())?;
        let (cx, (_, bindings, _)) = (rooms.cx, self.bound(rooms.memory)?);
        let mut encoder = cx.device.encoder();
        let mut compute = cx.device.pass(&mut encoder, lane::UPDATE);
        let count = rooms.neighbours.count as u64;
        run(&mut compute, &cx.pipelines.centroids, &bindings.centroids, count, cx.limits());
        drop(compute);
        Ok(cx.device.run(encoder)?)
    }

    pub(super) fn area<P: DeviceSpace>(&self, rooms: Rooms<'_, P>) -> f64 {
        let totals = self.moving.as_ref().map(|m| m.totals).unwrap_or_default();
        limbs(totals.area_low, totals.area_high) as f64 / rooms.clip.scales.area
    }

    /// What the totals say of the point at `place`.
    pub(super) fn describe<P: DeviceSpace>(&self, rooms: Rooms<'_, P>, place: Place, stats: PassStats) -> Evaluation {
        let totals = self.moving.as_ref().map(|m| m.totals).unwrap_or_default();
        let grain = grain(rooms);
        Evaluation {
            energy: limbs(totals.energy_low, totals.energy_high) as f64 / rooms.clip.scales.energy,
            gradient_squared: f64::from(totals.gradient_squared) / grain / grain,
            slope: if place == Place::Point { 0.0 } else { f64::from(totals.slope) / grain },
            empty_cells: totals.empty as usize,
            area: self.area(rooms),
            stats,
        }
    }

    /// Submits what `encoder` has and the dot products, and takes them in as those of the pair in `params.slot`.
    fn learn<P: DeviceSpace>(
        &mut self,
        rooms: Rooms<'_, P>,
        encoder: wgpu::CommandEncoder,
        params: OptimizerParams,
    ) -> Result<()> {
        let (pipelines, (_, bindings, _)) = (&rooms.cx.pipelines, self.bound(rooms.memory)?);
        let dots = self.dots(rooms, encoder, (&pipelines.partial_dots, &bindings.partial_dots), params.groups)?;
        let moving = self.there()?;
        moving.history.learn(params.slot as usize, &dots);
        moving.gradient = Gradient::WithProducts;
        Ok(())
    }

    /// Submits what `encoder` has, a stage that leaves parts of dot products in `groups` workgroups, and reads the sums.
    fn dots<P: DeviceSpace>(
        &self,
        rooms: Rooms<'_, P>,
        mut encoder: wgpu::CommandEncoder,
        (partial, bound): (&wgpu::ComputePipeline, &wgpu::BindGroup),
        groups: u32,
    ) -> Result<[f32; DOTS]> {
        let (cx, (moving, bindings, there)) = (rooms.cx, self.bound(rooms.memory)?);
        let mut compute = cx.device.pass(&mut encoder, lane::UPDATE);
        run_groups(&mut compute, partial, bound, [groups, 1]);
        run_groups(&mut compute, &cx.pipelines.dots, &bindings.dots, [1, 1]);
        drop(compute);
        let mut dots = [0.0; DOTS];
        let take = |read: &[f32]| dots.copy_from_slice(read);
        there.buffers.staging.read_with(&cx.device, encoder, &moving.buffers.dots, 0..DOTS, take)?;
        Ok(dots)
    }

    /// Parameters with the slot of the history's next pair. The stages are told them.
    fn prepare_pair<P: DeviceSpace>(&mut self, rooms: Rooms<'_, P>) -> Result<OptimizerParams> {
        let history = &self.there()?.history;
        let slot = history.free_slot();
        let params = OptimizerParams { slot: slot as u32, used: history.used(slot), ..self.params(rooms) };
        self.prepare(rooms, params)?;
        Ok(params)
    }

    /// The search direction and its slope. The device has gradient and sums of the present point.
    pub(super) fn find_direction<P: DeviceSpace>(&mut self, rooms: Rooms<'_, P>) -> Result<f64> {
        let (cx, count) = (rooms.cx, rooms.neighbours.count as f64);
        let moving = self.there()?;
        if moving.gradient != Gradient::WithProducts && !moving.history.is_empty() {
            let params = self.prepare_pair(rooms)?;
            self.learn(rooms, cx.device.encoder(), params)?;
        }
        let grain = grain(rooms);
        let moving = self.there()?;
        moving.history.drop_without_scale();
        let mut c = moving.history.direction();
        if moving.history.is_empty() {
            // The gradient is stored with its grain, and is divided by masses over their mean; with a history its scale
            // has both in it.
            c[2 * PAIRS] *= 0.5 * count / (grain * cx.surface.mass());
        }
        let mut coefficients = [[0.0; 4]; 5];
        for (k, c) in c.into_iter().enumerate() {
            coefficients[k / 4][k % 4] = c as f32;
        }
        let params = OptimizerParams { coefficients, ..self.params(rooms) };
        self.prepare(rooms, params)?;
        let (_, bindings, _) = self.bound(rooms.memory)?;
        let stage = (&cx.pipelines.direction, &bindings.direction);
        let dots = self.dots(rooms, cx.device.encoder(), stage, params.groups)?;
        let slope = f64::from(dots[0]) / grain;
        let moving = self.there()?;
        moving.directed = true;
        moving.trial_gradient_known = false;
        Ok(slope)
    }

    /// The trial point becomes the present one. Its rows and sums stay.
    pub(super) fn accept<P: DeviceSpace>(&mut self, rooms: Rooms<'_, P>) -> Result<()> {
        let (cx, count) = (rooms.cx, rooms.neighbours.count);
        let params = self.prepare_pair(rooms)?;
        let (moving, bindings, there) = self.bound(rooms.memory)?;
        let mut encoder = cx.device.encoder();
        let mut compute = cx.device.pass(&mut encoder, lane::UPDATE);
        run(&mut compute, &cx.pipelines.accept, &bindings.accept, count as u64, cx.limits());
        drop(compute);
        let bytes = (count * size_of::<P::Seed>()) as u64;
        encoder.copy_buffer_to_buffer(&there.buffers.seeds, 0, &moving.buffers.points, 0, bytes);
        self.learn(rooms, encoder, params)?;
        let moving = self.there()?;
        moving.history.take(params.slot as usize);
        moving.trial_gradient_known = false;
        moving.sums_of = Some(Place::Point);
        Ok(())
    }

    pub(super) fn read_points<P: DeviceSpace>(&self, rooms: Rooms<'_, P>) -> Result<Vec<P::Seed>> {
        let moving = self.moving.as_ref().ok_or_else(missing)?;
        let staging = &rooms.memory.there()?.buffers.staging;
        Ok(staging.read(&rooms.cx.device, &moving.buffers.points, 0..rooms.neighbours.count)?)
    }
}

/// What gradients are multiplied by: a power of two near n / (m h), which a gradient of a mean cell is not much larger than.
fn grain<P: DeviceSpace>(rooms: Rooms<'_, P>) -> f64 {
    let n = rooms.neighbours.count as f64;
    let spacing = (rooms.cx.surface.area() / n).sqrt();
    (n / (rooms.cx.mass * spacing)).log2().round().clamp(-90.0, 90.0).exp2()
}
