//! A session's buffers, and bytes in and out of them.
//!
//! Purpose: allocate what a [`Plan`] says, once; upload and download in bounded portions.
//! Invariant: an upload in flight never holds more than [`UPLOAD_BYTES`] of wgpu's own staging
//! memory, whose exhaustion would lose the device.
//! Must not know: what the bytes mean.

use std::ops::Range;
use std::sync::{Arc, mpsc};

use bytemuck::{NoUninit, Pod};
use wgpu::BufferUsages as Usage;

use super::plan::{self, MotionPlan, Plan};
use super::spare::Spare;
use super::{Device, GpuError};

/// Bytes that are handed to the queue between two submissions.
pub const UPLOAD_BYTES: usize = 32 << 20;

/// All buffers of a session. Field names are those of [`Plan`] and of the shaders' bindings.
#[derive(Debug)]
pub struct Buffers {
    /// Seed records.
    pub seeds: wgpu::Buffer,
    /// Neighbour table.
    pub table: wgpu::Buffer,
    /// Sets of cells.
    pub slots: wgpu::Buffer,
    /// List of pairs.
    pub list: wgpu::Buffer,
    /// Fixed-point sums.
    pub sums: wgpu::Buffer,
    /// List of failures.
    pub failures: wgpu::Buffer,
    /// Summary block.
    pub state: wgpu::Buffer,
    /// Indirect arguments.
    pub arguments: wgpu::Buffer,
    /// Parameters.
    pub params: wgpu::Buffer,
    /// Heads of emitted pieces.
    pub heads: wgpu::Buffer,
    /// Their vertices.
    pub vertices: wgpu::Buffer,
    /// Their labels.
    pub labels: wgpu::Buffer,
    /// Grid of facets.
    pub near: wgpu::Buffer,
    /// Grid of seeds.
    pub cells: wgpu::Buffer,
    /// How far the seeds of each of its cells have moved.
    pub drifts: wgpu::Buffer,
    /// Seeds in its order.
    pub sorted: wgpu::Buffer,
    /// Where the parts of a dispatch begin.
    pub origins: wgpu::Buffer,
    /// Where seeds were when lists were made, and how far these reach.
    pub kept: wgpu::Buffer,
    /// Lists.
    pub lists: wgpu::Buffer,
    /// What is done with them.
    pub keep: wgpu::Buffer,
    /// What there is of each window of facets.
    pub windows: Vec<WindowBuffers>,
    staging: wgpu::Buffer,
    plan: Plan,
    spare: Arc<Spare>,
}

/// The next session may have them.
impl Drop for Buffers {
    fn drop(&mut self) {
        let Self {
            seeds,
            table,
            slots,
            list,
            sums,
            failures,
            state,
            arguments,
            params,
            heads,
            vertices,
            labels,
            near,
            cells,
            drifts,
            sorted,
            origins,
            kept,
            lists,
            keep,
            windows,
            staging,
            plan: _,
            spare,
        } = self;
        let all = [
            seeds, table, slots, list, sums, failures, state, arguments, params, heads, vertices, labels, near, cells,
            drifts, sorted, origins, kept, lists, keep, staging,
        ];
        let windows = windows.iter().flat_map(|window| [&window.facets, &window.proposals]);
        spare.keep(all.into_iter().map(|buffer| &*buffer).chain(windows).cloned());
    }
}

/// Buffers of the facets of a window.
#[derive(Debug)]
pub struct WindowBuffers {
    /// Facet records.
    pub facets: wgpu::Buffer,
    /// Proposals.
    pub proposals: wgpu::Buffer,
}

