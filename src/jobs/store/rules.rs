//! What every store decides alike.
//!
//! Purpose: the parts of operations that need no container: versions, what a change writes, why a job expires, what becomes of an
//! orphan. Invariant: nothing here reads or writes. Must not know: tables, SQL, clocks.

use super::StoreError;
use crate::record::event::{Event, Log, What};
use crate::record::state::State;
use crate::record::{Cause, Change, Failure, FailureKind, JobId, Spec, Status, Time};

/// Specifications of a page, encoded: a page is shorter than its limit where they are long.
pub(crate) const PAGE_BYTES: usize = 2 << 20;

/// Errors: `Stale` if a version is asked for and it is another one.
pub(crate) fn at_version(found: u64, id: JobId, at: Option<u64>) -> Result<(), StoreError> {
    match at {
        Some(expected) if expected != found => Err(StoreError::Stale { id, expected, found }),
        _ => Ok(()),
    }
}

/// Status and events of a new job.
pub(crate) fn begun(spec: &Spec, now: Time) -> (Status, Log) {
    let status = Status::new(spec.task().deadlines, now);
    let mut log = Log::default();
    log.push(state_event(&status, 1, now));
    (status, log)
}

/// The status after a change. Errors: `Transition`.
pub(crate) fn changed(
    (id, spec): (JobId, &Spec),
    before: &Status,
    change: Change,
    now: Time,
) -> Result<Status, StoreError> {
    before.changed(spec.task().deadlines, change, now).map_err(|cause| StoreError::Transition { id, cause })
}

/// The event that says that a job came to this status.
pub(crate) fn state_event(status: &Status, number: u64, now: Time) -> Event {
    Event { number, at: now, what: What::State { state: status.state, attempt: status.attempts } }
}

/// Why a job in this state expires when it is due.
pub(crate) fn due_cause(state: State) -> Cause {
    match state {
        State::Queued => Cause::QueueDeadline,
        _ => Cause::RunDeadline,
    }
}

/// What becomes of a job that lost its executor. `is_alone`: nothing else of the executor can have been the cause.
pub(crate) fn orphaned(status: &Status, log: &Log, is_alone: bool, max_crashes: u32) -> Change {
    let times = status.crashes + 1;
    if times < max_crashes || !is_alone {
        return Change::Orphan;
    }
    let stage = log.last_stage().map_or_else(String::new, |stage| format!(" (at its stage \"{stage}\")"));
    let mut message =
        format!("the server went down {times} times with this job, the last time with nothing else at work{stage}");
    let last = status.holder.as_ref().map(|holder| &holder.name);
    let names: Vec<&str> = status.crashed_on.iter().chain(last).map(String::as_str).collect();
    if !names.is_empty() {
        message.push_str(&format!("; it was at work at: {}", names.join(", ")));
    }
    Change::Fail(Failure { kind: FailureKind::Crashed, message })
}
