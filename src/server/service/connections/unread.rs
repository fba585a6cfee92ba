//! Requests that no service could read.
//!
//! Purpose: [`told`] corrects the code of an answer from before the handler: an unreadable request is the client's error.
//! Invariant: answers of handlers are unchanged.
//! Must not know: messages.

use tonic::body::Body;
use tonic::codegen::http::Response;
use tonic::{Code, Status};

use super::super::RequestError;

/// The answer with the documented code, if it comes from the transport.
pub(super) fn told(response: Response<Body>) -> Response<Body> {
    match Status::from_header_map(response.headers()) {
        // The transport's words for a message that is no protobuf, is missing, ends too early or is longer than it may be.
        Some(status) if matches!(status.code(), Code::Internal | Code::OutOfRange) => {
            Status::from(RequestError::Inbound(status)).into_http()
        }
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
            let answer = told(Status::new(from, "words").into_http());
            let status = Status::from_header_map(answer.headers()).unwrap();
            assert_eq!((status.code(), status.message()), (to, "words"));
        }
        assert!(Status::from_header_map(told(Response::new(Body::empty())).headers()).is_none());
    }
}
