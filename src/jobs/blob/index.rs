//! The index of blobs: which are stored, whose they are, what pins them, and how much room is left.
//!
//! Purpose: [`BlobIndex`], which a store of blobs asks before and after it moves bytes. [`LocalIndex`] serves one process.
//! Invariant: each call is one step: other calls see all of it or nothing. An error changes nothing. After
//! [`BlobIndex::admit`], blobs and uploads together are within the quota. A pinned blob is never among those that go.
//! Must not know: where bytes lie, how they get there, jobs.

mod ledger;
mod local;
mod promises;
pub(crate) mod rules;

use std::fmt::Debug;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use async_trait::async_trait;
use serde::{Deserialize, Serialize};

pub use local::LocalIndex;

use super::chunk::UploadId;
use super::{BlobError, BlobInfo, Digest, Owner, Usage};

/// What a storage has when it is opened.
#[derive(Debug, Default)]
pub struct Stored {
    /// Blobs, and when each was used last (nanoseconds since 1970).
    pub blobs: Vec<(BlobInfo, u64)>,
    /// Owners of blobs, the oldest first.
    pub owners: Vec<(Digest, Owner)>,
    /// Uploads, and when each was continued last.
    pub uploads: Vec<(UploadId, SystemTime)>,
}

/// What an upload is admitted under.
#[derive(Clone, Copy, Debug)]
pub struct Terms {
    /// For all blobs and uploads together.
    pub quota_bytes: u64,
    /// Uploads at once, of all owners.
    pub places: usize,
    /// For the blobs and uploads of the upload's owner.
    pub own_quota_bytes: Option<u64>,
}

/// What goes, so that an upload has room.
#[derive(Debug, Default)]
pub struct Room {
    /// Blobs that are out of the index. The caller removes their bytes, then calls [`BlobIndex::removed`].
    pub victims: Vec<BlobInfo>,
    /// Blobs that the upload's owner no longer has. Others have them, or need them.
    pub given_up: Vec<Digest>,
}

/// A blob and the time of its last use, nanoseconds since 1970. No two uses have the same time.
#[derive(Clone, Copy, Debug)]
pub struct Used {
    pub info: BlobInfo,
    pub stamp: u64,
}

#[derive(Clone, Copy, Debug)]
pub struct Published {
    pub stamp: u64,
    /// The owner that lost the blob, because it has too many.
    pub replaced: Option<Owner>,
}

/// How far an upload is in an object store.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Note {
    /// The object store's name of the multipart upload; empty before the first part.
    pub multipart: String,
    /// The object store's names of the parts, in order.
    pub parts: Vec<String>,
    /// The bytes of all parts.
    pub bytes: u64,
    /// The state of the hash after these bytes, as hexadecimal digits; empty before the first part.
    pub hash: String,
}

/// Notes of uploads, from which any process continues them. Every call may fail with `Unavailable` or `Database`; it is unknown then whether
/// the note was changed.
#[async_trait]
pub trait UploadNotes: Send + Sync + Debug {
    /// The note of an upload. `None` if there is no such upload.
    async fn note(&self, upload: UploadId) -> Result<Option<Note>, BlobError>;

    /// Writes the note of an upload that is admitted.
    async fn begin(&self, _: UploadId) -> Result<(), BlobError> {
        Ok(())
    }

    /// Replaces the note `from` by `to`. `false` if the note is another by now: another process has continued or ended the
    /// upload, or is about to show its bytes.
    async fn advance(&self, upload: UploadId, from: &Note, to: &Note) -> Result<bool, BlobError>;

    /// Removes the note of an upload that ends.
    async fn remove(&self, _: UploadId) -> Result<(), BlobError> {
        Ok(())
    }
}

/// See the module's head. Every call may fail with `Unavailable` or `Database`.
#[async_trait]
pub trait BlobIndex: Send + Sync + Debug {
    /// Enters what a storage has. No quota is checked. Gives the owners that count for nothing: their blob is not stored,
    /// or has too many; or the index knew the blob before, without them.
    async fn enter(&self, stored: Stored) -> Result<Vec<(Digest, Owner)>, BlobError>;

    /// Keeps a place and room for a new upload. `None` if the upload is in the index already. To make room, the owner loses
    /// the oldest of its blobs that none of its pins holds, and the least recently used blobs go. An owner may promise a
    /// quarter of the quota in several uploads, and all owners three quarters: the rest is for results. Errors: `TooLarge`,
    /// `QuotaExceeded`, `OwnQuotaExceeded`, `TooManyUploads`.
    async fn admit(&self, upload: UploadId, terms: Terms) -> Result<Option<Room>, BlobError>;

    /// Enters an upload that another process began. Its room is not checked. Errors: `TooManyUploads`; `UploadNotFound` if the
    /// index is that process's too, and has it no more.
    async fn adopt(&self, upload: UploadId, places: usize) -> Result<(), BlobError>;

