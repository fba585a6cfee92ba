//! The HTTP interface: a mesh in, a mesh out, and jobs and blobs for clients without gRPC.
//!
//! Purpose: [`door`] makes a listener of a server that answers the routes of [`ROUTES`]. Invariant: a route is described once, in
//! that table; the router, the guard, the metrics and the OpenAPI document read it. Requests use the same jobs, blobs, keys and limits
//! as gRPC calls, and are refused for the same reasons, by the names that options have here. Must not know: gRPC, messages,
//! connections, how a surface is remeshed.

mod blobs;
mod body;
#[cfg(feature = "ui")]
mod docs;
mod form;
mod guard;
mod jobs;
mod openapi;
mod options;
#[cfg(feature = "ui")]
mod page;
mod problem;
mod remesh;
mod schema;
mod state;
mod warnings;

use std::sync::LazyLock;
use std::time::Duration;

use axum::Router;
use axum::http::Method;
use axum::http::header::{self, CONTENT_TYPE, HeaderName, HeaderValue};
use axum::middleware::{from_fn_with_state, map_request, map_response};
use axum::response::{IntoResponse, Response};
use axum::routing::{MethodRouter, delete, get, post};
use schemars::json_schema;
use tokio::net::TcpListener;
use tower_http::cors::CorsLayer;

#[cfg(feature = "ui")]
use self::guard::Open;
use self::guard::{Guard, guard, unknown};
use self::openapi::{Answer, Content, Parameter};
use self::schema::{BYTES, EVENTS, JSON, digest, job_id, labels, named, text, whole};
use crate::keys::Role;
use crate::service::{Desk, Door, Kind};

/// A route, as the router serves it and as clients see it.
#[derive(Clone, Copy, Debug)]
pub struct Route {
    /// In capitals.
    pub method: &'static str,
    /// As OpenAPI writes it.
    pub path: &'static str,
    pub role: Role,
    /// The places that it takes, and its limit of time.
    pub kind: Kind,
    handler: fn() -> MethodRouter<Desk>,
    /// The name of the operation in generated clients.
    id: &'static str,
    summary: &'static str,
    description: &'static str,
    parameters: &'static [Parameter],
    /// Whether its query has the options of a remesh too.
    takes_options: bool,
    body: Content,
    answers: &'static [Answer],
}

/// A route without parameters, bodies and texts. [`ROUTES`] adds them.
const fn route(
    method: &'static str,
    path: &'static str,
    role: Role,
    kind: Kind,
    handler: fn() -> MethodRouter<Desk>,
) -> Route {
    let (id, summary, description) = ("", "", "");
    let (parameters, takes_options, body, answers): (&[_], _, _, &[_]) = (&[], false, Content::Nothing, &[]);
    Route { method, path, role, kind, handler, id, summary, description, parameters, takes_options, body, answers }
}

const DIGEST: Parameter = Parameter::path("digest", "The SHA-256 of the bytes.", digest);
const ID: Parameter = Parameter::path("id", "The id of the job.", job_id);
const LABEL: Parameter =
    Parameter::query("label", "A label of the job, as KEY=VALUE; repeat the parameter for several labels.", labels);
const RANGE: Parameter = Parameter::header("Range", "One range of bytes.", text);
const IF_NONE_MATCH: Parameter = Parameter::header("If-None-Match", "ETags that the client has.", text);
const IF_RANGE: Parameter =
    Parameter::header("If-Range", "Send the range only if the ETag is this one, else all bytes.", text);
const ETAG: Parameter = Parameter::header("ETag", "The digest, in quotes.", text);
const WARNING: Parameter = Parameter::header(
    warnings::WARNING,
    "A warning of the report, as `CODE: MESSAGE`. There is one header for each, at most 16.",
    text,
);
const LOCATION: Parameter = Parameter::header("Location", "The path of the new resource.", text);

