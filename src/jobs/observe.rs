//! Jobs at work, as others see them.
//!
//! Purpose: [`activity`] counts and traces work; [`preview`] shows the seeds of a job. Invariant: work never waits for an
//! observer. Must not know: queues, stores, how counts are kept.

pub mod activity;
pub mod preview;
