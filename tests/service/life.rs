//! Promise: the server lives through full queues, clients that vanish, panics and lost devices; it
//! drains before it ends, and says how it is.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use crate::server::*;
use server::config::Limits;
use server::service::SERVICE_NAME;
use tessera::proto::*;
use tonic::Code;
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;
use tonic_types::StatusExt;
use transport::ConnectionLimits;

const SECOND: Duration = Duration::from_secs(1);

type Answer = Result<Vec<compute_rvd_response::Message>, tonic::Status>;

/// Starts a request on a task of its own.
fn begin(mut client: Client, backend: BackendChoice) -> tokio::task::JoinHandle<Answer> {
    tokio::spawn(async move { ask_rvd(&mut client, small_rvd(backend)).await })
}

#[tokio::test(flavor = "multi_thread")]
async fn a_full_queue_refuses_with_advice_and_empties() {
    let fake = Arc::new(Fake::new(Mood::Busy));
    let server = Server::start(Setup { queue_jobs: 3, ..Setup::fake(&fake) }).await;
    // Memory that other tests of this process hold may have a job refused for a while: it is asked for again.
    let mut busy = begin(server.client().await, BackendChoice::Serial);
    let start = Instant::now();
    while fake.running.load(Ordering::SeqCst) == 0 {
        assert!(start.elapsed() < PATIENCE, "the job runs");
        if busy.is_finished() {
            busy = begin(server.client().await, BackendChoice::Serial);
        }
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    let mut waiting: Vec<tokio::task::JoinHandle<Answer>> = Vec::new();
    while server.engine.load().0 < 2 {
        assert!(start.elapsed() < 2 * PATIENCE, "two wait");
        waiting.retain(|job| !job.is_finished());
        if waiting.len() < 2 {
            waiting.push(begin(server.client().await, BackendChoice::Parallel));
        }
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    let status = ask_rvd(&mut server.client().await, small_rvd(BackendChoice::Parallel)).await.unwrap_err();
    assert_eq!(status.code(), Code::ResourceExhausted);
    assert!(status.get_details_retry_info().unwrap().retry_delay.is_some());
    // The one at work goes; those who wait get their turn.
    busy.abort();
    for job in waiting {
        assert!(!job.await.unwrap().unwrap().is_empty());
    }
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_vanishes_frees_the_worker() {
    let fake = Arc::new(Fake::new(Mood::Busy));
    let server = Server::start(Setup::fake(&fake)).await;
    let job = begin(server.client().await, BackendChoice::Serial);
    until("the job runs", || fake.running.load(Ordering::SeqCst) == 1).await;
    job.abort();
    let took = until("the worker is free", || fake.running.load(Ordering::SeqCst) == 0).await;
    println!("free after {took:?}");
    ask_rvd(&mut server.client().await, small_rvd(BackendChoice::Parallel)).await.unwrap();
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_deadline_stops_the_work() {
    let fake = Arc::new(Fake::new(Mood::Busy));
    let server = Server::start(Setup::fake(&fake)).await;
    let mut request = tonic::Request::new(tokio_stream::iter(small_rvd(BackendChoice::Serial)));
    request.set_timeout(Duration::from_millis(300));
    let mut answers = server.client().await.compute_rvd(request).await.unwrap().into_inner();
    let status = loop {
        match answers.message().await {
            Ok(Some(_)) => {}
            Ok(None) => panic!("ends with an error"),
            Err(status) => break status,
        }
    };
    assert!(matches!(status.code(), Code::DeadlineExceeded | Code::Cancelled), "{status:?}");
    until("the worker is free", || fake.running.load(Ordering::SeqCst) == 0).await;
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn who_left_the_queue_is_skipped() {
    let fake = Arc::new(Fake::new(Mood::Busy));
    let server = Server::start(Setup::fake(&fake)).await;
    let first = begin(server.client().await, BackendChoice::Serial);
    until("the job runs", || fake.running.load(Ordering::SeqCst) == 1).await;
    let second = begin(server.client().await, BackendChoice::Serial);
    until("one waits", || server.engine.load().0 == 1).await;
    second.abort();
    let _ = second.await;
    // The server hears of it while the first is still at work.
    tokio::time::sleep(SECOND).await;
    first.abort();
    until("nothing is left", || server.engine.load() == (0, false)).await;
    assert_eq!(fake.begun.load(Ordering::SeqCst), 1, "the second never began");
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_panic_is_internal_and_the_server_lives_on() {
    let fake = Arc::new(Fake::new(Mood::Panics));
    let server = Server::start(Setup::fake(&fake)).await;
    let mut client = server.client().await;
    for _ in 0..3 {
        let status = ask_rvd(&mut client, small_rvd(BackendChoice::Serial)).await.unwrap_err();
        assert_eq!(status.code(), Code::Internal);
        assert!(!status.message().contains("on purpose"), "insides stay inside");
        ask_rvd(&mut client, small_rvd(BackendChoice::Parallel)).await.unwrap();
    }
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lost_device_is_tried_again_twice() {
    let fake = Arc::new(Fake::new(Mood::Loses(2)));
    let server = Server::start(Setup::fake(&fake)).await;
    ask_rvd(&mut server.client().await, small_rvd(BackendChoice::Serial)).await.unwrap();
    server.stop().await.unwrap();

    let fake = Arc::new(Fake::new(Mood::Loses(usize::MAX)));
    let server = Server::start(Setup::fake(&fake)).await;
    let status = ask_rvd(&mut server.client().await, small_rvd(BackendChoice::Serial)).await.unwrap_err();
    assert_eq!(status.code(), Code::Unavailable);
    assert!(status.get_details_retry_info().is_some());
    assert_eq!(fake.begun.load(Ordering::SeqCst), 3);
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn an_idle_session_blocks_nobody() {
    use cvt_request::Message as Ask;
    // The first server has all the time for the others' questions, the second one loses patience.
    for idle in [10 * PATIENCE, Duration::from_millis(300)] {
        let limits = Limits { max_sessions: 1, session_idle: idle, ..Limits::default() };
        let server = Server::start(Setup { limits, ..Setup::default() }).await;
        let (points, facets) = octahedron();
        let (send, stream) = by_hand();
        let mesh = Some(mesh_header(&points, &facets));
        let header = CvtHeader { mesh, seeds: 9, ..CvtHeader::default() };
        let wrap = |message| CvtRequest { message: Some(message) };
        send.send(wrap(Ask::Header(header))).await.unwrap();
        for chunk in all_chunks(&points, &facets, &spiral(9)) {
            send.send(wrap(Ask::Chunk(chunk))).await.unwrap();
        }
        send.send(wrap(Ask::Start(CvtStart {}))).await.unwrap();
        let mut client = server.client().await;
        let mut session = client.cvt(stream).await.unwrap().into_inner();
        session.message().await.unwrap().unwrap();
        if idle > PATIENCE {
            ask_rvd(&mut server.client().await, small_rvd(BackendChoice::Auto)).await.unwrap();
            let (_send, second) = by_hand::<CvtRequest>();
            let status = client.cvt(second).await.unwrap().into_inner().message().await.unwrap_err();
            assert_eq!(status.code(), Code::ResourceExhausted, "one session at a time here");
        } else {
            let status = session.message().await.unwrap_err();
            assert_eq!(status.code(), Code::DeadlineExceeded, "idle for too long");
        }
        drop((send, session));
        server.stop().await.unwrap();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_does_not_read_is_cut_and_stalls_nobody() {
    let connections = ConnectionLimits { stall: Duration::from_millis(300), ..ConnectionLimits::default() };
    let limits = Limits { connections, ..Limits::default() };
    let server = Server::start(Setup { limits, ..Setup::default() }).await;
    let (points, facets) = sphere(6);
    let request = rvd_request(&points, &facets, &spiral(20_000), BackendChoice::Parallel, &[RvdOutput::Cells]);
    let mut answers = server.client().await.compute_rvd(tokio_stream::iter(request)).await.unwrap().into_inner();
    // Its turn has come. From here on it reads nothing; another client is served meanwhile.
    answers.message().await.unwrap().unwrap();
    tokio::time::timeout(PATIENCE, ask_rvd(&mut server.client().await, small_rvd(BackendChoice::Parallel)))
        .await
        .expect("not stalled")
        .unwrap();
    // Many times as long as a reader may stall, once there is nothing left to compute.
    until("the work has ended", || server.engine.load() == (0, false)).await;
    tokio::time::sleep(3 * SECOND).await;
    let end = loop {
        match answers.message().await {
            Ok(Some(_)) => {}
            Ok(None) => break None,
            Err(status) => break Some(status),
        }
    };
    assert_eq!(end.expect("never ends as if all were well").code(), Code::Cancelled, "the stream is reset");
    server.stop().await.unwrap();
}

async fn health(server: &Server, service: &str) -> ServingStatus {
    let mut client = HealthClient::new(server.channel().await);
    let answer = client.check(HealthCheckRequest { service: service.to_owned() }).await.unwrap();
    answer.into_inner().status()
}

/// A server that is told to stop with a job at work.
async fn draining(grace: Duration) -> (Server, Client, tokio::task::JoinHandle<Answer>, Arc<Fake>) {
    let fake = Arc::new(Fake::new(Mood::Busy));
    let mut server = Server::start(Setup { limits: Limits { grace, ..Limits::default() }, ..Setup::fake(&fake) }).await;
    assert_eq!(health(&server, SERVICE_NAME).await, ServingStatus::Serving);
    assert_eq!(health(&server, "").await, ServingStatus::Serving);
    let client = server.client().await;
    let job = begin(server.client().await, BackendChoice::Serial);
    until("the job runs", || fake.running.load(Ordering::SeqCst) == 1).await;
    server.begin_stop();
    (server, client, job, fake)
}

#[tokio::test(flavor = "multi_thread")]
async fn shutdown_drains_and_says_so() {
    let (server, mut client, job, fake) = draining(10 * PATIENCE).await;
    let start = Instant::now();
    while health(&server, SERVICE_NAME).await != ServingStatus::NotServing {
        assert!(start.elapsed() < PATIENCE, "it says so");
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    // A client that goes on sending may lose the answer to the reset of its stream.
    let head = tokio_stream::iter(small_rvd(BackendChoice::Parallel).into_iter().take(1));
    let refused = match client.compute_rvd(tokio_stream::StreamExt::chain(head, tokio_stream::pending())).await {
        Ok(answers) => answers.into_inner().message().await.map(|_| ()),
        Err(status) => Err(status),
    };
    let status = refused.unwrap_err();
    assert_eq!(status.code(), Code::Unavailable, "{status:?}");
    assert!(status.get_details_retry_info().is_some());
    assert_eq!(fake.running.load(Ordering::SeqCst), 1, "work goes on through the grace period");
    job.abort();
    drop(client);
    // It ends with the last job, long before the grace does.
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_left_after_the_grace_is_cut() {
    let (server, _client, job, fake) = draining(Duration::from_millis(300)).await;
    server.stop().await.unwrap();
    assert_eq!(job.await.unwrap().unwrap_err().code(), Code::Unavailable, "what is left is cut");
    assert_eq!(fake.running.load(Ordering::SeqCst), 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn shutdown_lets_short_work_end() {
    let server = Server::start(Setup::default()).await;
    let (points, facets) = sphere(5);
    let request = rvd_request(&points, &facets, &spiral(5000), BackendChoice::Parallel, &[RvdOutput::Cells]);
    let mut client = server.client().await;
    let mut answers = client.compute_rvd(tokio_stream::iter(request)).await.unwrap().into_inner();
    answers.message().await.unwrap().unwrap();
    let stopping = tokio::spawn(server.stop());
    let mut last = None;
    while let Some(answer) = answers.message().await.unwrap() {
        last = answer.message;
    }
    assert!(matches!(last, Some(compute_rvd_response::Message::Done(_))));
    stopping.await.unwrap().unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn both_reflections_list_the_service() {
    let server = Server::start(Setup::default()).await;
    {
        use tonic_reflection::pb::v1::ServerReflectionRequest;
        use tonic_reflection::pb::v1::server_reflection_client::ServerReflectionClient;
        use tonic_reflection::pb::v1::server_reflection_request::MessageRequest;
        use tonic_reflection::pb::v1::server_reflection_response::MessageResponse;
        let ask = ServerReflectionRequest {
            host: String::new(),
            message_request: Some(MessageRequest::ListServices(String::new())),
        };
        let mut client = ServerReflectionClient::new(server.channel().await);
        let mut answers = client.server_reflection_info(tokio_stream::iter([ask])).await.unwrap().into_inner();
        let answer = answers.message().await.unwrap().unwrap().message_response.unwrap();
        let MessageResponse::ListServicesResponse(list) = answer else { panic!("a list") };
        assert!(list.service.iter().any(|s| s.name == SERVICE_NAME));
    }
    {
        use tonic_reflection::pb::v1alpha::ServerReflectionRequest;
        use tonic_reflection::pb::v1alpha::server_reflection_client::ServerReflectionClient;
        use tonic_reflection::pb::v1alpha::server_reflection_request::MessageRequest;
        use tonic_reflection::pb::v1alpha::server_reflection_response::MessageResponse;
        let ask = ServerReflectionRequest {
            host: String::new(),
            message_request: Some(MessageRequest::FileContainingSymbol(SERVICE_NAME.to_owned())),
        };
        let mut client = ServerReflectionClient::new(server.channel().await);
        let mut answers = client.server_reflection_info(tokio_stream::iter([ask])).await.unwrap().into_inner();
        let answer = answers.message().await.unwrap().unwrap().message_response.unwrap();
        assert!(matches!(answer, MessageResponse::FileDescriptorResponse(_)));
    }
    server.stop().await.unwrap();
}
