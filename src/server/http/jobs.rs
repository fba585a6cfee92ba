//! `/v1/jobs`: jobs that outlive their request.
//!
//! Invariant: every question is asked in the name of the caller's tenant. Events come once and in order, and go on after the
//! number that a client says it has. Must not know: how jobs are done, where they are kept.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::fmt::Display;
use std::time::Duration;

use axum::body::{Body, Bytes, to_bytes};
use axum::extract::{Extension, Path, Request, State};
use axum::http::header::{CACHE_CONTROL, CONTENT_LENGTH, CONTENT_TYPE, HeaderName, LOCATION};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::Serialize;
use serde_json::{Value, json};
use tokio::sync::mpsc;

use super::blobs::send;
use super::guard::Whose;
use super::options::{Asked, format_names, media_type};
use super::problem::{Answered, Problem, wrong};
use super::schema::{BYTES, EVENTS, JSON, digest, job_id as job_id_schema, named, word, word_or_null};
use super::warnings::{REPORT, WARNING, warnings};
use crate::service::{self, Caller, Desk, Detail, Fault, FaultKind, RequestError, job_id, to_the_end};
use jobs::blob::Digest;
use jobs::executor::api::Reuse;
use jobs::record::event::{Event, Progress, What};
use jobs::record::state::State as JobState;
use jobs::record::{Cause, Failure, FailureKind, Holder, Job, JobId, Outcome, ResultFormat, Spec};
use jobs::store::Query;
use telemetry::trace;
use transport::Phase;
use wire::fields;
use wire::proto::{self, ReusePolicy};

/// The longest specification, bytes.
const SPEC_BYTES: usize = 1 << 20;

const WAITING_EVENTS: usize = 16;

/// Between two events or signs of life, for what stands between here and the client.
const ALIVE_EVERY: Duration = Duration::from_secs(15);

fn answer(status: StatusCode, body: &impl Serialize) -> Response {
    (status, [(CONTENT_TYPE, JSON)], json!(body).to_string()).into_response()
}

/// A job, as answers have it.
#[derive(Serialize, JsonSchema)]
#[schemars(rename = "Job", transform = describe)]
pub(super) struct JobBody<'a> {
    #[schemars(schema_with = "job_id_schema")]
    id: JobId,
    #[schemars(schema_with = "word::<JobState>")]
    state: JobState,
    created_ms: u64,
    started_ms: Option<u64>,
    changed_ms: u64,
    attempts: u32,
    crashes: u32,
    #[schemars(schema_with = "specification_schema")]
    spec: Value,
    failure: Option<FailureBody<'a>>,
    /// Digests by name.
    #[schemars(schema_with = "digests")]
    results: BTreeMap<&'a str, Digest>,
    #[schemars(schema_with = "word_or_null::<Cause>")]
    expired_by: Option<Cause>,
    request_id: &'a str,
    unschedulable: Option<String>,
    server: Option<&'a str>,
}

#[derive(Serialize, JsonSchema)]
#[schemars(inline)]
struct FailureBody<'a> {
    #[schemars(schema_with = "word::<FailureKind>")]
    kind: FailureKind,
    message: &'a str,
}

/// A page of jobs.
#[derive(Serialize, JsonSchema)]
#[schemars(inline)]
pub(super) struct Page<'a> {
    jobs: Vec<JobBody<'a>>,
    next_page_token: Option<String>,
}

fn specification_schema(_: &mut SchemaGenerator) -> Schema {
    named("JobSpec")
}

fn digests(schemas: &mut SchemaGenerator) -> Schema {
    json_schema!({ "type": "object", "additionalProperties": digest(schemas) })
}

/// The body of [`create`].
pub(super) fn request(_: &mut SchemaGenerator) -> Schema {
    json_schema!({ "oneOf": [named("Options"), named("JobSpec")] })
}

