//! The labels of a flood on a GPU.
//!
//! Purpose: seeds go to the device, all passes of a flood are one submission, and the labels of the surface's voxels come
//! back, to be summed on the host. Invariant: the rules of [`super`]; where two seeds are as near, the device may round
//! otherwise. Must not know: what labels are for.

use std::sync::Arc;

use super::{BYTES, Labels, NONE};
use geometry::rvd::RvdError;
use geometry::token::Token;
use gpu::buffers::{Allocation, Staging, write};
use gpu::wgpu::{BindGroup, BindGroupDescriptor, BindGroupEntry, Buffer, BufferUsages, ComputePass, ComputePipeline};
use gpu::wgpu::{ComputePipelineDescriptor, ShaderModuleDescriptor, ShaderSource};
use gpu::{Device, GpuError};

/// Invocations of a workgroup, as in the shaders.
const WORKGROUP: u32 = 64;
/// Workgroups in one dimension that every device has.
const MOST_GROUPS: u32 = 65_535;
/// The lane under which the device's clock counts the passes.
const LANE: usize = 2;

/// A stage, for each of the two buffers that the labels may be in.
struct Stage {
    pipeline: ComputePipeline,
    bound: [BindGroup; 2],
}

impl Stage {
    fn run(&self, pass: &mut ComputePass<'_>, front: usize, items: u32) {
        let groups = items.div_ceil(WORKGROUP).max(1);
        let x = groups.min(MOST_GROUPS);
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.bound[front], &[]);
        pass.dispatch_workgroups(x, groups.div_ceil(x), 1);
    }
}

pub(in super::super) struct OnDevice {
    device: Arc<Device>,
    n: u32,
    /// Which of both buffers has the present labels.
    front: usize,
    both: [Buffer; 2],
    seeds: Buffer,
    planted: Buffer,
    /// How many voxels hold seeds.
    planting: Buffer,
    gathered: Buffer,
    staging: Staging,
    plant: Stage,
    /// Distances 1, 2, 4 and so on.
    passes: Vec<Stage>,
    gather: Stage,
    /// Those of the surface's voxels.
    labels: Vec<u32>,
    bytes: u64,
    _allocation: Allocation,
}

impl OnDevice {
    /// For a grid of N³ voxels, of which `codes` are the surface's, and `count` seeds at most.
    pub(in super::super) fn new(device: &Arc<Device>, n: u32, codes: &[u32], count: usize) -> Result<Self, GpuError> {
        let all = n.pow(3);
        let (surface, of_seeds) = (4 * codes.len() as u64, count as u64);
        let (needed_bytes, limit_bytes) = (4 * u64::from(all), device.limits().max_storage_buffer_binding_size);
        if needed_bytes > limit_bytes {
            return Err(GpuError::NeverFits { what: "labels".to_owned(), needed_bytes, limit_bytes });
        }
        let bytes = BYTES * u64::from(all) + 3 * surface + 24 * of_seeds;
        let mut allocation = Allocation::new(device, bytes);
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_SRC | BufferUsages::COPY_DST;
        let mut make = |label: &str, bytes: u64| allocation.make(device, label, bytes, usage);
        let both = [make("labels", 4 * u64::from(all))?, make("next labels", 4 * u64::from(all))?];
        let (seeds, planted) = (make("seeds", 16 * of_seeds)?, make("planted", 8 * of_seeds)?);
        let (at, gathered) = (make("voxels", surface)?, make("gathered", surface)?);
        write(device, &at, 0, codes)?;
        let mut params = |step: u32, items: u32| -> Result<Buffer, GpuError> {
            let buffer = make("parameters", 16)?;
            write(device, &buffer, 0, &[n, step, items, 0])?;
            Ok(buffer)
        };
        let (planting, gathering) = (params(0, 0)?, params(0, codes.len() as u32)?);
        let plant =
            stage(device, "plant", include_str!("plant.wgsl"), |front| [&planting, &seeds, &planted, &both[front]])?;
        let gather =
            stage(device, "gather", include_str!("gather.wgsl"), |front| [&gathering, &at, &both[front], &gathered])?;
        let mut passes = Vec::new();
        for k in 0..=n.div_ceil(2).next_power_of_two().ilog2() {
            let params = params(1 << k, all)?;
            passes.push(stage(device, "pass", include_str!("pass.wgsl"), |front| {
                [&params, &seeds, &both[front], &both[1 - front]]
            })?);
        }
        let staging = Staging::new(device, &mut allocation, surface.max(16))?;
        let (device, labels) = (Arc::clone(device), vec![NONE; codes.len()]);
        let _allocation = allocation;
        Ok(Self {
            device,
            n,
            front: 0,
            both,
            seeds,
            planted,
            planting,
            gathered,
            staging,
            plant,
            passes,
            gather,
            labels,
            bytes,
            _allocation,
        })
    }
}

