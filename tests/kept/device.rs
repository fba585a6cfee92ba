//! Promise: a device that is lost or hangs costs time and no job: health says so within a second, the device is opened anew,
//! and the job that was at work gives the same bits.
//!
//! A real device of wgpu, a software one too, in a server of this process: it is destroyed under the jobs, or given work that
//! takes longer than any submission may. `TESSERA_LOSSES=20 TESSERA_HANGS=5` does so as often. A software device that hangs
//! keeps all cores busy, so no hang is the default.

#[path = "../common/gpu.rs"]
mod gpu;
#[path = "../common/hang.rs"]
mod hang;

use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use ::gpu::diagram::Gpu;
use ::gpu::{Device, DeviceOptions};
use jobs::blob::BlobOptions;
use jobs::*;
use needs::needs;
use serde_json::json;
use server::config::Limits;
use server::metrics::Metrics;
use server::readiness::Readiness;
use server::service::{self, About, Access, Jobs, Parts, SERVICE_NAME, ServeError};
use tessera::mesh::shapes::Shape;
use tessera::proto::*;
use tessera::{BackendKind, RvdError};
use tokio::net::TcpListener;
use tokio::sync::oneshot;
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;

use self::hang::Hang;
use super::program::{Client, part, remesh};

const LIMIT: Duration = Duration::from_secs(120);
/// What the device may take for one submission. The first ones compile shaders, for a minute where nothing is cached; a hang is
/// waited for to its end.
fn timeout() -> Duration {
    Duration::from_secs(if times("TESSERA_HANGS", 0) > 0 { 20 } else { 120 })
}

fn times(name: &str, usual: usize) -> usize {
    std::env::var(name).map_or(usual, |text| text.parse().unwrap())
}

/// A server whose device can be taken away.
struct Server {
    address: SocketAddr,
    engine: Engine,
    device: Arc<Mutex<Option<Arc<Device>>>>,
    /// Whether the device can be opened.
    is_there: Arc<Mutex<bool>>,
    journal: Arc<dyn store::JobStore>,
    readiness: Readiness,
    stop: oneshot::Sender<()>,
    served: tokio::task::JoinHandle<Result<(), ServeError>>,
}

impl Server {
    async fn start(loss: LossPolicy, loss_patience: Duration) -> Self {
        let device = Arc::new(Mutex::new(None));
        let is_there = Arc::new(Mutex::new(true));
        let (kept, there) = (Arc::clone(&device), Arc::clone(&is_there));
        let factory = move || -> Result<Backends, JobError> {
            let away =
                |reason: &str| RvdError::BackendUnavailable { wanted: BackendKind::Gpu, reason: reason.to_owned() };
            if !*there.lock().unwrap() {
                return Err(away("taken away on purpose").into());
            }
            let options = DeviceOptions { software: true, timeout: timeout(), ..DeviceOptions::default() };
            let opened = Device::open(&options).map_err(|error| away(&error.to_string()))?;
            *kept.lock().unwrap() = Some(Arc::clone(&opened));
            Ok(Backends {
                gpu: Ok(Arc::new(Gpu::new(opened, Some(1))?)),
                parallel: tessera::BackendOptions::new()
                    .with_choice(tessera::BackendChoice::Only(BackendKind::Parallel))
                    .with_threads(1)
                    .open()?,
                serial: tessera::BackendOptions::new()
                    .with_choice(tessera::BackendChoice::Only(BackendKind::Serial))
                    .open()?,
                default: tessera::BackendChoice::Only(BackendKind::Gpu),
                pools: None,
            })
        };
        let revive = Duration::from_millis(200);
        let options = EngineOptions { jobs_at_once: 1, revive, loss, loss_patience, ..EngineOptions::default() };
        let (engine, worker) = Engine::start(factory, options).unwrap();
        let limits = Limits::default();
        let Limits { max_vertices, max_facets, max_seeds, max_iterations, .. } = limits;
        let bounds = wire::counts::Bounds { max_vertices, max_facets, max_seeds, max_iterations };
        let stores = Stores::ephemeral(BlobOptions::default());
        let blobs = Arc::clone(&stores.blobs);
        let journal = Arc::clone(&stores.jobs);
        let executor = Executor::start(engine.clone(), stores, ExecutorOptions::new(bounds)).await.unwrap();
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let (stop, stopped) = oneshot::channel();
        let jobs = Some(Jobs { blobs, api: Arc::new(executor) });
        let readiness = Readiness::new();
        let parts = Parts {
            engine: engine.clone(),
            worker,
            limits,
            jobs,
            tls: None,
            access: Access::open(),
            metrics: Metrics::default(),
            readiness: readiness.clone(),
            about: About::default(),
            door: None,
        };
        let served = tokio::spawn(service::run(listener, parts, async {
            let _ = stopped.await;
        }));
        Self { address, engine, device, is_there, journal, readiness, stop, served }
    }

    async fn client(&self) -> Client {
        Client::to(&self.address.to_string()).await
    }

    /// Takes the device away for good.
    fn lose(&self) {
        self.device.lock().unwrap().as_ref().unwrap().raw().destroy();
    }

    /// Work that the device of now takes this long for, compiled and measured. Nothing of it is at the device yet.
    fn hang(&self, time: Duration) -> Hang {
        Hang::new(Arc::clone(self.device.lock().unwrap().as_ref().unwrap()), time)
    }

    /// What health says, from now on.
    async fn health(&self) -> tonic::Streaming<tonic_health::pb::HealthCheckResponse> {
        let channel = tonic::transport::Endpoint::from_shared(format!("http://{}", self.address)).unwrap();
        let mut health = HealthClient::new(channel.connect().await.unwrap());
        let request = HealthCheckRequest { service: SERVICE_NAME.to_owned() };
        health.watch(request).await.unwrap().into_inner()
    }