/// Adds the comments that the protobuf schema has on the fields of a job.
fn describe(schema: &mut Schema) {
    let properties = schema.get_mut("properties").and_then(Value::as_object_mut);
    for (name, property) in properties.into_iter().flatten() {
        let (field, unit) =
            name.strip_suffix("_ms").map_or((&**name, ""), |field| (field, " Milliseconds since 1970."));
        if let Some(text) = fields::schema::<proto::Job>(field)["description"].as_str()
            && property.get("description").is_none()
        {
            property["description"] = format!("{text}{unit}").into();
        }
    }
}

impl<'a> JobBody<'a> {
    fn of(job: &'a Job) -> Self {
        let status = &job.status;
        let (mut failure, mut results, mut expired_by) = (None, BTreeMap::new(), None);
        match &status.outcome {
            None => {}
            Some(Outcome::Succeeded(set)) => {
                results = set.blobs.iter().map(|(name, digest)| (name.as_str(), *digest)).collect();
            }
            Some(Outcome::Failed(Failure { kind, message })) => failure = Some(FailureBody { kind: *kind, message }),
            Some(Outcome::Expired(cause)) => expired_by = Some(*cause),
        }
        Self {
            id: job.id,
            state: status.state,
            created_ms: status.created.0,
            started_ms: status.started.map(|time| time.0),
            changed_ms: status.changed.0,
            attempts: status.attempts,
            crashes: status.crashes,
            spec: wire::json::to_value(job.spec.message()),
            failure,
            results,
            expired_by,
            request_id: &job.spec.request_id,
            unschedulable: None,
            server: status.holder.as_ref().and_then(Holder::server),
        }
    }
}

pub(super) async fn create(State(desk): State<Desk>, Extension(client): Whose, request: Request) -> Answered {
    Asked::of_query(request.uri().query())?.finish()?;
    let bytes = to_bytes(request.into_body(), SPEC_BYTES)
        .await
        .map_err(|_| wrong("body", format!("did not come, or has more than {SPEC_BYTES} bytes")))?;
    let wanted = specification(&bytes, &client.tenant)?;
    let created = service::create(desk.api.clone(), &*desk.blobs, client.bytes, wanted).await?;
    let status = if created.existed { StatusCode::OK } else { StatusCode::CREATED };
    let mut response = answer(status, &JobBody::of(&created.job));
    if let Ok(place) = format!("/v1/jobs/{}", created.job.id).parse() {
        response.headers_mut().insert(LOCATION, place);
    }
    Ok(response)
}

/// What a job is asked to do: the options of a remesh with the digest of its surface, or a whole specification as jobs are
/// answered with.
fn specification(bytes: &[u8], tenant: &str) -> Result<(Spec, Reuse), RequestError> {
    let body = |error: &dyn Display| wrong("body", format!("cannot be read: {error}"));
    let Value::Object(mut object) = serde_json::from_slice(bytes).map_err(|error| body(&error))? else {
        return Err(wrong("body", "is no object of JSON"));
    };
    let reuse = match object.shift_remove("reuse") {
        None | Some(Value::Null) => Reuse::Never,
        Some(word) => {
            let named = |word: &str| ReusePolicy::from_str_name(&format!("REUSE_POLICY_{}", word.to_ascii_uppercase()));
            let policy = word.as_str().and_then(named).filter(|policy| *policy != ReusePolicy::Unspecified);
            let policy = policy.ok_or_else(|| wrong("reuse", format!("is {word}; it must be never or same_bits")))?;
            service::reuse(policy.into())?
        }
    };
    let (message, request_id) = if object.get("mesh").is_some_and(Value::is_object) {
        let request_id = match object.shift_remove("request_id") {
            None | Some(Value::Null) => String::new(),
            Some(Value::String(id)) => id,
            Some(Value::Number(id)) => id.to_string(),
            Some(_) => return Err(wrong("request_id", "is a text")),
        };
        let message = wire::json::from_value(Value::Object(object)).map_err(|error| body(&error))?;
        (message, request_id)
    } else {
        let mut asked = Asked::of_json(object)?;
        let mesh = asked.digest("mesh")?.ok_or_else(|| wrong("mesh", "is missing; it is the digest of a blob"))?;
        let format = asked.format("format")?;
        let format =
            format.ok_or_else(|| wrong("format", format!("is missing; it must be one of {}", format_names())))?;
        let to = asked.format("to")?.unwrap_or(format);
        asked.remesh(mesh, format, to)?
    };
    Ok((Spec::new(message, tenant.to_owned(), request_id)?, reuse))
}

