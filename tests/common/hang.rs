//! Work for a device that goes on for as long as is asked, so that its driver does not answer.

use std::sync::Arc;
use std::time::{Duration, Instant};

use ::gpu::Device;

/// Work that takes longer than any submission may.
pub struct Hang {
    device: Arc<Device>,
    pipeline: wgpu::ComputePipeline,
    bindings: wgpu::BindGroup,
    /// Thousands of workgroups.
    thousands: u32,
}

impl Hang {
    /// Compiles it and measures it, so that it will take about so long. Nothing of it is at the device after that.
    pub fn new(device: Arc<Device>, time: Duration) -> Self {
        // A loop of a software driver ends after 65,535 rounds, so many workgroups go through a shorter one.
        let source = "@group(0) @binding(0) var<storage, read_write> out: array<u32>;
            @compute @workgroup_size(8) fn main(@builtin(workgroup_id) group: vec3u) {
                var x = group.x;
                for (var i = 0u; i < 60000u; i++) { x = x * 1664525u + 1013904223u + (x >> 7u); }
                if x == 7u { out[0] = x; }
            }";
        let raw = device.raw();
        let module = raw.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: None,
            source: wgpu::ShaderSource::Wgsl(source.into()),
        });
        let pipeline = raw.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: None,
            layout: None,
            module: &module,
            entry_point: Some("main"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            cache: None,
        });
        let usage = wgpu::BufferUsages::STORAGE;
        let buffer =
            raw.create_buffer(&wgpu::BufferDescriptor { label: None, size: 16, usage, mapped_at_creation: false });
        let bindings = raw.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &pipeline.get_bind_group_layout(0),
            entries: &[wgpu::BindGroupEntry { binding: 0, resource: buffer.as_entire_binding() }],
        });
        let mut hang = Self { device, pipeline, bindings, thousands: 1 };
        // The first one is compiled.
        hang.wait();
        // The fastest of three: others use the processors too.
        let one = (0..3).map(|_| {
            let begin = Instant::now();
            hang.wait();
            begin.elapsed().as_secs_f64()
        });
        let one = one.fold(f64::INFINITY, f64::min);
        hang.thousands = (time.as_secs_f64() / one).ceil() as u32;
        hang
    }

    /// Gives it to the device, and does not wait.
    pub fn submit(&self) -> wgpu::SubmissionIndex {
        let mut encoder = self.device.encoder();
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, &self.bindings, &[]);
            pass.dispatch_workgroups(1000, self.thousands, 1);
        }
        self.device.queue().submit([encoder.finish()])
    }

    fn wait(&self) {
        let submission_index = Some(self.submit());
        self.device.raw().poll(wgpu::PollType::Wait { submission_index, timeout: None }).unwrap();
    }
}
