//! Room for uploads.
//!
//! Purpose: [`admit`] decides by the rules of every index, one upload at a time in all processes, and takes out what goes.
//! Invariant: an upload is admitted in the transaction that takes out what goes for it. Must not know: where bytes lie.

use std::collections::HashSet;

use sqlx::{PgConnection, PgPool};

use super::{BlobResult, blob, blobs, count, key_of, keys, number, places};
use crate::blob::index::rules::{Figures, OwnRoom};
use crate::blob::index::{Room, Terms};
use crate::blob::{BlobError, BlobInfo, Digest, Owner, UploadId, Usage};

/// The lock of admissions. It is let go of at the end of the transaction.
const ADMISSION: i64 = 7_310_293_847_562;
/// Rows of `amounts` that an admission replaces by their sum.
const MANY_AMOUNTS: i64 = 64;
/// Blobs that are looked at for some to go: at first, most in one statement, and most while others wait.
const LOOK_AT: i64 = 16;
const LOOK_AT_MOST: i64 = 1024;
const LOOK_AT_IN_TURN: usize = 4096;

/// What an admission comes to. All of it is committed: of a refusal, which blobs are held.
pub(super) enum Decision {
    Admitted(Option<Room>),
    /// The caller gives the refusal of these figures, with pinned bytes.
    Full(Figures),
    /// Many pinned blobs were looked at. Others have their turn first.
    Again,
}

/// As [`crate::blob::index::BlobIndex::admit`].
pub(super) async fn admit(work: &mut PgConnection, id: &UploadId, terms: &Terms) -> BlobResult<Decision> {
    let Some(figures) = figures(work, id).await? else { return Ok(Decision::Admitted(None)) };
    figures.check_place(id, terms.places)?;
    // The owner's first: these are locked in the order of their digests.
    let own = match (id.owner, terms.own_quota_bytes) {
        (Some(owner), Some(limit)) => match own_room(work, owner, id, limit, figures.own_uploading_bytes).await? {
            Some(own) => own,
            None => return Ok(Decision::Again),
        },
        _ => Vec::new(),
    };
    let excess = match figures.excess(id, terms) {
        // Pinned bytes are in no figure here: they only matter where there is no room.
        Err(BlobError::QuotaExceeded { .. }) => return Ok(Decision::Full(figures)),
        excess => excess?,
    };
    let victims = match victims(work, excess).await? {
        Found::Enough(victims) => victims,
        Found::TooFew if blobs::release(work).await? => return Ok(Decision::Again),
        Found::TooFew => return Ok(Decision::Full(figures)),
        Found::Many => return Ok(Decision::Again),
    };
    blobs::leave(work, victims.iter().map(|victim| &victim.digest)).await?;
    let mut room = Room { victims, given_up: Vec::new() };
    enter(work, id).await?;
    fold(work).await?;
    if let Some(owner) = id.owner {
        let gone: HashSet<Digest> = room.victims.iter().map(|victim| victim.digest).collect();
        for digest in own.into_iter().filter(|digest| !gone.contains(digest)) {
            match blobs::disown(work, owner, &digest).await? {
                Some(orphan) => room.victims.push(orphan),
                None => room.given_up.push(digest),
            }
        }
    }
    Ok(Decision::Admitted(Some(room)))
}

async fn enter(work: &mut PgConnection, id: &UploadId) -> BlobResult<()> {
    let enter = "insert into tessera.uploads (digest, size, owner, touched) values ($1, $2, $3, tessera.now_us()) \
                 on conflict do nothing";
    let enter = sqlx::query(enter).bind(id.digest.as_bytes().as_slice()).bind(number(id.size_bytes));
    enter.bind(key_of(id.owner)).execute(work).await?;
    Ok(())
}

