//! The stages as pipelines, and a session's buffers bound to them.
//!
//! Purpose: one pipeline per stage and variant, made once per device and polygon size.
//! Invariant: binding numbers are those in the stage's `.wgsl`; wgpu derives the layouts from
//! them, so that a stage is described in one place only.
//! Must not know: what is dispatched when.

use super::buffers::{Buffers, OptimizerBuffers, WindowBuffers};
use super::layout::{DOTS, LENGTHENERS, LIST, LONGER, MEMBERS, MOST_REQUEUED, PAIRS, ROW};
use super::plan::SEARCH_PART;
use super::shaders;
use crate::gpu::shader::Constant;
use crate::gpu::{Device, GpuError};

/// Slots of the variant that pairs with large polygons are clipped by.
pub(super) const LARGE_POLYGON: usize = 64;

/// Pipelines for one number of polygon slots.
#[derive(Debug)]
pub(super) struct Pipelines {
    /// Enters candidates.
    pub enqueue: wgpu::ComputePipeline,
    /// Does most facets as a whole, and enters the others' first cells.
    /// By [`MEMBERS`], then without and with weights.
    pub divide: [[wgpu::ComputePipeline; 2]; MEMBERS.len()],
    /// Takes the next pairs.
    pub indirect_arguments: wgpu::ComputePipeline,
    /// Clips them, polygon in registers.
    pub clip: wgpu::ComputePipeline,
    /// The same, adding in two phases.
    pub clip_shared: wgpu::ComputePipeline,
    /// The first with [`LARGE_POLYGON`] indexed slots.
    pub clip_large: wgpu::ComputePipeline,
    /// Writes pieces.
    pub emit: wgpu::ComputePipeline,
    /// Enters pairs by cell.
    pub reach: wgpu::ComputePipeline,
    /// Proves those pairs.
    pub verify: wgpu::ComputePipeline,
    /// Counts the seeds of each grid cell.
    pub count: wgpu::ComputePipeline,
    /// Places the grid's cells.
    pub offsets: wgpu::ComputePipeline,
    /// Puts seeds into them.
    pub scatter: wgpu::ComputePipeline,
    /// Finds seeds on one another.
    pub duplicates: wgpu::ComputePipeline,
    /// Takes rows from Verlet lists.
    pub from_lists: wgpu::ComputePipeline,
    /// Finds every seed's nearest.
    pub search: wgpu::ComputePipeline,
    /// The same, and makes lists.
    pub search_lists: wgpu::ComputePipeline,
    /// Makes rows longer that pairs found too short, and puts these to the end of the list again.
    pub lengthen: wgpu::ComputePipeline,
    /// Takes pairs once more that need the variant with more slots.
    pub overflow: wgpu::ComputePipeline,
    /// Finds every facet's first cell.
    pub first_cells: wgpu::ComputePipeline,
    /// Seeds along the direction.
    pub trial: wgpu::ComputePipeline,
    /// Seeds to their cells' centroids.
    pub centroids: wgpu::ComputePipeline,
    /// Gradient, and parts of the totals.
    pub gradient: wgpu::ComputePipeline,
    /// The totals.
    pub totals: wgpu::ComputePipeline,
    /// Whether a step may follow at once.
    pub may_step: wgpu::ComputePipeline,
    /// Accepts the trial point.
    pub accept: wgpu::ComputePipeline,
    /// Parts of dot products.
    pub partial_dots: wgpu::ComputePipeline,
    /// Dot products.
    pub dots: wgpu::ComputePipeline,
    /// The direction.
    pub direction: wgpu::ComputePipeline,
}

