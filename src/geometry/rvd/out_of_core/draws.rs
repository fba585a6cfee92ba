//! Seeds drawn from a surface that is read in windows.
//!
//! Purpose: the points of [`crate::mesh::sample::sample`] without weights, to the bit: all numbers are drawn first, and then the
//! facets are met in the order of what they were drawn for.
//! Invariant: memory goes with the points alone. Must not know: windows, files.

use glam::DVec3;

use crate::mesh::sample::{Draw, draws};

/// Points that wait for their facets.
pub(super) struct Draws {
    /// By the mass before them, the highest first.
    waiting: Vec<(Draw, u32)>,
    points: Vec<DVec3>,
    last: Option<[DVec3; 3]>,
    sum: f64,
}

impl Draws {
    /// Draws for so many points on a surface of this mass.
    pub(super) fn new(count: usize, seed: u64, total: f64) -> Self {
        let mut waiting: Vec<(Draw, u32)> = draws(count, seed, total).zip(0..).collect();
        waiting.sort_unstable_by(|a, b| b.0.target.total_cmp(&a.0.target).then(b.1.cmp(&a.1)));
        Self { waiting, points: vec![DVec3::ZERO; count], last: None, sum: 0.0 }
    }

    /// The next facet, and its mass.
    pub(super) fn meet(&mut self, corners: [DVec3; 3], mass: f64) {
        let before = self.sum;
        self.sum += mass;
        if self.sum > before {
            self.last = Some(corners);
        }
        while let Some((draw, place)) = self.waiting.pop_if(|(draw, _)| draw.target < self.sum) {
            self.points[place as usize] = draw.point(corners);
        }
    }

    /// The points, once all facets were met.
    pub(super) fn finish(mut self) -> Vec<DVec3> {
        // Rounding may leave some beyond the end.
        if let Some(corners) = self.last {
            for (draw, place) in self.waiting.drain(..) {
                self.points[place as usize] = draw.point(corners);
            }
        }
        self.points
    }
}
