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

/// What a server says that does not start.
fn refused(folder: &Path) -> String {
    let mut command = Command::new(env!("CARGO_BIN_EXE_tessera"));
    command.args(["serve", "--listen", "127.0.0.1:0", "--backend", "serial", "--data-dir"]).arg(folder);
    let out = command.env("TESSERA_LOG", "error").output().unwrap();
    let said = String::from_utf8_lossy(&out.stderr).into_owned();
    assert_eq!(out.status.code(), Some(69), "{said}");
    said
}

#[tokio::test(flavor = "multi_thread")]
async fn a_damaged_journal_is_told_from_an_empty_one_and_mended() {
    const JOBS: usize = 60;
    let kept = tempfile::tempdir().unwrap();
    let mut program = Program::start(kept.path(), &[]);
    let mut client = program.client().await;
    let digest = client.put_mesh(&Shape::Genus(3).build(600)).await;
    let mut ids = Vec::new();
    for seed in 0..JOBS {
        ids.push(client.submit(remesh(&digest, 40, seed as u64)).await);
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
    // What lies beside the journal.
    std::fs::write(&file, &whole).unwrap();
    let version = kept.path().join("version");
    for noise in [&b""[..], b"x", b"1 2", b"\xff\xff", b"99999999999"] {
        std::fs::write(&version, noise).unwrap();
        let served = refused(kept.path());
        assert!(served.contains("version") && served.contains("tessera journal repair"), "{served}");
        let (out, told) = journal("check", kept.path());
        assert_eq!((out.status.code(), told["jobs"].as_u64()), (Some(65), Some(JOBS as u64)), "{out:?}");
        let (out, told) = journal("repair", kept.path());
        assert!(out.status.success() && told["damaged_journal"].is_null(), "{out:?}");
        let (out, told) = journal("check", kept.path());
        assert_eq!((out.status.code(), told["faults"].as_array().map(Vec::len)), (Some(0), Some(0)), "{out:?}");
    }
    std::fs::write(&version, "7\n").unwrap();
    for out in [journal("check", kept.path()).0, journal("repair", kept.path()).0] {
        let said = String::from_utf8_lossy(&out.stderr);
        assert!(out.status.code() == Some(65) && said.contains("has version 7"), "{said}");
    }
    std::fs::write(&version, "1\n").unwrap();
    std::fs::remove_file(&file).unwrap();
    let missing = refused(kept.path());
    for what in ["check", "repair"] {
        let said = String::from_utf8_lossy(&journal(what, kept.path()).0.stderr).into_owned();
        assert!(said.contains("move it away") && !said.contains("journal repair"), "{said}");
    }
    assert!(missing.contains("move it away") && !missing.contains("journal repair"), "{missing}");
    // Nobody waits for what is no file.
    for name in ["journal.redb", "version"] {
        let path = kept.path().join(name);
        let _ = std::fs::remove_file(&path);
        assert!(Command::new("mkfifo").arg(&path).status().unwrap().success());
        for what in ["check", "repair"] {
            assert_eq!(journal(what, kept.path()).0.status.code(), Some(74), "{what} {name}");
        }
        assert!(refused(kept.path()).contains("no regular file"));
        std::fs::remove_file(&path).unwrap();
        std::fs::write(&file, &whole).unwrap();
    }
    println!("jobs saved of {JOBS}: {saved:?}");
    assert!(saved.iter().any(|jobs| *jobs > 0));
}
