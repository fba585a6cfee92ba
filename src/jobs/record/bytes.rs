//! The two memories that jobs share.
//!
//! Purpose: [`Bytes`] is what a job needs of them, or what there is. Invariant: sums never overflow. Must not know: jobs.

use serde::{Deserialize, Serialize};

/// Memory, bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bytes {
    /// Of the process.
    pub host: u64,
    /// Of the device; 0 for a job on a CPU.
    pub device: u64,
}

impl Bytes {
    /// More than there ever is.
    pub const MAX: Self = Self { host: u64::MAX, device: u64::MAX };

    /// Whether both are at most those of `room`.
    pub fn fits(self, room: Self) -> bool {
        self.host <= room.host && self.device <= room.device
    }

    pub(crate) fn plus(self, other: Self) -> Self {
        Self { host: self.host.saturating_add(other.host), device: self.device.saturating_add(other.device) }
    }

    pub(crate) fn minus(self, other: Self) -> Self {
        Self { host: self.host.saturating_sub(other.host), device: self.device.saturating_sub(other.device) }
    }
}
