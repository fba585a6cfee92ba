//! Time by the device's own clock.
//!
//! Purpose: [`Timer`] writes a time stamp before and after each compute pass of a submission and adds the differences up by
//! lane, a number that the caller gives a kind of pass. Invariant: only stamps of the submission that is waited for are read;
//! passes of an encoder that is never submitted are forgotten. A pass for which there is no stamp left is not timed, and never
//! wrong. Must not know: what a lane stands for.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::mpsc::{self, Receiver};

use super::GpuError;

/// Kinds of passes that are timed apart.
pub(super) const LANES: usize = 4;

/// Passes of one submission that are timed.
const SPANS: usize = 256;

pub(super) struct Timer {
    stamps: wgpu::QuerySet,
    resolved: wgpu::Buffer,
    staging: wgpu::Buffer,
    /// Nanoseconds of a tick.
    period: f64,
    /// The encoder that is being filled, and the lanes of its passes.
    encoder: u64,
    lanes: Vec<usize>,
    /// Lanes of what was submitted and not read yet.
    due: Option<(Vec<usize>, Receiver<bool>)>,
    /// Milliseconds of each lane so far, and of its longest pass.
    pub(super) total_ms: [f64; LANES],
    pub(super) longest_ms: [f64; LANES],
}

fn name(encoder: &wgpu::CommandEncoder) -> u64 {
    let mut hasher = DefaultHasher::new();
    encoder.hash(&mut hasher);
    hasher.finish()
}

impl Timer {
    pub(super) fn new(device: &wgpu::Device, queue: &wgpu::Queue) -> Self {
        let bytes = (2 * SPANS * size_of::<u64>()) as u64;
        let buffer = |label, usage| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size: bytes,
                usage,
                mapped_at_creation: false,
            })
        };
        let stamps =
            wgpu::QuerySetDescriptor { label: Some("stamps"), ty: wgpu::QueryType::Timestamp, count: 2 * SPANS as u32 };
        Self {
            stamps: device.create_query_set(&stamps),
            resolved: buffer("stamps", wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC),
            staging: buffer("stamps read", wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST),
            period: f64::from(queue.get_timestamp_period()),
            encoder: 0,
            lanes: Vec::with_capacity(SPANS),
            due: None,
            total_ms: [0.0; LANES],
            longest_ms: [0.0; LANES],
        }
    }

    pub(super) fn pass<'a>(&mut self, encoder: &'a mut wgpu::CommandEncoder, lane: usize) -> wgpu::ComputePass<'a> {
        let name = name(encoder);
        if self.encoder != name {
            self.lanes.clear();
            self.encoder = name;
        }
        let first = 2 * self.lanes.len() as u32;
        let room = self.lanes.len() < SPANS && lane < LANES;
        if room {
            self.lanes.push(lane);
        }
        let writes = room.then_some(wgpu::ComputePassTimestampWrites {
            query_set: &self.stamps,
            beginning_of_pass_write_index: Some(first),
            end_of_pass_write_index: Some(first + 1),
        });
        encoder.begin_compute_pass(&wgpu::ComputePassDescriptor { label: None, timestamp_writes: writes })
    }

    /// Ends an encoder that is about to be submitted. Returns whether [`Self::submitted`] has to follow.
    pub(super) fn finish(&mut self, encoder: &mut wgpu::CommandEncoder) -> bool {
        if self.lanes.is_empty() || self.due.is_some() || self.encoder != name(encoder) {
            return false;
        }
        let stamps = 2 * self.lanes.len() as u32;
        encoder.resolve_query_set(&self.stamps, 0..stamps, &self.resolved, 0);
        encoder.copy_buffer_to_buffer(&self.resolved, 0, &self.staging, 0, u64::from(stamps) * 8);
        true
    }

    /// What [`Self::finish`] ended was submitted.
    pub(super) fn submitted(&mut self) {
        let (sender, receiver) = mpsc::sync_channel(1);
        let lanes = std::mem::take(&mut self.lanes);
        self.encoder = 0;
        self.staging.map_async(wgpu::MapMode::Read, 0..(lanes.len() * 16) as u64, move |r| {
            // The receiver is gone only if the wait has ended.
            let _ = sender.send(r.is_ok());
        });
        self.due = Some((lanes, receiver));
    }

    /// Reads the stamps of what was submitted and has ended.
    pub(super) fn collect(&mut self, timeout: std::time::Duration) -> Result<(), GpuError> {
        let Some((lanes, answer)) = self.due.take() else { return Ok(()) };
        if answer.recv_timeout(timeout) != Ok(true) {
            return Err(GpuError::Failed("time stamps could not be mapped".to_owned()));
        }
        let bytes = (lanes.len() * 16) as u64;
        let view = self.staging.get_mapped_range(0..bytes).map_err(|e| GpuError::Failed(e.to_string()))?;
        let ticks: Vec<u64> = view.chunks_exact(8).map(bytemuck::pod_read_unaligned).collect();
        drop(view);
        self.staging.unmap();
        for (&lane, ends) in lanes.iter().zip(ticks.chunks_exact(2)) {
            // A clock may be set back between two stamps; such a span is worth nothing.
            let ms = ends[1].saturating_sub(ends[0]) as f64 * self.period / 1e6;
            self.total_ms[lane] += ms;
            self.longest_ms[lane] = self.longest_ms[lane].max(ms);
        }
        Ok(())
    }
}
