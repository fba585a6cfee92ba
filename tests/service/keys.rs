//! Promise: who has no good key gets one answer and nothing else; a key does what its role says, in its own tenant's name, as
//! often as its limits say, until it is revoked.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use server::keys::{KeyFile, KeyLimits, NewKey, Role, Secret};
use server::service::{Access, AccessOptions};
use tessera::proto::job_service_client::JobServiceClient;
use tessera::proto::*;
use tonic::metadata::MetadataValue;
use tonic::{Code, Request};
use tonic_types::StatusExt;

use crate::raw::{CHECK, Raw, framed};
use crate::server::*;

const SECOND: Duration = Duration::from_secs(1);
const REFLECT: &str = "/grpc.reflection.v1.ServerReflection/ServerReflectionInfo";

/// Each method, and the least role that may call it.
const METHODS: &[(&str, Role)] = &[
    ("RemeshService/ComputeRvd", Role::Submit),
    ("RemeshService/Cvt", Role::Submit),
    ("RemeshService/Remesh", Role::Submit),
    ("BlobService/Write", Role::Submit),
    ("BlobService/QueryWriteStatus", Role::Read),
    ("BlobService/Read", Role::Read),
    ("BlobService/FindMissing", Role::Read),
    ("BlobService/Stat", Role::Read),
    ("BlobService/Delete", Role::Submit),
    ("JobService/CreateJob", Role::Submit),
    ("JobService/GetJob", Role::Read),
    ("JobService/ListJobs", Role::Read),
    ("JobService/WatchJob", Role::Read),
    ("JobService/CancelJob", Role::Submit),
    ("JobService/DeleteJob", Role::Submit),
    ("JobService/EstimateJob", Role::Read),
];

pub fn required() -> AccessOptions {
    AccessOptions { require_keys: true, ..AccessOptions::default() }
}

pub struct House {
    pub folder: tempfile::TempDir,
    file: KeyFile,
}

impl House {
    pub fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let file = KeyFile::in_folder(folder.path());
        Self { folder, file }
    }

    pub fn add(&self, name: &str, role: Role, limits: KeyLimits) -> Secret {
        self.lasting(name, role, limits, None)
    }

    fn lasting(&self, name: &str, role: Role, limits: KeyLimits, lasts: Option<Duration>) -> Secret {
        let new = NewKey { name: name.to_owned(), role, lasts, limits, is_second: true };
        self.file.change(|keys| keys.add(new)).unwrap().1
    }

    async fn start(&self, options: AccessOptions) -> Server {
        let access = Access::in_folder(self.folder.path(), options).unwrap();
        Server::start(Setup { access, ..Setup::default() }).await
    }
}

fn bearer(secret: &Secret) -> String {
    format!("Bearer {}", secret.reveal())
}

/// A message in the name of a key.
pub fn with<T>(secret: &Secret, message: T) -> Request<T> {
    let mut request = Request::new(message);
    let mut value: MetadataValue<_> = bearer(secret).parse().unwrap();
    value.set_sensitive(true);
    request.metadata_mut().insert("authorization", value);
    request
}

fn code(end: &BTreeMap<String, String>) -> Code {
    end.get("grpc-status").map_or(Code::Ok, |code| Code::from_bytes(code.as_bytes()))
}

