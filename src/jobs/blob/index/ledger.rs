//! Which blobs there are, how much room they take, and which go first.
//!
//! Purpose: the bytes in use against the quota, the order of last use, the uploads, the pins and the owners. Pure
//! bookkeeping, no storage. Invariant: after [`Ledger::admit`] succeeded, blobs and promises together are within the quota. A
//! pinned blob is never among the victims. What is refused changes nothing. Forgetting a blob forgets its owners.
//! Must not know: where blobs lie, the names of owners.

use std::collections::{BTreeSet, HashMap, HashSet};
use std::time::SystemTime;

use super::promises::Promises;
use super::rules::{Figures, OwnRoom};
use super::{Published, Room, Stored, Terms, Used};
use crate::blob::chunk::UploadId;
use crate::blob::owners::Owners;
use crate::blob::{BlobError, BlobInfo, Digest, Owner, Usage};

#[derive(Clone, Copy, Debug)]
struct Entry {
    size_bytes: u64,
    /// When it was used last; unique.
    stamp: u64,
    pins: usize,
}

/// What a name holds, and in whose name.
#[derive(Debug, Default)]
struct Pin {
    owner: Option<Owner>,
    held: HashSet<Digest>,
}

#[derive(Debug, Default)]
pub(super) struct Ledger {
    blob_bytes: u64,
    pinned_bytes: u64,
    pub(super) promises: Promises,
    entries: HashMap<Digest, Entry>,
    /// Blobs that no pin holds, the least recently used first.
    unpinned: BTreeSet<(u64, Digest)>,
    pins: HashMap<String, Pin>,
    /// How many pins in an owner's name hold a blob.
    pinned_for: HashMap<(Owner, Digest), usize>,
    owners: Owners,
    /// Blobs that are out of the index while their bytes are still being removed.
    leaving: HashSet<Digest>,
    last_stamp: u64,
}

impl Ledger {
    /// As [`super::BlobIndex::enter`].
    pub(super) fn enter(&mut self, stored: Stored) -> Vec<(Digest, Owner)> {
        for (blob, stamp) in stored.blobs {
            self.found(blob, stamp);
        }
        for (id, touched) in stored.uploads {
            self.promises.enter(id, touched);
        }
        let mut lost = Vec::new();
        for (digest, owner) in stored.owners {
            match self.get(&digest) {
                Some(_) => lost.extend(self.give(&digest, owner).map(|other| (digest, other))),
                None => lost.push((digest, owner)),
            }
        }
        lost
    }

    /// A blob whose bytes are stored, used last at `stamp` (nanoseconds since 1970). The quota is not checked.
    fn found(&mut self, blob: BlobInfo, stamp: u64) {
        let BlobInfo { digest, size_bytes } = blob;
        if self.entries.contains_key(&digest) {
            return;
        }
        self.last_stamp = self.last_stamp.max(stamp);
        self.entries.insert(digest, Entry { size_bytes, stamp, pins: 0 });
        self.unpinned.insert((stamp, digest));
        self.blob_bytes += size_bytes;
    }

    /// A blob whose bytes were seen. Gives whether it is in the index now: one that is being removed is not.
    pub(super) fn seen(&mut self, blob: BlobInfo, stamp: u64) -> bool {
        if self.leaving.contains(&blob.digest) {
            return false;
        }
        self.found(blob, stamp);
        true
    }

    /// The bytes of a blob that was to be removed are gone, or will stay.
    pub(super) fn removed(&mut self, blob: BlobInfo, gone: bool) {
        self.leaving.remove(&blob.digest);
        if !gone {
            self.found(blob, 0);
        }
    }

    pub(super) fn get(&self, digest: &Digest) -> Option<BlobInfo> {
        self.entries.get(digest).map(|entry| BlobInfo { digest: *digest, size_bytes: entry.size_bytes })
    }

    /// The blob is used now.
    pub(super) fn touch(&mut self, digest: &Digest) -> Option<Used> {
        let entry = self.entries.get_mut(digest)?;
        let stamp = next_stamp(&mut self.last_stamp);
        if self.unpinned.remove(&(entry.stamp, *digest)) {
            self.unpinned.insert((stamp, *digest));
        }
        entry.stamp = stamp;
        Some(Used { info: BlobInfo { digest: *digest, size_bytes: entry.size_bytes }, stamp })
    }

