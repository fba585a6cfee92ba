//! Blobs, pins and owners in the database.
//!
//! Purpose: what an index does to blobs, but for making room. Invariant: as the tables say: who takes a blob out locks it first
//! and looks at its pins then. The bytes of a blob are removed and shown by one process at a time: [`removing`] and
//! `showing` take the lock of its digest, and each sees what the other has begun. Must not know: where bytes lie, quotas.

use std::collections::HashMap;
use std::time::Duration;

use sqlx::{PgConnection, PgExecutor, PgPool};

use super::{BlobResult, blob, count, keys, micros, number};
use crate::blob::index::{Published, Used};
use crate::blob::{BlobError, BlobInfo, Digest, MOST_OWNERS, Owner, UploadId};

/// Blobs that are entered by one statement.
pub(super) const AT_ONCE: usize = 1000;
/// Blobs that are given to be removed at once.
const LEFT_AT_ONCE: i64 = 1000;
/// How long the removal of a blob's bytes may take. Longer than the store of objects tries.
const REMOVING: Duration = Duration::from_secs(300);
/// How long after a removal a process may still enter what it saw before: a list of all blobs takes a while.
const SEEN_BEFORE: Duration = Duration::from_secs(3600);
/// Which locks [`lock`] takes.
const DIGESTS: i32 = 731_029;
/// Of an owner with this many blobs or more it does not matter how many.
const MANY: i64 = 1000;

/// Locks a digest, not its row: which may not be there.
pub(super) async fn lock(work: &mut PgConnection, digest: &Digest) -> BlobResult<()> {
    let [a, b, c, d, ..] = *digest.as_bytes();
    let lock = sqlx::query("select pg_advisory_xact_lock($1, $2)").bind(DIGESTS);
    lock.bind(i32::from_le_bytes([a, b, c, d])).execute(work).await?;
    Ok(())
}

/// Enters blobs that are stored; gives those that were not known. Those whose bytes are being removed stay out.
pub(super) async fn enter(pool: &PgPool, blobs: &[(BlobInfo, u64)]) -> BlobResult<Vec<Digest>> {
    let sizes: Vec<i64> = blobs.iter().map(|(blob, _)| number(blob.size_bytes)).collect();
    let stamps: Vec<i64> = blobs.iter().map(|(_, stamp)| number(*stamp)).collect();
    // In order, so that two that enter the same do not wait for each other.
    let entered: Vec<[u8; 32]> = sqlx::query_scalar(
        "insert into tessera.blobs (digest, size, used) \
         select digest, size, used from unnest($1::bytea[], $2::bigint[], $3::bigint[]) as stored (digest, size, used) \
         where not exists (select from tessera.gone g where g.digest = stored.digest) order by digest \
         on conflict do nothing returning digest",
    )
    .bind(keys(blobs.iter().map(|(blob, _)| &blob.digest)))
    .bind(sizes)
    .bind(stamps)
    .fetch_all(pool)
    .await?;
    Ok(entered.into_iter().map(Digest::from).collect())
}

/// As [`crate::blob::index::BlobIndex::publish`].
pub(super) async fn publish(work: &mut PgConnection, id: &UploadId, pin: Option<&str>) -> BlobResult<Published> {
    let digest = &id.digest;
    let end = sqlx::query("delete from tessera.uploads where digest = $1 and size = $2 and owner = $3");
    let end = end.bind(digest.as_bytes().as_slice()).bind(number(id.size_bytes)).bind(super::key_of(id.owner));
    end.execute(&mut *work).await?;
    let stamp: i64 = sqlx::query_scalar(
        "insert into tessera.blobs as b (digest, size, used) values ($1, $2, tessera.stamp(0)) \
         on conflict (digest) do update set used = greatest(b.used + 1, excluded.used) returning used",
    )
    .bind(digest.as_bytes().as_slice())
    .bind(number(id.size_bytes))
    .fetch_one(&mut *work)
    .await?;
    let back = sqlx::query("delete from tessera.gone where digest = $1").bind(digest.as_bytes().as_slice());
    back.execute(&mut *work).await?;
    if let Some(name) = pin {
        pin_all(work, None, name, &[*digest]).await?;
    }
    let replaced = match id.owner {
        Some(owner) => give(work, owner, digest).await?,
        None => None,
    };
    Ok(Published { stamp: count(stamp), replaced })
}

