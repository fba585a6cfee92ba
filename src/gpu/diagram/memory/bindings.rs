//! A session's buffers bound to the stages.
//!
//! Purpose: the bind groups of all pipelines.
//! Invariant: binding numbers are those in the stage's `.wgsl`. Must not know: what is dispatched when.

use super::buffers::{Buffers, OptimizerBuffers, WindowBuffers};
use crate::diagram::pipelines::Pipelines;
use crate::{Device, GpuError};

/// One session's buffers bound to each stage.
#[derive(Debug)]
pub(crate) struct Bindings {
    /// Stages that see a window of the facets.
    pub windows: Vec<WindowBindings>,
    /// For [`Pipelines::indirect_arguments`].
    pub indirect_arguments: wgpu::BindGroup,
    /// For [`Pipelines::count`].
    pub count: wgpu::BindGroup,
    /// For [`Pipelines::offsets`].
    pub offsets: wgpu::BindGroup,
    /// For [`Pipelines::scatter`].
    pub scatter: wgpu::BindGroup,
    /// For [`Pipelines::duplicates`].
    pub duplicates: wgpu::BindGroup,
    /// For [`Pipelines::from_lists`].
    pub from_lists: wgpu::BindGroup,
    /// For [`Pipelines::search`].
    pub search: wgpu::BindGroup,
    /// For [`Pipelines::search_lists`].
    pub search_lists: wgpu::BindGroup,
    /// For [`Pipelines::lengthen`].
    pub lengthen: wgpu::BindGroup,
    /// For [`Pipelines::overflow`].
    pub overflow: wgpu::BindGroup,
}

/// One window's.
#[derive(Debug)]
pub(crate) struct WindowBindings {
    /// For [`Pipelines::enqueue`].
    pub enqueue: wgpu::BindGroup,
    /// For each of [`Pipelines::divide`].
    pub divide: Vec<[wgpu::BindGroup; 2]>,
    /// For [`Pipelines::clip`].
    pub clip: wgpu::BindGroup,
    /// For [`Pipelines::clip_shared`].
    pub clip_shared: wgpu::BindGroup,
    /// For [`Pipelines::clip_large`].
    pub clip_large: wgpu::BindGroup,
    /// For [`Pipelines::emit`].
    pub emit: wgpu::BindGroup,
    /// For [`Pipelines::reach`].
    pub reach: wgpu::BindGroup,
    /// For [`Pipelines::verify`].
    pub verify: wgpu::BindGroup,
    /// For [`Pipelines::first_cells`].
    pub first_cells: wgpu::BindGroup,
}

impl Bindings {
    /// Binds `b` to all stages.
    ///
    /// # Errors
    /// `Failed`, `Lost`.
    pub(crate) fn new(device: &Device, pipelines: &Pipelines, b: &Buffers) -> Result<Self, GpuError> {
        let window = |w| WindowBindings::new(device, pipelines, b, w);
        let search = [&b.params, &b.seeds, &b.cells, &b.sorted, &b.table, &b.state, &b.list_origins, &b.list_state];
        let from_lists =
            [&b.params, &b.seeds, &b.sorted, &b.table, &b.list_origins, &b.lists, &b.list_state, &b.state, &b.drifts];
        let lengthen = [&b.params, &b.seeds, &b.cells, &b.sorted, &b.table, &b.list, &b.failures, &b.state];
        Ok(Self {
            windows: b.windows.iter().map(window).collect::<Result<_, _>>()?,
            indirect_arguments: bind(device, &pipelines.indirect_arguments, &[&b.params, &b.state, &b.arguments])?,
            count: bind(
                device,
                &pipelines.count,
                &[&b.params, &b.seeds, &b.cells, &b.state, &b.list_origins, &b.list_state, &b.drifts],
            )?,
            offsets: bind(device, &pipelines.offsets, &[&b.params, &b.cells, &b.state, &b.list_state, &b.arguments])?,
            scatter: bind(device, &pipelines.scatter, &[&b.params, &b.seeds, &b.cells, &b.sorted, &b.state])?,
            duplicates: bind(device, &pipelines.duplicates, &[&b.params, &b.cells, &b.sorted, &b.state])?,
            from_lists: bind(device, &pipelines.from_lists, &from_lists)?,
            search: bind(device, &pipelines.search, &search)?,
            search_lists: bind(device, &pipelines.search_lists, &[&search[..], &[&b.lists]].concat())?,
            lengthen: bind(device, &pipelines.lengthen, &lengthen)?,
            overflow: bind(device, &pipelines.overflow, &[&b.params, &b.list, &b.failures, &b.state, &b.arguments])?,
        })
    }
}

