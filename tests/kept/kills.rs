//! Promise: a job that was acknowledged is done once, with the same bits, however often the process is killed.
//!
//! `TESSERA_KILLS=50` kills so often.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tessera::mesh::shapes::Shape;
use tessera::proto::*;

use super::program::*;

const JOBS: u64 = 12;

/// The jobs of a round: the same in each.
fn specs(digest: &str) -> Vec<JobSpec> {
    (0..JOBS).map(|i| remesh(digest, 100 + 40 * (i as u32 % 5), i)).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn no_acknowledged_job_is_lost_by_kills() {
    let kills: usize = std::env::var("TESSERA_KILLS").map_or(3, |text| text.parse().unwrap());
    let mesh = Shape::Genus(3).build(1_500);
    let mut random = ChaCha8Rng::seed_from_u64(7);

    // Without a kill.
    let calm = tempfile::tempdir().unwrap();
    let program = Program::start(calm.path(), &[]);
    let mut client = program.client().await;
    let digest = client.put_mesh(&mesh).await;
    let mut expected = Vec::new();
    let start = Instant::now();
    for spec in specs(&digest) {
        expected.push(client.submit(spec).await);
    }
    for id in &mut expected {
        *id = part(&client.end(id, Duration::from_secs(300)).await, "mesh");
    }
    let calm_time = start.elapsed();
    drop(program);

    let folder = tempfile::tempdir().unwrap();
    let mut slowest = Duration::ZERO;
    let mut acknowledged: HashMap<String, usize> = HashMap::new();
    let mut program = Program::start(folder.path(), &[]);
    for round in 0..kills {
        let mut client = program.client().await;
        assert_eq!(client.put_mesh(&mesh).await, digest);
        let known = Arc::new(Mutex::new(Vec::new()));
        let submitting = {
            let (known, mut client, specs) = (Arc::clone(&known), client.clone(), specs(&digest));
            tokio::spawn(async move {
                for (i, spec) in specs.into_iter().enumerate() {
                    let Ok(created) = client.create(spec, &format!("{round}/{i}")).await else { return };
                    known.lock().unwrap().push((created.job.unwrap().id, i));
                }
            })
        };
        tokio::time::sleep(calm_time.mul_f64(random.random_range(0.0..0.7))).await;
        program.kill();
        submitting.await.unwrap();
        let begin = Instant::now();
        program = Program::start(folder.path(), &[]);
        let mut client = program.client().await;
        client.all().await;
        slowest = slowest.max(begin.elapsed());
        let known = std::mem::take(&mut *known.lock().unwrap());
        for (id, i) in known {
            let job = client.end(&id, Duration::from_secs(300)).await;
            assert_eq!(job.state(), JobState::Succeeded, "{job:?}");
            assert_eq!(part(&job, "mesh"), expected[i], "job {i} of round {round}");
            assert!(job.attempts <= 2, "{job:?}");
            assert!(acknowledged.insert(id, i).is_none());
        }
        // A call whose answer was lost is repeated, and makes no second job.
        for (i, spec) in specs(&digest).into_iter().enumerate() {
            let created = client.create(spec, &format!("{round}/{i}")).await.unwrap();
            let id = created.job.unwrap().id;
            let job = client.end(&id, Duration::from_secs(300)).await;
            assert_eq!(part(&job, "mesh"), expected[i]);
            acknowledged.insert(id, i);
        }
        let all = client.all().await;
        assert_eq!(all.len(), (round + 1) * JOBS as usize, "each once");
        assert!(all.iter().all(|job| acknowledged.contains_key(&job.id)));
    }
    println!(
        "{}",
        serde_json::json!({ "kills": kills, "jobs": acknowledged.len(), "serving_again_s": slowest.as_secs_f64() })
    );
    let last = acknowledged.keys().next().unwrap().clone();
    let mut client = program.client().await;
    let mesh_of = part(&client.get(&last).await, "mesh");
    client.read(&mesh_of).await;
    assert_eq!(program.stop(), Some(0));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_that_brings_the_process_down_twice_is_not_tried_again() {
    let folder = tempfile::tempdir().unwrap();
    let mut program = Program::start(folder.path(), &["--jobs-at-once", "1"]);
    let mut client = program.client().await;
    let digest = client.put_mesh(&Shape::Genus(3).build(20_000)).await;
    // Long enough to be killed in.
    let id = client.submit(remesh(&digest, 20_000, 0)).await;
    for kill in 1..=2 {
        let started = Instant::now();
        while client.get(&id).await.state() != JobState::Running {
            assert!(started.elapsed() < Duration::from_secs(60));
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        program.kill();
        program = Program::start(folder.path(), &["--jobs-at-once", "1"]);
        client = program.client().await;
        let job = client.get(&id).await;
        assert_eq!(job.crashes, kill);
    }
    let job = client.get(&id).await;
    assert_eq!(
        (job.state(), job.failure.clone().unwrap().kind()),
        (JobState::Failed, JobFailureKind::Crashed),
        "{job:?}"
    );
    // The server is not the worse for it.
    let id = client.submit(remesh(&digest, 200, 0)).await;
    assert_eq!(client.end(&id, Duration::from_secs(120)).await.state(), JobState::Succeeded);
}

#[tokio::test(flavor = "multi_thread")]
async fn of_jobs_that_were_at_work_together_none_fails_before_it_is_tried_alone() {
    let folder = tempfile::tempdir().unwrap();
    let options = &["--jobs-at-once", "2"];
    let mut program = Program::start(folder.path(), options);
    let mut client = program.client().await;
    let digest = client.put_mesh(&Shape::Genus(3).build(20_000)).await;
    let ids = [client.submit(remesh(&digest, 20_000, 0)).await, client.submit(remesh(&digest, 20_001, 0)).await];
    let running = async |client: &mut Client| {
        let mut running = Vec::new();
        for id in &ids {
            if client.get(id).await.state() == JobState::Running {
                running.push(id.clone());
            }
        }
        running
    };
    for _ in 0..2 {
        let started = Instant::now();
        while running(&mut client).await.len() < 2 {
            assert!(started.elapsed() < Duration::from_secs(60), "both run");
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        program.kill();
        program = Program::start(folder.path(), options);
        client = program.client().await;
    }
    // Now one after the other.
    let later = client.submit(remesh(&digest, 200, 0)).await;
    let started = Instant::now();
    let suspect = loop {
        match &running(&mut client).await[..] {
            [] => {}
            [one] => break one.clone(),
            both => panic!("{both:?} are at work together"),
        }
        assert!(started.elapsed() < Duration::from_secs(60));
        tokio::time::sleep(Duration::from_millis(5)).await;
    };
    assert_eq!(client.get(&later).await.state(), JobState::Queued);
    for id in &ids {
        let job = client.get(id).await;
        assert_eq!((job.crashes, job.failure), (2, None));
    }
    program.kill();
    let program = Program::start(folder.path(), options);
    client = program.client().await;
    for id in &ids {
        let is_guilty = *id == suspect;
        assert_eq!(client.get(id).await.state() == JobState::Failed, is_guilty);
        if !is_guilty {
            client.cancel(id).await.unwrap();
        }
    }
    assert_eq!(client.end(&later, Duration::from_secs(120)).await.state(), JobState::Succeeded);
    drop(program);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_orderly_end_puts_jobs_back_without_blame() {
    let folder = tempfile::tempdir().unwrap();
    let mut program = Program::start(folder.path(), &["--grace-s", "0.2", "--jobs-at-once", "1"]);
    let mut client = program.client().await;
    let digest = client.put_mesh(&Shape::Genus(3).build(20_000)).await;
    let long = client.submit(remesh(&digest, 20_000, 0)).await;
    let short = client.submit(remesh(&digest, 200, 0)).await;
    let watched = {
        let (mut client, long) = (client.clone(), long.clone());
        tokio::spawn(async move { client.watch(&long, 0).await })
    };
    while client.get(&long).await.state() != JobState::Running {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    assert_eq!(program.stop(), Some(0));
    assert_eq!(watched.await.unwrap().unwrap_err().code(), tonic::Code::Unavailable, "it can be watched again");
    program = Program::start(folder.path(), &[]);
    client = program.client().await;
    for id in [&short, &long] {
        let job = client.end(id, Duration::from_secs(300)).await;
        assert_eq!((job.state(), job.crashes), (JobState::Succeeded, 0), "{job:?}");
    }
    let other = std::process::Command::new(env!("CARGO_BIN_EXE_tessera"))
        .args(["serve", "--listen", "127.0.0.1:0", "--data-dir"])
        .arg(folder.path())
        .output()
        .unwrap();
    let words = String::from_utf8(other.stderr).unwrap();
    assert_eq!(other.status.code(), Some(69), "{words}");
    assert!(words.contains("in use by another server") && words.contains("--data-dir"), "{words}");
    assert_eq!(program.stop(), Some(0));
}
