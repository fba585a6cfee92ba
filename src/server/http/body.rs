//! The body of a request, as it comes.
//!
//! Purpose: [`Arriving`] reads a body within the limits of uploads; [`whole`] has all of it in memory; [`read_to_the_end`]
//! keeps connections good for the answers of refused uploads. Invariant: what is held
//! is counted in the memory that all uploads share, byte by byte as it is unpacked where `Content-Encoding` says gzip. A body
//! that stalls, takes too long or comes while the server drains is refused. Must not know: what the bytes say.

use std::error::Error;
use std::io::{self, ErrorKind, Write};
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use axum::body::{Body, BodyDataStream, Bytes};
use axum::extract::Request;
use axum::http::header::{CONTENT_ENCODING, CONTENT_LENGTH, EXPECT};
use axum::http::{HeaderMap, Version};
use futures_util::StreamExt as _;
use http_body::{Body as _, Frame, SizeHint};
use tokio::runtime::Handle;
use tokio::time::Instant;

use super::problem::wrong;
use crate::service::{Desk, RequestError};
use geometry::mesh::io::{DataError, unpacked_limit, unpacked_wrong, unpacker};
use jobs::executor::api::JobApiError;
use transport::{Phase, Share};

pub(super) struct Arriving<'a> {
    desk: &'a Desk,
    stream: BodyDataStream,
    deadline: Instant,
}

impl<'a> Arriving<'a> {
    pub(super) fn new(desk: &'a Desk, body: Body) -> Self {
        Self { desk, stream: body.into_data_stream(), deadline: Instant::now() + desk.limits.upload }
    }

    /// The next bytes; `None` at the end.
    pub(super) async fn next(&mut self) -> Result<Option<Bytes>, RequestError> {
        let limits = &self.desk.limits;
        let come = tokio::select! {
            come = tokio::time::timeout(limits.upload_idle, self.stream.next()) => {
                come.map_err(|_| RequestError::Idle(limits.upload_idle))?
            }
            () = tokio::time::sleep_until(self.deadline) => return Err(RequestError::UploadTime(limits.upload)),
            () = self.desk.gate.reached(Phase::Draining) => return Err(RequestError::Draining),
        };
        come.transpose().map_err(|error| broken(&error))
    }
}