impl WindowBindings {
    fn new(device: &Device, pipelines: &Pipelines, b: &Buffers, w: &WindowBuffers) -> Result<Self, GpuError> {
        let clip = [&b.params, &b.seeds, &w.facets, &b.table, &b.slots, &b.list, &b.sums, &b.failures, &b.state];
        let divide = [&b.params, &b.seeds, &w.facets, &b.table, &w.candidates, &b.slots, &b.list, &b.sums, &b.state];
        let both =
            |plain, weighted| Ok::<_, GpuError>([bind(device, plain, &divide)?, bind(device, weighted, &divide)?]);
        Ok(Self {
            enqueue: bind(
                device,
                &pipelines.enqueue,
                &[&b.params, &w.facets, &w.candidates, &b.slots, &b.list, &b.failures, &b.state],
            )?,
            divide: pipelines.divide.iter().map(|[a, b]| both(a, b)).collect::<Result<_, _>>()?,
            clip: bind(device, &pipelines.clip, &clip)?,
            clip_shared: bind(device, &pipelines.clip_shared, &clip)?,
            clip_large: bind(device, &pipelines.clip_large, &clip)?,
            emit: bind(
                device,
                &pipelines.emit,
                &[&b.params, &b.seeds, &w.facets, &b.table, &b.list, &b.heads, &b.vertices, &b.labels],
            )?,
            reach: bind(
                device,
                &pipelines.reach,
                &[&b.params, &b.seeds, &w.facets, &b.table, &b.near, &b.slots, &b.list, &b.failures, &b.state],
            )?,
            verify: bind(device, &pipelines.verify, &[&b.params, &w.facets, &b.slots, &b.list, &b.failures, &b.state])?,
            first_cells: bind(
                device,
                &pipelines.first_cells,
                &[&b.params, &b.seeds, &w.facets, &b.table, &b.cells, &b.sorted, &w.candidates, &b.state],
            )?,
        })
    }
}

/// The stages that move seeds, bound. Made anew whenever one of the two sets of buffers is.
#[derive(Debug)]
pub(crate) struct OptimizerBindings {
    /// For [`Pipelines::trial`].
    pub trial: wgpu::BindGroup,
    /// For [`Pipelines::centroids`].
    pub centroids: wgpu::BindGroup,
    /// For [`Pipelines::totals`].
    pub totals: wgpu::BindGroup,
    /// For [`Pipelines::may_step`].
    pub may_step: wgpu::BindGroup,
    /// For [`Pipelines::accept`].
    pub accept: wgpu::BindGroup,
    /// For [`Pipelines::partial_dots`].
    pub partial_dots: wgpu::BindGroup,
    /// For [`Pipelines::dots`].
    pub dots: wgpu::BindGroup,
    /// For [`Pipelines::direction`].
    pub direction: wgpu::BindGroup,
    /// For [`Pipelines::gradient`], at the present point.
    pub gradient: wgpu::BindGroup,
    /// The same at the trial point.
    pub gradient_ahead: wgpu::BindGroup,
}

impl OptimizerBindings {
    /// Binds `b` and `m`.
    ///
    /// # Errors
    /// `Failed`, `Lost`.
    pub(crate) fn new(
        device: &Device,
        pipelines: &Pipelines,
        b: &Buffers,
        m: &OptimizerBuffers,
    ) -> Result<Self, GpuError> {
        let gradient = |to| {
            let buffers = [&m.params, &b.sums, &m.held, &m.direction, to, &m.partial_totals];
            bind(device, &pipelines.gradient, &buffers)
        };
        Ok(Self {
            trial: bind(device, &pipelines.trial, &[&m.params, &m.points, &m.direction, &b.seeds])?,
            centroids: bind(device, &pipelines.centroids, &[&m.params, &b.sums, &m.held, &m.points, &b.state])?,
            totals: bind(device, &pipelines.totals, &[&m.params, &m.partial_totals, &m.totals])?,
            may_step: bind(device, &pipelines.may_step, &[&m.params, &m.totals, &b.state])?,
            accept: bind(
                device,
                &pipelines.accept,
                &[&m.params, &b.seeds, &m.points, &m.ahead, &m.gradient, &m.steps, &m.changes],
            )?,
            partial_dots: bind(
                device,
                &pipelines.partial_dots,
                &[&m.params, &b.sums, &m.steps, &m.changes, &m.gradient, &m.partials],
            )?,
            dots: bind(device, &pipelines.dots, &[&m.params, &m.partials, &m.dots])?,
            direction: bind(
                device,
                &pipelines.direction,
                &[&m.params, &m.steps, &m.changes, &m.gradient, &m.direction, &m.partials, &b.sums],
            )?,
            gradient: gradient(&m.gradient)?,
            gradient_ahead: gradient(&m.ahead)?,
        })
    }
}

fn bind(
    device: &Device,
    pipeline: &wgpu::ComputePipeline,
    buffers: &[&wgpu::Buffer],
) -> Result<wgpu::BindGroup, GpuError> {
    let entries: Vec<wgpu::BindGroupEntry<'_>> = buffers
        .iter()
        .enumerate()
        .map(|(k, buffer)| wgpu::BindGroupEntry { binding: k as u32, resource: buffer.as_entire_binding() })
        .collect();
    device.scoped(|| {
        device.raw().create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &pipeline.get_bind_group_layout(0),
            entries: &entries,
        })
    })
}