pub(super) async fn get(pool: &PgPool, digest: &Digest) -> BlobResult<Option<BlobInfo>> {
    let get = sqlx::query_as("select digest, size from tessera.blobs where digest = $1");
    Ok(get.bind(digest.as_bytes().as_slice()).fetch_optional(pool).await?.map(blob))
}

/// The blobs are used now. One that was used less than `same_use` (ns) ago costs no write: it is far from the oldest, which go
/// first. One that another process uses or takes out at this moment is not waited for, so that two such calls do not wait for
/// each other.
pub(super) async fn touch(work: &mut PgConnection, digests: &[Digest], same_use: i64) -> BlobResult<Vec<Option<Used>>> {
    let used: Vec<([u8; 32], i64, i64)> = sqlx::query_as(
        "with asked as (select digest, max(k) as k from unnest($1::bytea[]) with ordinality as a (digest, k) group by digest), \
         free as (select digest from tessera.blobs where digest = any($1) and used <= tessera.now_us() * 1000 - $2 \
         for no key update skip locked), \
         moved as (update tessera.blobs b set used = greatest(b.used + 1, tessera.stamp(a.k)) \
         from asked a join free f using (digest) where b.digest = a.digest returning b.digest, b.used) \
         select b.digest, b.size, coalesce(m.used, b.used) from tessera.blobs b left join moved m using (digest) \
         where b.digest = any($1)",
    )
    .bind(keys(digests))
    .bind(same_use)
    .fetch_all(work)
    .await?;
    let used: HashMap<Digest, Used> = used
        .into_iter()
        .map(|(digest, size, stamp)| (digest.into(), Used { info: blob((digest, size)), stamp: count(stamp) }))
        .collect();
    Ok(digests.iter().map(|digest| used.get(digest).copied()).collect())
}

/// As [`crate::blob::index::BlobIndex::found`].
pub(super) async fn found(work: &mut PgConnection, blob: BlobInfo, stamp: u64) -> BlobResult<bool> {
    // So that no removal begins meanwhile. What is being shown is in the index once that is done: until then it is an upload.
    lock(work, &blob.digest).await?;
    let enter = sqlx::query(
        "insert into tessera.blobs (digest, size, used) select $1, $2, $3 \
         where not exists (select from tessera.gone where digest = $1) and not exists \
         (select from tessera.uploads where digest = $1 and not tessera.is_free(showing, shown_by)) on conflict do nothing",
    );
    let enter = enter.bind(blob.digest.as_bytes().as_slice()).bind(number(blob.size_bytes)).bind(number(stamp));
    enter.execute(&mut *work).await?;
    let is_there = sqlx::query_scalar("select exists (select from tessera.blobs where digest = $1)");
    Ok(is_there.bind(blob.digest.as_bytes().as_slice()).fetch_one(work).await?)
}

/// Locks a blob, so that no pin comes; gives its size.
async fn take(work: &mut PgConnection, digest: &Digest) -> BlobResult<Option<u64>> {
    let take = sqlx::query_scalar("select size from tessera.blobs where digest = $1 for update");
    let size: Option<i64> = take.bind(digest.as_bytes().as_slice()).fetch_optional(work).await?;
    Ok(size.map(count))
}

/// As [`crate::blob::index::BlobIndex::forget`].
pub(super) async fn forget(work: &mut PgConnection, digest: &Digest) -> BlobResult<Option<BlobInfo>> {
    let Some(size_bytes) = take(work, digest).await? else { return Ok(None) };
    for forget in ["delete from tessera.pins where digest = $1", "delete from tessera.blobs where digest = $1"] {
        sqlx::query(forget).bind(digest.as_bytes().as_slice()).execute(&mut *work).await?;
    }
    Ok(Some(BlobInfo { digest: *digest, size_bytes }))
}

