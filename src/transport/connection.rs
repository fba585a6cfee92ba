//! One connection: HTTP on a socket, with time limits.
//!
//! Purpose: [`serve`] runs a connection of gRPC, [`serve_web`] one of HTTP/1.1 and HTTP/2 with a router, until it ends, is
//! closed, or exceeds a limit. Invariant: every stream is cut with its connection; a stream is reset if its client reads
//! nothing; if its bytes remain, the connection is closed. HTTP/1.1 has no streams: its connection is closed. Must not
//! know: other connections, messages, requests and answers.

use std::convert::Infallible;
use std::fmt;
use std::future::Future;
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};

use axum::Router;
use axum::body::Body as WebBody;
use hyper::body::Incoming;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::server::conn::auto;
use hyper_util::service::TowerToHyperService;
use tokio::sync::{Notify, watch};
use tonic::body::Body;
use tonic::codegen::http::{HeaderMap, Request, Response};

use super::account::Account;
use super::arriving::Arriving;
use super::exchange::{Answer, Ending, Exchange, Farewell};
use super::frames::Meter;
use super::places::{Guest, Peer, Standing};
use super::rejection::Rejection;
use super::socket::{Line, Tapped, Traffic};
use super::{Common, ConnectionLimits, Grpc, LINGER, Phase, unread};
use telemetry::trace;

/// Flow-control windows of uploads, bytes: per stream and per connection.
const STREAM_WINDOW: u32 = 1 << 20;
const CONNECTION_WINDOW: u32 = 4 << 20;

/// Bytes of a stream's answer that may wait for the socket.
const SEND_BUFFER: usize = 128 << 10;

const ENCODING: &str = "grpc-encoding";

/// The longest message to health and reflection, bytes.
const QUESTION: u64 = 4 << 10;

/// Time for the goodbye before the socket is closed.
const FINISH_TIME: Duration = Duration::from_secs(1);

/// Time for the bytes of a stream that was cut to go.
const CUT_TIME: Duration = Duration::from_secs(1);

/// Between two looks at a connection's limits.
const LOOK_EVERY: Duration = Duration::from_secs(1);
const LOOK_EVERY_AT_THE_END: Duration = Duration::from_millis(25);

pub(super) struct State {
    pub(super) peer: Peer,
    opened: Instant,
    pub(super) traffic: Arc<Traffic>,
    streams: Mutex<Streams>,
    pub(super) evicted: Notify,
}

struct Streams {
    /// Open, or ended with bytes that wait.
    all: Vec<Arc<Exchange>>,
    /// The request that was taken last, until something runs it.
    taken: Option<Arc<Exchange>>,
    requests: u64,
    /// Time of the last begin or end of a request.
    last: Instant,
}

impl State {
    pub(super) fn new(peer: Peer) -> Self {
        let streams = Streams { all: Vec::new(), taken: None, requests: 0, last: Instant::now() };
        let (opened, traffic) = (Instant::now(), Arc::default());
        Self { peer, opened, traffic, streams: Mutex::new(streams), evicted: Notify::new() }
    }

    pub(super) fn take(&self, exchange: &Arc<Exchange>) {
        let mut streams = self.lock();
        streams.requests += 1;
        streams.last = Instant::now();
        streams.all.push(Arc::clone(exchange));
        streams.taken = Some(Arc::clone(exchange));
    }

    /// The work on a request has ended.
    fn end(&self, exchange: &Exchange) {
        exchange.ended.set();
        self.lock().last = Instant::now();
    }

    fn lock(&self) -> MutexGuard<'_, Streams> {
        super::lock(&self.streams)
    }
}

impl Guest for State {
    fn standing(&self) -> Standing {
        let streams = self.lock();
        match streams.requests {
            0 if !self.traffic.received.is_set() => Standing::Silent,
            0 => Standing::Greeted,
            // A health watch may last forever and needs no key: it occupies no place.
            _ if streams.all.iter().all(|stream| stream.ended.is_set() || stream.is_question) => {
                Standing::Idle(streams.last.elapsed())
            }
            _ => Standing::Busy,
        }
    }

