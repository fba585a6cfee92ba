//! Servers that share the database.
//!
//! Purpose: [`beat`] keeps the row of this process; [`overview`] and [`unschedulable`] read those of all. Invariant: each is one
//! statement or two, and locks no job. Only the database's clock says which server is alive. Must not know: how jobs are claimed.

use std::collections::BTreeMap;

use sqlx::postgres::PgRow;
use sqlx::{FromRow, PgConnection, PgExecutor, Row};

use super::rows::{count, id_of, number, text, to_json};
use crate::record::{Bytes, JobId};
use crate::store::StoreError;
use crate::store::shared::{AWAY, Document, Lease, Line, Member, Node, Overview, Role, Unschedulable};

type StoreResult<T> = Result<T, StoreError>;

/// Between two sweeps of any process.
const BETWEEN_SWEEPS_MS: i64 = 900;
/// A server that is away is listed for so long.
const REMEMBERED_MS: i64 = 24 * 3_600_000;
/// Leases that are listed.
const LEASES: i64 = 1000;

/// The class of jobs that need a GPU, as in `jobs.class`.
pub(super) const GPU: i16 = 1;

fn whole(value: u32) -> i32 {
    i32::try_from(value).unwrap_or(i32::MAX)
}

/// Gives whether an operator wants this process to take no more work, and how many are alive beside it.
pub(super) async fn beat(
    connection: impl PgExecutor<'_>,
    (holder, process): (&str, i64),
    node: &Node,
) -> StoreResult<(bool, u32)> {
    let (drain, others): (bool, i64) = sqlx::query_as(
        "insert into tessera.nodes as n (holder, name, role, version, address, class, places, host_bytes, device_bytes, \
         at_work, host_planned, device_planned, process, started, seen) \
         values ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $14, tessera.now_ms(), tessera.now_ms()) \
         on conflict (holder) do update set address = excluded.address, class = excluded.class, places = excluded.places, \
         host_bytes = excluded.host_bytes, device_bytes = excluded.device_bytes, at_work = excluded.at_work, \
         host_planned = excluded.host_planned, device_planned = excluded.device_planned, seen = excluded.seen \
         returning n.drain, (select count(*) from tessera.nodes o where o.holder <> n.holder and o.seen > tessera.now_ms() - $13)",
    )
    .bind(text(holder))
    .bind(text(&node.name))
    .bind(node.role as i16)
    .bind(text(&node.version))
    .bind(text(&node.address))
    .bind(if node.has_gpu { GPU } else { 0 })
    .bind(whole(node.places))
    .bind(number(node.memory.host))
    .bind(number(node.memory.device))
    .bind(whole(node.at_work))
    .bind(number(node.planned.host))
    .bind(number(node.planned.device))
    .bind(away_ms())
    .bind(process)
    .fetch_one(connection)
    .await?;
    Ok((drain, u32::try_from(others).unwrap_or(u32::MAX)))
}

/// Whether this process is the one that sweeps now; it has settled the shares of tenants then.
pub(super) async fn sweeps(connection: &mut PgConnection) -> StoreResult<bool> {
    let swept = sqlx::query(
        "update tessera.pulse set swept = n.now from (select tessera.now_ms() as now) n where n.now - swept >= $1",
    );
    let sweeps = swept.bind(BETWEEN_SWEEPS_MS).execute(&mut *connection).await?.rows_affected() > 0;
    if sweeps {
        sqlx::query("select tessera.settle()").execute(&mut *connection).await?;
        let gone = sqlx::query("delete from tessera.nodes where seen < tessera.now_ms() - $1");
        gone.bind(REMEMBERED_MS).execute(connection).await?;
    }
    Ok(sweeps)
}

pub(super) async fn leave(connection: impl PgExecutor<'_>, holder: &str) -> StoreResult<()> {
    let gone = sqlx::query("delete from tessera.nodes where holder = $1").bind(text(holder));
    Ok(gone.execute(connection).await.map(drop)?)
}

/// Gives or takes back the wish that servers of this name take no more work. Gives how many there are.
pub(super) async fn drain(connection: impl PgExecutor<'_>, name: &str, drain: bool) -> StoreResult<u64> {
    let update = sqlx::query("update tessera.nodes set drain = $2 where name = $1 and seen > tessera.now_ms() - $3");
    let done = update.bind(text(name)).bind(drain).bind(away_ms()).execute(connection).await?;
    Ok(done.rows_affected())
}

pub(super) async fn share_calls(
    connection: &mut PgConnection,
    holder: &str,
    open: BTreeMap<String, u32>,
) -> StoreResult<BTreeMap<String, u32>> {
    let told = sqlx::query("update tessera.nodes set open_calls = $2::text::jsonb where holder = $1");
    told.bind(text(holder)).bind(to_json("open calls", &open)?).execute(&mut *connection).await?;
    let rows: Vec<(String, i64)> = sqlx::query_as(
        "select c.key, sum(c.value::bigint)::bigint from tessera.nodes n, jsonb_each_text(n.open_calls) c \
         where n.holder <> $1 and n.seen > tessera.now_ms() - $2 group by c.key",
    )
    .bind(text(holder))
    .bind(away_ms())
    .fetch_all(connection)
    .await?;
    Ok(rows.into_iter().map(|(key, open)| (key, u32::try_from(open).unwrap_or(u32::MAX))).collect())
}