const FILE: Content = Content::Plain(BYTES);
const JOB: Content = Content::json(|schemas| schemas.subschema_for::<jobs::JobBody<'_>>());

/// The answers that carry a blob.
const DOWNLOAD: &[Answer] = &[
    Answer::new(200, "All bytes.", FILE).with(&[ETAG]),
    Answer::new(206, "The range.", FILE).with(&[ETAG]),
    Answer::new(304, "The client has these bytes.", Content::Nothing),
];

/// Every route of the interface.
pub const ROUTES: &[Route] = &[
    Route {
        id: "remesh",
        summary: "Remesh a mesh",
        description: "The body is the file of a mesh, compressed by gzip or not; the answer is the file of its remesh. The request \
                      is a job: limits, keys and quotas are those of jobs. Closing the connection cancels it.",
        parameters: &[LABEL],
        takes_options: true,
        body: Content::Mesh,
        answers: &[Answer::new(200, "The remesh.", Content::Mesh).with(&[ETAG, WARNING])],
        ..route("POST", "/v1/remesh", Role::Submit, Kind::Stream, || post(remesh::remesh))
    },
    Route {
        id: "uploadBlob",
        summary: "Store bytes",
        description: "With `digest` and Content-Length the body is stored as it arrives, and a broken upload can be resumed. \
                      Otherwise it stays in memory until its digest is known.",
        parameters: &[Parameter::query("digest", "The SHA-256 of the body, if it is known.", digest)],
        body: FILE,
        answers: &[Answer::new(201, "Stored.", Content::json(|schemas| schemas.subschema_for::<blobs::Blob>()))
            .with(&[LOCATION])],
        ..route("POST", "/v1/blobs", Role::Submit, Kind::Stream, || post(blobs::upload))
    },
    // axum answers HEAD where it answers GET.
    Route {
        id: "readBlob",
        summary: "Read bytes",
        description: "HEAD gives the headers alone.",
        parameters: &[DIGEST, RANGE, IF_NONE_MATCH, IF_RANGE],
        answers: DOWNLOAD,
        ..route("GET", "/v1/blobs/{digest}", Role::Read, Kind::Stream, || get(blobs::read))
    },
    Route {
        id: "deleteBlob",
        summary: "Remove a blob from the tenant",
        description: "The bytes are deleted when no job and no other tenant needs them.",
        parameters: &[DIGEST],
        answers: &[Answer::new(204, "Removed.", Content::Nothing)],
        ..route("DELETE", "/v1/blobs/{digest}", Role::Submit, Kind::Call, || delete(blobs::remove))
    },
    Route {
        id: "createJob",
        summary: "Create a job",
        description: "The body is an object with the options of `/v1/remesh`, the digest of the mesh (`mesh`) and its `format`; or \
                      a whole specification, as in `spec` of a job, with `request_id` and `reuse` beside it.",
        body: Content::json(jobs::request),
        answers: &[
            Answer::new(201, "Created.", JOB).with(&[LOCATION]),
            Answer::new(
                200,
                "An earlier request created it: one with this `request_id`, or by `reuse` one with the same result.",
                JOB,
            )
            .with(&[LOCATION]),
        ],
        ..route("POST", "/v1/jobs", Role::Submit, Kind::Call, || post(jobs::create))
    },
    Route {
        id: "listJobs",
        summary: "List jobs",
        description: "The newest first, in pages.",
        parameters: &[
            Parameter::query("page_size", "Jobs of a page, at most 1000. 0: the server chooses.", whole),
            Parameter::query("page_token", "`next_page_token` of the page before.", text),
            Parameter::query("states", "States with commas between; all if not given.", text),
            LABEL,
        ],
        answers: &[Answer::new(200, "A page.", Content::json(|schemas| schemas.subschema_for::<jobs::Page<'_>>()))],
        ..route("GET", "/v1/jobs", Role::Read, Kind::Call, || get(jobs::list))
    },
    Route {
        id: "getJob",
        summary: "A job",
        description: "Its current state.",
        parameters: &[ID],
        answers: &[Answer::new(200, "The job.", JOB)],
        ..route("GET", "/v1/jobs/{id}", Role::Read, Kind::Call, || get(jobs::one))
    },
    Route {
        id: "deleteJob",
        summary: "Delete a job",
        description: "Deletes an ended job and its result.",
        parameters: &[ID],
        answers: &[Answer::new(204, "Deleted.", Content::Nothing)],
        ..route("DELETE", "/v1/jobs/{id}", Role::Submit, Kind::Call, || delete(jobs::remove))
    },
    Route {
        id: "cancelJob",
        summary: "Cancel a job",
        description: "A job that is already cancelled stays so.",
        parameters: &[ID],
        answers: &[Answer::new(200, "The job.", JOB)],
        ..route("POST", "/v1/jobs/{id}/cancel", Role::Submit, Kind::Call, || post(jobs::cancel))
    },
    Route {
        id: "watchJob",
        summary: "Watch a job",
        description: "Server-sent events: `state`, `stage`, `iteration`, and `end` as the last one; `problem` if the server ends the \
                      stream. After a broken connection, send `Last-Event-ID`.",
        parameters: &[
            ID,
            Parameter::header("Last-Event-ID", "The number of the last event received.", whole),
            Parameter::query("after", "The same, for clients that cannot send the header.", whole),
        ],
        answers: &[
            Answer::new(200, "Past and future events.", Content::Plain(EVENTS)),
            Answer::new(204, "The job has ended, and all its events were sent.", Content::Nothing),
        ],
        ..route("GET", "/v1/jobs/{id}/events", Role::Read, Kind::Watch, || get(jobs::events))
    },
    Route {
        id: "seeds",
        summary: "The seeds of a running job",
        description: "Waits up to 20 seconds for seeds after more steps than `after`, and gives the newest. More than a million \
                      seeds are not sent. The cell of a seed is the part of the surface nearest to it.",
        parameters: &[
            ID,
            Parameter::query(
                "after",
                "Steps that the client has seen.",
                |_| json_schema!({ "type": "integer", "minimum": 0, "default": 0 }),
            ),
        ],
        answers: &[
            Answer::new(200, "Three doubles per seed, little-endian, in the coordinates of the mesh.", FILE).with(&[
                Parameter::header(jobs::STEPS, "Steps taken.", |_| json_schema!({ "type": "integer", "minimum": 1 })),
            ]),
            Answer::new(204, "No new seeds. Ask again unless `tessera-ended` is set.", Content::Nothing)
                .with(&[Parameter::header(jobs::ENDED, "The job has ended.", |_| json_schema!({ "const": "true" }))]),
        ],
        ..route("GET", "/v1/jobs/{id}/seeds", Role::Read, Kind::Watch, || get(jobs::seeds))
    },
    Route {
        id: "getResult",
        summary: "The result of a job",
        description: "The mesh, or another result by its name.",
        parameters: &[
            ID,
            Parameter::query(
                "name",
                "A name of the job's `results`; `mesh` if not given. `report` has the figures.",
                text,
            ),
            RANGE,
            IF_NONE_MATCH,
            IF_RANGE,
        ],
        answers: &[
            Answer::new(200, "All bytes.", FILE).with(&[ETAG, WARNING]),
            Answer::new(206, "The range.", FILE).with(&[ETAG, WARNING]),
            Answer::new(304, "The client has these bytes.", Content::Nothing),
        ],
        ..route("GET", "/v1/jobs/{id}/result", Role::Read, Kind::Stream, || get(jobs::result))
    },
    Route {
        id: "serverInfo",
        summary: "The server",
        description: "Version, readiness, backends, memory and limits.",
        answers: &[Answer::new(200, "The server.", Content::json(|_| named("GetServerInfoResponse")))],
        ..route("GET", "/v1/info", Role::Read, Kind::Call, || get(state::info))
    },
    Route {
        id: "openapi",
        summary: "This document",
        answers: &[Answer::new(200, "OpenAPI 3.1.", Content::Plain(JSON))],
        ..route("GET", "/v1/openapi.json", Role::Read, Kind::Call, || get(openapi))
    },
];

/// The HTTP interface, as OpenAPI 3.1.
pub static OPENAPI: LazyLock<String> = LazyLock::new(|| format!("{:#}\n", openapi::document(ROUTES)));

async fn openapi() -> Response {
    ([(CONTENT_TYPE, JSON)], OPENAPI.as_str()).into_response()
}

pub fn door(listener: TcpListener) -> Door {
    Door::new(listener, |desk| {
        let origins = desk.access.options().hosts.origins.clone();
        for_browsers(routes(desk), origins)
    })
}

/// As [`door`], with the page for browsers and a page of this interface.
#[cfg(feature = "ui")]
pub fn door_with_page(listener: TcpListener) -> Door {
    Door::new(listener, |desk| {
        let mut router = Router::new();
        for path in page::PATHS {
            let open = from_fn_with_state(Open { desk: desk.clone(), path }, guard::open);
            router = router.route(path, get(page::serve).route_layer(open));
        }
        let open = from_fn_with_state(Open { desk: desk.clone(), path: "/docs" }, guard::open);
        router = router.route("/docs", get(docs::serve).route_layer(open));
        let origins = desk.access.options().hosts.origins.clone();
        let page = router.with_state(desk.clone());
        for_browsers(page.merge(routes(desk)), origins)
    })
}

/// What browsers need to hear beside each answer: which sites may read it (`origins`), and that its type is not to be guessed.
fn for_browsers(router: Router, origins: Vec<HeaderValue>) -> Router {
    let router =
        router.layer(map_request(body::read_to_the_end)).layer(map_response(async |mut response: Response| {
            response.headers_mut().insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
            response
        }));
    if origins.is_empty() {
        return router;
    }
    let names = |names: &[&'static str]| names.iter().copied().map(HeaderName::from_static).collect::<Vec<_>>();
    let cors = CorsLayer::new()
        .allow_origin(origins)
        .allow_methods([Method::GET, Method::HEAD, Method::POST, Method::DELETE])
        .allow_headers(names(SENT))
        .expose_headers(names(READ))
        .max_age(Duration::from_secs(600));
    router.layer(cors)
}

/// Headers that pages of allowed sites may send, and those that they may read.
const SENT: &[&str] = &[
    "accept",
    "authorization",
    "content-encoding",
    "content-type",
    "if-none-match",
    "if-range",
    "last-event-id",
    "range",
    "tessera-tenant",
    "traceparent",
];
const READ: &[&str] =
    &["content-range", "etag", "location", "retry-after", jobs::ENDED, jobs::STEPS, warnings::WARNING];

fn routes(desk: Desk) -> Router {
    let mut router = Router::new();
    for route in ROUTES {
        let guarded = from_fn_with_state(Guard { desk: desk.clone(), route: *route }, guard);
        router = router.route(route.path, (route.handler)().route_layer(guarded));
    }
    state::open(router).fallback(unknown).method_not_allowed_fallback(unknown).with_state(desk)
}
