//! The port for operators: metrics, health and readiness over HTTP.
//!
//! Purpose: [`serve`] answers `/metrics`, `/healthz`, `/readyz` and `/version` and `/scale` until it is dropped.
//! Invariant: whatever is sent to it, it holds few connections, each for a short time, and takes nothing but a request's
//! head. It answers while the server drains, and no page of another site. Must not know: gRPC, jobs, how faults are found.

use std::collections::VecDeque;
use std::convert::Infallible;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::extract::{Request, State};
use axum::http::header::{ACCEPT, CACHE_CONTROL, CONTENT_TYPE, X_CONTENT_TYPE_OPTIONS};
use axum::http::{HeaderMap, HeaderValue, StatusCode};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use serde_json::json;
use tokio::net::{TcpListener, TcpStream};
use tokio::task::{AbortHandle, JoinSet};

use crate::hosts::{self, Hosts, Reach};
use crate::metrics::{Format, Metrics};
use crate::readiness::Readiness;

/// Connections at once: some scrapers and probes, each with one or two. One more ends the oldest, so that idle connections
/// keep no probe out.
const CONNECTIONS: usize = 32;

/// For the head of a request, counted from the connection's beginning or the last answer.
const HEAD_TIME: Duration = Duration::from_secs(10);

/// For a connection as a whole. Scrapers connect again.
const CONNECTION_TIME: Duration = Duration::from_secs(120);

/// The head of a request, bytes; hyper takes no smaller limit.
const HEAD_BYTES: usize = 16 << 10;

/// Between two tries to accept after one failed.
const PAUSE: Duration = Duration::from_millis(100);

#[derive(Clone)]
pub struct Admin {
    pub metrics: Metrics,
    pub readiness: Readiness,
    pub revision: Option<&'static str>,
    pub hosts: Hosts,
    /// Updates gauges that are read on demand, before each scrape.
    pub look: Arc<dyn Fn() + Send + Sync>,
    /// What an autoscaler wants to know; none if this server is alone.
    pub scale: Arc<dyn Fn() -> Scale + Send + Sync>,
}

pub type Scale = Pin<Box<dyn Future<Output = Option<serde_json::Value>> + Send>>;

pub async fn serve(listener: TcpListener, admin: Admin) -> Infallible {
    let reach = hosts::reach(&listener, Reach::Near);
    let routes = routes(admin, reach);
    let mut open = JoinSet::new();
    let mut ends: VecDeque<AbortHandle> = VecDeque::new();
    loop {
        match listener.accept().await {
            Ok((stream, _)) => {
                let routes = routes.clone();
                ends.push_back(open.spawn(async move {
                    let _ = tokio::time::timeout(CONNECTION_TIME, connection(stream, routes)).await;
                }));
            }
            Err(error) => {
                tracing::debug!(%error, "the admin port could not accept a connection");
                tokio::time::sleep(PAUSE).await;
            }
        }
        while open.try_join_next().is_some() {}
        ends.retain(|end| !end.is_finished());
        while ends.len() > CONNECTIONS
            && let Some(oldest) = ends.pop_front()
        {
            oldest.abort();
        }
    }
}

async fn connection(stream: TcpStream, routes: Router) {
    let served = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEAD_TIME)
        .max_buf_size(HEAD_BYTES)
        .serve_connection(TokioIo::new(stream), TowerToHyperService::new(routes))
        .await;
    if let Err(error) = served {
        tracing::debug!(%error, "a connection of the admin port failed");
    }
}

fn routes(admin: Admin, reach: Reach) -> Router {
    let guard = from_fn_with_state((admin.hosts.clone(), reach), guard);
    Router::new()
        .route("/metrics", get(metrics))
        .route("/healthz", get(|| async { "ok\n" }))
        .route("/readyz", get(readiness))
        .route("/version", get(version))
        .route("/scale", get(scale))
        .layer(guard)
        .with_state(admin)
}

