//! The names of uploads, and the pieces in which they come.
//!
//! Purpose: [`UploadId`] says what an upload promises to become; [`Chunk::check`] whether a piece may follow.
//! Invariant: nothing of a chunk that is refused was kept. Must not know: where the bytes lie, how much room there is.

use std::fmt;
use std::str::FromStr;

use bytes::Bytes;

use super::{BlobError, Digest, Owner};

/// The longest chunk that is taken, bytes.
pub const MAX_CHUNK_BYTES: usize = 4 << 20;

/// The length of the chunks that this crate sends, bytes.
pub(super) const CHUNK_BYTES: usize = 1 << 20;

/// The name of an upload: what it promises to become, and whose it is.
///
/// Uploads of one owner with the same promise are the same upload: they continue each other. Uploads of different
/// owners are separate: an owner can neither spoil nor see the uploads of others.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct UploadId {
    pub digest: Digest,
    pub size_bytes: u64,
    /// Its owner. The server's own uploads have none, and are not kept out by uploads of others.
    pub owner: Option<Owner>,
}

impl UploadId {
    /// An upload of the server's own.
    pub const fn new(digest: Digest, size_bytes: u64) -> Self {
        Self { digest, size_bytes, owner: None }
    }

    /// The same upload by `owner`: a tenant, for example. Any text will do.
    #[must_use]
    pub fn of(self, owner: &str) -> Self {
        Self { owner: Some(Owner::of(owner)), ..self }
    }
}

/// Stands for no owner in names of files and in databases.
pub(crate) const NO_OWNER: Owner = Owner([0; 16]);

/// The name under which the parts lie.
impl fmt::Display for UploadId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}-{}-{}", self.digest, self.size_bytes, self.owner.unwrap_or(NO_OWNER))
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
        let owner = Some(owner.parse().map_err(|_| ())?).filter(|owner| *owner != NO_OWNER);
        let id = Self { digest: digest.parse().map_err(|_| ())?, size_bytes, owner };
        // One text for each upload: no `+1`, no `01`.
        if id.to_string() == text { Ok(id) } else { Err(()) }
    }
}

#[derive(Clone, Debug)]
pub struct Chunk {
    pub offset: u64,
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
    /// Errors: `ChunkTooLarge`, `WrongOffset`, `PastEnd`, `ChecksumMismatch`.
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

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UploadStatus {
    /// Bytes that are stored; the next chunk begins here.
    pub kept_bytes: u64,
    /// The blob is visible: there is nothing more to send.
    pub complete: bool,
}
