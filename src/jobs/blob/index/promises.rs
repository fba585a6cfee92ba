//! Uploads in the index.
//!
//! Purpose: [`Promises`] counts the places and bytes of uploads under way, by owner, and knows when each was continued
//! last. Pure bookkeeping. Invariant: an upload is counted once. Must not know: blobs, quotas, where bytes lie.

use std::collections::HashMap;
use std::time::{Duration, SystemTime};

use super::rules::Figures;
use crate::blob::chunk::UploadId;

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

    /// What uploads have beside this one. Those of the server itself are nobody's.
    pub(super) fn figures(&self, id: &UploadId) -> Figures {
        let mut figures = Figures { uploading_bytes: self.bytes, ..Figures::default() };
        for other in self.touched.keys().filter(|other| other.owner.is_some()) {
            figures.uploads += 1;
            if other.owner == id.owner {
                figures.own_uploads += 1;
                figures.own_uploading_bytes = figures.own_uploading_bytes.saturating_add(other.size_bytes);
            }
        }
        figures
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
