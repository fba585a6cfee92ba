//! What a job needs, and whether it may have that here.
//!
//! Purpose: [`request`] is the way of every job into the queue, that of a stream and that of the store. [`estimate`]
//! predicts memory and time from counts; [`forecast`] finds the counts of a specification. Invariant: nothing is kept or
//! queued here. Must not know: where jobs are kept, how they are done.

pub mod estimate;
pub mod forecast;

use std::fmt;

use estimate::{Counts, Need};

use crate::JobError;
use crate::blob::BlobError;
use crate::engine::{AdmissionRequest, Engine};
use crate::store::StoreError;

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

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Memory {
    Host,
    Device,
}

impl fmt::Display for Memory {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Host => "of memory",
            Self::Device => "of device memory",
        })
    }
}

/// Why something that a caller wants of jobs was refused or failed.
#[derive(Clone, Debug, thiserror::Error)]
pub enum JobApiError {
    #[error("{field} {problem}")]
    Input { field: String, problem: String },
    #[error("the job needs {needed_bytes} bytes {of}, and this server has {limit_bytes} for a job; ask for less")]
    TooLarge { of: Memory, needed_bytes: u64, limit_bytes: u64 },
    #[error(
        "the facets meet so many cells that the job would take about {seconds} s, and its limit is {limit_seconds} s; give \
         fewer points or a surface without needles and crossing facets, or raise the limit"
    )]
    TooLong { seconds: f64, limit_seconds: f64 },
    #[error("more than {limit_bytes} bytes are packed in the file; unpack it first (gunzip)")]
    Packed { limit_bytes: u64 },
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error(transparent)]
    Blob(#[from] BlobError),
    #[error(transparent)]
    Job(#[from] JobError),
}