    /// The notes of uploads in this index, if several processes share it: it then has every upload. Else the notes lie beside the
    /// blobs.
    fn notes(self: Arc<Self>) -> Option<Arc<dyn UploadNotes>> {
        None
    }

    /// The upload is continued now.
    async fn touch_upload(&self, upload: UploadId) -> Result<(), BlobError>;

    /// The upload has become nothing: its place and room are free.
    async fn end_upload(&self, upload: UploadId) -> Result<(), BlobError>;

    /// How long an upload was not continued. `None` if it is not in the index.
    async fn idle_time(&self, upload: UploadId) -> Result<Option<Duration>, BlobError>;

    /// Uploads that were not continued for `time`.
    async fn idle_uploads(&self, time: Duration) -> Result<Vec<UploadId>, BlobError>;

    /// The upload that was idle for the longest, and for `time` at least: one of the owner of `upload`, else of any owner.
    async fn stalest_upload(&self, upload: UploadId, time: Duration) -> Result<Option<UploadId>, BlobError>;

    /// The upload has become a blob, or joined the one that is there. Its owner has the blob now, `pin` holds it, and it is
    /// used.
    async fn publish(&self, upload: UploadId, pin: Option<&str>) -> Result<Published, BlobError>;

    /// The bytes of the upload are about to be shown as the blob's: until it has become a blob or nothing, or for some
    /// minutes, no process removes them. [`BlobIndex::touch_upload`] takes that back. Errors: `UploadNotFound` if another process
    /// ended it; `Unavailable` while another process shows it, or removes the bytes of a blob of the same digest.
    async fn showing(&self, upload: UploadId) -> Result<(), BlobError>;

    async fn get(&self, digest: Digest) -> Result<Option<BlobInfo>, BlobError>;

    /// The blobs are used now. `None` for those that are not stored. An index may leave out a use soon after the one before.
    async fn touch(&self, digests: &[Digest]) -> Result<Vec<Option<Used>>, BlobError>;

    /// Enters a blob whose bytes were found in the storage. Gives whether it is in the index now: one whose bytes are being
    /// removed is not.
    async fn found(&self, blob: BlobInfo, stamp: u64) -> Result<bool, BlobError>;

    /// Takes a blob out, pinned or not: its bytes are gone or wrong.
    async fn forget(&self, digest: Digest) -> Result<Option<BlobInfo>, BlobError>;

    /// Takes a blob out on request. Errors: `NotFound`, `Pinned`.
    async fn delete(&self, digest: Digest) -> Result<BlobInfo, BlobError>;

    /// Whether the caller may remove the bytes of a blob that is out of the index. Not if it has come back or is about to, nor
    /// while another process does so. The caller calls [`BlobIndex::removed`] within some minutes.
    async fn removing(&self, blob: BlobInfo) -> Result<bool, BlobError>;

    /// Blobs that have been out of the index for `time`, and whose bytes no process reported as removed.
    async fn left(&self, time: Duration) -> Result<Vec<BlobInfo>, BlobError>;

    /// Takes out blobs that were not used for `time`, and that no owner and no pin holds. The caller removes their bytes. Ends the pins
    /// of results that no job has before.
    async fn orphans(&self, _: Duration) -> Result<Vec<BlobInfo>, BlobError> {
        Ok(Vec::new())
    }

    /// The bytes of a blob that is out of the index are gone. If not, the blob is back, as the first to go.
    async fn removed(&self, blob: BlobInfo, gone: bool) -> Result<(), BlobError>;

    /// Pins all of `digests` under a name, or none; in the name of an owner, if one is given. They are used now.
    /// Errors: `NotFound`: the first that is not stored.
    async fn pin(&self, owner: Option<Owner>, name: &str, digests: &[Digest]) -> Result<Vec<Used>, BlobError>;

    /// Takes back all pins of a name.
    async fn unpin(&self, name: &str) -> Result<(), BlobError>;

    /// Whether a blob is stored and the owner has it.
    async fn has(&self, owner: Owner, digest: Digest) -> Result<bool, BlobError>;

    /// Adds an owner to a blob that is stored. Gives the owner that it replaces, if there were too many.
    async fn give(&self, owner: Owner, digest: Digest) -> Result<Option<Owner>, BlobError>;

    /// Takes a blob from its owner. Gives it if it has no owner left and no pin: it is out of the index then. Errors:
    /// `NotFound`; `Pinned` if it is pinned in the owner's name.
    async fn disown(&self, owner: Owner, digest: Digest) -> Result<Option<BlobInfo>, BlobError>;

    async fn owned_bytes(&self, owner: Owner) -> Result<u64, BlobError>;

    /// What is in use. The limit is not known here.
    async fn usage(&self) -> Result<Usage, BlobError>;
}
