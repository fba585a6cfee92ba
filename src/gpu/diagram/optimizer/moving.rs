//! What is known of the seeds that move.
//!
//! Purpose: the optimizer's buffers, and of which point the device has sums, gradient and totals.
//! Invariant: what is said to be known is on the device. Must not know: stages.

use super::batch::Batch;
use super::history::History;
use crate::buffers::write;
use crate::diagram::context::Context;
use crate::diagram::layout::Totals;
use crate::diagram::memory::{OptimizerBindings, OptimizerBuffers};
use crate::diagram::neighbours::Place;
use crate::diagram::plan::OptimizerPlan;
use geometry::rvd::{RvdError, Together};

/// What is known of the gradient at the present point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Gradient {
    /// Nothing.
    Unknown,
    /// The device has it.
    Known,
    /// And the history has its products.
    WithProducts,
}

/// Whether a step follows a pass at once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Step {
    /// It does not.
    No,
    /// It is to, if the pass ends with its first submission.
    Wanted,
    /// It has.
    Taken,
}

/// What a session has once its seeds are moved.
pub(crate) struct Moving {
    pub buffers: OptimizerBuffers,
    pub(super) bindings: Option<OptimizerBindings>,
    pub(super) held: Vec<bool>,
    pub(super) history: History,
    /// There is a direction.
    pub directed: bool,
    pub(super) gradient: Gradient,
    /// The gradient at the last trial point is known.
    pub(super) trial_gradient_known: bool,
    /// Whose sums the device has.
    pub(super) sums_of: Option<Place>,
    /// Of which point the present pass is, if it ends with totals.
    pub(super) totals_of: Option<Place>,
    /// Whether a step follows the present pass.
    pub step: Step,
    /// How many passes a submission may have.
    pub batch: Batch,
    /// As read last.
    pub totals: Totals,
}

impl Moving {
    pub(super) fn new(cx: &Context, together: Together) -> Result<Self, RvdError> {
        let plan = OptimizerPlan::new(cx.max_seeds as u64, cx.limits())?;
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

    pub(crate) fn hold(&mut self, cx: &Context, held: &[bool]) -> Result<(), RvdError> {
        let words: Vec<u32> = held.iter().map(|&h| u32::from(h)).collect();
        write(&cx.device, &self.buffers.held, 0, &words)?;
        self.held = held.to_vec();
        self.begin_anew();
        Ok(())
    }

    /// There is no direction, no history and no gradient any more.
    pub(super) fn begin_anew(&mut self) {
        self.history.clear();
        self.directed = false;
        self.gradient = Gradient::Unknown;
        self.trial_gradient_known = false;
    }

    /// Whether the present pass ends with totals.
    pub(crate) fn wants_totals(&self) -> bool {
        self.totals_of.is_some()
    }

    /// Whether the device has the sums of the present point.
    pub(crate) fn has_sums(&self) -> bool {
        self.sums_of == Some(Place::Point)
    }

    /// Whether it has its gradient and its sums.
    pub(crate) fn has_gradient_and_sums(&self) -> bool {
        self.gradient != Gradient::Unknown && self.has_sums()
    }

    /// Whether a trial point can be accepted.
    pub(crate) fn has_trial(&self) -> bool {
        self.trial_gradient_known && self.gradient != Gradient::Unknown
    }

    /// A pass at `place` begins.
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
