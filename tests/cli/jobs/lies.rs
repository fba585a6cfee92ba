//! A server that lies is told in one sentence, and leaves no file behind.

use tessera::proto::{Job, JobState};

use super::Stage;
use super::fake::{Fake, ID, Lie, digest, job, result};

fn lying(lie: Lie, before: JobState) -> Stage {
    let bytes = vec![7; (2 << 20) + 5];
    let ended = Job { results: vec![result("mesh", &bytes)], ..job(JobState::Succeeded) };
    let fake = Fake::ending(before, ended);
    fake.keep(&bytes);
    fake.state().lie = lie;
    Stage::new(fake)
}

fn found_out(stage: &Stage, line: &str, words: &str) {
    let (code, said, told) = stage.tell(line);
    assert_eq!(code, Some(69), "{line}: {told}");
    assert!(told.contains("the server's answer is wrong: ") && told.contains(words), "{line}: {words:?}: {told}");
    assert!(told.lines().count() == 1 && said.is_empty(), "{line}: {told}{said}");
    let left: Vec<_> =
        std::fs::read_dir(stage.folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert!(left.iter().all(|name| ["in.off"].contains(&name.to_str().unwrap())), "{line}: {left:?}");
}

#[test]
fn a_download_is_whole_or_not_there() {
    let bytes = vec![7; (2 << 20) + 5];
    for (lie, words) in [
        (Lie::OtherBytes, "the bytes have the digest"),
        (Lie::Damaged, "is damaged"),
        (Lie::Short, "it ended after 2097152 of 2097157 bytes"),
        (Lie::Long, "more were sent"),
        (Lie::Endless, "a piece without bytes"),
    ] {
        let stage = lying(lie, JobState::Succeeded);
        found_out(&stage, &format!("jobs fetch {ID} -o out.ply"), words);
        found_out(&stage, &format!("blobs get {} -o out", digest(&bytes)), words);
    }
}

#[test]
fn an_upload_is_stored_or_not() {
    for (lie, words) in [
        (Lie::Incomplete, "all 36 bytes were sent, but the blob is not complete"),
        (Lie::TooMuchKept, "it has 37 bytes of a blob of 36"),
    ] {
        let stage = lying(lie, JobState::Succeeded);
        found_out(&stage, "blobs put in.off", words);
        found_out(&stage, "jobs submit remesh in.off --points 9", words);
        assert!(stage.fake.state().created.is_empty());
    }
}

#[test]
fn jobs_and_events_are_those_that_were_asked_for() {
    for command in ["get", "wait", "cancel", "fetch -o out.ply"] {
        let line = format!("jobs {command} {ID}");
        found_out(&lying(Lie::OtherJob, JobState::Running), &line, "about another job");
        if command != "cancel" {
            found_out(&lying(Lie::State, JobState::Running), &line, "there is no state 77");
        }
    }
    found_out(&lying(Lie::Events, JobState::Running), &format!("jobs wait {ID}"), "event 1 comes after event 2");
    let line = format!("jobs wait {ID} --retry-s 0.5");
    found_out(&lying(Lie::EndOfEvents, JobState::Running), &line, "events ended before the job did");
    found_out(&lying(Lie::Pages, JobState::Running), "jobs list", "its pages do not end");
}
