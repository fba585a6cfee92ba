//! The three streams; [`blobs`] and [`jobs`] are services of their own.
//!
//! Purpose: read the upload, hand it to the engine, send what comes back. Invariant: thin: no geometry here, and no status
//! codes. What a stream holds is dropped with its future. Must not know: which backend works, how statuses look.

/// How messages and chunks become the answers of a stream.
macro_rules! wraps {
    ($response:ident) => {
        fn wrap(message: response::Message) -> $response {
            $response { message: Some(message) }
        }

        fn wrap_chunk(chunk: Chunk) -> $response {
            wrap(response::Message::Chunk(chunk))
        }
    };
}

pub(super) mod blobs;
mod cvt;
mod diagram;
pub(super) mod jobs;
mod remesh;

use std::sync::Arc;

use prost::Message as _;
use tonic::{Request, Response, Status, Streaming};

use super::RequestError;
use super::desk::tenant_of;
use super::stream::{Answers, Gate, Inbox, Kind, Outbox, respond};
use crate::config::Limits;
use ::jobs::admission::estimate::{self, Counts, need};
use ::jobs::admission::forecast::{must_end, must_fit};
use ::jobs::executor::api::ClusterApi;
use ::jobs::executor::prepared::Input;
use ::jobs::executor::streams::Place;
use ::jobs::observe::activity::Origin;
use ::jobs::places::Places;
pub(super) use ::jobs::{AdmissionRequest, BackendInfo, CancelOnDrop, Engine, JobError, admission};
use geometry::cvt::density::{Count, Expected};
use geometry::mesh::TriMesh;
use geometry::remesh::report::to_json;
use geometry::remesh::{RemeshOptions, Seeds};
use geometry::token::Token;
use transport::{Budget, Phase, Share};
use wire::assemble::Uploaded;
use wire::chunks::{byte_chunks, point_chunks};
use wire::options::{Diagram, Session, Start, fill};
use wire::proto::{ArrayKind, Chunk, ComputeRvdHeader, CvtHeader, RemeshHeader};
use wire::upload::{Checked, Header, Incoming, Upload};
use wire::{attributes, codec, proto};

/// The longest report that the last message holds, bytes; a longer one goes ahead of it in chunks.
const REPORT_IN_DONE_BYTES: usize = 256 << 10;

/// The answer to a call of one message.
type Reply<T> = Result<Response<T>, Status>;

pub(super) struct Handlers {
    shared: Arc<Shared>,
}

struct Shared {
    engine: Engine,
    jobs: Option<super::Jobs>,
    limits: Limits,
    budget: Budget,
    gate: Gate,
    /// Surfaces prepared at once: as many as there are cores, and two at least.
    preparing: Places,
}

impl Handlers {
    pub(super) fn new(
        (engine, jobs): (Engine, Option<super::Jobs>),
        limits: Limits,
        budget: Budget,
        gate: Gate,
    ) -> Self {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        // One tenant leaves a place.
        let preparing = Places::new(cores.max(2));
        Self { shared: Arc::new(Shared { engine, jobs, limits, budget, gate, preparing }) }
    }

    /// Runs a stream in the name of its tenant.
    fn stream<M, T: Send + 'static, F: Future<Output = Result<(), RequestError>> + Send + 'static>(
        &self,
        method: &'static str,
        request: Request<Streaming<M>>,
        handle: fn(Arc<Shared>, String, Inbox<M>, Outbox<T>) -> F,
    ) -> Reply<Answers<T>> {
        let (metadata, extensions, stream) = request.into_parts();
        let (shared, tenant) = (Arc::clone(&self.shared), tenant_of(metadata.as_ref(), &extensions)?);
        let (name, places) = (tenant.clone(), (&self.shared.gate, &self.shared.budget));
        let handle = |out| handle(shared, tenant, Inbox::new(stream), out);
        Ok(respond((method, Kind::Stream, &name), &metadata, &extensions, places, handle)?)
    }
}

#[tonic::async_trait]
impl proto::remesh_service_server::RemeshService for Handlers {
    type ComputeRvdStream = Answers<proto::ComputeRvdResponse>;
    type CvtStream = Answers<proto::CvtResponse>;
    type RemeshStream = Answers<proto::RemeshResponse>;

    async fn compute_rvd(
        &self,
        request: Request<Streaming<proto::ComputeRvdRequest>>,
    ) -> Reply<Self::ComputeRvdStream> {
        self.stream("ComputeRvd", request, diagram::handle)
    }

