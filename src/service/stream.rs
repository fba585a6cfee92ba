//! Both directions of a stream, with limits on every wait.
//!
//! Purpose: [`Gate`] admits, [`Inbox`] reads with an idle limit, [`Outbox`] writes with a stall limit,
//! [`respond`] runs a handler until it ends or the client goes, the deadline passes, the server cuts.
//! Invariant: a stream that ends without its last message ends with an error, never with OK.
//! Must not know: what the messages say.

use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use tokio::sync::mpsc::error::SendTimeoutError;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc, oneshot, watch};
use tokio_stream::Stream;
use tonic::metadata::MetadataMap;
use tonic::{Response, Status, Streaming};

use super::{Phase, RequestError};
use crate::config::Limits;

/// Messages that wait for the client: a few MiB at most.
const OUTBOX_MESSAGES: usize = 4;

/// Counts streams and sessions, and knows whether the server is on its way out.
#[derive(Clone, Debug)]
pub(crate) struct Gate {
    streams: Arc<Semaphore>,
    sessions: Arc<Semaphore>,
    limits: Limits,
    phase: watch::Receiver<Phase>,
}

impl Gate {
    pub(crate) fn new(limits: Limits, phase: watch::Receiver<Phase>) -> Self {
        let streams = Arc::new(Semaphore::new(limits.max_streams));
        let sessions = Arc::new(Semaphore::new(limits.max_sessions));
        Self { streams, sessions, limits, phase }
    }

    /// Admits a stream.
    pub(crate) fn admit(&self) -> Result<OwnedSemaphorePermit, RequestError> {
        if *self.phase.borrow() != Phase::Serving {
            return Err(RequestError::Draining);
        }
        let full = |_| RequestError::TooMany { what: "streams", limit: self.limits.max_streams };
        Arc::clone(&self.streams).try_acquire_owned().map_err(full)
    }

    /// Admits an interactive session.
    pub(crate) fn admit_session(&self) -> Result<OwnedSemaphorePermit, RequestError> {
        let full = |_| RequestError::TooMany { what: "sessions", limit: self.limits.max_sessions };
        Arc::clone(&self.sessions).try_acquire_owned().map_err(full)
    }

    /// Ready once no stream is open.
    pub(crate) async fn idle(&self) {
        let all = u32::try_from(self.limits.max_streams).unwrap_or(u32::MAX);
        let _ = self.streams.acquire_many(all).await;
    }

    /// Ready once the server is at least so far on its way out.
    pub(crate) async fn reached(&self, phase: Phase) {
        let _ = self.phase.clone().wait_for(|now| *now >= phase).await;
    }
}

/// Messages from the client.
pub(crate) struct Inbox<T> {
    stream: Streaming<T>,
}

impl<T> Inbox<T> {
    pub(crate) fn new(stream: Streaming<T>) -> Self {
        Self { stream }
    }

    /// The next message; `None` once the client has closed its side.
    pub(crate) async fn next(&mut self, idle: Duration) -> Result<Option<T>, RequestError> {
        match tokio::time::timeout(idle, self.stream.message()).await {
            Ok(message) => message.map_err(RequestError::Inbound),
            Err(_) => Err(RequestError::Idle(idle)),
        }
    }
}

/// Messages to the client.
#[derive(Debug)]
pub(crate) struct Outbox<T> {
    sender: mpsc::Sender<T>,
    stall: Duration,
}

impl<T> Outbox<T> {
    /// Sends when there is room.
    pub(crate) async fn send(&self, message: T) -> Result<(), RequestError> {
        self.sender.send_timeout(message, self.stall).await.map_err(|e| match e {
            SendTimeoutError::Timeout(_) => RequestError::Stalled(self.stall),
            SendTimeoutError::Closed(_) => RequestError::ClientGone,
        })
    }
}

/// What tonic polls: the messages, and at their end the status.
#[derive(Debug)]
pub(crate) struct Answers<T> {
    receiver: mpsc::Receiver<T>,
    end: Option<oneshot::Receiver<Option<Status>>>,
}

