//! The stages as pipelines, and a session's buffers bound to them.
//!
//! Purpose: one pipeline per stage and variant, made once per device and polygon size.
//! Invariant: binding numbers are those in the stage's `.wgsl`; wgpu derives the layouts from
//! them, so that a stage is described in one place only.
//! Must not know: what is dispatched when.

use super::buffers::{Buffers, MotionBuffers, WindowBuffers};
use super::layout::{DOTS, LENGTHENERS, LIST, LONGER, MEMBERS, MOST_RETAKEN, PAIRS, ROW};
use super::plan::SEARCH_PART;
use crate::gpu::{Device, GpuError, shader};

/// Slots of the variant that pairs with large polygons are clipped by.
pub(super) const LARGE_POLYGON: usize = 64;

/// Pipelines for one number of polygon slots.
#[derive(Debug)]
pub(super) struct Pipelines {
    /// Enters proposals.
    pub propose: wgpu::ComputePipeline,
    /// Does most facets as a whole, and enters the others' first cells.
    /// By [`MEMBERS`], then without and with weights.
    pub divide: [[wgpu::ComputePipeline; 2]; MEMBERS.len()],
    /// Takes the next pairs.
    pub prepare: wgpu::ComputePipeline,
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
    pub rows: wgpu::ComputePipeline,
    /// Puts seeds into them.
    pub scatter: wgpu::ComputePipeline,
    /// Finds seeds on one another.
    pub twins: wgpu::ComputePipeline,
    /// Takes rows from the lists that are kept.
    pub recall: wgpu::ComputePipeline,
    /// Finds every seed's nearest.
    pub search: wgpu::ComputePipeline,
    /// The same, and makes lists.
    pub search_lists: wgpu::ComputePipeline,
    /// Makes rows longer that pairs found too short, and puts these to the end of the list again.
    pub lengthen: wgpu::ComputePipeline,
    /// Takes pairs once more that need the variant with more slots.
    pub crowded: wgpu::ComputePipeline,
    /// Finds every facet's first cell.
    pub start: wgpu::ComputePipeline,
    /// Seeds along the direction.
    pub trial: wgpu::ComputePipeline,
    /// Seeds to their cells' centroids.
    pub centroids: wgpu::ComputePipeline,
    /// Gradient, and parts of the figures.
    pub tally: wgpu::ComputePipeline,
    /// The figures.
    pub figures: wgpu::ComputePipeline,
    /// Whether a step may follow at once.
    pub settle: wgpu::ComputePipeline,
    /// Accepts the trial point.
    pub keep: wgpu::ComputePipeline,
    /// Parts of dot products.
    pub products: wgpu::ComputePipeline,
    /// Dot products.
    pub dots: wgpu::ComputePipeline,
    /// The direction.
    pub combine: wgpu::ComputePipeline,
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
        let most = ("MOST", i64::from(MOST_RETAKEN));
        let lengtheners = ("LENGTHENERS", i64::from(LENGTHENERS));
        let longer = [("ROW", i64::from(ROW)), ("LONGER", i64::from(LONGER)), most];
        let divide = |members: usize, weighted| {
            let members = i64::from(MEMBERS[members]);
            let constants =
                [("ROW", i64::from(ROW)), ("MEMBERS", members), ("WEIGHTED", weighted), ("SHARED", 0), wide];
            pipeline(device, "divide", &constants)
        };
        let both = |members| Ok::<_, GpuError>([divide(members, 0)?, divide(members, 1)?]);
        Ok(Self {
            propose: pipeline(device, "propose", &registers)?,
            divide: [both(0)?, both(1)?, both(2)?, both(3)?],
            prepare: pipeline(device, "prepare", &[lengtheners])?,
            clip: pipeline(device, "clip", &registers)?,
            clip_shared: pipeline(device, "clip", &shared)?,
            clip_large: pipeline(device, "clip", &array)?,
            emit: pipeline(device, "emit", &registers)?,
            reach: pipeline(device, "reach", &registers)?,
            verify: pipeline(device, "verify", &registers)?,
            count: pipeline(device, "count", &[part])?,
            rows: pipeline(device, "rows", &[part])?,
            scatter: pipeline(device, "scatter", &[])?,
            twins: pipeline(device, "twins", &[])?,
            recall: pipeline(device, "recall", &search(LIST))?,
            search: pipeline(device, "search", &search(ROW))?,
            search_lists: pipeline(device, "search", &search(LIST))?,
            lengthen: pipeline(device, "lengthen", &longer)?,
            crowded: pipeline(device, "crowded", &[most, lengtheners])?,
            start: pipeline(device, "start", &[])?,
            trial: pipeline(device, "trial", &[])?,
            centroids: pipeline(device, "centroids", &[])?,
            tally: pipeline(device, "tally", &[])?,
            figures: pipeline(device, "figures", &[])?,
            settle: pipeline(device, "settle", &[])?,
            keep: pipeline(device, "keep", &[])?,
            products: pipeline(device, "products", &[pairs])?,
            dots: pipeline(device, "dots", &[("DOTS", DOTS as i64)])?,
            combine: pipeline(device, "combine", &[pairs])?,
        })
    }
}