    fn evict(&self) {
        self.evicted.notify_one();
    }
}

/// The state of a connection against its limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Verdict {
    Stays,
    /// Say goodbye, then close.
    Finish(&'static str),
    Close(&'static str),
}

pub(super) async fn serve(
    line: Line,
    state: Arc<State>,
    common: Arc<Common>,
    grpc: Arc<Grpc>,
    phase: watch::Receiver<Phase>,
) {
    let service = Answerer { state: Arc::clone(&state), common: Arc::clone(&common), grpc, phase: phase.clone() };
    let builder = builder(&common.limits, &state).http2_only();
    let connection = builder.serve_connection(metered(line, &common.limits, &state), service);
    run(connection, auto::Connection::graceful_shutdown, &state, &common, phase).await;
}

/// A line whose control frames are counted. HTTP/1.1 has none.
pub(super) fn metered(line: Line, limits: &ConnectionLimits, state: &State) -> TokioIo<Tapped<Line, Meter>> {
    let tap = Meter::new(limits.control_frames, Arc::clone(&state.traffic));
    TokioIo::new(Tapped { stream: line, tap })
}

/// A builder of connections with the limits of HTTP/2.
pub(super) fn builder(limits: &ConnectionLimits, state: &Arc<State>) -> auto::Builder<Spawner> {
    let mut builder = auto::Builder::new(Spawner(Arc::clone(state)));
    builder
        .http2()
        .timer(TokioTimer::new())
        .initial_stream_window_size(STREAM_WINDOW)
        .initial_connection_window_size(CONNECTION_WINDOW)
        .max_concurrent_streams(limits.streams)
        .max_send_buf_size(SEND_BUFFER)
        .max_header_list_size(limits.header_bytes)
        .max_pending_accept_reset_streams(limits.pending_resets)
        .max_local_error_reset_streams(limits.fault_resets)
        .keep_alive_interval(limits.ping_every)
        .keep_alive_timeout(limits.stall.max(limits.ping_timeout));
    builder
}

/// Runs a connection, whatever HTTP is spoken on it, until it ends, has to go, or breaks a limit; `finish` has it end once it
/// has nothing open.
pub(super) async fn run<C, E>(
    connection: C,
    finish: impl Fn(Pin<&mut C>),
    state: &Arc<State>,
    common: &Common,
    mut phase: watch::Receiver<Phase>,
) where
    C: Future<Output = Result<(), E>>,
    E: fmt::Display,
{
    let limits = &common.limits;
    tokio::pin!(connection);
    let look_every = [limits.stall, limits.first_request, limits.idle, limits.first_byte]
        .into_iter()
        .map(|limit| limit / 8)
        .fold(LOOK_EVERY, Duration::min)
        .max(LOOK_EVERY_AT_THE_END);
    let mut leaving = Leaving::default();
    loop {
        let now = *phase.borrow_and_update();
        let pause = if now == Phase::Serving && leaving.finish.is_none() { look_every } else { LOOK_EVERY_AT_THE_END };
        tokio::select! {
            result = connection.as_mut() => {
                if state.traffic.flooded.is_set() {
                    common.closes("a flood of frames that carry nothing");
                } else if let Err(error) = result {
                    tracing::debug!(%error, "a connection failed");
                }
                break;
            }
            () = state.evicted.notified() => break,
            () = tokio::time::sleep(pause) => {}
            Ok(()) = phase.changed() => {}
        }
        match leaving.look(state, common, *phase.borrow()) {
            Verdict::Stays => {}
            Verdict::Finish(why) => {
                tracing::debug!(why, "a connection has to go");
                leaving.finish = Some(Instant::now());
                finish(connection.as_mut());
            }
            Verdict::Close(why) => {
                common.closes(why);
                break;
            }
        }
    }
    let mut streams = state.lock();
    streams.all.drain(..).for_each(|stream| stream.lose());
}

impl Common {
    /// Says that a connection broke a limit, now and then aloud.
    fn closes(&self, why: &'static str) {
        tracing::debug!(why, "a connection is closed");
        if let Some(times) = self.closed.count() {
            tracing::info!(times, why, "closed connections that broke a limit");
        }
    }
}

/// How far a connection is on its way out.
#[derive(Default)]
struct Leaving {
    /// Since when the server drains.
    draining: Option<Instant>,
    /// Since when nothing is open while the server closes.
    quiet: Option<Instant>,
    /// Time of the request to close.
    finish: Option<Instant>,
}

impl Leaving {
    fn look(&mut self, state: &State, common: &Common, phase: Phase) -> Verdict {
        let limits = &common.limits;
        let mut streams = state.lock();
        streams.all.retain(|stream| !stream.ended.is_set() || stream.waiting() > 0);
        if state.traffic.blocked_for() >= limits.stall {
            return Verdict::Close("the client reads nothing");
        }
        for stream in &streams.all {
            if stream.unmoved_for() >= limits.stall {
                if stream.ended.is_set() {
                    return Verdict::Close("the client takes no end of an answer");
                }
                if !stream.cut_stalled() && stream.unmoved_for() >= limits.stall + CUT_TIME {
                    return Verdict::Close("a stream could not be reset");
                }
            }
            if !stream.admitted.is_set() && !stream.answered.is_set() && stream.age() >= limits.first_request {
                stream.cut();
            }
        }
        if phase >= Phase::Draining {
            let since = *self.draining.get_or_insert_with(Instant::now);
            if streams.requests == 0 && state.opened <= since {
                return Verdict::Close("no request came before the shutdown");
            }
            if since.elapsed() >= LINGER {
                // Enough time for a client to read the end of such an answer.
                let idle = streams.all.iter().filter(|stream| !stream.admitted.is_set() && stream.age() >= LINGER);
                idle.for_each(|stream| stream.cut());
            }
        }
        if let Some(since) = self.finish {
            return if since.elapsed() >= FINISH_TIME { Verdict::Close("it did not go") } else { Verdict::Stays };
        }
        let open = !streams.all.is_empty();
        if phase >= Phase::Closing {
            let since = *self.quiet.get_or_insert_with(Instant::now);
            if open {
                self.quiet = None;
            } else if since.elapsed() >= LINGER {
                return Verdict::Finish("the server ends");
            }
            return Verdict::Stays;
        }
        if !state.traffic.received.is_set() && state.opened.elapsed() >= limits.first_byte {
            return Verdict::Close("nothing came");
        }
        if streams.requests == 0 && state.opened.elapsed() >= limits.first_request {
            return Verdict::Close("no request came");
        }
        if streams.requests > 0 && !open && streams.last.elapsed() >= limits.idle {
            return Verdict::Finish("idle for too long");
        }
        Verdict::Stays
    }
}

/// Runs a connection's streams, each until it ends or is cut.
#[derive(Clone)]
pub(super) struct Spawner(pub(super) Arc<State>);

impl<F> hyper::rt::Executor<F> for Spawner
where
    F: Future + Send + 'static,
    F::Output: Send,
{
    fn execute(&self, work: F) {
        // The connection takes a request and has it run before it takes the next.
        let Some(exchange) = self.0.lock().taken.take() else {
            tokio::spawn(work);
            return;
        };
        let end = EndOnDrop { state: Arc::clone(&self.0), exchange };
        tokio::spawn(async move {
            tokio::select! {
                biased;
                () = end.exchange.cut.notified() => {}
                _ = work => {}
            }
        });
    }
}

/// Registers the end of a stream's work at its connection, also after a panic.
pub(super) struct EndOnDrop {
    pub(super) state: Arc<State>,
    pub(super) exchange: Arc<Exchange>,
}

impl Ending for EndOnDrop {
    fn end(&self, _: &HeaderMap) {}
}

impl Drop for EndOnDrop {
    fn drop(&mut self) {
        self.state.end(&self.exchange);
    }
}

struct Answerer {
    state: Arc<State>,
    common: Arc<Common>,
    grpc: Arc<Grpc>,
    phase: watch::Receiver<Phase>,
}

impl hyper::service::Service<Request<Incoming>> for Answerer {
    type Response = Response<Answer<Body>>;
    type Error = Infallible;
    type Future = Pin<Box<dyn Future<Output = Result<Self::Response, Infallible>> + Send>>;

    fn call(&self, mut request: Request<Incoming>) -> Self::Future {
        let uploads = request.uri().path().starts_with(self.grpc.uploads);
        let exchange = Arc::new(Exchange::new(self.common.budget.clone(), !uploads));
        let (account, trace) = Account::open(&self.grpc.calls, &request, &exchange);
        self.state.take(&exchange);
        request.extensions_mut().insert(Arc::clone(&exchange));
        request.extensions_mut().insert(self.state.peer);
        let encoding = request.headers().get(ENCODING).map(|value| value.as_bytes().to_vec());
        let most = if uploads { self.common.limits.message_bytes as u64 } else { QUESTION };
        let budget = self.common.budget.clone();
        let grpc = Arc::clone(&self.grpc);
        let mut phase = self.phase.clone();
        let span = account.span.clone();
        let work = async move {
            let arriving = |body| Body::new(Arriving::new(body, budget, grpc.status, most, encoding));
            let response = (grpc.routes)(request.map(arriving)).await;
            let response = if exchange.admitted.is_set() { response } else { unread::answer(response) };
            exchange.answered.set();
            account.begun(response.status(), response.headers());
            let farewell = (!exchange.admitted.is_set()).then(|| Farewell {
                time: Box::pin(async move {
                    let _ = phase.wait_for(|now| *now >= Phase::Draining).await;
                }),
                trailers: farewell(&grpc),
            });
            Ok(response.map(|body| Answer::new(body, exchange, farewell).with_ending(account)))
        };
        Box::pin(trace::within(trace, span, work))
    }
}

/// The end of answers without work, such as health watches, when the server drains.
fn farewell(grpc: &Grpc) -> HeaderMap {
    let mut trailers = HeaderMap::new();
    // A status that is no header cannot be: its text is plain.
    let _ = (grpc.status)(Rejection::Draining).add_header(&mut trailers);
    trailers
}

/// Smallest buffer that hyper allows for the head of an HTTP/1.1 request, bytes.
const LEAST_HEAD: usize = 8 << 10;

pub(super) async fn serve_web(
    line: Line,
    state: Arc<State>,
    common: Arc<Common>,
    router: Router,
    phase: watch::Receiver<Phase>,
) {
    let limits = &common.limits;
    let entrance =
        Entrance { state: Arc::clone(&state), common: Arc::clone(&common), routes: TowerToHyperService::new(router) };
    let mut builder = self::builder(limits, &state);
    builder
        .http1()
        .timer(TokioTimer::new())
        .header_read_timeout(limits.idle.max(limits.first_request))
        .max_buf_size(LEAST_HEAD.max(limits.header_bytes as usize));
    let served = builder.serve_connection(metered(line, limits, &state), entrance);
    run(served, auto::Connection::graceful_shutdown, &state, &common, phase).await;
}

struct Entrance {
    state: Arc<State>,
    common: Arc<Common>,
    routes: TowerToHyperService<Router>,
}

impl hyper::service::Service<Request<Incoming>> for Entrance {
    type Response = Response<Answer<WebBody>>;
    type Error = Infallible;
    type Future = Pin<Box<dyn Future<Output = Result<Self::Response, Infallible>> + Send>>;

    fn call(&self, mut request: Request<Incoming>) -> Self::Future {
        let exchange = Arc::new(Exchange::new(self.common.budget.clone(), false));
        self.state.take(&exchange);
        let over = EndOnDrop { state: Arc::clone(&self.state), exchange: Arc::clone(&exchange) };
        request.extensions_mut().insert(Arc::clone(&exchange));
        request.extensions_mut().insert(self.state.peer);
        let answering = self.routes.call(request);
        Box::pin(async move {
            let response = answering.await?;
            exchange.answered.set();
            Ok(response.map(|body| Answer::new(body, exchange, None).with_ending(over)))
        })
    }
}
