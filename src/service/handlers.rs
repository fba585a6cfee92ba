//! The three streams.
//!
//! Purpose: read the upload, hand it to the engine, send what comes back. Invariant: thin: no
//! geometry here, and no status codes. What a stream holds is dropped with its future.
//! Must not know: which backend works, how statuses look.

use std::sync::Arc;

use prost::Message as _;
use tokio::sync::{Semaphore, watch};
use tonic::{Request, Response, Status, Streaming};

use super::assemble::Uploaded;
use super::limits::{self, Budget, MeshCounts, SeedCounts, Share};
use super::proto::{self, ArrayKind, Chunk};
use super::stream::{Answers, Gate, Inbox, Outbox, respond};
use super::upload::{Header, Incoming, Upload};
use super::{Phase, RequestError, convert, options};
use crate::config::Limits;
use crate::job::spec::{Input, Prepared};
use crate::job::{BackendInfo, Engine, JobError};
use crate::mesh::TriMesh;
use crate::remesh::Seeds;

mod cvt;
mod diagram;
mod remesh;

/// The service.
pub(crate) struct Handlers {
    shared: Arc<Shared>,
    gate: Gate,
}

/// What every stream uses.
struct Shared {
    engine: Engine,
    limits: Limits,
    budget: Budget,
    gate: Gate,
    /// Surfaces prepared at once: as many as there are cores.
    preparing: Semaphore,
}

impl Handlers {
    pub(crate) fn new(engine: Engine, limits: Limits, phase: watch::Receiver<Phase>) -> Self {
        let gate = Gate::new(limits, phase);
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let shared = Shared {
            engine,
            limits,
            budget: Budget::new(limits.memory_bytes),
            gate: gate.clone(),
            preparing: Semaphore::new(cores),
        };
        Self { shared: Arc::new(shared), gate }
    }

    pub(crate) fn gate(&self) -> &Gate {
        &self.gate
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
    ) -> Result<Response<Self::ComputeRvdStream>, Status> {
        let (metadata, _, stream) = request.into_parts();
        let shared = Arc::clone(&self.shared);
        Ok(respond("ComputeRvd", &metadata, &self.gate, |out| diagram::handle(shared, Inbox::new(stream), out))?)
    }

    async fn cvt(&self, request: Request<Streaming<proto::CvtRequest>>) -> Result<Response<Self::CvtStream>, Status> {
        let (metadata, _, stream) = request.into_parts();
        let shared = Arc::clone(&self.shared);
        Ok(respond("Cvt", &metadata, &self.gate, |out| cvt::handle(shared, Inbox::new(stream), out))?)
    }

    async fn remesh(
        &self,
        request: Request<Streaming<proto::RemeshRequest>>,
    ) -> Result<Response<Self::RemeshStream>, Status> {
        let (metadata, _, stream) = request.into_parts();
        let shared = Arc::clone(&self.shared);
        Ok(respond("Remesh", &metadata, &self.gate, |out| remesh::handle(shared, Inbox::new(stream), out))?)
    }
}

/// Reads header, chunks and the end mark.
async fn upload<M, H: Header>(
    shared: &Shared,
    inbox: &mut Inbox<M>,
    split: fn(M) -> Incoming<H>,
) -> Result<(H, SeedCounts, Uploaded), RequestError> {
    let mut upload = Upload::new(shared.limits, shared.budget.clone());
    loop {
        let message = inbox.next(shared.limits.upload_idle).await?;
        if let Some(complete) = upload.take(message.map(split))? {
            return Ok(complete);
        }
    }
}

/// The upload of a recorded `Remesh` stream, as far as it needs no engine.
pub(crate) fn replay(recording: &mut &[u8], limits: &Limits) -> Result<Input, RequestError> {
    let mut upload = Upload::new(*limits, Budget::new(limits.memory_bytes));
    loop {
        let message = match recording.is_empty() {
            true => None,
            false => Some(proto::RemeshRequest::decode_length_delimited(&mut *recording).map_err(|error| {
                // As tonic says it.
                RequestError::Inbound(Status::invalid_argument(error.to_string()))
            })?),
        };
        if let Some((header, seeds, uploaded)) = upload.take(message.map(remesh::split))? {
            return Ok(input(seeds, uploaded, header.density.as_ref(), limits)?.0);
        }
    }
}

