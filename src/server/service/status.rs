//! The only place where an error becomes a status code.
//!
//! Purpose: a [`Fault`] in gRPC's words: its code, and google.rpc details. Invariant: nothing is decided here that `fault` has
//! not decided. Must not know: which error it was.

use tonic::{Code, Status};
use tonic_types::{ErrorDetails, StatusExt};

use super::RequestError;
use super::fault::{Detail, Fault};
use transport::status_of_unread;

impl From<RequestError> for Status {
    fn from(error: RequestError) -> Self {
        match error {
            RequestError::Inbound(status) => status_of_unread(status),
            other => Fault::from(other).into(),
        }
    }
}

impl From<Fault> for Status {
    fn from(fault: Fault) -> Self {
        let (code, text) = (Code::from_i32(fault.kind as i32), fault.text);
        if fault.details.is_empty() {
            return Self::new(code, text);
        }
        let mut details = ErrorDetails::new();
        for detail in fault.details {
            match detail {
                Detail::Field { path, description } => details.add_bad_request_violation(path, description),
                Detail::Retry(after) => details.set_retry_info(Some(after)),
                Detail::Quota { subject, description } => details.add_quota_failure_violation(subject, description),
                Detail::Precondition { kind, subject, description } => {
                    details.add_precondition_failure_violation(kind, subject, description)
                }
                Detail::Missing { kind, name, description } => details.set_resource_info(kind, name, "", description),
            };
        }
        Self::with_error_details(code, text, details)
    }
}
