//! What can be done with one job, as statements of a transaction.
//!
//! Purpose: [`Work`] is a transaction and what it touches; its operations read a row for update, decide by the record's machine as
//! every store does, and write. Invariant: a job's row is locked before its lease, its pins come last. A state changes with its
//! lease, its pins and its event, or not at all. All that comes from outside is bound, never part of a statement.
//! Must not know: connections, which jobs are over.

use std::collections::HashMap;

use sqlx::postgres::PgRow;
use sqlx::{FromRow, PgConnection, PgExecutor, PgTransaction, Postgres, QueryBuilder, Row};

use super::cluster::GPU;
use super::index;
use super::listen::Voice;
use super::pool::Database;
use super::rows::{JobRow, Locked, LockedRow, count, from_json, id_of, number, progress_log, text, to_json};
use crate::blob::{BlobError, Digest, Owner};
use crate::record::event::{Events, Log, Progress, What};
use crate::record::state::State;
use crate::record::{Change, Holder, Job, JobId, Spec, Status, Time};
use crate::store::codec::encode;
use crate::store::pins::{input_pin, over};
use crate::store::{Created, NewJob, Offer, Page, Query, StoreError, rules};

/// Progress that is looked at, the latest: more of a job than its log keeps.
const RECENT: i64 = 256;

type StoreResult<T> = Result<T, StoreError>;

pub(super) struct Work {
    transaction: PgTransaction<'static>,
    /// Jobs with something new to be seen.
    touched: Vec<JobId>,
    /// Whether one of them waits now.
    queued: bool,
}

impl Work {
    pub(super) async fn begin(database: &Database) -> StoreResult<Self> {
        Ok(Self { transaction: database.begin().await?, touched: Vec::new(), queued: false })
    }

    /// Commits what was done and says so, or undoes it. Without a voice the servers find it when they look next.
    pub(super) async fn end<T>(self, done: StoreResult<T>, voice: Option<&Voice>) -> StoreResult<T> {
        if done.is_err() {
            // Unless the connection is lost, and the transaction with it.
            drop(self.transaction.rollback().await);
            return done;
        }
        self.transaction.commit().await?;
        if let Some(voice) = voice {
            voice.say(self.touched, self.queued);
        }
        done
    }

    pub(super) fn connection(&mut self) -> &mut PgConnection {
        &mut self.transaction
    }

    pub(super) async fn now(&mut self) -> StoreResult<Time> {
        let now: i64 = sqlx::query_scalar("select tessera.now_ms()").fetch_one(self.connection()).await?;
        Ok(Time(count(now)))
    }

    pub(super) async fn create(&mut self, new: NewJob) -> StoreResult<Created> {
        let NewJob { random, spec, needs, cost } = new;
        if let Some(job) = requested(self.connection(), &spec).await? {
            return Ok(Created::before(job));
        }
        let now = self.now().await?;
        let id = JobId::new(now, random);
        if !spec.request_id.is_empty() {
            // Waits for another transaction with the same request.
            let kept = sqlx::query(
                "insert into tessera.requests (tenant, request_id, job) values ($1, $2, $3) on conflict do nothing",
            )
            .bind(&spec.tenant)
            .bind(&spec.request_id)
            .bind(id.0.as_slice())
            .execute(self.connection())
            .await?;
            if kept.rows_affected() == 0 {
                let gone = || StoreError::Unavailable { cause: "the same request was deleted meanwhile".to_owned() };
                let job = requested(self.connection(), &spec).await?.ok_or_else(gone)?;
                return Ok(Created::before(job));
            }
        }
        let (status, log) = rules::begun(&spec, now);
        let labels: std::collections::BTreeMap<_, _> = spec.message().labels.iter().collect();
        let kept = sqlx::query(
            "insert into tessera.jobs (id, tenant, request_id, state, version, priority, host_bytes, device_bytes, created, \
             changed, due, labels, spec, status, log, class, cost, weight) \
             values ($1, $2, $3, $4, $5, $6, $7, $8, $9, $9, $10, $11::text::jsonb, $12, $13, $14, $15, $16, $17) \
             on conflict (id) do nothing",
        )
        .bind(id.0.as_slice())
        .bind(&spec.tenant)
        .bind(&spec.request_id)
        .bind(status.state as i16)
        .bind(number(status.version))
        .bind(i16::try_from(spec.task().priority).unwrap_or_default())
        .bind(number(needs.host))
        .bind(number(needs.device))
        .bind(number(now.0))
        .bind(status.due.map(|due| number(due.0)))
        .bind(to_json("labels", &labels)?)
        .bind(encode("spec", &spec)?)
        .bind(to_json("the status", &status)?)
        .bind(to_json("the log", &log)?)
        .bind(if spec.task().needs_gpu() { GPU } else { 0 })
        .bind((cost.seconds.max(0.0) * 1000.0) as i64)
        .bind(if cost.weight > 0.0 && cost.weight.is_finite() { cost.weight } else { 1.0 })
        .execute(self.connection())
        .await?;
        if kept.rows_affected() == 0 {
            return Err(StoreError::NameTaken { id });
        }
        self.hold(Owner::of(&spec.tenant), &input_pin(id), &spec.task().blobs()).await?;
        self.touched.push(id);
        self.queued = true;
        Ok(Created::new(Job { id, spec, status }))
    }

