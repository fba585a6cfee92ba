//! Which blobs there are, how much room they take, and which go first.
//!
//! Purpose: the bytes in use against the quota, the order of last use, and the pins. Pure bookkeeping, no storage.
//! Invariant: after [`Ledger::reserve`] succeeded, blobs and reservations together are within the quota. A pinned
//! blob is never among the victims. A refused reservation changes nothing.
//! Must not know: where blobs lie, or who pins them.

use std::collections::{BTreeSet, HashMap, HashSet};
use std::time::SystemTime;

use super::{BlobError, BlobInfo, Digest};

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

#[derive(Clone, Copy, Debug)]
struct Entry {
    size_bytes: u64,
    /// When it was used last; unique.
    stamp: u64,
    /// How many names pin it.
    pins: usize,
}

/// See the module's head.
#[derive(Debug)]
pub(super) struct Ledger {
    limit_bytes: u64,
    blob_bytes: u64,
    pinned_bytes: u64,
    uploading_bytes: u64,
    entries: HashMap<Digest, Entry>,
    /// Blobs that no pin holds, the least recently used first.
    unpinned: BTreeSet<(u64, Digest)>,
    pins: HashMap<String, HashSet<Digest>>,
    /// Blobs that are out of the books while their bytes are still being removed.
    leaving: HashSet<Digest>,
    last_stamp: u64,
}

impl Ledger {
    /// Nothing stored.
    pub(super) fn new(limit_bytes: u64) -> Self {
        Self {
            limit_bytes,
            blob_bytes: 0,
            pinned_bytes: 0,
            uploading_bytes: 0,
            entries: HashMap::new(),
            unpinned: BTreeSet::new(),
            pins: HashMap::new(),
            leaving: HashSet::new(),
            last_stamp: 0,
        }
    }

    /// A blob that was stored before, used last at `stamp` (nanoseconds since 1970). The quota is not asked.
    pub(super) fn found(&mut self, digest: Digest, size_bytes: u64, stamp: u64) {
        if self.entries.contains_key(&digest) {
            return;
        }
        self.last_stamp = self.last_stamp.max(stamp);
        self.entries.insert(digest, Entry { size_bytes, stamp, pins: 0 });
        self.unpinned.insert((stamp, digest));
        self.blob_bytes += size_bytes;
    }

    /// A blob whose bytes were seen. Says whether it is in the books now: one that is being removed is not.
    pub(super) fn seen(&mut self, digest: Digest, size_bytes: u64, stamp: u64) -> bool {
        if self.leaving.contains(&digest) {
            return false;
        }
        self.found(digest, size_bytes, stamp);
        true
    }

    /// The bytes of a blob that was to be removed are gone, or will stay.
    pub(super) fn left(&mut self, digest: &Digest) {
        self.leaving.remove(digest);
    }

    /// An upload that was kept from before. The quota is not asked.
    pub(super) fn found_upload(&mut self, size_bytes: u64) {
        self.uploading_bytes = self.uploading_bytes.saturating_add(size_bytes);
    }

    /// A blob's size, if it is stored.
    pub(super) fn get(&self, digest: &Digest) -> Option<BlobInfo> {
        self.entries.get(digest).map(|entry| BlobInfo { digest: *digest, size_bytes: entry.size_bytes })
    }

    /// The blob is used now: its size and the stamp of this use.
    pub(super) fn touch(&mut self, digest: &Digest) -> Option<(BlobInfo, u64)> {
        let entry = self.entries.get_mut(digest)?;
        let stamp = next_stamp(&mut self.last_stamp);
        if self.unpinned.remove(&(entry.stamp, *digest)) {
            self.unpinned.insert((stamp, *digest));
        }
        entry.stamp = stamp;
        Some((BlobInfo { digest: *digest, size_bytes: entry.size_bytes }, stamp))
    }

    /// Keeps room for `size_bytes`. The victims are forgotten here; the caller removes their bytes. For somebody who
    /// has promised other bytes already, `own_bytes`, all that is promised stays below a quarter of the room, and for all who
    /// do so below three: the rest is for results.
    ///
    /// # Errors
    /// `TooLarge` if it could never fit, `QuotaExceeded` if it does not fit now.
    pub(super) fn reserve(&mut self, size_bytes: u64, own_bytes: Option<u64>) -> Result<Vec<BlobInfo>, BlobError> {
        if size_bytes > self.limit_bytes {
            return Err(BlobError::TooLarge { size_bytes, limit_bytes: self.limit_bytes });
        }
        let used_bytes = self.blob_bytes.saturating_add(self.uploading_bytes);
        let firm_bytes = self.pinned_bytes.saturating_add(self.uploading_bytes);
        let promised_bytes = self.uploading_bytes.saturating_add(size_bytes);
        let quarter = self.limit_bytes / 4;
        let crowds = size_bytes > 0
            && own_bytes.is_some_and(|own| {
                (own > 0 && own.saturating_add(size_bytes) > quarter)
                    || (self.uploading_bytes > 0 && promised_bytes > 3 * quarter)
            });
        if crowds || firm_bytes.saturating_add(size_bytes) > self.limit_bytes {
            return Err(BlobError::QuotaExceeded {
                needed_bytes: size_bytes,
                limit_bytes: self.limit_bytes,
                used_bytes,
                pinned_bytes: self.pinned_bytes,
                uploading_bytes: self.uploading_bytes,
            });
        }
        let mut victims = Vec::new();
        while self.blob_bytes.saturating_add(self.uploading_bytes).saturating_add(size_bytes) > self.limit_bytes {
            let Some(&(_, digest)) = self.unpinned.first() else { break };
            self.leaving.insert(digest);
            victims.extend(self.forget(&digest));
        }
        self.uploading_bytes += size_bytes;
        Ok(victims)
    }

