//! Uploads in the database.
//!
//! Purpose: when each was continued last, how far it is ([`note`], [`advance`]), and [`show`]. Must not know: blobs, quotas, where bytes lie.

use std::time::{Duration, SystemTime};

use sqlx::{PgConnection, PgPool};

use super::{BlobResult, count, key_of, micros, number};
use crate::blob::index::Note;
use crate::blob::{BlobError, NO_OWNER, Owner, UploadId};

/// Chunks within this time are one sign that an upload goes on. Short against the time after which one is idle.
const SAME_SIGN: Duration = Duration::from_secs(5);
/// How long an upload's bytes may take to be shown. Longer than the store of objects tries.
const SHOWING: Duration = Duration::from_secs(900);
/// How often, and how many times, is looked for the end of a removal.
pub(super) const LOOK: Duration = Duration::from_millis(50);
pub(super) const LOOKS: usize = 40;

/// Its row: digest, size, owner.
type Row = ([u8; 32], i64, [u8; 16]);

fn id((digest, size, owner): Row) -> UploadId {
    let owner = Some(Owner::from_bytes(owner)).filter(|owner| *owner != NO_OWNER);
    UploadId { digest: digest.into(), size_bytes: count(size), owner }
}

macro_rules! of {
    ($sql:expr, $id:ident) => {
        sqlx::query_as($sql).bind($id.digest.as_bytes().as_slice()).bind(number($id.size_bytes)).bind(key_of($id.owner))
    };
}

pub(super) async fn enter(pool: &PgPool, uploads: &[(UploadId, SystemTime)]) -> BlobResult<()> {
    for (id, touched) in uploads {
        let touched = touched.duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        let enter = "insert into tessera.uploads (digest, size, owner, touched) \
                     values ($1, $2, $3, least($4, tessera.now_us())) on conflict do nothing";
        let enter = sqlx::query(enter).bind(id.digest.as_bytes().as_slice()).bind(number(id.size_bytes));
        enter.bind(key_of(id.owner)).bind(micros(touched)).execute(pool).await?;
    }
    Ok(())
}

/// Also takes back that this process shows it.
pub(super) async fn touch(pool: &PgPool, id: &UploadId, process: i64) -> BlobResult<()> {
    let touch = "update tessera.uploads set touched = tessera.now_us(), \
                 showing = case shown_by when $4 then 0 else showing end where digest = $1 and size = $2 and owner = $3 \
                 and (touched < tessera.now_us() - $5 or (shown_by = $4 and showing > 0)) returning true";
    let _touched: Option<(bool,)> = of!(touch, id).bind(process).bind(micros(SAME_SIGN)).fetch_optional(pool).await?;
    Ok(())
}

/// Not what another process shows: its room becomes the blob's.
pub(super) async fn end(pool: &PgPool, id: &UploadId, process: i64) -> BlobResult<()> {
    let end = "delete from tessera.uploads where digest = $1 and size = $2 and owner = $3 \
               and (shown_by = $4 or tessera.is_free(showing, shown_by)) returning true";
    let _ended: Option<(bool,)> = of!(end, id).bind(process).fetch_optional(pool).await?;
    Ok(())
}

/// Errors: `UploadNotFound`: another process ended it.
pub(super) async fn adopt(pool: &PgPool, id: &UploadId) -> BlobResult<()> {
    match idle_time(pool, id).await? {
        Some(_) => Ok(()),
        None => Err(BlobError::UploadNotFound { digest: id.digest }),
    }
}

pub(super) async fn idle_time(pool: &PgPool, id: &UploadId) -> BlobResult<Option<Duration>> {
    let idle = "select tessera.now_us() - touched from tessera.uploads where digest = $1 and size = $2 and owner = $3";
    let idle: Option<(i64,)> = of!(idle, id).fetch_optional(pool).await?;
    Ok(idle.map(|(idle,)| Duration::from_micros(count(idle))))
}

