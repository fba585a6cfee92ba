//! What can go wrong with a blob.
//!
//! Purpose: one cause a variant, with what the caller needs to go on. Invariant: after every error the store is as it was
//! before the call, unless the variant says otherwise. Must not know: status codes of any protocol.

use std::error::Error;
use std::io;
use std::path::PathBuf;

use super::Digest;

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BlobError {
    #[error("blob {digest} is not stored; upload it")]
    NotFound { digest: Digest },
    #[error("there is no upload of {digest}; it was never begun, or was removed; begin it again")]
    UploadNotFound { digest: Digest },
    #[error("the chunk begins at {got}, but {expected} bytes are stored; go on from there")]
    WrongOffset { expected: u64, got: u64 },
    #[error("a chunk of {bytes} bytes is too long; send at most {limit_bytes}")]
    ChunkTooLarge { bytes: u64, limit_bytes: u64 },
    #[error("the chunk ends at {end}, but the upload was begun with a size of {size_bytes} bytes")]
    PastEnd { end: u64, size_bytes: u64 },
    #[error("the chunk at {offset} was damaged on its way (CRC-32C {actual:08x}, not {expected:08x}); send it again")]
    ChecksumMismatch { offset: u64, expected: u32, actual: u32 },
    #[error("{kept_bytes} of {size_bytes} bytes are stored; send the rest, then finish")]
    Incomplete { kept_bytes: u64, size_bytes: u64 },
    #[error("the bytes have the digest {actual}, not {expected}; the upload was removed, begin it again")]
    DigestMismatch { expected: Digest, actual: Digest },
    #[error(
        "blob {digest} was damaged where it was stored, and was removed; upload it again, or run again the job that made it"
    )]
    Damaged { digest: Digest },
    #[error("blob {digest} has {actual_bytes} bytes, not {promised_bytes}")]
    WrongSize { digest: Digest, promised_bytes: u64, actual_bytes: u64 },
    #[error("a blob of {size_bytes} bytes is too large; at most {limit_bytes} bytes are allowed")]
    TooLarge { size_bytes: u64, limit_bytes: u64 },
    #[error(
        "no room for {needed_bytes} more bytes: {used_bytes} of {limit_bytes} are in use, {pinned_bytes} of them needed \
         by jobs and results, {uploading_bytes} by uploads; delete results, or try again later"
    )]
    QuotaExceeded { needed_bytes: u64, limit_bytes: u64, used_bytes: u64, pinned_bytes: u64, uploading_bytes: u64 },
    #[error(
        "no room for {needed_bytes} more bytes: {used_bytes} of the {limit_bytes} bytes that this key may have are in use; \
         delete blobs or jobs, or try again later"
    )]
    OwnQuotaExceeded { needed_bytes: u64, used_bytes: u64, limit_bytes: u64 },
    #[error("{limit} uploads are under way, as many as may be; try again later")]
    TooManyUploads { limit: usize },
    #[error("the range begins at {offset}, but the blob has {size_bytes} bytes")]
    OutOfRange { offset: u64, size_bytes: u64 },
    #[error("blob {digest} is needed by a job or a result; delete that first")]
    Pinned { digest: Digest },
    #[error("{} is used by another process; stop it, or give another folder", .folder.display())]
    InUse { folder: PathBuf },
    #[error("the disk that holds the blobs is full; free space, or lower the quota")]
    StorageFull,
    #[error("the blob storage failed: {0}; try again, and look at the server's log if it stays so")]
    Unavailable(String),
    #[error("another server stores or removes blob {digest}; try again")]
    Busy { digest: Digest },
    #[error("the database does not answer: {0}; try again, and look at the server's log if it stays so")]
    Database(String),
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
                | Self::Database(_)
                | Self::Busy { .. }
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