    /// As [`super::BlobIndex::admit`].
    pub(super) fn admit(&mut self, id: UploadId, terms: &Terms) -> Result<Option<Room>, BlobError> {
        if self.promises.has(&id) {
            return Ok(None);
        }
        let promised = self.promises.figures(&id);
        let figures = Figures { blob_bytes: self.blob_bytes, pinned_bytes: self.pinned_bytes, ..promised };
        figures.check_place(&id, terms.places)?;
        let own = match (id.owner, terms.own_quota_bytes) {
            (Some(owner), Some(limit_bytes)) => {
                let used_bytes = self.owned_bytes(owner).saturating_add(figures.own_uploading_bytes);
                self.own_room(owner, OwnRoom { needed_bytes: id.size_bytes, used_bytes, limit_bytes })?
            }
            _ => Vec::new(),
        };
        let excess = figures.excess(&id, terms)?;
        let mut room = Room { victims: self.make_room(excess), given_up: Vec::new() };
        self.promises.enter(id, SystemTime::now());
        for digest in own {
            // It may be among the victims by now.
            let Some(owner) = id.owner else { break };
            match self.disown(&digest, owner) {
                Ok(Some(orphan)) => room.victims.push(orphan),
                Ok(None) => room.given_up.push(digest),
                Err(_) => {}
            }
        }
        Ok(Some(room))
    }

    /// An upload that another process began. Errors: `TooManyUploads`.
    pub(super) fn adopt(&mut self, id: UploadId, places: usize) -> Result<(), BlobError> {
        if !self.promises.has(&id) {
            self.promises.figures(&id).check_place(&id, places)?;
            self.promises.enter(id, SystemTime::now());
        }
        Ok(())
    }

    /// Forgets the least recently used blobs until these bytes have gone.
    fn make_room(&mut self, excess_bytes: u64) -> Vec<BlobInfo> {
        let kept_bytes = self.blob_bytes.saturating_sub(excess_bytes);
        let mut victims = Vec::new();
        while self.blob_bytes > kept_bytes {
            let Some(&(_, digest)) = self.unpinned.first() else { break };
            self.leaving.insert(digest);
            victims.extend(self.forget(&digest));
        }
        victims
    }

    /// As [`super::BlobIndex::publish`].
    pub(super) fn publish(&mut self, id: UploadId, pin: Option<&str>) -> Published {
        let digest = id.digest;
        self.promises.end(&id);
        self.leaving.remove(&digest);
        self.found(BlobInfo { digest, size_bytes: id.size_bytes }, 0);
        if let Some(name) = pin {
            self.pin_one(name, digest);
        }
        let stamp = self.touch(&digest).map_or(0, |used| used.stamp);
        Published { stamp, replaced: id.owner.and_then(|owner| self.give(&digest, owner)) }
    }

    /// Removes a blob from the index, pinned or not: its bytes are gone, or soon will be.
    pub(super) fn forget(&mut self, digest: &Digest) -> Option<BlobInfo> {
        let entry = self.entries.remove(digest)?;
        self.owners.forget(digest);
        self.unpinned.remove(&(entry.stamp, *digest));
        self.blob_bytes -= entry.size_bytes;
        if entry.pins > 0 {
            self.pinned_bytes -= entry.size_bytes;
            self.pinned_for.retain(|(_, other), _| other != digest);
            self.pins.retain(|_, pin| {
                pin.held.remove(digest);
                !pin.held.is_empty()
            });
        }
        Some(BlobInfo { digest: *digest, size_bytes: entry.size_bytes })
    }

    /// Removes a blob on request. Errors: `NotFound`, `Pinned`.
    pub(super) fn delete(&mut self, digest: &Digest) -> Result<BlobInfo, BlobError> {
        match self.entries.get(digest) {
            Some(entry) if entry.pins > 0 => Err(BlobError::Pinned { digest: *digest }),
            _ => self.forget(digest).ok_or(BlobError::NotFound { digest: *digest }),
        }
    }

    /// Pins all of `digests`, or none. With an owner, all that `name` pins is pinned in the owner's name. Errors: the first
    /// that is not stored.
    pub(super) fn pin(&mut self, owner: Option<Owner>, name: &str, digests: &[Digest]) -> Result<(), Digest> {
        if let Some(digest) = digests.iter().find(|digest| !self.entries.contains_key(digest)) {
            return Err(*digest);
        }
        for digest in digests {
            self.pin_one(name, *digest);
        }
        if let Some(owner) = owner
            && let Some(pin) = self.pins.get_mut(name).filter(|pin| pin.owner.is_none())
        {
            pin.owner = Some(owner);
            for digest in &pin.held {
                *self.pinned_for.entry((owner, *digest)).or_default() += 1;
            }
        }
        Ok(())
    }

