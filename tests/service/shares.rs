//! Promise: a tenant that takes all places it can get leaves one for another tenant, of each kind.

use std::sync::Arc;
use std::time::Duration;

use jobs::blob::{Digest, put};
use server::config::Limits;
use server::keys::{KeyLimits, Role, Secret};
use server::service::Access;
use tessera::proto::blob_service_client::BlobServiceClient;
use tessera::proto::job_service_client::JobServiceClient;
use tessera::proto::remesh_service_client::RemeshServiceClient;
use tessera::proto::*;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Code, Request, Status};

use crate::jobs::{by, wanted};
use crate::keys::{House, required, with};
use crate::server::*;

const SECOND: Duration = Duration::from_secs(1);

/// Opens calls until one is refused; gives how many there are. They stay open with what `open` returns.
async fn all<T>(mut open: impl AsyncFnMut() -> Result<T, Status>) -> Vec<T> {
    let mut held = Vec::new();
    loop {
        match open().await {
            Ok(one) => held.push(one),
            Err(status) => {
                assert_eq!(status.code(), Code::ResourceExhausted, "{status:?}");
                return held;
            }
        }
        assert!(held.len() < 100, "nothing is refused");
    }
}

fn stream_of<T: Send + 'static>(secret: &Secret, messages: ReceiverStream<T>) -> Request<ReceiverStream<T>> {
    with(secret, messages)
}

