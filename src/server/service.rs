//! The service: three streams over gRPC, blobs and jobs, health and reflection.
//!
//! Purpose: [`run`] serves on a listener until its shutdown, then drains. Invariant: nothing waits without a limit; every
//! error leaves through `status` and nowhere else; a stream that ends in any way gives back its memory and its place. Must
//! not know: how a diagram is computed, how messages look (`wire`), the command line.

mod access;
mod convert;
mod desk;
mod fault;
mod handlers;
mod health;
mod info;
mod status;
mod stream;

use std::future::Future;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use axum::Router;
use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio::task::JoinSet;
use tonic::codec::CompressionEncoding::{Gzip, Zstd};
use tonic::service::Routes;

use self::access::Guarded;
pub(crate) use self::access::{Caller, Pass, Refusal};
pub(crate) use self::convert::{job_id, reuse};
pub(crate) use self::desk::{DESK_TIME, Desk, EmptyUpload, check_owned, create, follow, tenant_of, timely, to_the_end};
pub(crate) use self::fault::{Detail, Fault, Kind as FaultKind};
use self::health::Told;
pub use self::info::{About, Info};
pub(crate) use self::stream::{Gate, Kind};
use crate::config::Limits;
use crate::hosts::Reach;
use crate::lifecycle::{self, Step};
use crate::metrics::Metrics;
use crate::readiness::{Readiness, Reason};
use jobs::blob::{BlobError, BlobStore, Digest};
use jobs::executor::api::{JobApi, JobApiError};
use jobs::executor::prepared::Input;
use jobs::{Device, Engine, JobError};
use transport::{Budget, Calls, ConnectionLimits, Grpc, Phase, Protocol, Rejection, Shared, Tls};
use wire::{WireError, proto};

pub use self::access::{Access, AccessOptions};

pub const SERVICE_NAME: &str = "tessera.v1.RemeshService";

pub const BLOB_SERVICE_NAME: &str = "tessera.v1.BlobService";

pub const JOB_SERVICE_NAME: &str = "tessera.v1.JobService";

pub const SERVER_SERVICE_NAME: &str = "tessera.v1.ServerService";

pub struct Parts {
    pub engine: Engine,
    /// The engine's thread, joined at the end.
    pub worker: JoinHandle<()>,
    /// What a request may ask for, and how long things may take.
    pub limits: Limits,
    /// Jobs that outlive their stream; without, neither they nor blobs are served.
    pub jobs: Option<Jobs>,
    pub tls: Option<Arc<Tls>>,
    pub access: Access,
    /// Counts. Give the engine the same.
    pub metrics: Metrics,
    pub readiness: Readiness,
    pub about: About,
    pub door: Option<Door>,
}

/// A way in beside gRPC: where it listens, and what it makes of the desk.
pub struct Door {
    listener: TcpListener,
    open: Box<dyn FnOnce(Desk) -> Router + Send>,
}

impl Door {
    pub fn new(listener: TcpListener, open: impl FnOnce(Desk) -> Router + Send + 'static) -> Self {
        Self { listener, open: Box::new(open) }
    }
}

#[derive(Clone)]
pub struct Jobs {
    pub blobs: Arc<dyn BlobStore>,
    pub api: Arc<dyn JobApi>,
}

