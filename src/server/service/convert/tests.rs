//! Times come back, an end has its reason, a page is no longer than a message, formats have one number.

use proptest::prelude::*;
use prost::Message as _;

use super::*;
use geometry::mesh::io::Format;
use jobs::record::{Cause, Failure, Job, Outcome, ResultSet, Spec, Status};
use jobs::store::Page;
use proto::{CvtEdit, CvtJob, CvtJobCommand, CvtOptions, JobSpec, MeshFile, Point, RemeshOptions, SeedEdit};
use proto::{cvt_job_command, job_mesh, job_spec, seed_edit};

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_wrong_message_is_refused_and_nothing_panics(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        if let Ok(message) = JobSpec::decode(&bytes[..]) {
            let _ = Spec::new(message, String::new(), String::new());
        }
        if let Ok(message) = proto::ListJobsRequest::decode(&bytes[..]) {
            let _ = query(message, String::new());
        }
    }

    #[test]
    fn times_come_back(ms in any::<u64>()) {
        prop_assert_eq!(time("at", timestamp(Time(ms))).unwrap(), Time(ms));
    }
}

#[test]
fn parts_of_a_millisecond_count_as_a_whole_one() {
    let of = |seconds, nanos| wire::codec::duration_ms(prost_types::Duration { seconds, nanos });
    assert_eq!(of(1, 1).unwrap(), 1001);
    assert_eq!(of(0, 999_999_999).unwrap(), 1000);
    assert_eq!(of(i64::MAX, 0).unwrap(), u64::MAX, "what is refused later, and by its range");
    for (seconds, nanos) in [(-1, 0), (0, -1), (0, 1_000_000_000)] {
        assert!(of(seconds, nanos).is_err());
    }
    let of = |seconds, nanos| time("at", prost_types::Timestamp { seconds, nanos });
    assert_eq!(of(-5, 0).unwrap(), Time(0));
    assert_eq!(of(5, 1).unwrap(), Time(5001));
    assert!(of(0, -1).is_err());
}

fn small() -> JobSpec {
    let file = MeshFile { digest: "07".repeat(32), format: Format::Stl.number(), attributes: None };
    JobSpec {
        mesh: Some(proto::JobMesh { source: Some(job_mesh::Source::File(file)) }),
        work: Some(job_spec::Work::Remesh(RemeshOptions { points: Some(5), ..RemeshOptions::default() })),
        ..JobSpec::default()
    }
}

fn spec(message: JobSpec) -> Spec {
    Spec::new(message, "t".to_owned(), "r".to_owned()).unwrap()
}

#[test]
fn an_end_is_told_with_its_reason() {
    let valid = spec(small());
    let status = |outcome| Status { outcome, ..Status::new(valid.task().deadlines, Time(1500)) };
    let told = |outcome| message(&Job { id: JobId::new(Time(1), 1), spec: valid.clone(), status: status(outcome) });
    let open = told(None);
    assert_eq!((open.created.unwrap().nanos, open.started, &open.request_id[..]), (500_000_000, None, "r"));
    for (cause, name) in
        [(Cause::QueueDeadline, "queue_deadline"), (Cause::RunDeadline, "run_deadline"), (Cause::Kept, "kept")]
    {
        assert_eq!(told(Some(Outcome::Expired(cause))).expired_by, name);
    }
    let failure = Failure { kind: FailureKind::Crashed, message: "m".to_owned() };
    let failure = told(Some(Outcome::Failed(failure))).failure.unwrap();
    assert_eq!((failure.kind(), &failure.message[..]), (proto::JobFailureKind::Crashed, "m"));
    let blobs = [("mesh".to_owned(), Digest::from([1; 32]))].into();
    let results = told(Some(Outcome::Succeeded(ResultSet { blobs, ..ResultSet::default() }))).results;
    assert_eq!((&results[0].name[..], &results[0].digest), ("mesh", &"01".repeat(32)));
}

#[test]
fn a_page_is_no_longer_than_a_message() {
    let add = seed_edit::Edit::Add(Point { x: 0.5, y: 0.5, z: 0.5 });
    let edit = CvtEdit { edits: vec![SeedEdit { edit: Some(add) }; 2000], seeds: 0 };
    let options = CvtOptions { points: Some(5), ..CvtOptions::default() };
    let commands = vec![CvtJobCommand { command: Some(cvt_job_command::Command::Edit(edit)) }];
    let work = Some(job_spec::Work::Cvt(CvtJob { options: Some(options), commands }));
    let valid = spec(JobSpec { work, ..small() });
    let status = Status::new(valid.task().deadlines, Time(1));
    let job = |k| Job { id: JobId::new(Time(1), k), spec: valid.clone(), status: status.clone() };
    let page = Page { jobs: (0..100).rev().map(job).collect(), next: None };
    let message = super::page(&page);
    assert!(message.encoded_len() < 4 << 20 && message.jobs.len() > 10 && message.jobs.len() < 100);
    assert_eq!(message.next_page_token, message.jobs.last().unwrap().id);
}

/// The schema names the same formats by the same numbers.
#[test]
fn messages_number_formats_as_the_table_does() {
    let all = (1..100).filter_map(|number| proto::MeshFormat::try_from(number).ok());
    assert_eq!(all.count(), Format::ALL.len());
    for format in Format::ALL {
        let message = proto::MeshFormat::try_from(format.number()).unwrap();
        let name = format!("MESH_FORMAT_{}", format.extension().to_ascii_uppercase());
        assert_eq!((message.as_str_name(), Format::of_number(format.number())), (&*name, Some(format)));
    }
    assert_eq!((Format::of_number(0), Format::of_number(99)), (None, None));
}
