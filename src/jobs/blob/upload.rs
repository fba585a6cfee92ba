//! Uploads that this process works on.
//!
//! Purpose: one lock for each upload under way. Invariant: at most one task changes an upload at a time. An upload that
//! failed halfway through a change is read again from the storage before its next use, so that memory and storage never
//! disagree. Must not know: where the bytes lie, how much room there is, how old an upload is.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};

use tokio::sync::OwnedMutexGuard;

use super::chunk::UploadId;
use super::staging::Part;
use crate::lock;

pub(super) enum Slot {
    /// The storage has it; it is to be read before its next use.
    Kept,
    Open(Box<dyn Part>),
    /// Finished or removed; the table has it no more.
    Gone,
}

/// One upload. The slot is locked over each change.
type Upload = Arc<tokio::sync::Mutex<Slot>>;

#[derive(Default)]
pub(super) struct Uploads(Mutex<HashMap<UploadId, Upload>>);

impl Uploads {
    /// An upload that the storage kept from an earlier process.
    pub(super) fn found(&self, id: UploadId) {
        lock(&self.0).insert(id, Arc::new(tokio::sync::Mutex::new(Slot::Kept)));
    }

    /// Waits for the turn to change an upload. `None` if there is none.
    pub(super) async fn lock(&self, id: &UploadId) -> Option<OwnedMutexGuard<Slot>> {
        let upload = lock(&self.0).get(id).cloned()?;
        Some(upload.lock_owned().await)
    }

    /// Adds an upload, locked. `None` if there is one.
    pub(super) fn add(&self, id: UploadId) -> Option<OwnedMutexGuard<Slot>> {
        let mut uploads = lock(&self.0);
        if uploads.contains_key(&id) {
            return None;
        }
        let upload = Arc::new(tokio::sync::Mutex::new(Slot::Kept));
        // It is new, so the lock is free.
        let slot = Arc::clone(&upload).try_lock_owned().ok()?;
        uploads.insert(id, upload);
        Some(slot)
    }

    pub(super) fn all(&self) -> Vec<UploadId> {
        lock(&self.0).keys().copied().collect()
    }

    /// The upload has become a blob or nothing.
    pub(super) fn remove(&self, id: &UploadId, slot: &mut Slot) {
        *slot = Slot::Gone;
        lock(&self.0).remove(id);
    }
}