/// Answers no page of another site: the port asks for no key.
async fn guard(State((hosts, reach)): State<(Hosts, Reach)>, request: Request, next: Next) -> Response {
    let mut response = match hosts.check(&request, reach) {
        Ok(()) => next.run(request).await,
        Err(_) => (StatusCode::FORBIDDEN, REFUSED).into_response(),
    };
    response.headers_mut().insert(X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    response
}

const REFUSED: &str = "This port answers requests to its own address alone, and no page of another site; add a name with \
                       --public-host.\n";

async fn metrics(State(admin): State<Admin>, headers: HeaderMap) -> Response {
    let format = Format::of(headers.get(ACCEPT).and_then(|value| value.to_str().ok()));
    (admin.look)();
    ([(CONTENT_TYPE, format.content_type())], admin.metrics.text(format)).into_response()
}

/// An answer in JSON that no proxy keeps.
fn answer(status: StatusCode, value: &serde_json::Value) -> Response {
    (status, [(CONTENT_TYPE, "application/json"), (CACHE_CONTROL, "no-store")], format!("{value}\n")).into_response()
}

async fn readiness(State(admin): State<Admin>) -> Response {
    let condition = admin.readiness.condition();
    let status = if condition.is_ready() { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE };
    answer(status, &condition.describe())
}

async fn scale(State(admin): State<Admin>) -> Response {
    match (admin.scale)().await {
        Some(value) => answer(StatusCode::OK, &value),
        None => (StatusCode::NOT_FOUND, ALONE).into_response(),
    }
}

const ALONE: &str = "No other server shares this one's jobs (--store), or the database does not answer.\n";

async fn version(State(admin): State<Admin>) -> Response {
    answer(StatusCode::OK, &json!({ "version": env!("CARGO_PKG_VERSION"), "revision": admin.revision }))
}

#[cfg(test)]
mod tests {
    use tokio::io::{AsyncReadExt, AsyncWriteExt};

    use super::*;
    use crate::readiness::Reason;

    struct Port {
        address: std::net::SocketAddr,
        readiness: Readiness,
        _serving: JoinSet<Infallible>,
    }

    async fn port() -> Port {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let (address, readiness) = (listener.local_addr().unwrap(), Readiness::new());
        let admin = Admin {
            metrics: Metrics::default(),
            readiness: readiness.clone(),
            revision: Some("abc"),
            hosts: Hosts::default(),
            look: Arc::new(|| {}),
            scale: Arc::new(|| Box::pin(async { None })),
        };
        let mut serving = JoinSet::new();
        serving.spawn(serve(listener, admin));
        Port { address, readiness, _serving: serving }
    }

    /// What a request is answered with.
    async fn ask(port: &Port, request: &str) -> String {
        let mut stream = TcpStream::connect(port.address).await.unwrap();
        stream.write_all(request.as_bytes()).await.unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).await.unwrap();
        answer
    }

    async fn get(port: &Port, path: &str, more: &str) -> String {
        ask(port, &format!("GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n{more}\r\n")).await
    }

    #[tokio::test]
    async fn every_door_answers() {
        let port = port().await;
        assert!(get(&port, "/healthz", "").await.starts_with("HTTP/1.1 200 OK"));
        let version = get(&port, "/version", "").await;
        assert!(version.contains(env!("CARGO_PKG_VERSION")) && version.contains(r#""revision":"abc""#), "{version}");
        let text = get(&port, "/metrics", "").await.to_lowercase();
        assert!(text.contains("content-type: text/plain; version=0.0.4") && !text.contains("# eof"), "{text}");
        let open = get(&port, "/metrics", "Accept: application/openmetrics-text\r\n").await;
        assert!(open.contains("application/openmetrics-text; version=1.0.0") && open.ends_with("# EOF\n"), "{open}");
        assert!(get(&port, "/nothing", "").await.starts_with("HTTP/1.1 404"));
        let post = ask(&port, "POST /metrics HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n").await;
        assert!(post.starts_with("HTTP/1.1 405"), "{post}");
    }

    #[tokio::test]
    async fn readiness_has_its_reasons() {
        let port = port().await;
        assert!(get(&port, "/readyz", "").await.ends_with("{\"ready\":true,\"reasons\":[],\"degraded\":[]}\n"));
        port.readiness.set(Reason::OnCpu, true);
        assert!(get(&port, "/readyz", "").await.ends_with("\"reasons\":[],\"degraded\":[\"on_cpu\"]}\n"));
        port.readiness.set(Reason::OnCpu, false);
        port.readiness.set(Reason::DeviceLost, true);
        port.readiness.set(Reason::Draining, true);
        let answer = get(&port, "/readyz", "").await;
        assert!(answer.starts_with("HTTP/1.1 503"), "{answer}");
        assert!(
            answer.ends_with("{\"ready\":false,\"reasons\":[\"draining\",\"device_lost\"],\"degraded\":[]}\n"),
            "{answer}"
        );
        assert!(get(&port, "/healthz", "").await.starts_with("HTTP/1.1 200"), "the process lives");
    }

    #[tokio::test]
    async fn pages_of_other_sites_read_nothing() {
        let port = port().await;
        for (host, more, status) in [
            ("localhost:9090", "", 200),
            ("evil.example", "", 403),
            ("127.0.0.1", "Origin: http://evil.example\r\n", 403),
            ("127.0.0.1", "Sec-Fetch-Site: cross-site\r\n", 403),
        ] {
            let request = format!("GET /metrics HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n{more}\r\n");
            let answer = ask(&port, &request).await;
            assert!(answer.starts_with(&format!("HTTP/1.1 {status}")), "{host} {more}: {answer}");
            assert!(answer.contains("x-content-type-options: nosniff"), "{answer}");
        }
    }

    #[tokio::test]
    async fn a_head_that_is_too_long_is_refused() {
        let port = port().await;
        let answer = get(&port, "/healthz", &format!("X: {}\r\n", "x".repeat(2 * HEAD_BYTES))).await;
        assert!(answer.starts_with("HTTP/1.1 431"), "{answer}");
    }
}
