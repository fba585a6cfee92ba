//! Blobs that nothing needs.
//!
//! Purpose: [`unpin`] ends the pins of results that no job has: those of a server that lost its claim, or went down. [`take`] takes
//! out blobs that no owner and no pin holds. Invariant: a job is locked while its pins are looked at, so that no server claims
//! it meanwhile; a job that is running keeps all of its pins. Must not know: where bytes lie, quotas.

use std::time::Duration;

use sqlx::PgConnection;

use super::{BlobResult, blob, blobs, micros};
use crate::blob::{BlobInfo, Digest};
use crate::record::state::State;

/// Blobs that are taken out at once.
const AT_ONCE: i64 = 1000;

/// Ends the pins of results whose job is gone, has ended without a result, waits, or has another result.
pub(super) async fn unpin(work: &mut PgConnection) -> BlobResult<()> {
    // The names are those of `store::pins`. A status names the digests of its result.
    sqlx::query(
        "with stale as (select p.name, p.digest, j.id from tessera.pins p \
         left join tessera.jobs j on j.id = case when p.name ~ $3 then decode(substr(p.name, 8), 'hex') end \
         where p.name ~ $3 and (j.id is null or (j.state <> $1 \
         and (j.state <> $2 or position(encode(p.digest, 'hex') in j.status) = 0)))), \
         free as (select id from tessera.jobs where id in (select id from stale) and state <> $1 for update skip locked) \
         delete from tessera.pins p using stale s where (p.name, p.digest) = (s.name, s.digest) \
         and (s.id is null or s.id in (select id from free))",
    )
    .bind(State::Running as i16)
    .bind(State::Succeeded as i16)
    .bind("^result:[0-9a-f]{32}$")
    .execute(work)
    .await?;
    Ok(())
}

/// As [`crate::blob::index::BlobIndex::orphans`].
pub(super) async fn take(work: &mut PgConnection, time: Duration) -> BlobResult<Vec<BlobInfo>> {
    let free = "not exists (select from tessera.owners o where o.digest = b.digest) \
                and not exists (select from tessera.pins p where p.digest = b.digest)";
    let locked: Vec<([u8; 32],)> = sqlx::query_as(sqlx::AssertSqlSafe(format!(
        "select digest from tessera.blobs b where used <= (tessera.now_us() - $1) * 1000 and {free} \
         order by digest limit $2 for update skip locked"
    )))
    .bind(micros(time))
    .bind(AT_ONCE)
    .fetch_all(&mut *work)
    .await?;
    // Once they are locked no pin and no owner comes.
    let digests: Vec<&[u8]> = locked.iter().map(|(digest,)| digest.as_slice()).collect();
    let orphans = format!("select digest, size from tessera.blobs b where digest = any($1) and {free}");
    let orphans: Vec<([u8; 32], i64)> =
        sqlx::query_as(sqlx::AssertSqlSafe(orphans)).bind(digests).fetch_all(&mut *work).await?;
    let orphans: Vec<BlobInfo> = orphans.into_iter().map(blob).collect();
    let digests: Vec<Digest> = orphans.iter().map(|blob| blob.digest).collect();
    blobs::leave(work, &digests).await?;
    Ok(orphans)
}