    /// Pins blobs, or none. Errors: `InputMissing`: the first that is not stored.
    async fn hold(&mut self, owner: Owner, name: &str, digests: &[Digest]) -> StoreResult<()> {
        index::pin(self.connection(), Some(owner), name, digests).await.map_err(|error| match error {
            BlobError::NotFound { digest } => StoreError::InputMissing { digest },
            error => StoreError::Unavailable { cause: error.to_string() },
        })
    }

    async fn release(&mut self, names: &[String]) -> StoreResult<()> {
        Ok(index::unpin(self.connection(), names).await?)
    }

    /// Locks a job, once it is free. Errors: `NotFound`.
    async fn lock(&mut self, id: JobId) -> StoreResult<Locked> {
        let row: Option<LockedRow> = sqlx::query_as(
            "select id, spec, status, log, tessera.now_ms() as now from tessera.jobs where id = $1 for update",
        )
        .bind(id.0.as_slice())
        .fetch_optional(self.connection())
        .await?;
        row.ok_or(StoreError::NotFound { id })?.locked()
    }

    /// Locks a job that is there and free. For work on many, so that two such do not wait for each other.
    pub(super) async fn lock_free(&mut self, id: JobId) -> StoreResult<Option<Locked>> {
        let row: Option<LockedRow> = sqlx::query_as(
            "select id, spec, status, log, tessera.now_ms() as now from tessera.jobs where id = $1 for update skip locked",
        )
        .bind(id.0.as_slice())
        .fetch_optional(self.connection())
        .await?;
        row.map(LockedRow::locked).transpose()
    }

    pub(super) async fn change(&mut self, id: JobId, at: u64, change: Change) -> StoreResult<Job> {
        let job = self.lock(id).await?;
        rules::at_version(job.status.version, id, Some(at))?;
        self.apply(job, change).await
    }

    /// Changes a locked job. Errors: `Transition`.
    pub(super) async fn apply(&mut self, job: Locked, change: Change) -> StoreResult<Job> {
        let Locked { id, spec, status: before, mut log, now } = job;
        let status = rules::changed((id, &spec), &before, change, now)?;
        let mut event = log.last() + 1;
        if before.state == State::Running
            && let Some((token, next)) = self.end_lease(id).await?
        {
            log = log.extended(&recent(self.connection(), id, token).await?);
            event = next.max(event);
            self.charge(id, &before, now).await?;
        }
        log.push(rules::state_event(&status, event, now));
        sqlx::query(
            "update tessera.jobs set state = $2, version = $3, changed = $4, due = $5, status = $6, log = $7, \
             fingerprint = $8 where id = $1",
        )
        .bind(id.0.as_slice())
        .bind(status.state as i16)
        .bind(number(status.version))
        .bind(number(status.changed.0))
        .bind(status.due.map(|due| number(due.0)))
        .bind(to_json("the status", &status)?)
        .bind(to_json("the log", &log)?)
        .bind(status.fingerprint().map(|fingerprint| fingerprint.as_bytes().to_vec()))
        .execute(self.connection())
        .await?;
        if let Some(holder) = &status.holder {
            sqlx::query("insert into tessera.leases (job, version, holder, until, length, next) values ($1, $2, $3, $4, $5, $6)")
                .bind(id.0.as_slice())
                .bind(number(status.version))
                .bind(text(&holder.name))
                .bind(number(holder.until.0))
                .bind(number(holder.until.0.saturating_sub(now.0)))
                .bind(number(event + 1))
                .execute(self.connection())
                .await?;
        }
        self.release(&over(id, status.state)).await?;
        self.touched.push(id);
        self.queued |= status.state == State::Queued;
        Ok(Job { id, spec, status })
    }