fn pipeline(
    device: &Device,
    stage: &str,
    constants: &[shader::Constant<'_>],
) -> Result<wgpu::ComputePipeline, GpuError> {
    let source = shader::compose(stage, constants)?;
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
    /// For [`Pipelines::prepare`].
    pub prepare: wgpu::BindGroup,
    /// For [`Pipelines::count`].
    pub count: wgpu::BindGroup,
    /// For [`Pipelines::rows`].
    pub rows: wgpu::BindGroup,
    /// For [`Pipelines::scatter`].
    pub scatter: wgpu::BindGroup,
    /// For [`Pipelines::twins`].
    pub twins: wgpu::BindGroup,
    /// For [`Pipelines::recall`].
    pub recall: wgpu::BindGroup,
    /// For [`Pipelines::search`].
    pub search: wgpu::BindGroup,
    /// For [`Pipelines::search_lists`].
    pub search_lists: wgpu::BindGroup,
    /// For [`Pipelines::lengthen`].
    pub lengthen: wgpu::BindGroup,
    /// For [`Pipelines::crowded`].
    pub crowded: wgpu::BindGroup,
}

/// One window's.
#[derive(Debug)]
pub(super) struct WindowBindings {
    /// For [`Pipelines::propose`].
    pub propose: wgpu::BindGroup,
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
    /// For [`Pipelines::start`].
    pub start: wgpu::BindGroup,
}

impl Bindings {
    /// Binds `b` to all stages.
    ///
    /// # Errors
    /// `Failed`, `Lost`.
    pub(super) fn new(device: &Device, pipelines: &Pipelines, b: &Buffers) -> Result<Self, GpuError> {
        let window = |w| WindowBindings::new(device, pipelines, b, w);
        let search = [&b.params, &b.seeds, &b.cells, &b.sorted, &b.table, &b.state, &b.kept, &b.keep];
        let recall = [&b.params, &b.seeds, &b.sorted, &b.table, &b.kept, &b.lists, &b.keep, &b.state, &b.drifts];
        let lengthen = [&b.params, &b.seeds, &b.cells, &b.sorted, &b.table, &b.list, &b.failures, &b.state];
        Ok(Self {
            windows: b.windows.iter().map(window).collect::<Result<_, _>>()?,
            prepare: bind(device, &pipelines.prepare, &[&b.params, &b.state, &b.arguments])?,
            count: bind(
                device,
                &pipelines.count,
                &[&b.params, &b.seeds, &b.cells, &b.state, &b.kept, &b.keep, &b.drifts],
            )?,
            rows: bind(device, &pipelines.rows, &[&b.params, &b.cells, &b.state, &b.keep, &b.arguments])?,
            scatter: bind(device, &pipelines.scatter, &[&b.params, &b.seeds, &b.cells, &b.sorted, &b.state])?,
            twins: bind(device, &pipelines.twins, &[&b.params, &b.cells, &b.sorted, &b.state])?,
            recall: bind(device, &pipelines.recall, &recall)?,
            search: bind(device, &pipelines.search, &search)?,
            search_lists: bind(device, &pipelines.search_lists, &[&search[..], &[&b.lists]].concat())?,
            lengthen: bind(device, &pipelines.lengthen, &lengthen)?,
            crowded: bind(device, &pipelines.crowded, &[&b.params, &b.list, &b.failures, &b.state, &b.arguments])?,
        })
    }
}

impl WindowBindings {
    fn new(device: &Device, pipelines: &Pipelines, b: &Buffers, w: &WindowBuffers) -> Result<Self, GpuError> {
        let clip = [&b.params, &b.seeds, &w.facets, &b.table, &b.slots, &b.list, &b.sums, &b.failures, &b.state];
        let divide = [&b.params, &b.seeds, &w.facets, &b.table, &w.proposals, &b.slots, &b.list, &b.sums, &b.state];
        let both =
            |plain, weighted| Ok::<_, GpuError>([bind(device, plain, &divide)?, bind(device, weighted, &divide)?]);
        Ok(Self {
            propose: bind(
                device,
                &pipelines.propose,
                &[&b.params, &w.facets, &w.proposals, &b.slots, &b.list, &b.failures, &b.state],
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
            start: bind(
                device,
                &pipelines.start,
                &[&b.params, &b.seeds, &w.facets, &b.table, &b.cells, &b.sorted, &w.proposals, &b.state],
            )?,
        })
    }
}

/// The stages that move seeds, bound. Made anew whenever one of the two sets of buffers is.
#[derive(Debug)]
pub(super) struct MotionBindings {
    /// For [`Pipelines::trial`].
    pub trial: wgpu::BindGroup,
    /// For [`Pipelines::centroids`].
    pub centroids: wgpu::BindGroup,
    /// For [`Pipelines::figures`].
    pub figures: wgpu::BindGroup,
    /// For [`Pipelines::settle`].
    pub settle: wgpu::BindGroup,
    /// For [`Pipelines::keep`].
    pub keep: wgpu::BindGroup,
    /// For [`Pipelines::products`].
    pub products: wgpu::BindGroup,
    /// For [`Pipelines::dots`].
    pub dots: wgpu::BindGroup,
    /// For [`Pipelines::combine`].
    pub combine: wgpu::BindGroup,
    /// For [`Pipelines::tally`], at the present point.
    pub tally: wgpu::BindGroup,
    /// The same at the trial point.
    pub tally_ahead: wgpu::BindGroup,
}

impl MotionBindings {
    /// Binds `b` and `m`.
    ///
    /// # Errors
    /// `Failed`, `Lost`.
    pub(super) fn new(
        device: &Device,
        pipelines: &Pipelines,
        b: &Buffers,
        m: &MotionBuffers,
    ) -> Result<Self, GpuError> {
        let tally = |gradient| {
            let buffers = [&m.motion, &b.sums, &m.held, &m.direction, gradient, &m.tallies];
            bind(device, &pipelines.tally, &buffers)
        };
        Ok(Self {
            trial: bind(device, &pipelines.trial, &[&m.motion, &m.points, &m.direction, &b.seeds])?,
            centroids: bind(device, &pipelines.centroids, &[&m.motion, &b.sums, &m.held, &m.points, &b.state])?,
            figures: bind(device, &pipelines.figures, &[&m.motion, &m.tallies, &m.figures])?,
            settle: bind(device, &pipelines.settle, &[&m.motion, &m.figures, &b.state])?,
            keep: bind(
                device,
                &pipelines.keep,
                &[&m.motion, &b.seeds, &m.points, &m.ahead, &m.gradient, &m.steps, &m.changes],
            )?,
            products: bind(
                device,
                &pipelines.products,
                &[&m.motion, &b.sums, &m.steps, &m.changes, &m.gradient, &m.partials],
            )?,
            dots: bind(device, &pipelines.dots, &[&m.motion, &m.partials, &m.dots])?,
            combine: bind(
                device,
                &pipelines.combine,
                &[&m.motion, &m.steps, &m.changes, &m.gradient, &m.direction, &m.partials, &b.sums],
            )?,
            tally: tally(&m.gradient)?,
            tally_ahead: tally(&m.ahead)?,
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