/// Makes the engine's input of an upload.
fn input(
    seeds: SeedCounts,
    uploaded: Uploaded,
    density: Option<&proto::DensityOptions>,
    limits: &Limits,
) -> Result<(Input, Share), RequestError> {
    let Uploaded { positions, facets, weights, seeds: points, edge_lengths, creases, attributes, share } = uploaded;
    let density = convert::density(density, weights, edge_lengths, limits.max_seeds)?;
    let mesh = TriMesh::new(positions, facets).map_err(JobError::from)?;
    let attributes = match attributes.is_empty() {
        true => None,
        false => Some(super::attributes::collect(&mesh, attributes)?),
    };
    let seeds = match seeds {
        SeedCounts::Uploaded(_) => Seeds::Given(points),
        SeedCounts::Sampled { points, seed } => Seeds::Sample { points: points as usize, seed },
        SeedCounts::Implied { seed } => Seeds::Implied { seed },
    };
    Ok((Input { mesh, density, seeds, creases, attributes }, share))
}

/// Does long work that needs no backend, on a thread that may block.
async fn apart<R: Send + 'static>(
    shared: &Shared,
    work: impl FnOnce() -> Result<R, RequestError> + Send + 'static,
) -> Result<R, RequestError> {
    let Ok(_permit) = shared.preparing.acquire().await else { return Err(RequestError::Draining) };
    match tokio::task::spawn_blocking(work).await {
        Ok(result) => result,
        Err(panic) => Err(JobError::Panicked(panic.to_string()).into()),
    }
}

/// Checks an upload, and prepares it `by` one of the ways there are.
async fn prepare(
    shared: &Shared,
    seeds: SeedCounts,
    uploaded: Uploaded,
    density: Option<proto::DensityOptions>,
    by: fn(Input) -> Result<Prepared, JobError>,
) -> Result<(Arc<Prepared>, Share), RequestError> {
    let limits = shared.limits;
    apart(shared, move || {
        let (input, share) = input(seeds, uploaded, density.as_ref(), &limits)?;
        Ok((Arc::new(by(input)?), share))
    })
    .await
}

/// Sends an array.
async fn send_all<T>(
    outbox: &Outbox<T>,
    chunks: impl Iterator<Item = Chunk>,
    wrap: fn(Chunk) -> T,
) -> Result<(), RequestError> {
    for chunk in chunks {
        outbox.send(wrap(chunk)).await?;
    }
    Ok(())
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

    /// Tells the log who did the work and how long it took.
    fn note(self, method: &'static str, by: &BackendInfo) {
        let Self { queue_ms, compute_ms } = self;
        tracing::info!(method, backend = by.kind.name(), adapter = by.adapter, queue_ms, compute_ms, "worked");
    }

    fn progress(self, stage: &str, done: u64, total: u64) -> proto::Progress {
        proto::Progress { stage: stage.to_owned(), done, total, timing: Some(self.timing()) }
    }
}

/// Sends points as an array; a name for what all streams do with seeds.
async fn send_seeds<T>(outbox: &Outbox<T>, seeds: &[glam::DVec3], wrap: fn(Chunk) -> T) -> Result<(), RequestError> {
    send_all(outbox, convert::point_chunks(ArrayKind::Seeds, seeds), wrap).await
}

impl From<crate::remesh::RemeshError> for RequestError {
    fn from(error: crate::remesh::RemeshError) -> Self {
        Self::Job(error.into())
    }
}

impl From<crate::mesh::MeshError> for RequestError {
    fn from(error: crate::mesh::MeshError) -> Self {
        Self::Job(error.into())
    }
}
