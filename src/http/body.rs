//! The body of a request, as it comes.
//!
//! Purpose: [`Arriving`] reads a body within the limits of uploads; [`whole`] has all of it in memory. Invariant: what is held
//! is counted in the memory that all uploads share. A body that stalls, takes too long or comes while the server drains is
//! refused. Must not know: what the bytes say.

use std::error::Error;
use std::io::ErrorKind;
use std::time::Duration;

use axum::body::{Body, BodyDataStream, Bytes};
use futures_util::StreamExt as _;
use tokio::time::Instant;

use super::problem::wrong;
use crate::service::{Desk, Phase, RequestError, Share};

/// See the module's head.
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

/// Takes a body that nobody wants, for a client that reads no answer before it has sent everything: to close a connection
/// while bytes are unread would reset it, and the answer would be lost. Within limits: the rest is the client's loss.
pub(super) async fn pass_over(body: Body) {
    const BYTES: usize = 64 << 20;
    const TIME: Duration = Duration::from_secs(5);
    let mut stream = body.into_data_stream();
    let reading = async {
        let mut left = BYTES;
        while let Some(Ok(bytes)) = stream.next().await
            && left > bytes.len()
        {
            left -= bytes.len();
        }
    };
    let _ = tokio::time::timeout(TIME, reading).await;
}

/// A whole body and its memory.
pub(super) async fn whole(desk: &Desk, body: Body) -> Result<(Bytes, Share), RequestError> {
    let mut arriving = Arriving::new(desk, body);
    let mut share = desk.budget.share();
    let mut all = Vec::new();
    while let Some(bytes) = arriving.next().await? {
        share.grow(bytes.len() as u64)?;
        all.extend_from_slice(&bytes);
    }
    Ok((all.into(), share))
}
