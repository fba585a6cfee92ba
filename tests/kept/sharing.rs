//! Promise: jobs at work together give the bits that each gives alone; a flood of one tenant does not hold up another; what
//! was cancelled gives back all that it had.

use std::time::{Duration, Instant};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tessera::mesh::shapes::Shape;
use tessera::proto::*;

use super::program::*;

const LIMIT: Duration = Duration::from_secs(300);

#[tokio::test(flavor = "multi_thread")]
async fn together_and_alone_give_the_same_bits() {
    let mut meshes: Vec<Vec<String>> = Vec::new();
    for at_once in ["1", "4"] {
        let folder = tempfile::tempdir().unwrap();
        let program = Program::start(folder.path(), &["--jobs-at-once", at_once]);
        let mut client = program.client().await;
        let digest = client.put_mesh(&Shape::Genus(3).build(4_000)).await;
        let mut ids = Vec::new();
        for i in 0..8 {
            ids.push(client.submit(remesh(&digest, 300 + 50 * i, u64::from(i))).await);
        }
        let mut parts = Vec::new();
        for id in &ids {
            parts.push(part(&client.end(id, LIMIT).await, "mesh"));
        }
        meshes.push(parts);
    }
    assert_eq!(meshes[0], meshes[1]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flood_does_not_hold_up_another_tenant() {
    let folder = tempfile::tempdir().unwrap();
    let program = Program::start(folder.path(), &["--jobs-at-once", "2"]);
    let client = program.client().await;
    let mut flood = client.of("flood");
    let digest = flood.put_mesh(&Shape::Genus(3).build(10_000)).await;
    for i in 0..12 {
        flood.submit(remesh(&digest, 5_000, i)).await;
    }
    let mut other = client.of("other");
    let own = other.put_mesh(&Shape::Genus(3).build(10_000)).await;
    assert_eq!(own, digest, "the same bytes; who does not have them sends them");
    let id = other.submit(remesh(&own, 100, 0)).await;
    assert_eq!(other.end(&id, LIMIT).await.state(), JobState::Succeeded);
    let waiting = flood.all().await.iter().filter(|job| job.state() == JobState::Queued).count();
    assert!(waiting >= 6, "{waiting} of 12 wait when the other's job is done");
    // Priorities go first among those of a tenant.
    let mut urgent = remesh(&digest, 100, 1);
    urgent.priority = Some(5);
    let id = flood.submit(urgent).await;
    flood.end(&id, LIMIT).await;
    let waiting = flood.all().await.iter().filter(|job| job.state() == JobState::Queued).count();
    assert!(waiting >= 2, "{waiting} still wait");
}

/// Cancels so many jobs at random moments; gives how long it took each time until a place was free again.
pub async fn cancels(program: &Program, count: usize) -> Vec<Duration> {
    let mut client = program.client().await;
    let digest = client.put_mesh(&Shape::Genus(3).build(20_000)).await;
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let mut times = Vec::new();
    for i in 0..count {
        // With one at a time, the next begins once this has stopped.
        let id = client.submit(remesh(&digest, 3_000, i as u64)).await;
        let next = client.submit(remesh(&digest, 3_000, i as u64)).await;
        while client.get(&id).await.state() == JobState::Queued {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
        tokio::time::sleep(Duration::from_millis(random.random_range(0..600))).await;
        let begin = Instant::now();
        if client.cancel(&id).await.is_ok() {
            while client.get(&next).await.state() == JobState::Queued {
                tokio::time::sleep(Duration::from_millis(1)).await;
            }
            times.push(begin.elapsed());
        }
        let _ = client.cancel(&next).await;
    }
    times
}

#[cfg(target_os = "linux")]
#[tokio::test(flavor = "multi_thread")]
async fn what_is_cancelled_gives_back_all() {
    let folder = tempfile::tempdir().unwrap();
    let program = Program::start(folder.path(), &["--jobs-at-once", "1"]);
    // What is made once and stays: threads, caches.
    cancels(&program, 3).await;
    tokio::time::sleep(Duration::from_millis(500)).await;
    let (_, descriptors, threads) = program.held();
    cancels(&program, 12).await;
    let start = Instant::now();
    loop {
        let (_, now_descriptors, now_threads) = program.held();
        // The runtime's own threads for files come and go.
        if now_descriptors <= descriptors + 1 && now_threads <= threads + 4 {
            break;
        }
        assert!(
            start.elapsed() < LIMIT / 10,
            "{descriptors} descriptors and {threads} threads before, {now_descriptors} and {now_threads} after"
        );
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    let mut client = program.client().await;
    let digest = client.put_mesh(&Shape::Torus.build(2_000)).await;
    let id = client.submit(remesh(&digest, 100, 0)).await;
    assert_eq!(client.end(&id, LIMIT).await.state(), JobState::Succeeded);
}
