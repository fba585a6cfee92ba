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
use axum::http::{Request, Response};
use hyper::body::Incoming;
use hyper_util::rt::TokioTimer;
use hyper_util::server::conn::auto;
use hyper_util::service::TowerToHyperService;
use tokio::sync::watch;

use super::super::Phase;
use super::Common;
use super::connection::{self, EndOnDrop, State};
use super::exchange::{Answer, Exchange};
use super::socket::Line;

/// Smallest buffer that hyper allows for the head of an HTTP/1.1 request, bytes.
const LEAST_HEAD: usize = 8 << 10;

pub(super) async fn serve(
    line: Line,
    state: Arc<State>,
    common: Arc<Common>,
    router: Router,
    phase: watch::Receiver<Phase>,
) {
    let limits = &common.limits;
    let entrance =
        Entrance { state: Arc::clone(&state), common: Arc::clone(&common), routes: TowerToHyperService::new(router) };
    let mut builder = connection::builder(limits, &state);
    builder
        .http1()
        .timer(TokioTimer::new())
        .header_read_timeout(limits.idle_connection.max(limits.first_request))
        .max_buf_size(LEAST_HEAD.max(limits.transport.header_bytes as usize));
    let served = builder.serve_connection(connection::metered(line, limits, &state), entrance);
    connection::run(served, auto::Connection::graceful_shutdown, &state, &common, phase).await;
}

struct Entrance {
    state: Arc<State>,
    common: Arc<Common>,
    routes: TowerToHyperService<Router>,
}

impl hyper::service::Service<Request<Incoming>> for Entrance {
    type Response = Response<Answer<Body>>;
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
