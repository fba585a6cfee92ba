//! What is admitted.
//!
//! Purpose: [`Figures`] says whether an upload has a place and room, and how much has to go for it. Every index decides by it.
//! Pure arithmetic. Must not know: which blobs go, where the figures come from.

use super::Terms;
use crate::blob::chunk::UploadId;
use crate::blob::{BlobError, Digest};

/// One owner has at most the `SHARE`th part of all places for uploads.
const SHARE: usize = 4;
/// The least that this part is, if there are that many places.
const FEW: usize = 8;

/// What is in use when an upload asks for room.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Figures {
    /// Uploads that have an owner.
    pub(crate) uploads: usize,
    /// Uploads of the upload's owner, and their bytes.
    pub(crate) own_uploads: usize,
    pub(crate) own_uploading_bytes: u64,
    pub(crate) uploading_bytes: u64,
    pub(crate) blob_bytes: u64,
    pub(crate) pinned_bytes: u64,
}

impl Figures {
    /// Whether one more upload has a place among `places`. The server's own always have. Errors: `TooManyUploads`.
    pub(crate) fn check_place(&self, id: &UploadId, places: usize) -> Result<(), BlobError> {
        let share = (places / SHARE).max(FEW).min(places);
        match () {
            () if id.owner.is_none() => Ok(()),
            () if self.uploads >= places => Err(BlobError::TooManyUploads { limit: places }),
            () if self.own_uploads >= share => Err(BlobError::TooManyUploads { limit: share }),
            () => Ok(()),
        }
    }

    /// Bytes of unpinned blobs that have to go so that the upload has room. Errors: `TooLarge` if it could never fit,
    /// `QuotaExceeded` if it does not fit now.
    pub(crate) fn excess(&self, id: &UploadId, terms: &Terms) -> Result<u64, BlobError> {
        let (size_bytes, limit_bytes) = (id.size_bytes, terms.quota_bytes);
        if size_bytes > limit_bytes {
            return Err(BlobError::TooLarge { size_bytes, limit_bytes });
        }
        let promised_bytes = self.uploading_bytes.saturating_add(size_bytes);
        let quarter = limit_bytes / 4;
        let crowds = size_bytes > 0
            && id.owner.is_some()
            && ((self.own_uploading_bytes > 0 && self.own_uploading_bytes.saturating_add(size_bytes) > quarter)
                || (self.uploading_bytes > 0 && promised_bytes > 3 * quarter));
        if crowds || self.pinned_bytes.saturating_add(promised_bytes) > limit_bytes {
            return Err(self.full(id, terms));
        }
        Ok(self.blob_bytes.saturating_add(promised_bytes).saturating_sub(limit_bytes))
    }

    pub(crate) fn full(&self, id: &UploadId, terms: &Terms) -> BlobError {
        BlobError::QuotaExceeded {
            needed_bytes: id.size_bytes,
            limit_bytes: terms.quota_bytes,
            used_bytes: self.blob_bytes.saturating_add(self.uploading_bytes),
            pinned_bytes: self.pinned_bytes,
            uploading_bytes: self.uploading_bytes,
        }
    }
}

/// An owner's room for one more upload.
#[derive(Clone, Copy, Debug)]
pub(crate) struct OwnRoom {
    pub(crate) needed_bytes: u64,
    /// Its blobs and uploads.
    pub(crate) used_bytes: u64,
    pub(crate) limit_bytes: u64,
}

impl OwnRoom {
    /// Bytes that the owner has to give up.
    pub(crate) fn excess(&self) -> u64 {
        self.used_bytes.saturating_add(self.needed_bytes).saturating_sub(self.limit_bytes)
    }

    /// What the owner gives up of its blobs that none of its pins holds, the longest held first. Errors: `OwnQuotaExceeded`.
    pub(crate) fn give_up(&self, held: impl IntoIterator<Item = (Digest, u64)>) -> Result<Vec<Digest>, BlobError> {
        let (mut excess, mut given_up) = (self.excess(), Vec::new());
        for (digest, size) in held {
            if excess == 0 {
                break;
            }
            if size > 0 {
                given_up.push(digest);
                excess = excess.saturating_sub(size);
            }
        }
        let Self { needed_bytes, used_bytes, limit_bytes } = *self;
        match excess {
            0 => Ok(given_up),
            _ => Err(BlobError::OwnQuotaExceeded { needed_bytes, used_bytes, limit_bytes }),
        }
    }
}
