//! Promise: a job is created once per request, told as it was given, and hidden from other tenants; a watch tells every
//! event after a number and ends with the job; who does not read holds up nobody but himself.

use std::time::Duration;

use jobs::blob::{Digest, put};
use jobs::record::event::Progress;
use jobs::record::{self, Change, Failure, FailureKind, JobId, ResultSet};
use jobs::store::{JobStore, Offer};
use server::service::{BLOB_SERVICE_NAME, JOB_SERVICE_NAME};
use tessera::proto::job_event::What;
use tessera::proto::job_service_client::JobServiceClient;
use tessera::proto::*;
use tonic::transport::Channel;
use tonic::{Code, Request, Status, Streaming};
use tonic_types::StatusExt;

use crate::server::*;

const SECOND: Duration = Duration::from_secs(1);

type Jobs = JobServiceClient<Channel>;

async fn start() -> (Server, Jobs) {
    // No test may wait for the grace to end.
    let limits = server::config::Limits { grace: 10 * PATIENCE, ..Default::default() };
    let server = Server::start(Setup { limits, ..Setup::default() }).await;
    let client = JobServiceClient::new(server.channel().await);
    put(&*server.idle.blobs, b"a surface".to_vec().into(), None).await.unwrap();
    (server, client)
}

/// A remesh of the blob that is there.
pub fn wanted(points: u32) -> JobSpec {
    let file =
        MeshFile { digest: Digest::of(b"a surface").to_string(), format: MeshFormat::Ply.into(), attributes: None };
    let work =
        RemeshOptions { points: Some(points), lloyd: Some(0), crease_angle: Some(12.5), ..RemeshOptions::default() };
    JobSpec {
        mesh: Some(JobMesh { source: Some(job_mesh::Source::File(file)) }),
        work: Some(job_spec::Work::Remesh(work)),
        queue_deadline: Some(prost_types::Duration { seconds: 3600, nanos: 500_000_000 }),
        labels: [("part".to_owned(), points.to_string())].into(),
        ..JobSpec::default()
    }
}

pub fn by<T>(tenant: &str, message: T) -> Request<T> {
    let mut request = Request::new(message);
    request.metadata_mut().insert("tessera-tenant", tenant.parse().unwrap());
    request
}

fn asked(points: u32, request_id: &str) -> CreateJobRequest {
    CreateJobRequest { spec: Some(wanted(points)), request_id: request_id.to_owned(), ..CreateJobRequest::default() }
}

async fn create(client: &mut Jobs, points: u32) -> Job {
    client.create_job(by("t", asked(points, ""))).await.unwrap().into_inner().job.unwrap()
}

fn id(job: &Job) -> JobId {
    job.id.parse().unwrap()
}

fn field(status: &Status) -> String {
    status.get_details_bad_request().expect("a field").field_violations[0].field.clone()
}

/// Somebody takes the job; gives the version of the claim.
async fn claim(server: &Server, job: &Job) -> u64 {
    let offer = Offer::of("test", Duration::from_secs(3600), id(job));
    server.idle.store.claim_next(offer).await.unwrap().unwrap().status.version
}

async fn change(server: &Server, job: &Job, at: u64, change: Change) {
    server.idle.store.change(id(job), at, change).await.unwrap();
}

async fn step(server: &Server, job: &Job, at: u64, index: u64) {
    let kind = "lloyd".to_owned();
    let step =
        Progress::Iteration { index, total: 9, kind, energy: 0.5, energy_ratio: 1.25, gradient_norm: 0.25, ms: 1.5 };
    server.idle.store.progress(id(job), at, step).await.unwrap();
}

async fn watch(client: &mut Jobs, job: &Job, after: u64) -> Streaming<WatchJobResponse> {
    client.watch_job(by("t", WatchJobRequest { id: job.id.clone(), after })).await.unwrap().into_inner()
}

async fn next(events: &mut Streaming<WatchJobResponse>) -> Result<Option<JobEvent>, Status> {
    let event = tokio::time::timeout(PATIENCE, events.message()).await.expect("an event comes")?;
    Ok(event.map(|event| event.event.unwrap()))
}

