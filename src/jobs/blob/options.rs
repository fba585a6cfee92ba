//! Options of a blob store.
//!
//! Invariant: the defaults suit a server with a disk of its own. Must not know: what kind of store it is.

use std::time::Duration;

/// How much is kept, and how long.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct BlobOptions {
    /// Blobs and uploads together, bytes.
    pub quota_bytes: u64,
    pub blob_bytes: u64,
    pub uploads: usize,
    pub keep_uploads: Duration,
    /// How long an idle upload keeps its place while others need one.
    pub keep_crowded_uploads: Duration,
    /// Whether the disk must have a blob before it is said to be stored. Without, a loss of power may lose blobs.
    pub fsync: bool,
    /// Bytes of the disk that stay free: for the journal, which must never find it full.
    pub reserve_bytes: u64,
}

impl Default for BlobOptions {
    fn default() -> Self {
        Self {
            quota_bytes: 64 << 30,
            blob_bytes: 16 << 30,
            uploads: 256,
            keep_uploads: Duration::from_secs(24 * 3600),
            // Twice the pause that a client may make between two pieces.
            keep_crowded_uploads: Duration::from_secs(120),
            fsync: true,
            reserve_bytes: 64 << 20,
        }
    }
}

impl BlobOptions {
    geometry::setters! {
        with_quota_bytes(quota_bytes: u64),
        with_blob_bytes(blob_bytes: u64),
        with_uploads(uploads: usize),
        with_keep_uploads(keep_uploads: Duration),
        with_keep_crowded_uploads(keep_crowded_uploads: Duration),
        with_fsync(fsync: bool),
        with_reserve_bytes(reserve_bytes: u64),
    }
}