    fn pin_one(&mut self, name: &str, digest: Digest) {
        let Some(entry) = self.entries.get_mut(&digest) else { return };
        let pin = self.pins.entry(name.to_owned()).or_default();
        if !pin.held.insert(digest) {
            return;
        }
        if let Some(owner) = pin.owner {
            *self.pinned_for.entry((owner, digest)).or_default() += 1;
        }
        entry.pins += 1;
        if entry.pins == 1 {
            self.unpinned.remove(&(entry.stamp, digest));
            self.pinned_bytes += entry.size_bytes;
        }
    }

    /// Takes back all pins of `name`. A blob that no other name pins is as old as its last use.
    pub(super) fn unpin(&mut self, name: &str) {
        let Pin { owner, held } = self.pins.remove(name).unwrap_or_default();
        for digest in held {
            if let Some(owner) = owner
                && let Some(count) = self.pinned_for.get_mut(&(owner, digest))
            {
                *count -= 1;
                if *count == 0 {
                    self.pinned_for.remove(&(owner, digest));
                }
            }
            let Some(entry) = self.entries.get_mut(&digest) else { continue };
            entry.pins -= 1;
            if entry.pins == 0 {
                self.unpinned.insert((entry.stamp, digest));
                self.pinned_bytes -= entry.size_bytes;
            }
        }
    }

    /// Whether a blob is stored and the owner has it.
    pub(super) fn has(&self, digest: &Digest, owner: Owner) -> bool {
        self.entries.contains_key(digest) && self.owners.has(digest, owner)
    }

    /// Adds an owner to a blob that is stored. Returns the owner that it replaces, if there were too many.
    pub(super) fn give(&mut self, digest: &Digest, owner: Owner) -> Option<Owner> {
        let size_bytes = self.entries.get(digest)?.size_bytes;
        let pinned_for = &self.pinned_for;
        self.owners.add(*digest, size_bytes, owner, |owner| pinned_for.contains_key(&(owner, *digest)))
    }

    /// Takes a blob from its owner. Returns it if it has no owner left and no pin: it is out of the index then.
    /// Errors: `NotFound`, `Pinned`.
    pub(super) fn disown(&mut self, digest: &Digest, owner: Owner) -> Result<Option<BlobInfo>, BlobError> {
        if !self.has(digest, owner) {
            return Err(BlobError::NotFound { digest: *digest });
        }
        if self.pinned_for.contains_key(&(owner, *digest)) {
            return Err(BlobError::Pinned { digest: *digest });
        }
        self.owners.take(digest, owner);
        let is_needed = self.entries.get(digest).is_some_and(|entry| entry.pins > 0);
        if is_needed || self.owners.has_owner(digest) {
            return Ok(None);
        }
        self.leaving.insert(*digest);
        Ok(self.forget(digest))
    }

    pub(super) fn owned_bytes(&self, owner: Owner) -> u64 {
        self.owners.bytes(owner)
    }

    /// What an owner gives up to have room. Nothing is changed. Errors: `OwnQuotaExceeded`.
    fn own_room(&self, owner: Owner, room: OwnRoom) -> Result<Vec<Digest>, BlobError> {
        if room.excess() == 0 {
            return Ok(Vec::new());
        }
        let held = self.owners.oldest(owner).into_iter();
        room.give_up(held.filter(|(digest, _)| !self.pinned_for.contains_key(&(owner, *digest))))
    }

    /// What is in use. The limit is not known here.
    pub(super) fn usage(&self) -> Usage {
        Usage {
            blobs: self.entries.len(),
            blob_bytes: self.blob_bytes,
            pinned_bytes: self.pinned_bytes,
            uploads: self.promises.count(),
            uploading_bytes: self.promises.bytes(),
            limit_bytes: 0,
        }
    }
}

/// Now in nanoseconds since 1970, later than all stamps before.
fn next_stamp(last: &mut u64) -> u64 {
    let now = SystemTime::UNIX_EPOCH.elapsed().map_or(0, |time| u64::try_from(time.as_nanos()).unwrap_or(u64::MAX));
    *last = now.max(last.saturating_add(1));
    *last
}