    /// Charges the tenant what an attempt took beyond what it was charged at its beginning, or gives back what it did not take.
    async fn charge(&mut self, id: JobId, before: &Status, now: Time) -> StoreResult<()> {
        let took_ms = now.0.saturating_sub(before.started.unwrap_or(now).0);
        sqlx::query(
            "insert into tessera.charges (class, tenant, seconds) \
             select class, tenant, ($2 - cost) / 1000.0 / weight from tessera.jobs where id = $1 and cost > 0",
        )
        .bind(id.0.as_slice())
        .bind(number(took_ms))
        .execute(self.connection())
        .await?;
        Ok(())
    }

    /// The token of the lease, and the number of the next event.
    async fn end_lease(&mut self, id: JobId) -> StoreResult<Option<(i64, u64)>> {
        let ended: Option<(i64, i64)> =
            sqlx::query_as("delete from tessera.leases where job = $1 returning token, next")
                .bind(id.0.as_slice())
                .fetch_optional(self.connection())
                .await?;
        Ok(ended.map(|(token, next)| (token, count(next))))
    }

    pub(super) async fn claim_next(&mut self, offer: Offer) -> StoreResult<Option<Job>> {
        let Offer { holder, lease, room, whole, has_gpu, job } = offer;
        let id = match job {
            Some(id) => {
                let charge = sqlx::query(
                    "insert into tessera.charges (class, tenant, seconds) \
                     select class, tenant, cost / 1000.0 / weight from tessera.jobs where id = $1 and state = 0",
                );
                charge.bind(id.0.as_slice()).execute(self.connection()).await?;
                Some(id.0.to_vec())
            }
            None => {
                let next = sqlx::query_scalar("select tessera.next_job($1, $2, $3, $4, $5, $6)")
                    .bind(text(&holder))
                    .bind(number(room.host))
                    .bind(number(room.device))
                    .bind(number(whole.host))
                    .bind(number(whole.device))
                    .bind(if has_gpu { GPU } else { 0 });
                next.fetch_one(self.connection()).await?
            }
        };
        let Some(id) = id else { return Ok(None) };
        let found: Option<LockedRow> = sqlx::query_as(
            "select id, spec, status, log, tessera.now_ms() as now from tessera.jobs where id = $1 and state = 0 for update",
        )
        .bind(id)
        .fetch_optional(self.connection())
        .await?;
        let Some(row) = found else { return Ok(None) };
        let job = row.locked()?;
        let holder = Holder { name: holder, until: job.now.after(lease) };
        self.apply(job, Change::Claim(holder)).await.map(Some)
    }

    /// The events of a locked job, with those of the claim that is at work.
    pub(super) async fn with_progress(&mut self, job: &Locked) -> StoreResult<Log> {
        let token: Option<i64> = sqlx::query_scalar("select token from tessera.leases where job = $1")
            .bind(job.id.0.as_slice())
            .fetch_optional(self.connection())
            .await?;
        Ok(match token {
            Some(token) => job.log.clone().extended(&recent(self.connection(), job.id, token).await?),
            None => job.log.clone(),
        })
    }

    pub(super) async fn cancel(&mut self, id: JobId) -> StoreResult<Job> {
        let job = self.lock(id).await?;
        match job.status.state {
            State::Cancelled => Ok(Job { id, spec: job.spec, status: job.status }),
            _ => self.apply(job, Change::Cancel).await,
        }
    }

    pub(super) async fn delete(&mut self, id: JobId) -> StoreResult<()> {
        let job = self.lock(id).await?;
        let state = job.status.state;
        match state.is_ended() {
            true => self.remove(&job).await,
            false => Err(StoreError::NotEnded { id, state }),
        }
    }

    /// Forgets a locked job that has ended.
    pub(super) async fn remove(&mut self, job: &Locked) -> StoreResult<()> {
        let Locked { id, spec, .. } = job;
        sqlx::query("delete from tessera.jobs where id = $1").bind(id.0.as_slice()).execute(self.connection()).await?;
        if !spec.request_id.is_empty() {
            sqlx::query("delete from tessera.requests where tenant = $1 and request_id = $2")
                .bind(&spec.tenant)
                .bind(&spec.request_id)
                .execute(self.connection())
                .await?;
        }
        self.release(&over(*id, State::Expired)).await?;
        self.touched.push(*id);
        Ok(())
    }
}

