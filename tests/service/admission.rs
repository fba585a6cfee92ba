//! Promise: what cannot be done is refused before its mesh is sent; what was let in at its header is not refused later;
//! an upload has a time limit as a whole. A long report arrives.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use crate::server::*;
use server::config::Limits;
use tessera::proto::compute_rvd_request::Message as Ask;
use tessera::proto::*;
use tokio::sync::mpsc::Sender;
use tonic::{Code, Streaming};
use tonic_types::StatusExt;

const SECOND: Duration = Duration::from_secs(1);

/// Sends the first messages of a request; the rest waits.
async fn begin(
    server: &Server,
    backend: BackendChoice,
    first: usize,
) -> (Sender<ComputeRvdRequest>, Vec<ComputeRvdRequest>, Streaming<ComputeRvdResponse>) {
    let mut request = small_rvd(backend);
    let rest = request.split_off(first);
    let (send, stream) = by_hand();
    for message in request {
        send.send(message).await.unwrap();
    }
    let answers = server.client().await.compute_rvd(stream).await.unwrap().into_inner();
    (send, rest, answers)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_full_queue_refuses_at_the_header_and_keeps_its_word() {
    let fake = Arc::new(Fake::new(Mood::Busy));
    let server = Server::start(Setup { queue_jobs: 1, ..Setup::fake(&fake) }).await;
    let mut client = server.client().await;
    let busy = tokio::spawn(async move { ask_rvd(&mut client, small_rvd(BackendChoice::Serial)).await });
    until("the job runs", || fake.running.load(Ordering::SeqCst) == 1).await;
    // This one has the only place in the queue from its header on.
    let (send, rest, mut first) = begin(&server, BackendChoice::Parallel, 1).await;
    tokio::time::sleep(SECOND / 2).await;
    until("its place is kept", || server.engine.reserve("another").is_err()).await;
    let (_send, _rest, mut second) = begin(&server, BackendChoice::Parallel, 1).await;
    let status = tokio::time::timeout(PATIENCE, second.message()).await.expect("without its mesh").unwrap_err();
    assert_eq!(status.code(), Code::ResourceExhausted);
    assert!(status.get_details_retry_info().unwrap().retry_delay.is_some());
    for message in rest {
        send.send(message).await.unwrap();
    }
    use compute_rvd_response::Message::Accepted;
    assert!(matches!(first.message().await.unwrap().unwrap().message, Some(Accepted(_))));
    // Whoever gives up an upload gives back its place.
    drop((send, first));
    until("nobody waits", || server.engine.load().0 == 0 || server.engine.reserve("another").is_ok()).await;
    busy.abort();
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_backend_that_is_not_there_is_refused_at_the_header() {
    let server = Server::start(Setup::default()).await;
    let (_send, _rest, mut answers) = begin(&server, BackendChoice::Gpu, 1).await;
    let status = tokio::time::timeout(PATIENCE, answers.message()).await.expect("at once").unwrap_err();
    assert_eq!(status.code(), Code::FailedPrecondition);
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn an_upload_has_a_limit_as_a_whole() {
    let limits = Limits { upload: SECOND, upload_idle: 10 * PATIENCE, ..Limits::default() };
    let server = Server::start(Setup { limits, ..Setup::default() }).await;
    let (send, mut rest, mut answers) = begin(&server, BackendChoice::Parallel, 1).await;
    let Some(Ask::Chunk(positions)) = rest.remove(0).message else { panic!("positions come first") };
    let start = Instant::now();
    let drip = tokio::spawn(async move {
        for (i, byte) in positions.data.iter().enumerate() {
            let message = rvd_message(Ask::Chunk(chunk(ArrayKind::Positions, i as u64, &[*byte])));
            if send.send(message).await.is_err() {
                break;
            }
            tokio::time::sleep(SECOND / 10).await;
        }
    });
    let status = tokio::time::timeout(PATIENCE, answers.message()).await.expect("it ends").unwrap_err();
    assert_eq!(status.code(), Code::DeadlineExceeded, "{status:?}");
    assert!(start.elapsed() >= SECOND / 2);
    drip.abort();
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_long_report_comes_in_chunks() {
    const STEPS: u32 = 1000;
    let server = Server::start(Setup::default()).await;
    let (points, facets) = octahedron();
    let seeds = spiral(12);
    let header = RemeshHeader {
        mesh: Some(mesh_header(&points, &facets)),
        seeds: seeds.len() as u64,
        backend: BackendChoice::Serial.into(),
        options: Some(RemeshOptions {
            lloyd: Some(STEPS),
            newton: Some(0),
            measure: Measure::Topology.into(),
            ..RemeshOptions::default()
        }),
    };
    let requests = remesh_request(header, &points, &facets, &seeds, Vec::new());
    let mut answers = server.client().await.remesh(tokio_stream::iter(requests)).await.unwrap().into_inner();
    let (mut chunks, mut last) = (Vec::new(), None);
    while let Some(answer) = answers.message().await.unwrap() {
        match answer.message.unwrap() {
            remesh_response::Message::Chunk(chunk) => chunks.push(chunk),
            remesh_response::Message::Done(done) => last = Some(done),
            _ => {}
        }
    }
    let report = gather(&chunks, ArrayKind::Report);
    assert!(report.len() > 256 << 10, "{} bytes are no long report", report.len());
    assert!(last.unwrap().report_json.is_empty());
    let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
    assert_eq!(report["iterations"].as_array().unwrap().len(), STEPS as usize);
    assert_eq!(report["result"]["euler"], 2);
    server.stop().await.unwrap();
}
