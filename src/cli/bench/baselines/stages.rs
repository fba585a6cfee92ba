//! Buffers and stages of a method on a GPU.
//!
//! Purpose: what methods with shaders of their own share: [`Buffers`] within the limits of the device, and [`Stage`]s that are
//! bound to them. Invariant: every error is a [`GpuError`], a buffer that no shader could see too; a dispatch has no more
//! workgroups in one dimension than every device allows. Must not know: what a stage does, what a buffer is for.

use std::sync::Arc;

use gpu::buffers::{Allocation, Staging, write};
use gpu::device::WORKGROUP;
use gpu::shader::{Constant, Sources, compose};
use gpu::wgpu::{BindGroup, BindGroupDescriptor, BindGroupEntry, Buffer, BufferUsages, CommandEncoder, ComputePass};
use gpu::wgpu::{ComputePipeline, ComputePipelineDescriptor, ShaderModuleDescriptor, ShaderSource};
use gpu::{Device, GpuError};

/// Workgroups in one dimension that every device has.
const MOST_GROUPS: u32 = 65_535;
/// The lane under which the device's clock counts the passes.
const LANE: usize = 2;

/// The buffers of one method.
pub(super) struct Buffers {
    pub(super) device: Arc<Device>,
    bytes: u64,
    allocation: Allocation,
}

impl Buffers {
    /// None yet, of `bytes` altogether.
    pub(super) fn new(device: &Arc<Device>, bytes: u64) -> Self {
        Self { device: Arc::clone(device), bytes, allocation: Allocation::new(device, bytes) }
    }

    /// Bytes of all of them.
    pub(super) fn bytes(&self) -> u64 {
        self.bytes
    }

    /// A buffer of zeros.
    pub(super) fn make(&mut self, label: &str, bytes: u64) -> Result<Buffer, GpuError> {
        let limits = self.device.limits();
        let limit_bytes = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
        if bytes > limit_bytes {
            return Err(GpuError::NeverFits { what: label.to_owned(), needed_bytes: bytes, limit_bytes });
        }
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_SRC | BufferUsages::COPY_DST;
        self.allocation.make(&self.device, label, bytes, usage)
    }

    /// A buffer of these words.
    pub(super) fn words(&mut self, label: &str, words: &[u32]) -> Result<Buffer, GpuError> {
        let buffer = self.make(label, 4 * words.len() as u64)?;
        write(&self.device, &buffer, 0, words)?;
        Ok(buffer)
    }

    /// The buffer through which labels come back, `bytes` at once.
    pub(super) fn staging(&mut self, bytes: u64) -> Result<Staging, GpuError> {
        Staging::new(&self.device, &mut self.allocation, bytes.max(16))
    }

    /// Compiles stage `name` of `sources`. Each of the `choices` has the buffers of the bindings 0, 1, 2 and so on.
    pub(super) fn stage(
        &self,
        sources: Sources,
        name: &str,
        constants: &[Constant<'_>],
        choices: &[Vec<&Buffer>],
    ) -> Result<Stage, GpuError> {
        let source = ShaderSource::Wgsl(compose(sources, name, constants)?.into());
        let (label, raw) = (Some(name), self.device.raw());
        self.device.scoped(|| {
            let module = raw.create_shader_module(ShaderModuleDescriptor { label, source });
            let pipeline = raw.create_compute_pipeline(&ComputePipelineDescriptor {
                label,
                layout: None,
                module: &module,
                entry_point: Some("main"),
                compilation_options: Default::default(),
                cache: None,
            });
            let layout = pipeline.get_bind_group_layout(0);
            let bind = |buffers: &Vec<&Buffer>| {
                let bound = (0..).zip(buffers);
                let entries: Vec<_> = bound
                    .map(|(binding, buffer)| BindGroupEntry { binding, resource: buffer.as_entire_binding() })
                    .collect();
                raw.create_bind_group(&BindGroupDescriptor { label, layout: &layout, entries: &entries })
            };
            let bound = choices.iter().map(bind).collect();
            Stage { pipeline, bound }
        })
    }

    /// Begins a pass of stages.
    pub(super) fn pass<'a>(&self, encoder: &'a mut CommandEncoder) -> ComputePass<'a> {
        self.device.pass(encoder, LANE)
    }
}

/// A compiled stage.
pub(super) struct Stage {
    pipeline: ComputePipeline,
    /// One for each choice of buffers.
    bound: Vec<BindGroup>,
}

impl Stage {
    /// Dispatches `items` invocations on the buffers of a choice.
    pub(super) fn run(&self, pass: &mut ComputePass<'_>, choice: usize, items: u32) {
        let groups = items.div_ceil(WORKGROUP).max(1);
        let x = groups.min(MOST_GROUPS);
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.bound[choice], &[]);
        pass.dispatch_workgroups(x, groups.div_ceil(x), 1);
    }
}
