//! The index of blobs in the database.
//!
//! Purpose: [`PostgresIndex`] is [`BlobIndex`] for several processes. Must not know: where bytes lie, jobs.

use std::time::Duration;

use async_trait::async_trait;

use super::pool::Database;
use crate::blob::index::{BlobIndex, Published, Room, Stored, Terms, Used};
use crate::blob::{BlobError, BlobInfo, Digest, Owner, UploadId, Usage};

#[derive(Debug)]
pub(super) struct PostgresIndex {
    database: Database,
}

impl PostgresIndex {
    pub(super) fn new(database: Database) -> Self {
        Self { database }
    }
}

fn later<T>() -> Result<T, BlobError> {
    Err(BlobError::Unavailable("the index of blobs is not in the database yet".to_owned()))
}

#[async_trait]
impl BlobIndex for PostgresIndex {
    async fn enter(&self, stored: Stored) -> Result<Vec<(Digest, Owner)>, BlobError> {
        for (blob, used) in stored.blobs {
            sqlx::query("insert into tessera.blobs (digest, size, used) values ($1, $2, $3) on conflict do nothing")
                .bind(blob.digest.as_bytes().as_slice())
                .bind(i64::try_from(blob.size_bytes).unwrap_or(i64::MAX))
                .bind(i64::try_from(used).unwrap_or(i64::MAX))
                .execute(self.database.pool())
                .await?;
        }
        Ok(Vec::new())
    }

    async fn admit(&self, _: UploadId, _: Terms) -> Result<Option<Room>, BlobError> {
        later()
    }

    async fn adopt(&self, _: UploadId, _: usize) -> Result<(), BlobError> {
        later()
    }

    async fn touch_upload(&self, _: UploadId) -> Result<(), BlobError> {
        later()
    }

    async fn end_upload(&self, _: UploadId) -> Result<(), BlobError> {
        later()
    }

    async fn idle_time(&self, _: UploadId) -> Result<Option<Duration>, BlobError> {
        later()
    }

    async fn idle_uploads(&self, _: Duration) -> Result<Vec<UploadId>, BlobError> {
        later()
    }

    async fn stalest_upload(&self, _: UploadId, _: Duration) -> Result<Option<UploadId>, BlobError> {
        later()
    }

    async fn publish(&self, _: UploadId, _: Option<&str>) -> Result<Published, BlobError> {
        later()
    }

    async fn get(&self, _: Digest) -> Result<Option<BlobInfo>, BlobError> {
        later()
    }

    async fn touch(&self, _: &[Digest]) -> Result<Vec<Option<Used>>, BlobError> {
        later()
    }

    async fn found(&self, _: BlobInfo, _: u64) -> Result<bool, BlobError> {
        later()
    }

    async fn forget(&self, _: Digest) -> Result<Option<BlobInfo>, BlobError> {
        later()
    }

    async fn delete(&self, _: Digest) -> Result<BlobInfo, BlobError> {
        later()
    }

    async fn removed(&self, _: BlobInfo, _: bool) -> Result<(), BlobError> {
        later()
    }

    async fn pin(&self, owner: Option<Owner>, name: &str, digests: &[Digest]) -> Result<Vec<Used>, BlobError> {
        for digest in digests {
            sqlx::query("insert into tessera.pins (name, digest, owner) values ($1, $2, $3) on conflict do nothing")
                .bind(name)
                .bind(digest.as_bytes().as_slice())
                .bind(owner.map(|owner| owner.as_bytes().to_vec()))
                .execute(self.database.pool())
                .await?;
        }
        Ok(Vec::new())
    }

    async fn unpin(&self, _: &str) -> Result<(), BlobError> {
        later()
    }

    async fn has(&self, _: Owner, _: Digest) -> Result<bool, BlobError> {
        later()
    }

    async fn give(&self, _: Owner, _: Digest) -> Result<Option<Owner>, BlobError> {
        later()
    }

    async fn disown(&self, _: Owner, _: Digest) -> Result<Option<BlobInfo>, BlobError> {
        later()
    }

    async fn owned_bytes(&self, _: Owner) -> Result<u64, BlobError> {
        later()
    }

    async fn usage(&self) -> Result<Usage, BlobError> {
        let (blobs, bytes, pinned): (i64, i64, i64) = sqlx::query_as(
            "select count(*), coalesce(sum(size), 0)::bigint, coalesce(sum(size) filter (where exists \
             (select from tessera.pins p where p.digest = b.digest)), 0)::bigint from tessera.blobs b",
        )
        .fetch_one(self.database.pool())
        .await?;
        let [blobs, blob_bytes, pinned_bytes] = [blobs, bytes, pinned].map(|number| u64::try_from(number).unwrap_or(0));
        let blobs = usize::try_from(blobs).unwrap_or(usize::MAX);
        Ok(Usage { blobs, blob_bytes, pinned_bytes, ..Usage::default() })
    }
}