/// Progress of a lease, what is looked at of it.
async fn recent(connection: impl PgExecutor<'_>, id: JobId, token: i64) -> StoreResult<Log> {
    let rows: Vec<(i64, i64, String)> =
        sqlx::query_as("select number, at, what from tessera.progress where token = $1 order by number desc limit $2")
            .bind(token)
            .bind(RECENT)
            .fetch_all(connection)
            .await?;
    progress_log(id, rows)
}

pub(super) async fn requested(connection: impl PgExecutor<'_>, wanted: &Spec) -> StoreResult<Option<Job>> {
    if wanted.request_id.is_empty() {
        return Ok(None);
    }
    let row: Option<JobRow> = sqlx::query_as(
        "select j.id, j.spec, j.status, l.until from tessera.requests r join tessera.jobs j on j.id = r.job \
         left join tessera.leases l on l.job = j.id where r.tenant = $1 and r.request_id = $2",
    )
    .bind(&wanted.tenant)
    .bind(&wanted.request_id)
    .fetch_optional(connection)
    .await?;
    let Some(job) = row.map(JobRow::job).transpose()? else { return Ok(None) };
    match job.spec == *wanted {
        true => Ok(Some(job)),
        false => Err(StoreError::AlreadyExists { request_id: wanted.request_id.clone(), id: job.id }),
    }
}

pub(super) async fn same(
    connection: impl PgExecutor<'_>,
    tenant: &str,
    fingerprint: Digest,
) -> StoreResult<Option<Job>> {
    // A job that has ended has no lease.
    let row: Option<JobRow> = sqlx::query_as(
        "select id, spec, status, null::bigint as until from tessera.jobs \
         where tenant = $1 and fingerprint = $2 and state = 2 order by id desc limit 1",
    )
    .bind(tenant)
    .bind(fingerprint.as_bytes().as_slice())
    .fetch_optional(connection)
    .await?;
    row.map(JobRow::job).transpose()
}

pub(super) async fn get(connection: impl PgExecutor<'_>, id: JobId) -> StoreResult<Job> {
    let row: Option<JobRow> = sqlx::query_as(
        "select j.id, j.spec, j.status, l.until from tessera.jobs j left join tessera.leases l on l.job = j.id \
         where j.id = $1",
    )
    .bind(id.0.as_slice())
    .fetch_optional(connection)
    .await?;
    row.ok_or(StoreError::NotFound { id })?.job()
}

/// Jobs that wait, by tenant.
pub(super) async fn waiting(connection: impl PgExecutor<'_>) -> StoreResult<HashMap<String, usize>> {
    let rows: Vec<(String, i64)> =
        sqlx::query_as("select tenant, count(*) from tessera.jobs where state = 0 group by tenant")
            .fetch_all(connection)
            .await?;
    Ok(rows.into_iter().map(|(tenant, jobs)| (tenant, usize::try_from(jobs).unwrap_or(0))).collect())
}

