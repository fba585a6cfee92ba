//! Rows of jobs between the database and records.
//!
//! Purpose: what a row holds, and reading a job by its parts. Invariant: a record that cannot be read is an error that names the
//! job. Numbers that the database cannot hold become its greatest. Must not know: transactions, states.

use serde::Serialize;
use serde::de::DeserializeOwned;
use sqlx::postgres::PgRow;
use sqlx::{FromRow, Row};

use crate::record::event::{Event, Log};
use crate::record::{Job, JobId, Spec, Status, Time};
use crate::store::StoreError;
use crate::store::codec::decode;

/// A number for the database.
pub(super) fn number(value: u64) -> i64 {
    i64::try_from(value).unwrap_or(i64::MAX)
}

/// A number of the database.
pub(super) fn count(value: i64) -> u64 {
    u64::try_from(value).unwrap_or(0)
}

/// A text for the database, which keeps no NUL.
pub(super) fn text(value: &str) -> String {
    value.replace('\0', "\u{fffd}")
}

fn damaged(what: &str, cause: &dyn std::fmt::Display) -> StoreError {
    StoreError::Damaged { path: what.into(), what: cause.to_string() }
}

pub(super) fn to_json<T: Serialize>(what: &str, value: &T) -> Result<String, StoreError> {
    serde_json::to_string(value).map_err(|error| damaged(what, &error))
}

pub(super) fn from_json<T: DeserializeOwned>(what: &str, id: JobId, json: &str) -> Result<T, StoreError> {
    serde_json::from_str(json).map_err(|error| damaged(&format!("{what} of {id}"), &error))
}

pub(super) fn id_of(bytes: &[u8]) -> Result<JobId, StoreError> {
    bytes.try_into().map(JobId).map_err(|_| damaged("a job's name", &"it has not 16 bytes"))
}

/// A job for reading, with its lease.
pub(super) struct JobRow {
    pub id: Vec<u8>,
    pub spec: Vec<u8>,
    pub status: String,
    /// Of its lease.
    pub until: Option<i64>,
}

impl FromRow<'_, PgRow> for JobRow {
    fn from_row(row: &PgRow) -> sqlx::Result<Self> {
        let (id, spec) = (row.try_get("id")?, row.try_get("spec")?);
        Ok(Self { id, spec, status: row.try_get("status")?, until: row.try_get("until")? })
    }
}

impl JobRow {
    pub(super) fn job(self) -> Result<Job, StoreError> {
        let id = id_of(&self.id)?;
        let mut status: Status = from_json("the status", id, &self.status)?;
        if let (Some(holder), Some(until)) = (&mut status.holder, self.until) {
            holder.until = Time(count(until));
        }
        Ok(Job { id, spec: decode(&format!("specs/{id}"), &self.spec)?, status })
    }
}

pub(super) struct LockedRow {
    id: Vec<u8>,
    spec: Vec<u8>,
    status: String,
    log: String,
    now: i64,
}

impl FromRow<'_, PgRow> for LockedRow {
    fn from_row(row: &PgRow) -> sqlx::Result<Self> {
        let (id, spec, status) = (row.try_get("id")?, row.try_get("spec")?, row.try_get("status")?);
        Ok(Self { id, spec, status, log: row.try_get("log")?, now: row.try_get("now")? })
    }
}

/// A job that a transaction has locked.
pub(super) struct Locked {
    pub id: JobId,
    pub spec: Spec,
    pub status: Status,
    pub log: Log,
    /// The time of the database.
    pub now: Time,
}

impl LockedRow {
    pub(super) fn locked(self) -> Result<Locked, StoreError> {
        let id = id_of(&self.id)?;
        let status: Status = from_json("the status", id, &self.status)?;
        // Read before the lock was had: another change may have come after.
        let now = Time(count(self.now)).max(status.changed);
        let (spec, log) = (decode(&format!("specs/{id}"), &self.spec)?, from_json("the log", id, &self.log)?);
        Ok(Locked { id, spec, status, log, now })
    }
}

/// Progress as a log, of numbers, times and events, the latest first.
pub(super) fn progress_log(id: JobId, rows: Vec<(i64, i64, String)>) -> Result<Log, StoreError> {
    let mut log = Log::default();
    for (number, at, what) in rows.into_iter().rev() {
        log.push(Event { number: count(number), at: Time(count(at)), what: from_json("an event", id, &what)? });
    }
    Ok(log)
}