/// Waits for the turn to admit, and says what is in use, without pinned bytes. `None` if the upload is there already.
async fn figures(work: &mut PgConnection, id: &UploadId) -> BlobResult<Option<Figures>> {
    sqlx::query("select pg_advisory_xact_lock($1)").bind(ADMISSION).execute(&mut *work).await?;
    // One statement: an upload that becomes a blob meanwhile is counted once.
    let (is_there, uploads, own_uploads, own_uploading, uploading, blob_bytes): (bool, i64, i64, i64, i64, i64) =
        sqlx::query_as(
            "select exists (select from tessera.uploads where digest = $1 and size = $2 and owner = $3), u.*, a.* \
         from (select count(*) filter (where owner <> $4), count(*) filter (where owner = $3), \
         least(coalesce(sum(size) filter (where owner = $3), 0), 9223372036854775807)::bigint, \
         least(coalesce(sum(size), 0), 9223372036854775807)::bigint from tessera.uploads) u, \
         (select coalesce(sum(bytes), 0)::bigint from tessera.amounts) a",
        )
        .bind(id.digest.as_bytes().as_slice())
        .bind(number(id.size_bytes))
        .bind(key_of(id.owner))
        .bind(key_of(None))
        .fetch_one(&mut *work)
        .await?;
    if is_there {
        return Ok(None);
    }
    Ok(Some(Figures {
        uploads: places(uploads),
        own_uploads: if id.owner.is_some() { places(own_uploads) } else { 0 },
        own_uploading_bytes: if id.owner.is_some() { count(own_uploading) } else { 0 },
        uploading_bytes: count(uploading),
        blob_bytes: count(blob_bytes),
        pinned_bytes: 0,
    }))
}

/// Replaces the rows of `amounts` by their sum, if they are many.
async fn fold(work: &mut PgConnection) -> BlobResult<()> {
    sqlx::query(
        "with gone as (delete from tessera.amounts where (select count(*) from tessera.amounts) > $1 returning blobs, bytes) \
         insert into tessera.amounts select sum(blobs), sum(bytes) from gone having count(*) > 0",
    )
    .bind(MANY_AMOUNTS)
    .execute(work)
    .await?;
    Ok(())
}

const PINNED: &str = "coalesce((select sum(size) from tessera.blobs b where exists \
                      (select from tessera.pins p where p.digest = b.digest)), 0)::bigint";

/// The refusal, with pinned bytes.
pub(super) async fn full(pool: &PgPool, figures: Figures, id: &UploadId, terms: &Terms) -> BlobResult<BlobError> {
    let pinned: i64 = sqlx::query_scalar(sqlx::AssertSqlSafe(format!("select {PINNED}"))).fetch_one(pool).await?;
    Ok(Figures { pinned_bytes: count(pinned), ..figures }.full(id, terms))
}

/// Locks what the owner gives up. `None` if a pin came or a blob went meanwhile: to lock others beside
/// these would be out of order. Errors: `OwnQuotaExceeded`.
async fn own_room(
    work: &mut PgConnection,
    owner: Owner,
    id: &UploadId,
    limit_bytes: u64,
    promised_bytes: u64,
) -> BlobResult<Option<Vec<Digest>>> {
    let used_bytes = blobs::owned_bytes(work, owner).await?.saturating_add(promised_bytes);
    let room = OwnRoom { needed_bytes: id.size_bytes, used_bytes, limit_bytes };
    if room.excess() == 0 {
        return Ok(Some(Vec::new()));
    }
    // The oldest that suffice.
    let held: Vec<([u8; 32], i64)> = sqlx::query_as(
        "select digest, size from (select o.digest, o.size, o.since, sum(o.size) over (order by o.since) as upto \
             from tessera.owners o where o.owner = $1 and o.size > 0 and not exists \
             (select from tessera.pins p where p.digest = o.digest and p.owner = $1)) held \
             where upto - size < $2 order by since",
    )
    .bind(owner.as_bytes().as_slice())
    .bind(number(room.excess()))
    .fetch_all(&mut *work)
    .await?;
    let given_up = room.give_up(held.into_iter().map(|(digest, size)| (digest.into(), count(size))))?;
    let locked = "select digest from tessera.blobs where digest = any($1) order by digest for update";
    let locked = sqlx::query(locked).bind(keys(&given_up)).fetch_all(&mut *work).await?.len();
    // The owner may have given one up itself.
    let still = "select (select count(*) from tessera.pins where digest = any($1) and owner = $2), \
                 (select count(*) from tessera.owners where digest = any($1) and owner = $2)";
    let (pinned, owned): (i64, i64) =
        sqlx::query_as(still).bind(keys(&given_up)).bind(owner.as_bytes().as_slice()).fetch_one(&mut *work).await?;
    let is_so = locked == given_up.len() && owned == given_up.len() as i64 && pinned == 0;
    Ok(is_so.then_some(given_up))
}

