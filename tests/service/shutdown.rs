//! Promise: at a shutdown only admitted work uses the grace period. Everything else ends at once, and whoever watches
//! is told.

use std::time::{Duration, Instant};

use crate::raw::{COMPUTE_RVD, Raw, WATCH, framed, silent};
use crate::server::*;
use server::config::Limits;
use server::service::SERVICE_NAME;
use tessera::proto::*;
use tonic::Code;
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;
use tonic_reflection::pb::v1::ServerReflectionRequest;
use tonic_reflection::pb::v1::server_reflection_client::ServerReflectionClient;
use tonic_reflection::pb::v1::server_reflection_request::MessageRequest;

const SECOND: Duration = Duration::from_secs(1);

fn long_grace() -> Setup {
    Setup { limits: Limits { grace: 10 * PATIENCE, ..Limits::default() }, ..Setup::default() }
}

#[tokio::test(flavor = "multi_thread")]
async fn watches_are_told_and_end_at_once() {
    let server = Server::start(long_grace()).await;
    let mut watches = Vec::new();
    for service in ["", SERVICE_NAME] {
        let mut client = HealthClient::new(server.channel().await);
        let request = HealthCheckRequest { service: service.to_owned() };
        let mut watch = client.watch(request).await.unwrap().into_inner();
        assert_eq!(watch.message().await.unwrap().unwrap().status(), ServingStatus::Serving);
        watches.push((client, watch));
    }
    let start = Instant::now();
    let stopping = tokio::spawn(server.stop());
    for (_, watch) in &mut watches {
        assert_eq!(watch.message().await.unwrap().unwrap().status(), ServingStatus::NotServing);
        assert_eq!(watch.message().await.unwrap_err().code(), Code::Unavailable);
    }
    stopping.await.unwrap().unwrap();
    assert!(start.elapsed() < PATIENCE, "took {:?} of a grace of {:?}", start.elapsed(), 10 * PATIENCE);
}

#[tokio::test(flavor = "multi_thread")]
async fn nothing_but_admitted_work_uses_the_grace() {
    let server = Server::start(long_grace()).await;
    // In the middle of a handshake, and before it.
    let _sockets = [silent(server.address, b"").await, silent(server.address, b"PRI * HTTP/2").await];
    // A connection that was used, and one whose client never reads.
    let mut idle = server.client().await;
    ask_rvd(&mut idle, small_rvd(BackendChoice::Parallel)).await.unwrap();
    let mut shut = Raw::connect(server.address, 0).await;
    let _shut_watch = shut.ask(WATCH, &[HealthCheckRequest::default()]).await.unwrap();
    // A reflection stream that goes on.
    let (ask, questions) = by_hand();
    let list = ServerReflectionRequest {
        host: String::new(),
        message_request: Some(MessageRequest::ListServices(String::new())),
    };
    ask.send(list).await.unwrap();
    let mut reflection = ServerReflectionClient::new(server.channel().await);
    let mut listed = reflection.server_reflection_info(questions).await.unwrap().into_inner();
    listed.message().await.unwrap().unwrap();
    // Half an upload, and half a message of one.
    let (send, stream) = by_hand();
    let mut request = small_rvd(BackendChoice::Parallel);
    request.truncate(2);
    let half = framed(&request[0]);
    for message in request {
        send.send(message).await.unwrap();
    }
    let mut upload = server.client().await.compute_rvd(stream).await.unwrap().into_inner();
    let mut broken = Raw::connect(server.address, 1 << 16).await;
    let (_response, mut body) = broken.begin(COMPUTE_RVD).await;
    body.send_data(half.slice(..half.len() / 2), false).unwrap();
    tokio::time::sleep(SECOND / 2).await;

    let start = Instant::now();
    server.stop().await.unwrap();
    assert!(start.elapsed() < PATIENCE, "took {:?} of a grace of {:?}", start.elapsed(), 10 * PATIENCE);
    assert_eq!(upload.message().await.unwrap_err().code(), Code::Unavailable);
    assert_eq!(listed.message().await.unwrap_err().code(), Code::Unavailable);
}

/// A session that waits for a command ends with the server; its seeds are kept as a blob of its tenant.
#[tokio::test(flavor = "multi_thread")]
async fn a_session_ends_with_the_blob_of_its_seeds() {
    use cvt_request::Message as Ask;
    let mut server = Server::start(long_grace()).await;
    let (points, facets) = octahedron();
    let seeds = spiral(9);
    let (send, stream) = by_hand();
    let wrap = |message| CvtRequest { message: Some(message) };
    let header = CvtHeader { mesh: Some(mesh_header(&points, &facets)), seeds: 9, ..CvtHeader::default() };
    send.send(wrap(Ask::Header(header))).await.unwrap();
    for chunk in all_chunks(&points, &facets, &seeds) {
        send.send(wrap(Ask::Chunk(chunk))).await.unwrap();
    }
    send.send(wrap(Ask::Start(CvtStart {}))).await.unwrap();
    let mut session = server.client().await.cvt(stream).await.unwrap().into_inner();
    session.message().await.unwrap().unwrap();
    let blobs = server.idle.blobs.clone();
    server.begin_stop();
    let status = session.message().await.unwrap_err();
    assert_eq!(status.code(), Code::Unavailable);
    let words = status.message().split([' ', ',']);
    let digest: Vec<jobs::blob::Digest> = words.filter_map(|word| word.parse().ok()).collect();
    let bytes: Vec<u8> = seeds.iter().flat_map(|seed| seed.to_array()).flat_map(f64::to_le_bytes).collect();
    assert_eq!(digest, [jobs::blob::Digest::of(&bytes)], "{}", status.message());
    assert!(blobs.stat(digest[0]).await.is_ok());
    drop(send);
    server.ended().await.unwrap();
}
