//! Buffers of sessions that have ended, for the next.
//!
//! Purpose: a job of the same plan as the one before allocates nothing. Invariant: what is taken is as if it were new: zeroed.
//! At most [`MOST_BYTES`] lie here, the oldest go first. Must not know: what buffers are for.

use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// What is kept at most, bytes.
const MOST_BYTES: u64 = 512 << 20;

#[derive(Debug, Default)]
pub(crate) struct Spare(Mutex<VecDeque<wgpu::Buffer>>);

impl Spare {
    fn lock(&self) -> MutexGuard<'_, VecDeque<wgpu::Buffer>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A buffer of this size and usage, with whatever it holds.
    pub(super) fn take(&self, size: u64, usage: wgpu::BufferUsages) -> Option<wgpu::Buffer> {
        let mut spare = self.lock();
        let found = spare.iter().position(|buffer| buffer.size() == size && buffer.usage() == usage)?;
        spare.remove(found)
    }

    pub(super) fn keep(&self, buffers: impl IntoIterator<Item = wgpu::Buffer>) {
        let mut spare = self.lock();
        spare.extend(buffers);
        let mut bytes: u64 = spare.iter().map(wgpu::Buffer::size).sum();
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
