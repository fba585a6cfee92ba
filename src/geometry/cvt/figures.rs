//! Figures of the steps.
//!
//! Purpose: what a report says of each step, of where they end, and of the device meanwhile.
//! Invariant: a name that scripts read does not change. Must not know: why steps were taken.

use serde::Serialize;

use super::Iteration;
use crate::rvd::DeviceWork;

/// What a GPU was kept busy with: nothing on a CPU. A device counts for all its users together.
#[derive(Clone, Copy, Debug, Default, Serialize, PartialEq, Eq)]
pub struct DeviceFigures {
    /// All of the run, from opening the session on.
    #[serde(flatten)]
    pub total: DeviceWork,
    /// Of this, in the iterations.
    pub iterations: DeviceWork,
    /// Figure by figure, the middle of the iterations but the first, which allocates and uploads what the others use.
    pub later_iteration_median: DeviceWork,
    /// The most of them. Where pairs are done again or on the host, seeds and sums are read back.
    pub later_iteration_most: DeviceWork,
}

impl DeviceFigures {
    /// Of a run with these iterations.
    pub fn new(total: DeviceWork, iterations: &[IterationFigures]) -> Self {
        let sum = iterations.iter().fold(DeviceWork::default(), |sum, step| sum.with(&step.device, |a, b| a + b));
        let later: Vec<DeviceWork> = iterations.iter().skip(1).map(|step| step.device).collect();
        let at = |place: fn(usize) -> usize| {
            DeviceWork::each(|figure| {
                let mut all: Vec<u64> = later.iter().map(figure).collect();
                all.sort_unstable();
                all.get(place(all.len())).copied().unwrap_or(0)
            })
        };
        let (later_iteration_median, later_iteration_most) = (at(|n| n / 2), at(|n| n.saturating_sub(1)));
        Self { total, iterations: sum, later_iteration_median, later_iteration_most }
    }
}

/// One step.
#[derive(Clone, Debug, Serialize)]
pub struct IterationFigures {
    /// "lloyd" or "lbfgs".
    pub kind: &'static str,
    /// Before the step, caller's units.
    pub energy: f64,
    /// Over the hexagonal tiling's.
    pub energy_ratio: f64,
    /// ‖∇E‖.
    pub gradient_norm: f64,
    /// Area covered by the pieces that this step saw, caller's units squared.
    pub area: f64,
    /// Passes.
    pub evaluations: usize,
    /// Wall-clock.
    pub ms: f64,
    /// Of which neighbour tables.
    pub neighbours_ms: f64,
    /// Nearest seeds of the facets.
    pub start_ms: f64,
    /// Clipping and summing.
    pub clip_ms: f64,
    /// Results, seeds moved.
    pub update_ms: f64,
    /// What a GPU was kept busy with.
    #[serde(flatten)]
    pub device: DeviceWork,
}

/// The seeds after the last step, before they are put on the surface.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct FinalFigures {
    /// Caller's units.
    pub energy: f64,
    /// Over the hexagonal tiling's.
    pub energy_ratio: f64,
    /// ‖∇E‖.
    pub gradient_norm: f64,
}

impl FinalFigures {
    /// Of the seeds that `present` was taken at.
    pub fn of(present: &Iteration) -> Self {
        let Iteration { energy, energy_ratio, gradient_norm, .. } = *present;
        Self { energy, energy_ratio, gradient_norm }
    }
}

impl IterationFigures {
    /// One step's figures.
    pub fn of(step: &Iteration) -> Self {
        Self {
            kind: step.kind.name(),
            energy: step.energy,
            energy_ratio: step.energy_ratio,
            gradient_norm: step.gradient_norm,
            area: step.area,
            evaluations: step.evaluations,
            ms: step.ms,
            neighbours_ms: step.stats.neighbours_ms,
            start_ms: step.stats.start_ms,
            clip_ms: step.stats.clip_ms,
            update_ms: step.stats.update_ms,
            device: step.stats.device,
        }
    }
}
