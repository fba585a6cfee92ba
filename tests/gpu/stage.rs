//! Runs one stage of `shaders/` alone, on buffers that a test makes.
//!
//! Invariant: the buffers are given in the order of the stage's bindings, as words; what a stage may write comes back.
//! Must not know: what a stage does.

use std::sync::Arc;

use ::gpu::Device;
use ::gpu::buffers::{Allocation, Staging, write};
use ::gpu::diagram::shaders;
use bytemuck::Pod;
use wgpu::BufferUsages as Usage;

/// Bytes that are read back at once.
pub const STAGING_BYTES: u64 = 1 << 16;

/// What reads buffers back, some bytes at a time.
pub fn staging(device: &Device) -> (Staging, Allocation) {
    let mut allocation = Allocation::new(device, STAGING_BYTES);
    (Staging::new(device, &mut allocation, STAGING_BYTES).unwrap(), allocation)
}

/// Records as words.
pub fn words<T: Pod>(records: &[T]) -> Vec<u32> {
    bytemuck::pod_collect_to_vec(records)
}

/// Words as records.
pub fn records<T: Pod>(words: &[u32]) -> Vec<T> {
    bytemuck::pod_collect_to_vec(words)
}

/// A stage with its constants, compiled.
pub struct Stage {
    device: Arc<Device>,
    pipeline: wgpu::ComputePipeline,
    layout: wgpu::BindGroupLayout,
    /// Of each binding: none for a uniform, else whether it is read alone.
    bindings: Vec<Option<bool>>,
}

impl Stage {
    /// `name` as in `shaders/`; the entry point is `main` but for `clip/checks`.
    pub fn new(device: &Arc<Device>, name: &str, entry: &str, constants: &[(&str, i64)]) -> Self {
        let source = shaders::compose(name, constants).unwrap();
        let parsed = naga::front::wgsl::parse_str(&source).unwrap_or_else(|e| panic!("{}", e.emit_to_string(&source)));
        let mut bindings = Vec::new();
        for (_, variable) in parsed.global_variables.iter() {
            let Some(binding) = &variable.binding else { continue };
            let read_only = match variable.space {
                naga::AddressSpace::Uniform => None,
                naga::AddressSpace::Storage { access } => Some(!access.contains(naga::StorageAccess::STORE)),
                other => panic!("{name}: {other:?}"),
            };
            bindings.push((binding.binding, read_only));
        }
        bindings.sort_unstable_by_key(|&(at, _)| at);
        assert!(bindings.iter().enumerate().all(|(k, &(at, _))| at as usize == k), "{name}: bindings have gaps");
        let raw = device.raw();
        let entries: Vec<_> = bindings
            .iter()
            .map(|&(binding, read_only)| wgpu::BindGroupLayoutEntry {
                binding,
                visibility: wgpu::ShaderStages::COMPUTE,
                ty: wgpu::BindingType::Buffer {
                    ty: match read_only {
                        None => wgpu::BufferBindingType::Uniform,
                        Some(read_only) => wgpu::BufferBindingType::Storage { read_only },
                    },
                    has_dynamic_offset: false,
                    min_binding_size: None,
                },
                count: None,
            })
            .collect();
        let layout = raw.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: None, entries: &entries });
        let module = raw.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(name),
            source: wgpu::ShaderSource::Wgsl(source.into()),
        });
        let pipeline = raw.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(name),
            layout: Some(&raw.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: None,
                bind_group_layouts: &[Some(&layout)],
                immediate_size: 0,
            })),
            module: &module,
            entry_point: Some(entry),
            compilation_options: Default::default(),
            cache: None,
        });
        let bindings = bindings.into_iter().map(|(_, read_only)| read_only).collect();
        Self { device: Arc::clone(device), pipeline, layout, bindings }
    }

    /// Dispatches so many workgroups. The buffers come back as they are then.
    pub fn run(&self, groups: u32, given: &[Vec<u32>]) -> Vec<Vec<u32>> {
        let device = &self.device;
        assert_eq!(given.len(), self.bindings.len(), "a buffer for each binding");
        let buffers: Vec<wgpu::Buffer> = given
            .iter()
            .zip(&self.bindings)
            .map(|(words, read_only)| {
                let usage = if read_only.is_none() { Usage::UNIFORM } else { Usage::STORAGE | Usage::COPY_SRC };
                let buffer = device.buffer("stage", 4 * words.len() as u64, usage | Usage::COPY_DST).unwrap();
                write(device, &buffer, 0, words).unwrap();
                buffer
            })
            .collect();
        let bound: Vec<_> = buffers
            .iter()
            .enumerate()
            .map(|(k, b)| wgpu::BindGroupEntry { binding: k as u32, resource: b.as_entire_binding() })
            .collect();
        let descriptor = wgpu::BindGroupDescriptor { label: None, layout: &self.layout, entries: &bound };
        let group = device.raw().create_bind_group(&descriptor);
        let mut encoder = device.encoder();
        {
            let mut pass = encoder.begin_compute_pass(&Default::default());
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, &group, &[]);
            pass.dispatch_workgroups(groups, 1, 1);
        }
        device.run(encoder).unwrap();
        let (reader, _allocation) = staging(device);
        let read = |(k, buffer): (usize, &wgpu::Buffer)| match self.bindings[k] {
            Some(false) => reader.read::<u32>(device, buffer, 0..given[k].len()).unwrap(),
            _ => given[k].clone(),
        };
        buffers.iter().enumerate().map(read).collect()
    }
}