/// Why a body came to no end: its client said something that is no HTTP, or has gone.
fn broken(error: &(dyn Error + 'static)) -> RequestError {
    let mut causes = std::iter::successors(Some(error), |&cause| cause.source());
    let is_malformed = causes.any(|cause| {
        let kind = cause.downcast_ref::<std::io::Error>().map(std::io::Error::kind);
        matches!(kind, Some(ErrorKind::InvalidInput | ErrorKind::InvalidData))
    });
    match is_malformed {
        true => wrong("body", "is no HTTP; a length or a chunk is malformed"),
        false => RequestError::ClientGone,
    }
}

/// A body of HTTP/1 whose rest is discarded once nothing reads it any more, beside the answer: a client may read no answer
/// before it has sent everything, and to close a connection while bytes are unread would reset it. Within limits: the rest is
/// the client's loss.
struct Tail {
    body: Body,
    /// The client waits for `100 Continue`, which the first read sends.
    waits: bool,
    ended: bool,
}

/// See [`Tail`].
pub(super) async fn read_to_the_end(request: Request) -> Request {
    if request.version() >= Version::HTTP_2 {
        return request;
    }
    let waits = request.headers().contains_key(EXPECT);
    request.map(|body| Body::new(Tail { ended: body.is_end_stream(), body, waits }))
}

impl http_body::Body for Tail {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Self::Data>, Self::Error>>> {
        self.waits = false;
        let frame = Pin::new(&mut self.body).poll_frame(context);
        self.ended |= matches!(frame, Poll::Ready(None | Some(Err(_))));
        frame
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

impl Drop for Tail {
    fn drop(&mut self) {
        const BYTES: usize = 64 << 20;
        const TIME: Duration = Duration::from_secs(5);
        // Without a runtime the process ends.
        let Ok(runtime) = Handle::try_current() else { return };
        if self.ended || self.waits || self.body.is_end_stream() {
            return;
        }
        let mut stream = std::mem::take(&mut self.body).into_data_stream();
        let reading = async move {
            let mut left = BYTES;
            while let Some(Ok(bytes)) = stream.next().await
                && left > bytes.len()
            {
                left -= bytes.len();
            }
        };
        runtime.spawn(tokio::time::timeout(TIME, reading));
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Coding {
    Plain,
    Gzip,
}

/// How a body comes, as its headers say. Errors: a coding that is not known.
pub(super) fn coding(headers: &HeaderMap) -> Result<Coding, RequestError> {
    let Some(value) = headers.get(CONTENT_ENCODING) else { return Ok(Coding::Plain) };
    match value.to_str().unwrap_or("unreadable").trim().to_ascii_lowercase().as_str() {
        "" | "identity" => Ok(Coding::Plain),
        "gzip" | "x-gzip" => Ok(Coding::Gzip),
        other => Err(wrong("content-encoding", format!("is {other:?}; it must be gzip, or left out"))),
    }
}

pub(super) fn length(headers: &HeaderMap) -> Option<u64> {
    headers.get(CONTENT_LENGTH)?.to_str().ok()?.parse().ok()
}

/// A whole body of a tenant, unpacked, and its memory.
pub(super) async fn whole(
    desk: &Desk,
    tenant: &str,
    headers: &HeaderMap,
    body: Body,
) -> Result<(Bytes, Share), RequestError> {
    let mut arriving = Arriving::new(desk, body);
    let mut kept = Kept { all: Vec::new(), share: desk.budget.upload_of(tenant), limit: usize::MAX, refusal: None };
    if coding(headers)? == Coding::Plain {
        while let Some(bytes) = arriving.next().await? {
            kept.write_all(&bytes).map_err(|error| kept.refused(&error))?;
        }
        return Ok((kept.all.into(), kept.share));
    }
    let length = length(headers).map(|length| usize::try_from(length).unwrap_or(usize::MAX));
    let mut unpacking = unpacker(kept);
    let mut come = 0usize;
    while let Some(bytes) = arriving.next().await? {
        for piece in bytes.chunks(STEP) {
            // Of a body without a length, what has come by now counts.
            come = come.saturating_add(piece.len());
            unpacking.get_mut().limit = unpacked_limit(length.unwrap_or(come));
            unpacking.write_all(piece).map_err(|error| unpacking.get_mut().refused(&error))?;
            tokio::task::yield_now().await;
        }
    }
    unpacking.try_finish().map_err(|error| unpacking.get_mut().refused(&error))?;
    let kept = std::mem::replace(unpacking.get_mut(), Kept::nothing(desk));
    Ok((kept.all.into(), kept.share))
}

/// Packed bytes that are unpacked before others have their turn: at most 4 MiB come of them.
const STEP: usize = 4 << 10;

/// Bytes that are kept, and counted before there is room for them.
struct Kept {
    all: Vec<u8>,
    share: Share,
    limit: usize,
    /// Why no more is taken.
    refusal: Option<RequestError>,
}

impl Kept {
    fn nothing(desk: &Desk) -> Self {
        Self { all: Vec::new(), share: desk.budget.share(), limit: 0, refusal: None }
    }

    /// What an error of writing means.
    fn refused(&mut self, error: &io::Error) -> RequestError {
        if let Some(refusal) = self.refusal.take() {
            return refusal;
        }
        match unpacked_wrong(error, self.limit) {
            DataError::TooLong { limit } => JobApiError::Packed { limit_bytes: limit as u64 }.into(),
            error => wrong("body", format!("is not packed as its Content-Encoding says: {error}")),
        }
    }
}

impl Write for Kept {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.all.len().saturating_add(bytes.len()) > self.limit {
            return Err(io::ErrorKind::FileTooLarge.into());
        }
        if let Err(refusal) = self.share.grow(bytes.len() as u64) {
            self.refusal = Some(refusal.into());
            return Err(io::ErrorKind::OutOfMemory.into());
        }
        self.all.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
