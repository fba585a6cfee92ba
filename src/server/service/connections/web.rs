//! A connection that speaks HTTP/1.1 and HTTP/2.
//!
//! Purpose: [`serve`] runs a router on a connection, with the limits of gRPC connections.
//! Invariant: those of `connection`. A stream of HTTP/2 that stalls is reset; HTTP/1.1 has no streams, so its connection is
//! closed.
//! Must not know: requests and answers.

use std::convert::Infallible;
use std::pin::Pin;
use std::sync::Arc;

use axum::Router;
use axum::body::Body;
use axum::http::{HeaderMap, Request, Response};
use hyper::body::Incoming;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::server::conn::auto;
use hyper_util::service::TowerToHyperService;
use tokio::sync::watch;

use super::super::Phase;
use super::Common;
use super::connection::{self, CONNECTION_WINDOW, SEND_BUFFER, STREAM_WINDOW, Spawner, State};
use super::exchange::{Answer, Ending, Exchange};
use super::frames::Metered;
use super::line::Line;

/// Smallest buffer that hyper allows for the head of an HTTP/1.1 request, bytes.
const LEAST_HEAD: usize = 8 << 10;

/// Runs the connection.
pub(super) async fn serve(
    line: Line,
    state: Arc<State>,
    common: Arc<Common>,
    router: Router,
    phase: watch::Receiver<Phase>,
) {
    let limits = &common.limits;
    let transport = limits.transport;
    let entrance =
        Entrance { state: Arc::clone(&state), common: Arc::clone(&common), routes: TowerToHyperService::new(router) };
    // Only HTTP/2 has frames; HTTP/1.1 is not checked.
    let line = Metered::new(line, transport.control_frames, state.traffic());
    let mut builder = auto::Builder::new(Spawner(Arc::clone(&state)));
    builder
        .http1()
        .timer(TokioTimer::new())
        .header_read_timeout(limits.idle_connection.max(limits.first_request))
        .max_buf_size(LEAST_HEAD.max(transport.header_bytes as usize));
    builder
        .http2()
        .timer(TokioTimer::new())
        .initial_stream_window_size(STREAM_WINDOW)
        .initial_connection_window_size(CONNECTION_WINDOW)
        .max_concurrent_streams(connection::streams(limits))
        .max_send_buf_size(SEND_BUFFER)
        .max_header_list_size(transport.header_bytes)
        .max_pending_accept_reset_streams(transport.pending_resets)
        .max_local_error_reset_streams(transport.fault_resets)
        .keep_alive_interval(transport.ping_every)
        .keep_alive_timeout(limits.stall.max(transport.ping_timeout));
    let served = builder.serve_connection(TokioIo::new(line), entrance);
    connection::run(served, auto::Connection::graceful_shutdown, &state, &common, phase).await;
}

/// Hands requests to the router.
struct Entrance {
    state: Arc<State>,
    common: Arc<Common>,
    routes: TowerToHyperService<Router>,
}

/// The request is over when this is dropped.
struct Over {
    state: Arc<State>,
    exchange: Arc<Exchange>,
}

impl Ending for Over {
    fn end(&self, _: &HeaderMap) {}
}

impl Drop for Over {
    fn drop(&mut self) {
        self.state.end(&self.exchange);
    }
}

impl hyper::service::Service<Request<Incoming>> for Entrance {
    type Response = Response<Answer<Body>>;
    type Error = Infallible;
    type Future = Pin<Box<dyn Future<Output = Result<Self::Response, Infallible>> + Send>>;

    fn call(&self, mut request: Request<Incoming>) -> Self::Future {
        let exchange = Arc::new(Exchange::new(self.common.budget.clone()));
        self.state.take(&exchange);
        let over = Over { state: Arc::clone(&self.state), exchange: Arc::clone(&exchange) };
        request.extensions_mut().insert(Arc::clone(&exchange));
        request.extensions_mut().insert(self.state.peer());
        let answering = self.routes.call(request);
        Box::pin(async move {
            let response = answering.await?;
            exchange.answer();
            Ok(response.map(|body| Answer::new(body, exchange, None).told(over)))
        })
    }
}
