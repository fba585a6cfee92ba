//! The answer to a call with a key.
//!
//! Purpose: [`Held`] keeps the call's place until its answer has left, and ends the answer if the key does.
//! Invariant: bytes go through unchanged; an answer that is cut ends with a status. Must not know: what the bytes say.

use std::future::Future;
use std::pin::Pin;
use std::task::{Context, Poll};

use http_body::{Frame, SizeHint};
use tonic::Status;
use tonic::body::Body;
use tonic::codegen::Bytes;
use tonic::codegen::http::HeaderMap;

use super::super::RequestError;
use super::table::Pass;

pub(super) struct Held {
    body: Body,
    ended: Pin<Box<dyn Future<Output = ()> + Send>>,
    _pass: Pass,
    is_cut: bool,
}

impl Held {
    pub(super) fn new(body: Body, pass: Pass) -> Self {
        Self { body, ended: Box::pin(pass.ended()), _pass: pass, is_cut: false }
    }
}

impl http_body::Body for Held {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Self::Data>, Self::Error>>> {
        if self.is_cut {
            return Poll::Ready(None);
        }
        if self.ended.as_mut().poll(context).is_ready() {
            self.is_cut = true;
            // The work for the answer sees that its client is gone.
            self.body = Body::empty();
            let mut trailers = HeaderMap::new();
            // A status that is no header cannot be: its text is plain.
            let _ = Status::from(RequestError::unauthenticated()).add_header(&mut trailers);
            return Poll::Ready(Some(Ok(Frame::trailers(trailers))));
        }
        Pin::new(&mut self.body).poll_frame(context)
    }

    fn is_end_stream(&self) -> bool {
        self.is_cut || self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        if self.is_cut { SizeHint::with_exact(0) } else { self.body.size_hint() }
    }
}
