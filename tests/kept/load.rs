//! Promise: many clients at once are all served, in about the same time; who comes in excess is refused at once and told when to
//! come again, and the server's memory stays where it was.
//!
//! Short here; `TESSERA_LOAD_S=600` is the length of each in seconds. Figures are printed as JSON.

use std::time::{Duration, Instant};

use serde_json::json;
use tessera::mesh::shapes::Shape;
use tessera::proto::*;
use tonic::Code;
use tonic_types::StatusExt;

use super::program::*;

const LIMIT: Duration = Duration::from_secs(300);
/// Connections that the clients share: a client of its own is a tenant, not a socket.
const CONNECTIONS: usize = 16;

pub fn length(usual: f64) -> Duration {
    Duration::from_secs_f64(std::env::var("TESSERA_LOAD_S").map_or(usual, |text| text.parse().unwrap()))
}

pub fn quantile(times: &mut [f64], part: f64) -> f64 {
    times.sort_unstable_by(f64::total_cmp);
    times.get(((times.len().max(1) - 1) as f64 * part).round() as usize).copied().unwrap_or(0.0)
}

/// Seconds of all processors that the process has had.
#[cfg(target_os = "linux")]
fn busy_s(program: &Program) -> f64 {
    let stat = std::fs::read_to_string(format!("/proc/{}/stat", program.child.id())).unwrap();
    let after = stat.rsplit_once(") ").unwrap().1;
    let ticks: u64 = after.split(' ').skip(11).take(2).map(|text| text.parse::<u64>().unwrap()).sum();
    ticks as f64 / 100.0
}

/// Clients that each ask for a job, wait for its end and ask for the next.
#[cfg(target_os = "linux")]
async fn crowd(clients: usize, facets: usize, points: u32, length: Duration) {
    let folder = tempfile::tempdir().unwrap();
    let program = Program::start(folder.path(), &["--max-streams", "1024"]);
    let mesh = Shape::Genus(3).build(facets);
    let mut connections = Vec::new();
    for _ in 0..CONNECTIONS {
        connections.push(program.client().await);
    }
    let bytes = tessera::mesh::io::encode(tessera::mesh::io::Format::Ply, &mesh).unwrap();
    let warm = connections[0].of("warm").put(&bytes).await;
    let id = connections[0].of("warm").submit(remesh(&warm, points, 0)).await;
    assert_eq!(connections[0].of("warm").end(&id, LIMIT).await.state(), JobState::Succeeded);
    let before = program.held();
    let (begin, busy) = (Instant::now(), busy_s(&program));
    let tasks: Vec<_> = (0..clients)
        .map(|who| {
            let (mut client, bytes) = (connections[who % CONNECTIONS].of(&format!("client-{who}")), bytes.clone());
            tokio::spawn(async move {
                let digest = client.put(&bytes).await;
                let mut times = Vec::new();
                for job in 0u64.. {
                    let begun = Instant::now();
                    let id = client.submit(remesh(&digest, points, job)).await;
                    let ended = client.end(&id, LIMIT).await;
                    assert_eq!(ended.state(), JobState::Succeeded, "{ended:?}");
                    times.push(begun.elapsed().as_secs_f64());
                    if begin.elapsed() >= length {
                        break;
                    }
                }
                times
            })
        })
        .collect();
    let mut times = Vec::new();
    for task in tasks {
        times.extend(task.await.unwrap());
    }
    let seconds = begin.elapsed().as_secs_f64();
    let cores = std::thread::available_parallelism().unwrap().get() as f64;
    let share = (busy_s(&program) - busy) / (seconds * cores);
    let jobs = times.len();
    let (median, p99) = (quantile(&mut times, 0.5), quantile(&mut times, 0.99));
    println!(
        "{}",
        json!({
            "clients": clients, "facets": facets, "points": points, "seconds": seconds, "jobs": jobs,
            "jobs_a_second": jobs as f64 / seconds, "processors_busy": share, "median_s": median, "p99_s": p99,
            "p99_over_median": p99 / median, "memory_descriptors_threads": [before, program.held()],
        })
    );
    assert!(jobs >= clients);
}

