//! Promise: who is slow, silent, too long or says nonsense loses its connection or is told, within the limits; it takes nothing
//! from others.

use std::time::{Duration, Instant};

use server::config::Limits;
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
