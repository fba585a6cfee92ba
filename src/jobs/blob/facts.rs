//! What a store tells of its blobs.
//!
//! Purpose: what the interface, the quota and the store of blobs say to each other. Invariant: plain numbers.
//! Must not know: where they come from.

use super::Digest;

/// A blob that is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BlobInfo {
    /// Its name.
    pub digest: Digest,
    /// Its size.
    pub size_bytes: u64,
}

/// What is in use, and what may be.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Usage {
    /// Blobs that are stored.
    pub blobs: usize,
    /// Their bytes.
    pub blob_bytes: u64,
    /// The bytes of those that a pin holds.
    pub pinned_bytes: u64,
    /// Uploads under way.
    pub uploads: usize,
    /// Their promised bytes.
    pub uploading_bytes: u64,
    /// The quota.
    pub limit_bytes: u64,
}
