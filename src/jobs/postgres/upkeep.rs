//! Upkeep: what is over, and what was orphaned.
//!
//! Purpose: [`Work::expire`] and [`Work::recover`], which look for jobs by the indexes and change each as any other operation does.
//! Invariant: doing it again is harmless, also by several processes at once: a job that another transaction has locked is left
//! to the next sweep, and what was found is looked at again under the lock. After the database was away, its clients have time to
//! renew their leases. Must not know: connections.

use std::time::Duration;

use super::cluster::away_ms;
use super::jobs::{Work, ids};
use super::pool::Database;
use super::rows::{id_of, number, text};
use crate::record::state::State;
use crate::record::{Cause, Change, JobId};
use crate::store::{Orphans, Recovered, Retention, StoreError, Swept, rules};

/// Jobs of one transaction.
const MOST: usize = 100;

/// Says that the database answers. Gives since when it does: nothing was heard for longer than `silence` before.
pub(super) async fn pulse(database: &Database, silence: Duration) -> Result<i64, StoreError> {
    let since = sqlx::query_scalar(
        "update tessera.pulse set since = case when n.now - at > $1 then n.now else since end, at = n.now \
         from (select tessera.now_ms() as now) n returning since",
    );
    let silence = i64::try_from(silence.as_millis()).unwrap_or(i64::MAX);
    Ok(since.bind(silence).fetch_one(database.pool()).await?)
}

impl Work {
    pub(super) async fn expire(&mut self, keep: Retention, most: usize) -> Result<Swept, StoreError> {
        let most_now = most.min(MOST);
        let now = self.now().await?;
        let due: Vec<Vec<u8>> = sqlx::query_scalar(
            "select id from tessera.jobs where due is not null and due <= $1 order by due, id limit $2",
        )
        .bind(number(now.0))
        .bind(number(most_now as u64 + 1))
        .fetch_all(self.connection())
        .await?;
        let mut due = ids(due)?;
        let mut more = due.len() > most_now;
        due.truncate(most_now);
        let room = most_now - due.len();
        let before = |kept: Duration| number(now.0).saturating_sub(i64::try_from(kept.as_millis()).unwrap_or(i64::MAX));
        let over: Vec<Vec<u8>> = sqlx::query_scalar(
            "select id from ((select id, changed from tessera.jobs where state = 2 and changed <= $1 order by changed, id \
             limit $3) union all (select id, changed from tessera.jobs where state > 2 and changed <= $2 \
             order by changed, id limit $3)) o order by changed, id limit $3",
        )
        .bind(before(keep.results))
        .bind(before(keep.records))
        .bind(number(room as u64 + 1))
        .fetch_all(self.connection())
        .await?;
        let mut over = ids(over)?;
        more |= over.len() > room;
        over.truncate(room);
        let mut swept = Swept::default();
        for id in due {
            let Some(job) = self.lock_free(id).await? else { continue };
            if job.status.due.is_some_and(|due| due <= job.now) {
                let cause = rules::due_cause(job.status.state);
                self.apply(job, Change::Expire(cause)).await?;
                swept.expired.push(id);
            }
        }
        for id in over {
            let Some(job) = self.lock_free(id).await? else { continue };
            let passed = |kept| job.status.changed.after(kept) <= job.now;
            match job.status.state {
                State::Succeeded if passed(keep.results) => {
                    self.apply(job, Change::Expire(Cause::Kept)).await?;
                    swept.expired.push(id);
                }
                State::Failed | State::Cancelled | State::Expired if passed(keep.records) => {
                    self.remove(&job).await?;
                    swept.deleted.push(id);
                }
                _ => {}
            }
        }
        // Otherwise another process is at it.
        swept.more = more && swept.expired.len() + swept.deleted.len() > 0;
        Ok(swept)
    }

    /// `own` is how this process calls itself. The database answers since the time `since`: a lease that ended before could not
    /// be renewed, and gets its length once more.
    pub(super) async fn recover(
        &mut self,
        orphans: Orphans,
        (own, since): (&str, i64),
        max_crashes: u32,
    ) -> Result<Recovered, StoreError> {
        let own = (orphans == Orphans::All).then(|| text(own));
        let now = self.now().await?;
        // Of several pieces of work of a process any one may be the cause: each job is tried once more, alone. So all leases of a process
        // that is away are taken at once, though they end one after the other.
        let orphaned: Vec<(Vec<u8>, bool, bool)> = sqlx::query_as(
            "with l as (select job, holder, (until <= $1 and length <= $1 - $3) or holder is not distinct from $2 as is_over, \
             count(*) over (partition by holder) = 1 as is_alone from tessera.leases), \
             away as (select holder from tessera.nodes where seen <= $1 - $4 intersect select holder from l where is_over) \
             select job, is_alone, holder in (select holder from away) from l \
             where is_over or holder in (select holder from away) order by job",
        )
        .bind(number(now.0))
        .bind(&own)
        .bind(since)
        .bind(away_ms())
        .fetch_all(self.connection())
        .await?;
        let mut recovered = Recovered::default();
        for (id, is_alone, is_away) in orphaned {
            let id = id_of(&id)?;
            let Some(job) = self.lock_free(id).await? else { continue };
            if !self.is_orphaned(id, (number(now.0), is_away), own.as_deref()).await? {
                continue;
            }
            let log = self.with_progress(&job).await?;
            let change = rules::orphaned(&job.status, &log, is_alone, max_crashes);
            let names = if change == Change::Orphan { &mut recovered.requeued } else { &mut recovered.failed };
            names.push(id);
            self.apply(job, change).await?;
        }
        // Each process claims what it has room for: what waits is of interest at a start alone.
        if orphans == Orphans::All {
            let queued = sqlx::query_scalar("select id from tessera.jobs where state = 0 order by id");
            recovered.queued = ids(queued.fetch_all(self.connection()).await?)?;
        }
        Ok(recovered)
    }

    /// Locks the lease, so that it is not renewed meanwhile.
    async fn is_orphaned(
        &mut self,
        id: JobId,
        (now, is_away): (i64, bool),
        own: Option<&str>,
    ) -> Result<bool, StoreError> {
        let lease: Option<i64> = sqlx::query_scalar(
            "select until from tessera.leases where job = $1 and (until <= $2 or holder = $3 or $4) for update",
        )
        .bind(id.0.as_slice())
        .bind(now)
        .bind(own)
        .bind(is_away)
        .fetch_optional(self.connection())
        .await?;
        Ok(lease.is_some())
    }
}