    async fn cvt(&self, request: Request<Streaming<proto::CvtRequest>>) -> Reply<Self::CvtStream> {
        self.stream("Cvt", request, cvt::handle)
    }

    async fn remesh(&self, request: Request<Streaming<proto::RemeshRequest>>) -> Reply<Self::RemeshStream> {
        self.stream("Remesh", request, remesh::handle)
    }
}

impl Shared {
    fn cluster(&self) -> Option<&dyn ClusterApi> {
        self.jobs.as_ref()?.api.cluster()
    }

    /// Ready once the server drains, or an operator wants it to take no more work.
    async fn leaves(&self) {
        let drained = async {
            match self.cluster() {
                // Without a sender the server ends.
                Some(cluster) => drop(cluster.drained().wait_for(|drained| *drained).await),
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            () = self.gate.reached(Phase::Draining) => {}
            () = drained => {}
        }
    }

    /// Errors: `Elsewhere` if another server is to do streams.
    async fn does_streams(&self) -> Result<(), RequestError> {
        let Some(cluster) = self.cluster() else { return Ok(()) };
        cluster.streams_elsewhere().await.map_or(Ok(()), |address| Err(RequestError::Elsewhere { address }))
    }
}

struct Received {
    arrays: Uploaded,
    /// Its memory. Held until the job is done.
    share: Share,
}

/// What was uploaded, and its place in the queue, reserved since its header.
struct Admitted<H: Needs> {
    header: Checked<H::Options>,
    received: Received,
    place: Place,
}

/// Reads header, chunks and the end mark. What cannot be done now, or not here, is refused at the header.
async fn upload<M: Into<Incoming<H>>, H: Needs>(
    shared: &Shared,
    tenant: &str,
    inbox: &mut Inbox<M>,
) -> Result<Admitted<H>, RequestError> {
    let Limits { upload_idle, upload: limit, .. } = shared.limits;
    let deadline = tokio::time::Instant::now() + limit;
    let mut upload = Upload::<H>::new(shared.limits.bounds());
    let mut share = shared.budget.upload_of(tenant);
    let mut kept = None;
    loop {
        let message = tokio::select! {
            message = inbox.next(upload_idle) => message?,
            () = tokio::time::sleep_until(deadline) => return Err(RequestError::UploadTime(limit)),
            // Nothing was admitted yet that a shutdown would wait for.
            () = shared.gate.reached(Phase::Draining) => return Err(RequestError::Draining),
        };
        let complete = upload.take(message.map(Into::into), |bytes| share.grow(bytes).map_err(RequestError::from))?;
        let place = match (kept.take(), upload.header()) {
            (Some(place), _) => place,
            (None, header) => {
                shared.does_streams().await?;
                // Nothing can come before the header.
                let request = header.map(|header| admission_request::<H>(shared, tenant, header)).transpose()?;
                Place { request: request.unwrap_or_default(), reservation: shared.engine.reserve(tenant)? }
            }
        };
        if let Some((header, arrays)) = complete {
            return Ok(Admitted { header, received: Received { arrays, share }, place });
        }
        kept = Some(place);
    }
}

/// The upload of a recorded `Remesh` stream, as far as it needs no engine.
pub(super) fn replay(recording: &mut &[u8], limits: &Limits) -> Result<Input, RequestError> {
    let mut upload = Upload::<proto::RemeshHeader>::new(limits.bounds());
    let mut share = Budget::new(limits.memory_bytes).share();
    loop {
        let message = match recording.is_empty() {
            true => None,
            false => Some(proto::RemeshRequest::decode_length_delimited(&mut *recording).map_err(|error| {
                // As tonic says it.
                RequestError::Inbound(Status::invalid_argument(error.to_string()))
            })?),
        };
        let complete = upload.take(message.map(Into::into), |bytes| share.grow(bytes).map_err(RequestError::from))?;
        if let Some((mut header, arrays)) = complete {
            return Ok(input(Received { arrays, share }, &mut header.options, &Token::default())?.0);
        }
    }
}

/// Makes the engine's input of an upload, and fills in its options.
fn input(received: Received, options: &mut dyn Start, token: &Token) -> Result<(Input, Share), RequestError> {
    token.enter("read");
    let Received { arrays, share } = received;
    let Uploaded { positions, facets, by_vertex, seeds, creases, attributes } = arrays;
    fill(options, seeds, by_vertex);
    let mesh = TriMesh::new(positions, facets).map_err(JobError::from)?;
    token.check().map_err(JobError::from)?;
    let attributes = match attributes.is_empty() {
        true => None,
        false => Some(attributes::collect(&mesh, attributes).map_err(|error| error.under("mesh"))?),
    };
    let (seeds, density) = options.start();
    seeds.resolve(&mesh);
    let most = density.max_points;
    if let Some(points) = seeds.drawn().filter(|points| *points > most) {
        let text = format!("come to {points} for this surface; this server takes at most {most}");
        return Err(wire::WireError::field("options.points", text).into());
    }
    let (seeds, density) = (std::mem::replace(seeds, Seeds::Given(Vec::new())), std::mem::take(density));
    Ok((Input { mesh, density, seeds, creases, attributes }, share))
}

/// Does long work that needs no backend, on a thread that may block. When the caller goes, the work is cancelled, and
/// its place is free once it has: work that went on without a place would be as many threads as there are such callers.
async fn apart<R: Send + 'static>(
    (shared, tenant): (&Shared, &str),
    token: &Token,
    work: impl FnOnce(&Token) -> Result<R, RequestError> + Send + 'static,
) -> Result<R, RequestError> {
    let place = shared.preparing.wait(tenant).await;
    let cancel = CancelOnDrop::new(token);
    let (engine, token) = (shared.engine.clone(), token.clone());
    let work = move || {
        let (_place, _watched, _mark) = (place, engine.watch(&token), engine.mark());
        engine.on_threads(|| work(&token))
    };
    let span = tracing::Span::current();
    let done = tokio::task::spawn_blocking(move || span.in_scope(work)).await;
    cancel.disarm();
    match done {
        Ok(result) => result,
        Err(panic) => Err(JobError::Panicked(panic.to_string()).into()),
    }
}