pub(super) async fn document(connection: impl PgExecutor<'_>, name: &str) -> StoreResult<Option<Document>> {
    let row: Option<(i64, String)> = sqlx::query_as("select version, content from tessera.documents where name = $1")
        .bind(name)
        .fetch_optional(connection)
        .await?;
    Ok(row.map(|(version, content)| Document { version, content }))
}

/// Whether the document was at version `seen`, and now is this.
pub(super) async fn replace(
    connection: impl PgExecutor<'_>,
    (name, seen): (&str, Option<i64>),
    content: &str,
) -> StoreResult<bool> {
    let change = match seen {
        Some(_) => "update tessera.documents set version = version + 1, content = $2 where name = $1 and version = $3",
        None => {
            "insert into tessera.documents (name, content, version) select $1, $2, 1 where $3::bigint is null \
             on conflict do nothing"
        }
    };
    let done = sqlx::query(change).bind(name).bind(text(content)).bind(seen).execute(connection).await?;
    Ok(done.rows_affected() > 0)
}

/// As [`AWAY`].
pub(super) fn away_ms() -> i64 {
    i64::try_from(AWAY.as_millis()).unwrap_or(i64::MAX)
}

pub(super) async fn overview(connection: &mut PgConnection) -> StoreResult<Overview> {
    let members = members(&mut *connection).await?;
    let lines: Vec<(String, i64, i64, i64)> = sqlx::query_as(
        "select tenant, count(*) filter (where state = 0), count(*) filter (where state = 1), \
         coalesce(tessera.now_ms() - min(changed) filter (where state = 0), 0) \
         from tessera.jobs where state in (0, 1) group by tenant order by tenant",
    )
    .fetch_all(&mut *connection)
    .await?;
    let line = |(tenant, queued, running, oldest)| {
        let [queued, running, oldest_ms] = [queued, running, oldest].map(count);
        Line { tenant, queued, running, oldest_ms }
    };
    let leases: Vec<(Vec<u8>, String, i64)> =
        sqlx::query_as("select job, holder, until - tessera.now_ms() from tessera.leases order by until limit $1")
            .bind(LEASES)
            .fetch_all(connection)
            .await?;
    let lease = |(job, holder, left_ms): (Vec<u8>, String, i64)| Ok(Lease { job: id_of(&job)?, holder, left_ms });
    let leases = leases.into_iter().map(lease).collect::<StoreResult<_>>()?;
    Ok(Overview { members, lines: lines.into_iter().map(line).collect(), leases })
}

async fn members(connection: impl PgExecutor<'_>) -> StoreResult<Vec<Member>> {
    let rows: Vec<MemberRow> =
        sqlx::query_as("select *, tessera.now_ms() as now from tessera.nodes order by name, started, holder")
            .fetch_all(connection)
            .await?;
    Ok(rows.into_iter().map(|row| row.0).collect())
}

pub(super) async fn unschedulable(connection: &mut PgConnection, id: JobId) -> StoreResult<Option<Unschedulable>> {
    let job: Option<(i16, i64, i64)> =
        sqlx::query_as("select class, host_bytes, device_bytes from tessera.jobs where id = $1 and state = 0")
            .bind(id.0.as_slice())
            .fetch_optional(&mut *connection)
            .await?;
    let Some((class, host, device)) = job else { return Ok(None) };
    let needs = Bytes { host: count(host), device: count(device) };
    Ok(Unschedulable::of(&members(connection).await?, needs, class >= GPU))
}

struct MemberRow(Member);

impl FromRow<'_, PgRow> for MemberRow {
    fn from_row(row: &PgRow) -> sqlx::Result<Self> {
        let bytes = |host, device| -> sqlx::Result<Bytes> {
            Ok(Bytes { host: count(row.try_get(host)?), device: count(row.try_get(device)?) })
        };
        let numbers = |column| -> sqlx::Result<u32> { Ok(u32::try_from(row.try_get::<i32, _>(column)?).unwrap_or(0)) };
        let node = Node {
            name: row.try_get("name")?,
            // A later program may know more: what it does is not known here.
            role: Role::from_repr(row.try_get("role")?).unwrap_or(Role::Gateway),
            version: row.try_get("version")?,
            address: row.try_get("address")?,
            has_gpu: row.try_get::<i16, _>("class")? >= GPU,
            places: numbers("places")?,
            memory: bytes("host_bytes", "device_bytes")?,
            at_work: numbers("at_work")?,
            planned: bytes("host_planned", "device_planned")?,
        };
        let (now, seen, started): (i64, i64, i64) =
            (row.try_get("now")?, row.try_get("seen")?, row.try_get("started")?);
        Ok(Self(Member {
            node,
            holder: row.try_get("holder")?,
            is_alive: now - seen < away_ms(),
            drains: row.try_get("drain")?,
            seen_ms: count(now - seen),
            up_ms: count(now - started),
        }))
    }
}
