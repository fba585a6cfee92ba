//! What a device allows.
//!
//! Purpose: [`Limits`] are the numbers that plans of buffers and dispatches are made for.
//! Invariant: pure. Must not know: what the bytes are for.

use super::GpuError;

/// The part of a buffer that one readback copies at most.
pub const STAGING_BYTES: u64 = 32 << 20;

/// What the device allows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Largest buffer, bytes.
    pub buffer_bytes: u64,
    /// Largest storage binding, bytes.
    pub binding_bytes: u64,
    /// Workgroups in one dimension.
    pub workgroups: u32,
}

impl Limits {
    /// Those of an open device.
    pub fn of(limits: &wgpu::Limits) -> Self {
        Self {
            buffer_bytes: limits.max_buffer_size,
            binding_bytes: limits.max_storage_buffer_binding_size,
            workgroups: limits.max_compute_workgroups_per_dimension,
        }
    }

    /// Largest buffer that a shader can see all of, bytes.
    pub fn seen_bytes(self) -> u64 {
        // Offsets within a buffer are 32-bit words on the device.
        self.buffer_bytes.min(self.binding_bytes).min(16 << 30)
    }
}

/// Whether a shader can see each of these buffers (name, bytes) as a whole.
///
/// # Errors
/// `NeverFits` with the first that it cannot.
pub fn fits(buffers: &[(&str, u64)], limits: Limits) -> Result<(), GpuError> {
    let limit_bytes = limits.seen_bytes();
    for &(what, needed_bytes) in buffers {
        if needed_bytes > limit_bytes {
            return Err(GpuError::NeverFits { what: what.to_owned(), needed_bytes, limit_bytes });
        }
    }
    Ok(())
}