/// An upload that was read, and the place of its job, planned with its surface.
struct Ready<T> {
    value: T,
    share: Share,
    place: Place,
}

impl<H: Needs> Admitted<H> {
    /// Reads the upload, on a thread that may block, and plans its job again: counts alone do not tell of needles, fans and
    /// soups. `make` then makes what the job needs. Errors: `JobApi` with `TooLarge` or `TooLong` if the job could not run here.
    async fn read<T: Send + 'static>(
        self,
        (shared, tenant): (&Shared, &str),
        token: &Token,
        make: impl FnOnce(Input, H::Options, &Token) -> Result<T, JobError> + Send + 'static,
    ) -> Result<Ready<T>, RequestError> {
        let Self { mut header, received, mut place } = self;
        let (by, limits) = (shared.engine.backend(header.backend)?, shared.engine.memory());
        let (value, share, need) = apart((shared, tenant), token, move |token| {
            let asked = header.options.clone();
            let (input, share) = input(received, &mut header.options, token)?;
            let expected =
                Expected::of(&input.mesh, &input.density, input.seeds.count(), token).map_err(JobError::from)?;
            let options = std::mem::replace(&mut header.options, asked);
            let need = need(&counts::<H>(&header, &by, expected.points as u64).of_surface(&expected), by.threads);
            must_fit(&need, limits)?;
            must_end(&need, token.time_limit())?;
            Ok((make(input, options, token)?, share, need))
        })
        .await?;
        (place.request.seconds, place.request.memory) = (need.seconds, need.memory);
        Ok(Ready { value, share, place })
    }
}

async fn send_all<T: prost::Message>(
    outbox: &Outbox<T>,
    chunks: impl Iterator<Item = Chunk>,
    wrap: fn(Chunk) -> T,
) -> Result<(), RequestError> {
    for chunk in chunks {
        outbox.send(wrap(chunk)).await?;
    }
    Ok(())
}

/// Sends a report as chunks if it is long; otherwise gives it, for the last message.
async fn send_report<T: prost::Message>(
    outbox: &Outbox<T>,
    report: &(impl serde::Serialize + Sync),
    wrap: fn(Chunk) -> T,
) -> Result<String, RequestError> {
    let json = to_json(report).map(|json| json.to_string()).unwrap_or_default();
    if json.len() <= REPORT_IN_DONE_BYTES {
        return Ok(json);
    }
    let _held = outbox.holding(json.len());
    send_all(outbox, byte_chunks(ArrayKind::Report, json.as_bytes()), wrap).await?;
    Ok(String::new())
}

/// Queue and compute time, added up.
#[derive(Clone, Copy, Debug, Default)]
struct Clock {
    queue_ms: f64,
    compute_ms: f64,
}

impl Clock {
    fn add(&mut self, queue_ms: f64, compute_ms: f64) {
        self.queue_ms += queue_ms;
        self.compute_ms += compute_ms;
    }

