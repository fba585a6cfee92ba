//! Buffers of a plan, and bytes in and out of them.
//!
//! Purpose: [`Allocation`] allocates what a plan says, and passes it on to the next one when it ends ([`Spare`]), so that a job of
//! the same plan as the one before allocates nothing; [`Staging`] and [`write()`] download and upload in bounded portions.
//! Invariant: an upload in flight never holds more than [`UPLOAD_BYTES`] of wgpu's own staging memory, whose exhaustion would lose
//! the device. A buffer that is passed on is zeroed. At most [`MOST_BYTES`] lie spare, the oldest go first.
//! Must not know: what the bytes mean.

use std::collections::VecDeque;
use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, mpsc};

use bytemuck::{NoUninit, Pod};
use wgpu::{Buffer, BufferUsages as Usage};

use crate::{Device, GpuError};

/// Bytes that are handed to the queue between two submissions.
pub const UPLOAD_BYTES: usize = 32 << 20;

/// The buffers of one plan. When it is dropped, they go to the device's spare ones.
#[derive(Debug)]
pub struct Allocation {
    buffers: Vec<Buffer>,
    /// Bytes of the whole plan, for the error message.
    needed_bytes: u64,
    spare: Arc<Spare>,
}

impl Allocation {
    /// Nothing yet, of a plan of `needed_bytes`.
    pub fn new(device: &Device, needed_bytes: u64) -> Self {
        Self { buffers: Vec::new(), needed_bytes, spare: Arc::clone(&device.spare) }
    }

    /// Allocates one buffer, zeroed.
    ///
    /// # Errors
    /// `OutOfMemory` with the bytes of the whole plan; what was allocated for it is freed.
    pub fn make(&mut self, device: &Device, label: &str, bytes: u64, usage: Usage) -> Result<Buffer, GpuError> {
        match device.buffer(label, bytes, usage) {
            Ok(buffer) => {
                self.buffers.push(buffer.clone());
                Ok(buffer)
            }
            Err(error) => {
                self.buffers.clear();
                Err(match error {
                    GpuError::OutOfMemory { what, limit_bytes, .. } => {
                        GpuError::OutOfMemory { what, needed_bytes: self.needed_bytes, limit_bytes }
                    }
                    other => other,
                })
            }
        }
    }
}

impl Drop for Allocation {
    fn drop(&mut self) {
        self.spare.keep(self.buffers.drain(..));
    }
}

/// The buffer through which bytes come back.
#[derive(Debug)]
pub struct Staging {
    buffer: Buffer,
    bytes: u64,
}

impl Staging {
    /// A staging buffer of `bytes`.
    pub fn new(device: &Device, allocation: &mut Allocation, bytes: u64) -> Result<Self, GpuError> {
        let buffer = allocation.make(device, "staging", bytes, Usage::MAP_READ | Usage::COPY_DST)?;
        Ok(Self { buffer, bytes })
    }

    /// Reads entries `range` of a buffer of `T`.
    pub fn read<T: Pod>(&self, device: &Device, buffer: &Buffer, range: Range<usize>) -> Result<Vec<T>, GpuError> {
        let mut out = Vec::with_capacity(range.len());
        let portion = (self.bytes as usize / size_of::<T>()).max(1);
        let mut at = range.start;
        while at < range.end {
            let end = range.end.min(at + portion);
            self.read_with(device, device.encoder(), buffer, at..end, |values: &[T]| out.extend_from_slice(values))?;
            at = end;
        }
        Ok(out)
    }

    /// Ends `encoder` with a copy of entries `range`, which must fit the staging buffer, submits, waits, and shows them.
    pub fn read_with<T: Pod>(
        &self,
        device: &Device,
        encoder: wgpu::CommandEncoder,
        buffer: &Buffer,
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
    pub fn read_parts(
        &self,
        device: &Device,
        mut encoder: wgpu::CommandEncoder,
        parts: &[(&Buffer, u64, u64)],
        show: impl FnOnce(&[u8]),
    ) -> Result<(), GpuError> {
        let mut bytes = 0;
        for &(buffer, first, length) in parts.iter().filter(|part| part.2 > 0) {
            encoder.copy_buffer_to_buffer(buffer, first, &self.buffer, bytes, length);
            bytes += length;
        }
        if bytes == 0 {
            return device.run(encoder);
        }
        let index = device.submit(encoder)?;
        device.meters().read_bytes += bytes;
        let (mapped, answer) = mpsc::sync_channel(1);
        // Refusals reach the flags of the device; this one only says that the bytes are there.
        self.buffer.map_async(wgpu::MapMode::Read, 0..bytes, move |r| {
            // The receiver is gone only if waiting failed.
            let _ = mapped.send(r.is_ok());
        });
        device.wait(Some(index))?;
        // Another thread that waits for the same device may have taken this callback and not run it yet.
        if answer.recv_timeout(device.timeout) != Ok(true) {
            return Err(GpuError::Failed("a buffer could not be mapped".to_owned()));
        }
        let view = self.buffer.get_mapped_range(0..bytes).map_err(|e| GpuError::Failed(e.to_string()))?;
        show(&view);
        drop(view);
        self.buffer.unmap();
        Ok(())
    }
}

/// Writes `values` to `buffer` from entry `first` on.
pub fn write<T: NoUninit>(device: &Device, buffer: &Buffer, first: usize, values: &[T]) -> Result<(), GpuError> {
    let bytes: &[u8] = bytemuck::cast_slice(values);
    let mut offset = (first * size_of::<T>()) as u64;
    for (k, portion) in bytes.chunks(UPLOAD_BYTES).enumerate() {
        if k > 0 {
            device.run(device.encoder())?;
        }
        device.queue().write_buffer(buffer, offset, portion);
        device.meters().uploaded_bytes += portion.len() as u64;
        offset += portion.len() as u64;
    }
    device.check()
}

/// What is kept at most, bytes.
const MOST_BYTES: u64 = 512 << 20;

#[derive(Debug, Default)]
pub(crate) struct Spare(Mutex<VecDeque<Buffer>>);

impl Spare {
    fn lock(&self) -> MutexGuard<'_, VecDeque<Buffer>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A buffer of this size and usage, with whatever it holds.
    pub(super) fn take(&self, size: u64, usage: Usage) -> Option<Buffer> {
        let mut spare = self.lock();
        let found = spare.iter().position(|buffer| buffer.size() == size && buffer.usage() == usage)?;
        spare.remove(found)
    }

    pub(super) fn keep(&self, buffers: impl IntoIterator<Item = Buffer>) {
        let mut spare = self.lock();
        spare.extend(buffers);
        let mut bytes: u64 = spare.iter().map(Buffer::size).sum();
        while bytes > MOST_BYTES {
            let Some(oldest) = spare.pop_front() else { break };
            bytes -= oldest.size();
        }
    }

    /// Frees all. Whether there was any.
    pub(super) fn free(&self) -> bool {
        let freed = std::mem::take(&mut *self.lock());
        !freed.is_empty()
    }
}
