//! What a job needs, and whether it may have that here.
//!
//! Purpose: [`request`] is the way of every job into the queue, that of a stream and that of the store. [`estimate`]
//! predicts memory and time from counts; [`forecast`] finds the counts of a specification. Invariant: nothing is kept or
//! queued here. Must not know: where jobs are kept, how they are done.

pub mod error;
pub mod estimate;
pub mod forecast;

use estimate::{Counts, Need};

use crate::engine::{AdmissionRequest, Engine};

/// The admission request of a tenant's job with these counts and this need.
pub fn request(engine: &Engine, tenant: &str, counts: &Counts, need: &Need) -> AdmissionRequest {
    AdmissionRequest {
        tenant: tenant.into(),
        weight: engine.weights().of(tenant),
        seconds: need.seconds,
        memory: need.memory,
        origin: Some(counts.origin(None)),
        ..AdmissionRequest::default()
    }
}
