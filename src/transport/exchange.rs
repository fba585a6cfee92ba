//! One request and its answer, as the transport sees them.
//!
//! Purpose: [`Exchange`] counts the bytes that wait for the client, and has the time of the last write; [`Answer`] is the
//! answer's body and reports its written bytes. Invariant: every byte of an answer is counted from the service's call until
//! it is written or the stream ends. Must not know: messages, the content of answers.

use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use bytes::Buf;
use http_body::Frame;
use tokio::sync::Notify;
use tonic::Extensions;
use tonic::codegen::{Body, Bytes, http::HeaderMap};

use super::budget::Budget;

/// A state that is reached once.
#[derive(Debug, Default)]
pub(crate) struct Flag(AtomicBool);

impl Flag {
    /// Sets it. Returns whether it was not set before.
    pub(crate) fn set(&self) -> bool {
        !self.0.swap(true, Ordering::AcqRel)
    }

    pub(crate) fn is_set(&self) -> bool {
        self.0.load(Ordering::Acquire)
    }
}

#[derive(Debug)]
pub struct Exchange {
    began: Instant,
    budget: Budget,
    /// Milliseconds from `began` to the last byte that moved.
    moved_ms: AtomicU64,
    /// Bytes that wait for the client.
    waiting: AtomicU64,
    /// Of a request for health or reflection, which does no work.
    pub(super) is_question: bool,
    /// The request is work that was admitted: a shutdown lets it end.
    pub(super) admitted: Flag,
    /// The service has begun its answer.
    pub(super) answered: Flag,
    /// Its work has ended. Bytes may still wait.
    pub(super) ended: Flag,
    /// The server reset it, since its client took nothing.
    pub(super) stalled: Flag,
    /// The server reset it, for any reason.
    pub(super) is_cut: Flag,
    /// Notified once its work has to end.
    pub(super) cut: Notify,
}

impl Exchange {
    pub(super) fn new(budget: Budget, is_question: bool) -> Self {
        Self {
            began: Instant::now(),
            budget,
            moved_ms: AtomicU64::new(0),
            waiting: AtomicU64::new(0),
            is_question,
            admitted: Flag::default(),
            answered: Flag::default(),
            ended: Flag::default(),
            stalled: Flag::default(),
            is_cut: Flag::default(),
            cut: Notify::new(),
        }
    }

    /// Marks the request with these extensions as admitted.
    pub fn admit(extensions: &Extensions) {
        extensions.get::<Arc<Self>>().map(|exchange| exchange.admitted.set());
    }

    /// Whether it was reset since its client took nothing.
    pub fn is_stalled(&self) -> bool {
        self.stalled.is_set()
    }

    pub(super) fn age(&self) -> Duration {
        self.began.elapsed()
    }

    pub(super) fn waiting(&self) -> u64 {
        self.waiting.load(Ordering::Acquire)
    }

    /// How long bytes have waited without one being taken.
    pub(super) fn unmoved_for(&self) -> Duration {
        if self.waiting() == 0 {
            return Duration::ZERO;
        }
        self.began.elapsed().saturating_sub(Duration::from_millis(self.moved_ms.load(Ordering::Acquire)))
    }

    /// Ends the work on it, which resets the stream.
    pub(super) fn cut(&self) {
        self.is_cut.set();
        self.cut.notify_one();
    }

    /// The connection has ended.
    pub(super) fn lose(&self) {
        self.cut.notify_one();
    }

    /// As [`Self::cut`], since the client takes nothing. Returns whether this is the first time.
    pub(super) fn cut_stalled(&self) -> bool {
        let first = self.stalled.set();
        self.cut();
        first
    }

    fn moved(&self) {
        let ms = u64::try_from(self.began.elapsed().as_millis()).unwrap_or(u64::MAX);
        self.moved_ms.store(ms, Ordering::Release);
    }

    /// The service gave bytes. They count as moved: the client has not had them before.
    fn give(&self, bytes: u64) {
        if self.waiting.fetch_add(bytes, Ordering::AcqRel) == 0 {
            self.moved();
        }
        self.budget.charge(bytes);
    }

    /// Bytes have left, or were thrown away with their stream.
    fn leave(&self, bytes: u64) {
        self.moved();
        self.waiting.fetch_sub(bytes, Ordering::AcqRel);
        self.budget.release(bytes);
    }
}

/// Receives the end of an answer. Dropped when the exchange is over.
pub(super) trait Ending: Send {
    /// The answer ends with these trailers.
    fn end(&self, trailers: &HeaderMap);
}

/// Bytes of an answer, each counted until the connection has written it or the rest is dropped.
///
/// Body frames, passed on unchanged. Splitting them at a client's window would halve frames again and again: a slow reader
/// would then get only tiny frames, which clients refuse.
pub(super) struct Counted {
    bytes: Bytes,
    exchange: Arc<Exchange>,
}

impl Buf for Counted {
    fn remaining(&self) -> usize {
        self.bytes.len()
    }

    fn chunk(&self) -> &[u8] {
        &self.bytes
    }

    fn advance(&mut self, count: usize) {
        self.bytes.advance(count);
        self.exchange.leave(count as u64);
    }
}

impl Drop for Counted {
    fn drop(&mut self) {
        if !self.bytes.is_empty() {
            self.exchange.leave(self.bytes.len() as u64);
        }
    }
}

