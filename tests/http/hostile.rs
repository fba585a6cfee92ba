//! Promise: who is slow, silent, too long or says nonsense loses its connection or is told, within the limits; it takes nothing
//! from others.

use std::time::{Duration, Instant};

use serde_json::json;
use server::config::Limits;
use server::keys::{KeyLimits, Role};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use transport::ConnectionLimits;

use super::client::{self, House, get, post};
use super::torus;

/// Short ones.
fn limits() -> Limits {
    let second = Duration::from_secs(1);
    let connections = ConnectionLimits {
        first_byte: second,
        first_request: 2 * second,
        idle: 2 * second,
        stall: second,
        max_connections_per_peer: 64,
        ..ConnectionLimits::default()
    };
    Limits { upload: 4 * second, upload_idle: second, memory_bytes: 8 << 20, connections, ..Limits::default() }
}

/// What comes back until the connection ends, or nothing more for long.
async fn until_closed(stream: &mut TcpStream) -> (String, bool) {
    let mut all = Vec::new();
    let read = tokio::time::timeout(Duration::from_secs(30), stream.read_to_end(&mut all)).await;
    (String::from_utf8_lossy(&all).into_owned(), read.is_ok())
}

/// Sends some bytes and then nothing.
async fn silent_after(house: &House, bytes: &[u8]) -> (String, Duration) {
    let begin = Instant::now();
    let mut stream = TcpStream::connect(house.http).await.unwrap();
    stream.write_all(bytes).await.unwrap();
    let (text, closed) = until_closed(&mut stream).await;
    assert!(closed, "{:?}: still open", String::from_utf8_lossy(&bytes[..bytes.len().min(80)]));
    (text, begin.elapsed())
}

