//! Promise: a job ends at its ceilings, and work that does not stop is seen, told and ended.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use glam::DVec3;
use jobs::Ceilings;
use server::service::ServeError;
use tessera::proto::{BackendChoice, RvdOutput};
use tonic::Code;
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;
use tonic_types::StatusExt;

use super::server::*;

async fn health(server: &Server) -> ServingStatus {
    let request = HealthCheckRequest { service: String::new() };
    let answer = HealthClient::new(server.channel().await).check(request).await.unwrap();
    answer.into_inner().status()
}

async fn health_becomes(server: &Server, wanted: ServingStatus) {
    let waiting = async {
        while health(server).await != wanted {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    tokio::time::timeout(PATIENCE, waiting).await.unwrap_or_else(|_| panic!("health never became {wanted:?}"));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_ends_at_its_ceiling_on_time() {
    let fake = Arc::new(Fake::new(Mood::Busy));
    let ceilings = Ceilings { time: Some(Duration::from_millis(300)), ..Ceilings::default() };
    let server = Server::start(Setup { ceilings, ..Setup::fake(&fake) }).await;
    let mut client = server.client().await;
    let status = ask_rvd(&mut client, small_rvd(BackendChoice::Serial)).await.unwrap_err();
    assert_eq!(status.code(), Code::ResourceExhausted, "{status:?}");
    assert!(status.message().contains("limit of 0.3 s"), "{status:?}");
    let quota = status.get_details_quota_failure().unwrap();
    assert_eq!(quota.violations[0].subject, "job-seconds");
    assert!(status.get_details_retry_info().is_none(), "the same job would end there again");
    ask_rvd(&mut client, small_rvd(BackendChoice::Parallel)).await.unwrap();
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_ends_at_its_ceiling_on_memory() {
    // More than so small a job is expected to need, and less than what is held beside it below.
    let fake = Arc::new(Fake::new(Mood::Busy));
    let ceilings = Ceilings { memory_bytes: Some(100 << 20), ..Ceilings::default() };
    let server = Server::start(Setup { ceilings, ..Setup::fake(&fake) }).await;
    let mut client = server.client().await;
    let asked = tokio::spawn(async move { ask_rvd(&mut client, small_rvd(BackendChoice::Serial)).await });
    let mut held = Vec::new();
    while !asked.is_finished() && held.len() < 1000 {
        held.push(vec![1u8; 1 << 20]);
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    let status = asked.await.unwrap().unwrap_err();
    assert_eq!(status.code(), Code::ResourceExhausted, "{status:?}");
    assert_eq!(status.get_details_quota_failure().unwrap().violations[0].subject, "job-memory-mib");
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_that_never_fits_is_refused_at_its_header() {
    let ceilings = Ceilings { memory_bytes: Some(1 << 20), ..Ceilings::default() };
    let server = Server::start(Setup { ceilings, ..Setup::default() }).await;
    let header = small_rvd(BackendChoice::Parallel).into_iter().take(1);
    // Nothing more comes: the refusal does not wait for it.
    let requests = tokio_stream::StreamExt::chain(tokio_stream::iter(header), tokio_stream::pending());
    let status = match server.client().await.compute_rvd(requests).await {
        Ok(answers) => answers.into_inner().message().await.unwrap_err(),
        Err(status) => status,
    };
    assert_eq!(status.code(), Code::InvalidArgument, "{status:?}");
    assert!(status.message().contains("1048576"), "both figures are said: {status:?}");
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn needles_are_refused_once_they_are_read() {
    let fake = Arc::new(Fake::new(Mood::Busy));
    let ceilings = Ceilings { time: Some(Duration::from_millis(100)), ..Ceilings::default() };
    let server = Server::start(Setup { ceilings, ..Setup::fake(&fake) }).await;
    let rim = |k: u32| DVec3::new((f64::from(k) * 0.002).cos(), (f64::from(k) * 0.002).sin(), 0.0);
    let points: Vec<DVec3> = (0..3000).map(rim).chain([DVec3::Z]).collect();
    let facets: Vec<[u32; 3]> = (0..2999).map(|k| [k, k + 1, 3000]).collect();
    let asked = rvd_request(&points, &facets, &spiral(3000), BackendChoice::Serial, &[RvdOutput::Sums]);
    let status = ask_rvd(&mut server.client().await, asked).await.unwrap_err();
    assert_eq!(status.code(), Code::InvalidArgument, "{status:?}");
    assert!(status.message().contains("meet so many cells"), "{status:?}");
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn stuck_work_is_told_by_health_until_it_recovers() {
    let fake = Arc::new(Fake::new(Mood::Deaf));
    let ceilings = Ceilings { stuck: Duration::from_millis(300), lost: 10 * PATIENCE, ..Ceilings::default() };
    let server = Server::start(Setup { ceilings, ..Setup::fake(&fake) }).await;
    let mut request = tonic::Request::new(tokio_stream::iter(small_rvd(BackendChoice::Serial)));
    request.set_timeout(Duration::from_millis(300));
    let mut answers = server.client().await.compute_rvd(request).await.unwrap().into_inner();
    while let Ok(Some(_)) = answers.message().await {}
    health_becomes(&server, ServingStatus::NotServing).await;
    fake.released.store(true, Ordering::SeqCst);
    health_becomes(&server, ServingStatus::Serving).await;
    ask_rvd(&mut server.client().await, small_rvd(BackendChoice::Parallel)).await.unwrap();
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn work_that_never_stops_ends_the_server() {
    let fake = Arc::new(Fake::new(Mood::Deaf));
    let wait = Duration::from_millis(300);
    let server = Server::start(Setup {
        ceilings: Ceilings { stuck: wait, lost: wait, ..Ceilings::default() },
        ..Setup::fake(&fake)
    })
    .await;
    let mut request = tonic::Request::new(tokio_stream::iter(small_rvd(BackendChoice::Serial)));
    request.set_timeout(wait);
    let mut answers = server.client().await.compute_rvd(request).await.unwrap().into_inner();
    while let Ok(Some(_)) = answers.message().await {}
    assert!(matches!(server.ended().await, Err(ServeError::WorkStuck { .. })));
    fake.released.store(true, Ordering::SeqCst);
}
