//! The index of one process.
//!
//! Purpose: [`LocalIndex`] is [`BlobIndex`] in memory. What of them must outlive the process is written beside the blobs by
//! the store of blobs, or follows from jobs. Invariant: the lock is held for one call. Must not know: where bytes lie.

use std::sync::Mutex;
use std::time::Duration;

use async_trait::async_trait;

use super::ledger::Ledger;
use super::{BlobIndex, Published, Room, Stored, Terms, Used};
use crate::blob::chunk::UploadId;
use crate::blob::{BlobError, BlobInfo, Digest, Owner, Usage};
use crate::lock;

#[derive(Debug, Default)]
pub struct LocalIndex(Mutex<Ledger>);

impl LocalIndex {
    /// As [`BlobIndex::pin`], at once. Is no use. Errors: the first that is not stored; nothing is pinned then.
    pub(crate) fn hold(&self, owner: Owner, name: &str, digests: &[Digest]) -> Result<(), Digest> {
        lock(&self.0).pin(Some(owner), name, digests)
    }

    /// As [`BlobIndex::unpin`], at once.
    pub(crate) fn release(&self, name: &str) {
        lock(&self.0).unpin(name);
    }
}

#[async_trait]
impl BlobIndex for LocalIndex {
    async fn enter(&self, stored: Stored) -> Result<Vec<(Digest, Owner)>, BlobError> {
        Ok(lock(&self.0).enter(stored))
    }

    async fn admit(&self, upload: UploadId, terms: Terms) -> Result<Option<Room>, BlobError> {
        lock(&self.0).admit(upload, &terms)
    }

    async fn adopt(&self, upload: UploadId, places: usize) -> Result<(), BlobError> {
        lock(&self.0).adopt(upload, places)
    }

    async fn touch_upload(&self, upload: UploadId) -> Result<(), BlobError> {
        lock(&self.0).promises.touch(&upload);
        Ok(())
    }

    async fn end_upload(&self, upload: UploadId) -> Result<(), BlobError> {
        lock(&self.0).promises.end(&upload);
        Ok(())
    }

    async fn idle_time(&self, upload: UploadId) -> Result<Option<Duration>, BlobError> {
        Ok(lock(&self.0).promises.idle_time(&upload))
    }

    async fn idle_uploads(&self, time: Duration) -> Result<Vec<UploadId>, BlobError> {
        Ok(lock(&self.0).promises.idle(time))
    }

    async fn stalest_upload(&self, upload: UploadId, time: Duration) -> Result<Option<UploadId>, BlobError> {
        Ok(lock(&self.0).promises.stalest(&upload, time))
    }

    async fn publish(&self, upload: UploadId, pin: Option<&str>) -> Result<Published, BlobError> {
        Ok(lock(&self.0).publish(upload, pin))
    }

    // Within one process the store of blobs locks the digest.
    async fn showing(&self, _: UploadId) -> Result<(), BlobError> {
        Ok(())
    }

    async fn get(&self, digest: Digest) -> Result<Option<BlobInfo>, BlobError> {
        Ok(lock(&self.0).get(&digest))
    }

    async fn touch(&self, digests: &[Digest]) -> Result<Vec<Option<Used>>, BlobError> {
        let mut ledger = lock(&self.0);
        Ok(digests.iter().map(|digest| ledger.touch(digest)).collect())
    }

    async fn found(&self, blob: BlobInfo, stamp: u64) -> Result<bool, BlobError> {
        Ok(lock(&self.0).seen(blob, stamp))
    }

    async fn forget(&self, digest: Digest) -> Result<Option<BlobInfo>, BlobError> {
        Ok(lock(&self.0).forget(&digest))
    }

    async fn delete(&self, digest: Digest) -> Result<BlobInfo, BlobError> {
        lock(&self.0).delete(&digest)
    }

    async fn removing(&self, blob: BlobInfo) -> Result<bool, BlobError> {
        Ok(lock(&self.0).get(&blob.digest).is_none())
    }

    // What a crash leaves is entered as blobs by the next process.
    async fn left(&self, _: Duration) -> Result<Vec<BlobInfo>, BlobError> {
        Ok(Vec::new())
    }

    async fn removed(&self, blob: BlobInfo, gone: bool) -> Result<(), BlobError> {
        lock(&self.0).removed(blob, gone);
        Ok(())
    }

    async fn pin(&self, owner: Option<Owner>, name: &str, digests: &[Digest]) -> Result<Vec<Used>, BlobError> {
        let mut ledger = lock(&self.0);
        ledger.pin(owner, name, digests).map_err(|digest| BlobError::NotFound { digest })?;
        Ok(digests.iter().filter_map(|digest| ledger.touch(digest)).collect())
    }

    async fn unpin(&self, name: &str) -> Result<(), BlobError> {
        lock(&self.0).unpin(name);
        Ok(())
    }

    async fn has(&self, owner: Owner, digest: Digest) -> Result<bool, BlobError> {
        Ok(lock(&self.0).has(&digest, owner))
    }

    async fn give(&self, owner: Owner, digest: Digest) -> Result<Option<Owner>, BlobError> {
        Ok(lock(&self.0).give(&digest, owner))
    }

    async fn disown(&self, owner: Owner, digest: Digest) -> Result<Option<BlobInfo>, BlobError> {
        lock(&self.0).disown(&digest, owner)
    }

    async fn owned_bytes(&self, owner: Owner) -> Result<u64, BlobError> {
        Ok(lock(&self.0).owned_bytes(owner))
    }

    async fn usage(&self) -> Result<Usage, BlobError> {
        Ok(lock(&self.0).usage())
    }
}