/// As [`crate::blob::index::UploadNotes::note`].
pub(super) async fn note(pool: &PgPool, id: &UploadId) -> BlobResult<Option<Note>> {
    let note = "select coalesce(multipart, ''), kept, coalesce(hash, ''), array(select content from tessera.upload_parts p \
                where (p.digest, p.size, p.owner) = (u.digest, u.size, u.owner) order by number) \
                from tessera.uploads u where digest = $1 and size = $2 and owner = $3";
    let note: Option<(String, i64, String, Vec<String>)> = of!(note, id).fetch_optional(pool).await?;
    Ok(note.map(|(multipart, kept, hash, parts)| Note { multipart, parts, bytes: count(kept), hash }))
}

/// As [`crate::blob::index::UploadNotes::advance`]. `to` has the parts of `from` and more, or none.
pub(super) async fn advance(
    work: &mut PgConnection,
    id: &UploadId,
    (from, to): (&Note, &Note),
    process: i64,
) -> BlobResult<bool> {
    let advance = "update tessera.uploads set multipart = nullif($6, ''), kept = $7, hash = nullif($8, ''), \
                   touched = tessera.now_us() where digest = $1 and size = $2 and owner = $3 \
                   and coalesce(multipart, '') = $4 and kept = $5 and (shown_by = $9 or tessera.is_free(showing, shown_by)) \
                   returning true";
    let advanced: Option<(bool,)> = of!(advance, id)
        .bind(&from.multipart)
        .bind(number(from.bytes))
        .bind(&to.multipart)
        .bind(number(to.bytes))
        .bind(&to.hash)
        .bind(process)
        .fetch_optional(&mut *work)
        .await?;
    if advanced.is_none() {
        return Ok(false);
    }
    let parts = "with gone as (delete from tessera.upload_parts where digest = $1 and size = $2 and owner = $3 and number > $4) \
                 insert into tessera.upload_parts (digest, size, owner, number, content) \
                 select $1, $2, $3, number, content from unnest($5::text[]) with ordinality p (content, number) \
                 where number > $6 returning true";
    let kept = from.parts.len().min(to.parts.len());
    let _parts: Vec<(bool,)> = of!(parts, id)
        .bind(i32::try_from(kept).unwrap_or(i32::MAX))
        .bind(&to.parts)
        .bind(kept as i64)
        .fetch_all(work)
        .await?;
    Ok(true)
}

pub(super) async fn idle(pool: &PgPool, time: Duration) -> BlobResult<Vec<UploadId>> {
    let idle = "select digest, size, owner from tessera.uploads where touched <= tessera.now_us() - $1";
    let rows: Vec<Row> = sqlx::query_as(idle).bind(micros(time)).fetch_all(pool).await?;
    Ok(rows.into_iter().map(id).collect())
}

pub(super) async fn stalest(pool: &PgPool, upload: &UploadId, time: Duration) -> BlobResult<Option<UploadId>> {
    let stalest = "select digest, size, owner from tessera.uploads where owner <> $1 and touched <= tessera.now_us() - $2 \
                   order by owner = $3 desc, touched limit 1";
    let stalest = sqlx::query_as(stalest).bind(key_of(None)).bind(micros(time)).bind(key_of(upload.owner));
    let row: Option<Row> = stalest.fetch_optional(pool).await?;
    Ok(row.map(id))
}

/// Keeps removals, and other processes that would show it, away from the bytes of a blob that is about to be shown. Not while
/// there are some. Errors: `UploadNotFound`.
pub(super) async fn show(work: &mut PgConnection, id: &UploadId, process: i64) -> BlobResult<bool> {
    super::blobs::lock(work, &id.digest).await?;
    let free: Option<(bool, bool)> = of!(
        "select shown_by = $4 or tessera.is_free(showing, shown_by), not exists \
         (select from tessera.gone where digest = $1 and removing > tessera.now_ms()) \
         from tessera.uploads where digest = $1 and size = $2 and owner = $3 for no key update",
        id
    )
    .bind(process)
    .fetch_optional(&mut *work)
    .await?;
    match free {
        None => return Err(BlobError::UploadNotFound { digest: id.digest }),
        Some((true, true)) => {}
        Some(_) => return Ok(false),
    }
    let show = "update tessera.uploads set showing = tessera.now_ms() + $4, shown_by = $5 \
                where digest = $1 and size = $2 and owner = $3 returning true";
    let shown: Option<(bool,)> = of!(show, id).bind(micros(SHOWING) / 1000).bind(process).fetch_optional(work).await?;
    Ok(shown.is_some())
}
