//! Promise: a full disk loses no acknowledged job. Jobs wait for room, what is new is refused with a typed error, and once there
//! is room all succeed.
//!
//! `TESSERA_SMALL_DISK` names a folder of a small file system of its own, of 48 MB or so; all of it is filled:
//! `mount -t tmpfs -o size=48m tmpfs FOLDER`.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use serde_json::json;
use tessera::mesh::shapes::Shape;
use tessera::proto::*;

use super::program::*;

const JOBS: u64 = 20;
const LIMIT: Duration = Duration::from_secs(120);
/// What a server says that cannot write its journal any more.
const NOT_WRITTEN: i32 = 74;

/// Fills the disk of a folder until not a byte is left.
fn fill(folder: &Path) -> PathBuf {
    let path = folder.join("ballast");
    let mut file = std::fs::File::create(&path).unwrap();
    for piece in [1 << 20, 1 << 12, 1] {
        while file.write_all(&vec![7; piece]).is_ok() {}
    }
    path
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "fills a disk; TESSERA_SMALL_DISK names it"]
async fn a_full_disk_loses_no_job() {
    let disk = PathBuf::from(std::env::var_os("TESSERA_SMALL_DISK").expect("TESSERA_SMALL_DISK names a small disk"));
    let mesh = Shape::Genus(3).build(3_000);
    let options = ["--disk-reserve-mib", "4", "--jobs-at-once", "2"];

    // With room.
    let calm = tempfile::tempdir().unwrap();
    let program = Program::start(calm.path(), &options);
    let mut client = program.client().await;
    let digest = client.put_mesh(&mesh).await;
    let mut expected = Vec::new();
    for i in 0..JOBS {
        let id = client.submit(remesh(&digest, 100 + 40 * (i as u32 % 5), i)).await;
        expected.push(part(&client.end(&id, LIMIT).await, "mesh"));
    }
    drop(program);

    let folder = tempfile::tempdir_in(&disk).unwrap();
    let mut program = Program::start(folder.path(), &options);
    let mut client = program.client().await;
    assert_eq!(client.put_mesh(&mesh).await, digest);
    let mut ids = Vec::new();
    for i in 0..JOBS {
        ids.push(client.submit(remesh(&digest, 100 + 40 * (i as u32 % 5), i)).await);
    }
    let ballast = fill(&disk);
    let begin = Instant::now();
    let (mut refused, mut restarts) = (Vec::new(), 0);
    while begin.elapsed() < Duration::from_secs(6) {
        let call = pieces(&vec![begin.elapsed().subsec_nanos() as u8; 2 << 20], 1 << 20).remove(0);
        match tokio::time::timeout(Duration::from_secs(3), client.begin(call)).await {
            Ok(Err(status)) => refused.push(status.code()),
            Ok(Ok(_)) => panic!("an upload is taken by a full disk"),
            Err(_) => {}
        }
        if let Some(status) = program.child.try_wait().unwrap() {
            assert_eq!(status.code(), Some(NOT_WRITTEN), "the journal cannot be written");
            restarts += 1;
            break;
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    assert!(
        refused.iter().all(|code| matches!(code, tonic::Code::ResourceExhausted | tonic::Code::Unavailable)),
        "{refused:?}"
    );
    std::fs::remove_file(ballast).unwrap();
    let roomy = Instant::now();
    if restarts > 0 {
        program = Program::start(folder.path(), &options);
        client = program.client().await;
    }
    for (id, mesh) in ids.iter().zip(&expected) {
        let job = client.end(id, LIMIT).await;
        assert_eq!(job.state(), JobState::Succeeded, "{job:?}");
        assert_eq!(part(&job, "mesh"), *mesh);
        client.read(mesh).await;
    }
    println!(
        "{}",
        json!({
            "jobs": JOBS, "refused": refused.len(), "ended_with_74": restarts,
            "all_done_after_room_s": roomy.elapsed().as_secs_f64(),
        })
    );
    assert_eq!(program.stop(), Some(0));
}