pub(super) async fn list(State(desk): State<Desk>, Extension(client): Whose, request: Request) -> Answered {
    let mut asked = Asked::of_query(request.uri().query())?;
    let states = asked.take("states", "states with commas between, as queued,running", |text| {
        let state = |word: &str| serde_json::from_value::<JobState>(json!(word)).ok();
        text.split(',').map(state).collect::<Option<Vec<_>>>()
    })?;
    let query = Query {
        states: states.unwrap_or_default(),
        labels: asked.labels(),
        tenant: Some(client.tenant),
        since: None,
        before: None,
        limit: asked.whole("page_size")?.unwrap_or(0),
        token: asked.take("page_token", "one that this server gave", |text| text.parse().ok())?,
    };
    asked.finish()?;
    let page = desk.api.list(query).await?;
    let jobs = page.jobs.iter().map(JobBody::of).collect();
    let next_page_token = page.next.map(|token| token.to_string());
    Ok(answer(StatusCode::OK, &Page { jobs, next_page_token }))
}

pub(super) async fn one(State(desk): State<Desk>, Extension(client): Whose, Path(id): Path<String>) -> Answered {
    let job = desk.api.get(&client.tenant, job_id(&id)?).await?;
    let unschedulable = match desk.api.cluster() {
        Some(cluster) => cluster.unschedulable(&job).await?,
        None => None,
    };
    Ok(answer(StatusCode::OK, &JobBody { unschedulable, ..JobBody::of(&job) }))
}

pub(super) async fn cancel(State(desk): State<Desk>, Extension(client): Whose, Path(id): Path<String>) -> Answered {
    let id = job_id(&id)?;
    let job = to_the_end(async move { desk.api.cancel(&client.tenant, id).await }).await?;
    Ok(answer(StatusCode::OK, &JobBody::of(&job)))
}

pub(super) async fn remove(State(desk): State<Desk>, Extension(client): Whose, Path(id): Path<String>) -> Answered {
    let id = job_id(&id)?;
    to_the_end(async move { desk.api.delete(&client.tenant, id).await }).await?;
    Ok(StatusCode::NO_CONTENT.into_response())
}

pub(super) async fn result(
    State(desk): State<Desk>,
    Extension(client): Whose,
    Path(id): Path<String>,
    request: Request,
) -> Answered {
    let mut asked = Asked::of_query(request.uri().query())?;
    let name = asked.text("name").unwrap_or_else(|| MESH.to_owned());
    asked.finish()?;
    let job = desk.api.get(&client.tenant, job_id(&id)?).await?;
    send_result(&desk, &client, &job, &name, request.headers(), ()).await
}

/// The surface among the results of a job.
pub(super) const MESH: &str = "mesh";

pub(super) async fn send_result(
    desk: &Desk,
    client: &Caller,
    job: &Job,
    name: &str,
    headers: &HeaderMap,
    until: impl Send + 'static,
) -> Answered {
    let Some(Outcome::Succeeded(set)) = &job.status.outcome else { return Err(Problem::of(without_result(job))) };
    let Some(digest) = set.blobs.get(name) else {
        let names: Vec<&str> = set.blobs.keys().map(String::as_str).collect();
        return Err(wrong("name", format!("is {name:?}; this job's results are {}", names.join(", "))).into());
    };
    let media_type = match (name, job.spec.task().result) {
        (MESH, ResultFormat::File(format)) => media_type(format),
        (REPORT, _) => JSON,
        _ => BYTES,
    };
    let warnings = if name == MESH { warnings(desk, job).await } else { Vec::new() };
    let mut answer = send(desk, &client.tenant, *digest, headers, media_type, until).await?;
    for warning in warnings {
        answer.headers_mut().append(WARNING, warning);
    }
    Ok(answer)
}

