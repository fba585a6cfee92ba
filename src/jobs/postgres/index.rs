//! The index of blobs in the database.
//!
//! Purpose: [`PostgresIndex`] is [`BlobIndex`] for several processes. [`admission`] makes room, [`blobs`] has pins, owners and
//! removals, [`uploads`] the uploads, [`orphans`] what nothing needs. Each call is one short transaction; the rules are those of every index. Invariant: one
//! admission at a time: all else only takes blobs and uploads away, turns an upload into its blob, or enters what is stored, so that
//! the quota holds whenever it is looked at. Rows are locked in this order: an upload, blobs by their digests, then what
//! belongs to them; what is locked in another order is skipped where it is not free. Only the database's clock counts.
//! Must not know: where bytes lie, jobs.

mod admission;
mod blobs;
mod orphans;
mod uploads;

use std::hash::{BuildHasher, RandomState};
use std::sync::Arc;
use std::time::Duration;

use async_trait::async_trait;
use sqlx::PgTransaction;

use super::pool::Database;
use super::rows::{count, number};
use crate::blob::index::{BlobIndex, Note, Published, Room, Stored, Terms, UploadNotes, Used};
use crate::blob::{BlobError, BlobInfo, Digest, NO_OWNER, Owner, UploadId, Usage};
use admission::Decision;
pub(super) use blobs::{pin, unpin};

type BlobResult<T> = Result<T, BlobError>;

#[derive(Debug)]
pub(super) struct PostgresIndex {
    database: Database,
    /// Uses of a blob within this time are one use.
    same_use: Duration,
    /// This process, among those that show bytes.
    pub(super) process: i64,
}

impl PostgresIndex {
    pub(super) fn new(database: Database, same_use: Duration) -> Self {
        Self { database, same_use, process: RandomState::new().hash_one(()).cast_signed() }
    }

    async fn begin(&self) -> BlobResult<PgTransaction<'static>> {
        Ok(self.database.pool().begin().await?)
    }

    fn same_use(&self) -> i64 {
        i64::try_from(self.same_use.as_nanos()).unwrap_or(i64::MAX)
    }
}

fn places(value: i64) -> usize {
    usize::try_from(value).unwrap_or(0)
}

fn micros(time: Duration) -> i64 {
    i64::try_from(time.as_micros()).unwrap_or(i64::MAX)
}

fn keys<'a>(digests: impl IntoIterator<Item = &'a Digest>) -> Vec<&'a [u8]> {
    digests.into_iter().map(|digest| digest.as_bytes().as_slice()).collect()
}

fn key_of(owner: Option<Owner>) -> [u8; 16] {
    *owner.unwrap_or(NO_OWNER).as_bytes()
}

/// A blob of a row: digest and size.
fn blob((digest, size): ([u8; 32], i64)) -> BlobInfo {
    BlobInfo { digest: digest.into(), size_bytes: count(size) }
}

/// An operation that ends in time, on a connection or in a transaction. A closure's future could not be seen to be `Send`.
macro_rules! run {
    ($index:ident, $operation:expr) => {
        $index.database.run(async { Ok($operation.await) }).await.map_err(unavailable)?
    };
}

/// As [`run`], in a transaction that takes back what an error leaves.
macro_rules! transaction {
    ($index:ident, |$work:ident| $operation:expr) => {
        run!($index, async {
            let mut transaction = $index.begin().await?;
            let $work = &mut *transaction;
            let done = $operation.await?;
            transaction.commit().await?;
            Ok::<_, BlobError>(done)
        })
    };
}

fn unavailable(error: crate::store::StoreError) -> BlobError {
    match error {
        crate::store::StoreError::Unavailable { cause } => BlobError::Database(cause),
        error => BlobError::Database(error.to_string()),
    }
}

#[async_trait]
impl BlobIndex for PostgresIndex {
    // Another process may have entered them, and may be at work: what the database knows stays as it is. The owners of a blob
    // that it knows are those that it has: a mark beside the blob may be left from one that gave it away.
    async fn enter(&self, stored: Stored) -> BlobResult<Vec<(Digest, Owner)>> {
        let mut lost = Vec::new();
        let mut new = std::collections::HashSet::new();
        for some in stored.blobs.chunks(blobs::AT_ONCE) {
            let entered: Vec<Digest> = run!(self, blobs::enter(self.database.pool(), some))?;
            new.extend(entered);
        }
        let (given, known): (Vec<_>, Vec<_>) = stored.owners.into_iter().partition(|(digest, _)| new.contains(digest));
        for (digest, owner) in given {
            lost.extend(self.give(owner, digest).await?.map(|other| (digest, other)));
        }
        for some in known.chunks(blobs::AT_ONCE) {
            lost.extend(run!(self, blobs::not_owned(self.database.pool(), some))?);
        }
        run!(self, uploads::enter(self.database.pool(), &stored.uploads))?;
        Ok(lost)
    }

    async fn admit(&self, upload: UploadId, terms: Terms) -> BlobResult<Option<Room>> {
        loop {
            let decision: Decision = transaction!(self, |work| admission::admit(work, &upload, &terms))?;
            match decision {
                Decision::Admitted(room) => return Ok(room),
                Decision::Again => {}
                // Nothing waits for this one.
                Decision::Full(figures) => {
                    let full = admission::full(self.database.pool(), figures, &upload, &terms);
                    return Err(run!(self, full)?);
                }
            }
        }
    }