#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    #[error("the descriptors for reflection are broken: {0}")]
    Reflection(#[from] tonic_reflection::server::Error),
    #[error("the engine ended while it was needed; the log may say why")]
    WorkerDied,
    #[error("the engine did not end within {} s of the shutdown", .0.as_secs_f64())]
    WorkerStuck(Duration),
    #[error("the journal of jobs can no longer be written; see that its disk has room and is sound, then start again")]
    Journal,
    #[error("the device was lost and could not be opened again; see to its driver, or give --on-device-loss cpu")]
    DeviceMissing,
    #[error("work in the stage {stage:?} went on long after it was told to stop; only a new process can go on")]
    WorkStuck { stage: &'static str },
}

/// Why a request is refused or ends badly. `status` makes a status code of it.
#[derive(Clone, Debug, thiserror::Error)]
pub enum RequestError {
    #[error(transparent)]
    Wire(#[from] WireError),
    #[error(transparent)]
    Transport(#[from] Rejection),
    #[error("all of the {limit} {what} that may be open are in use, or as many of them as one tenant may have")]
    TooMany { what: &'static str, limit: usize },
    #[error("no message came for {} s", .0.as_secs_f64())]
    Idle(Duration),
    #[error("the upload was not complete after {} s", .0.as_secs_f64())]
    UploadTime(Duration),
    #[error("the client took none of the bytes that wait for it for {} s", .0.as_secs_f64())]
    Stalled(Duration),
    #[error("the deadline has passed")]
    Deadline,
    #[error("the client has gone")]
    ClientGone,
    #[error("{}", Rejection::Draining)]
    Draining,
    #[error(
        "this server does no streams: {}",
        address.as_ref().map_or("create a job instead".to_owned(), |at| format!("ask {at}, or create a job"))
    )]
    Elsewhere { address: Option<String> },
    #[error("the job is at work at the server {holder:?}, which alone shows its seeds; its events are here too")]
    SeedsElsewhere { holder: String },
    #[error(
        "the server does no more streams; the last seeds of this one are the blob {seeds}, an array of three F64 for each: begin \
         with them at another server"
    )]
    SessionEnded { seeds: Digest },
    #[error("the server's storage did not answer within {} s", .0.as_secs_f64())]
    Slow(Duration),
    #[error(transparent)]
    Job(#[from] JobError),
    #[error(transparent)]
    Blob(#[from] BlobError),
    #[error(transparent)]
    JobApi(#[from] JobApiError),
    #[error(transparent)]
    Access(#[from] access::Refusal),
    #[error("{}", .0.message())]
    Inbound(tonic::Status),
}

impl RequestError {
    /// The caller's key is no good, or no longer.
    pub fn unauthenticated() -> Self {
        Self::Access(access::Refusal::Unauthenticated)
    }
}

/// The start of the paths of services that take uploads; health and reflection have short messages.
const UPLOADS: &str = "/tessera.v1.";

/// Streams of a connection for health and reflection.
const EXTRA_STREAMS: u32 = 16;

/// Time for streams to end once they were cut, and for connections to close.
const CUT_TIME: Duration = Duration::from_secs(2);

/// Takes the upload of a recorded `Remesh` stream as the service would, without a server: fuzzers call it, and so may a
/// caller with a recording that was refused. A recording is every request after its length as a varint, up to the one that
/// finishes the upload. Errors: what the service would say.
pub fn replay(recording: &[u8], limits: &Limits) -> Result<Input, String> {
    handlers::replay(&mut &*recording, limits).map_err(|error| error.to_string())
}

/// Serves on `listener` until `shutdown` is ready; then refuses new streams, lets open ones end within the grace period,
/// cuts what is left, joins the engine and returns.
/// Without a listener nothing but work of the store is done.
pub async fn run(
    listener: impl Into<Option<TcpListener>>,
    parts: Parts,
    shutdown: impl Future<Output = ()> + Send,
) -> Result<(), ServeError> {
    let Parts { engine, worker, limits, jobs, tls, access, metrics, readiness, about, door } = parts;
    let message_bytes = limits.connections.message_bytes;
    // Ended with the server, wherever it is.
    let mut tasks = JoinSet::new();
    let phase = watch::Sender::new(Phase::Serving);
    let budget = Budget::told(limits.memory_bytes, engine.memory_outside_jobs());
    metrics.memory(engine.memory_outside_jobs(), limits.memory_bytes);
    let gate = Gate::new(limits, phase.subscribe(), metrics.clone());
    let api = jobs.as_ref().map(|jobs| Arc::clone(&jobs.api));
    access.follow(engine.weights().clone(), api.clone(), &mut tasks);
    let handlers = handlers::Handlers::new((engine.clone(), jobs.clone()), limits, budget.clone(), gate.clone());
    let info = Info { engine: engine.clone(), limits, readiness: readiness.clone(), about };
    let (health, health_service) = tonic_health::server::health_reporter();
    let names = names(jobs.is_some());
    let health = Arc::new(Told::new(health, names, metrics.clone()));
    readiness.set(Reason::Starting, true);
    let begin = Instant::now();
    health::check(&engine, &readiness, &metrics).await;
    lifecycle::ended(&metrics, Step::Probe, begin);
    readiness.set(Reason::Starting, false);
    health.tell(readiness.condition()).await;
    let mut routes = Routes::new(health_service)
        .add_service(proto::server_service_server::ServerServiceServer::new(info.clone()))
        .add_service(
            proto::remesh_service_server::RemeshServiceServer::new(handlers)
                .max_decoding_message_size(message_bytes)
                .accept_compressed(Gzip)
                .accept_compressed(Zstd)
                .send_compressed(Gzip)
                .send_compressed(Zstd),
        );
    if access.options().reflection {
        routes = routes.add_service(reflection(names)?.build_v1()?).add_service(reflection(names)?.build_v1alpha()?);
    }
    tasks.spawn(Arc::clone(&health).follow(readiness.clone()));
    tasks.spawn(health::probes(engine.clone(), readiness.clone(), metrics.clone(), limits.probe));
    if let Some(jobs) = &jobs {
        let storage = jobs.api.storage();
        tasks.spawn(health::follow_blobs(Arc::clone(&jobs.blobs), storage, readiness.clone(), metrics.clone()));
        let cluster = crate::cluster::follow(Arc::clone(&jobs.api), metrics.clone(), readiness.clone());
        tasks.spawn(async move {
            let _ = cluster.await;
        });
    }
    // By TLS a name that resolves to this address has no certificate.
    let wide = if tls.is_some() { Reach::Anywhere } else { Reach::Near };
    let door = door.zip(jobs.as_ref()).map(|(door, Jobs { api, blobs })| {
        let (api, blobs, access) = (Arc::clone(api), Arc::clone(blobs), access.of(&door.listener, wide));
        let (budget, gate, metrics) = (budget.clone(), gate.clone(), metrics.clone());
        (door.listener, (door.open)(Desk { api, blobs, limits, budget, gate, access, metrics, info: info.clone() }))
    });
    if let Some(jobs) = jobs {
        routes = with_jobs(routes, jobs, limits, &budget, &gate);
    }
    // Browsers speak no HTTP/2 without TLS.
    let listener = listener.into();
    let guard = listener.as_ref().map(|listener| access.of(listener, Reach::Anywhere));
    let guarded = guard.map(|guard| Guarded::new(guard, routes.prepare()));
    let closing = watch::Sender::new(CUT_TIME);
    let shared = Shared::new(connections(&limits), budget, metrics.connections(), tls);
    let grpc = guarded.map(|guarded| {
        Protocol::Grpc(Arc::new(Grpc {
            routes: Box::new(move |request| Box::pin(guarded.clone().call(request))),
            calls: Calls::new(metrics.connections(), access::served()),
            uploads: UPLOADS,
            status: |rejection| RequestError::from(rejection).into(),
        }))
    });
    let beside = async {
        if let Some((listener, router)) = door {
            let web = Protocol::Web(router);
            transport::serve(listener, web, shared.clone(), phase.subscribe(), closing.subscribe()).await;
        }
    };
    let mut phases = phase.subscribe();
    let serving = async {
        match listener.zip(grpc) {
            Some((listener, grpc)) => {
                transport::serve(listener, grpc, shared.clone(), phase.subscribe(), closing.subscribe()).await;
            }
            None => drop(phases.wait_for(|phase| *phase == Phase::Closing).await),
        }
    };
    let serving = async { tokio::join!(serving, beside) };
    tokio::pin!(serving);

    let unkept = async {
        match &api {
            Some(api) => api.failed().await,
            None => std::future::pending().await,
        }
    };
    let mut is_kept = true;
    let lost = tokio::select! {
        _ = &mut serving => None,
        () = shutdown => None,
        () = unkept => {
            is_kept = false;
            readiness.set(Reason::JournalBroken, true);
            None
        }
        lost = health::follow_engine(&engine, &readiness, &metrics) => lost,
    };
    // A wait for work that never ends would be in vain.
    let grace = if lost.is_some() { Duration::ZERO } else { limits.grace };
    tracing::info!(grace_s = grace.as_secs_f64(), "shutting down: no new streams, open ones may end");
    // Before the phase: watchers get the status, and then their stream ends.
    readiness.set(Reason::Draining, true);
    health.tell(readiness.condition()).await;
    phase.send_replace(Phase::Draining);
    let begin = Instant::now();
    let idle = || async {
        let jobs = async {
            if let Some(api) = &api {
                api.drain().await;
            }
        };
        tokio::join!(gate.idle(), jobs);
    };
    let draining = async {
        if tokio::time::timeout(grace, idle()).await.is_err() {
            tracing::warn!("the grace period is over: cutting what is left");
        }
        lifecycle::ended(&metrics, Step::Drain, begin);
        let drained = Instant::now();
        phase.send_replace(Phase::Cut);
        engine.cancel_all();
        let _ = tokio::time::timeout(CUT_TIME, idle()).await;
        // Answers that are written may still be on their way to a slow reader.
        closing.send_replace(grace.saturating_sub(begin.elapsed()).max(CUT_TIME));
        phase.send_replace(Phase::Closing);
        drained
    };
    let (drained, _) = tokio::join!(draining, serving);
    lifecycle::ended(&metrics, Step::Close, drained);
    if let Some(stage) = lost {
        return Err(ServeError::WorkStuck { stage });
    }
    let device = *engine.watch_device().borrow();
    let begin = Instant::now();
    engine.close();
    join(worker).await?;
    lifecycle::ended(&metrics, Step::Engine, begin);
    if !is_kept {
        return Err(ServeError::Journal);
    }
    match device {
        Device::Gone => return Err(ServeError::WorkerDied),
        Device::Missing => return Err(ServeError::DeviceMissing),
        Device::Ready | Device::Lost | Device::Replaced => {}
    }
    tracing::info!("ended");
    Ok(())
}

/// The limits of connections. A connection may have all streams of the server open, and some for health and reflection.
fn connections(limits: &Limits) -> ConnectionLimits {
    let all = u32::try_from(limits.max_streams).unwrap_or(u32::MAX).saturating_add(EXTRA_STREAMS);
    ConnectionLimits { streams: limits.connections.streams.or(Some(all)), ..limits.connections }
}

/// Waits for the engine, but not for ever.
async fn join(worker: JoinHandle<()>) -> Result<(), ServeError> {
    let limit = Duration::from_secs(10);
    let start = Instant::now();
    while !worker.is_finished() {
        if start.elapsed() > limit {
            return Err(ServeError::WorkerStuck(limit));
        }
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    if worker.join().is_err() {
        tracing::error!("the engine ended with a panic");
    }
    Ok(())
}

fn with_jobs(routes: Routes, Jobs { blobs, api }: Jobs, limits: Limits, budget: &Budget, gate: &Gate) -> Routes {
    let jobs = handlers::jobs::Jobs::new(api, Arc::clone(&blobs), budget.clone(), gate.clone());
    let blobs = handlers::blobs::Blobs::new(blobs, limits, budget.clone(), gate.clone());
    let message_bytes = limits.connections.message_bytes;
    // What is read is not compressed: results seldom shrink, and their clients wait for them.
    let blobs = proto::blob_service_server::BlobServiceServer::new(blobs)
        .max_decoding_message_size(message_bytes)
        .accept_compressed(Gzip)
        .accept_compressed(Zstd);
    let jobs = proto::job_service_server::JobServiceServer::new(jobs)
        .max_decoding_message_size(message_bytes)
        .accept_compressed(Gzip)
        .accept_compressed(Zstd)
        .send_compressed(Gzip)
        .send_compressed(Zstd);
    routes.add_service(blobs).add_service(jobs)
}

fn names(jobs: bool) -> &'static [&'static str] {
    const NAMES: &[&str] = &[SERVICE_NAME, SERVER_SERVICE_NAME, BLOB_SERVICE_NAME, JOB_SERVICE_NAME];
    if jobs { NAMES } else { &[SERVICE_NAME, SERVER_SERVICE_NAME] }
}

fn reflection(names: &[&str]) -> Result<tonic_reflection::server::Builder<'static>, ServeError> {
    let builder = tonic_reflection::server::Builder::configure()
        .register_encoded_file_descriptor_set(proto::DESCRIPTORS)
        .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
        // Each version lists the other, and so has to describe it: clients ask about all that is listed.
        .register_encoded_file_descriptor_set(tonic_reflection::pb::v1::FILE_DESCRIPTOR_SET)
        .register_encoded_file_descriptor_set(tonic_reflection::pb::v1alpha::FILE_DESCRIPTOR_SET);
    // Named, since the descriptors have services that may not be served.
    let others =
        ["grpc.health.v1.Health", "grpc.reflection.v1.ServerReflection", "grpc.reflection.v1alpha.ServerReflection"];
    Ok(names.iter().copied().chain(others).fold(builder, tonic_reflection::server::Builder::with_service_name))
}