    fn timing(self) -> proto::Timing {
        proto::Timing { queue_ms: self.queue_ms, compute_ms: self.compute_ms }
    }

    /// Logs the backend and how long the work took.
    fn note(self, method: &'static str, by: &BackendInfo) {
        let Self { queue_ms, compute_ms } = self;
        tracing::info!(method, backend = by.kind.name(), adapter = by.adapter, queue_ms, compute_ms, "worked");
    }

    fn progress(self, stage: &str, done: u64, total: u64) -> proto::Progress {
        proto::Progress { stage: stage.to_owned(), done, total, timing: Some(self.timing()) }
    }
}

/// Sends points as an array; a name for what all streams do with seeds.
async fn send_seeds<T: prost::Message>(
    outbox: &Outbox<T>,
    seeds: &[glam::DVec3],
    wrap: fn(Chunk) -> T,
) -> Result<(), RequestError> {
    let _held = outbox.holding(size_of_val(seeds));
    send_all(outbox, point_chunks(ArrayKind::Seeds, seeds), wrap).await
}

fn accepted(position: usize, by: &BackendInfo) -> proto::Accepted {
    proto::Accepted {
        queue_position: u32::try_from(position).unwrap_or(u32::MAX),
        backend: by.kind.name().to_owned(),
        adapter: by.adapter.clone().unwrap_or_default(),
        threads: u32::try_from(by.threads).unwrap_or(u32::MAX),
    }
}

/// A header that says what its job needs.
trait Needs: Header<Options: Start + Clone + Send + 'static> {
    const KIND: estimate::Kind;
    /// Whether later pieces continue what the first one makes.
    const HAS_CONTINUATIONS: bool;

    fn counts(counts: Counts, options: &Self::Options) -> Counts;
}

/// The admission request of a stream's job, in the name of its tenant. Errors: `JobApi` with `TooLarge` if it could never
/// run here.
fn admission_request<H: Needs>(
    shared: &Shared,
    tenant: &str,
    header: &Checked<H::Options>,
) -> Result<AdmissionRequest, RequestError> {
    let by = shared.engine.backend(header.backend)?;
    let Checked { mesh, options, .. } = header;
    let points = match (options.seeds(), options.seeds().count()) {
        _ if mesh.seeds > 0 => mesh.seeds,
        (_, Count::Points(points)) => points as u64,
        (Seeds::Share { of, .. }, _) => of.of_vertices(usize::try_from(mesh.vertices).unwrap_or(usize::MAX)) as u64,
        // Nothing is known yet: seldom more than half as many as facets.
        (_, Count::Implied) => (mesh.facets / 2).clamp(1, shared.limits.max_seeds.max(1)),
    };
    let counts = counts::<H>(header, &by, points);
    let need = need(&counts, by.threads);
    must_fit(&need, shared.engine.memory())?;
    let request = admission::request(&shared.engine, tenant, &counts, &need);
    // Of the points that are asked for, not of those that may be added.
    let origin = request.origin.map(|origin| Origin { seeds: points, ..origin });
    Ok(AdmissionRequest { has_continuations: H::HAS_CONTINUATIONS, origin, ..request })
}

/// What a stream's header says of its job, which begins with so many points.
fn counts<H: Needs>(header: &Checked<H::Options>, by: &BackendInfo, points: u64) -> Counts {
    let Checked { mesh, options, attributes, .. } = header;
    let counts = H::counts(Counts::new(H::KIND, by.kind, mesh.vertices, mesh.facets, points), options);
    let attributes = attributes.iter().fold(0, |sum, array| array.values.saturating_mul(3).saturating_add(sum));
    Counts { attributes, ..counts }
}

impl Needs for RemeshHeader {
    const KIND: estimate::Kind = estimate::Kind::Remesh;
    const HAS_CONTINUATIONS: bool = false;

    fn counts(counts: Counts, options: &RemeshOptions) -> Counts {
        counts.of_remesh(options)
    }
}

impl Needs for ComputeRvdHeader {
    const KIND: estimate::Kind = estimate::Kind::Rvd;
    const HAS_CONTINUATIONS: bool = true;

    // Pieces are sent as they come, and not kept.
    fn counts(counts: Counts, options: &Diagram) -> Counts {
        counts.of_diagram(options)
    }
}

impl Needs for CvtHeader {
    const KIND: estimate::Kind = estimate::Kind::Cvt;
    const HAS_CONTINUATIONS: bool = true;

    fn counts(counts: Counts, options: &Session) -> Counts {
        counts.of_session(options)
    }
}
