//! Promise: a client that takes nothing is cut, and what waited for it goes; one that takes a little, steadily, is not.

use std::time::{Duration, Instant};

use crate::raw::{COMPUTE_RVD, Raw};
use crate::server::*;
use server::config::Limits;
use tessera::proto::*;
use transport::ConnectionLimits;

const SECOND: Duration = Duration::from_secs(1);

/// A request whose answer is about a hundred times `points` bytes long.
fn request(points: usize) -> Vec<ComputeRvdRequest> {
    let (vertices, facets) = octahedron();
    rvd_request(&vertices, &facets, &spiral(points), BackendChoice::Parallel, &[RvdOutput::Cells])
}

fn stalling(ms: u64) -> ConnectionLimits {
    ConnectionLimits { stall: Duration::from_millis(ms), ..ConnectionLimits::default() }
}

#[tokio::test(flavor = "multi_thread")]
async fn shut_windows_give_back_their_places_and_their_memory() {
    const STREAMS: usize = 6;
    let (upload, answer) = (1 << 20, 3 << 20);
    // One tenant leaves a place to others.
    let max_streams = STREAMS + 1;
    // And an eighth of the memory.
    let memory_bytes = (upload + answer) * 8 / 7 + 1;
    let limits = Limits { connections: stalling(700), max_streams, memory_bytes, ..Limits::default() };
    let server = Server::start(Setup { limits, ..Setup::default() }).await;
    let mut held = Vec::new();
    // Shut from the start, and shut after some bytes; all on one connection, and each on its own.
    let mut one = Raw::connect(server.address, 0).await;
    for i in 0..STREAMS {
        if i < 3 {
            held.push((None, one.ask(COMPUTE_RVD, &request(4000)).await.unwrap()));
        } else {
            let mut own = Raw::connect(server.address, 10_000 * (i as u32 - 3)).await;
            let body = own.ask(COMPUTE_RVD, &request(4000)).await.unwrap();
            held.push((Some(own), body));
        }
    }
    for (_, body) in &mut held {
        let end = async { while body.data().await.is_some_and(|data| data.is_ok()) {} };
        tokio::time::timeout(60 * SECOND, end).await.expect("is cut");
    }
    // All places are free, and an upload that needs nearly all memory fits.
    let (vertices, facets) = sphere(5);
    let whole = || rvd_request(&vertices, &facets, &spiral(150_000), BackendChoice::Parallel, &[RvdOutput::Centroids]);
    ask_rvd(&mut server.client().await, whole()).await.unwrap();
    let clients: Vec<_> = (0..STREAMS)
        .map(|_| {
            let channel = server.client();
            async { ask_rvd(&mut channel.await, small_rvd(BackendChoice::Parallel)).await }
        })
        .collect();
    for client in clients {
        client.await.unwrap();
    }
    server.stop().await.unwrap();
}

/// Reads without opening the window again; gives the bytes that came, and whether the answer came to its end.
async fn take(body: &mut h2::RecvStream) -> (usize, bool) {
    let mut bytes = 0;
    while let Some(data) = body.data().await {
        match data {
            Ok(data) => bytes += data.len(),
            Err(_) => return (bytes, false),
        }
    }
    (bytes, body.trailers().await.is_ok_and(|trailers| trailers.is_some()))
}

#[tokio::test(flavor = "multi_thread")]
async fn the_end_of_an_answer_that_nobody_takes_goes() {
    let limits = Limits { connections: stalling(500), ..Limits::default() };
    let server = Server::start(Setup { limits, ..Setup::default() }).await;
    let ask = async |window| {
        let mut raw = Raw::connect(server.address, window).await;
        let mut body = raw.ask(COMPUTE_RVD, &small_rvd(BackendChoice::Parallel)).await.unwrap();
        let taken = tokio::time::timeout(20 * SECOND, take(&mut body)).await.expect("nothing waits for ever");
        (taken, raw)
    };
    let ((whole, true), _) = ask(1 << 16).await else { panic!("a window that is wide enough") };
    // The last window leaves some bytes of the last message, which the server has handed on as a whole by then; more than
    // the times in a report can be shorter in another answer.
    for window in [1, whole / 2, whole - 500] {
        let ((taken, ended), _raw) = ask(window as u32).await;
        assert!(taken <= window && !ended, "{taken} of {whole} bytes, window {window}");
    }
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_steady_slow_reader_is_served_to_the_end() {
    const EACH: usize = 4 << 10;
    let pause = Duration::from_millis(100);
    let limits = Limits { connections: stalling(1000), ..Limits::default() };
    let server = Server::start(Setup { limits, ..Setup::default() }).await;
    let mut raw = Raw::connect(server.address, 2 * EACH as u32).await;
    let start = Instant::now();
    let mut body = raw.ask(COMPUTE_RVD, &request(1200)).await.unwrap();
    let (mut bytes, mut unclaimed) = (0, 0);
    while let Some(data) = body.data().await {
        let data = data.expect("is not cut");
        bytes += data.len();
        unclaimed += data.len();
        while unclaimed >= EACH {
            tokio::time::sleep(pause).await;
            body.flow_control().release_capacity(EACH).unwrap();
            unclaimed -= EACH;
        }
        body.flow_control().release_capacity(unclaimed).unwrap();
        unclaimed = 0;
    }
    let trailers = body.trailers().await.unwrap().unwrap();
    assert_eq!(trailers["grpc-status"], "0");
    assert!(bytes > 2 * (64 << 10), "several messages, each longer than the reader takes in the limit: {bytes}");
    assert!(start.elapsed() > 3 * SECOND, "it was a slow reader: {:?}", start.elapsed());
    server.stop().await.unwrap();
}

/// What a client takes, it gives back: the window opens by one frame at a time. Frames that are split at each round end as dust,
/// for which a client may close the connection.
#[tokio::test(flavor = "multi_thread")]
async fn frames_of_a_slow_reader_stay_large() {
    let server = Server::start(Setup::default()).await;
    let mut raw = Raw::connect(server.address, 65_535).await;
    let mut body = raw.ask(COMPUTE_RVD, &request(6_000)).await.unwrap();
    let (mut bytes, mut frames, mut small) = (0, 0, 0);
    while let Some(data) = body.data().await {
        let data = data.unwrap();
        (bytes, frames, small) = (bytes + data.len(), frames + 1, small + usize::from(data.len() < 256));
        // Longer than the server needs to fill the window again.
        tokio::time::sleep(Duration::from_millis(1)).await;
        body.flow_control().release_capacity(data.len()).unwrap();
    }
    // A window has been filled many times.
    assert!(bytes > 10 * 65_535, "{bytes}");
    assert!(small * 20 < frames && bytes / frames > 2_000, "{small} of {frames} frames are small; {bytes} bytes");
    server.stop().await.unwrap();
}