/// Ends an answer without running work.
pub(super) struct Farewell {
    /// Ready when the server wants no such answer any more.
    pub(super) time: Pin<Box<dyn Future<Output = ()> + Send>>,
    /// How the answer ends then.
    pub(super) trailers: HeaderMap,
}

pub(super) struct Answer<B> {
    inner: B,
    exchange: Arc<Exchange>,
    farewell: Option<Farewell>,
    ended: bool,
    ending: Option<Box<dyn Ending>>,
}

impl<B> Answer<B> {
    pub(super) fn new(inner: B, exchange: Arc<Exchange>, farewell: Option<Farewell>) -> Self {
        Self { inner, exchange, farewell, ended: false, ending: None }
    }

    /// `ending` receives the end of the answer, and is dropped with it.
    pub(super) fn with_ending(mut self, ending: impl Ending + 'static) -> Self {
        self.ending = Some(Box::new(ending));
        self
    }

    /// Whether the answer must end, while the service has no frame.
    fn is_over(&mut self, context: &mut Context<'_>) -> Option<HeaderMap> {
        let farewell = self.farewell.as_mut()?;
        farewell.time.as_mut().poll(context).is_ready().then(|| {
            self.ended = true;
            std::mem::take(&mut farewell.trailers)
        })
    }

    fn end(&self, trailers: &HeaderMap) {
        self.ending.iter().for_each(|ending| ending.end(trailers));
    }
}

impl<B: Body<Data = Bytes> + Unpin> Body for Answer<B> {
    type Data = Counted;
    type Error = B::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Self::Data>, Self::Error>>> {
        if self.ended {
            return Poll::Ready(None);
        }
        match Pin::new(&mut self.inner).poll_frame(context) {
            Poll::Pending => {
                let Some(trailers) = self.is_over(context) else { return Poll::Pending };
                self.end(&trailers);
                Poll::Ready(Some(Ok(Frame::trailers(trailers))))
            }
            Poll::Ready(frame) => Poll::Ready(frame.map(|frame| {
                let frame = frame?.map_data(|bytes| {
                    self.exchange.give(bytes.len() as u64);
                    Counted { bytes, exchange: Arc::clone(&self.exchange) }
                });
                if let Some(trailers) = frame.trailers_ref() {
                    self.end(trailers);
                }
                Ok(frame)
            })),
        }
    }

    fn is_end_stream(&self) -> bool {
        self.ended || self.inner.is_end_stream()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tonic::Status;

    /// A body of given frames.
    struct Frames(Vec<Bytes>);

    impl Body for Frames {
        type Data = Bytes;
        type Error = Status;
        fn poll_frame(mut self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
            if self.0.is_empty() {
                return Poll::Pending;
            }
            Poll::Ready(Some(Ok(Frame::data(self.0.remove(0)))))
        }
    }

    fn next(body: &mut Answer<Frames>) -> Option<Frame<Counted>> {
        let mut context = Context::from_waker(std::task::Waker::noop());
        match Pin::new(body).poll_frame(&mut context) {
            Poll::Ready(frame) => frame.map(Result::unwrap),
            Poll::Pending => None,
        }
    }

    #[test]
    fn bytes_are_counted_until_they_are_dropped() {
        let budget = Budget::new(1 << 20);
        let exchange = Arc::new(Exchange::new(budget.clone(), false));
        let data: Vec<u8> = (0..50_000).map(|i| (i % 251) as u8).collect();
        let mut body = Answer::new(Frames(vec![data.clone().into()]), Arc::clone(&exchange), None);
        let mut all = next(&mut body).and_then(|frame| frame.into_data().ok()).unwrap();
        assert!(next(&mut body).is_none());
        assert_eq!((exchange.waiting(), all.remaining()), (50_000, 50_000));
        assert!(!budget.has((1 << 20) - 49_999));
        // A few bytes count, as they are written.
        let mut written = vec![0; 17];
        all.copy_to_slice(&mut written);
        assert_eq!((exchange.waiting(), &written[..]), (49_983, &data[..17]));
        assert_eq!(all.chunk(), &data[17..]);
        drop(all);
        drop(body);
        assert_eq!(exchange.waiting(), 0);
        assert_eq!(exchange.unmoved_for(), Duration::ZERO);
        assert!(budget.has(1 << 20));
    }

    #[test]
    fn a_body_that_goes_early_gives_back_what_it_held() {
        let budget = Budget::new(1 << 20);
        let exchange = Arc::new(Exchange::new(budget.clone(), false));
        let mut body = Answer::new(Frames(vec![vec![0; 50_000].into()]), Arc::clone(&exchange), None);
        let first = next(&mut body);
        assert!(!budget.has(1 << 20));
        drop(body);
        drop(first);
        assert!(budget.has(1 << 20));
    }

    #[test]
    fn an_answer_without_work_ends_when_it_is_time() {
        let exchange = Arc::new(Exchange::new(Budget::new(1 << 20), false));
        let mut trailers = HeaderMap::new();
        trailers.insert("grpc-status", "14".parse().unwrap());
        let farewell = Farewell { time: Box::pin(std::future::ready(())), trailers };
        let mut body = Answer::new(Frames(vec![vec![1].into()]), exchange, Some(farewell));
        assert!(next(&mut body).unwrap().is_data(), "what the service says goes first");
        assert!(next(&mut body).unwrap().is_trailers());
        assert!(next(&mut body).is_none() && body.is_end_stream());
    }
}
