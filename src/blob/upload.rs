//! Uploads under way.
//!
//! Purpose: the names of uploads, the check of each chunk, and the table of those that this process knows.
//! Invariant: at most one task changes an upload at a time. An upload that failed halfway through a change is read
//! again from the storage before its next use, so that memory and storage never disagree.
//! Must not know: where the bytes lie, or how much room there is.

use std::collections::HashMap;
use std::fmt;
use std::str::FromStr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, SystemTime};

use bytes::Bytes;
use tokio::sync::OwnedMutexGuard;

use super::digest::{from_hex, to_hex};
use super::staging::Part;
use super::{BlobError, Digest, Owner};

/// The longest chunk that is taken, bytes.
pub const MAX_CHUNK_BYTES: usize = 4 << 20;

/// Of all places for uploads, one owner has at most one in so many.
const SHARE: usize = 4;
/// But so many at least, if there are that many.
const FEW: usize = 8;

/// The length of the chunks that this crate sends, bytes.
pub(super) const CHUNK_BYTES: usize = 1 << 20;

/// The name of an upload: what it promises to become, and whose it is.
///
/// Uploads of one owner with the same promise are the same upload: they continue each other. Uploads of different
/// owners have nothing in common: nobody can spoil another's upload, or learn of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct UploadId {
    digest: Digest,
    size_bytes: u64,
    owner: [u8; 16],
}

impl UploadId {
    /// An upload of the server's own.
    pub const fn new(digest: Digest, size_bytes: u64) -> Self {
        Self { digest, size_bytes, owner: [0; 16] }
    }

    /// The same upload by `owner`: a tenant, for example. Any text will do.
    #[must_use]
    pub fn of(self, owner: &str) -> Self {
        Self { owner: Owner::of(owner).bytes(), ..self }
    }

    /// Whose it is. What the process stores for itself is nobody's, and is not kept out by others' uploads.
    pub fn owner(&self) -> Option<Owner> {
        Owner::from_bytes(self.owner)
    }

    /// Whether it is somebody's.
    pub(super) fn is_owned(&self) -> bool {
        self.owner().is_some()
    }

    /// What it becomes.
    pub const fn digest(&self) -> Digest {
        self.digest
    }

    /// How many bytes it will have.
    pub const fn size_bytes(&self) -> u64 {
        self.size_bytes
    }
}

/// The name under which the parts lie.
impl fmt::Display for UploadId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}-{}-{}", self.digest, self.size_bytes, to_hex(&self.owner))
    }
}

impl FromStr for UploadId {
    type Err = ();

    fn from_str(text: &str) -> Result<Self, ()> {
        let mut words = text.split('-');
        let (Some(digest), Some(size), Some(owner), None) = (words.next(), words.next(), words.next(), words.next())
        else {
            return Err(());
        };
        let size_bytes = size.parse().map_err(|_| ())?;
        let id = Self { digest: digest.parse().map_err(|_| ())?, size_bytes, owner: from_hex(owner).map_err(|_| ())? };
        // One text for each upload: no `+1`, no `01`.
        if id.to_string() == text { Ok(id) } else { Err(()) }
    }
}

/// Consecutive bytes of an upload.
#[derive(Clone, Debug)]
pub struct Chunk {
    /// Where they begin.
    pub offset: u64,
    /// The bytes.
    pub bytes: Bytes,
    /// Their CRC-32C, as the sender computed it.
    pub crc32c: u32,
}

impl Chunk {
    /// A chunk of bytes that are known to be good.
    pub fn new(offset: u64, bytes: Bytes) -> Self {
        let crc32c = crc32c::crc32c(&bytes);
        Self { offset, bytes, crc32c }
    }

    /// Whether the chunk may follow `kept_bytes` bytes of an upload of `size_bytes`.
    ///
    /// # Errors
    /// `ChunkTooLarge`, `WrongOffset`, `PastEnd`, `ChecksumMismatch`.
    pub(super) fn check(&self, kept_bytes: u64, size_bytes: u64) -> Result<(), BlobError> {
        let bytes = self.bytes.len() as u64;
        if self.bytes.len() > MAX_CHUNK_BYTES {
            return Err(BlobError::ChunkTooLarge { bytes, limit_bytes: MAX_CHUNK_BYTES as u64 });
        }
        if self.offset != kept_bytes {
            return Err(BlobError::WrongOffset { expected: kept_bytes, got: self.offset });
        }
        let end = self.offset.saturating_add(bytes);
        if end > size_bytes {
            return Err(BlobError::PastEnd { end, size_bytes });
        }
        let actual = crc32c::crc32c(&self.bytes);
        if actual != self.crc32c {
            return Err(BlobError::ChecksumMismatch { offset: self.offset, expected: self.crc32c, actual });
        }
        Ok(())
    }
}

