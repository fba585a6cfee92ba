//! The interface to blobs.
//!
//! Purpose: [`BlobStore`] for handlers and jobs; [`put`] stores bytes that are in memory already. Invariant: every call
//! names its upload or blob in full, so that any process that shares the storage can answer it. No call depends on an
//! object that an earlier call returned. Must not know: where the bytes lie.

use std::fmt::Debug;
use std::ops::Range;
use std::time::Duration;

use async_trait::async_trait;
use bytes::Bytes;
use futures_util::stream::BoxStream;

use super::chunk::{CHUNK_BYTES, Chunk, UploadId, UploadStatus};
use super::{BlobError, Digest, Owner};

/// The longest piece that a read gives, bytes.
pub const READ_BYTES: usize = 1 << 20;

/// How much is kept, and how long. The defaults suit a server with a disk of its own.
#[derive(Clone, Copy, Debug)]
pub struct BlobOptions {
    pub quota_bytes: u64,
    pub blob_bytes: u64,
    pub uploads: usize,
    pub keep_uploads: Duration,
    /// How long an idle upload keeps its place while others need one.
    pub keep_crowded_uploads: Duration,
    /// How long a blob stays that no owner and no pin holds, and how long a process has to remove the bytes of one that goes, where
    /// processes share an index.
    pub keep_unneeded: Duration,
    /// Between two looks for objects that such an index lacks.
    pub scan_period: Duration,
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
            keep_unneeded: Duration::from_secs(3600),
            scan_period: Duration::from_secs(24 * 3600),
            fsync: true,
            reserve_bytes: 64 << 20,
        }
    }
}

/// The bytes of a range, in order, in pieces of at most [`READ_BYTES`].
pub type ByteStream = BoxStream<'static, Result<Bytes, BlobError>>;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BlobInfo {
    pub digest: Digest,
    pub size_bytes: u64,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Usage {
    pub blobs: usize,
    pub blob_bytes: u64,
    /// The bytes of those that a pin holds.
    pub pinned_bytes: u64,
    pub uploads: usize,
    /// Their promised bytes.
    pub uploading_bytes: u64,
    pub limit_bytes: u64,
}

/// Reads of whole blobs since the start, by whether the local disk had them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CacheUse {
    pub hits: u64,
    pub misses: u64,
}

pub struct BlobRead {
    pub info: BlobInfo,
    /// What of it comes; within the blob.
    pub range: Range<u64>,
    /// The bytes. Ends early only after an error.
    pub bytes: ByteStream,
}

/// Content-addressed storage with resumable uploads. See the module's head.
///
/// An upload: [`begin`](Self::begin), [`write`](Self::write) at ascending offsets, [`finish`](Self::finish). After a
/// cut connection or a restart, [`upload_status`](Self::upload_status) says where to go on.
///
/// Every call may also fail with `Unavailable`, or with `Database` if the index is in one that does not answer.
#[async_trait]
pub trait BlobStore: Send + Sync + Debug {
    /// Begins an upload or goes on with one. Room for the whole size is kept from here on. Blobs may be evicted.
    ///
    /// If the blob is stored already and the upload's owner has it, the upload is complete. Any other owner sends all
    /// bytes, which proves that it may have them. Errors: `TooLarge`, `QuotaExceeded`, `TooManyUploads`, `WrongSize`,
    /// `StorageFull`.
    async fn begin(&self, upload: UploadId) -> Result<UploadStatus, BlobError> {
        self.begin_within(upload, None).await
    }

    /// As [`begin`](Self::begin), with a quota for the owner's blobs and uploads together. To make room, the owner loses
    /// the oldest of its blobs that none of its jobs needs. Errors: those of [`begin`](Self::begin), and
    /// `OwnQuotaExceeded`.
    async fn begin_within(&self, upload: UploadId, own_limit_bytes: Option<u64>) -> Result<UploadStatus, BlobError>;

    /// Stores the next chunk. Errors: `UploadNotFound`, `WrongOffset`, `ChunkTooLarge`, `PastEnd`, `ChecksumMismatch`,
    /// `StorageFull`.
    async fn write(&self, upload: UploadId, chunk: Chunk) -> Result<UploadStatus, BlobError>;

    /// How many bytes of an upload are stored. Errors: `UploadNotFound`.
    async fn upload_status(&self, upload: UploadId) -> Result<UploadStatus, BlobError>;

    /// Makes the blob visible if all bytes are there and their digest is right. With `pin`, the blob is pinned under this
    /// name before anything can evict it. May be called again after success. Errors: `UploadNotFound`, `Incomplete`,
    /// `StorageFull`; `DigestMismatch`: the upload was removed.
    async fn finish(&self, upload: UploadId, pin: Option<&str>) -> Result<BlobInfo, BlobError>;

    /// Removes an upload and what is stored of it. Errors: `UploadNotFound`.
    async fn abandon(&self, upload: UploadId) -> Result<(), BlobError>;

    /// Reads `range` of a blob; an end after the blob's end means its end. Counts as a use. The stream of a whole blob ends
    /// with `Damaged` if the bytes that are stored have another digest; then the blob is gone, and can be uploaded again.
    /// Errors: `NotFound`, `OutOfRange`.
    async fn read(&self, digest: Digest, range: Range<u64>) -> Result<BlobRead, BlobError>;

    /// Whether a blob is stored, and its size. Is no use. Errors: `NotFound`.
    async fn stat(&self, digest: Digest) -> Result<BlobInfo, BlobError>;

