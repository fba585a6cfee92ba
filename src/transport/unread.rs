//! Requests that gRPC itself could not read.
//!
//! Invariant: a request that cannot be read is the client's fault, with the code that its kind of fault has. Must not know:
//! messages.

use tonic::body::Body;
use tonic::codegen::http::Response;
use tonic::{Code, Status};

/// The status of a message that could not be read: tonic has others for faults of the server.
pub fn status(status: Status) -> Status {
    match status.code() {
        // A message over the limit.
        Code::OutOfRange => Status::resource_exhausted(status.message()),
        // Whatever is wrong with what a client sends is no fault of the server.
        Code::Internal => Status::invalid_argument(status.message()),
        _ => status,
    }
}

/// An answer from before the handler, with the code of [`status`].
pub(crate) fn answer(response: Response<Body>) -> Response<Body> {
    match Status::from_header_map(response.headers()) {
        // A message that is no protobuf, is missing, ends too early or is longer than it may be.
        Some(found) if matches!(found.code(), Code::Internal | Code::OutOfRange) => status(found).into_http(),
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
            let answer = answer(Status::new(from, "words").into_http());
            let status = Status::from_header_map(answer.headers()).unwrap();
            assert_eq!((status.code(), status.message()), (to, "words"));
        }
        assert!(Status::from_header_map(answer(Response::new(Body::empty())).headers()).is_none());
    }
}