/// How far an upload is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UploadStatus {
    /// Bytes that are stored; the next chunk begins here.
    pub kept_bytes: u64,
    /// The blob is visible: there is nothing more to send.
    pub complete: bool,
}

/// What this process knows of an upload.
pub(super) enum Slot {
    /// The storage has it; nobody has looked at it yet, or a change failed.
    Kept,
    /// Ready for the next chunk.
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

    /// Waits for the turn to change it.
    pub(super) async fn lock(&self) -> OwnedMutexGuard<Slot> {
        Arc::clone(&self.slot).lock_owned().await
    }

    /// Somebody continued it.
    pub(super) fn touch(&self) {
        *lock(&self.touched) = SystemTime::now();
    }

    /// How long nobody has continued it.
    pub(super) fn idle(&self) -> Duration {
        // A clock that was set back makes an upload younger, not older.
        lock(&self.touched).elapsed().unwrap_or_default()
    }
}

/// The uploads under way.
#[derive(Default)]
pub(super) struct Uploads(Mutex<HashMap<UploadId, Arc<Upload>>>);

impl fmt::Debug for Uploads {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Uploads({})", lock(&self.0).len())
    }
}

impl Uploads {
    /// An upload that the storage kept from an earlier process.
    pub(super) fn found(&self, id: UploadId, touched: SystemTime) {
        lock(&self.0).insert(id, Arc::new(Upload::new(touched)));
    }

    /// An upload, if there is one.
    pub(super) fn get(&self, id: &UploadId) -> Option<Arc<Upload>> {
        lock(&self.0).get(id).cloned()
    }

    /// Adds an upload, locked, unless there is one. One owner has at most a [`SHARE`]th of the places. `admit` hears the bytes
    /// that the owner has promised besides, if there is one. `admit` says whether there is room; it is not asked otherwise.
    ///
    /// # Errors
    /// `TooManyUploads`; those of `admit`.
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
        if id.is_owned() {
            let own = uploads.keys().filter(|other| other.owner == id.owner).count();
            let all = uploads.keys().filter(|other| other.is_owned()).count();
            let share = (limit / SHARE).max(FEW).min(limit);
            if all >= limit || own >= share {
                return Err(BlobError::TooManyUploads { limit: if all >= limit { limit } else { share } });
            }
        }
        let upload = Arc::new(Upload::new(SystemTime::now()));
        // Nobody else has seen it.
        let Ok(slot) = Arc::clone(&upload.slot).try_lock_owned() else { return Ok(None) };
        let own = uploads.keys().filter(|other| other.owner == id.owner).map(|other| other.size_bytes);
        let promised = id.is_owned().then(|| own.fold(0, u64::saturating_add));
        let admitted = admit(promised)?;
        uploads.insert(id, upload);
        Ok(Some((slot, admitted)))
    }

    /// The upload has become a blob or nothing.
    pub(super) fn remove(&self, id: &UploadId, slot: &mut Slot) {
        *slot = Slot::Gone;
        lock(&self.0).remove(id);
    }

    /// Uploads that nobody continued for `time`.
    pub(super) fn idle(&self, time: Duration) -> Vec<UploadId> {
        lock(&self.0).iter().filter(|(_, upload)| upload.idle() >= time).map(|(id, _)| *id).collect()
    }

    /// The upload that nobody continued for the longest, and for `time` at least: one of the owner of `id`, else of anybody.
    pub(super) fn stalest(&self, id: &UploadId, time: Duration) -> Option<UploadId> {
        let uploads = lock(&self.0);
        let idle = uploads
            .iter()
            .map(|(other, upload)| (other, upload.idle()))
            .filter(|(other, idle)| other.is_owned() && *idle >= time);
        let found = idle.max_by_key(|(other, idle)| (other.owner == id.owner, *idle));
        found.map(|(other, _)| *other)
    }

    /// How many.
    pub(super) fn len(&self) -> usize {
        lock(&self.0).len()
    }
}

/// Locks a mutex whose content is never left half changed.
pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
