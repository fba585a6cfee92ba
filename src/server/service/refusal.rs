//! Errors that count as refusals.
//!
//! Invariant: what is wrong with a request is no refusal; what a retry, another server or an operator mends is one.
//! Must not know: how refusals are counted, status codes of our own errors.

use tonic::Code;

use super::RequestError;
use crate::metrics::Refused;
use geometry::rvd::RvdError;
use jobs::JobError;
use jobs::blob::BlobError;
use jobs::executor::api::JobApiError;

pub(super) fn of(error: &RequestError) -> Option<Refused> {
    match error {
        RequestError::Memory { .. } => Some(Refused::Memory),
        RequestError::MessageTooLong { .. } => Some(Refused::MessageSize),
        RequestError::TooMany { .. } => Some(Refused::Streams),
        RequestError::Draining => Some(Refused::Draining),
        RequestError::Job(error) | RequestError::JobApi(JobApiError::Job(error)) => of_job(error),
        RequestError::Blob(error) | RequestError::JobApi(JobApiError::Blob(error)) => of_blob(error),
        RequestError::JobApi(JobApiError::TooLarge { .. } | JobApiError::Packed { .. }) => Some(Refused::TooLarge),
        // The transport's word for a message that is too long, and ours for memory that is used up.
        RequestError::Inbound(status) => match status.code() {
            Code::OutOfRange => Some(Refused::MessageSize),
            Code::ResourceExhausted => Some(Refused::Memory),
            _ => None,
        },
        _ => None,
    }
}

fn of_job(error: &JobError) -> Option<Refused> {
    match error {
        JobError::QueueFull { .. } => Some(Refused::Queue),
        JobError::Draining => Some(Refused::Draining),
        _ => match error.as_rvd()? {
            RvdError::OutOfMemory { .. } => Some(Refused::Memory),
            RvdError::NeverFits { .. } => Some(Refused::TooLarge),
            _ => None,
        },
    }
}

fn of_blob(error: &BlobError) -> Option<Refused> {
    match error {
        BlobError::QuotaExceeded { .. } | BlobError::TooManyUploads { .. } | BlobError::StorageFull => {
            Some(Refused::Storage)
        }
        BlobError::TooLarge { .. } => Some(Refused::TooLarge),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::token::Stopped;
    use jobs::executor::api::Memory;
    use wire::WireError;

    #[test]
    fn faults_of_a_request_are_no_refusals() {
        assert_eq!(of(&WireError::Order("no").into()), None);
        assert_eq!(of(&JobError::from(Stopped::Cancelled).into()), None);
        assert_eq!(of(&JobError::from(RvdError::NoSeeds).into()), None);
        assert_eq!(of(&RequestError::Deadline), None);
    }

    #[test]
    fn what_may_succeed_elsewhere_is_one() {
        let full = JobError::QueueFull { waiting: 1, retry_after: std::time::Duration::ZERO };
        assert_eq!(of(&full.clone().into()), Some(Refused::Queue));
        assert_eq!(of(&JobApiError::Job(full).into()), Some(Refused::Queue));
        assert_eq!(
            of(&JobApiError::TooLarge { of: Memory::Host, needed_bytes: 2, limit_bytes: 1 }.into()),
            Some(Refused::TooLarge)
        );
        assert_eq!(of(&BlobError::StorageFull.into()), Some(Refused::Storage));
        assert_eq!(of(&RequestError::Draining), Some(Refused::Draining));
    }
}
