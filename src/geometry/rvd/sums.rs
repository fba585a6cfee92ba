//! Sums over cells, and what a pass and its device did.
//!
//! Purpose: what a pass answers, what it did, and what crossed between host and device and took time there.
//! Invariant: sums have one entry a seed. Work and phases grow from a session's opening on; a difference of two is what was done
//! between. A session on a CPU has neither.
//! Must not know: how pieces were made, what passes and submissions are for.

use std::{iter::repeat_n, ops::AddAssign};

use glam::DVec3;
use serde::Serialize;

use super::{clip, refill};
use crate::knn::Point;

/// Sums over each restricted cell Ω_i, in the surface's unit frame. All have one entry a seed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CellSums<P = DVec3> {
    /// ∫ w: the cell's mass.
    pub mass: Vec<f64>,
    /// ∫ w (p - x_i): the first moment about the seed. Centroid = x_i + moment / mass.
    pub moment: Vec<P>,
    /// ∫ w |p - x_i|²: the cell's share of the CVT energy.
    pub energy: Vec<f64>,
    /// ∫ 1: the cell's area, whatever the weights.
    pub area: Vec<f64>,
}

impl<P: Point> CellSums<P> {
    /// Zero for `n` cells, keeping what was allocated.
    pub fn reset(&mut self, n: usize) {
        refill(&mut self.mass, repeat_n(0.0, n));
        refill(&mut self.moment, repeat_n(P::ZERO, n));
        refill(&mut self.energy, repeat_n(0.0, n));
        refill(&mut self.area, repeat_n(0.0, n));
    }

    /// Adds one piece to cell `i`.
    pub fn add(&mut self, i: usize, piece: &clip::Integrals<P>) {
        self.mass[i] += piece.mass;
        self.moment[i] += piece.moment;
        self.energy[i] += piece.energy;
        self.area[i] += piece.area;
    }

    /// Centroid of cell `i` about seed `seed`, or the seed itself if the cell is empty.
    pub fn centroid(&self, i: usize, seed: P) -> P {
        if self.mass[i] > 0.0 { seed + self.moment[i] / self.mass[i] } else { seed }
    }
}

/// What one pass did. Times are wall-clock milliseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PassStats {
    /// Non-empty pieces, i.e. (facet, cell) incidences.
    pub pairs: u64,
    /// Pairs done again because the neighbour table ended.
    pub relaunched_neighbours: u64,
    /// Pairs done again with more polygon slots.
    pub relaunched_polygon: u64,
    /// Pairs done again, or inserted again, with more cell slots for their facet.
    pub relaunched_cells: u64,
    /// Facets that cells had found and left to propagation, so that the pass began anew (GPU, looking by cell).
    pub relaunched_facets: u64,
    /// Pairs that another precision finished (GPU: the f64 path).
    pub f64_finished: u64,
    /// Seeds that lie exactly on an earlier one, and so have an empty cell.
    pub duplicate_seeds: u64,
    /// Neighbour tables: building the tree and querying it.
    pub neighbours_ms: f64,
    /// The nearest seed of every facet.
    pub start_ms: f64,
    /// Clipping and summing.
    pub clip_ms: f64,
    /// Moving results to where the caller reads them.
    pub update_ms: f64,
    /// What the device did; its counts can be read as if they were fields of this.
    pub device: DeviceWork,
}

impl std::ops::Deref for PassStats {
    type Target = DeviceWork;

    fn deref(&self) -> &DeviceWork {
        &self.device
    }
}

impl PassStats {
    /// All pairs that were launched more than once.
    pub fn relaunched(&self) -> u64 {
        self.relaunched_neighbours + self.relaunched_polygon + self.relaunched_cells
    }

    /// Takes what the device says of the phases.
    pub fn set_phases(&mut self, phases: PhasesMs) {
        self.neighbours_ms = phases.neighbours;
        self.start_ms = phases.start;
        self.clip_ms = phases.clip;
        self.update_ms = phases.update;
    }

    /// Adds another pass's figures to these. Of the duplicate seeds it keeps the most that a pass saw.
    pub fn add(&mut self, other: &PassStats) {
        self.pairs += other.pairs;
        self.relaunched_neighbours += other.relaunched_neighbours;
        self.relaunched_polygon += other.relaunched_polygon;
        self.relaunched_cells += other.relaunched_cells;
        self.relaunched_facets += other.relaunched_facets;
        self.f64_finished += other.f64_finished;
        self.duplicate_seeds = self.duplicate_seeds.max(other.duplicate_seeds);
        self.neighbours_ms += other.neighbours_ms;
        self.start_ms += other.start_ms;
        self.clip_ms += other.clip_ms;
        self.update_ms += other.update_ms;
        self.device += other.device;
    }
}

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
