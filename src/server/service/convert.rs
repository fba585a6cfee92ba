//! Jobs between messages and records.
//!
//! Purpose: [`job`] has jobs, events and lists; here are their enums and times. A specification needs no conversion: records
//! keep the message.
//! Invariant: an unknown enum value is an error with the path of the field, never a default.
//! Must not know: whether a specification makes sense (`jobs::record`), streams, status codes.

pub(super) mod job;

#[cfg(test)]
mod tests;

use jobs::blob::{Digest, DigestError};
use jobs::record::state::State;
use jobs::record::{FailureKind, JobId, JobIdError, Time};
use wire::codec::{NANOS, milliseconds};
use wire::{WireError, proto};

/// The states of both sides have the same names.
fn state_value(state: State) -> proto::JobState {
    match state {
        State::Queued => proto::JobState::Queued,
        State::Running => proto::JobState::Running,
        State::Succeeded => proto::JobState::Succeeded,
        State::Failed => proto::JobState::Failed,
        State::Cancelled => proto::JobState::Cancelled,
        State::Expired => proto::JobState::Expired,
    }
}

fn state(value: i32) -> Option<State> {
    State::ALL.into_iter().find(|state| i32::from(state_value(*state)) == value)
}

fn failure_value(kind: FailureKind) -> proto::JobFailureKind {
    match kind {
        FailureKind::BadInput => proto::JobFailureKind::BadInput,
        FailureKind::MissingInput => proto::JobFailureKind::MissingInput,
        FailureKind::TooLarge => proto::JobFailureKind::TooLarge,
        FailureKind::Unavailable => proto::JobFailureKind::Unavailable,
        FailureKind::Crashed => proto::JobFailureKind::Crashed,
        FailureKind::Internal => proto::JobFailureKind::Internal,
    }
}

/// A digest at this path.
pub(super) fn digest(path: &str, text: &str) -> Result<Digest, WireError> {
    text.parse().map_err(|error: DigestError| WireError::field(path, format!("is no digest: {error}")))
}

/// The name of a job.
pub(crate) fn job_id(text: &str) -> Result<JobId, WireError> {
    text.parse().map_err(|error: JobIdError| WireError::field("id", format!("names no job: {error}")))
}

/// The first millisecond that is not before a time.
fn time(path: &str, time: prost_types::Timestamp) -> Result<Time, WireError> {
    if !NANOS.contains(&time.nanos) {
        return Err(WireError::field(path, "is no time: nanos go from 0 to 999999999"));
    }
    // No job is older than 1970.
    Ok(u64::try_from(time.seconds).map_or(Time(0), |seconds| Time(milliseconds(seconds, time.nanos))))
}

fn timestamp(Time(ms): Time) -> prost_types::Timestamp {
    let nanos = i32::try_from(ms % 1000).unwrap_or_default() * 1_000_000;
    prost_types::Timestamp { seconds: i64::try_from(ms / 1000).unwrap_or(i64::MAX), nanos }
}
