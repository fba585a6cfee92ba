//! Promise: readers of a few bytes a second cost little memory each, and do not hold up anybody else.
//!
//! Short here; `TESSERA_LOAD_S=60` is the length of each of the eight spells, with and without readers in turns. Figures are
//! printed as JSON.

use std::collections::HashSet;
use std::net::SocketAddr;
use std::time::{Duration, Instant};

use serde_json::json;
use tessera::mesh::shapes::Shape;
use tessera::proto::*;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;

use super::load::{length, quantile};
use super::program::*;
use super::raw::{COMPUTE_RVD, Raw};
use super::server::{octahedron, rvd_request, spiral};

const LIMIT: Duration = Duration::from_secs(300);
const READ: &str = "/tessera.v1.BlobService/Read";
/// Of each reader.
const BYTES_A_SECOND: usize = 10_000;

/// Takes a few bytes of an answer at a time, and says when the first have come.
async fn trickle(address: SocketAddr, digest: Option<String>, who: usize, begun: mpsc::Sender<usize>) {
    let mut client = Raw::connect(address, 65_535).await;
    let mut body = match digest {
        Some(digest) => client.ask(READ, &[ReadRequest { digest, ..ReadRequest::default() }]).await.unwrap(),
        // The cells of a diagram: some megabytes, sent while they are made.
        None => {
            let (vertices, facets) = octahedron();
            let seeds = spiral(20_000);
            let request = rvd_request(&vertices, &facets, &seeds, BackendChoice::Parallel, &[RvdOutput::Cells]);
            client.ask(COMPUTE_RVD, &request).await.unwrap()
        }
    };
    while let Some(data) = body.data().await {
        let data = data.unwrap();
        let _ = begun.try_send(who);
        let _ = body.flow_control().release_capacity(data.len());
        tokio::time::sleep(Duration::from_secs_f64(data.len() as f64 / BYTES_A_SECOND as f64)).await;
    }
}

/// Takes the whole of a diagram, as fast as it comes.
async fn whole(address: SocketAddr) {
    let (vertices, facets) = octahedron();
    let request = rvd_request(&vertices, &facets, &spiral(20_000), BackendChoice::Parallel, &[RvdOutput::Cells]);
    let mut client = Raw::connect(address, 1 << 20).await;
    let mut body = client.ask(COMPUTE_RVD, &request).await.unwrap();
    while let Some(Ok(data)) = body.data().await {
        let _ = body.flow_control().release_capacity(data.len());
    }
}

/// Seconds of each job of some clients but for its first, for so long.
async fn jobs(program: &Program, digest: &str, length: Duration) -> Vec<f64> {
    let begin = Instant::now();
    let tasks = (0..4u64).map(|who| {
        let address = program.address.clone();
        let digest = digest.to_owned();
        async move {
            let mut client = Client::to(&address).await;
            // What has ended while nobody worked begins again with the first.
            let id = client.submit(remesh(&digest, 40, who)).await;
            client.end(&id, LIMIT).await;
            let mut times = Vec::new();
            while begin.elapsed() < length || times.is_empty() {
                let asked = Instant::now();
                let id = client.submit(remesh(&digest, 40, who)).await;
                assert_eq!(client.end(&id, LIMIT).await.state(), JobState::Succeeded);
                times.push(asked.elapsed().as_secs_f64());
            }
            times
        }
    });
    let tasks: Vec<JoinHandle<_>> = tasks.map(tokio::spawn).collect();
    let mut all = Vec::new();
    for task in tasks {
        all.extend(task.await.unwrap());
    }
    all
}

#[cfg(target_os = "linux")]
async fn measure(readers: usize, spells: usize, length: Duration) {
    let folder = tempfile::tempdir().unwrap();
    let program = Program::start(folder.path(), &["--stall-s", "30"]);
    let address: SocketAddr = program.address.parse().unwrap();
    let mut client = program.client().await;
    // More than a reader takes in any spell.
    let large = client.put(&(0..8u32 << 20).flat_map(u32::to_le_bytes).collect::<Vec<u8>>()).await;
    let digest = client.put_mesh(&Shape::Genus(3).build(600)).await;
    jobs(&program, &digest, length.min(Duration::from_secs(10))).await;
    // What the server needs to compute such diagrams at all, it has from here on.
    // Several at once: each that works beside another has a memory of its own.
    let warm: Vec<_> = (0..6).map(|_| tokio::spawn(whole(address))).collect();
    for one in warm {
        one.await.unwrap();
    }
    let (mut alone, mut beside, mut each) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..spells {
        alone.extend(jobs(&program, &digest, length).await);
        let before = program.held().0;
        let (begun, mut told) = mpsc::channel(10_000);
        let reading: Vec<_> = (0..readers)
            .map(|reader| {
                tokio::spawn(trickle(address, (reader % 2 == 0).then(|| large.clone()), reader, begun.clone()))
            })
            .collect();
        // What they ask for is computed first, as far as somebody waits for it; that is work like any other.
        drop(begun);
        let mut who = HashSet::new();
        while who.len() < readers {
            match tokio::time::timeout(LIMIT, told.recv()).await {
                Ok(Some(reader)) => who.insert(reader),
                _ => panic!("{} of {readers} readers begin", who.len()),
            };
            assert!(!reading.iter().any(JoinHandle::is_finished), "the server sends slow readers away");
        }
        // However long that takes beside other tests: what is at work is no reader's.
        for _ in 0..LIMIT.as_secs() {
            let worked = program.worked_s();
            tokio::time::sleep(Duration::from_secs(1)).await;
            if program.worked_s() - worked < 0.1 {
                break;
            }
        }
        each.push(program.held().0.saturating_sub(before) / readers as u64);
        beside.extend(jobs(&program, &digest, length).await);
        for reader in reading {
            reader.abort();
        }
        tokio::time::sleep(Duration::from_secs(1)).await;
    }
    let parts = |times: &mut [f64]| [0.5, 0.9, 0.99, 1.0].map(|part| quantile(times, part));
    let (most, jobs_alone, jobs_beside) = (*each.iter().max().unwrap(), alone.len(), beside.len());
    println!(
        "{}",
        json!({
            "readers": readers, "bytes_each_at_most": most, "jobs_alone": jobs_alone, "jobs_beside": jobs_beside,
            "alone_s_p50_p90_p99_most": parts(&mut alone),
            "beside_s_p50_p90_p99_most": parts(&mut beside),
        })
    );
    assert!(most <= 8 << 20, "{most} bytes for each reader");
}

#[cfg(target_os = "linux")]
#[tokio::test(flavor = "multi_thread")]
async fn slow_readers_hold_little() {
    measure(12, 1, length(1.0)).await;
}

#[cfg(target_os = "linux")]
#[tokio::test(flavor = "multi_thread")]
#[ignore = "a program that prints figures: 50 readers for eight spells of TESSERA_LOAD_S seconds"]
async fn figures_of_slow_readers() {
    measure(50, 4, length(30.0)).await;
}