#[tokio::test(flavor = "multi_thread")]
async fn without_a_good_key_every_method_gives_one_answer() {
    let house = House::new();
    let good = house.add("ci", Role::Admin, KeyLimits::default());
    let revoked = house.add("gone", Role::Admin, KeyLimits::default());
    let expired = house.lasting("late", Role::Admin, KeyLimits::default(), Some(Duration::ZERO));
    house.file.change(|keys| keys.revoke("gone")).unwrap();
    let server = house.start(required()).await;
    let mut raw = Raw::connect(server.address, 1 << 20).await;
    let (revoked, expired, unknown) = (bearer(&revoked), bearer(&expired), bearer(&Secret::random().unwrap()));
    let own = bearer(&good);
    let wrong = own.replace(own.rsplit_once('_').unwrap().1, &"0".repeat(64));
    let malformed = own.replace("tsr_", "tsr-");
    let mut answers = Vec::new();
    let paths = METHODS.iter().map(|(path, _)| format!("/tessera.v1.{path}"));
    let paths: Vec<_> = paths.chain([REFLECT.to_owned(), "/tessera.v1.JobService/NoSuchMethod".to_owned()]).collect();
    for path in &paths {
        for headers in [
            &[][..],
            &[("authorization", "")],
            &[("authorization", &wrong)],
            &[("authorization", &unknown)],
            &[("authorization", &revoked)],
            &[("authorization", &expired)],
            &[("authorization", &malformed)],
            &[("authorization", &own), ("authorization", &own)],
            &[("authorization", &wrong), ("authorization", &own)],
            &[("x-forwarded-authorization", &own), ("x-forwarded-for", "127.0.0.1"), ("tessera-tenant", "ci")],
            &[("authorization-bin", "dHNy"), ("tessera-tenant-bin", "Y2k=")],
        ] {
            // No message is read: one that is no protobuf makes no difference.
            for bytes in [framed(&GetJobRequest::default()), vec![0, 0, 0, 0, 2, 0xff, 0xff].into()] {
                let mut end = raw.end_of(path, headers, bytes).await;
                end.remove("date");
                answers.push((format!("{path} {headers:?}"), end));
            }
        }
    }
    let first = answers[0].1.clone();
    assert_eq!(code(&first), Code::Unauthenticated, "{first:?}");
    for (what, answer) in answers {
        assert_eq!(answer, first, "{what}");
    }
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_role_may_what_the_table_says() {
    let house = House::new();
    let roles = [Role::Read, Role::Submit, Role::Admin];
    let keys = roles.map(|role| (role, bearer(&house.add(role.name(), role, KeyLimits::default()))));
    let server = house.start(required()).await;
    let mut raw = Raw::connect(server.address, 1 << 20).await;
    for (path, needs) in METHODS {
        for (role, key) in &keys {
            let path = format!("/tessera.v1.{path}");
            let end = raw.end_of(&path, &[("authorization", key)], framed(&GetJobRequest::default())).await;
            let refused = code(&end) == Code::PermissionDenied;
            assert_eq!(refused, role < needs, "{role} {path}: {end:?}");
            assert_ne!(code(&end), Code::Unauthenticated);
        }
    }
    // Another's name is refused alike, whether there is such a tenant or not.
    let get = "/tessera.v1.JobService/ListJobs";
    let empty = || framed(&ListJobsRequest::default());
    for name in ["admin", "nobody-at-all"] {
        let end = raw.end_of(get, &[("authorization", &keys[1].1), ("tessera-tenant", name)], empty()).await;
        assert_eq!(code(&end), Code::PermissionDenied, "{end:?}");
    }
    let end = raw.end_of(get, &[("authorization", &keys[2].1), ("tessera-tenant", "submit")], empty()).await;
    assert_eq!(code(&end), Code::Ok);
    let twice = [("authorization", keys[2].1.as_str()), ("tessera-tenant", "submit"), ("tessera-tenant", "read")];
    assert_eq!(code(&raw.end_of(get, &twice, empty()).await), Code::InvalidArgument);
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn health_and_reflection_have_switches() {
    let house = House::new();
    let key = bearer(&house.add("eye", Role::Read, KeyLimits::default()));
    let key = [("authorization", key.as_str())];
    let health = tonic_health::pb::HealthCheckRequest::default();
    for (options, anybody, described) in [
        (required(), Code::Ok, Code::Ok),
        (
            AccessOptions { health_needs_key: true, reflection: false, ..required() },
            Code::Unauthenticated,
            Code::Unimplemented,
        ),
    ] {
        let server = house.start(options).await;
        let mut raw = Raw::connect(server.address, 1 << 20).await;
        assert_eq!(code(&raw.end_of(CHECK, &[], framed(&health)).await), anybody);
        assert_eq!(code(&raw.end_of(CHECK, &key, framed(&health)).await), Code::Ok);
        assert_eq!(code(&raw.end_of(REFLECT, &[], Default::default()).await), Code::Unauthenticated);
        assert_eq!(code(&raw.end_of(REFLECT, &key, Default::default()).await), described);
        server.stop().await.unwrap();
    }
    // Where keys are not needed, a bad one is refused, and nobody is somebody who has one.
    let server = house.start(AccessOptions::default()).await;
    let mut raw = Raw::connect(server.address, 1 << 20).await;
    let list = "/tessera.v1.JobService/ListJobs";
    let bad = bearer(&Secret::random().unwrap());
    for (headers, wanted) in [
        (&[][..], Code::Ok),
        (&[("tessera-tenant", "team")], Code::Ok),
        (&[("tessera-tenant", "eye")], Code::Unauthenticated),
        (&[("authorization", bad.as_str())], Code::Unauthenticated),
        (&[("origin", "http://localhost:5173")], Code::PermissionDenied),
        (&[("origin", "https://evil.example")], Code::PermissionDenied),
        (&[("host", "evil.example")], Code::PermissionDenied),
        (&key, Code::Ok),
    ] {
        let end = raw.end_of(list, headers, framed(&ListJobsRequest::default())).await;
        assert_eq!(code(&end), wanted, "{headers:?} {end:?}");
    }
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn keys_rotate_while_the_server_runs() {
    let house = House::new();
    let old = house.add("ci", Role::Submit, KeyLimits::default());
    let server = house.start(required()).await;
    let mut client = JobServiceClient::new(server.channel().await);
    // A stream that is open with the old key: an upload that never ends.
    let (send, requests) = by_hand::<ComputeRvdRequest>();
    send.send(small_rvd(BackendChoice::Parallel).remove(0)).await.unwrap();
    let mut stream = server.client().await;
    let open = with(&old, requests);
    let open = tokio::spawn(async move {
        match stream.compute_rvd(open).await {
            Ok(answers) => answers.into_inner().message().await.map(drop),
            Err(status) => Err(status),
        }
    });
    client.list_jobs(with(&old, ListJobsRequest::default())).await.unwrap();
    let new = house.add("ci", Role::Submit, KeyLimits::default());
    let begin = Instant::now();
    while let Err(status) = client.list_jobs(with(&new, ListJobsRequest::default())).await {
        assert_eq!(status.code(), Code::Unauthenticated);
        assert!(begin.elapsed() < PATIENCE, "a new key is seen");
        tokio::time::sleep(SECOND / 20).await;
    }
    client.list_jobs(with(&old, ListJobsRequest::default())).await.unwrap();
    assert!(!open.is_finished());
    // A damaged file changes nothing.
    let path = house.file.path();
    let good = std::fs::read(&path).unwrap();
    std::fs::write(&path, &good[..good.len() / 2]).unwrap();
    tokio::time::sleep(2 * SECOND).await;
    client.list_jobs(with(&old, ListJobsRequest::default())).await.unwrap();
    std::fs::write(&path, &good).unwrap();
    house.file.change(|keys| keys.revoke(old.id())).unwrap();
    let status = tokio::time::timeout(PATIENCE, open).await.expect("its calls end").unwrap().unwrap_err();
    assert_eq!(status.code(), Code::Unauthenticated, "{status:?}");
    let status = client.list_jobs(with(&old, ListJobsRequest::default())).await.unwrap_err();
    assert_eq!(status.code(), Code::Unauthenticated);
    client.list_jobs(with(&new, ListJobsRequest::default())).await.unwrap();
    drop(send);
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_key_that_ends_while_the_server_runs_is_refused() {
    let house = House::new();
    let key = house.lasting("ci", Role::Submit, KeyLimits::default(), Some(5 * SECOND));
    let server = house.start(required()).await;
    let mut client = JobServiceClient::new(server.channel().await);
    client.list_jobs(with(&key, ListJobsRequest::default())).await.unwrap();
    let begin = Instant::now();
    while client.list_jobs(with(&key, ListJobsRequest::default())).await.is_ok() {
        assert!(begin.elapsed() < PATIENCE);
        tokio::time::sleep(SECOND / 20).await;
    }
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn limits_of_a_key_are_kept() {
    let house = House::new();
    let slow = house.add("slow", Role::Read, KeyLimits { rate: Some(1), ..KeyLimits::default() });
    let few = house.add("few", Role::Submit, KeyLimits { in_flight: Some(2), ..KeyLimits::default() });
    let free = house.add("free", Role::Read, KeyLimits::default());
    house.add("heavy", Role::Submit, KeyLimits { weight: Some(4.0), ..KeyLimits::default() });
    let server = house.start(required()).await;
    let mut client = JobServiceClient::new(server.channel().await);
    let mut refused = Vec::new();
    let begin = Instant::now();
    let mut taken = 0;
    while refused.len() < 5 {
        match client.list_jobs(with(&slow, ListJobsRequest::default())).await {
            Ok(_) => taken += 1,
            Err(status) => refused.push(status),
        }
    }
    assert_eq!(["heavy", "slow"].map(|name| server.engine.weights().of(name)), [4.0, 1.0]);
    // As many at once as there are in a second, and those of the time that went by.
    assert!(taken as f64 <= 2.0 + begin.elapsed().as_secs_f64(), "{taken}");
    for status in &refused {
        assert_eq!(status.code(), Code::ResourceExhausted);
        let wait = status.get_details_retry_info().unwrap().retry_delay.unwrap();
        assert!(wait <= SECOND, "{wait:?}");
        assert_eq!(status.get_details_quota_failure().unwrap().violations[0].subject, "rate");
    }
    tokio::time::sleep(refused[4].get_details_retry_info().unwrap().retry_delay.unwrap() + SECOND / 20).await;
    client.list_jobs(with(&slow, ListJobsRequest::default())).await.expect("after the pause that was told");

    // Two streams that wait for their upload. One is refused where a question below is just then the second call: it
    // is opened again.
    let mut open = tokio::task::JoinSet::new();
    for _ in 0..2 {
        let (mut stream, few) = (server.client().await, few.clone());
        open.spawn(async move {
            loop {
                let (send, requests) = by_hand::<ComputeRvdRequest>();
                send.send(small_rvd(BackendChoice::Parallel).remove(0)).await.unwrap();
                match stream.compute_rvd(with(&few, requests)).await {
                    Ok(_answer) => std::future::pending().await,
                    Err(status) => assert_eq!(status.code(), Code::ResourceExhausted, "{status:?}"),
                }
                tokio::time::sleep(SECOND / 20).await;
            }
        });
    }
    let begin = Instant::now();
    let status = loop {
        match client.list_jobs(with(&few, ListJobsRequest::default())).await {
            Err(status) => break status,
            Ok(_) => assert!(begin.elapsed() < PATIENCE),
        }
        tokio::time::sleep(SECOND / 50).await;
    };
    assert_eq!(status.code(), Code::ResourceExhausted, "{status:?}");
    assert_eq!(status.get_details_quota_failure().unwrap().violations[0].subject, "in-flight");
    assert!(status.get_details_retry_info().is_some());
    // Others are not held up, and a call that ends makes room.
    client.list_jobs(with(&free, ListJobsRequest::default())).await.unwrap();
    open.shutdown().await;
    let begin = Instant::now();
    while client.list_jobs(with(&few, ListJobsRequest::default())).await.is_err() {
        assert!(begin.elapsed() < PATIENCE);
        tokio::time::sleep(SECOND / 50).await;
    }
    server.stop().await.unwrap();
}
