//! What is known of the seeds that move.
//!
//! Purpose: the optimizer's buffers, and of which point the device has sums, gradient and totals. [`Batch`] says how many passes
//! one submission may have: twice as many each time, as long as passes need nothing of the host and do not take too long.
//! Invariant: what is said to be known is on the device. One pass a submission after a pass that needed the host.
//! Must not know: stages.

use super::history::History;
use crate::buffers::write;
use crate::diagram::layout::Totals;
use crate::diagram::memory::{OptimizerBindings, OptimizerBuffers};
use crate::diagram::neighbours::Place;
use crate::diagram::plan::{Moved, OptimizerPlan, PASSES};
use crate::diagram::space::DeviceSpace;
use crate::diagram::{Context, Result};
use geometry::rvd::Together;

/// What is known of the gradient at the present point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Gradient {
    Unknown,
    /// The device has it.
    Known,
    /// And the history has its products.
    WithProducts,
}

/// Whether a step follows a pass at once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Step {
    No,
    /// It is to, if the pass ends with its first submission.
    Wanted,
    Taken,
}

/// What a session has once its seeds are moved.
pub(crate) struct Moving {
    pub buffers: OptimizerBuffers,
    pub(super) bindings: Option<OptimizerBindings>,
    pub(super) held: Vec<bool>,
    pub(super) history: History,
    pub directed: bool,
    pub(super) gradient: Gradient,
    pub(super) trial_gradient_known: bool,
    /// Whose sums the device has.
    pub(super) sums_of: Option<Place>,
    /// Of which point the present pass is, if it ends with totals.
    pub(super) totals_of: Option<Place>,
    pub step: Step,
    pub batch: Batch,
    /// As read last.
    pub totals: Totals,
}

impl Moving {
    pub(super) fn new<P: DeviceSpace>(cx: &Context<P>, seeds: u64, together: Together) -> Result<Self> {
        let plan = OptimizerPlan::new(Moved { lifted: !P::IS_PLACE, seeds }, cx.limits())?;
        Ok(Self {
            buffers: OptimizerBuffers::new(&cx.device, plan)?,
            bindings: None,
            held: Vec::new(),
            history: History::default(),
            directed: false,
            gradient: Gradient::Unknown,
            trial_gradient_known: false,
            sums_of: None,
            totals_of: None,
            step: Step::No,
            batch: Batch::new(together),
            totals: Totals::default(),
        })
    }

    pub(crate) fn hold<P: DeviceSpace>(&mut self, cx: &Context<P>, held: &[bool]) -> Result<()> {
        let words: Vec<u32> = held.iter().map(|&h| u32::from(h)).collect();
        write(&cx.device, &self.buffers.held, 0, &words)?;
        self.held = held.to_vec();
        self.begin_anew();
        Ok(())
    }

    pub(super) fn begin_anew(&mut self) {
        self.history.clear();
        self.directed = false;
        self.gradient = Gradient::Unknown;
        self.trial_gradient_known = false;
    }

    pub(crate) fn wants_totals(&self) -> bool {
        self.totals_of.is_some()
    }

    /// Whether the device has the sums of the present point.
    pub(crate) fn has_sums(&self) -> bool {
        self.sums_of == Some(Place::Point)
    }

    pub(crate) fn has_gradient_and_sums(&self) -> bool {
        self.gradient != Gradient::Unknown && self.has_sums()
    }

    pub(crate) fn has_trial(&self) -> bool {
        self.trial_gradient_known && self.gradient != Gradient::Unknown
    }

    pub(crate) fn begin_pass(&mut self, place: Place) {
        self.sums_of = None;
        if place == Place::Point {
            self.gradient = Gradient::Unknown;
        }
        self.trial_gradient_known = false;
        self.totals_of = Some(place);
    }

    /// The pass has ended, well or not.
    pub(crate) fn end_pass(&mut self) {
        self.totals_of = None;
    }

    /// It was done to its end at `place`.
    pub(crate) fn pass_done(&mut self, place: Place) {
        self.sums_of = Some(place);
        match place {
            Place::Point => self.gradient = Gradient::Known,
            _ => self.trial_gradient_known = true,
        }
    }
}

/// A submission of several passes is not to take longer, by what the last ones took.
const SUBMISSION_MS: f64 = 100.0;

/// Learns how many passes a submission may have.
pub(crate) struct Batch {
    /// Passes of the next submission.
    pub count: usize,
    by: Together,
}

impl Batch {
    pub(crate) fn new(by: Together) -> Self {
        Self { count: 1, by }
    }

    /// `taken` passes out of `tried` were clean, in `ms` altogether: twice as many next time, or one.
    pub(crate) fn learn(&mut self, tried: usize, taken: usize, ms: f64) {
        let most = match self.by {
            Together::ByTime => (SUBMISSION_MS * taken as f64 / ms.max(1e-3)) as usize,
            Together::AtMost(most) => most,
        };
        self.count = if taken < tried { 1 } else { (2 * tried).max(self.count).min(most).clamp(1, PASSES) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clean_passes_double_within_the_time_and_others_begin_anew() {
        let mut together = Batch::new(Together::ByTime);
        let mut seen = Vec::new();
        for _ in 0..7 {
            seen.push(together.count);
            together.learn(together.count, together.count, 1.0);
        }
        assert_eq!(seen, [1, 2, 4, 8, 16, 32, 32]);
        together.learn(32, 3, 10.0);
        assert_eq!(together.count, 1);
        together.learn(1, 1, 20.0);
        together.learn(2, 2, 40.0);
        together.learn(4, 4, 80.0);
        assert_eq!(together.count, 5);
        // Fewer than might have been.
        together.learn(3, 3, 6.0);
        assert_eq!(together.count, 6);
        together.learn(1, 1, 500.0);
        assert_eq!(together.count, 1);
        let mut together = Batch::new(Together::AtMost(4));
        for count in [1, 2, 4, 4] {
            assert_eq!(together.count, count);
            together.learn(count, count, 1e6);
        }
        together.learn(4, 3, 1.0);
        assert_eq!(together.count, 1);
    }
}
