//! Promise: a server that works for long does not grow. Jobs of all kinds, cancelled ones, bad ones, streams that are dropped
//! and uploads that are left: what each took comes back.
//!
//! Short here; `TESSERA_SOAK_S=1800` is the length. Figures are printed as JSON. Memory is measured in a rest after each spell of
//! work, when kept jobs have expired and the allocator has given back what is free: beside work it tells what is at work.

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::json;
use tessera::mesh::shapes::Shape;
use tessera::proto::*;
use tonic::Code;

use super::program::*;
use super::raw::{COMPUTE_RVD, Raw};
use super::server::{octahedron, rvd_request, spiral};

const LIMIT: Duration = Duration::from_secs(300);
const CLIENTS: u64 = 6;
const SPELLS: u32 = 12;
/// Of each spell; the rest of it is rest.
const WORK: f64 = 0.65;
/// Threads that compute; each of a pool has a number behind this.
const POOL: &str = "tessera-cpu-";

fn seconds() -> Duration {
    Duration::from_secs_f64(std::env::var("TESSERA_SOAK_S").map_or(4.0, |text| text.parse().unwrap()))
}

/// One thing that a client does; its kind.
async fn act(client: &mut Client, address: SocketAddr, rng: &mut ChaCha8Rng) -> usize {
    let kind = rng.random_range(0..8);
    let facets = 300 + rng.random_range(0..1500);
    let mesh = Shape::Genus(rng.random_range(1..4)).build(facets);
    // Enough for three handles.
    let points = rng.random_range(100..300);
    match kind {
        // A job to its end; its result is read, and it is deleted or left to expire.
        0 | 1 => {
            let digest = client.put_mesh(&mesh).await;
            let id = client.submit(remesh(&digest, points, rng.random())).await;
            let job = client.end(&id, LIMIT).await;
            assert_eq!(job.state(), JobState::Succeeded, "{job:?}");
            client.read(&part(&job, "mesh")).await;
            if kind == 0 {
                let request = client.request(DeleteJobRequest { id });
                client.jobs.delete_job(request).await.unwrap();
            }
        }
        // A diagram.
        2 => {
            let digest = client.put_mesh(&mesh).await;
            let options = DiagramOptions { points: Some(points), ..DiagramOptions::default() };
            let work = Some(job_spec::Work::Rvd(options));
            let id = client.submit(JobSpec { work, ..remesh(&digest, points, 1) }).await;
            assert_eq!(client.end(&id, LIMIT).await.state(), JobState::Succeeded);
        }
        // Cancelled, at any moment.
        3 => {
            let digest = client.put_mesh(&mesh).await;
            let id = client.submit(remesh(&digest, points, rng.random())).await;
            tokio::time::sleep(Duration::from_millis(rng.random_range(0..200))).await;
            // It may have ended before.
            if let Err(late) = client.cancel(&id).await {
                assert_eq!(late.code(), Code::FailedPrecondition, "{late}");
            }
            client.end(&id, LIMIT).await;
        }
        // A mesh that is none, which is seen at once, and one whose facets name vertices that are not there.
        4 => {
            let digest = client.put(format!("ply\n{}", rng.random::<u64>()).as_bytes()).await;
            let refused = client.create(remesh(&digest, points, 0), "").await.unwrap_err();
            assert_eq!(refused.code(), Code::InvalidArgument, "{refused}");
            let file = format!(
                "ply\nformat ascii 1.0\ncomment {}\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n\
                 element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n3 0 1 2\n",
                rng.random::<u64>()
            );
            let digest = client.put(file.as_bytes()).await;
            let id = client.submit(remesh(&digest, points, 0)).await;
            let job = client.end(&id, LIMIT).await;
            assert_eq!(job.failure.unwrap().kind(), JobFailureKind::BadInput);
        }
        // An answer that nobody reads to its end.
        5 => {
            let (vertices, facets) = octahedron();
            let seeds = spiral(rng.random_range(100..3_000));
            let request = rvd_request(&vertices, &facets, &seeds, BackendChoice::Parallel, &[RvdOutput::Cells]);
            let mut raw = Raw::connect(address, 30_000).await;
            let mut body = raw.ask(COMPUTE_RVD, &request).await.unwrap();
            let _ = body.data().await;
        }
        // An upload that is left. It keeps its place for two minutes: fewer of these, so that places are left for the others.
        6 if rng.random_range(0..5) > 0 => {}
        6 => {
            let data = rng.random::<u64>().to_le_bytes().to_vec();
            let digest = format!("{:016x}{:048x}", rng.random::<u64>(), 0);
            let message = WriteRequest {
                digest,
                size_bytes: 1 << 16,
                crc32c: crc32c::crc32c(&data),
                data: data.into(),
                ..WriteRequest::default()
            };
            let _ = client.begin(message).await;
        }
        // A watch that is dropped.
        _ => {
            let digest = client.put_mesh(&mesh).await;
            let id = client.submit(remesh(&digest, points, rng.random())).await;
            let watched = tokio::time::timeout(Duration::from_millis(20), client.watch(&id, 0)).await;
            drop(watched);
            let missing = client.jobs.get_job(client.request(GetJobRequest { id: format!("{id}x") })).await;
            assert_eq!(missing.unwrap_err().code(), Code::InvalidArgument);
            client.end(&id, LIMIT).await;
        }
    }
    kind
}

