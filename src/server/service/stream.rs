//! Both directions of a stream, with limits on every wait.
//!
//! Purpose: [`Gate`] admits, [`Inbox`] reads with an idle limit, [`Outbox`] writes as the client takes it,
//! [`respond`] runs a handler until it ends or the client goes, the deadline passes, the server cuts; [`answer`] does the
//! same for a handler that gives one message. Invariant: a stream that ends without its last message ends with an error,
//! never with OK. A stream keeps its place until its answer has left or was thrown away; what waits in between is counted.
//! The transport resets a stream whose client takes nothing. Must not know: what the messages say.

use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use tokio::sync::{mpsc, oneshot, watch};
use tokio_stream::Stream;
use tonic::metadata::MetadataMap;
use tonic::{Extensions, Response, Status, Streaming};

use super::RequestError;
use super::fault::refusal;
use crate::config::Limits;
use crate::metrics::Metrics;
use jobs::places::{Place, Places};
use telemetry::trace;
use transport::{Budget, Exchange, Phase, Share};

/// Messages of a stream that wait for the transport.
const OUTBOX_MESSAGES: usize = 4;

/// Between two looks whether memory for a message is free.
const MEMORY_PAUSE: Duration = Duration::from_millis(20);

/// Kinds of calls. Each has places of its own: watches of jobs take none from work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Uploads, downloads, work.
    Stream,
    /// A question with one answer.
    Call,
    /// Waits for what happens to a job.
    Watch,
}

/// Counts streams and sessions, and knows whether the server is on its way out.
#[derive(Clone, Debug)]
pub struct Gate {
    streams: Places,
    calls: Places,
    watches: Places,
    sessions: Places,
    limits: Limits,
    phase: watch::Receiver<Phase>,
    metrics: Metrics,
}

impl Gate {
    pub fn new(limits: Limits, phase: watch::Receiver<Phase>, metrics: Metrics) -> Self {
        let [streams, calls, watches] = [(); 3].map(|()| Places::new(limits.max_streams));
        let sessions = Places::new(limits.max_sessions);
        Self { streams, calls, watches, sessions, limits, phase, metrics }
    }

    fn note(&self, error: &RequestError) {
        refusal(error).into_iter().for_each(|reason| self.metrics.refused(reason));
    }

    /// A place for a call of a tenant.
    pub fn admit(&self, kind: Kind, tenant: &str) -> Result<Place, RequestError> {
        if *self.phase.borrow() != Phase::Serving {
            return Err(RequestError::Draining);
        }
        let (places, what) = match kind {
            Kind::Stream => (&self.streams, "streams"),
            Kind::Call => (&self.calls, "calls"),
            Kind::Watch => (&self.watches, "watches of jobs"),
        };
        places.take(tenant).ok_or(RequestError::TooMany { what, limit: self.limits.max_streams })
    }

    pub fn admit_session(&self, tenant: &str) -> Result<Place, RequestError> {
        let full = RequestError::TooMany { what: "sessions", limit: self.limits.max_sessions };
        self.sessions.take(tenant).ok_or(full)
    }

    /// Ready once no stream and no call is open.
    pub async fn idle(&self) {
        for places in [&self.streams, &self.calls, &self.watches] {
            places.idle().await;
        }
    }

    /// Ready once the server has reached this phase.
    pub async fn reached(&self, phase: Phase) {
        let _ = self.phase.clone().wait_for(|now| *now >= phase).await;
    }
}

pub(super) struct Inbox<T> {
    stream: Streaming<T>,
}

impl<T> Inbox<T> {
    pub(super) fn new(stream: Streaming<T>) -> Self {
        Self { stream }
    }

    /// The next message; `None` once the client has closed its side.
    pub(super) async fn next(&mut self, idle: Duration) -> Result<Option<T>, RequestError> {
        match tokio::time::timeout(idle, self.stream.message()).await {
            Ok(message) => message.map_err(RequestError::Inbound),
            Err(_) => Err(RequestError::Idle(idle)),
        }
    }
}

#[derive(Debug)]
pub(super) struct Outbox<T> {
    sender: mpsc::Sender<Waiting<T>>,
    budget: Budget,
}

#[derive(Debug)]
struct Waiting<T> {
    message: T,
    _share: Share,
}

impl<T: prost::Message> Outbox<T> {
    /// Counts what is being sent, while it is there as a whole.
    pub(super) fn holding(&self, bytes: usize) -> Share {
        let mut share = self.budget.share();
        share.hold(bytes as u64);
        share
    }