#[tokio::test(flavor = "multi_thread")]
async fn one_tenant_leaves_places_of_each_kind() {
    let house = House::new();
    let [greedy, other] = ["greedy", "other"].map(|name| house.add(name, Role::Submit, KeyLimits::default()));
    let limits = Limits { max_streams: 12, max_sessions: 4, ..Limits::default() };
    let access = Access::in_folder(house.folder.path(), required()).unwrap();
    let fake = Arc::new(Fake::new(Mood::Busy));
    let server = Server::start(Setup { limits, access, queue_jobs: 5, ..Setup::fake(&fake) }).await;
    let (channel, beside) = (server.channel().await, server.channel().await);
    let [mut mine, mut theirs] = [channel.clone(), beside.clone()].map(RemeshServiceClient::new);

    // Sessions, by streams of one connection.
    let session = async |client: &mut Client, secret: &Secret| {
        let (send, messages) = by_hand::<CvtRequest>();
        let mut answers = client.cvt(stream_of(secret, messages)).await?.into_inner();
        // One that has a place says nothing.
        match tokio::time::timeout(SECOND / 5, answers.message()).await {
            Ok(refused) => Err(refused.unwrap_err()),
            Err(_) => Ok((send, answers)),
        }
    };
    let held = all(async || session(&mut mine, &greedy).await).await;
    assert_eq!(held.len(), 3);
    let one = tokio::time::timeout(10 * SECOND, session(&mut theirs, &other)).await.unwrap();
    assert!(one.is_ok(), "{one:?}");
    drop((held, one));
    until("sessions are over", || server.engine.load().0 == 0).await;
    tokio::time::sleep(SECOND / 2).await;

    // Streams: uploads that do not begin.
    let mut blobs = BlobServiceClient::new(channel.clone());
    let mut writes = Vec::new();
    let refused = loop {
        let (send, messages) = by_hand::<WriteRequest>();
        let (mut blobs, request) = (blobs.clone(), stream_of(&greedy, messages));
        let mut call = tokio::spawn(async move { blobs.write(request).await });
        match tokio::time::timeout(SECOND / 5, &mut call).await {
            Ok(answer) => break answer.unwrap().unwrap_err(),
            Err(_) => writes.push((send, call)),
        }
    };
    assert_eq!((refused.code(), writes.len()), (Code::ResourceExhausted, 10));
    let begin = std::time::Instant::now();
    let mut other_blobs = BlobServiceClient::new(beside.clone());
    let piece = WriteRequest {
        digest: Digest::of(b"1").to_string(),
        size_bytes: 1,
        data: b"1".to_vec().into(),
        crc32c: crc32c::crc32c(b"1"),
        finish: true,
        ..WriteRequest::default()
    };
    other_blobs.write(with(&other, tokio_stream::iter([piece]))).await.unwrap();
    assert!(begin.elapsed() < 10 * SECOND, "{:?}", begin.elapsed());
    // Short calls have places of their own.
    blobs.find_missing(with(&greedy, FindMissingRequest::default())).await.unwrap();
    drop(writes);
    tokio::time::sleep(SECOND / 2).await;

    // Places in the queue: headers whose meshes do not come.
    let header = async |client: &mut Client, secret: &Secret| {
        let (send, messages) = by_hand::<ComputeRvdRequest>();
        send.send(small_rvd(BackendChoice::Serial).swap_remove(0)).await.unwrap();
        let mut answers = client.compute_rvd(stream_of(secret, messages)).await?.into_inner();
        match tokio::time::timeout(SECOND / 5, answers.message()).await {
            Ok(refused) => Err(refused.unwrap_err()),
            Err(_) => Ok((send, answers)),
        }
    };
    let held = all(async || header(&mut mine, &greedy).await).await;
    assert_eq!(held.len(), 4);
    let one = tokio::time::timeout(10 * SECOND, header(&mut theirs, &other)).await.unwrap();
    assert!(one.is_ok(), "{one:?}");
    drop((held, one));
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn one_tenant_leaves_a_watch() {
    let limits = Limits { max_streams: 12, ..Limits::default() };
    let server = Server::start(Setup { limits, ..Setup::default() }).await;
    let mut client = JobServiceClient::new(server.channel().await);
    put(&*server.idle.blobs, b"a surface".to_vec().into(), None).await.unwrap();
    let mut jobs = Vec::new();
    for tenant in ["greedy", "other"] {
        let ask = CreateJobRequest { spec: Some(wanted(100)), ..CreateJobRequest::default() };
        jobs.push(client.create_job(by(tenant, ask)).await.unwrap().into_inner().job.unwrap());
    }
    let watch = async |tenant: &'static str, job: &Job| {
        let mut client = client.clone();
        client.watch_job(by(tenant, WatchJobRequest { id: job.id.clone(), after: 0 })).await
    };
    let held = all(async || watch("greedy", &jobs[0]).await).await;
    assert_eq!(held.len(), 10);
    let other = tokio::time::timeout(10 * SECOND, watch("other", &jobs[1])).await.unwrap();
    assert!(other.is_ok(), "{other:?}");
    drop((held, other));
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn one_tenant_leaves_memory_for_uploads() {
    let limits = Limits { memory_bytes: 1 << 20, ..Limits::default() };
    let server = Server::start(Setup { limits, queue_jobs: 100, ..Setup::default() }).await;
    let mut client = server.client().await;
    let (points, facets) = sphere(5);
    let mut messages = rvd_request(&points, &facets, &spiral(20), BackendChoice::Serial, &[RvdOutput::Sums]);
    // It does not end.
    messages.pop();
    let held = all(async || {
        let (send, stream) = by_hand();
        for message in messages.clone() {
            send.send(message).await.unwrap();
        }
        let mut answers = client.compute_rvd(by("greedy", stream)).await?.into_inner();
        match tokio::time::timeout(SECOND / 5, answers.message()).await {
            Ok(refused) => Err(refused.unwrap_err()),
            Err(_) => Ok((send, answers)),
        }
    })
    .await;
    let bytes = 24 * points.len() + 12 * facets.len();
    assert_eq!(held.len(), ((1 << 20) - (1 << 17)) / bytes, "an eighth is left");
    let asked = tokio_stream::iter(small_rvd(BackendChoice::Serial));
    let mut answers = client.compute_rvd(by("other", asked)).await.unwrap().into_inner();
    while let Some(answer) = answers.message().await.unwrap() {
        drop(answer);
    }
    drop(held);
    server.stop().await.unwrap();
}
