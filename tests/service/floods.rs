//! Promise: a client that floods a connection loses it, and others are served meanwhile. Bytes by hand: no library sends
//! such.

use std::net::SocketAddr;
use std::time::Duration;

use crate::raw::{WATCH, closes, silent};
use crate::server::*;
use server::config::Limits;
use tessera::proto::*;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use transport::ConnectionLimits;

const SECOND: Duration = Duration::from_secs(1);
const PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0";

/// Types of frames.
const DATA: u8 = 0;
const HEADERS: u8 = 1;
const PRIORITY: u8 = 2;
const RST_STREAM: u8 = 3;
const SETTINGS: u8 = 4;
const PING: u8 = 6;
const GOAWAY: u8 = 7;
const WINDOW_UPDATE: u8 = 8;
const CONTINUATION: u8 = 9;
const END_HEADERS: u8 = 4;

fn frame(kind: u8, flags: u8, stream: u32, payload: &[u8]) -> Vec<u8> {
    let length = (payload.len() as u32).to_be_bytes();
    let mut bytes = vec![length[1], length[2], length[3], kind, flags];
    bytes.extend(stream.to_be_bytes());
    bytes.extend(payload);
    bytes
}

/// A header as HPACK has it that is in no table.
fn field(name: &str, value: &str) -> Vec<u8> {
    assert!(name.len() < 127);
    let mut bytes = vec![0, name.len() as u8];
    bytes.extend(name.bytes());
    match value.len() {
        length @ 0..127 => bytes.push(length as u8),
        length => {
            bytes.push(127);
            let mut rest = length - 127;
            while rest >= 128 {
                bytes.push((rest % 128) as u8 | 128);
                rest /= 128;
            }
            bytes.push(rest as u8);
        }
    }
    bytes.extend(value.bytes());
    bytes
}

/// The head of a call to `path`.
fn head(path: &str) -> Vec<u8> {
    // POST and http, from HPACK's table.
    let mut bytes = vec![0x83, 0x86];
    for (name, value) in
        [(":path", path), (":authority", "localhost"), ("content-type", "application/grpc"), ("te", "trailers")]
    {
        bytes.extend(field(name, value));
    }
    bytes
}

/// Sends `part` again and again until the server closes the connection, reading what it says.
async fn flood(address: SocketAddr, limit: Duration, mut part: impl FnMut(u32) -> Vec<u8>) -> bool {
    let mut socket = silent(address, PREFACE).await;
    let end = async {
        let (mut from, mut to) = socket.split();
        let reading = async {
            let mut buffer = vec![0; 1 << 16];
            while from.read(&mut buffer).await.is_ok_and(|n| n > 0) {}
        };
        let writing = async {
            for turn in 0.. {
                if to.write_all(&part(turn)).await.is_err() {
                    return;
                }
            }
        };
        tokio::select! {
            () = reading => {}
            () = writing => {}
        }
    };
    tokio::time::timeout(limit, end).await.is_ok()
}

/// What the server says on a connection until it closes it: types of frames.
async fn said(socket: &mut TcpStream) -> Vec<u8> {
    let mut bytes = Vec::new();
    let _ = tokio::time::timeout(PATIENCE, socket.read_to_end(&mut bytes)).await;
    let (mut kinds, mut rest) = (Vec::new(), &bytes[..]);
    while let Some((head, more)) = rest.split_at_checked(9) {
        let length = u32::from_be_bytes([0, head[0], head[1], head[2]]) as usize;
        kinds.push(head[3]);
        rest = more.get(length..).unwrap_or_default();
    }
    kinds
}