fn without_result(job: &Job) -> Fault {
    let of = |kind, text: &str, reason: &'static str| {
        let (subject, description) = (job.id.to_string(), text.to_owned());
        Fault::new(kind, text).with(Detail::Precondition { kind: reason, subject, description })
    };
    match &job.status.outcome {
        Some(Outcome::Failed(Failure { kind, message })) => match kind {
            FailureKind::BadInput => {
                // It begins with the path of a field, if one is wrong.
                let path = message.split_once(": ").map(|(path, _)| path).filter(|path| path.starts_with("spec."));
                let path = path.unwrap_or("spec").to_owned();
                let detail = Detail::Field { path, description: message.clone() };
                Fault::new(FaultKind::InvalidArgument, message.clone()).with(detail)
            }
            FailureKind::MissingInput => of(FaultKind::FailedPrecondition, message, "missing_input"),
            FailureKind::TooLarge => {
                let detail = Detail::Quota { subject: "job", description: message.clone() };
                Fault::new(FaultKind::ResourceExhausted, message.clone()).with(detail)
            }
            FailureKind::Unavailable => {
                Fault::new(FaultKind::Unavailable, message.clone()).with(Detail::Retry(Duration::from_secs(5)))
            }
            FailureKind::Crashed | FailureKind::Internal => Fault::new(FaultKind::Internal, message.clone()),
        },
        Some(Outcome::Expired(cause)) => match cause {
            Cause::QueueDeadline | Cause::RunDeadline => {
                Fault::new(FaultKind::DeadlineExceeded, "the job's deadline has passed")
            }
            Cause::Kept => of(FaultKind::FailedPrecondition, "the result was kept as long as results are", "JOB_STATE"),
        },
        _ => {
            let text = format!("the job is {}; it has no result", job.status.state.name());
            of(FaultKind::FailedPrecondition, &text, "JOB_STATE")
        }
    }
}

pub(super) async fn events(
    State(desk): State<Desk>,
    Extension(client): Whose,
    Path(id): Path<String>,
    request: Request,
) -> Answered {
    let mut asked = Asked::of_query(request.uri().query())?;
    let id = job_id(&id)?;
    let given = request.headers().get("last-event-id").and_then(|value| value.to_str().ok()?.trim().parse().ok());
    let after: u64 = given.or(asked.whole("after")?).unwrap_or(0);
    asked.finish()?;
    let job = desk.api.get(&client.tenant, id).await?;
    let is_over = job.status.state.is_ended();
    if is_over && desk.api.events(&client.tenant, id, after, 1).await?.events.is_empty() {
        // A browser asks again until it gets this.
        return Ok(StatusCode::NO_CONTENT.into_response());
    }
    let (sender, receiver) = mpsc::channel(WAITING_EVENTS);
    tokio::spawn(trace::carry(watch(desk, client.tenant, id, after, sender)));
    let frames = futures_util::stream::unfold(receiver, |mut receiver| async move {
        let frame = match tokio::time::timeout(ALIVE_EVERY, receiver.recv()).await {
            Ok(Some(frame)) => frame,
            Ok(None) => return None,
            Err(_) => Bytes::from_static(b":\n\n"),
        };
        Some((Ok::<_, Infallible>(frame), receiver))
    });
    let headers = [(CONTENT_TYPE, EVENTS), (CACHE_CONTROL, "no-store")];
    Ok((headers, Body::from_stream(frames)).into_response())
}

/// Sends the events of a job until it has ended, the client goes or the server drains.
async fn watch(desk: Desk, tenant: String, id: JobId, after: u64, sender: mpsc::Sender<Bytes>) {
    let tell = |event: Event| {
        let frame = frame(&event);
        let sender = &sender;
        async move { sender.send(frame).await.map_err(|_| RequestError::ClientGone) }
    };
    let result = tokio::select! {
        biased;
        result = service::follow(&*desk.api, &tenant, id, after, tell) => result,
        () = sender.closed() => return,
        // The job goes on, and can be watched again from where this ends.
        () = desk.gate.reached(Phase::Draining) => Err(RequestError::Draining),
    };
    let last = match result {
        Ok(()) => "event: end\ndata: {}\n\n".to_owned(),
        Err(error) => {
            let problem = Problem::from(error);
            format!("event: problem\ndata: {}\n\n", problem.json(problem.status()))
        }
    };
    let _ = sender.send(last.into()).await;
}