    // What another process began is here already.
    async fn adopt(&self, upload: UploadId, _: usize) -> BlobResult<()> {
        run!(self, uploads::adopt(self.database.pool(), &upload))
    }

    fn notes(self: Arc<Self>) -> Option<Arc<dyn UploadNotes>> {
        Some(self)
    }

    async fn touch_upload(&self, upload: UploadId) -> BlobResult<()> {
        run!(self, uploads::touch(self.database.pool(), &upload, self.process))
    }

    async fn end_upload(&self, upload: UploadId) -> BlobResult<()> {
        run!(self, uploads::end(self.database.pool(), &upload, self.process))
    }

    async fn idle_time(&self, upload: UploadId) -> BlobResult<Option<Duration>> {
        run!(self, uploads::idle_time(self.database.pool(), &upload))
    }

    async fn idle_uploads(&self, time: Duration) -> BlobResult<Vec<UploadId>> {
        run!(self, uploads::idle(self.database.pool(), time))
    }

    async fn stalest_upload(&self, upload: UploadId, time: Duration) -> BlobResult<Option<UploadId>> {
        run!(self, uploads::stalest(self.database.pool(), &upload, time))
    }

    async fn publish(&self, upload: UploadId, pin: Option<&str>) -> BlobResult<Published> {
        transaction!(self, |work| blobs::publish(work, &upload, pin))
    }

    async fn showing(&self, upload: UploadId) -> BlobResult<()> {
        // Longer than most removals take.
        for _ in 0..uploads::LOOKS {
            let is_free: bool = transaction!(self, |work| uploads::show(work, &upload, self.process))?;
            if is_free {
                return Ok(());
            }
            tokio::time::sleep(uploads::LOOK).await;
        }
        let digest = upload.digest;
        Err(BlobError::Busy { digest })
    }

    async fn get(&self, digest: Digest) -> BlobResult<Option<BlobInfo>> {
        run!(self, blobs::get(self.database.pool(), &digest))
    }

    async fn touch(&self, digests: &[Digest]) -> BlobResult<Vec<Option<Used>>> {
        run!(self, async {
            let mut connection = self.database.pool().acquire().await?;
            blobs::touch(&mut connection, digests, self.same_use()).await
        })
    }

    async fn found(&self, blob: BlobInfo, stamp: u64) -> BlobResult<bool> {
        transaction!(self, |work| blobs::found(work, blob, stamp))
    }

    async fn forget(&self, digest: Digest) -> BlobResult<Option<BlobInfo>> {
        transaction!(self, |work| blobs::forget(work, &digest))
    }

    async fn delete(&self, digest: Digest) -> BlobResult<BlobInfo> {
        transaction!(self, |work| blobs::delete(work, &digest))
    }

    async fn removing(&self, blob: BlobInfo) -> BlobResult<bool> {
        transaction!(self, |work| blobs::removing(work, blob))
    }

    async fn left(&self, time: Duration) -> BlobResult<Vec<BlobInfo>> {
        transaction!(self, |work| blobs::left(work, time))
    }

    async fn orphans(&self, time: Duration) -> BlobResult<Vec<BlobInfo>> {
        transaction!(self, |work| orphans::unpin(work))?;
        transaction!(self, |work| orphans::take(work, time))
    }

    async fn removed(&self, blob: BlobInfo, gone: bool) -> BlobResult<()> {
        transaction!(self, |work| blobs::removed(work, blob, gone))
    }

    async fn pin(&self, owner: Option<Owner>, name: &str, digests: &[Digest]) -> BlobResult<Vec<Used>> {
        transaction!(self, |work| async {
            blobs::pin(work, owner, name, digests).await?;
            let used = blobs::touch(work, digests, self.same_use()).await?;
            Ok::<_, BlobError>(used.into_iter().flatten().collect())
        })
    }

    async fn unpin(&self, name: &str) -> BlobResult<()> {
        run!(self, async { Ok(blobs::unpin(self.database.pool(), &[name.to_owned()]).await?) })
    }

    async fn has(&self, owner: Owner, digest: Digest) -> BlobResult<bool> {
        run!(self, blobs::has(self.database.pool(), owner, &digest))
    }

    async fn give(&self, owner: Owner, digest: Digest) -> BlobResult<Option<Owner>> {
        transaction!(self, |work| blobs::give(work, owner, &digest))
    }

    async fn disown(&self, owner: Owner, digest: Digest) -> BlobResult<Option<BlobInfo>> {
        transaction!(self, |work| blobs::disown(work, owner, &digest))
    }

    async fn owned_bytes(&self, owner: Owner) -> BlobResult<u64> {
        run!(self, async {
            let mut connection = self.database.pool().acquire().await?;
            blobs::owned_bytes(&mut connection, owner).await
        })
    }

    async fn usage(&self) -> BlobResult<Usage> {
        run!(self, admission::usage(self.database.pool()))
    }
}

#[async_trait]
impl UploadNotes for PostgresIndex {
    async fn note(&self, upload: UploadId) -> BlobResult<Option<Note>> {
        run!(self, uploads::note(self.database.pool(), &upload))
    }

    async fn advance(&self, upload: UploadId, from: &Note, to: &Note) -> BlobResult<bool> {
        transaction!(self, |work| uploads::advance(work, &upload, (from, to), self.process))
    }
}
