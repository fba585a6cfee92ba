//! The only place where an error becomes a status code.
//!
//! Purpose: a [`Fault`] in gRPC's words: its code, and google.rpc details. Invariant: nothing is decided here that `fault` has
//! not decided. Must not know: which error it was.

use tonic::body::Body;
use tonic::codegen::http::Response;
use tonic::{Code, Status};
use tonic_types::{ErrorDetails, StatusExt};

use super::RequestError;
use super::fault::{Detail, Fault};

impl From<RequestError> for Status {
    fn from(error: RequestError) -> Self {
        match error {
            RequestError::Inbound(status) => of_inbound(status),
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

/// What the transport says of a message that it could not read.
fn of_inbound(status: Status) -> Status {
    match status.code() {
        // tonic's word for a message over the cap.
        Code::OutOfRange => Status::resource_exhausted(status.message()),
        // Whatever is wrong with what a client sends is no fault of the server.
        Code::Internal => Status::invalid_argument(status.message()),
        _ => status,
    }
}

/// An answer from before the handler, with the documented code: a request that cannot be read is the client's fault.
pub(super) fn of_unread(response: Response<Body>) -> Response<Body> {
    match Status::from_header_map(response.headers()) {
        // The transport's words for a message that is no protobuf, is missing, ends too early or is longer than it may be.
        Some(status) if matches!(status.code(), Code::Internal | Code::OutOfRange) => of_inbound(status).into_http(),
        _ => response,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_read_is_the_client_s_fault() {
        for (from, to) in [
            (Code::Internal, Code::InvalidArgument),
            (Code::OutOfRange, Code::ResourceExhausted),
            (Code::Unauthenticated, Code::Unauthenticated),
            (Code::Unimplemented, Code::Unimplemented),
        ] {
            let answer = of_unread(Status::new(from, "words").into_http());
            let status = Status::from_header_map(answer.headers()).unwrap();
            assert_eq!((status.code(), status.message()), (to, "words"));
        }
        assert!(Status::from_header_map(of_unread(Response::new(Body::empty())).headers()).is_none());
    }
}
