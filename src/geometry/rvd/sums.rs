//! Sums over cells.
//!
//! Purpose: [`CellSums`], what a pass answers; [`PassStats`], what it did.
//! Invariant: one entry a seed. Must not know: how pieces were made.

use glam::DVec3;

use super::clip;
use super::work::{DeviceWork, PhasesMs};

/// Sums over each restricted cell Ω_i, in the surface's unit frame. All have one entry a seed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CellSums {
    /// ∫ w: the cell's mass.
    pub mass: Vec<f64>,
    /// ∫ w (p - x_i): the first moment about the seed. Centroid = x_i + moment / mass.
    pub moment: Vec<DVec3>,
    /// ∫ w |p - x_i|²: the cell's share of the CVT energy.
    pub energy: Vec<f64>,
    /// ∫ 1: the cell's area, whatever the weights.
    pub area: Vec<f64>,
}

impl CellSums {
    /// Zero for `n` cells, keeping what was allocated.
    pub fn reset(&mut self, n: usize) {
        self.mass.clear();
        self.mass.resize(n, 0.0);
        self.moment.clear();
        self.moment.resize(n, DVec3::ZERO);
        self.energy.clear();
        self.energy.resize(n, 0.0);
        self.area.clear();
        self.area.resize(n, 0.0);
    }

    /// Adds one piece to cell `i`.
    pub fn add(&mut self, i: usize, piece: &clip::Integrals) {
        self.mass[i] += piece.mass;
        self.moment[i] += piece.moment;
        self.energy[i] += piece.energy;
        self.area[i] += piece.area;
    }

    /// Centroid of cell `i` about seed `seed`, or the seed itself if the cell is empty.
    pub fn centroid(&self, i: usize, seed: DVec3) -> DVec3 {
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
    /// Facets whose cells had found them and that were left to propagation, so that the pass began
    /// anew (GPU, [`Strategy::Cell`](super::Strategy::Cell)).
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

/// `stats.uploaded_bytes` is `stats.device.uploaded_bytes`.
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