impl Buffers {
    /// Allocates everything, for windows of so many facets each.
    ///
    /// # Errors
    /// `OutOfMemory` with the bytes of the whole plan; what was allocated is freed again.
    pub fn new(device: &Device, plan: Plan, windows: &[u64]) -> Result<Self, GpuError> {
        let storage = Usage::STORAGE | Usage::COPY_DST | Usage::COPY_SRC;
        let make = |label: &str, bytes: u64, usage: Usage| {
            device.buffer(label, bytes, usage).map_err(|e| match e {
                GpuError::OutOfMemory { what, limit_bytes, .. } => {
                    GpuError::OutOfMemory { what, needed_bytes: plan.total_bytes(), limit_bytes }
                }
                other => other,
            })
        };
        let window = |&facets: &u64| {
            let (records, proposals) = plan::window_bytes(facets);
            Ok(WindowBuffers {
                facets: make("facets", records, storage)?,
                proposals: make("proposals", proposals, storage)?,
            })
        };
        let windows = windows.iter().map(window).collect::<Result<_, GpuError>>()?;
        let made = Self {
            windows,
            seeds: make("seeds", plan.seeds_bytes, storage)?,
            table: make("table", plan.table_bytes, storage)?,
            slots: make("slots", plan.slots_bytes, storage)?,
            list: make("list", plan.list_bytes, storage)?,
            sums: make("sums", plan.sums_bytes, storage)?,
            failures: make("failures", plan.failures_bytes, storage)?,
            state: make("state", plan.state_bytes, storage)?,
            arguments: make("arguments", plan.arguments_bytes, storage | Usage::INDIRECT)?,
            params: make("params", plan.params_bytes, Usage::UNIFORM | Usage::COPY_DST)?,
            heads: make("heads", plan.heads_bytes, storage)?,
            vertices: make("vertices", plan.vertices_bytes, storage)?,
            labels: make("labels", plan.labels_bytes, storage)?,
            near: make("near", plan.near_bytes, storage)?,
            cells: make("cells", plan.cells_bytes, storage)?,
            drifts: make("drifts", plan.drifts_bytes, storage)?,
            sorted: make("sorted", plan.sorted_bytes, storage)?,
            origins: make("origins", plan.origins_bytes, Usage::COPY_SRC | Usage::COPY_DST)?,
            kept: make("kept", plan.kept_bytes, storage)?,
            lists: make("lists", plan.lists_bytes, storage)?,
            keep: make("keep", plan.keep_bytes, storage | Usage::INDIRECT)?,
            staging: make("staging", plan.staging_bytes, Usage::MAP_READ | Usage::COPY_DST)?,
            plan,
            spare: device.spare(),
        };
        write(device, &made.origins, 0, &plan::part_origins(&plan))?;
        Ok(made)
    }

    /// What they were made for.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// Reads entries `range` of a buffer of `T`.
    ///
    /// # Errors
    /// Those of [`Device::run`].
    pub fn read<T: Pod>(
        &self,
        device: &Device,
        buffer: &wgpu::Buffer,
        range: Range<usize>,
    ) -> Result<Vec<T>, GpuError> {
        let mut out = Vec::with_capacity(range.len());
        let portion = (self.plan.staging_bytes as usize / size_of::<T>()).max(1);
        let mut at = range.start;
        while at < range.end {
            let end = range.end.min(at + portion);
            self.read_with(device, device.encoder(), buffer, at..end, |values: &[T]| out.extend_from_slice(values))?;
            at = end;
        }
        Ok(out)
    }

    /// Ends `encoder` with a copy of entries `range`, which must fit the staging buffer, submits,
    /// waits, and shows them.
    ///
    /// # Errors
    /// Those of [`Device::run`].
    pub fn read_with<T: Pod>(
        &self,
        device: &Device,
        encoder: wgpu::CommandEncoder,
        buffer: &wgpu::Buffer,
        range: Range<usize>,
        show: impl FnOnce(&[T]),
    ) -> Result<(), GpuError> {
        let (first, bytes) = ((range.start * size_of::<T>()) as u64, (range.len() * size_of::<T>()) as u64);
        self.read_parts(device, encoder, &[(buffer, first, bytes)], |view| match bytemuck::try_cast_slice(view) {
            Ok(values) => show(values),
            // A mapped range is aligned to 8 bytes; the copy serves a driver that aligns less.
            Err(_) => {
                let copy: Vec<T> = view.chunks_exact(size_of::<T>()).map(bytemuck::pod_read_unaligned).collect();
                show(&copy);
            }
        })
    }

    /// Ends `encoder` with copies of (buffer, first byte, bytes), which must fit the staging buffer
    /// together, submits, waits, and shows them one behind the other.
    ///
    /// # Errors
    /// Those of [`Device::run`].
    pub fn read_parts(
        &self,
        device: &Device,
        mut encoder: wgpu::CommandEncoder,
        parts: &[(&wgpu::Buffer, u64, u64)],
        show: impl FnOnce(&[u8]),
    ) -> Result<(), GpuError> {
        let mut bytes = 0;
        for &(buffer, first, length) in parts.iter().filter(|part| part.2 > 0) {
            encoder.copy_buffer_to_buffer(buffer, first, &self.staging, bytes, length);
            bytes += length;
        }
        if bytes == 0 {
            return device.run(encoder);
        }
        let index = device.submit(encoder)?;
        device.count_read(bytes);
        let (mapped, answer) = mpsc::sync_channel(1);
        // Refusals reach the flags of the device; this one only says that the bytes are there.
        self.staging.map_async(wgpu::MapMode::Read, 0..bytes, move |r| {
            // The receiver is gone only if waiting failed.
            let _ = mapped.send(r.is_ok());
        });
        device.wait(Some(index))?;
        // Another thread that waits for the same device may have taken this callback and not run it yet.
        if answer.recv_timeout(device.timeout()) != Ok(true) {
            return Err(GpuError::Failed("a buffer could not be mapped".to_owned()));
        }
        let view = self.staging.get_mapped_range(0..bytes).map_err(|e| GpuError::Failed(e.to_string()))?;
        show(&view);
        drop(view);
        self.staging.unmap();
        Ok(())
    }
}