impl<T> Stream for Answers<T> {
    type Item = Result<T, Status>;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        match self.receiver.poll_recv(context) {
            Poll::Pending => return Poll::Pending,
            Poll::Ready(Some(message)) => return Poll::Ready(Some(Ok(message))),
            Poll::Ready(None) => {}
        }
        let Some(end) = self.end.as_mut() else { return Poll::Ready(None) };
        let status = match Pin::new(end).poll(context) {
            Poll::Pending => return Poll::Pending,
            Poll::Ready(Ok(status)) => status,
            // The handler's task died.
            Poll::Ready(Err(_)) => Some(Status::internal("the request failed by a fault of the server")),
        };
        self.end = None;
        Poll::Ready(status.map(Err))
    }
}

/// Runs `handle` on a task of its own.
pub(crate) fn respond<T, F>(
    method: &'static str,
    metadata: &MetadataMap,
    gate: &Gate,
    handle: impl FnOnce(Outbox<T>) -> F,
) -> Result<Response<Answers<T>>, RequestError>
where
    T: Send + 'static,
    F: Future<Output = Result<(), RequestError>> + Send + 'static,
{
    let permit = gate.admit()?;
    let deadline = timeout(metadata);
    let (sender, receiver) = mpsc::channel(OUTBOX_MESSAGES);
    let (end, ended) = oneshot::channel();
    let watcher = sender.clone();
    let work = handle(Outbox { sender, stall: gate.limits.stall });
    let gate = gate.clone();
    tokio::spawn(async move {
        let start = Instant::now();
        // Boxed, so that it can be dropped, and its work cancelled, before the status leaves.
        let mut work = Box::pin(work);
        let result = tokio::select! {
            result = &mut work => result,
            () = watcher.closed() => Err(RequestError::ClientGone),
            () = sleep(deadline) => Err(RequestError::Deadline),
            () = gate.reached(Phase::Cut) => Err(RequestError::Draining),
        };
        drop(work);
        let ms = start.elapsed().as_secs_f64() * 1e3;
        let status = result.err().map(Status::from);
        match &status {
            None => tracing::info!(method, ms, "done"),
            Some(status) => tracing::info!(method, ms, code = ?status.code(), message = status.message(), "ended"),
        }
        let _ = end.send(status);
        drop(watcher);
        drop(permit);
    });
    Ok(Response::new(Answers { receiver, end: Some(ended) }))
}

async fn sleep(limit: Option<Duration>) {
    match limit {
        Some(limit) => tokio::time::sleep(limit).await,
        None => std::future::pending().await,
    }
}

/// The client's deadline, from the header `grpc-timeout`: digits and a unit.
fn timeout(metadata: &MetadataMap) -> Option<Duration> {
    let text = metadata.get("grpc-timeout")?.to_str().ok()?;
    let (digits, unit) = text.split_at_checked(text.len().checked_sub(1)?)?;
    let value: u64 = digits.parse().ok()?;
    match unit {
        "H" => Some(Duration::from_secs(value.saturating_mul(3600))),
        "M" => Some(Duration::from_secs(value.saturating_mul(60))),
        "S" => Some(Duration::from_secs(value)),
        "m" => Some(Duration::from_millis(value)),
        "u" => Some(Duration::from_micros(value)),
        "n" => Some(Duration::from_nanos(value)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deadlines_are_read() {
        let of = |text: &str| {
            let mut metadata = MetadataMap::new();
            metadata.insert("grpc-timeout", text.parse().unwrap());
            timeout(&metadata)
        };
        assert_eq!(of("20S"), Some(Duration::from_secs(20)));
        assert_eq!(of("150m"), Some(Duration::from_millis(150)));
        assert_eq!(of("x"), None);
        assert_eq!(of(""), None);
        assert_eq!(timeout(&MetadataMap::new()), None);
    }
}
