//! What can go wrong with a blob.
//!
//! Purpose: one cause a variant, with what the caller needs to go on.
//! Invariant: after every error the store is as it was before the call, unless the variant says otherwise.
//! Must not know: status codes of any protocol.

use std::error::Error;
use std::io;
use std::path::PathBuf;

use super::Digest;

/// See the module's head.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BlobError {
    /// There is no such blob. It may have been evicted.
    #[error("blob {digest} is not stored; upload it")]
    NotFound {
        /// Which.
        digest: Digest,
    },
    /// There is no such upload, and no blob that it could have become.
    #[error("there is no upload of {digest}; it was never begun, or was removed; begin it again")]
    UploadNotFound {
        /// What it would have become.
        digest: Digest,
    },
    /// The chunk does not begin where the stored bytes end.
    #[error("the chunk begins at {got}, but {expected} bytes are stored; go on from there")]
    WrongOffset {
        /// Where the next chunk must begin.
        expected: u64,
        /// Where it began.
        got: u64,
    },
    /// A chunk is longer than a chunk may be.
    #[error("a chunk of {bytes} bytes is too long; send at most {limit_bytes}")]
    ChunkTooLarge {
        /// Its length.
        bytes: u64,
        /// The longest allowed.
        limit_bytes: u64,
    },
    /// The chunk goes on after the promised end.
    #[error("the chunk ends at {end}, but the upload was begun with a size of {size_bytes} bytes")]
    PastEnd {
        /// Where the chunk would end.
        end: u64,
        /// The promised size.
        size_bytes: u64,
    },
    /// The chunk was damaged on its way. Nothing of it was stored.
    #[error("the chunk at {offset} was damaged on its way (CRC-32C {actual:08x}, not {expected:08x}); send it again")]
    ChecksumMismatch {
        /// Where the chunk begins.
        offset: u64,
        /// What its sender computed.
        expected: u32,
        /// What arrived.
        actual: u32,
    },
    /// Not all bytes are there yet.
    #[error("{kept_bytes} of {size_bytes} bytes are stored; send the rest, then finish")]
    Incomplete {
        /// How many are.
        kept_bytes: u64,
        /// The promised size.
        size_bytes: u64,
    },
    /// The bytes have another digest than was promised. The upload was removed.
    #[error("the bytes have the digest {actual}, not {expected}; the upload was removed, begin it again")]
    DigestMismatch {
        /// What was promised.
        expected: Digest,
        /// What came.
        actual: Digest,
    },
    /// What is stored is not what was uploaded: something else wrote to the storage. The blob was removed, pinned or not.
    #[error(
        "blob {digest} was damaged where it was stored, and was removed; upload it again, or run again the job that made it"
    )]
    Damaged {
        /// Which.
        digest: Digest,
    },
    /// The blob is stored, and has another size.
    #[error("blob {digest} has {actual_bytes} bytes, not {promised_bytes}")]
    WrongSize {
        /// Which.
        digest: Digest,
        /// What was promised.
        promised_bytes: u64,
        /// What it has.
        actual_bytes: u64,
    },
    /// Larger than a blob may ever be here.
    #[error("a blob of {size_bytes} bytes is too large; at most {limit_bytes} bytes are allowed")]
    TooLarge {
        /// Its size.
        size_bytes: u64,
        /// The largest allowed.
        limit_bytes: u64,
    },
    /// No room now, and nothing more that could be evicted.
    #[error(
        "no room for {needed_bytes} more bytes: {used_bytes} of {limit_bytes} are in use, {pinned_bytes} of them needed \
         by jobs and results, {uploading_bytes} by uploads; delete results, or try again later"
    )]
    QuotaExceeded {
        /// What was asked for.
        needed_bytes: u64,
        /// The quota.
        limit_bytes: u64,
        /// Blobs and promised uploads.
        used_bytes: u64,
        /// Blobs that a pin holds.
        pinned_bytes: u64,
        /// Promised sizes of uploads under way.
        uploading_bytes: u64,
    },
    /// The owner has as much as it may have, and nothing of it could go.
    #[error(
        "no room for {needed_bytes} more bytes: {used_bytes} of the {limit_bytes} bytes that this key may have are in use; \
         delete blobs or jobs, or try again later"
    )]
    OwnQuotaExceeded {
        /// What was asked for.
        needed_bytes: u64,
        /// What the owner has.
        used_bytes: u64,
        /// What it may have.
        limit_bytes: u64,
    },
    /// As many uploads are under way as may be.
    #[error("{limit} uploads are under way, as many as may be; try again later")]
    TooManyUploads {
        /// How many may be.
        limit: usize,
    },
    /// The range begins after the end of the blob.
    #[error("the range begins at {offset}, but the blob has {size_bytes} bytes")]
    OutOfRange {
        /// Where it begins.
        offset: u64,
        /// The blob's size.
        size_bytes: u64,
    },
    /// A job or a result needs the blob.
    #[error("blob {digest} is needed by a job or a result; delete that first")]
    Pinned {
        /// Which.
        digest: Digest,
    },
    /// Another process uses the folder.
    #[error("{} is used by another process; stop it, or give another folder", .folder.display())]
    InUse {
        /// Which folder.
        folder: PathBuf,
    },
    /// The disk is full.
    #[error("the disk that holds the blobs is full; free space, or lower the quota")]
    StorageFull,
    /// The storage did not do what it was asked.
    #[error("the blob storage failed: {0}; try again, and look at the server's log if it stays so")]
    Unavailable(String),
}

