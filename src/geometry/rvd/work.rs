//! What a session's device is kept busy with.
//!
//! Purpose: [`DeviceWork`] counts what crosses between host and device, [`PhasesMs`] what the device itself says
//! its stages took. Both grow from a session's opening on; a difference of two is what was done between.
//! Invariant: a session on a CPU has neither. Must not know: what a submission is for.

use std::ops::AddAssign;

use serde::Serialize;

/// Counts of what a session had its device do, since it was opened. A device counts for all its users together, so
/// the figures are a session's own only while nobody else uses its device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct DeviceWork {
    /// Passes whose rows of neighbours or first cells the host made.
    pub host_searches: u64,
    /// Facets that the device divided among their cells at once, of all passes that add up.
    pub divided_facets: u64,
    /// Facets that it, or the host, went through pair by pair.
    pub paired_facets: u64,
    /// Command buffers handed to the device.
    pub device_submissions: u64,
    /// Buffers allocated on the device.
    pub device_allocations: u64,
    /// Bytes written to the device.
    pub uploaded_bytes: u64,
    /// Bytes read back from it.
    pub read_back_bytes: u64,
}

impl DeviceWork {
    /// What was done after `before`.
    pub fn since(&self, before: &Self) -> Self {
        self.with(before, |now, before| now - before)
    }

    /// Figure by figure, what `by` makes of these and `other`.
    pub fn with(&self, other: &Self, by: impl Fn(u64, u64) -> u64) -> Self {
        Self {
            host_searches: by(self.host_searches, other.host_searches),
            divided_facets: by(self.divided_facets, other.divided_facets),
            paired_facets: by(self.paired_facets, other.paired_facets),
            device_submissions: by(self.device_submissions, other.device_submissions),
            device_allocations: by(self.device_allocations, other.device_allocations),
            uploaded_bytes: by(self.uploaded_bytes, other.uploaded_bytes),
            read_back_bytes: by(self.read_back_bytes, other.read_back_bytes),
        }
    }
}

impl AddAssign for DeviceWork {
    fn add_assign(&mut self, more: Self) {
        *self = self.with(&more, |a, b| a + b);
    }
}

/// Milliseconds by the device's own clock, since it was told to keep time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PhasesMs {
    /// Rows of neighbours.
    pub neighbours: f64,
    /// First cells of the facets.
    pub start: f64,
    /// Clipping and summing.
    pub clip: f64,
    /// Figures, gradients, directions, seeds moved.
    pub update: f64,
}

impl PhasesMs {
    /// Each of `count` that took them together.
    pub fn over(&self, count: f64) -> Self {
        let Self { neighbours, start, clip, update } = *self;
        Self { neighbours: neighbours / count, start: start / count, clip: clip / count, update: update / count }
    }

    /// What they took after `before`.
    pub fn since(&self, before: &Self) -> Self {
        Self {
            neighbours: self.neighbours - before.neighbours,
            start: self.start - before.start,
            clip: self.clip - before.clip,
            update: self.update - before.update,
        }
    }
}