    async fn stop(self) -> Result<(), ServeError> {
        let _ = self.stop.send(());
        self.served.await.unwrap()
    }
}

/// Waits until a job is at its steps.
async fn steps(client: &mut Client, id: &str) {
    let request = WatchJobRequest { id: id.to_owned(), after: 0 };
    let mut stream = client.jobs.watch_job(request).await.unwrap().into_inner();
    while let Some(message) = stream.message().await.unwrap() {
        if matches!(message.event.unwrap().what, Some(job_event::What::Iteration(_))) {
            return;
        }
    }
    panic!("a job without steps");
}

#[needs(gpu)]
#[tokio::test(flavor = "multi_thread")]
async fn no_job_is_lost_with_its_device() {
    if self::gpu::device().is_none() {
        return;
    }
    let (losses, hangs) = (times("TESSERA_LOSSES", 3), times("TESSERA_HANGS", 0));
    let server = Server::start(LossPolicy::Wait, Duration::from_secs(30)).await;
    let mut client = server.client().await;
    // Two jobs: one for each way to lose the device. The long one is still at its steps when the device is given its work.
    let (mut calm_s, mut told, mut ended) = (Vec::new(), Vec::new(), Vec::new());
    for (rounds, hanging, facets, points) in [(losses, false, 1_200, 150), (hangs, true, 20_000, 5_000)] {
        if rounds == 0 {
            continue;
        }
        let digest = client.put_mesh(&Shape::Genus(3).build(facets)).await;
        let spec = remesh(&digest, points, 1);
        let begin = Instant::now();
        let calm = client.submit(spec.clone()).await;
        let calm = client.end(&calm, LIMIT).await;
        assert_eq!(calm.state(), JobState::Succeeded, "{calm:?}");
        let expected = part(&calm, "mesh");
        calm_s.push(begin.elapsed().as_secs_f64());
        for _ in 0..rounds {
            let mut health = server.health().await;
            assert_eq!(health.message().await.unwrap().unwrap().status(), ServingStatus::Serving);
            let hang = hanging.then(|| server.hang(2 * timeout()));
            let id = client.submit(spec.clone()).await;
            steps(&mut client, &id).await;
            let begin = Instant::now();
            match &hang {
                Some(hang) => drop(hang.submit()),
                None => server.lose(),
            }
            let heard = tokio::time::timeout(LIMIT, health.message()).await.expect("health changes").unwrap().unwrap();
            // A submission has its time.
            let after = begin.elapsed().saturating_sub(if hanging { timeout() } else { Duration::ZERO });
            assert_eq!(heard.status(), ServingStatus::NotServing);
            told.push(after.as_secs_f64());
            let job = client.end(&id, LIMIT).await;
            assert_eq!(job.state(), JobState::Succeeded, "{job:?}");
            assert_eq!(part(&job, "mesh"), expected, "the same bits");
            ended.push(begin.elapsed().as_secs_f64());
        }
    }
    assert_eq!(server.engine.losses(), (losses + hangs) as u64);
    // Within a second, as the long form holds it to on a machine that does nothing else; here before any job has ended.
    let in_time = if std::env::var_os("TESSERA_LOSSES").is_some() { 1.0 } else { 15.0 };
    assert!(told.iter().all(|seconds| *seconds < in_time), "NOT_SERVING in time: {told:?}");
    println!(
        "{}",
        json!({ "losses": losses, "hangs": hangs, "calm_s": calm_s, "not_serving_after_s": told, "job_ended_after_s": ended })
    );
    server.stop().await.unwrap();
}

#[needs(gpu)]
#[tokio::test(flavor = "multi_thread")]
async fn a_device_that_does_not_come_back_ends_the_server_or_its_use() {
    if self::gpu::device().is_none() {
        return;
    }
    let mesh = Shape::Genus(3).build(1_200);
    // Its work goes to the CPU, and says so.
    let server = Server::start(LossPolicy::Cpu, Duration::from_millis(500)).await;
    let mut client = server.client().await;
    let digest = client.put_mesh(&mesh).await;
    let id = client.submit(remesh(&digest, 150, 1)).await;
    steps(&mut client, &id).await;
    *server.is_there.lock().unwrap() = false;
    server.lose();
    let job = client.end(&id, LIMIT).await;
    assert_eq!(job.state(), JobState::Succeeded, "{job:?}");
    let report: serde_json::Value = serde_json::from_slice(&client.read(&part(&job, "report")).await).unwrap();
    assert_eq!(report["backend"], "parallel");
    let mut health = server.health().await;
    // The job may end before the server has said so of itself.
    let serves = async { while health.message().await.unwrap().unwrap().status() != ServingStatus::Serving {} };
    tokio::time::timeout(LIMIT, serves).await.expect("it serves on the CPU");
    assert_eq!(server.readiness.condition().to_string(), "ready; degraded: on_cpu");
    server.stop().await.unwrap();

    // The process is told to end; the job is put back, and not failed.
    let server = Server::start(LossPolicy::End, Duration::from_millis(500)).await;
    let mut client = server.client().await;
    let digest = client.put_mesh(&mesh).await;
    let id = client.submit(remesh(&digest, 150, 1)).await;
    steps(&mut client, &id).await;
    *server.is_there.lock().unwrap() = false;
    server.lose();
    let journal = Arc::clone(&server.journal);
    let ended = tokio::time::timeout(LIMIT, server.served).await.expect("it ends").unwrap();
    assert!(matches!(ended, Err(ServeError::DeviceMissing)), "{ended:?}");
    let job = journal.get(id.parse().unwrap()).await.unwrap();
    assert_eq!((job.status.state, job.status.crashes), (jobs::record::state::State::Queued, 0));
}