pub(super) async fn list(connection: impl PgExecutor<'_>, query: &Query) -> StoreResult<Page> {
    let limit = query.limit();
    let low = JobId::first_of(query.since.unwrap_or_default());
    let mut high = query.before.map_or([0xff; 16], |before| JobId::first_of(before).0);
    if let Some(last) = query.token {
        high = high.min(last.0);
    }
    let mut texts = query.labels.iter().flat_map(|(key, value)| [key, value]).chain(&query.tenant);
    // No job has such a text.
    if low.0 >= high || texts.any(|text| text.contains('\0')) {
        return Ok(Page::default());
    }
    // Planned anew each time, since labels and tenants differ much in how many jobs they have.
    // The inner query finds a page and one more, to know whether there is another; the outer ends it where specifications are long.
    let mut sql: QueryBuilder<Postgres> = QueryBuilder::new(
        "select p.id, p.spec, p.status, l.until, p.found from (select id, spec, status, count(*) over () as found, \
         sum(octet_length(spec)) over (order by id desc) - octet_length(spec) as ahead from (select id, spec, status \
         from tessera.jobs where id >= ",
    );
    sql.push_bind(low.0.to_vec()).push(" and id < ").push_bind(high.to_vec());
    if let Some(tenant) = &query.tenant {
        sql.push(" and tenant = ").push_bind(tenant);
    }
    match &query.states[..] {
        [] => {}
        [state] => {
            sql.push(" and state = ").push_bind(*state as i16);
        }
        states => {
            let states: Vec<i16> = states.iter().map(|state| *state as i16).collect();
            sql.push(" and state = any(").push_bind(states).push(")");
        }
    }
    if !query.labels.is_empty() {
        sql.push(" and labels @> ").push_bind(to_json("labels", &query.labels)?).push("::text::jsonb");
    }
    sql.push(" order by id desc limit ").push_bind(number(limit as u64 + 1));
    sql.push(") q) p left join tessera.leases l on l.job = p.id where p.ahead <= ");
    sql.push_bind(number(rules::PAGE_BYTES as u64)).push(" order by p.id desc");
    let rows: Vec<ListedRow> = sql.build_query_as().persistent(false).fetch_all(connection).await?;
    let found = rows.first().map_or(0, |row| count(row.found));
    let jobs: Vec<Job> = rows.into_iter().take(limit).map(|row| row.job.job()).collect::<Result<_, _>>()?;
    let next = jobs.last().filter(|_| found > jobs.len() as u64).map(|job| job.id);
    Ok(Page { jobs, next })
}

/// A job of a page, and how many there are of the page and the one more.
struct ListedRow {
    job: JobRow,
    found: i64,
}

impl FromRow<'_, PgRow> for ListedRow {
    fn from_row(row: &PgRow) -> sqlx::Result<Self> {
        Ok(Self { job: JobRow::from_row(row)?, found: row.try_get("found")? })
    }
}

pub(super) async fn renew(
    connection: &mut PgConnection,
    id: JobId,
    at: u64,
    lease: std::time::Duration,
) -> StoreResult<()> {
    let renewed = sqlx::query(
        "update tessera.leases set until = tessera.now_ms() + $3, length = $3 where job = $1 and version = $2",
    )
    .bind(id.0.as_slice())
    .bind(number(at))
    .bind(i64::try_from(lease.as_millis()).unwrap_or(i64::MAX).min(i64::MAX / 4))
    .execute(&mut *connection)
    .await?;
    if renewed.rows_affected() == 0 {
        return Err(not_held(connection, id, at).await);
    }
    Ok(())
}

pub(super) async fn progress(
    connection: &mut PgConnection,
    id: JobId,
    at: u64,
    progress: Progress,
) -> StoreResult<u64> {
    let given: Option<i64> = sqlx::query_scalar(
        "with given as (update tessera.leases set next = next + 1 where job = $1 and version = $2 \
         returning token, next - 1 as number) insert into tessera.progress (token, number, at, what) \
         select token, number, tessera.now_ms(), $3 from given returning number",
    )
    .bind(id.0.as_slice())
    .bind(number(at))
    .bind(to_json("an event", &What::Progress(progress.finite()))?)
    .fetch_optional(&mut *connection)
    .await?;
    match given {
        Some(given) => Ok(count(given)),
        None => Err(not_held(connection, id, at).await),
    }
}

/// Why a job has no lease of version `at`.
async fn not_held(connection: &mut PgConnection, id: JobId, at: u64) -> StoreError {
    match get(connection, id).await {
        Ok(job) => StoreError::Stale { id, expected: at, found: job.status.version },
        Err(error) => error,
    }
}

pub(super) async fn events(connection: &mut PgConnection, id: JobId, after: u64, most: usize) -> StoreResult<Events> {
    let found: Option<(String, Option<i64>)> = sqlx::query_as(
        "select j.log, l.token from tessera.jobs j left join tessera.leases l on l.job = j.id where j.id = $1",
    )
    .bind(id.0.as_slice())
    .fetch_optional(&mut *connection)
    .await?;
    let (log, token) = found.ok_or(StoreError::NotFound { id })?;
    let mut log: Log = from_json("the log", id, &log)?;
    if let Some(token) = token {
        log = log.extended(&recent(connection, id, token).await?);
    }
    Ok(log.after(after, most))
}

/// The names in a column of a query.
pub(super) fn ids(rows: Vec<Vec<u8>>) -> StoreResult<Vec<JobId>> {
    rows.iter().map(|bytes| id_of(bytes)).collect()
}
