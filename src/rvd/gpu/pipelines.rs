//! The stages as pipelines, and a session's buffers bound to them.
//!
//! Purpose: one pipeline per stage and variant, made once per device and polygon size.
//! Invariant: binding numbers are those in the stage's `.wgsl`; wgpu derives the layouts from
//! them, so that a stage is described in one place only.
//! Must not know: what is dispatched when.

use crate::gpu::buffers::Buffers;
use crate::gpu::{Device, GpuError, shader};

/// Slots of the variant that pairs with large polygons are clipped by.
pub const LARGE_POLYGON: usize = 64;

/// Pipelines for one number of polygon slots.
#[derive(Debug)]
pub struct Pipelines {
    /// Enters proposals.
    pub propose: wgpu::ComputePipeline,
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
}

impl Pipelines {
    /// Composes and compiles all stages for `slots` polygon vertices (4 to 16).
    ///
    /// # Errors
    /// `Failed`, `Lost`; `Shader` only for a mistake in `shaders/`.
    pub fn new(device: &Device, slots: usize) -> Result<Self, GpuError> {
        let registers = [("SLOTS", slots as i64), ("ARRAY", 0), ("SHARED", 0)];
        let shared = [("SLOTS", slots as i64), ("ARRAY", 0), ("SHARED", 1)];
        let array = [("SLOTS", LARGE_POLYGON as i64), ("ARRAY", 1), ("SHARED", 0)];
        Ok(Self {
            propose: pipeline(device, "propose", &registers)?,
            prepare: pipeline(device, "prepare", &registers)?,
            clip: pipeline(device, "clip", &registers)?,
            clip_shared: pipeline(device, "clip", &shared)?,
            clip_large: pipeline(device, "clip", &array)?,
            emit: pipeline(device, "emit", &registers)?,
            reach: pipeline(device, "reach", &registers)?,
            verify: pipeline(device, "verify", &registers)?,
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
pub struct Bindings {
    /// For [`Pipelines::propose`].
    pub propose: wgpu::BindGroup,
    /// For [`Pipelines::prepare`].
    pub prepare: wgpu::BindGroup,
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
}

impl Bindings {
    /// Binds `b` to all stages.
    ///
    /// # Errors
    /// `Failed`, `Lost`.
    pub fn new(device: &Device, pipelines: &Pipelines, b: &Buffers) -> Result<Self, GpuError> {
        let clip = [&b.params, &b.seeds, &b.facets, &b.table, &b.slots, &b.list, &b.sums, &b.failures, &b.state];
        Ok(Self {
            propose: bind(
                device,
                &pipelines.propose,
                &[&b.params, &b.facets, &b.proposals, &b.slots, &b.list, &b.failures, &b.state],
            )?,
            prepare: bind(device, &pipelines.prepare, &[&b.params, &b.state, &b.arguments])?,
            clip: bind(device, &pipelines.clip, &clip)?,
            clip_shared: bind(device, &pipelines.clip_shared, &clip)?,
            clip_large: bind(device, &pipelines.clip_large, &clip)?,
            emit: bind(
                device,
                &pipelines.emit,
                &[&b.params, &b.seeds, &b.facets, &b.table, &b.list, &b.heads, &b.vertices, &b.labels],
            )?,
            reach: bind(
                device,
                &pipelines.reach,
                &[&b.params, &b.seeds, &b.facets, &b.table, &b.near, &b.slots, &b.list, &b.failures, &b.state],
            )?,
            verify: bind(device, &pipelines.verify, &[&b.params, &b.facets, &b.slots, &b.list, &b.failures, &b.state])?,
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
