//! Promise: a journal that something has damaged is never taken for an empty one; `tessera journal` says what can be read of
//! it, and saves that.

use std::path::Path;
use std::process::{Command, Output};
use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tessera::mesh::shapes::Shape;
use tessera::proto::*;

use super::program::*;

const LIMIT: Duration = Duration::from_secs(120);

fn journal(what: &str, folder: &Path) -> (Output, serde_json::Value) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_tessera"));
    let out = command.args(["journal", what, "--json", "--data-dir"]).arg(folder).output().unwrap();
    let told = serde_json::from_slice(&out.stdout).unwrap_or_default();
    (out, told)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_damaged_journal_is_told_from_an_empty_one_and_mended() {
    const JOBS: usize = 60;
    let kept = tempfile::tempdir().unwrap();
    let mut program = Program::start(kept.path(), &[]);
    let mut client = program.client().await;
    let digest = client.put_mesh(&Shape::Genus(3).build(1_000)).await;
    let mut ids = Vec::new();
    for seed in 0..JOBS {
        ids.push(client.submit(remesh(&digest, 60, seed as u64)).await);
    }
    for id in &ids {
        assert_eq!(client.end(id, LIMIT).await.state(), JobState::Succeeded);
    }
    let (out, _) = journal("check", kept.path());
    assert_eq!(out.status.code(), Some(69), "a server uses it: {out:?}");
    assert_eq!(program.stop(), Some(0));

    let (out, told) = journal("check", kept.path());
    assert!(out.status.success(), "{out:?}");
    assert_eq!((told["jobs"].as_u64(), told["faults"].as_array().unwrap().len()), (Some(JOBS as u64), 0));
    let (out, told) = journal("repair", kept.path());
    assert!(out.status.success() && told["damaged_journal"].is_null(), "what is whole stays: {out:?}");

    let file = kept.path().join("journal.redb");
    let whole = std::fs::read(&file).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(28);
    let mut saved = Vec::new();
    for round in 0..12 {
        let mut bytes = whole.clone();
        match round {
            0 => bytes.truncate(bytes.len() / 2),
            1 => bytes.clear(),
            2 => bytes[..512].fill(0),
            // Some pages of noise, as a disk leaves them that fails.
            _ => {
                for _ in 0..1 + round / 4 {
                    let at = random.random_range(4096..bytes.len() - 4096);
                    random.fill(&mut bytes[at..at + 4096]);
                }
            }
        }
        std::fs::write(&file, &bytes).unwrap();
        let (out, told) = journal("check", kept.path());
        match out.status.code() {
            // The noise may lie where nothing is kept.
            Some(0) => assert_eq!(told["jobs"], JOBS, "round {round}: {told}"),
            Some(65) => {}
            _ => panic!("round {round}: {out:?}"),
        }
        assert_eq!(std::fs::read(&file).unwrap(), bytes, "a look changes nothing");
        let (out, told) = journal("repair", kept.path());
        match out.status.code() {
            Some(0) => {
                let jobs = told["jobs"].as_u64().unwrap() as usize;
                let mut program = Program::start(kept.path(), &[]);
                let mut client = program.client().await;
                let all = client.all().await;
                assert_eq!(all.len(), jobs, "round {round}");
                for job in all {
                    assert_eq!((job.state(), ids.contains(&job.id)), (JobState::Succeeded, true), "{job:?}");
                    client.read(&part(&job, "mesh")).await;
                }
                assert_eq!(program.stop(), Some(0));
                saved.push(jobs);
            }
            Some(65) => saved.push(0),
            _ => panic!("round {round}: {out:?}"),
        }
        for left in std::fs::read_dir(kept.path()).unwrap() {
            let left = left.unwrap();
            if left.file_name().to_string_lossy().starts_with("journal.damaged") {
                assert_eq!(std::fs::read(left.path()).unwrap(), bytes, "the damaged one is kept");
                std::fs::remove_file(left.path()).unwrap();
            }
        }
    }
    println!("jobs saved of {JOBS}: {saved:?}");
    assert!(saved.iter().any(|jobs| *jobs > 0));
}