impl Pipelines {
    /// Composes and compiles all stages for `slots` polygon vertices (4 to 16).
    ///
    /// # Errors
    /// `Failed`, `Lost`; `Shader` only for a mistake in `shaders/`.
    pub(super) fn new(device: &Device, slots: usize) -> Result<Self, GpuError> {
        let wide = ("WIDE", i64::from(device.has_wide_atomics()));
        let registers = [("SLOTS", slots as i64), ("ARRAY", 0), ("SHARED", 0), wide];
        let shared = [("SLOTS", slots as i64), ("ARRAY", 0), ("SHARED", 1), wide];
        let array = [("SLOTS", LARGE_POLYGON as i64), ("ARRAY", 1), ("SHARED", 0), wide];
        let part = ("PART", SEARCH_PART as i64);
        let pairs = ("PAIRS", PAIRS as i64);
        let search = |width| [("ROW", i64::from(ROW)), ("LIST", i64::from(LIST)), ("WIDTH", i64::from(width)), part];
        let most = ("MOST", i64::from(MOST_REQUEUED));
        let lengtheners = ("LENGTHENERS", i64::from(LENGTHENERS));
        let longer = [("ROW", i64::from(ROW)), ("LONGER", i64::from(LONGER)), most];
        let divide = |members: usize, weighted| {
            let members = i64::from(MEMBERS[members]);
            let constants =
                [("ROW", i64::from(ROW)), ("MEMBERS", members), ("WEIGHTED", weighted), ("SHARED", 0), wide];
            pipeline(device, "clip/divide", &constants)
        };
        let both = |members| Ok::<_, GpuError>([divide(members, 0)?, divide(members, 1)?]);
        Ok(Self {
            enqueue: pipeline(device, "clip/enqueue", &registers)?,
            divide: [both(0)?, both(1)?, both(2)?, both(3)?],
            indirect_arguments: pipeline(device, "clip/indirect_arguments", &[lengtheners])?,
            clip: pipeline(device, "clip/clip", &registers)?,
            clip_shared: pipeline(device, "clip/clip", &shared)?,
            clip_large: pipeline(device, "clip/clip", &array)?,
            emit: pipeline(device, "clip/emit", &registers)?,
            reach: pipeline(device, "clip/reach", &registers)?,
            verify: pipeline(device, "clip/verify", &registers)?,
            count: pipeline(device, "neighbours/count", &[part])?,
            offsets: pipeline(device, "neighbours/offsets", &[part])?,
            scatter: pipeline(device, "neighbours/scatter", &[])?,
            duplicates: pipeline(device, "neighbours/duplicates", &[])?,
            from_lists: pipeline(device, "neighbours/from_lists", &search(LIST))?,
            search: pipeline(device, "neighbours/search", &search(ROW))?,
            search_lists: pipeline(device, "neighbours/search", &search(LIST))?,
            lengthen: pipeline(device, "neighbours/lengthen", &longer)?,
            overflow: pipeline(device, "clip/overflow", &[most, lengtheners])?,
            first_cells: pipeline(device, "neighbours/first_cells", &[])?,
            trial: pipeline(device, "optimizer/trial", &[])?,
            centroids: pipeline(device, "optimizer/centroids", &[])?,
            gradient: pipeline(device, "optimizer/gradient", &[])?,
            totals: pipeline(device, "optimizer/totals", &[])?,
            may_step: pipeline(device, "optimizer/may_step", &[])?,
            accept: pipeline(device, "optimizer/accept", &[])?,
            partial_dots: pipeline(device, "optimizer/partial_dots", &[pairs])?,
            dots: pipeline(device, "optimizer/dots", &[("DOTS", DOTS as i64)])?,
            direction: pipeline(device, "optimizer/direction", &[pairs])?,
        })
    }
}

fn pipeline(device: &Device, stage: &str, constants: &[Constant<'_>]) -> Result<wgpu::ComputePipeline, GpuError> {
    let source = shaders::compose(stage, constants)?;
    device.scoped(|| {
        let module = device.raw().create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(stage),
            source: wgpu::ShaderSource::Wgsl(source.into()),
        });
        device.raw().create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(stage),
            layout: None,
            module: &module,
            entry_point: Some("main"),
            compilation_options: wgpu::PipelineCompilationOptions {
                zero_initialize_workgroup_memory: false,
                ..Default::default()
            },
            cache: None,
        })
    })
}

/// One session's buffers bound to each stage.
#[derive(Debug)]
pub(super) struct Bindings {
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
pub(super) struct WindowBindings {
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
    pub(super) fn new(device: &Device, pipelines: &Pipelines, b: &Buffers) -> Result<Self, GpuError> {
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
pub(super) struct OptimizerBindings {
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
    pub(super) fn new(
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
