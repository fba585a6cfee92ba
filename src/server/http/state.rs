//! What the server says of itself over HTTP.
//!
//! Invariant: `/healthz` and `/readyz` need no key, take no place of other requests, and are answered while the server drains.
//! Must not know: how faults are found.

use axum::Router;
use axum::extract::{Request, State};
use axum::http::StatusCode;
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE};
use axum::response::{IntoResponse, Response};
use axum::routing::get;

use super::problem::Problem;
use super::schema::JSON;
use crate::service::{Desk, RequestError};

/// Adds the paths without a guard.
pub(super) fn open(router: Router<Desk>) -> Router<Desk> {
    router.route("/healthz", get(healthz)).route("/readyz", get(readyz))
}

fn checked(desk: &Desk, request: &Request, answer: impl FnOnce() -> Response) -> Response {
    match desk.access.check_host(request) {
        Ok(()) => answer(),
        Err(refusal) => Problem::from(RequestError::from(refusal)).into_response(),
    }
}

async fn healthz(State(desk): State<Desk>, request: Request) -> Response {
    checked(&desk, &request, || ([(CACHE_CONTROL, "no-store")], "ok\n").into_response())
}

async fn readyz(State(desk): State<Desk>, request: Request) -> Response {
    checked(&desk, &request, || {
        let condition = desk.info.readiness.condition();
        let status = if condition.is_ready() { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE };
        json(status, &condition.describe())
    })
}

pub(super) async fn info(State(desk): State<Desk>) -> Response {
    json(StatusCode::OK, &wire::json::to_value(&desk.info.describe()))
}

/// An answer that no proxy keeps.
fn json(status: StatusCode, value: &serde_json::Value) -> Response {
    (status, [(CONTENT_TYPE, JSON), (CACHE_CONTROL, "no-store")], format!("{value}\n")).into_response()
}