/// Takes out blobs that are locked and have no pins. Their bytes are to be removed.
pub(super) async fn leave<'a>(
    work: &mut PgConnection,
    digests: impl IntoIterator<Item = &'a Digest>,
) -> BlobResult<()> {
    let digests = keys(digests);
    if digests.is_empty() {
        return Ok(());
    }
    sqlx::query(
        "with gone as (delete from tessera.blobs where digest = any($1) returning digest, size) \
         insert into tessera.gone (digest, size, since) select digest, size, tessera.now_ms() from gone \
         on conflict (digest) do update set size = excluded.size, since = excluded.since, done = false",
    )
    .bind(digests)
    .execute(work)
    .await?;
    Ok(())
}

/// As [`crate::blob::index::BlobIndex::delete`].
pub(super) async fn delete(work: &mut PgConnection, digest: &Digest) -> BlobResult<BlobInfo> {
    let size_bytes = take(work, digest).await?.ok_or(BlobError::NotFound { digest: *digest })?;
    if pinned(work, digest, None).await? {
        return Err(BlobError::Pinned { digest: *digest });
    }
    leave(work, [digest]).await?;
    Ok(BlobInfo { digest: *digest, size_bytes })
}

/// Whether a blob is pinned: at all, or in the name of an owner.
async fn pinned(work: &mut PgConnection, digest: &Digest, owner: Option<Owner>) -> BlobResult<bool> {
    let pinned = "select exists (select from tessera.pins where digest = $1 and ($2::bytea is null or owner = $2))";
    let pinned = sqlx::query_scalar(pinned).bind(digest.as_bytes().as_slice());
    Ok(pinned.bind(owner.map(|owner| *owner.as_bytes())).fetch_one(work).await?)
}

/// As [`crate::blob::index::BlobIndex::removing`].
pub(super) async fn removing(work: &mut PgConnection, blob: BlobInfo) -> BlobResult<bool> {
    lock(work, &blob.digest).await?;
    let claimed: Option<bool> = sqlx::query_scalar(
        "insert into tessera.gone as g (digest, size, since, removing) \
         select $1, $2, tessera.now_ms(), tessera.now_ms() + $3 \
         where not exists (select from tessera.blobs where digest = $1) and not exists \
         (select from tessera.uploads where digest = $1 and not tessera.is_free(showing, shown_by)) \
         on conflict (digest) do update set removing = excluded.removing, done = false where g.removing <= tessera.now_ms() returning true",
    )
    .bind(blob.digest.as_bytes().as_slice())
    .bind(number(blob.size_bytes))
    .bind(micros(REMOVING) / 1000)
    .fetch_optional(&mut *work)
    .await?;
    if claimed.is_none() {
        let back =
            "delete from tessera.gone g where digest = $1 and exists (select from tessera.blobs where digest = $1)";
        sqlx::query(back).bind(blob.digest.as_bytes().as_slice()).execute(work).await?;
    }
    Ok(claimed.is_some())
}

/// Clears the mark of blobs that no pin holds any more. Gives whether there were any.
pub(super) async fn release(work: &mut PgConnection) -> BlobResult<bool> {
    let release = "with free as (select digest from tessera.blobs b where held and not exists \
                   (select from tessera.pins p where p.digest = b.digest) for no key update skip locked) \
                   update tessera.blobs b set held = false from free where b.digest = free.digest";
    Ok(sqlx::query(release).execute(work).await?.rows_affected() > 0)
}