#[cfg(target_os = "linux")]
#[tokio::test(flavor = "multi_thread")]
async fn many_clients_are_all_served() {
    crowd(24, 600, 40, length(2.0)).await;
}

#[cfg(target_os = "linux")]
#[tokio::test(flavor = "multi_thread")]
#[ignore = "a program that prints figures: 256 clients for TESSERA_LOAD_S seconds"]
async fn figures_of_many_clients() {
    crowd(256, 10_000, 300, length(60.0)).await;
}

#[cfg(target_os = "linux")]
#[tokio::test(flavor = "multi_thread")]
async fn what_is_too_much_is_refused_at_once() {
    let folder = tempfile::tempdir().unwrap();
    // Half of the places are the most that one tenant has.
    let program = Program::start(folder.path(), &["--waiting-jobs", "32", "--jobs-at-once", "1"]);
    let client = program.client().await;
    let digest = client.of("flood").put_mesh(&Shape::Genus(3).build(10_000)).await;
    let alone = {
        let mut client = client.of("flood");
        let begin = Instant::now();
        let id = client.submit(remesh(&digest, 300, 1)).await;
        client.end(&id, LIMIT).await;
        begin.elapsed()
    };
    let (begin, length) = (Instant::now(), length(4.0));
    // Five times what it can do.
    let pause = alone / 5;
    let (mut refused, mut taken, mut memory) = (Vec::new(), Vec::new(), Vec::new());
    let mut flood = client.of("flood");
    for job in 0u64.. {
        // Until it is full: as fast as it goes; then at the rate.
        if !refused.is_empty() {
            tokio::time::sleep(pause.min(Duration::from_millis(20))).await;
        }
        let asked = Instant::now();
        match flood.create(remesh(&digest, 300, job), "").await {
            Ok(created) => taken.push(created.job.unwrap().id),
            Err(status) => {
                refused.push(asked.elapsed().as_secs_f64() * 1e3);
                assert_eq!(status.code(), Code::ResourceExhausted, "{status}");
                assert!(status.get_details_retry_info().is_some_and(|info| info.retry_delay.is_some()), "{status:?}");
                memory.push(program.held().0);
            }
        }
        // However slow this machine is, some are refused.
        let enough = refused.len() > 20 || begin.elapsed() > Duration::from_secs(60);
        if begin.elapsed() >= length && enough {
            break;
        }
    }
    // Another tenant is served meanwhile, and so is this one after.
    let mut other = client.of("other");
    let digest = other.put_mesh(&Shape::Genus(3).build(600)).await;
    let asked = Instant::now();
    let id = other.submit(remesh(&digest, 40, 1)).await;
    assert_eq!(other.end(&id, LIMIT).await.state(), JobState::Succeeded);
    let beside = asked.elapsed();
    for id in &taken {
        let _ = flood.cancel(id).await;
    }
    let asked = Instant::now();
    let small = flood.put_mesh(&Shape::Genus(3).build(600)).await;
    let id = flood.submit(remesh(&small, 40, 1)).await;
    assert_eq!(flood.end(&id, LIMIT).await.state(), JobState::Succeeded);
    let after = asked.elapsed();
    // Once it is as full as it gets.
    let warm = memory.len() / 4;
    let grown = memory.last().unwrap_or(&0).saturating_sub(memory.get(warm).copied().unwrap_or(0));
    println!(
        "{}",
        json!({
            "refused": refused.len(), "taken": taken.len(), "refusal_ms_p50": quantile(&mut refused, 0.5),
            "refusal_ms_p99": quantile(&mut refused, 0.99), "memory_grew_bytes": grown,
            "another_tenant_s": beside.as_secs_f64(), "normal_after_s": after.as_secs_f64(),
        })
    );
    assert!(refused.len() > 20, "{}", refused.len());
}
