//! The program with its admin port, and what is read from there.

use std::collections::BTreeMap;
use std::io::Read;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use sha2::{Digest as _, Sha256};
use tessera::mesh::TriMesh;
use tessera::mesh::io::{Format, encode};
use tessera::proto::blob_service_client::BlobServiceClient;
use tessera::proto::job_service_client::JobServiceClient;
use tessera::proto::*;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tonic::transport::{Channel, Endpoint};

use crate::process::addresses_of;

pub const SECOND: Duration = Duration::from_secs(1);

/// How long a test waits for what has to come. A loaded machine is far from it; without an end nothing would come at all.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// A server that keeps nothing. Killed when dropped.
pub struct Program {
    pub child: Child,
    pub address: String,
    pub admin: String,
    /// What it writes to the standard error stream, once it has ended.
    log: Option<std::thread::JoinHandle<String>>,
}

impl Program {
    pub fn start(options: &[&str], variables: &[(&str, &str)]) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_tessera"))
            .args(["--log-format", "json", "serve", "--listen", "127.0.0.1:0", "--admin-listen", "127.0.0.1:0"])
            .args(["--backend", "parallel", "--ephemeral"])
            .args(options)
            .envs(variables.iter().copied())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut error = child.stderr.take().unwrap();
        let log = std::thread::spawn(move || {
            let mut all = String::new();
            let _ = error.read_to_string(&mut all);
            all
        });
        let (address, admin) = addresses_of(&mut child);
        Self { child, address, admin, log: Some(log) }
    }

    pub async fn channel(&self) -> Channel {
        let endpoint = Endpoint::from_shared(format!("http://{}", self.address)).unwrap();
        endpoint.connect_timeout(10 * SECOND).connect().await.unwrap()
    }

    /// The status and the body of an answer of the admin port.
    pub async fn get(&self, path: &str, accept: &str) -> (u16, String) {
        get_from(&self.admin, path, accept).await
    }

    pub async fn metrics(&self) -> Samples {
        let (status, text) = self.get("/metrics", "text/plain").await;
        assert_eq!(status, 200);
        Samples::read(&text)
    }

    /// Tells it to end.
    pub fn term(&self) {
        let told = Command::new("kill").args(["-TERM", &self.child.id().to_string()]).status().unwrap();
        assert!(told.success());
    }

    /// Tells it to end, and waits; its log.
    pub fn stop(mut self) -> String {
        self.term();
        let start = Instant::now();
        while self.child.try_wait().unwrap().is_none() {
            assert!(start.elapsed() < PATIENCE, "it does not end");
            std::thread::sleep(Duration::from_millis(10));
        }
        self.log.take().unwrap().join().unwrap()
    }
}

/// The status and the body of an answer of a port that speaks HTTP.
pub async fn get_from(address: &str, path: &str, accept: &str) -> (u16, String) {
    let mut stream = tokio::net::TcpStream::connect(address).await.unwrap();
    let request = format!("GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nAccept: {accept}\r\n\r\n");
    stream.write_all(request.as_bytes()).await.unwrap();
    let mut answer = String::new();
    tokio::time::timeout(PATIENCE, stream.read_to_string(&mut answer)).await.unwrap().unwrap();
    let (head, body) = answer.split_once("\r\n\r\n").unwrap();
    (head.split(' ').nth(1).unwrap().parse().unwrap(), body.to_owned())
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Samples by name and labels.
#[derive(Clone, Debug)]
pub struct Samples(pub BTreeMap<String, f64>);

impl Samples {
    pub fn read(text: &str) -> Self {
        let lines = text.lines().filter(|line| !line.starts_with('#'));
        Self(
            lines.map(|line| line.rsplit_once(' ').unwrap()).map(|(n, v)| (n.to_owned(), v.parse().unwrap())).collect(),
        )
    }

    pub fn get(&self, name: &str) -> f64 {
        *self.0.get(name).unwrap_or_else(|| panic!("no {name} in {:#?}", self.0))
    }

    /// Calls by method and status.
    pub fn calls(&self) -> BTreeMap<(String, String), u64> {
        let prefix = "rpc_server_call_duration_seconds_count{";
        let of = |(name, count): (&String, &f64)| {
            let mut labels = name.strip_prefix(prefix)?.split('"').skip(1).step_by(2).map(str::to_owned);
            Some(((labels.next()?, labels.next()?), *count as u64))
        };
        self.0.iter().filter_map(of).collect()
    }
}

pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

/// Uploads a mesh; its digest.
pub async fn put(channel: &Channel, mesh: &TriMesh) -> String {
    let bytes = encode(Format::Ply, mesh).unwrap();
    let digest = hex(&Sha256::digest(&bytes));
    let piece = WriteRequest {
        digest: digest.clone(),
        size_bytes: bytes.len() as u64,
        crc32c: crc32c::crc32c(&bytes),
        data: bytes.into(),
        finish: true,
        ..WriteRequest::default()
    };
    let stored = BlobServiceClient::new(channel.clone()).write(tokio_stream::iter([piece])).await.unwrap();
    assert!(stored.into_inner().complete);
    digest
}

/// A remesh of a PLY file.
pub fn remesh(digest: &str, points: u32) -> JobSpec {
    let file = MeshFile { digest: digest.to_owned(), format: MeshFormat::Ply.into(), attributes: None };
    JobSpec {
        mesh: Some(JobMesh { source: Some(job_mesh::Source::File(file)) }),
        work: Some(job_spec::Work::Remesh(RemeshOptions {
            points: Some(points),
            seed: Some(1),
            ..RemeshOptions::default()
        })),
        ..JobSpec::default()
    }
}

/// Creates a job with metadata; its name.
pub async fn create(channel: &Channel, spec: JobSpec, metadata: &[(&'static str, &str)]) -> String {
    let mut request = tonic::Request::new(CreateJobRequest { spec: Some(spec), ..CreateJobRequest::default() });
    for (name, value) in metadata {
        request.metadata_mut().insert(*name, value.parse().unwrap());
    }
    JobServiceClient::new(channel.clone()).create_job(request).await.unwrap().into_inner().job.unwrap().id
}

/// Follows a job to its end.
pub async fn end(channel: &Channel, id: &str) -> Job {
    let mut jobs = JobServiceClient::new(channel.clone());
    let mut events = jobs.watch_job(WatchJobRequest { id: id.to_owned(), after: 0 }).await.unwrap().into_inner();
    let all = async { while events.message().await.unwrap().is_some() {} };
    tokio::time::timeout(120 * SECOND, all).await.expect("the job ends");
    jobs.get_job(GetJobRequest { id: id.to_owned() }).await.unwrap().into_inner().job.unwrap()
}