/// As [`crate::blob::index::BlobIndex::left`].
pub(super) async fn left(work: &mut PgConnection, time: Duration) -> BlobResult<Vec<BlobInfo>> {
    release(work).await?;
    let forget = "delete from tessera.gone where done and since <= tessera.now_ms() - $1";
    sqlx::query(forget).bind(micros(SEEN_BEFORE) / 1000).execute(&mut *work).await?;
    let left = "select digest, size from tessera.gone where not done and since <= tessera.now_ms() - $1 \
                order by since limit $2";
    let left = sqlx::query_as(left).bind(micros(time) / 1000).bind(LEFT_AT_ONCE).fetch_all(work).await?;
    Ok(left.into_iter().map(blob).collect())
}

/// As [`crate::blob::index::BlobIndex::removed`].
pub(super) async fn removed(work: &mut PgConnection, blob: BlobInfo, gone: bool) -> BlobResult<()> {
    let digest = blob.digest.as_bytes().as_slice();
    if gone {
        let done = "update tessera.gone set done = true, removing = 0, since = tessera.now_ms() where digest = $1";
        sqlx::query(done).bind(digest).execute(work).await?;
        return Ok(());
    }
    let back = "insert into tessera.blobs (digest, size, used) values ($1, $2, 0) on conflict do nothing";
    sqlx::query(back).bind(digest).bind(number(blob.size_bytes)).execute(&mut *work).await?;
    sqlx::query("delete from tessera.gone where digest = $1").bind(digest).execute(work).await?;
    Ok(())
}

/// Pins all, or none, in a transaction. Errors: `NotFound`.
pub(in crate::postgres) async fn pin(
    work: &mut PgConnection,
    owner: Option<Owner>,
    name: &str,
    digests: &[Digest],
) -> BlobResult<()> {
    let stored = "select digest from tessera.blobs where digest = any($1) order by digest for key share";
    let stored: Vec<[u8; 32]> = sqlx::query_scalar(stored).bind(keys(digests)).fetch_all(&mut *work).await?;
    if let Some(digest) = digests.iter().find(|digest| !stored.contains(digest.as_bytes())) {
        return Err(BlobError::NotFound { digest: *digest });
    }
    pin_all(work, owner, name, digests).await
}

/// Pins blobs that are locked. All that a name pins is pinned in one name.
async fn pin_all(work: &mut PgConnection, owner: Option<Owner>, name: &str, digests: &[Digest]) -> BlobResult<()> {
    let owner = owner.map(|owner| *owner.as_bytes());
    sqlx::query(
        "insert into tessera.pins (name, digest, owner) select $1, digest, \
         coalesce((select owner from tessera.pins where name = $1 and owner is not null limit 1), $2) \
         from unnest($3::bytea[]) digest order by digest on conflict do nothing",
    )
    .bind(name)
    .bind(owner)
    .bind(keys(digests))
    .execute(&mut *work)
    .await?;
    if owner.is_some() {
        let name_it = "update tessera.pins set owner = $2 where name = $1 and owner is null";
        sqlx::query(name_it).bind(name).bind(owner).execute(work).await?;
    }
    Ok(())
}

/// Ends the pins of these names.
pub(in crate::postgres) async fn unpin(connection: impl PgExecutor<'_>, names: &[String]) -> sqlx::Result<()> {
    if !names.is_empty() {
        sqlx::query("delete from tessera.pins where name = any($1)").bind(names).execute(connection).await?;
    }
    Ok(())
}

pub(super) async fn has(pool: &PgPool, owner: Owner, digest: &Digest) -> BlobResult<bool> {
    let has = sqlx::query_scalar("select exists (select from tessera.owners where digest = $1 and owner = $2)");
    Ok(has.bind(digest.as_bytes().as_slice()).bind(owner.as_bytes().as_slice()).fetch_one(pool).await?)
}