    /// Those of `digests` that are not stored, in order. For the others it counts as a use: they are the last to be
    /// evicted.
    async fn find_missing(&self, digests: &[Digest]) -> Result<Vec<Digest>, BlobError>;

    /// Removes a blob. Errors: `NotFound`, `Pinned`.
    async fn delete(&self, digest: Digest) -> Result<(), BlobError>;

    /// Protects blobs from eviction and deletion, in addition to those that `name` protects already. All or none.
    ///
    /// Pins do not outlive the process: they are set again at start, before the first upload. Errors: `NotFound`.
    async fn pin(&self, name: &str, digests: &[Digest]) -> Result<(), BlobError>;

    /// As [`pin`](Self::pin), in the name of an owner, which cannot delete the blobs meanwhile.
    async fn pin_for(&self, owner: Owner, name: &str, digests: &[Digest]) -> Result<(), BlobError>;

    /// Whether a blob is stored and this owner has it: uploaded it, or was given it by [`claim`](Self::claim). Is no use.
    async fn is_owned(&self, owner: Owner, digest: Digest) -> Result<bool, BlobError>;

    /// As [`find_missing`](Self::find_missing), where only what this owner has counts as stored.
    async fn find_missing_of(&self, owner: Owner, digests: &[Digest]) -> Result<Vec<Digest>, BlobError>;

    /// Gives blobs to an owner too. What is not stored is left out. Errors: `StorageFull`.
    async fn claim(&self, owner: Owner, digests: &[Digest]) -> Result<(), BlobError>;

    /// Takes a blob from its owner. Its bytes go with the last owner, unless they are pinned. Errors: `NotFound` if the
    /// owner does not have it; `Pinned` if it is pinned in the owner's name.
    async fn disown(&self, owner: Owner, digest: Digest) -> Result<(), BlobError>;

    async fn owned_bytes(&self, owner: Owner) -> Result<u64, BlobError>;

    /// Takes back all that `name` protects. A name without pins is no error.
    async fn unpin(&self, name: &str) -> Result<(), BlobError>;

    /// Removes uploads that were idle for too long; returns how many. To be called now and then.
    async fn sweep(&self) -> Result<usize, BlobError>;

    /// Whether something could be stored now. It asks the storage each time. Errors: `StorageFull`.
    async fn check(&self) -> Result<(), BlobError>;

    /// A hint: these are the bytes of a blob that was stored just now, and may be read soon.
    async fn remember(&self, _: Digest, _: &Bytes) {}

    /// How often copies on the local disk were of use.
    fn cache_use(&self) -> CacheUse {
        CacheUse::default()
    }

    /// The quota.
    fn limit_bytes(&self) -> u64;

    async fn usage(&self) -> Result<Usage, BlobError>;
}

/// Stores bytes that are in memory: results, and uploads of streams. `pin` as in [`BlobStore::finish`].
///
/// Two calls with the same bytes at once share the work.
pub async fn put(store: &dyn BlobStore, bytes: Bytes, pin: Option<&str>) -> Result<BlobInfo, BlobError> {
    put_upload(store, None, None, bytes, pin).await
}

/// Stores bytes that are in memory for an owner with a quota of `own_limit_bytes`. Errors: as [`put`], and
/// `OwnQuotaExceeded`.
pub async fn put_of(
    store: &dyn BlobStore,
    owner: &str,
    own_limit_bytes: Option<u64>,
    bytes: Bytes,
) -> Result<BlobInfo, BlobError> {
    put_upload(store, Some(Owner::of(owner)), own_limit_bytes, bytes, None).await
}

async fn put_upload(
    store: &dyn BlobStore,
    owner: Option<Owner>,
    limit: Option<u64>,
    bytes: Bytes,
    pin: Option<&str>,
) -> Result<BlobInfo, BlobError> {
    let hashed = bytes.clone();
    let digest = tokio::task::spawn_blocking(move || Digest::of(&hashed)).await.map_err(super::error::join)?;
    let upload = UploadId { digest, size_bytes: bytes.len() as u64, owner };
    let mut attempts = 0;
    loop {
        match put_once(store, upload, limit, &bytes, pin).await {
            // Another writer of the same upload gave up or went ahead, or the blob was evicted before it could be pinned.
            Err(BlobError::UploadNotFound { .. } | BlobError::Incomplete { .. }) if attempts < 3 => attempts += 1,
            Ok(info) => {
                store.remember(digest, &bytes).await;
                return Ok(info);
            }
            Err(error) => return Err(error),
        }
    }
}

async fn put_once(
    store: &dyn BlobStore,
    upload: UploadId,
    limit: Option<u64>,
    bytes: &Bytes,
    pin: Option<&str>,
) -> Result<BlobInfo, BlobError> {
    let mut status = store.begin_within(upload, limit).await?;
    if status.complete && pin.is_none() {
        return Ok(BlobInfo { digest: upload.digest, size_bytes: upload.size_bytes });
    }
    while !status.complete && status.kept_bytes < upload.size_bytes {
        let start = usize::try_from(status.kept_bytes).unwrap_or(bytes.len()).min(bytes.len());
        let piece = bytes.slice(start..bytes.len().min(start + CHUNK_BYTES));
        status = match store.write(upload, Chunk::new(status.kept_bytes, piece)).await {
            Err(BlobError::WrongOffset { expected, .. }) => UploadStatus { kept_bytes: expected, complete: false },
            result => result?,
        };
    }
    store.finish(upload, pin).await
}