/// Compiles a stage, which sees four buffers.
fn stage<'a>(
    device: &Device,
    label: &str,
    source: &str,
    buffers: impl Fn(usize) -> [&'a Buffer; 4],
) -> Result<Stage, GpuError> {
    device.scoped(|| {
        let source = ShaderSource::Wgsl(source.into());
        let module = device.raw().create_shader_module(ShaderModuleDescriptor { label: Some(label), source });
        let pipeline = device.raw().create_compute_pipeline(&ComputePipelineDescriptor {
            label: Some(label),
            layout: None,
            module: &module,
            entry_point: Some("main"),
            compilation_options: Default::default(),
            cache: None,
        });
        let layout = pipeline.get_bind_group_layout(0);
        let bound = [0, 1].map(|front| {
            let entry =
                |(binding, buffer): (u32, &'a Buffer)| BindGroupEntry { binding, resource: buffer.as_entire_binding() };
            let entries: Vec<_> = (0..).zip(buffers(front)).map(entry).collect();
            let descriptor = BindGroupDescriptor { label: Some(label), layout: &layout, entries: &entries };
            device.raw().create_bind_group(&descriptor)
        });
        Stage { pipeline, bound }
    })
}

impl Labels for OnDevice {
    fn flood(
        &mut self,
        seeds: &[[f32; 3]],
        planted: &[[u32; 2]],
        kept: bool,
        step: u32,
        token: &Token,
    ) -> Result<(), RvdError> {
        token.check()?;
        let device = &self.device;
        let padded: Vec<[f32; 4]> = seeds.iter().map(|&[x, y, z]| [x, y, z, 0.0]).collect();
        let count = planted.len() as u32;
        write(device, &self.seeds, 0, &padded)?;
        write(device, &self.planted, 0, planted)?;
        write(device, &self.planting, 0, &[self.n, 0, count, 0])?;
        let mut encoder = device.encoder();
        if !kept {
            encoder.clear_buffer(&self.both[self.front], 0, None);
        }
        let mut pass = device.pass(&mut encoder, LANE);
        self.plant.run(&mut pass, self.front, count);
        for stage in self.passes[..=step.ilog2() as usize].iter().rev() {
            stage.run(&mut pass, self.front, self.n.pow(3));
            self.front = 1 - self.front;
        }
        self.gather.run(&mut pass, self.front, self.labels.len() as u32);
        drop(pass);
        let labels = &mut self.labels;
        let all = 0..labels.len();
        self.staging.read_with(device, encoder, &self.gathered, all, |found: &[u32]| {
            // On the device 0 is no seed.
            labels.iter_mut().zip(found).for_each(|(label, found)| *label = found.wrapping_sub(1));
        })?;
        Ok(())
    }

    fn label(&self, k: usize, _: u32) -> u32 {
        self.labels[k]
    }

    fn bytes(&self) -> u64 {
        self.bytes
    }
}
