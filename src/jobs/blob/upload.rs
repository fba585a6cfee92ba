//! Uploads under way.
//!
//! Purpose: the table of the uploads that this process knows. Invariant: at most one task changes an upload at a time. An
//! upload that failed halfway through a change is read again from the storage before its next use, so that memory and
//! storage never disagree. Must not know: where the bytes lie, or how much room there is.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};
use std::time::{Duration, SystemTime};

use tokio::sync::OwnedMutexGuard;

use super::BlobError;
use super::chunk::UploadId;
use super::staging::Part;
use crate::lock;

/// One owner has at most the `SHARE`th part of all places for uploads.
const SHARE: usize = 4;
/// The least that this part is, if there are that many places.
const FEW: usize = 8;

pub(super) enum Slot {
    /// The storage has it; it is to be read before its next use.
    Kept,
    Open(Box<dyn Part>),
    /// Finished or removed; the table has it no more.
    Gone,
}

/// One upload. The slot is locked over each change.
pub(super) struct Upload {
    slot: Arc<tokio::sync::Mutex<Slot>>,
    touched: Mutex<SystemTime>,
}

impl Upload {
    fn new(touched: SystemTime) -> Self {
        Self { slot: Arc::new(tokio::sync::Mutex::new(Slot::Kept)), touched: Mutex::new(touched) }
    }

    pub(super) async fn lock(&self) -> OwnedMutexGuard<Slot> {
        Arc::clone(&self.slot).lock_owned().await
    }

    pub(super) fn touch(&self) {
        *lock(&self.touched) = SystemTime::now();
    }

    pub(super) fn idle(&self) -> Duration {
        // A clock that was set back makes an upload younger, not older.
        lock(&self.touched).elapsed().unwrap_or_default()
    }
}

#[derive(Default)]
pub(super) struct Uploads(Mutex<HashMap<UploadId, Arc<Upload>>>);

impl Uploads {
    /// An upload that the storage kept from an earlier process.
    pub(super) fn found(&self, id: UploadId, touched: SystemTime) {
        lock(&self.0).insert(id, Arc::new(Upload::new(touched)));
    }

    pub(super) fn get(&self, id: &UploadId) -> Option<Arc<Upload>> {
        lock(&self.0).get(id).cloned()
    }

    /// Adds an upload, locked, unless there is one. `admit` gets the bytes that its owner, if it has one, has promised besides,
    /// and decides whether there is room. Errors: `TooManyUploads`; those of `admit`.
    pub(super) fn add<T>(
        &self,
        id: UploadId,
        limit: usize,
        admit: impl FnOnce(Option<u64>) -> Result<T, BlobError>,
    ) -> Result<Option<(OwnedMutexGuard<Slot>, T)>, BlobError> {
        let mut uploads = lock(&self.0);
        if uploads.contains_key(&id) {
            return Ok(None);
        }
        if id.owner.is_some() {
            let own = uploads.keys().filter(|other| other.owner == id.owner).count();
            let all = uploads.keys().filter(|other| other.owner.is_some()).count();
            let share = (limit / SHARE).max(FEW).min(limit);
            if all >= limit || own >= share {
                return Err(BlobError::TooManyUploads { limit: if all >= limit { limit } else { share } });
            }
        }
        let upload = Arc::new(Upload::new(SystemTime::now()));
        // It is new, so the lock is free.
        let Ok(slot) = Arc::clone(&upload.slot).try_lock_owned() else { return Ok(None) };
        let own = uploads.keys().filter(|other| other.owner == id.owner).map(|other| other.size_bytes);
        let promised = id.owner.is_some().then(|| own.fold(0, u64::saturating_add));
        let admitted = admit(promised)?;
        uploads.insert(id, upload);
        Ok(Some((slot, admitted)))
    }

    /// The upload has become a blob or nothing.
    pub(super) fn remove(&self, id: &UploadId, slot: &mut Slot) {
        *slot = Slot::Gone;
        lock(&self.0).remove(id);
    }

    pub(super) fn idle(&self, time: Duration) -> Vec<UploadId> {
        lock(&self.0).iter().filter(|(_, upload)| upload.idle() >= time).map(|(id, _)| *id).collect()
    }

    /// The upload that was idle for the longest, and for `time` at least: one of the owner of `id`, else of any owner.
    pub(super) fn stalest(&self, id: &UploadId, time: Duration) -> Option<UploadId> {
        let uploads = lock(&self.0);
        let idle = uploads
            .iter()
            .map(|(other, upload)| (other, upload.idle()))
            .filter(|(other, idle)| other.owner.is_some() && *idle >= time);
        let found = idle.max_by_key(|(other, idle)| (other.owner == id.owner, *idle));
        found.map(|(other, _)| *other)
    }

    pub(super) fn len(&self) -> usize {
        lock(&self.0).len()
    }
}