async fn all(events: &mut Streaming<WatchJobResponse>) -> Vec<JobEvent> {
    let mut all = Vec::new();
    while let Some(event) = next(events).await.unwrap() {
        all.push(event);
    }
    all
}

fn state_of(event: &JobEvent) -> Option<JobState> {
    match event.what.as_ref().unwrap() {
        What::State(change) => Some(change.state()),
        _ => None,
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_is_told_as_it_was_given_and_made_once() {
    let (server, mut client) = start().await;
    let made = client.create_job(by("t", asked(100, "r1"))).await.unwrap().into_inner();
    assert!(!made.existed);
    let job = made.job.unwrap();
    assert_eq!(
        (job.spec.clone().unwrap(), job.state(), job.request_id.as_str()),
        (wanted(100), JobState::Queued, "r1")
    );
    assert!(job.created.is_some() && job.started.is_none() && job.attempts == 0);
    let again = client.create_job(by("t", asked(100, "r1"))).await.unwrap().into_inner();
    assert!(again.existed && again.job.unwrap() == job);
    let status = client.create_job(by("t", asked(101, "r1"))).await.unwrap_err();
    assert_eq!((status.code(), field(&status)), (Code::AlreadyExists, "request_id".to_owned()));
    let other = client.create_job(by("other", asked(101, "r1"))).await.unwrap().into_inner();
    assert!(!other.existed, "numbers of requests are a tenant's own");
    let told = client.get_job(by("t", GetJobRequest { id: job.id.clone() })).await.unwrap().into_inner();
    assert_eq!(told.job.unwrap(), job);
    let at = claim(&server, &job).await;
    let digest = Digest::of(b"result");
    let blobs = [("mesh".to_owned(), digest)].into();
    change(&server, &job, at, Change::Succeed(ResultSet { blobs, ..ResultSet::default() })).await;
    let told = client.get_job(by("t", GetJobRequest { id: job.id.clone() })).await.unwrap().into_inner().job.unwrap();
    assert_eq!((told.state(), told.attempts), (JobState::Succeeded, 1));
    assert_eq!(told.results, [ResultBlob { name: "mesh".to_owned(), digest: digest.to_string() }]);
    let failed = create(&mut client, 7).await;
    let at = claim(&server, &failed).await;
    let failure = Failure { kind: FailureKind::TooLarge, message: "too much".to_owned() };
    change(&server, &failed, at, Change::Fail(failure)).await;
    let told = client.get_job(by("t", GetJobRequest { id: failed.id })).await.unwrap().into_inner().job.unwrap();
    let failure = told.failure.clone().unwrap();
    assert_eq!(
        (told.state(), failure.kind(), &failure.message[..]),
        (JobState::Failed, JobFailureKind::TooLarge, "too much")
    );
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_wrong_with_a_job_is_named_as_messages_call_it() {
    let (server, mut client) = start().await;
    type Break = fn(&mut CreateJobRequest);
    fn spec(request: &mut CreateJobRequest) -> &mut JobSpec {
        request.spec.as_mut().unwrap()
    }
    fn remesh(request: &mut CreateJobRequest) -> &mut RemeshOptions {
        match spec(request).work.as_mut().unwrap() {
            job_spec::Work::Remesh(work) => work,
            other => panic!("{other:?}"),
        }
    }
    fn given(form: i32, count: u64) -> Option<JobArrays> {
        let seeds = ArrayRef { digest: Digest::of(b"s").to_string(), form, count };
        Some(JobArrays { seeds: Some(seeds), ..JobArrays::default() })
    }
    let cases: [(Break, &str); 14] = [
        (|r| r.spec = None, "spec"),
        (|r| spec(r).mesh = None, "spec.mesh.source"),
        (|r| spec(r).work = None, "spec.work"),
        (|r| spec(r).backend = 99, "spec.backend"),
        (|r| spec(r).priority = Some(101), "spec.priority"),
        (|r| spec(r).run_deadline = Some(prost_types::Duration { seconds: -1, nanos: 0 }), "spec.run_deadline"),
        (|r| spec(r).run_deadline = Some(prost_types::Duration::default()), "spec.run_deadline"),
        (|r| spec(r).arrays = given(0, 5), "spec.arrays.seeds.form"),
        (|r| spec(r).arrays = given(ArrayForm::U8.into(), 5), "spec.arrays.seeds.form"),
        (|r| spec(r).arrays = given(ArrayForm::F32.into(), 0), "spec.arrays.seeds.count"),
        (|r| remesh(r).crease_angle = Some(f64::NAN), "spec.remesh.crease_angle"),
        (|r| remesh(r).points = None, "spec.remesh.points"),
        (|r| remesh(r).max_deviation = Some(0.0), "spec.remesh.max_deviation"),
        (|r| r.request_id = "a b".to_owned(), "request_id"),
    ];
    for (spoil, path) in cases {
        let mut request = asked(100, "");
        spoil(&mut request);
        let status = client.create_job(by("t", request.clone())).await.expect_err(path);
        assert_eq!((status.code(), field(&status)), (Code::InvalidArgument, path.to_owned()), "{status:?}");
        assert!(status.message().starts_with(path), "{status:?}");
        if path != "request_id" {
            let question = EstimateJobRequest { spec: request.spec, vertices: Some(4), facets: Some(4) };
            let status = client.estimate_job(by("t", question)).await.expect_err(path);
            assert_eq!((status.code(), field(&status)), (Code::InvalidArgument, path.to_owned()));
        }
    }
    let mut missing = asked(100, "");
    let file = MeshFile { digest: Digest::of(b"none").to_string(), format: MeshFormat::Ply.into(), attributes: None };
    missing.spec.as_mut().unwrap().mesh = Some(JobMesh { source: Some(job_mesh::Source::File(file)) });
    let status = client.create_job(by("t", missing)).await.unwrap_err();
    assert_eq!(status.code(), Code::NotFound);
    assert_eq!(status.get_details_resource_info().unwrap().resource_type, "blob");
    let question = EstimateJobRequest { spec: Some(wanted(9)), vertices: Some(3), facets: Some(1) };
    let estimate = client.estimate_job(by("t", question)).await.unwrap().into_inner();
    assert_eq!((estimate.host_bytes, estimate.fits), (300, true));
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn jobs_of_other_tenants_are_not_there() {
    let (server, mut client) = start().await;
    let job = create(&mut client, 100).await;
    let id = || job.id.clone();
    for tenant in ["other", "T"] {
        let watch = client.watch_job(by(tenant, WatchJobRequest { id: id(), after: 0 })).await;
        let answers = [
            client.get_job(by(tenant, GetJobRequest { id: id() })).await.map(drop),
            client.cancel_job(by(tenant, CancelJobRequest { id: id() })).await.map(drop),
            client.delete_job(by(tenant, DeleteJobRequest { id: id() })).await.map(drop),
            watch.unwrap().into_inner().message().await.map(drop),
        ];
        for answer in answers {
            assert_eq!(answer.unwrap_err().code(), Code::NotFound);
        }
        assert!(client.list_jobs(by(tenant, ListJobsRequest::default())).await.unwrap().into_inner().jobs.is_empty());
    }
    assert_eq!(client.get_job(GetJobRequest { id: id() }).await.unwrap_err().code(), Code::NotFound, "nor to nobody");
    for wrong in ["", "x", &job.id[1..], &job.id.to_uppercase().replace('0', "A")] {
        let status = client.get_job(by("t", GetJobRequest { id: wrong.to_owned() })).await.unwrap_err();
        assert_eq!((status.code(), field(&status)), (Code::InvalidArgument, "id".to_owned()));
    }
    let status = client.get_job(by("a b", GetJobRequest { id: id() })).await.unwrap_err();
    assert_eq!((status.code(), field(&status)), (Code::InvalidArgument, "tessera-tenant".to_owned()));
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn jobs_are_cancelled_and_forgotten() {
    let (server, mut client) = start().await;
    let job = create(&mut client, 100).await;
    let delete = || by("t", DeleteJobRequest { id: job.id.clone() });
    let status = client.delete_job(delete()).await.unwrap_err();
    assert_eq!(status.code(), Code::FailedPrecondition);
    assert_eq!(status.get_details_precondition_failure().unwrap().violations[0].subject, job.id);
    for _ in 0..2 {
        let cancelled = client.cancel_job(by("t", CancelJobRequest { id: job.id.clone() })).await.unwrap().into_inner();
        assert_eq!(cancelled.job.unwrap().state(), JobState::Cancelled);
    }
    client.delete_job(delete()).await.unwrap();
    assert_eq!(client.delete_job(delete()).await.unwrap_err().code(), Code::NotFound);
    let done = create(&mut client, 101).await;
    let at = claim(&server, &done).await;
    change(&server, &done, at, Change::Succeed(ResultSet::default())).await;
    let status = client.cancel_job(by("t", CancelJobRequest { id: done.id.clone() })).await.unwrap_err();
    assert_eq!(status.code(), Code::FailedPrecondition);
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn lists_come_in_pages_that_fit_into_a_message() {
    let (server, mut client) = start().await;
    // Large ones: 80 of them are more than a message may be.
    let point = |x: f64| SeedEdit { edit: Some(seed_edit::Edit::Add(Point { x, y: x, z: x })) };
    let edit = CvtEdit { edits: vec![point(0.1); 2000], seeds: 0 };
    let command = CvtJobCommand { command: Some(cvt_job_command::Command::Edit(edit)) };
    let options = Some(CvtOptions { points: Some(5), ..CvtOptions::default() });
    let work = CvtJob { options, commands: vec![command] };
    let large = JobSpec { work: Some(job_spec::Work::Cvt(work)), ..wanted(0) };
    let mut made = Vec::new();
    for k in 0..60 {
        let spec = if k % 3 == 0 { wanted(k + 1) } else { large.clone() };
        let request = CreateJobRequest { spec: Some(spec), ..CreateJobRequest::default() };
        made.push(client.create_job(by("t", request)).await.unwrap().into_inner().job.unwrap().id);
    }
    made.sort_unstable_by(|a, b| b.cmp(a));
    for page_size in [7, 1000] {
        let (mut found, mut pages, mut page_token) = (Vec::new(), 0, String::new());
        loop {
            let question = ListJobsRequest { page_size, page_token, ..ListJobsRequest::default() };
            let page = client.list_jobs(by("t", question)).await.unwrap().into_inner();
            found.extend(page.jobs.into_iter().map(|job| job.id));
            pages += 1;
            page_token = page.next_page_token;
            if page_token.is_empty() {
                break;
            }
        }
        assert_eq!(found, made, "all of them, the newest first");
        assert!(pages > 1, "one message would be too long");
    }
    let labelled =
        ListJobsRequest { labels: [("part".to_owned(), "4".to_owned())].into(), ..ListJobsRequest::default() };
    let jobs = client.list_jobs(by("t", labelled)).await.unwrap().into_inner().jobs;
    assert_eq!(jobs.iter().map(|job| job.spec.clone().unwrap()).collect::<Vec<_>>(), [wanted(4)]);
    let of = |states: &[i32]| ListJobsRequest { states: states.to_vec(), ..ListJobsRequest::default() };
    let ended = client.list_jobs(by("t", of(&[JobState::Succeeded.into()]))).await.unwrap().into_inner();
    assert!(ended.jobs.is_empty());
    let begin = prost_types::Timestamp { seconds: 4_000_000_000, nanos: 1 };
    let later = ListJobsRequest { created_since: Some(begin), ..ListJobsRequest::default() };
    assert!(client.list_jobs(by("t", later)).await.unwrap().into_inner().jobs.is_empty());
    for (wrong, path) in [
        (of(&[1, 0]), "states[1]"),
        (of(&[77]), "states[0]"),
        (ListJobsRequest { page_token: "x".to_owned(), ..ListJobsRequest::default() }, "page_token"),
    ] {
        let status = client.list_jobs(by("t", wrong)).await.unwrap_err();
        assert_eq!((status.code(), field(&status)), (Code::InvalidArgument, path.to_owned()));
    }
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_watch_tells_everything_and_ends_with_the_job() {
    let (server, mut client) = start().await;
    let job = create(&mut client, 100).await;
    let mut events = watch(&mut client, &job, 0).await;
    let first = next(&mut events).await.unwrap().unwrap();
    assert_eq!((first.number, state_of(&first)), (1, Some(JobState::Queued)));
    let at = claim(&server, &job).await;
    let second = next(&mut events).await.unwrap().unwrap();
    assert_eq!(state_of(&second), Some(JobState::Running));
    for index in 0..3 {
        step(&server, &job, at, index).await;
        let event = next(&mut events).await.unwrap().unwrap();
        let Some(What::Iteration(step)) = event.what else { panic!("{event:?}") };
        assert_eq!((step.index, step.total, &step.kind[..], step.energy), (index, 9, "lloyd", 0.5));
    }
    // Cut, and on from the last number that came.
    drop(events);
    let stage = Progress::Stage { name: "dual".to_owned(), done: 1, total: 2 };
    server.idle.store.progress(id(&job), at, stage).await.unwrap();
    let mut events = watch(&mut client, &job, second.number + 3).await;
    let event = next(&mut events).await.unwrap().unwrap();
    assert!(matches!(&event.what, Some(What::Stage(stage)) if stage.name == "dual" && stage.total == 2), "{event:?}");
    change(&server, &job, at, Change::Succeed(ResultSet::default())).await;
    let rest = all(&mut events).await;
    assert_eq!(rest.iter().map(state_of).collect::<Vec<_>>(), [Some(JobState::Succeeded)]);
    // Of a job that has ended everything comes at once, and nothing after its last.
    let whole = all(&mut watch(&mut client, &job, 0).await).await;
    assert_eq!(whole.len(), 7);
    assert!(whole.is_sorted_by_key(|event| event.number));
    let last = whole.last().unwrap().number;
    for after in [last, last + 1, u64::MAX] {
        assert!(all(&mut watch(&mut client, &job, after).await).await.is_empty());
    }
    change(&server, &job, at + 1, Change::Expire(record::Cause::Kept)).await;
    let whole = all(&mut watch(&mut client, &job, last).await).await;
    assert_eq!(whole.iter().map(state_of).collect::<Vec<_>>(), [Some(JobState::Expired)]);
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_watch_of_a_job_that_is_deleted_says_so() {
    let (server, mut client) = start().await;
    let job = create(&mut client, 100).await;
    // Its number never comes: it waits past the end.
    let mut events = watch(&mut client, &job, 1000).await;
    tokio::time::sleep(SECOND / 5).await;
    server.idle.store.cancel(id(&job)).await.unwrap();
    server.idle.store.delete(id(&job)).await.unwrap();
    assert_eq!(next(&mut events).await.unwrap_err().code(), Code::NotFound);
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_shutdown_ends_watches_and_says_when_to_come_back() {
    let (server, mut client) = start().await;
    let job = create(&mut client, 100).await;
    let mut events = watch(&mut client, &job, 0).await;
    next(&mut events).await.unwrap().unwrap();
    let stopping = tokio::spawn(server.stop());
    let status = next(&mut events).await.unwrap_err();
    assert_eq!(status.code(), Code::Unavailable);
    assert!(status.get_details_retry_info().unwrap().retry_delay.is_some());
    // The server's end would come too late if anybody waited for watchers.
    stopping.await.unwrap().unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_watcher_that_does_not_read_holds_up_nobody() {
    let (server, mut client) = start().await;
    let job = create(&mut client, 100).await;
    let idle: Vec<_> = {
        let mut idle = Vec::new();
        for _ in 0..50 {
            idle.push(watch(&mut client, &job, 0).await);
        }
        idle
    };
    let mut reader = JobServiceClient::new(server.channel().await);
    let mut events = watch(&mut reader, &job, 0).await;
    let at = claim(&server, &job).await;
    for index in 0..500 {
        step(&server, &job, at, index).await;
    }
    change(&server, &job, at, Change::Succeed(ResultSet::default())).await;
    let whole = all(&mut events).await;
    assert_eq!(state_of(whole.last().unwrap()), Some(JobState::Succeeded));
    for mut events in idle {
        let whole = all(&mut events).await;
        assert_eq!(state_of(whole.last().unwrap()), Some(JobState::Succeeded), "who comes late hears the end");
    }
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn watchers_take_no_place_from_who_has_work() {
    let limits = server::config::Limits { max_streams: 3, ..Default::default() };
    let server = Server::start(Setup { limits, ..Setup::default() }).await;
    let mut client = JobServiceClient::new(server.channel().await);
    put(&*server.idle.blobs, b"a surface".to_vec().into(), None).await.unwrap();
    let job = create(&mut client, 100).await;
    let mut watches = Vec::new();
    for _ in 0..2 {
        watches.push(watch(&mut client, &job, 0).await);
    }
    let status = client.watch_job(by("t", WatchJobRequest { id: job.id.clone(), after: 0 })).await.unwrap_err();
    assert_eq!(status.code(), Code::ResourceExhausted);
    assert!(status.get_details_retry_info().is_some());
    client.get_job(by("t", GetJobRequest { id: job.id.clone() })).await.unwrap();
    ask_rvd(&mut server.client().await, small_rvd(BackendChoice::Parallel)).await.unwrap();
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn health_and_reflection_know_both_services() {
    use tonic_health::pb::HealthCheckRequest;
    use tonic_health::pb::health_check_response::ServingStatus;
    use tonic_health::pb::health_client::HealthClient;
    use tonic_reflection::pb::v1::ServerReflectionRequest;
    use tonic_reflection::pb::v1::server_reflection_client::ServerReflectionClient;
    use tonic_reflection::pb::v1::server_reflection_request::MessageRequest;
    use tonic_reflection::pb::v1::server_reflection_response::MessageResponse;
    let (server, _) = start().await;
    let mut health = HealthClient::new(server.channel().await);
    let mut reflection = ServerReflectionClient::new(server.channel().await);
    let question = MessageRequest::ListServices(String::new());
    let ask = ServerReflectionRequest { host: String::new(), message_request: Some(question) };
    let mut answers = reflection.server_reflection_info(tokio_stream::iter([ask])).await.unwrap().into_inner();
    let answer = answers.message().await.unwrap().unwrap().message_response.unwrap();
    let MessageResponse::ListServicesResponse(list) = answer else { panic!("a list") };
    for service in [BLOB_SERVICE_NAME, JOB_SERVICE_NAME] {
        let told = health.check(HealthCheckRequest { service: service.to_owned() }).await.unwrap().into_inner();
        assert_eq!(told.status(), ServingStatus::Serving);
        assert!(list.service.iter().any(|listed| listed.name == service), "{list:?}");
    }
    drop(answers);
    // What is listed can be described, by each version.
    use tonic_reflection::pb::v1alpha;
    let mut older = v1alpha::server_reflection_client::ServerReflectionClient::new(server.channel().await);
    for listed in list.service {
        let question = Some(MessageRequest::FileContainingSymbol(listed.name.clone()));
        let ask = ServerReflectionRequest { host: String::new(), message_request: question };
        let mut answers = reflection.server_reflection_info(tokio_stream::iter([ask])).await.unwrap().into_inner();
        let answer = answers.message().await.unwrap().unwrap().message_response.unwrap();
        assert!(matches!(answer, MessageResponse::FileDescriptorResponse(_)), "{}: {answer:?}", listed.name);
        use v1alpha::server_reflection_request::MessageRequest as Older;
        let question = Some(Older::FileContainingSymbol(listed.name.clone()));
        let ask = v1alpha::ServerReflectionRequest { host: String::new(), message_request: question };
        let mut answers = older.server_reflection_info(tokio_stream::iter([ask])).await.unwrap().into_inner();
        let answer = answers.message().await.unwrap().unwrap().message_response.unwrap();
        use v1alpha::server_reflection_response::MessageResponse as Answer;
        assert!(matches!(answer, Answer::FileDescriptorResponse(_)), "{}: {answer:?}", listed.name);
    }
    server.stop().await.unwrap();
}
