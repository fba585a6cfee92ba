//! Windows of facets.
//!
//! Purpose: where the buffers of all facets would be larger than what a shader can see of one, facets go by
//! windows of neighbouring ones: each has its records and first cells, and all take turns with the sets of cells
//! and the list of pairs. The seeds' buffers and their sums are shared.
//! Invariant: facets have their own numbers everywhere; only where a record or a first cell lies is counted from
//! the window's beginning. Sums are integers, so windows change no bit. With more than one window no facet is found by cell.
//! Must not know: what a window is clipped by.

use std::ops::Range;

use crate::diagram::plan::{self, Need, Window};
use crate::limits::Limits;

/// Pairs that the list has room for beside those that are expected.
const SPARE_PAIRS: f64 = 1024.0;

/// What decides how facets lie on the device. Capacities grow, and stay for the life of the session.
pub(crate) struct Windows {
    /// Cells that each facet is expected to meet.
    expected: Vec<f32>,
    /// Pairs that there is room for, for each that is expected.
    pairs_per_cell: f64,
    /// What that has grown by.
    grown: f64,
    /// By facet; never empty.
    pub all: Vec<Window>,
    /// The window at work.
    pub present: usize,
}

impl Windows {
    /// For facets that are expected to meet these numbers of cells, with room for `pairs_per_cell` pairs for each.
    pub(crate) fn new(expected: &[f64], pairs_per_cell: f64) -> Self {
        let all = Window { facets: 0..expected.len() as u32, slots: 0, pairs: 0 };
        Self {
            expected: expected.iter().map(|&e| e as f32).collect(),
            pairs_per_cell,
            grown: 1.0,
            all: vec![all],
            present: 0,
        }
    }

    pub(crate) fn facets(&self) -> Range<u32> {
        self.all.get(self.present).map_or(0..0, |w| w.facets.clone())
    }

    /// The window at work is the last one.
    pub(crate) fn is_last(&self) -> bool {
        self.present + 1 >= self.all.len()
    }

    pub(crate) fn window_of(&self, facet: u32) -> usize {
        self.all.partition_point(|w| w.facets.end <= facet).min(self.all.len() - 1)
    }

    /// Cuts the facets anew, for sets of cells of these sizes.
    pub(crate) fn cut(&mut self, slots_log2: &[u8], limits: Limits) {
        let (expected, per_cell) = (&self.expected, self.pairs_per_cell * self.grown);
        let need = |(&e, &log2): (&f32, &u8)| Need { slots: 1 << log2, pairs: per_cell * f64::from(e) };
        self.all = plan::windows(expected.iter().zip(slots_log2).map(need), self.spare(), limits);
        self.present = 0;
    }

    /// Pairs that the list has room for beside those that are expected.
    pub(crate) fn spare(&self) -> u64 {
        (SPARE_PAIRS * self.grown) as u64
    }

    /// Makes room for `needed` times as many pairs, and twice as many at least.
    pub(crate) fn grow(&mut self, needed: f64) {
        self.grown *= needed.max(2.0);
    }
}
