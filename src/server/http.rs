//! The HTTP interface: a mesh in, a mesh out, and jobs and blobs for clients without gRPC.
//!
//! Purpose: [`door`] makes a listener of a server that answers the routes of [`ROUTES`]. Invariant: every route is in that table
//! with the role that it needs, and in `openapi.json`; what is asked is done by the same jobs, blobs, keys and limits as over
//! gRPC, and refused for the same reasons, by the names that options have here. Must not know: gRPC, messages, connections,
//! how a surface is remeshed.

mod blobs;
mod body;
mod guard;
mod jobs;
mod options;
#[cfg(feature = "ui")]
mod page;
mod problem;
mod remesh;

use std::sync::LazyLock;

use axum::Router;
use axum::http::header::CONTENT_TYPE;
use axum::middleware::from_fn_with_state;
use axum::response::{IntoResponse, Response};
use axum::routing::{MethodRouter, delete, get, post};
use serde_json::{Value, json};
use tokio::net::TcpListener;
use wire::fields;

#[cfg(feature = "ui")]
use self::guard::Open;
use self::guard::{Guard, guard, unknown};
use crate::keys::Role;
use crate::service::{Desk, Door, Kind};
use geometry::mesh::io::Format;

/// The HTTP interface, as OpenAPI 3.1. Formats and media types come from [`Format`], options and specifications of jobs from
/// the schema of messages.
pub static OPENAPI: LazyLock<String> = LazyLock::new(|| {
    let formats = Format::ALL.map(|format| format!("\"{}\"", format.extension())).join(", ");
    let types = Format::ALL.map(|format| format!("\"{}\": {{}}", options::media_type(format))).join(", ");
    let text = include_str!("http/openapi.json").replace("\"$formats\"", &formats);
    let text = text.replace("\"$media_types\": {}", &types);
    // Tests read the file, so that it is JSON.
    let Ok(mut document) = serde_json::from_str::<Value>(&text) else { return text };
    for field in fields::all() {
        let schema = field.schema();
        let parameter = json!({ "name": field.name, "in": "query", "schema": schema });
        let parameters = document.pointer_mut("/paths/~1v1~1remesh/post/parameters").and_then(Value::as_array_mut);
        parameters.into_iter().for_each(|parameters| parameters.push(parameter.clone()));
        document["components"]["schemas"]["Options"]["properties"][&field.name] = schema;
    }
    for (name, schema) in wire::json::schemas::<wire::proto::JobSpec>("#/components/schemas/") {
        document["components"]["schemas"][name] = schema;
    }
    format!("{document:#}\n")
});

/// A route: its method, its path, the role that it needs, and among what it is counted.
#[derive(Clone, Copy, Debug)]
pub struct Route {
    /// In capitals.
    pub method: &'static str,
    /// As OpenAPI writes it.
    pub path: &'static str,
    pub role: Role,
    pub kind: Kind,
    handler: fn() -> MethodRouter<Desk>,
}

const fn route(
    method: &'static str,
    path: &'static str,
    role: Role,
    kind: Kind,
    handler: fn() -> MethodRouter<Desk>,
) -> Route {
    Route { method, path, role, kind, handler }
}

pub const ROUTES: &[Route] = &[
    route("POST", "/v1/remesh", Role::Submit, Kind::Stream, || post(remesh::remesh)),
    route("POST", "/v1/blobs", Role::Submit, Kind::Stream, || post(blobs::upload)),
    // HEAD comes with GET.
    route("GET", "/v1/blobs/{digest}", Role::Read, Kind::Stream, || get(blobs::read)),
    route("DELETE", "/v1/blobs/{digest}", Role::Submit, Kind::Call, || delete(blobs::remove)),
    route("POST", "/v1/jobs", Role::Submit, Kind::Call, || post(jobs::create)),
    route("GET", "/v1/jobs", Role::Read, Kind::Call, || get(jobs::list)),
    route("GET", "/v1/jobs/{id}", Role::Read, Kind::Call, || get(jobs::one)),
    route("DELETE", "/v1/jobs/{id}", Role::Submit, Kind::Call, || delete(jobs::remove)),
    route("POST", "/v1/jobs/{id}/cancel", Role::Submit, Kind::Call, || post(jobs::cancel)),
    route("GET", "/v1/jobs/{id}/events", Role::Read, Kind::Watch, || get(jobs::events)),
    route("GET", "/v1/jobs/{id}/seeds", Role::Read, Kind::Watch, || get(jobs::seeds)),
    route("GET", "/v1/jobs/{id}/result", Role::Read, Kind::Stream, || get(jobs::result)),
    route("GET", "/v1/openapi.json", Role::Read, Kind::Call, || get(openapi)),
];

pub fn door(listener: TcpListener) -> Door {
    Door::new(listener, routes)
}

/// As [`door`], with the page for browsers.
#[cfg(feature = "ui")]
pub fn door_with_page(listener: TcpListener) -> Door {
    Door::new(listener, |desk| {
        let mut router = Router::new();
        for path in page::PATHS {
            let open = from_fn_with_state(Open { desk: desk.clone(), path }, guard::open);
            router = router.route(path, get(page::serve).route_layer(open));
        }
        router.with_state(desk.clone()).merge(routes(desk))
    })
}

fn routes(desk: Desk) -> Router {
    let mut router = Router::new();
    for route in ROUTES {
        let guarded = from_fn_with_state(Guard { desk: desk.clone(), route: *route }, guard);
        router = router.route(route.path, (route.handler)().route_layer(guarded));
    }
    router.fallback(unknown).method_not_allowed_fallback(unknown).with_state(desk)
}

async fn openapi() -> Response {
    ([(CONTENT_TYPE, "application/json")], OPENAPI.as_str()).into_response()
}
