//! What a session's device is kept busy with.
//!
//! Purpose: [`DeviceWork`] counts what crosses between host and device, [`PhasesMs`] what the device itself says
//! its stages took. Both grow from a session's opening on; a difference of two is what was done between.
//! Invariant: a session on a CPU has neither. Must not know: what a submission is for.

use std::ops::AddAssign;

use serde::Serialize;

/// Counts of what a session had its device do, since it was opened. A device counts for all its users together, so
/// the figures are a session's own only while no other session uses its device.
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
        Self::each(|figure| by(figure(self), figure(other)))
    }

    /// Each figure as `of` makes it.
    pub fn each(of: impl Fn(fn(&Self) -> u64) -> u64) -> Self {
        Self {
            host_searches: of(|w| w.host_searches),
            divided_facets: of(|w| w.divided_facets),
            paired_facets: of(|w| w.paired_facets),
            device_submissions: of(|w| w.device_submissions),
            device_allocations: of(|w| w.device_allocations),
            uploaded_bytes: of(|w| w.uploaded_bytes),
            read_back_bytes: of(|w| w.read_back_bytes),
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
    fn each(of: impl Fn(fn(&Self) -> f64) -> f64) -> Self {
        Self {
            neighbours: of(|p| p.neighbours),
            start: of(|p| p.start),
            clip: of(|p| p.clip),
            update: of(|p| p.update),
        }
    }

    /// Each of `count` that took them together.
    pub fn over(&self, count: f64) -> Self {
        Self::each(|phase| phase(self) / count)
    }

    /// What they took after `before`.
    pub fn since(&self, before: &Self) -> Self {
        Self::each(|phase| phase(self) - phase(before))
    }
}