enum Found {
    Enough(Vec<BlobInfo>),
    TooFew,
    /// Many pinned ones, so far.
    Many,
}

/// Locks the least recently used blobs that no pin holds and that nothing else is at, so that these bytes go. Those that a pin
/// holds are marked.
async fn victims(work: &mut PgConnection, excess_bytes: u64) -> BlobResult<Found> {
    let (mut left, mut victims, mut looked_at) = (excess_bytes, Vec::new(), 0);
    let (mut after, mut most): ((i64, Vec<u8>), i64) = ((-1, Vec::new()), LOOK_AT);
    while left > 0 {
        let some: Vec<([u8; 32], i64, i64)> = sqlx::query_as(
            "select digest, size, used from tessera.blobs where not held and (used, digest) > ($1, $2) \
             order by used, digest limit $3 for update skip locked",
        )
        .bind(after.0)
        .bind(&after.1)
        .bind(most)
        .fetch_all(&mut *work)
        .await?;
        let Some((digest, _, used)) = some.last() else { return Ok(Found::TooFew) };
        after = (*used, digest.to_vec());
        most = (most * 4).min(LOOK_AT_MOST);
        // Once they are locked no pin comes.
        let all: Vec<&[u8]> = some.iter().map(|(digest, ..)| digest.as_slice()).collect();
        let pinned: Vec<[u8; 32]> = sqlx::query_scalar(
            "update tessera.blobs b set held = true where digest = any($1) and exists \
             (select from tessera.pins p where p.digest = b.digest) returning digest",
        )
        .bind(all)
        .fetch_all(&mut *work)
        .await?;
        let pinned: HashSet<[u8; 32]> = pinned.into_iter().collect();
        looked_at += pinned.len();
        for (digest, size, _) in some {
            if left > 0 && !pinned.contains(&digest) {
                let victim = blob((digest, size));
                left = left.saturating_sub(victim.size_bytes);
                victims.push(victim);
            }
        }
        if left > 0 && looked_at >= LOOK_AT_IN_TURN {
            return Ok(Found::Many);
        }
    }
    Ok(Found::Enough(victims))
}

/// As [`crate::blob::index::BlobIndex::usage`].
pub(super) async fn usage(pool: &PgPool) -> BlobResult<Usage> {
    let (blobs, blob_bytes, uploads, uploading, pinned): (i64, i64, i64, i64, i64) =
        sqlx::query_as(sqlx::AssertSqlSafe(format!(
            "select a.*, u.*, {PINNED} from \
             (select coalesce(sum(blobs), 0)::bigint, coalesce(sum(bytes), 0)::bigint from tessera.amounts) a, \
             (select count(*), least(coalesce(sum(size), 0), 9223372036854775807)::bigint from tessera.uploads) u"
        )))
        .fetch_one(pool)
        .await?;
    Ok(Usage {
        blobs: places(blobs),
        blob_bytes: count(blob_bytes),
        pinned_bytes: count(pinned),
        uploads: places(uploads),
        uploading_bytes: count(uploading),
        limit_bytes: 0,
    })
}