    /// An upload of `size_bytes` became nothing.
    pub(super) fn release(&mut self, size_bytes: u64) {
        self.uploading_bytes = self.uploading_bytes.saturating_sub(size_bytes);
    }

    /// An upload became a blob, or joined the one that is there. Gives the stamp of this use.
    pub(super) fn publish(&mut self, digest: Digest, size_bytes: u64, pin: Option<&str>) -> u64 {
        self.release(size_bytes);
        self.left(&digest);
        self.found(digest, size_bytes, 0);
        if let Some(name) = pin {
            self.pin_one(name, digest);
        }
        self.touch(&digest).map_or(0, |(_, stamp)| stamp)
    }

    /// Removes a blob from the books, pinned or not: its bytes are gone, or soon will be.
    pub(super) fn forget(&mut self, digest: &Digest) -> Option<BlobInfo> {
        let entry = self.entries.remove(digest)?;
        self.unpinned.remove(&(entry.stamp, *digest));
        self.blob_bytes -= entry.size_bytes;
        if entry.pins > 0 {
            self.pinned_bytes -= entry.size_bytes;
            self.pins.retain(|_, held| {
                held.remove(digest);
                !held.is_empty()
            });
        }
        Some(BlobInfo { digest: *digest, size_bytes: entry.size_bytes })
    }

    /// Removes a blob that somebody asked to delete.
    ///
    /// # Errors
    /// `NotFound`, `Pinned`.
    pub(super) fn delete(&mut self, digest: &Digest) -> Result<BlobInfo, BlobError> {
        match self.entries.get(digest) {
            Some(entry) if entry.pins > 0 => Err(BlobError::Pinned { digest: *digest }),
            _ => self.forget(digest).ok_or(BlobError::NotFound { digest: *digest }),
        }
    }

    /// Pins all of `digests`, or none.
    ///
    /// # Errors
    /// `NotFound`: the first that is not stored.
    pub(super) fn pin(&mut self, name: &str, digests: &[Digest]) -> Result<(), BlobError> {
        if let Some(digest) = digests.iter().find(|digest| !self.entries.contains_key(digest)) {
            return Err(BlobError::NotFound { digest: *digest });
        }
        for digest in digests {
            self.pin_one(name, *digest);
        }
        Ok(())
    }

    fn pin_one(&mut self, name: &str, digest: Digest) {
        let Some(entry) = self.entries.get_mut(&digest) else { return };
        if !self.pins.entry(name.to_owned()).or_default().insert(digest) {
            return;
        }
        entry.pins += 1;
        if entry.pins == 1 {
            self.unpinned.remove(&(entry.stamp, digest));
            self.pinned_bytes += entry.size_bytes;
        }
    }

    /// Takes back all pins of `name`. A blob that no other name pins is as old as its last use.
    pub(super) fn unpin(&mut self, name: &str) {
        for digest in self.pins.remove(name).unwrap_or_default() {
            let Some(entry) = self.entries.get_mut(&digest) else { continue };
            entry.pins -= 1;
            if entry.pins == 0 {
                self.unpinned.insert((entry.stamp, digest));
                self.pinned_bytes -= entry.size_bytes;
            }
        }
    }

    /// What is in use; `uploads` are not counted here.
    pub(super) fn usage(&self) -> Usage {
        Usage {
            blobs: self.entries.len(),
            blob_bytes: self.blob_bytes,
            pinned_bytes: self.pinned_bytes,
            uploads: 0,
            uploading_bytes: self.uploading_bytes,
            limit_bytes: self.limit_bytes,
        }
    }
}

/// Now in nanoseconds since 1970, later than all stamps before.
fn next_stamp(last: &mut u64) -> u64 {
    let now = SystemTime::UNIX_EPOCH.elapsed().map_or(0, |time| u64::try_from(time.as_nanos()).unwrap_or(u64::MAX));
    *last = now.max(last.saturating_add(1));
    *last
}