impl BlobError {
    /// Whether the same call may succeed later without another step by the caller.
    pub const fn is_temporary(&self) -> bool {
        matches!(
            self,
            Self::QuotaExceeded { .. }
                | Self::OwnQuotaExceeded { .. }
                | Self::TooManyUploads { .. }
                | Self::StorageFull
                | Self::Unavailable(_)
        )
    }

    /// Any error of the storage below: full if one of its causes says so.
    pub(super) fn storage(what: &str, error: &(dyn Error + 'static)) -> Self {
        let mut text = format!("{what}: {error}");
        let mut cause: Option<&(dyn Error + 'static)> = Some(error);
        while let Some(error) = cause {
            if let Some(io) = error.downcast_ref::<io::Error>()
                && matches!(io.kind(), io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded)
            {
                return Self::StorageFull;
            }
            let words = error.to_string();
            if !text.contains(&words) {
                text = format!("{text}: {words}");
            }
            cause = error.source();
        }
        Self::Unavailable(text)
    }
}

/// For `map_err`: an error of the file system while doing `what`.
pub(super) fn io(what: &'static str) -> impl Fn(io::Error) -> BlobError {
    move |error| BlobError::storage(what, &error)
}

/// For `map_err`: an error of the object store while doing `what`.
pub(super) fn object(what: &'static str) -> impl Fn(object_store::Error) -> BlobError {
    move |error| BlobError::storage(what, &error)
}

/// The answer of the object store while doing `what`; `None` if it has no such object.
pub(super) fn found<T>(what: &'static str, answer: object_store::Result<T>) -> Result<Option<T>, BlobError> {
    match answer {
        Err(object_store::Error::NotFound { .. }) => Ok(None),
        answer => answer.map(Some).map_err(object(what)),
    }
}

/// For `map_err`: a task that panicked, or that the end of the process cut.
pub(super) fn join(error: tokio::task::JoinError) -> BlobError {
    BlobError::Unavailable(format!("internal error: {error}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_disk_is_told_from_other_faults_however_deep_it_lies() {
        let full = || io::Error::from(io::ErrorKind::StorageFull);
        assert_eq!(BlobError::storage("write", &full()), BlobError::StorageFull);
        let wrapped = object_store::Error::Generic { store: "local", source: Box::new(full()) };
        assert_eq!(BlobError::storage("write", &wrapped), BlobError::StorageFull);
        let other = BlobError::storage("write", &io::Error::from(io::ErrorKind::PermissionDenied));
        assert!(matches!(other, BlobError::Unavailable(text) if text.contains("write: permission denied")));
    }
}
