//! What every request goes through: its key, its place, its time, its count.
//!
//! Purpose: [`guard`] stands before each route, [`unknown`] where there is none. Invariant: nothing is answered before the key
//! was looked at. A request keeps its place, of the server and of its key, until its answer has left or was thrown away; it is
//! counted once, however it ends. Must not know: what is asked.

use std::future::Future;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Instant;

use axum::body::{Body, Bytes};
use axum::extract::{Extension, Request, State};
use axum::http::{HeaderMap, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use http_body::{Frame, SizeHint};
use tracing::{Span, field, info_span};

use super::Route;
use super::problem::Problem;
use crate::metrics::{Metrics, Refused};
use crate::service::{Caller, DESK_TIME, Desk, Fault, FaultKind, Kind, Pass, Refusal, RequestError, tenant_of};
use jobs::places::Place;
use telemetry::trace::{self, TraceContext};
use transport::{Exchange, Phase};

/// How a route that is not served is counted, as OpenTelemetry calls it.
const OTHER: &str = "_OTHER";

#[derive(Clone)]
pub(super) struct Guard {
    pub(super) desk: Desk,
    pub(super) route: Route,
}

/// The caller, as handlers get it.
pub(super) type Whose = Extension<Caller>;

/// Counts a request when it is dropped.
struct Counted {
    metrics: Metrics,
    method: &'static str,
    route: &'static str,
    /// 499 until there is an answer: the client has gone.
    status: u16,
    began: Instant,
}

impl Counted {
    fn new(metrics: &Metrics, method: &'static str, route: &'static str) -> Self {
        Self { metrics: metrics.clone(), method, route, status: 499, began: Instant::now() }
    }

    fn answered(&mut self, response: &Response) {
        self.status = response.status().as_u16();
        if let Some(refused) = response.extensions().get::<Refused>() {
            self.metrics.refused(*refused);
        }
    }
}

impl Drop for Counted {
    fn drop(&mut self) {
        let Self { method, route, status, began, .. } = *self;
        let ms = began.elapsed().as_secs_f64() * 1e3;
        // What a client does wrong is no event of the server.
        match status < 500 {
            true => tracing::debug!(method, route, status, ms, "done"),
            false => tracing::info!(method, route, status, ms, "ended"),
        }
        self.metrics.request(method, route, status, began.elapsed());
    }
}

pub(super) async fn guard(State(guard): State<Guard>, request: Request, next: Next) -> Response {
    let Guard { desk, route } = guard;
    let method = if request.method() == "HEAD" { "HEAD" } else { route.method };
    let mut counted = Counted::new(&desk.metrics, method, route.path);
    let (place, pass, answered) = match enter(&desk, route, request) {
        Ok((request, place, pass)) => {
            let (span, context) = span(method, route.path, request.headers());
            let answering = answer(&desk, route.kind, pass.as_ref(), next.run(request));
            let response = trace::within(context, span, answering).await;
            (Some(place), pass, response)
        }
        Err(error) => (None, None, Err(error)),
    };
    // A refusal is not cut: what ends the call may be its very reason.
    let cut: Cut = match &answered {
        Ok(_) => Box::pin(until_cut(&desk, pass.as_ref())),
        Err(_) => Box::pin(std::future::pending()),
    };
    let response = answered.unwrap_or_else(|error| Problem::from(error).into_response());
    counted.answered(&response);
    response.map(|body| Body::new(Held { body, cut, _pass: pass, _place: place, _counted: counted }))
}

/// What the guard of a path that is open to everybody knows.
#[cfg(feature = "ui")]
#[derive(Clone)]
pub(super) struct Open {
    pub(super) desk: Desk,
    pub(super) path: &'static str,
}

/// Stands before what needs no key: a place, a count, and nothing else.
#[cfg(feature = "ui")]
pub(super) async fn open(State(open): State<Open>, request: Request, next: Next) -> Response {
    let Open { desk, path } = open;
    let method = if request.method() == "HEAD" { "HEAD" } else { "GET" };
    let mut counted = Counted::new(&desk.metrics, method, path);
    let entered = desk.access.check_host(&request).map_err(RequestError::from);
    let tenant = tenant_of(request.headers(), request.extensions());
    let admit = || desk.gate.admit(Kind::Call, &tenant?);
    let (place, response) = match entered.and_then(|()| admit()) {
        Ok(place) => {
            Exchange::admit(request.extensions());
            (Some(place), next.run(request).await)
        }
        Err(error) => (None, Problem::from(error).into_response()),
    };
    counted.answered(&response);
    let cut = until_cut(&desk, None);
    response.map(|body| Body::new(Held { body, cut: Box::pin(cut), _pass: None, _place: place, _counted: counted }))
}

/// What a request does is done in this span, of the trace that its caller names.
fn span(method: &'static str, route: &'static str, headers: &HeaderMap) -> (Span, TraceContext) {
    let span = info_span!(
        parent: None,
        "request",
        otel.name = route,
        otel.kind = "server",
        http.request.method = method,
        http.route = route,
        trace_id = field::Empty,
    );
    let asked = headers.get(trace::TRACEPARENT).and_then(|value| value.to_str().ok());
    let context = trace::join(&span, asked.and_then(TraceContext::parse));
    (span, context)
}

type Entered = (Request, Place, Option<Pass>);

fn enter(desk: &Desk, route: Route, mut request: Request) -> Result<Entered, RequestError> {
    let pass = desk.access.admit(&mut request, Some(route.role))?;
    let tenant = tenant_of(request.headers(), request.extensions())?;
    let place = desk.gate.admit(route.kind, &tenant)?;
    Exchange::admit(request.extensions());
    let bytes = request.extensions().get::<Caller>().and_then(|caller| caller.bytes);
    request.extensions_mut().insert(Caller { tenant, bytes });
    Ok((request, place, pass))
}

/// Ready once an answer has to end early.
type Cut = Pin<Box<dyn Future<Output = RequestError> + Send>>;

/// Waits for an answer, as long as that may take.
async fn answer(
    desk: &Desk,
    kind: Kind,
    pass: Option<&Pass>,
    answering: impl Future<Output = Response>,
) -> Result<Response, RequestError> {
    let late = async {
        match kind {
            Kind::Call => tokio::time::sleep(DESK_TIME).await,
            Kind::Stream | Kind::Watch => std::future::pending().await,
        }
    };
    tokio::select! {
        response = answering => Ok(response),
        () = late => Err(RequestError::Slow(DESK_TIME)),
        error = until_cut(desk, pass) => Err(error),
    }
}

/// Ready once the server cuts what is left, or the key has ended.
fn until_cut(desk: &Desk, pass: Option<&Pass>) -> impl Future<Output = RequestError> + Send + use<> {
    let gate = desk.gate.clone();
    let ended = pass.map(Pass::ended);
    async move {
        let ended = async {
            match ended {
                Some(ended) => ended.await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            () = gate.reached(Phase::Cut) => RequestError::Draining,
            () = ended => RequestError::unauthenticated(),
        }
    }
}

pub(super) async fn unknown(State(desk): State<Desk>, mut request: Request) -> Response {
    let mut counted = Counted::new(&desk.metrics, OTHER, OTHER);
    let response = match desk.access.admit(&mut request, None) {
        // A caller that needs no key, or has a good one, may know what exists.
        Ok(_) | Err(Refusal::Unknown) => {
            let text = "there is no such route, or not with this method; GET /v1/openapi.json lists all";
            let is_route = super::ROUTES.iter().any(|route| matches(route.path, request.uri().path()));
            let status = if is_route { StatusCode::METHOD_NOT_ALLOWED } else { StatusCode::NOT_FOUND };
            Problem(Fault::new(FaultKind::Unimplemented, text)).with_status(status)
        }
        Err(refusal) => Problem::from(refusal).into_response(),
    };
    counted.answered(&response);
    response
}

fn matches(route: &str, path: &str) -> bool {
    let (mut of_route, mut of_path) = (route.split('/'), path.split('/'));
    loop {
        match (of_route.next(), of_path.next()) {
            (None, None) => return true,
            (Some(one), Some(other)) if one == other || (one.starts_with('{') && !other.is_empty()) => {}
            _ => return false,
        }
    }
}

/// The body of an answer, with what is held until it has left.
struct Held {
    body: Body,
    cut: Cut,
    _pass: Option<Pass>,
    _place: Option<Place>,
    _counted: Counted,
}

impl http_body::Body for Held {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Self::Data>, Self::Error>>> {
        if let Poll::Ready(error) = self.cut.as_mut().poll(context) {
            self.cut = Box::pin(std::future::pending());
            self.body = Body::empty();
            return Poll::Ready(Some(Err(axum::Error::new(error))));
        }
        Pin::new(&mut self.body).poll_frame(context)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}
