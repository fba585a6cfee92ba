//! Where the bytes of uploads lie until they are whole.
//!
//! Purpose: [`Staging`] is one way to keep parts: files that grow ([`Folder`]), memory ([`Memory`]), or the multipart
//! uploads of an object store ([`Multipart`]). Invariant: what a part says it keeps is a prefix of what was appended.
//! Nothing staged is visible as a blob; publishing shows all of it or nothing. Must not know: quotas, pins, or which digest
//! was promised.

mod folder;
mod memory;
mod multipart;

use std::time::SystemTime;

use async_trait::async_trait;
use bytes::Bytes;
use object_store::path::Path;

pub(super) use folder::Folder;
pub(super) use memory::Memory;
pub(super) use multipart::Multipart;

use super::BlobError;
use super::chunk::UploadId;
use super::digest::Tally;

#[async_trait]
pub(super) trait Staging: Send + Sync {
    /// The uploads that an earlier process left, and when each was continued last. Removes what is of no use.
    async fn scan(&self) -> Result<Vec<(UploadId, SystemTime)>, BlobError>;

    /// Begins an upload, with no bytes.
    async fn create(&self, id: UploadId) -> Result<Box<dyn Part>, BlobError>;

    /// What is kept of an upload. `None` if there is nothing of it any more.
    async fn load(&self, id: UploadId) -> Result<Option<Box<dyn Part>>, BlobError>;

    /// Removes what is left of uploads that have ended.
    async fn sweep(&self) -> Result<(), BlobError> {
        Ok(())
    }

    async fn check(&self) -> Result<(), BlobError>;

    /// Removes what is kept of an upload, if anything is.
    async fn discard(&self, id: UploadId) -> Result<(), BlobError>;
}

/// The bytes of one upload. After an error the part is of no use; [`Staging::load`] gives what is kept.
#[async_trait]
pub(super) trait Part: Send + Sync {
    fn tally(&self) -> &Tally;

    /// Whether no other process has continued or ended the upload.
    async fn is_current(&self) -> Result<bool, BlobError> {
        Ok(true)
    }

    /// Adds bytes at the end; `crc32c` was checked.
    async fn append(&mut self, bytes: Bytes, crc32c: u32) -> Result<(), BlobError>;

    /// Makes the bytes durable and shows them at `to`, in place of what is there. The part is empty afterwards.
    async fn publish(&mut self, to: &Path) -> Result<(), BlobError>;
}