/// The buffers with which seeds are moved. Fields as in [`MotionPlan`] and in the shaders.
#[derive(Debug)]
pub struct MotionBuffers {
    /// The present point.
    pub points: wgpu::Buffer,
    /// Which seeds are held.
    pub held: wgpu::Buffer,
    /// The gradient there.
    pub gradient: wgpu::Buffer,
    /// The gradient at the trial point.
    pub ahead: wgpu::Buffer,
    /// The direction.
    pub direction: wgpu::Buffer,
    /// Steps of the history.
    pub steps: wgpu::Buffer,
    /// Changes of the gradient.
    pub changes: wgpu::Buffer,
    /// Partial sums over cells.
    pub tallies: wgpu::Buffer,
    /// Their sum.
    pub figures: wgpu::Buffer,
    /// Partial dot products.
    pub partials: wgpu::Buffer,
    /// Dot products.
    pub dots: wgpu::Buffer,
    /// Parameters.
    pub motion: wgpu::Buffer,
    /// What is kept of each pass of a submission.
    pub journal: wgpu::Buffer,
    plan: MotionPlan,
    spare: Arc<Spare>,
}

/// The next session may have them.
impl Drop for MotionBuffers {
    fn drop(&mut self) {
        let Self {
            points,
            held,
            gradient,
            ahead,
            direction,
            steps,
            changes,
            tallies,
            figures,
            partials,
            dots,
            motion,
            journal,
            plan: _,
            spare,
        } = self;
        let all = [
            points, held, gradient, ahead, direction, steps, changes, tallies, figures, partials, dots, motion, journal,
        ];
        spare.keep(all.into_iter().map(|buffer| buffer.clone()));
    }
}

impl MotionBuffers {
    /// Allocates everything, zeroed.
    ///
    /// # Errors
    /// `OutOfMemory` with the bytes of the whole plan.
    pub fn new(device: &Device, plan: MotionPlan) -> Result<Self, GpuError> {
        let storage = Usage::STORAGE | Usage::COPY_DST | Usage::COPY_SRC;
        let make = |label: &str, bytes: u64, usage: Usage| {
            device.buffer(label, bytes, usage).map_err(|e| match e {
                GpuError::OutOfMemory { what, limit_bytes, .. } => {
                    GpuError::OutOfMemory { what, needed_bytes: plan.total_bytes(), limit_bytes }
                }
                other => other,
            })
        };
        Ok(Self {
            points: make("points", plan.points_bytes, storage)?,
            held: make("held", plan.held_bytes, storage)?,
            gradient: make("gradient", plan.vector_bytes, storage)?,
            ahead: make("ahead", plan.vector_bytes, storage)?,
            direction: make("direction", plan.vector_bytes, storage)?,
            steps: make("steps", plan.history_bytes, storage)?,
            changes: make("changes", plan.history_bytes, storage)?,
            tallies: make("tallies", plan.tallies_bytes, storage)?,
            figures: make("figures", plan.figures_bytes, storage)?,
            partials: make("partials", plan.partials_bytes, storage)?,
            dots: make("dots", plan.dots_bytes, storage)?,
            motion: make("motion", plan.motion_bytes, Usage::UNIFORM | Usage::COPY_DST)?,
            journal: make("journal", plan.journal_bytes, Usage::COPY_SRC | Usage::COPY_DST)?,
            plan,
            spare: device.spare(),
        })
    }

    /// What they were made for.
    pub fn plan(&self) -> &MotionPlan {
        &self.plan
    }
}

/// Writes `values` to `buffer` from entry `first` on.
///
/// # Errors
/// Those of [`Device::run`].
pub fn write<T: NoUninit>(device: &Device, buffer: &wgpu::Buffer, first: usize, values: &[T]) -> Result<(), GpuError> {
    let bytes: &[u8] = bytemuck::cast_slice(values);
    let mut offset = (first * size_of::<T>()) as u64;
    for (k, portion) in bytes.chunks(UPLOAD_BYTES).enumerate() {
        if k > 0 {
            device.run(device.encoder())?;
        }
        device.queue().write_buffer(buffer, offset, portion);
        device.count_upload(portion.len());
        offset += portion.len() as u64;
    }
    device.check()
}