/// An event as server-sent events have it.
fn frame(event: &Event) -> Bytes {
    let at = event.at;
    let (kind, data) = match &event.what {
        What::State { state, attempt } => ("state", json!({ "state": state, "attempt": attempt, "at_ms": at })),
        What::Progress(Progress::Stage { name, done, total }) => {
            ("stage", json!({ "name": name, "done": done, "total": total, "at_ms": at }))
        }
        What::Progress(Progress::Iteration { index, total, kind, energy, energy_ratio, gradient_norm, ms }) => (
            "iteration",
            json!({
                "index": index, "total": total, "kind": kind, "energy": energy, "energy_ratio": energy_ratio,
                "gradient_norm": gradient_norm, "ms": ms, "at_ms": at,
            }),
        ),
    };
    format!("id: {}\nevent: {kind}\ndata: {data}\n\n", event.number).into()
}

/// How long a request waits for seeds.
const WAIT: Duration = Duration::from_secs(20);

/// Bytes that are handed to the connection at once.
const PIECE: usize = 64 << 10;

/// Header: steps taken.
pub(super) const STEPS: &str = "tessera-steps";

/// Header: the job has ended, and no seeds will follow.
pub(super) const ENDED: &str = "tessera-ended";

/// `GET /v1/jobs/{id}/seeds`: the newest seeds, after more steps than the caller has seen; steps between may be left out.
pub(super) async fn seeds(
    State(desk): State<Desk>,
    Extension(client): Whose,
    Path(id): Path<String>,
    request: Request,
) -> Answered {
    let mut asked = Asked::of_query(request.uri().query())?;
    let after: u64 = asked.whole("after")?.unwrap_or(0);
    asked.finish()?;
    let id = job_id(&id)?;
    if let Some(cluster) = desk.api.cluster()
        && let Some(holder) = cluster.at_work_elsewhere(&client.tenant, id).await?
    {
        return Err(RequestError::SeedsElsewhere { holder }.into());
    }
    let mut receiver = desk.api.preview(&client.tenant, id).await?;
    let newer = receiver.wait_for(|shown| shown.as_ref().is_some_and(|shown| shown.steps > after));
    let found = tokio::select! {
        found = tokio::time::timeout(WAIT, newer) => found,
        () = desk.gate.reached(Phase::Draining) => return Err(RequestError::Draining.into()),
    };
    let uncached = (CACHE_CONTROL, "no-store".to_owned());
    let preview = match found {
        Ok(Ok(shown)) => shown.clone(),
        // The job has ended.
        Ok(Err(_)) => {
            return Ok((StatusCode::NO_CONTENT, [uncached, (HeaderName::from_static(ENDED), "true".to_owned())])
                .into_response());
        }
        Err(_) => return Ok((StatusCode::NO_CONTENT, [uncached]).into_response()),
    };
    let Some(preview) = preview else { return Ok((StatusCode::NO_CONTENT, [uncached]).into_response()) };
    let bytes = preview.seeds;
    let mut share = desk.budget.share();
    share.grow(bytes.len() as u64)?;
    let headers = [
        uncached,
        (CONTENT_TYPE, BYTES.to_owned()),
        (CONTENT_LENGTH, bytes.len().to_string()),
        (HeaderName::from_static(STEPS), preview.steps.to_string()),
    ];
    let pieces = futures_util::stream::unfold((bytes, share), |(mut rest, share)| async move {
        let piece: Bytes = rest.split_to(rest.len().min(PIECE));
        (!piece.is_empty()).then_some((Ok::<_, Infallible>(piece), (rest, share)))
    });
    Ok((headers, Body::from_stream(pieces)).into_response())
}
