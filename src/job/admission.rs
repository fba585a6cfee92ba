//! What a job needs, and whether it may have that here.
//!
//! Purpose: [`estimate`] predicts memory and time from counts; [`forecast`] finds the counts of a specification. Invariant:
//! nothing is kept or queued here. Must not know: where jobs are kept, how they are done.

pub mod error;
pub(crate) mod estimate;
pub(crate) mod forecast;