async fn is_served(server: &Server) {
    let mut client = server.client().await;
    let asked = tokio::time::timeout(PATIENCE, ask_rvd(&mut client, small_rvd(BackendChoice::Parallel)));
    asked.await.expect("it is served").unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn streams_that_are_opened_and_reset_close_the_connection() {
    let server = Server::start(Setup::default()).await;
    let block = head(WATCH);
    // Many in one breath, each a call that is taken back at once.
    let resets = |turn: u32| -> Vec<u8> {
        (0..200)
            .flat_map(|i| {
                let stream = 2 * (200 * turn + i) + 1;
                let open = frame(HEADERS, END_HEADERS, stream, &block);
                [open, frame(RST_STREAM, 0, stream, &8u32.to_be_bytes())].concat()
            })
            .collect()
    };
    assert!(flood(server.address, PATIENCE, resets).await, "it is closed");
    is_served(&server).await;
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn streams_beyond_the_limit_are_refused_and_others_go_on() {
    const STREAMS: u32 = 10_000;
    let connections = ConnectionLimits { streams: Some(20), ..ConnectionLimits::default() };
    let server = Server::start(Setup { limits: Limits { connections, ..Limits::default() }, ..Setup::default() }).await;
    let block = head(WATCH);
    let mut socket = silent(server.address, PREFACE).await;
    let all: Vec<u8> = (0..STREAMS).flat_map(|i| frame(HEADERS, END_HEADERS, 2 * i + 1, &block)).collect();
    // The server may close before it has read them all.
    let _ = socket.write_all(&all).await;
    is_served(&server).await;
    let kinds = said(&mut socket).await;
    let refused = kinds.iter().filter(|kind| **kind == RST_STREAM).count();
    assert!(refused > 0 || kinds.contains(&GOAWAY), "{} frames", kinds.len());
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn heads_without_an_end_close_the_connection() {
    let server = Server::start(Setup::default()).await;
    let begin = frame(HEADERS, 0, 1, &head(WATCH));
    let more = frame(CONTINUATION, 0, 1, &field("x-more", &"y".repeat(8000)));
    let endless = |turn: u32| if turn == 0 { begin.clone() } else { more.clone() };
    assert!(flood(server.address, PATIENCE, endless).await, "it is closed");
    // Empty ones cost nothing to send.
    let empty = frame(CONTINUATION, 0, 1, b"").repeat(100);
    let endless = |turn: u32| if turn == 0 { begin.clone() } else { empty.clone() };
    assert!(flood(server.address, PATIENCE, endless).await, "it is closed");
    is_served(&server).await;
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_head_that_is_too_large_is_refused_alone() {
    let connections = ConnectionLimits { header_bytes: 2048, ..ConnectionLimits::default() };
    let server = Server::start(Setup { limits: Limits { connections, ..Limits::default() }, ..Setup::default() }).await;
    let channel = server.channel().await;
    let ask = async |bytes: usize| {
        let mut client = tonic_health::pb::health_client::HealthClient::new(channel.clone());
        let mut request = tonic::Request::new(tonic_health::pb::HealthCheckRequest::default());
        request.metadata_mut().insert("x-large", "y".repeat(bytes).parse().unwrap());
        tokio::time::timeout(PATIENCE, client.check(request)).await.expect("is answered")
    };
    assert!(ask(100).await.is_ok());
    assert!(ask(4000).await.is_err());
    assert!(ask(100).await.is_ok());
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn pings_and_settings_are_no_requests() {
    let connections = ConnectionLimits { first_request: SECOND, ..ConnectionLimits::default() };
    let limits = Limits { connections, ..Limits::default() };
    let server = Server::start(Setup { limits, ..Setup::default() }).await;
    let pings = frame(PING, 0, 0, &[7; 8]).repeat(500);
    let settings = frame(SETTINGS, 0, 0, &[0, 4, 0, 1, 0, 0]).repeat(500);
    let (one, other) = tokio::join!(
        flood(server.address, PATIENCE, |_| pings.clone()),
        flood(server.address, PATIENCE, |_| settings.clone())
    );
    assert!(one && other, "they are closed: {one} {other}");
    // One that reads nothing of the answers.
    let mut deaf = silent(server.address, PREFACE).await;
    for _ in 0..200 {
        if tokio::time::timeout(SECOND / 20, deaf.write_all(&pings)).await.is_err() {
            break;
        }
    }
    assert!(closes(&mut deaf, PATIENCE).await, "it is closed");
    is_served(&server).await;
    server.stop().await.unwrap();
}

/// A stream that is open for long, as one that watches has, is no licence to flood.
#[tokio::test(flavor = "multi_thread")]
async fn frames_that_carry_nothing_are_limited_beside_an_open_stream_too() {
    let server = Server::start(Setup::default()).await;
    let open = [frame(HEADERS, END_HEADERS, 1, &head(WATCH)), frame(DATA, 0, 1, &[0, 0, 0, 0, 0])].concat();
    let floods = [
        ("pings", frame(PING, 0, 0, &[7; 8])),
        ("answers to pings", frame(PING, 1, 0, &[7; 8])),
        ("settings", frame(SETTINGS, 0, 0, &[])),
        ("priorities", frame(PRIORITY, 0, 1, &[0, 0, 0, 3, 9])),
        ("windows", frame(WINDOW_UPDATE, 0, 1, &1u32.to_be_bytes())),
        ("data of no bytes", frame(DATA, 0, 1, &[])),
        ("an unknown type", frame(200, 0, 0, &[1; 30])),
    ];
    for (name, flooding) in &floods {
        let many = flooding.repeat(400);
        let closed = flood(server.address, PATIENCE, |turn| if turn == 0 { open.clone() } else { many.clone() });
        assert!(closed.await, "{name}: it is closed");
    }
    is_served(&server).await;
    server.stop().await.unwrap();
}

/// A client that pings after all it gets, as some do to learn how far away the server is, is none that floods.
#[tokio::test(flavor = "multi_thread")]
async fn pings_of_an_ordinary_client_are_no_flood() {
    let server = Server::start(Setup::default()).await;
    let mut socket = silent(server.address, PREFACE).await;
    let open = [frame(HEADERS, END_HEADERS, 1, &head(WATCH)), frame(DATA, 0, 1, &[0, 0, 0, 0, 0])].concat();
    socket.write_all(&open).await.unwrap();
    for _ in 0..50 {
        socket.write_all(&frame(PING, 0, 0, &[7; 8]).repeat(10)).await.unwrap();
        tokio::time::sleep(SECOND / 50).await;
    }
    assert!(!closes(&mut socket, SECOND / 2).await, "500 pings in a second");
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_connection_begins_with_a_byte() {
    let connections = ConnectionLimits { first_byte: Duration::from_millis(300), ..ConnectionLimits::default() };
    let server = Server::start(Setup { limits: Limits { connections, ..Limits::default() }, ..Setup::default() }).await;
    let (mut mute, mut greets) = (silent(server.address, b"").await, silent(server.address, PREFACE).await);
    assert!(closes(&mut mute, PATIENCE).await);
    assert!(!closes(&mut greets, SECOND / 2).await, "who has sent something has longer");
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn the_longest_message_can_be_chosen() {
    let header = || {
        let (points, facets) = octahedron();
        let mut all = rvd_request(&points, &facets, &spiral(20), BackendChoice::Parallel, &[RvdOutput::Sums]);
        // A chunk for an array that has no such place: what is said of it shows whether it was read at all.
        let far = chunk(ArrayKind::Seeds, 1 << 40, &vec![0; 5 << 20]);
        all[1] = rvd_message(compute_rvd_request::Message::Chunk(far));
        all
    };
    for (mib, code) in [(4, tonic::Code::ResourceExhausted), (8, tonic::Code::InvalidArgument)] {
        let connections = ConnectionLimits { message_bytes: mib << 20, ..ConnectionLimits::default() };
        let limits = Limits { connections, ..Limits::default() };
        let server = Server::start(Setup { limits, ..Setup::default() }).await;
        let refused = ask_rvd(&mut server.client().await, header()).await.unwrap_err();
        assert_eq!(refused.code(), code, "{mib} MiB: {refused}");
        server.stop().await.unwrap();
    }
}
