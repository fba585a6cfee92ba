//! What an operator asks of the database, without a server.
//!
//! Purpose: [`Operator`] reads who shares the database, drains servers, gives jobs that failed for crashes another try, and checks
//! what is kept. Invariant: it claims nothing and renews nothing. Only [`Operator::migrate`] changes the schema. Must not know: how
//! answers look.

use std::collections::BTreeMap;

use sqlx::PgConnection;

use super::cluster;
use super::jobs::Work;
use super::migrations;
use super::pool::{Database, PostgresOptions};
use super::rows::{JobRow, count};
use crate::record::state::State;
use crate::record::{Bytes, Job, JobId};
use crate::store::shared::{Document, Overview};
use crate::store::{Cost, NewJob, StoreError};

/// Jobs that failed for crashes, as many as are listed.
const DEAD: i64 = 1000;

/// See the module's head.
#[derive(Debug)]
pub struct Operator {
    database: Database,
}

/// What [`Operator::check`] found.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Checked {
    /// Steps of the schema that were done, and those that this program knows.
    pub schema: (i64, i64),
    /// Jobs by state.
    pub jobs: BTreeMap<&'static str, u64>,
    /// What does not agree; none if all is well.
    pub faults: Vec<String>,
}

impl Operator {
    /// Connects. The schema stays as it is. Errors: `Unusable`, `Unavailable`; `UnknownVersion` if its schema needs a later program.
    pub async fn connect(options: &PostgresOptions) -> Result<Self, StoreError> {
        Ok(Self { database: Database::connect(options).await? })
    }

    /// Connects, and does the steps of the schema that are missing. Gives how many there were, and how many there are. Errors: as
    /// [`Self::connect`].
    pub async fn migrate(options: &PostgresOptions) -> Result<(i64, i64), StoreError> {
        Database::migrate(options).await
    }

    pub async fn overview(&self) -> Result<Overview, StoreError> {
        let overview = async {
            let mut connection = self.database.pool().acquire().await?;
            cluster::overview(&mut connection).await
        };
        self.database.run(overview).await
    }

    /// Wants all servers of this name to take no more work, or to take work again. Gives how many of them are alive.
    pub async fn drain(&self, name: &str, drain: bool) -> Result<u64, StoreError> {
        cluster::drain(self.database.pool(), name, drain).await
    }

    /// Jobs that failed since servers went down with them and that were not tried again, the newest first, a thousand at most.
    pub async fn dead(&self) -> Result<Vec<Job>, StoreError> {
        let rows: Vec<JobRow> = sqlx::query_as(
            "select id, spec, status, null::bigint as until from tessera.jobs j where state = $1 \
             and status::jsonb #>> '{outcome,failed,kind}' = 'crashed' and not exists (select from tessera.requests r \
             where r.tenant = j.tenant and r.request_id = 'requeue-' || encode(j.id, 'hex')) order by id desc limit $2",
        )
        .bind(State::Failed as i16)
        .bind(DEAD)
        .fetch_all(self.database.pool())
        .await?;
        rows.into_iter().map(JobRow::job).collect()
    }

    /// Makes a new job of what one was asked to do that failed since servers went down with it. The old one stays as it is, and
    /// a second call gives the same new one. Errors: `NotFound` if there is no such job; `InputMissing` if its input is gone.
    pub async fn requeue(&self, id: JobId) -> Result<Job, StoreError> {
        let row: Option<JobRow> = sqlx::query_as(
            "select id, spec, status, null::bigint as until from tessera.jobs where id = $1 and state = $2 \
             and status::jsonb #>> '{outcome,failed,kind}' = 'crashed'",
        )
        .bind(id.0.as_slice())
        .bind(State::Failed as i16)
        .fetch_optional(self.database.pool())
        .await?;
        let dead = row.ok_or(StoreError::NotFound { id })?.job()?;
        let (host, device, cost, weight): (i64, i64, i64, f64) =
            sqlx::query_as("select host_bytes, device_bytes, cost, weight from tessera.jobs where id = $1")
                .bind(id.0.as_slice())
                .fetch_one(self.database.pool())
                .await?;
        let mut bytes = [0; 16];
        getrandom::fill(&mut bytes).map_err(|error| StoreError::Unusable { cause: error.to_string() })?;
        let random = u128::from_le_bytes(bytes);
        let mut spec = dead.spec;
        spec.request_id = format!("requeue-{id}");
        let needs = Bytes { host: count(host), device: count(device) };
        let cost = Cost { seconds: cost as f64 / 1000.0, weight };
        let mut work = Work::begin(&self.database).await?;
        let done = work.create(NewJob { random, spec, needs, cost }).await;
        let created = work.end(done, None).await?;
        Ok(created.job)
    }

    /// A text that all servers read.
    pub async fn document(&self, name: &str) -> Result<Option<Document>, StoreError> {
        cluster::document(self.database.pool(), name).await
    }

    /// Changes a text from the version that was seen; none if there was none. `false` if it has another one now.
    pub async fn replace(&self, name: &str, seen: Option<i64>, content: &str) -> Result<bool, StoreError> {
        cluster::replace(self.database.pool(), (name, seen), content).await
    }

    /// Looks whether what is kept agrees. Changes nothing.
    pub async fn check(&self) -> Result<Checked, StoreError> {
        let mut connection = self.database.pool().acquire().await?;
        let schema = (migrations::done(&mut connection).await?, migrations::known());
        let mut checked = Checked { schema, ..Checked::default() };
        if schema.0 < schema.1 {
            checked.faults.push("the schema lacks steps; `tessera store migrate` does them".to_owned());
            return Ok(checked);
        }
        let states: Vec<(i16, i64)> = sqlx::query_as("select state, count(*) from tessera.jobs group by state")
            .fetch_all(&mut *connection)
            .await?;
        for state in State::ALL {
            let jobs = states.iter().find(|(number, _)| *number == state as i16).map_or(0, |(_, jobs)| count(*jobs));
            checked.jobs.insert(state.name(), jobs);
        }
        for (what, query) in FAULTS {
            let found = number(&mut connection, query).await?;
            if found > 0 {
                checked.faults.push(format!("{found} {what}"));
            }
        }
        Ok(checked)
    }
}

async fn number(connection: &mut PgConnection, query: &'static str) -> Result<i64, StoreError> {
    Ok(sqlx::query_scalar(query).fetch_one(connection).await?)
}

/// What must not be, and how many there are.
const FAULTS: [(&str, &str); 5] = [
    (
        "running jobs without a lease: nothing takes them back",
        "select count(*) from tessera.jobs j where state = 1 and not exists (select from tessera.leases l where l.job = j.id)",
    ),
    (
        "leases of jobs that do not run",
        "select count(*) from tessera.leases l where not exists (select from tessera.jobs j where j.id = l.job and j.state = 1)",
    ),
    (
        "requests of jobs that are gone",
        "select count(*) from tessera.requests r where not exists (select from tessera.jobs j where j.id = r.job)",
    ),
    (
        "queued jobs whose input is not pinned",
        "select count(*) from tessera.jobs j where state = 0 \
         and not exists (select from tessera.pins p where p.name = 'input:' || encode(j.id, 'hex'))",
    ),
    (
        "blobs that are more or fewer than what was counted",
        "select abs((select count(*) from tessera.blobs) - (select coalesce(sum(blobs), 0) from tessera.amounts))::bigint",
    ),
];