/// The slope of a line through points, by least squares.
fn slope(points: &[(f64, f64)]) -> f64 {
    let n = points.len().max(1) as f64;
    let (x, y) = points.iter().fold((0.0, 0.0), |(x, y), p| (x + p.0 / n, y + p.1 / n));
    let (above, below) = points.iter().fold((0.0, 0.0), |(a, b), p| (a + (p.0 - x) * (p.1 - y), b + (p.0 - x).powi(2)));
    if below > 0.0 { above / below } else { 0.0 }
}

#[cfg(target_os = "linux")]
#[tokio::test(flavor = "multi_thread")]
async fn what_a_server_took_comes_back() {
    let folder = tempfile::tempdir().unwrap();
    let options = "--admin-listen 127.0.0.1:0 --keep-results 15s --keep-jobs 20s --blobs-mib 64 --upload-idle-s 5";
    let program = Program::start(folder.path(), &options.split(' ').collect::<Vec<_>>());
    let address: SocketAddr = program.address.parse().unwrap();
    let length = seconds();
    // Every kind once, so that what is made at first need is there.
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut client = program.client().await;
    for _ in 0..20 {
        act(&mut client, address, &mut rng).await;
    }
    let (start, threads) = (program.held(), program.threads());
    let others = threads.iter().filter(|name| !name.starts_with(POOL)).count();
    let begin = Instant::now();
    let (mut kinds, mut rests) = ([0; 8], Vec::new());
    for spell in 0..SPELLS {
        let start = Instant::now();
        let clients = (0..CLIENTS).map(|who| {
            let to = program.address.clone();
            tokio::spawn(async move {
                let mut rng = ChaCha8Rng::seed_from_u64(1000 * u64::from(spell) + who);
                let mut client = Client::to(&to).await.of(&format!("client-{who}"));
                let mut kinds = [0u64; 8];
                while start.elapsed() < (length / SPELLS).mul_f64(WORK) {
                    kinds[act(&mut client, address, &mut rng).await] += 1;
                }
                kinds
            })
        });
        for client in clients.collect::<Vec<_>>() {
            for (sum, kind) in kinds.iter_mut().zip(client.await.unwrap()) {
                *sum += kind;
            }
        }
        let end = begin + length / SPELLS * (spell + 1);
        tokio::time::sleep_until(end.into()).await;
        rests.push((begin.elapsed().as_secs_f64() / 3600.0, program.held().0 as f64));
    }
    // Threads that wait for work are given up after 2 s.
    let mut end = program.held();
    for _ in 0..150 {
        tokio::time::sleep(Duration::from_millis(100)).await;
        end = program.held();
        if end.1 <= start.1 && program.threads().iter().filter(|name| !name.starts_with(POOL)).count() <= others {
            break;
        }
    }
    let metrics = program.metrics().await;
    let used = metrics["tessera_memory_bytes{kind=\"used\"}"];
    let planned = metrics["tessera_device_bytes{kind=\"planned\"}"];
    let warm = &rests[rests.len() / 3..];
    println!(
        "{}",
        json!({
            "seconds": length.as_secs_f64(), "acts_by_kind": kinds, "mb_an_hour": slope(warm) / 1e6,
            "bytes_at_rest": rests.iter().map(|p| p.1).collect::<Vec<_>>(),
            "memory_descriptors_threads": [start, end], "used_bytes": used, "planned_bytes": planned,
        })
    );
    assert_eq!((used, planned), (0.0, 0.0));
    assert!(end.1 <= start.1 + 1, "descriptors: {} at first, {} at the end", start.1, end.1);
    // Whoever works makes its own pool at first need, and keeps it.
    let now = program.threads();
    let count = |names: &[&str]| now.iter().filter(|name| names.iter().any(|begin| name.starts_with(begin))).count();
    assert!(now.len() - count(&[POOL]) <= others + 1, "at first {threads:?}, at the end {now:?}");
    assert!(count(&["tessera-cpu-0"]) <= count(&["job-", "short-", "engine"]), "{now:?}");
    assert!(kinds.iter().sum::<u64>() > 0);
}
