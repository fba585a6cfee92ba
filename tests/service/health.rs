//! Promise: a backend that computes nonsense is found while nobody uses it, health says so within a second, and takes it
//! back by itself; what a server tells of itself agrees with its health.

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use glam::DVec3;
use jobs::blob::BlobError;
use server::config::Limits;
use server::service::{BLOB_SERVICE_NAME, JOB_SERVICE_NAME, SERVER_SERVICE_NAME, SERVICE_NAME};
use tessera::proto::server_service_client::ServerServiceClient;
use tessera::proto::*;
use tessera::rvd::{
    Backend, BackendKind, CellSums, PassStats, PieceBatch, RvdError, Serial, Session, SessionOptions, Surface,
};
use tessera::token::Token;
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;

use crate::server::*;

/// Computes right, or not.
#[derive(Default)]
struct Moody {
    is_wrong: Arc<AtomicBool>,
    probes: Arc<AtomicUsize>,
}

struct MoodySession {
    real: Box<dyn Session>,
    is_wrong: Arc<AtomicBool>,
    probes: Arc<AtomicUsize>,
}

impl Backend for Moody {
    fn kind(&self) -> BackendKind {
        BackendKind::Parallel
    }
    fn threads(&self) -> usize {
        1
    }
    fn session(&self, surface: Arc<Surface>, options: SessionOptions) -> Result<Box<dyn Session>, RvdError> {
        let real = Serial.session(surface, options)?;
        Ok(Box::new(MoodySession { real, is_wrong: self.is_wrong.clone(), probes: self.probes.clone() }))
    }
}

impl Session for MoodySession {
    fn set_seeds(&mut self, seeds: &[DVec3]) -> Result<(), RvdError> {
        self.real.set_seeds(seeds)
    }
    fn sums(&mut self, out: &mut CellSums, token: &Token) -> Result<PassStats, RvdError> {
        self.probes.fetch_add(1, Ordering::SeqCst);
        let stats = self.real.sums(out, token)?;
        if self.is_wrong.load(Ordering::SeqCst) {
            out.area[0] *= 1.5;
        }
        Ok(stats)
    }
    fn pieces(&mut self, facets: Range<u32>, out: &mut PieceBatch, token: &Token) -> Result<PassStats, RvdError> {
        self.real.pieces(facets, out, token)
    }
}

async fn next(states: &mut tonic::Streaming<tonic_health::pb::HealthCheckResponse>) -> ServingStatus {
    let state = tokio::time::timeout(PATIENCE, states.message()).await.expect("a change").unwrap().unwrap();
    state.status()
}

#[tokio::test]
async fn a_backend_that_computes_nonsense_is_found_and_comes_back() {
    let moody = Arc::new(Moody::default());
    let limits = Limits { probe: Duration::from_millis(100), ..Limits::default() };
    let server = Server::start(Setup { parallel: Some(moody.clone()), limits, ..Setup::default() }).await;
    let mut health = HealthClient::new(server.channel().await);
    let mut info = ServerServiceClient::new(server.channel().await);
    let ask = HealthCheckRequest { service: SERVICE_NAME.to_owned() };
    let mut states = health.watch(ask).await.unwrap().into_inner();
    assert_eq!(next(&mut states).await, ServingStatus::Serving);
    let told = info.get_server_info(GetServerInfoRequest {}).await.unwrap().into_inner();
    assert_eq!(told.readiness.unwrap(), Readiness { ready: true, ..Readiness::default() });

    moody.is_wrong.store(true, Ordering::SeqCst);
    assert_eq!(next(&mut states).await, ServingStatus::NotServing);
    let told = info.get_server_info(GetServerInfoRequest {}).await.unwrap().into_inner();
    assert_eq!(told.readiness.unwrap().reasons, ["probe_failed"]);

    moody.is_wrong.store(false, Ordering::SeqCst);
    assert_eq!(next(&mut states).await, ServingStatus::Serving);
    server.stop().await.unwrap();
}

#[tokio::test]
async fn a_backend_at_work_is_not_probed() {
    let moody = Arc::new(Moody::default());
    let busy = Arc::new(Fake::new(Mood::Busy));
    let limits = Limits { probe: Duration::from_millis(20), ..Limits::default() };
    let (serial, parallel) = (busy.clone(), Some(moody.clone() as Arc<dyn Backend>));
    let server = Server::start(Setup { serial, parallel, limits, ..Setup::default() }).await;
    let client = server.client().await;
    let work = tokio::spawn(async move {
        let mut client = client;
        ask_rvd(&mut client, small_rvd(BackendChoice::Serial)).await
    });
    until("the job is at work", || busy.running.load(Ordering::SeqCst) > 0).await;
    let before = moody.probes.load(Ordering::SeqCst);
    tokio::time::sleep(Duration::from_millis(400)).await;
    // Of the twenty that would be, one may have been decided on before the job was at work.
    let probes = moody.probes.load(Ordering::SeqCst);
    assert!(probes <= before + 1, "{probes} after {before}");
    let before = probes;
    work.abort();
    until("the engine is probed again", || moody.probes.load(Ordering::SeqCst) > before).await;
    server.stop().await.unwrap();
}

#[tokio::test]
async fn each_service_says_how_it_is() {
    let server = Server::start(Setup::default()).await;
    let mut health = HealthClient::new(server.channel().await);
    server.idle.storage.send_replace(Some(BlobError::StorageFull));
    for (name, expected) in [
        ("", ServingStatus::NotServing),
        (SERVICE_NAME, ServingStatus::Serving),
        (SERVER_SERVICE_NAME, ServingStatus::Serving),
        (JOB_SERVICE_NAME, ServingStatus::NotServing),
        (BLOB_SERVICE_NAME, ServingStatus::NotServing),
    ] {
        let start = Instant::now();
        loop {
            let asked = health.check(HealthCheckRequest { service: name.to_owned() }).await.unwrap();
            if asked.into_inner().status() == expected {
                break;
            }
            assert!(start.elapsed() < PATIENCE, "{name:?} is not {expected:?}");
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    }
    server.stop().await.unwrap();
}

#[tokio::test]
async fn a_server_tells_what_it_takes() {
    let limits = Limits { max_seeds: 1234, ..Limits::default() };
    let server = Server::start(Setup { limits, ..Setup::default() }).await;
    let mut info = ServerServiceClient::new(server.channel().await);
    let told = info.get_server_info(GetServerInfoRequest {}).await.unwrap().into_inner();
    assert_eq!(told.version, env!("CARGO_PKG_VERSION"));
    assert_eq!(told.limits.unwrap().max_seeds, 1234);
    assert_eq!(told.device, None);
    let state = |name: &str| told.backends.iter().find(|state| state.name == name).unwrap();
    assert!(state("parallel").is_default && state("parallel").threads == 2, "{told:?}");
    assert!(state("gpu").unavailable.contains("no GPU in this test"), "{told:?}");
    assert!(state("serial").unavailable.is_empty() && !state("serial").is_default);
    server.stop().await.unwrap();
}
