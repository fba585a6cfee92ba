//! Promise: strangers who connect and say nothing keep nobody out, and nothing of theirs stays for ever.

use std::net::SocketAddr;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use crate::process::address_of;
use crate::raw::{self, CHECK, COMPUTE_RVD, Raw, WATCH, closes, framed, silent};
use crate::server::*;
use server::config::Limits;
use tessera::proto::*;
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;
use transport::ConnectionLimits;

const SECOND: Duration = Duration::from_secs(1);
const PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0";

/// Limits on the number of connections, and of those of one peer.
fn limits(max_connections: usize, max_connections_per_peer: usize) -> Limits {
    let connections = ConnectionLimits { max_connections, max_connections_per_peer, ..ConnectionLimits::default() };
    Limits { connections, ..Limits::default() }
}

/// Sockets, and how many of them the server has left open.
async fn open_of(sockets: &mut [tokio::net::TcpStream]) -> usize {
    let mut open = 0;
    for socket in sockets {
        open += usize::from(!closes(socket, Duration::from_millis(20)).await);
    }
    open
}

async fn is_served(address: SocketAddr) -> bool {
    let endpoint = tonic::transport::Endpoint::from_shared(format!("http://{address}")).unwrap();
    let Ok(channel) = endpoint.connect_timeout(PATIENCE).timeout(PATIENCE).connect().await else { return false };
    let answer = HealthClient::new(channel).check(HealthCheckRequest::default()).await;
    answer.is_ok_and(|a| a.into_inner().status() == ServingStatus::Serving)
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_no_grpc_is_refused_in_http_s_words() {
    let server = Server::start(Setup::default()).await;
    let raw = Raw::connect(server.address, 1 << 16).await;
    for (method, kind, status) in [
        ("GET", "", 405),
        ("HEAD", "", 405),
        ("OPTIONS", "application/grpc", 405),
        ("PUT", "application/grpc", 405),
        ("POST", "", 415),
        ("POST", "application/json", 415),
        ("POST", "application/grpc-web", 415),
        ("POST", "application/grpcx", 415),
        ("POST", "application/grpc", 200),
        ("POST", "application/grpc+proto", 200),
        ("POST", "application/grpc; charset=utf-8", 200),
    ] {
        for path in [CHECK, "/", "/nothing/at.All"] {
            let mut request = http::Request::builder().method(method).uri(format!("http://localhost{path}"));
            if !kind.is_empty() {
                request = request.header("content-type", kind);
            }
            let mut send = raw.send.clone().ready().await.unwrap();
            let (answer, mut body) = send.send_request(request.body(()).unwrap(), false).unwrap();
            // Who is refused may have been reset.
            let _ = body.send_data(framed(&HealthCheckRequest::default()), true);
            let head = answer.await.unwrap();
            assert_eq!(head.status().as_u16(), status, "{method} {kind} {path}");
            assert_eq!(head.headers().contains_key("allow"), status == 405);
        }
    }
    assert!(is_served(server.address).await);
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn silent_sockets_keep_nobody_out() {
    let limits = limits(40, 20);
    let server = Server::start(Setup { limits, ..Setup::default() }).await;
    let mut sockets = Vec::new();
    for i in 0..90 {
        sockets.push(silent(server.address, if i % 2 == 0 { b"" } else { PREFACE }).await);
        if i % 30 == 29 {
            ask_rvd(&mut server.client().await, small_rvd(BackendChoice::Parallel)).await.unwrap();
        }
    }
    assert!(is_served(server.address).await);
    let open = open_of(&mut sockets).await;
    assert!(open <= 20, "{open} of them are still open");
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn who_asks_for_something_keeps_its_place_and_the_next_is_refused() {
    let limits = limits(4, 3);
    let server = Server::start(Setup { limits, ..Setup::default() }).await;
    let mut uploads = Vec::new();
    for _ in 0..3 {
        let mut raw = Raw::connect(server.address, 1 << 16).await;
        let (answer, mut body) = raw.begin(COMPUTE_RVD).await;
        let Some(first) = small_rvd(BackendChoice::Parallel).into_iter().next() else { panic!("a header") };
        body.send_data(framed(&first), false).unwrap();
        uploads.push((raw, answer, body));
    }
    // Longer than a connection has to be idle to go.
    tokio::time::sleep(Duration::from_millis(1200)).await;
    let mut fourth = silent(server.address, PREFACE).await;
    assert!(closes(&mut fourth, PATIENCE).await, "one address has three connections here");
    // Another address has its own share.
    let other = raw::from("127.0.0.2:0", server.address).await.unwrap();
    let mut other = Raw::on(other, 1 << 16).await;
    let mut body = other.ask(CHECK, &[HealthCheckRequest::default()]).await.unwrap();
    assert!(body.data().await.unwrap().is_ok());
    for (_raw, answer, _open) in uploads {
        let mut answers = answer.await.unwrap().into_body();
        let more = tokio::time::timeout(Duration::from_millis(50), answers.data()).await;
        assert!(more.is_err(), "an upload that was open goes on");
    }
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn watches_of_health_keep_nobody_out() {
    let limits = limits(4, 3);
    let server = Server::start(Setup { limits, ..Setup::default() }).await;
    let mut watches = Vec::new();
    for _ in 0..3 {
        let mut raw = Raw::connect(server.address, 1 << 16).await;
        let mut body = raw.ask(WATCH, &[HealthCheckRequest::default()]).await.unwrap();
        assert!(body.data().await.unwrap().is_ok());
        watches.push((raw, body));
    }
    tokio::time::sleep(Duration::from_millis(1200)).await;
    ask_rvd(&mut server.client().await, small_rvd(BackendChoice::Parallel)).await.unwrap();
    let (start, mut ended) = (Instant::now(), 0);
    // Once more when one has ended: the others go on.
    while ended == 0 && start.elapsed() < PATIENCE {
        for (_, body) in &mut watches {
            let more = tokio::time::timeout(Duration::from_millis(200), body.data()).await;
            ended += usize::from(more.is_ok());
        }
    }
    assert_eq!(ended, 1, "the oldest of them made room");
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_connection_without_a_request_is_closed() {
    let connections = ConnectionLimits { first_request: Duration::from_millis(300), ..ConnectionLimits::default() };
    let limits = Limits { connections, ..Limits::default() };
    let server = Server::start(Setup { limits, ..Setup::default() }).await;
    let mut watching = Raw::connect(server.address, 1 << 16).await;
    let mut watch = watching.ask(WATCH, &[HealthCheckRequest::default()]).await.unwrap();
    watch.data().await.unwrap().unwrap();
    // The head of a request that never ends: HEADERS without END_HEADERS.
    let endless = [PREFACE, b"\0\0\x01\x01\0\0\0\0\x01\x83"].concat();
    for bytes in [&b""[..], b"PRI * HTTP", PREFACE, &endless] {
        let mut socket = silent(server.address, bytes).await;
        assert!(closes(&mut socket, PATIENCE).await, "after {} bytes", bytes.len());
    }
    // A request whose message never ends is cut too; its connection lives.
    let (_response, mut body) = watching.begin(CHECK).await;
    body.send_data(vec![0, 0, 0].into(), false).unwrap();
    let reset = std::future::poll_fn(|context| body.poll_reset(context));
    tokio::time::timeout(PATIENCE, reset).await.expect("is reset").unwrap();
    assert!(tokio::time::timeout(Duration::from_millis(50), watch.data()).await.is_err(), "the watch goes on");
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn an_idle_connection_is_closed_in_good_form() {
    let connections = ConnectionLimits { idle: Duration::from_millis(600), ..ConnectionLimits::default() };
    let limits = Limits { connections, ..Limits::default() };
    let server = Server::start(Setup { limits, ..Setup::default() }).await;
    let mut raw = Raw::connect(server.address, 1 << 16).await;
    let mut body = raw.ask(CHECK, &[HealthCheckRequest::default()]).await.unwrap();
    body.data().await.unwrap().unwrap();
    body.trailers().await.unwrap();
    drop(body);
    let ended = tokio::time::timeout(PATIENCE, raw.connection).await.expect("is closed").unwrap();
    assert!(ended.is_ok(), "with a goodbye: {ended:?}");
    // A client of the usual kind connects anew without a word.
    let mut client = server.client().await;
    for _ in 0..2 {
        ask_rvd(&mut client, small_rvd(BackendChoice::Parallel)).await.unwrap();
        tokio::time::sleep(2 * SECOND).await;
    }
    server.stop().await.unwrap();
}

/// The program itself, with few descriptors.
#[cfg(target_os = "linux")]
#[tokio::test(flavor = "multi_thread")]
async fn descriptors_are_not_used_up() {
    let program = env!("CARGO_BIN_EXE_tessera");
    let mut child = Command::new("sh")
        .args([
            "-c",
            "ulimit -n 160; exec \"$0\" serve --listen 127.0.0.1:0 --backend serial --first-request-s 60",
            program,
        ])
        .args(Vec::<String>::new())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let address: SocketAddr = address_of(&mut child).parse().unwrap();
    let mut sockets = Vec::new();
    for _ in 0..200 {
        sockets.push(silent(address, b"").await);
    }
    let served = is_served(address).await;
    let open = std::fs::read_dir(format!("/proc/{}/fd", child.id())).map(Iterator::count);
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(served);
    assert!(open.unwrap() <= 160 - 32, "some descriptors are left");
}
