//! The program with a folder, and a client of it.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use sha2::{Digest as _, Sha256};
use tessera::mesh::TriMesh;
use tessera::mesh::io::{Format, encode};
use tessera::proto::blob_service_client::BlobServiceClient;
use tessera::proto::job_service_client::JobServiceClient;
use tessera::proto::*;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tonic::transport::{Channel, Endpoint};

use crate::process::{address_of, addresses_of};

/// A server. Killed when dropped.
pub struct Program {
    pub child: Child,
    pub address: String,
    /// The admin port, if the options open one.
    pub admin: Option<String>,
}

impl Program {
    /// Starts it, and waits until it listens.
    pub fn start(folder: &Path, options: &[&str]) -> Self {
        Self::start_logging(folder, options, "warn", Stdio::null())
    }

    /// The same with a log.
    pub fn start_logging(folder: &Path, options: &[&str], filter: &str, log: Stdio) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_tessera"))
            .args(["serve", "--listen", "127.0.0.1:0", "--backend", "parallel", "--data-dir"])
            .arg(folder)
            .args(options)
            .env("TESSERA_LOG", filter)
            // Whatever the machine has, there is no GPU.
            .env("VK_DRIVER_FILES", "/dev/null")
            .stdout(Stdio::piped())
            .stderr(log)
            .spawn()
            .unwrap();
        let (address, admin) = match options.contains(&"--admin-listen") {
            true => addresses_of(&mut child),
            false => (address_of(&mut child), String::new()),
        };
        let admin = Some(admin).filter(|admin| !admin.is_empty());
        Self { child, address, admin }
    }

    pub async fn client(&self) -> Client {
        Client::to(&self.address).await
    }

    /// No word to it, and no end of anything that it does.
    pub fn kill(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }

    /// Tells it to stop; its exit code.
    pub fn stop(&mut self) -> Option<i32> {
        let told = Command::new("kill").args(["-TERM", &self.child.id().to_string()]).status().unwrap();
        assert!(told.success());
        self.child.wait().unwrap().code()
    }

    /// The metrics that the admin port tells, by name and labels.
    pub async fn metrics(&self) -> BTreeMap<String, f64> {
        let mut stream = TcpStream::connect(self.admin.as_ref().unwrap()).await.unwrap();
        stream.write_all(b"GET /metrics HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n").await.unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).await.unwrap();
        let samples = answer.split_once("\r\n\r\n").unwrap().1.lines().filter(|line| !line.starts_with('#'));
        let samples = samples.map(|line| line.rsplit_once(' ').unwrap());
        samples.map(|(name, value)| (name.to_owned(), value.parse().unwrap())).collect()
    }

    /// Resident memory in bytes, open descriptors, threads.
    #[cfg(target_os = "linux")]
    pub fn held(&self) -> (u64, usize, usize) {
        crate::process::resources_of(&self.child)
    }

    /// Seconds that its threads have worked, all together.
    #[cfg(target_os = "linux")]
    pub fn worked_s(&self) -> f64 {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.child.id())).unwrap();
        // The name is in brackets; user and system time are the 14th and 15th field, in hundredths.
        let fields: Vec<f64> =
            stat.rsplit(')').next().unwrap().split_whitespace().filter_map(|n| n.parse().ok()).collect();
        (fields[10] + fields[11]) / 100.0
    }

    /// The names of its threads, sorted.
    #[cfg(target_os = "linux")]
    pub fn threads(&self) -> Vec<String> {
        let tasks = std::fs::read_dir(format!("/proc/{}/task", self.child.id())).unwrap();
        let name =
            |task: std::io::Result<std::fs::DirEntry>| std::fs::read_to_string(task.ok()?.path().join("comm")).ok();
        let mut names: Vec<String> = tasks.filter_map(name).map(|name| name.trim().to_owned()).collect();
        names.sort();
        names
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Somebody who uploads meshes and asks for jobs.
#[derive(Clone)]
pub struct Client {
    pub jobs: JobServiceClient<Channel>,
    pub blobs: BlobServiceClient<Channel>,
    pub tenant: Option<String>,
    pub key: Option<String>,
}

pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

/// The pieces of an upload, the last of which finishes it.
pub fn pieces(bytes: &[u8], size: usize) -> Vec<WriteRequest> {
    let digest = hex(&Sha256::digest(bytes));
    let mut all: Vec<WriteRequest> = bytes
        .chunks(size)
        .enumerate()
        .map(|(i, data)| WriteRequest {
            digest: digest.clone(),
            size_bytes: bytes.len() as u64,
            offset: (i * size) as u64,
            crc32c: crc32c::crc32c(data),
            data: data.to_vec().into(),
            finish: false,
        })
        .collect();
    all.last_mut().unwrap().finish = true;
    all
}

impl Client {
    pub async fn to(address: &str) -> Self {
        let endpoint = Endpoint::from_shared(format!("http://{address}")).unwrap();
        let channel = endpoint.connect_timeout(Duration::from_secs(10)).connect().await.unwrap();
        Self {
            jobs: JobServiceClient::new(channel.clone()),
            blobs: BlobServiceClient::new(channel),
            tenant: None,
            key: None,
        }
    }

    pub fn of(&self, tenant: &str) -> Self {
        Self { tenant: Some(tenant.to_owned()), ..self.clone() }
    }

    pub fn with_key(&self, key: &str) -> Self {
        Self { key: Some(key.to_owned()), ..self.clone() }
    }

    pub fn request<T>(&self, message: T) -> tonic::Request<T> {
        let mut request = tonic::Request::new(message);
        if let Some(key) = &self.key {
            request.metadata_mut().insert("authorization", format!("Bearer {key}").parse().unwrap());
        }
        if let Some(tenant) = &self.tenant {
            request.metadata_mut().insert("tessera-tenant", tenant.parse().unwrap());
        }
        request
    }

    pub async fn put(&mut self, bytes: &[u8]) -> String {
        let pieces = tokio_stream::iter(pieces(bytes, 1 << 20));
        let request = self.request(pieces);
        let stored = self.blobs.write(request).await.unwrap().into_inner();
        assert!(stored.complete);
        stored.digest
    }

    /// Begins an upload with one message and ends the stream.
    pub async fn begin(&mut self, message: WriteRequest) -> Result<WriteResponse, tonic::Status> {
        let request = self.request(tokio_stream::iter([message]));
        Ok(self.blobs.write(request).await?.into_inner())
    }

    pub async fn put_mesh(&mut self, mesh: &TriMesh) -> String {
        self.put(&encode(Format::Ply, mesh).unwrap()).await
    }

    pub async fn create(&mut self, spec: JobSpec, request_id: &str) -> Result<CreateJobResponse, tonic::Status> {
        let request = self.request(CreateJobRequest {
            spec: Some(spec),
            request_id: request_id.to_owned(),
            ..CreateJobRequest::default()
        });
        Ok(self.jobs.create_job(request).await?.into_inner())
    }

    /// The answer to a new job, or an earlier one with the same result.
    pub async fn create_or_reuse(&mut self, spec: JobSpec) -> CreateJobResponse {
        let reuse = ReusePolicy::SameBits.into();
        let request = self.request(CreateJobRequest { spec: Some(spec), reuse, ..CreateJobRequest::default() });
        self.jobs.create_job(request).await.unwrap().into_inner()
    }

    /// A new job's name.
    pub async fn submit(&mut self, spec: JobSpec) -> String {
        self.create(spec, "").await.unwrap().job.unwrap().id
    }

    pub async fn get(&mut self, id: &str) -> Job {
        let request = self.request(GetJobRequest { id: id.to_owned() });
        self.jobs.get_job(request).await.unwrap().into_inner().job.unwrap()
    }

    pub async fn cancel(&mut self, id: &str) -> Result<Job, tonic::Status> {
        let request = self.request(CancelJobRequest { id: id.to_owned() });
        Ok(self.jobs.cancel_job(request).await?.into_inner().job.unwrap())
    }

    /// The events after a number, to the end.
    pub async fn watch(&mut self, id: &str, after: u64) -> Result<Vec<JobEvent>, tonic::Status> {
        let request = self.request(WatchJobRequest { id: id.to_owned(), after });
        let mut stream = self.jobs.watch_job(request).await?.into_inner();
        let mut events = Vec::new();
        while let Some(message) = stream.message().await? {
            events.push(message.event.unwrap());
        }
        Ok(events)
    }

    /// Waits until a job has ended, at most so long.
    pub async fn end(&mut self, id: &str, limit: Duration) -> Job {
        let start = Instant::now();
        let watched = tokio::time::timeout(limit, self.watch(id, 0)).await;
        watched.unwrap_or_else(|_| panic!("{id} has not ended after {:?}", start.elapsed())).unwrap();
        self.get(id).await
    }

    pub async fn read(&mut self, digest: &str) -> Vec<u8> {
        let request = self.request(ReadRequest { digest: digest.to_owned(), ..ReadRequest::default() });
        let mut stream = self.blobs.read(request).await.unwrap().into_inner();
        let mut all = Vec::new();
        while let Some(piece) = stream.message().await.unwrap() {
            assert_eq!(piece.offset, all.len() as u64);
            assert_eq!(piece.crc32c, crc32c::crc32c(&piece.data));
            all.extend_from_slice(&piece.data);
        }
        assert_eq!(hex(&Sha256::digest(&all)), digest);
        all
    }

    /// All jobs of the tenant.
    pub async fn all(&mut self) -> Vec<Job> {
        let mut all = Vec::new();
        let mut token = String::new();
        loop {
            let page = ListJobsRequest { page_size: 1000, page_token: token, ..ListJobsRequest::default() };
            let request = self.request(page);
            let page = self.jobs.list_jobs(request).await.unwrap().into_inner();
            all.extend(page.jobs);
            token = page.next_page_token;
            if token.is_empty() {
                return all;
            }
        }
    }
}

/// A remesh of a PLY file.
pub fn remesh(digest: &str, points: u32, seed: u64) -> JobSpec {
    JobSpec {
        mesh: Some(JobMesh { source: Some(job_mesh::Source::File(file(digest))) }),
        work: Some(job_spec::Work::Remesh(RemeshOptions {
            points: Some(points),
            seed: Some(seed),
            ..RemeshOptions::default()
        })),
        ..JobSpec::default()
    }
}

pub fn file(digest: &str) -> MeshFile {
    MeshFile { digest: digest.to_owned(), format: MeshFormat::Ply.into(), attributes: None }
}

/// A part of a job's result.
pub fn part(job: &Job, name: &str) -> String {
    let found = job.results.iter().find(|blob| blob.name == name);
    found.unwrap_or_else(|| panic!("no {name}: {job:?}")).digest.clone()
}