/// Those of `owners` that do not have their blob.
pub(super) async fn not_owned(pool: &PgPool, owners: &[(Digest, Owner)]) -> BlobResult<Vec<(Digest, Owner)>> {
    let rows: Vec<([u8; 32], [u8; 16])> = sqlx::query_as(
        "select digest, owner from unnest($1::bytea[], $2::bytea[]) as marked (digest, owner) where not exists \
         (select from tessera.owners o where (o.digest, o.owner) = (marked.digest, marked.owner))",
    )
    .bind(keys(owners.iter().map(|(digest, _)| digest)))
    .bind(owners.iter().map(|(_, owner)| owner.as_bytes().as_slice()).collect::<Vec<_>>())
    .fetch_all(pool)
    .await?;
    Ok(rows.into_iter().map(|(digest, owner)| (digest.into(), Owner::from_bytes(owner))).collect())
}

pub(super) async fn owned_bytes(work: &mut PgConnection, owner: Owner) -> BlobResult<u64> {
    let bytes = sqlx::query_scalar("select coalesce(sum(size), 0)::bigint from tessera.owners where owner = $1");
    Ok(count(bytes.bind(owner.as_bytes().as_slice()).fetch_one(work).await?))
}

/// As [`crate::blob::index::BlobIndex::give`].
pub(super) async fn give(work: &mut PgConnection, owner: Owner, digest: &Digest) -> BlobResult<Option<Owner>> {
    let digest = digest.as_bytes().as_slice();
    // One owner at a time; pins do not wait for it.
    let size = sqlx::query_scalar("select size from tessera.blobs where digest = $1 for no key update");
    let Some(size): Option<i64> = size.bind(digest).fetch_optional(&mut *work).await? else { return Ok(None) };
    let give = "insert into tessera.owners (digest, owner, size) values ($1, $2, $3) \
                on conflict (digest, owner) do update set since = default";
    sqlx::query(give).bind(digest).bind(owner.as_bytes().as_slice()).bind(size).execute(&mut *work).await?;
    // As every index: of those that need it not, the one with the fewest blobs, and of several the latest.
    let replaced: Option<[u8; 16]> = sqlx::query_scalar(
        "delete from tessera.owners where digest = $1 and owner = (select o.owner from tessera.owners o \
         where o.digest = $1 and o.owner <> $2 and (select count(*) from tessera.owners where digest = $1) > $3 \
         and not exists (select from tessera.pins p where p.digest = $1 and p.owner = o.owner) \
         order by (select count(*) from (select from tessera.owners h where h.owner = o.owner limit $4) held), o.since desc \
         limit 1) returning owner",
    )
    .bind(digest)
    .bind(owner.as_bytes().as_slice())
    .bind(number(MOST_OWNERS as u64))
    .bind(MANY)
    .fetch_optional(work)
    .await?;
    Ok(replaced.map(Owner::from_bytes))
}

/// As [`crate::blob::index::BlobIndex::disown`].
pub(super) async fn disown(work: &mut PgConnection, owner: Owner, digest: &Digest) -> BlobResult<Option<BlobInfo>> {
    let size_bytes = take(work, digest).await?.ok_or(BlobError::NotFound { digest: *digest })?;
    let key = digest.as_bytes().as_slice();
    let has = sqlx::query_scalar("select exists (select from tessera.owners where digest = $1 and owner = $2)");
    let has: bool = has.bind(key).bind(owner.as_bytes().as_slice()).fetch_one(&mut *work).await?;
    if !has {
        return Err(BlobError::NotFound { digest: *digest });
    }
    if pinned(work, digest, Some(owner)).await? {
        return Err(BlobError::Pinned { digest: *digest });
    }
    let disown = sqlx::query("delete from tessera.owners where digest = $1 and owner = $2");
    disown.bind(key).bind(owner.as_bytes().as_slice()).execute(&mut *work).await?;
    let is_owned = sqlx::query_scalar("select exists (select from tessera.owners where digest = $1)");
    let is_owned: bool = is_owned.bind(key).fetch_one(&mut *work).await?;
    if is_owned || pinned(work, digest, None).await? {
        return Ok(None);
    }
    leave(work, [digest]).await?;
    Ok(Some(BlobInfo { digest: *digest, size_bytes }))
}
