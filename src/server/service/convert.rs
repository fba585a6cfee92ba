//! Jobs between messages and records.
//!
//! Purpose: jobs, events and lists with their enums and times. A specification needs no conversion: records keep the message.
//! Invariant: a job is answered with its specification as it was given, without tenant, holder and version. An unknown enum value is an error with the path of the field, never a default.
//! Must not know: whether a specification makes sense (`jobs::record`), streams, status codes.

#[cfg(test)]
mod tests;

use prost::Message as _;

use jobs::blob::{Digest, DigestError};
use jobs::executor::api::{Estimate, Reuse};
use jobs::record::event::{Event, Progress, What};
use jobs::record::state::State;
use jobs::record::{Cause, Failure, FailureKind, Holder, Job, JobId, JobIdError, Outcome, ResultSet, Status, Time};
use jobs::store::{Page, Query};
use wire::codec::{NANOS, milliseconds};
use wire::options::choice;
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

pub(super) fn digest(path: &str, text: &str) -> Result<Digest, WireError> {
    text.parse().map_err(|error: DigestError| WireError::field(path, format!("is no digest: {error}")))
}

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

/// The longest page, bytes, unless its only job is longer: below what a client takes by default.
const PAGE_BYTES: usize = 3 << 20;

pub(super) fn message(job: &Job) -> proto::Job {
    let Status {
        state,
        version: _,
        created,
        changed,
        started,
        attempts,
        crashes,
        crashed_on: _,
        due: _,
        holder,
        outcome,
    } = &job.status;
    let (mut failure, mut results, mut expired_by) = (None, Vec::new(), String::new());
    match outcome {
        None => {}
        Some(Outcome::Succeeded(ResultSet { blobs, fingerprint: _ })) => {
            let blob = |(name, digest): (&String, &jobs::blob::Digest)| proto::ResultBlob {
                name: name.clone(),
                digest: digest.to_string(),
            };
            results = blobs.iter().map(blob).collect();
        }
        Some(Outcome::Failed(Failure { kind, message })) => {
            failure = Some(proto::JobFailure { kind: failure_value(*kind).into(), message: message.clone() });
        }
        Some(Outcome::Expired(cause)) => expired_by = cause_name(*cause).to_owned(),
    }
    proto::Job {
        id: job.id.to_string(),
        spec: Some(job.spec.message().clone()),
        state: state_value(*state).into(),
        created: Some(timestamp(*created)),
        started: started.map(timestamp),
        changed: Some(timestamp(*changed)),
        attempts: *attempts,
        crashes: *crashes,
        failure,
        results,
        expired_by,
        request_id: job.spec.request_id.clone(),
        unschedulable: String::new(),
        server: holder.as_ref().and_then(Holder::server).unwrap_or_default().to_owned(),
    }
}

/// Errors: `Field` for a number that is no policy.
pub(crate) fn reuse(policy: i32) -> Result<Reuse, WireError> {
    Ok(match choice("reuse", policy)? {
        proto::ReusePolicy::Unspecified | proto::ReusePolicy::Never => Reuse::Never,
        proto::ReusePolicy::SameBits => Reuse::SameBits,
    })
}

fn cause_name(cause: Cause) -> &'static str {
    match cause {
        Cause::QueueDeadline => "queue_deadline",
        Cause::RunDeadline => "run_deadline",
        Cause::Kept => "kept",
    }
}

pub(super) fn event(event: Event) -> proto::JobEvent {
    use proto::job_event::What as Told;
    let Event { number, at, what } = event;
    let what = match what {
        What::State { state, attempt } => {
            Told::State(proto::JobStateChange { state: state_value(state).into(), attempt })
        }
        What::Progress(Progress::Stage { name, done, total }) => Told::Stage(proto::JobStage { name, done, total }),
        What::Progress(Progress::Iteration { index, total, kind, energy, energy_ratio, gradient_norm, ms }) => {
            Told::Iteration(proto::JobIteration { index, total, kind, energy, energy_ratio, gradient_norm, ms })
        }
    };
    proto::JobEvent { number, at: Some(timestamp(at)), what: Some(what) }
}

pub(super) fn query(request: proto::ListJobsRequest, tenant: String) -> Result<Query, WireError> {
    let proto::ListJobsRequest { page_size, page_token, states, labels, created_since, created_before } = request;
    let one = |(i, value): (usize, i32)| {
        let wrong = || WireError::field(format!("states[{i}]"), format!("is {value}, which is no state"));
        state(value).ok_or_else(wrong)
    };
    let token = match page_token.is_empty() {
        true => None,
        false => Some(page_token.parse().map_err(|_| {
            WireError::field("page_token", "is none that this server gave; leave it empty for the first page")
        })?),
    };
    let limited = |name, given: Option<_>| given.map(|given| time(name, given)).transpose();
    Ok(Query {
        states: states.into_iter().enumerate().map(one).collect::<Result<_, _>>()?,
        labels: labels.into_iter().collect(),
        tenant: Some(tenant),
        since: limited("created_since", created_since)?,
        before: limited("created_before", created_before)?,
        limit: usize::try_from(page_size).unwrap_or(Query::MAX_LIMIT).min(Query::MAX_LIMIT),
        token,
    })
}

/// A page. What does not fit into a message is left for the next.
pub(super) fn page(page: &Page) -> proto::ListJobsResponse {
    let (mut jobs, mut bytes, mut next) = (Vec::new(), 0, page.next);
    let mut last = None;
    for job in &page.jobs {
        let told = message(job);
        bytes += told.encoded_len();
        if let Some(last) = last
            && bytes > PAGE_BYTES
        {
            next = Some(last);
            break;
        }
        last = Some(job.id);
        jobs.push(told);
    }
    proto::ListJobsResponse { jobs, next_page_token: next.map(|token| token.to_string()).unwrap_or_default() }
}

/// What a job would need.
pub(super) fn estimate(estimate: Estimate) -> proto::EstimateJobResponse {
    let Estimate { host_bytes, host_limit_bytes, device_bytes, device_limit_bytes, seconds, fits, unschedulable } =
        estimate;
    let unschedulable = unschedulable.unwrap_or_default();
    proto::EstimateJobResponse {
        host_bytes,
        host_limit_bytes,
        device_bytes,
        device_limit_bytes,
        seconds,
        fits,
        unschedulable,
    }
}
