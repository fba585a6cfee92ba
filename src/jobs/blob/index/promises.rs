//! Uploads in the index.
//!
//! Purpose: [`Promises`] counts the places and bytes of uploads under way, by owner, and knows when each was continued
//! last. Pure bookkeeping. Invariant: an upload is counted once. Must not know: blobs, quotas, where bytes lie.

use std::collections::HashMap;
use std::time::{Duration, SystemTime};

use crate::blob::BlobError;
use crate::blob::chunk::UploadId;

/// One owner has at most the `SHARE`th part of all places for uploads.
const SHARE: usize = 4;
/// The least that this part is, if there are that many places.
const FEW: usize = 8;

#[derive(Debug, Default)]
pub(super) struct Promises {
    /// When each was continued last.
    touched: HashMap<UploadId, SystemTime>,
    bytes: u64,
}

fn idle_since(touched: SystemTime) -> Duration {
    // A clock that was set back makes an upload younger, not older.
    touched.elapsed().unwrap_or_default()
}

impl Promises {
    pub(super) fn enter(&mut self, id: UploadId, touched: SystemTime) {
        if self.touched.insert(id, touched).is_none() {
            self.bytes = self.bytes.saturating_add(id.size_bytes);
        }
    }

    pub(super) fn end(&mut self, id: &UploadId) {
        if self.touched.remove(id).is_some() {
            self.bytes = self.bytes.saturating_sub(id.size_bytes);
        }
    }

    pub(super) fn has(&self, id: &UploadId) -> bool {
        self.touched.contains_key(id)
    }

    /// Whether one more upload has a place among `limit`. The server's own always have. Errors: `TooManyUploads`.
    pub(super) fn check_place(&self, id: &UploadId, limit: usize) -> Result<(), BlobError> {
        if id.owner.is_none() {
            return Ok(());
        }
        let own = self.touched.keys().filter(|other| other.owner == id.owner).count();
        let all = self.touched.keys().filter(|other| other.owner.is_some()).count();
        let share = (limit / SHARE).max(FEW).min(limit);
        match () {
            () if all >= limit => Err(BlobError::TooManyUploads { limit }),
            () if own >= share => Err(BlobError::TooManyUploads { limit: share }),
            () => Ok(()),
        }
    }

    /// The bytes that the owner of an upload has promised besides; `None` for the server's own.
    pub(super) fn of_owner(&self, id: &UploadId) -> Option<u64> {
        let own = self.touched.keys().filter(|other| other.owner == id.owner).map(|other| other.size_bytes);
        id.owner.is_some().then(|| own.fold(0, u64::saturating_add))
    }

    pub(super) fn touch(&mut self, id: &UploadId) {
        self.touched.entry(*id).and_modify(|touched| *touched = SystemTime::now());
    }

    pub(super) fn idle_time(&self, id: &UploadId) -> Option<Duration> {
        self.touched.get(id).map(|touched| idle_since(*touched))
    }

    pub(super) fn idle(&self, time: Duration) -> Vec<UploadId> {
        self.touched.iter().filter(|(_, touched)| idle_since(**touched) >= time).map(|(id, _)| *id).collect()
    }

    /// As [`super::BlobIndex::stalest_upload`].
    pub(super) fn stalest(&self, id: &UploadId, time: Duration) -> Option<UploadId> {
        let idle = self
            .touched
            .iter()
            .map(|(other, touched)| (other, idle_since(*touched)))
            .filter(|(other, idle)| other.owner.is_some() && *idle >= time);
        let found = idle.max_by_key(|(other, idle)| (other.owner == id.owner, *idle));
        found.map(|(other, _)| *other)
    }

    pub(super) fn count(&self) -> usize {
        self.touched.len()
    }

    pub(super) fn bytes(&self) -> u64 {
        self.bytes
    }
}