#[tokio::test(flavor = "multi_thread")]
async fn who_falls_silent_is_let_go_of() {
    let house = House::with_limits(limits()).await;
    let head = b"POST /v1/blobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1000\r\n\r\nhalf";
    // Wherever it stops: before the first byte, in the head, in the body, in what HTTP/2 begins with.
    let mut beginnings: Vec<Vec<u8>> = (0..head.len()).step_by(7).map(|length| head[..length].to_vec()).collect();
    beginnings.push(b"PRI * HTTP/2.0\r\n\r\nSM".to_vec());
    beginnings.push(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n".to_vec());
    let ends = beginnings.iter().map(|bytes| silent_after(&house, bytes));
    for (bytes, (text, took)) in beginnings.iter().zip(futures_util::future::join_all(ends).await) {
        assert!(took < Duration::from_secs(15), "{bytes:?}: {took:?}");
        let is_told = bytes.ends_with(b"\r\n\r\nhalf");
        assert!(!is_told || text.contains(" 408 "), "{text}");
    }
    assert_eq!(get(&house, "/v1/jobs", &[]).await.status, 200);
    house.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_body_that_trickles_ends_with_the_time_of_uploads() {
    let house = House::with_limits(limits()).await;
    let mut stream = TcpStream::connect(house.http).await.unwrap();
    stream.write_all(b"POST /v1/blobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100000\r\n\r\n").await.unwrap();
    let begin = Instant::now();
    while begin.elapsed() < Duration::from_secs(20) && stream.write_all(b"x").await.is_ok() {
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
    assert!(begin.elapsed() < Duration::from_secs(12), "{:?}", begin.elapsed());
    house.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn who_reads_nothing_is_let_go_of() {
    let house = House::with_limits(limits()).await;
    let blob = vec![7; 6 << 20];
    let digest = post(&house, "/v1/blobs", &[], &blob).await.json()["digest"].as_str().unwrap().to_owned();
    let mut streams = Vec::new();
    for _ in 0..8 {
        streams.push(client::send(&house, "GET", &format!("/v1/blobs/{digest}"), &[], b"").await);
    }
    tokio::time::sleep(Duration::from_secs(8)).await;
    for stream in &mut streams {
        let mut all = Vec::new();
        // It was cut: not all of it comes.
        let _ = tokio::time::timeout(Duration::from_secs(5), stream.read_to_end(&mut all)).await.expect("it is closed");
        assert!(all.len() < blob.len(), "{}", all.len());
    }
    assert!(get(&house, &format!("/v1/blobs/{digest}"), &[]).await.body == blob);
    house.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn nonsense_is_refused_and_costs_nobody_else() {
    let house = House::with_limits(limits()).await;
    let long = "x".repeat(100_000);
    let many: String = (0..2000).map(|k| format!("h{k}: v\r\n")).collect();
    for (text, wanted) in [
        (format!("GET /v1/jobs HTTP/1.1\r\nHost: localhost\r\nlong: {long}\r\n\r\n"), &["431", "400"][..]),
        (format!("GET /v1/jobs HTTP/1.1\r\nHost: localhost\r\n{many}\r\n"), &["431", "400"]),
        (format!("GET /{long} HTTP/1.1\r\nHost: localhost\r\n\r\n"), &["414", "431", "400"]),
        ("GET /v1/jobs HTTP/9.9\r\n\r\n".to_owned(), &["400", "505"]),
        // A request of HTTP/1.1 names its host, whatever it asks for but a probe of health.
        ("GET /v1/jobs HTTP/1.1\r\nConnection: close\r\n\r\n".to_owned(), &["400"]),
        ("GET /none HTTP/1.1\r\nConnection: close\r\n\r\n".to_owned(), &["400"]),
        ("POST /v1/blobs HTTP/1.1\r\nConnection: close\r\nContent-Length: 2\r\n\r\nhi".to_owned(), &["400"]),
        ("POST /v1/blobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: -1\r\n\r\n".to_owned(), &["400"]),
        (
            "POST /v1/blobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1\r\nContent-Length: 2\r\n\r\n".to_owned(),
            &["400"],
        ),
        ("POST /v1/blobs HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\nzz\r\n".to_owned(), &["400"]),
        ("\0\u{1}\u{2}\u{3}\r\n\r\n".to_owned(), &["400"]),
        // More than the memory that all uploads share.
        (
            format!(
                "POST /v1/remesh?points=9 HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nContent-Length: {}\r\n\r\n{}",
                9 << 20,
                "x".repeat(9 << 20)
            ),
            &["503", "413"],
        ),
    ] {
        let mut stream = TcpStream::connect(house.http).await.unwrap();
        let (mut reading, mut writing) = stream.split();
        let mut all = Vec::new();
        let exchange = async {
            // A server that refuses may not read it all.
            let _ = tokio::join!(writing.write_all(text.as_bytes()), reading.read_to_end(&mut all));
        };
        tokio::time::timeout(Duration::from_secs(20), exchange).await.unwrap_or_else(|_| panic!("{text:.80}: no end"));
        let answer = String::from_utf8_lossy(&all);
        let status = answer.split(' ').nth(1).unwrap_or_default();
        assert!(wanted.contains(&status), "{text:.80}: {answer:.300}");
    }
    let file = torus(20);
    assert_eq!(post(&house, "/v1/remesh?points=100&format=obj", &[], &file).await.status, 200);
    house.stop().await;
}

/// The status of what a stream is answered with, if that comes within a second.
async fn status(stream: &mut TcpStream) -> Option<u16> {
    let mut head = [0; 12];
    tokio::time::timeout(Duration::from_secs(1), stream.read_exact(&mut head)).await.ok()?.ok()?;
    std::str::from_utf8(&head[9..]).ok()?.parse().ok()
}

#[tokio::test(flavor = "multi_thread")]
async fn one_tenant_leaves_places_to_another() {
    let (house, keys) = House::with_keys_and_limits(Limits { max_streams: 12, ..Limits::default() }).await;
    let [greedy, other] = ["greedy", "other"]
        .map(|name| format!("Authorization: Bearer {}", keys.add(name, Role::Submit, KeyLimits::default()).reveal()));
    house.reload().await;
    let file = torus(40);
    let mut jobs = Vec::new();
    for key in [&greedy, &other] {
        let digest = post(&house, "/v1/blobs", &[key], &file).await.json()["digest"].clone();
        let wanted = json!({ "mesh": digest, "format": "obj", "points": 3000, "lloyd": 10_000, "newton": 0 });
        let job =
            post(&house, "/v1/jobs", &[key, "Content-Type: application/json"], wanted.to_string().as_bytes()).await;
        jobs.push(job.json()["id"].as_str().unwrap_or_else(|| panic!("{job:?}")).to_owned());
    }
    // Uploads whose bytes do not come, and watches of a job.
    let upload = async |key: &str| {
        let mut stream = TcpStream::connect(house.http).await.unwrap();
        let head = format!("POST /v1/blobs HTTP/1.1\r\nHost: localhost\r\n{key}\r\nContent-Length: 9\r\n\r\nab");
        stream.write_all(head.as_bytes()).await.unwrap();
        stream
    };
    let watch =
        async |key: &str, job: &str| client::send(&house, "GET", &format!("/v1/jobs/{job}/events"), &[key], b"").await;
    let mut uploads = Vec::new();
    let mut watches = Vec::new();
    for _ in 0..11 {
        uploads.push(upload(&greedy).await);
        watches.push(watch(&greedy, &jobs[0]).await);
    }
    // Connections have no order: any one may be the last.
    let told = futures_util::future::join_all(uploads.iter_mut().map(status)).await;
    assert_eq!(told.iter().filter(|status| **status == Some(503)).count(), 1, "{told:?}");
    let told = futures_util::future::join_all(watches.iter_mut().map(status)).await;
    assert_eq!(told.iter().filter(|status| **status == Some(503)).count(), 1, "{told:?}");
    let begin = Instant::now();
    assert_eq!(post(&house, "/v1/blobs", &[&other], b"mine").await.status, 201);
    assert_eq!(status(&mut watch(&other, &jobs[1]).await).await, Some(200));
    assert!(begin.elapsed() < Duration::from_secs(10), "{:?}", begin.elapsed());
    drop((uploads, watches));
    for (key, job) in [&greedy, &other].into_iter().zip(&jobs) {
        post(&house, &format!("/v1/jobs/{job}/cancel"), &[key], b"").await;
    }
    house.stop().await;
}

/// Sends all of it before it reads a byte, as simple clients do.
async fn answer_after_all(house: &House, head: &str, body: &[u8]) -> String {
    let mut stream = TcpStream::connect(house.http).await.unwrap();
    let head = format!("{head} HTTP/1.1\r\nHost: localhost\r\nContent-Length: {}\r\n", body.len());
    stream.write_all(format!("{head}Connection: close\r\n\r\n").as_bytes()).await.unwrap();
    stream.write_all(body).await.unwrap_or_else(|error| panic!("{head}: {error}"));
    let mut all = String::new();
    stream.read_to_string(&mut all).await.unwrap_or_else(|error| panic!("{head}: {error}"));
    all
}

#[tokio::test(flavor = "multi_thread")]
async fn refused_uploads_hear_why() {
    let body = vec![b'x'; 24 << 20];
    let digest = "0".repeat(64);
    let open = House::with_limits(Limits { memory_bytes: 8 << 20, ..Limits::default() }).await;
    for (head, wanted) in [
        ("POST /v1/remesh?points=0".to_owned(), "400"),
        ("POST /v1/remesh?points=9".to_owned(), "503"),
        ("POST /v1/blobs".to_owned(), "503"),
        (format!("POST /v1/blobs?digest={digest}&what=1"), "400"),
        ("POST /v1/jobs".to_owned(), "4"),
        ("POST /v1/nothing".to_owned(), "404"),
        ("DELETE /v1/jobs".to_owned(), "405"),
    ] {
        let answer = answer_after_all(&open, &head, &body).await;
        assert!(answer.starts_with(&format!("HTTP/1.1 {wanted}")), "{head}: {answer}");
    }
    open.stop().await;
    let (locked, _keys) = House::with_keys().await;
    let answer = answer_after_all(&locked, "POST /v1/blobs", &body).await;
    assert!(answer.starts_with("HTTP/1.1 401"), "{answer}");
    locked.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn lines_end_as_they_should() {
    let house = House::open().await;
    for request in [
        "GET /healthz HTTP/1.1\nHost: localhost\r\nConnection: close\r\n\r\n",
        "GET /healthz HTTP/1.1\r\nHost: localhost\nConnection: close\r\n\r\n",
        "GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\n\n",
    ] {
        let mut stream = TcpStream::connect(house.http).await.unwrap();
        stream.write_all(request.as_bytes()).await.unwrap();
        let (text, closed) = until_closed(&mut stream).await;
        assert!(closed && !text.contains(" 200 "), "{request:?}: {text}");
    }
    // A file with such lines is a body.
    assert_eq!(post(&house, "/v1/remesh?points=60&to=off", &[], &torus(12)).await.status, 200);
    house.stop().await;
}