    /// Sends when there is room. One message of a stream may always wait; more wait where memory is free.
    pub(super) async fn send(&self, message: T) -> Result<(), RequestError> {
        let bytes = message.encoded_len() as u64;
        while self.sender.capacity() < self.sender.max_capacity() && !self.budget.has(bytes) {
            tokio::time::sleep(MEMORY_PAUSE).await;
        }
        let place = self.sender.reserve().await.map_err(|_| RequestError::ClientGone)?;
        let mut share = self.budget.share();
        share.hold(bytes);
        place.send(Waiting { message, _share: share });
        Ok(())
    }
}

/// What tonic polls: the messages, and at their end the status.
#[derive(Debug)]
pub(super) struct Answers<T> {
    receiver: mpsc::Receiver<Waiting<T>>,
    end: Option<oneshot::Receiver<Option<Status>>>,
    /// Given back when both the work and the answer are over.
    place: Option<Arc<Place>>,
}

impl<T> Stream for Answers<T> {
    type Item = Result<T, Status>;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        match self.receiver.poll_recv(context) {
            Poll::Pending => return Poll::Pending,
            Poll::Ready(Some(waiting)) => return Poll::Ready(Some(Ok(waiting.message))),
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
        // Before the client has the last message: it may begin anew at once.
        self.place = None;
        Poll::Ready(status.map(Err))
    }
}

/// Runs `work`, which gives one message, until it ends or the deadline passes, the server cuts, or `most` is over. If the
/// client goes, the transport drops all of it.
pub(super) async fn answer<T>(
    (method, kind, tenant): (&'static str, Kind, &str),
    metadata: &MetadataMap,
    extensions: &Extensions,
    gate: &Gate,
    most: Option<Duration>,
    work: impl Future<Output = Result<T, RequestError>>,
) -> Result<Response<T>, Status> {
    let _place = gate.admit(kind, tenant).inspect_err(|error| gate.note(error))?;
    Exchange::admit(extensions);
    let start = Instant::now();
    let result = tokio::select! {
        result = work => result,
        () = sleep(timeout(metadata)) => Err(RequestError::Deadline),
        () = sleep(most) => Err(RequestError::Slow(most.unwrap_or_default())),
        () = gate.reached(Phase::Cut) => Err(RequestError::Draining),
    };
    let ms = start.elapsed().as_secs_f64() * 1e3;
    match result.inspect_err(|error| gate.note(error)).map_err(Status::from) {
        Ok(message) => {
            tracing::debug!(method, ms, "done");
            Ok(Response::new(message))
        }
        Err(status) => {
            tracing::info!(method, ms, code = ?status.code(), message = status.message(), "ended");
            Err(status)
        }
    }
}

/// Runs `handle` on a task of its own.
pub(super) fn respond<T, F>(
    (method, kind, tenant): (&'static str, Kind, &str),
    metadata: &MetadataMap,
    extensions: &Extensions,
    (gate, budget): (&Gate, &Budget),
    handle: impl FnOnce(Outbox<T>) -> F,
) -> Result<Response<Answers<T>>, RequestError>
where
    T: Send + 'static,
    F: Future<Output = Result<(), RequestError>> + Send + 'static,
{
    let place = Arc::new(gate.admit(kind, tenant).inspect_err(|error| gate.note(error))?);
    Exchange::admit(extensions);
    let exchange = extensions.get::<Arc<Exchange>>().cloned();
    let deadline = timeout(metadata);
    let (sender, receiver) = mpsc::channel(OUTBOX_MESSAGES);
    let (end, ended) = oneshot::channel();
    let watcher = sender.clone();
    let work = handle(Outbox { sender, budget: budget.clone() });
    let answers = Answers { receiver, end: Some(ended), place: Some(Arc::clone(&place)) };
    let gate = gate.clone();
    tokio::spawn(trace::carry(async move {
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
        let result = result.map_err(|error| match error {
            RequestError::ClientGone if exchange.is_some_and(|e| e.is_stalled()) => {
                RequestError::Stalled(gate.limits.connections.stall)
            }
            other => other,
        });
        let ms = start.elapsed().as_secs_f64() * 1e3;
        let status = result.inspect_err(|error| gate.note(error)).err().map(Status::from);
        match &status {
            None => tracing::info!(method, ms, "done"),
            Some(status) => tracing::info!(method, ms, code = ?status.code(), message = status.message(), "ended"),
        }
        drop(place);
        let _ = end.send(status);
        drop(watcher);
    }));
    Ok(Response::new(answers))
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
