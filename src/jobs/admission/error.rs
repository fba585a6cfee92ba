//! Why something that a caller wants of jobs is refused or fails.
//!
//! Purpose: [`JobApiError`]. Invariant: each cause is one that a caller can act on. Must not know: how errors are worded
//! over the wire.

use std::fmt;

use crate::JobError;
use crate::blob::BlobError;
use crate::store::StoreError;

/// A memory that jobs share.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Memory {
    /// The process's.
    Host,
    /// The device's.
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
    /// The specification does not fit what its blobs hold, or what this server takes.
    #[error("{field} {problem}")]
    Input {
        /// Where in the request.
        field: String,
        /// What is wrong, and what to give instead.
        problem: String,
    },
    /// The job could never run here.
    #[error("the job needs {needed_bytes} bytes {of}, and this server has {limit_bytes} for a job; ask for less")]
    TooLarge {
        /// Of which memory.
        of: Memory,
        /// What it needs.
        needed_bytes: u64,
        /// What there is.
        limit_bytes: u64,
    },
    /// More is packed in the surface's file than may be in one of its size.
    #[error("more than {limit_bytes} bytes are packed in the file; unpack it first (gunzip)")]
    Packed {
        /// What may be.
        limit_bytes: u64,
    },
    /// The store of jobs refused or failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The store of blobs refused or failed.
    #[error(transparent)]
    Blob(#[from] BlobError),
    /// The queue refused or failed.
    #[error(transparent)]
    Job(#[from] JobError),
}
