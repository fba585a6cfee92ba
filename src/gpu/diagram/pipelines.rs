//! The stages as pipelines.
//!
//! Purpose: one pipeline per stage and variant, made once per device. A pipeline has the name of its stage.
//! Invariant: wgpu derives the layouts of bindings from the stage's `.wgsl`, so that a stage is described in one place only.
//! Must not know: what is dispatched when, and on which buffers.

use super::layout::{DOTS, LENGTHENERS, LIST, LONGER, MEMBERS, MOST_REQUEUED, PAIRS, ROW};
use super::plan::SEARCH_PART;
use super::shaders;
use crate::shader::Constant;
use crate::{Device, GpuError};

/// Polygon slots of the register variant. The same for all capacities: other slots would be
/// another program, which a driver may round differently in the last bit. A smaller capacity is
/// a limit below it, a larger one goes to the large variant.
pub(super) const SLOTS: usize = 10;

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
