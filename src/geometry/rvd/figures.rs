//! Figures of a diagram: what a report says of the last one and of all passes.
//!
//! Invariant: a name that scripts read does not change. Must not know: what the passes were for.

use serde::Serialize;

use super::dual::Dual;
use super::{PassStats, Surface};

/// The last diagram and what all of them took.
#[derive(Clone, Debug, Default, Serialize)]
pub struct RvdFigures {
    /// Area covered by the pieces, caller's units squared.
    pub area: f64,
    /// (facet, cell) incidences.
    pub pairs: u64,
    /// Pairs launched more than once, all passes.
    pub relaunched_pairs: u64,
    /// Of these, because neighbours ran out.
    pub relaunched_neighbours: u64,
    /// Because polygon slots ran out.
    pub relaunched_polygon: u64,
    /// Because cell slots ran out.
    pub relaunched_cells: u64,
    /// Pairs that the f64 path finished for the GPU, all passes.
    pub f64_finished_pairs: u64,
    /// Cells without surface in the last diagram.
    pub empty_cells: usize,
    /// Seeds that lay exactly on an earlier one, in the pass that had most of them. Their cells are empty.
    pub duplicate_seeds: usize,
    /// Seeds placed again because their cell was empty, all passes.
    pub reseeded_cells: usize,
}

impl RvdFigures {
    /// Adds what one pass had to do again.
    pub fn add_pass(&mut self, stats: &PassStats) {
        self.relaunched_pairs += stats.relaunched();
        self.relaunched_neighbours += stats.relaunched_neighbours;
        self.relaunched_polygon += stats.relaunched_polygon;
        self.relaunched_cells += stats.relaunched_cells;
        self.f64_finished_pairs += stats.f64_finished;
        self.duplicate_seeds = self.duplicate_seeds.max(stats.duplicate_seeds as usize);
    }

    /// Takes the last diagram's figures.
    pub fn of_dual(&mut self, dual: &Dual, surface: &Surface) {
        let scale = surface.frame().scale;
        self.area = dual.area / scale / scale;
        self.pairs = dual.stats.pairs;
        self.empty_cells = dual.empty_cells;
    }
}
