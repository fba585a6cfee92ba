//! A connection that is lost is opened again, and what came stays.

use std::time::{Duration, Instant};

use tessera::proto::{Job, JobState};

use super::Stage;
use super::fake::{Fake, ID, digest, job, result};

/// A server that loses its connections so many times.
fn losing(losses: u32, fake: Fake) -> Stage {
    fake.state().losses = losses;
    Stage::new(fake)
}

#[test]
fn an_upload_goes_on_where_it_was_cut() {
    let stage = losing(2, Fake::default());
    let bytes: Vec<u8> = (0..(7 << 19)).map(|i: u32| (i % 253) as u8).collect();
    std::fs::write(stage.folder.path().join("large"), &bytes).unwrap();
    assert_eq!(stage.ok("blobs put large"), format!("{}\n", digest(&bytes)));
    let state = stage.fake.state();
    assert_eq!(state.writes, [0, 1 << 20, 2 << 20], "each goes on after what was stored");
    assert!(state.blobs[&digest(&bytes)] == bytes);
}

#[test]
fn an_upload_of_another_process_is_gone_on_with() {
    let fake = Fake::default();
    let bytes = vec![9; 3 << 20];
    fake.state().uploads.insert(digest(&bytes), bytes[..1000].to_vec());
    let stage = Stage::new(fake);
    std::fs::write(stage.folder.path().join("large"), &bytes).unwrap();
    stage.ok("blobs put large");
    assert_eq!(stage.fake.state().writes, [1000]);
}

#[test]
fn a_download_goes_on_where_it_was_cut() {
    let bytes: Vec<u8> = (0..(5 << 19)).map(|i: u32| (i % 251) as u8).collect();
    let results = vec![result("mesh", &bytes)];
    let fake = Fake::ending(JobState::Succeeded, Job { results, ..job(JobState::Succeeded) });
    fake.keep(&bytes);
    let stage = losing(2, fake);
    stage.ok(&format!("jobs fetch {ID} -o out.ply"));
    assert!(std::fs::read(stage.folder.path().join("out.ply")).unwrap() == bytes);
    assert_eq!(stage.fake.state().read, [0, 1 << 20, 2 << 20]);
}

#[test]
fn events_go_on_after_the_last_that_came() {
    let stage = losing(3, Fake::ending(JobState::Queued, job(JobState::Succeeded)));
    stage.ok(&format!("jobs wait {ID}"));
    assert_eq!(stage.fake.state().watched, [0, 2, 3, 4]);
    let stage = losing(2, Fake::ending(JobState::Queued, job(JobState::Succeeded)));
    assert_eq!(stage.ok(&format!("jobs watch {ID}")).lines().count(), 5, "each once");
}

#[test]
fn a_job_is_created_once() {
    // Without a number of the caller's nobody knows.
    let stage = losing(1, Fake::default());
    stage.fake.state().losses = 0;
    stage.ok("blobs put in.off");
    stage.fake.state().losses = 1;
    stage.refused("jobs submit remesh in.off --points 9", 69, "whether the job was created is not known");
    stage.fake.state().losses = 1;
    let said = stage.ok("jobs submit remesh in.off --points 9 --request-id r --json");
    assert!(said.contains("\"existed\": true"), "{said}");
    assert_eq!(stage.fake.state().created.len(), 3);
}

#[test]
fn tries_come_to_an_end() {
    let stage = losing(1000, Fake::ending(JobState::Queued, job(JobState::Succeeded)));
    std::fs::write(stage.folder.path().join("large"), vec![1; 1 << 20]).unwrap();
    let start = Instant::now();
    // Its one piece is stored when the connection is lost, and the end brings none.
    stage.ok("blobs put large");
    stage.refused("jobs submit remesh in.off --points 9 --request-id r --retry-s 1", 69, "gave up after");
    stage.refused("jobs submit remesh in.off --points 8 --request-id s --retry-s 0", 69, "was lost: ");
    assert!(start.elapsed() < Duration::from_secs(60));
}

#[cfg(unix)]
#[test]
fn an_interrupt_ends_the_waiting_and_not_the_job() {
    use std::io::Read;
    let fake = Fake::ending(JobState::Queued, job(JobState::Succeeded));
    fake.state().hold = true;
    let stage = Stage::new(fake);
    for command in ["wait", "watch"] {
        let mut command = stage.command(&format!("jobs {command} {ID}"));
        let mut child =
            command.stdout(std::process::Stdio::null()).stderr(std::process::Stdio::piped()).spawn().unwrap();
        let start = Instant::now();
        while stage.fake.state().watched.is_empty() {
            assert!(start.elapsed() < Duration::from_secs(60), "nobody watches");
            std::thread::sleep(Duration::from_millis(20));
        }
        std::process::Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
        let code = child.wait().unwrap().code();
        let mut told = String::new();
        child.stderr.take().unwrap().read_to_string(&mut told).unwrap();
        assert_eq!(code, Some(130), "{told}");
        stage.fake.state().watched.clear();
    }
}
