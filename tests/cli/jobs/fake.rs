//! A small server of jobs and blobs, which can be told to lie, and to lose its connections.

use std::collections::HashMap;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard};

use sha2::Digest as _;
use tessera::proto::blob_service_server::{BlobService, BlobServiceServer};
use tessera::proto::job_service_server::{JobService, JobServiceServer};
use tessera::proto::{self, Job, JobEvent, JobState, ResultBlob, job_event};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Notify;
use tokio_stream::{Stream, StreamExt};
use tonic::transport::server::TcpIncoming;
use tonic::{Request, Response, Status, Streaming};

pub(super) const ID: &str = "0123456789abcdef0123456789abcdef";

/// What a server says that is not so.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Lie {
    #[default]
    None,
    /// Other bytes, with their own checksums.
    OtherBytes,
    /// Bytes that do not fit their checksums.
    Damaged,
    /// A download that ends too early.
    Short,
    /// More bytes than it says.
    Long,
    /// Pieces without bytes, without an end.
    Endless,
    /// Another job than the one that was asked for.
    OtherJob,
    /// A state that there is not.
    State,
    /// Events whose numbers fall.
    Events,
    /// Events that end before the job does.
    EndOfEvents,
    /// An upload that is not complete after its end.
    Incomplete,
    /// More bytes of an upload than there are.
    TooMuchKept,
    /// Pages without an end.
    Pages,
}

/// What the server has and has seen.
#[derive(Default)]
pub(super) struct State {
    pub(super) blobs: HashMap<String, Vec<u8>>,
    pub(super) uploads: HashMap<String, Vec<u8>>,
    pub(super) jobs: Vec<Job>,
    /// What a job becomes once it was watched to its end.
    pub(super) ended: Option<Job>,
    /// The offset of each first message of an upload.
    pub(super) writes: Vec<u64>,
    pub(super) created: Vec<(proto::CreateJobRequest, Option<String>)>,
    pub(super) listed: Option<proto::ListJobsRequest>,
    pub(super) estimated: Option<(Option<u64>, Option<u64>)>,
    /// The `after` of each watch, and the `offset` of each read.
    pub(super) watched: Vec<u64>,
    pub(super) read: Vec<u64>,
    pub(super) lie: Lie,
    /// How often connections are still to be lost in the midst of a call.
    pub(super) losses: u32,
    /// Whether watches come to no event after the first.
    pub(super) hold: bool,
}

#[derive(Clone, Default)]
pub(super) struct Fake {
    state: Arc<Mutex<State>>,
    cut: Arc<Notify>,
}

pub(super) fn digest(bytes: &[u8]) -> String {
    sha2::Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

pub(super) fn result(name: &str, bytes: &[u8]) -> ResultBlob {
    ResultBlob { name: name.to_owned(), digest: digest(bytes) }
}

/// The moment at which everything happens.
fn moment() -> Option<prost_types::Timestamp> {
    Some(prost_types::Timestamp { seconds: 1_793_865_600, nanos: 0 })
}

/// A remesh in this state.
pub(super) fn job(state: JobState) -> Job {
    let work = Some(proto::job_spec::Work::Remesh(proto::RemeshOptions::default()));
    let spec = Some(proto::JobSpec { work, ..Default::default() });
    Job { id: ID.to_owned(), spec, state: state.into(), created: moment(), ..Default::default() }
}

impl Fake {
    /// With a job in the state `before`, which becomes `ended` once it was watched.
    pub(super) fn ending(before: JobState, ended: Job) -> Self {
        let fake = Self::default();
        let now = if JobState::try_from(ended.state) == Ok(before) { ended.clone() } else { job(before) };
        fake.state().jobs = vec![now];
        fake.state().ended = Some(ended);
        fake
    }

    pub(super) fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap()
    }

    pub(super) fn keep(&self, bytes: &[u8]) {
        self.state().blobs.insert(digest(bytes), bytes.to_vec());
    }

    /// The last request that created a job, and whose it was.
    pub(super) fn created(&self) -> (proto::CreateJobRequest, Option<String>) {
        self.state().created.last().cloned().unwrap()
    }

    fn job(&self, id: &str) -> Result<Job, Status> {
        let state = self.state();
        let found = state.jobs.iter().find(|job| job.id == id).cloned();
        let mut job = found.ok_or_else(|| Status::not_found("no such job"))?;
        match state.lie {
            Lie::OtherJob => job.id = "f".repeat(32),
            Lie::State => job.state = 77,
            _ => {}
        }
        Ok(job)
    }

    /// Loses all connections, if that is still to happen, and never comes back.
    async fn lose(&self) {
        {
            let mut state = self.state();
            if state.losses == 0 {
                return;
            }
            state.losses -= 1;
        }
        // What was said is to arrive.
        tokio::time::sleep(std::time::Duration::from_millis(300)).await;
        self.cut.notify_waiters();
        std::future::pending::<()>().await;
    }

    /// A server of its own behind a door that can be shut; it ends with the runtime.
    pub(super) fn serve(&self) -> (tokio::runtime::Runtime, SocketAddr) {
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
        let (inner, outer) = runtime.block_on(async {
            (TcpListener::bind("127.0.0.1:0").await.unwrap(), TcpListener::bind("127.0.0.1:0").await.unwrap())
        });
        let (to, address) = (inner.local_addr().unwrap(), outer.local_addr().unwrap());
        let server = tonic::transport::Server::builder()
            .add_service(JobServiceServer::new(self.clone()))
            .add_service(BlobServiceServer::new(self.clone()));
        runtime.spawn(server.serve_with_incoming(TcpIncoming::from(inner)));
        let cut = Arc::clone(&self.cut);
        runtime.spawn(async move {
            loop {
                let (mut client, _) = outer.accept().await.unwrap();
                let cut = Arc::clone(&cut);
                tokio::spawn(async move {
                    let mut server = TcpStream::connect(to).await.unwrap();
                    tokio::select! {
                        _ = tokio::io::copy_bidirectional(&mut client, &mut server) => {}
                        () = cut.notified() => {}
                    }
                });
            }
        });
        (runtime, address)
    }
}

type Answers<T> = Pin<Box<dyn Stream<Item = Result<T, Status>> + Send>>;

/// A stream of what `body` sends.
fn answers<T: Send + 'static, F: Future<Output = ()> + Send>(
    body: impl FnOnce(tokio::sync::mpsc::Sender<Result<T, Status>>) -> F + Send + 'static,
) -> Response<Answers<T>> {
    let (sender, mut receiver) = tokio::sync::mpsc::channel(1);
    tokio::spawn(async move { body(sender).await });
    Response::new(Box::pin(futures_util::stream::poll_fn(move |context| receiver.poll_recv(context))))
}

#[tonic::async_trait]
impl BlobService for Fake {
    type ReadStream = Answers<proto::ReadResponse>;

    async fn write(
        &self,
        request: Request<Streaming<proto::WriteRequest>>,
    ) -> Result<Response<proto::WriteResponse>, Status> {
        let mut messages = request.into_inner();
        let (mut name, mut size) = (String::new(), 0);
        while let Some(message) = messages.next().await {
            let message = message?;
            if name.is_empty() {
                (name, size) = (message.digest, message.size_bytes);
                self.state().writes.push(message.offset);
            }
            assert_eq!(crc32c::crc32c(&message.data), message.crc32c);
            {
                let mut state = self.state();
                let upload = state.uploads.entry(name.clone()).or_default();
                if upload.len() as u64 != message.offset {
                    return Err(Status::out_of_range("elsewhere"));
                }
                upload.extend_from_slice(&message.data);
            }
            if !message.data.is_empty() {
                self.lose().await;
            }
            if message.finish {
                let mut state = self.state();
                let bytes = state.uploads.remove(&name).unwrap();
                let (kept_bytes, complete) = (bytes.len() as u64, state.lie != Lie::Incomplete);
                if digest(&bytes) != name || kept_bytes != size {
                    return Err(Status::invalid_argument("other bytes"));
                }
                if complete {
                    state.blobs.insert(name.clone(), bytes);
                }
                return Ok(Response::new(proto::WriteResponse {
                    digest: name,
                    size_bytes: size,
                    kept_bytes,
                    complete,
                }));
            }
        }
        Err(Status::cancelled("not finished"))
    }

    async fn query_write_status(
        &self,
        request: Request<proto::QueryWriteStatusRequest>,
    ) -> Result<Response<proto::QueryWriteStatusResponse>, Status> {
        let proto::QueryWriteStatusRequest { digest, size_bytes } = request.into_inner();
        let state = self.state();
        let complete = state.blobs.contains_key(&digest);
        let kept_bytes = match state.uploads.get(&digest) {
            _ if state.lie == Lie::TooMuchKept => size_bytes + 1,
            Some(upload) => upload.len() as u64,
            None if complete => size_bytes,
            None => return Err(Status::not_found("no such upload")),
        };
        Ok(Response::new(proto::QueryWriteStatusResponse { kept_bytes, complete }))
    }

    async fn read(&self, request: Request<proto::ReadRequest>) -> Result<Response<Self::ReadStream>, Status> {
        let proto::ReadRequest { digest, offset, .. } = request.into_inner();
        let (mut bytes, lie) = {
            let mut state = self.state();
            state.read.push(offset);
            let blob = state.blobs.get(&digest).cloned().ok_or_else(|| Status::not_found("no such blob"))?;
            (blob, state.lie)
        };
        if lie == Lie::OtherBytes {
            bytes[0] ^= 1;
        }
        let fake = self.clone();
        Ok(answers(move |sender| async move {
            let size_bytes = bytes.len() as u64 - u64::from(lie == Lie::Long);
            let piece = |at: usize, data: &[u8]| {
                let crc32c = crc32c::crc32c(data) ^ u32::from(lie == Lie::Damaged);
                Ok(proto::ReadResponse { offset: at as u64, data: data.to_vec().into(), crc32c, size_bytes })
            };
            let mut at = offset as usize;
            if bytes.is_empty() {
                let _ = sender.send(piece(0, &[])).await;
            }
            while at < bytes.len() {
                let next = (at + (1 << 20)).min(bytes.len());
                if lie == Lie::Endless {
                    while sender.send(piece(at, &[])).await.is_ok() {}
                    return;
                }
                if lie == Lie::Short && next == bytes.len() {
                    return;
                }
                if sender.send(piece(at, &bytes[at..next])).await.is_err() {
                    return;
                }
                at = next;
                fake.lose().await;
            }
        }))
    }

    async fn find_missing(
        &self,
        request: Request<proto::FindMissingRequest>,
    ) -> Result<Response<proto::FindMissingResponse>, Status> {
        let state = self.state();
        let digests = request.into_inner().digests.into_iter().filter(|name| !state.blobs.contains_key(name)).collect();
        Ok(Response::new(proto::FindMissingResponse { digests }))
    }

    async fn stat(&self, request: Request<proto::StatRequest>) -> Result<Response<proto::StatResponse>, Status> {
        let digest = request.into_inner().digest;
        let size = self.state().blobs.get(&digest).map(|bytes| bytes.len() as u64);
        let size_bytes = size.ok_or_else(|| Status::not_found("no such blob"))?;
        Ok(Response::new(proto::StatResponse { digest, size_bytes }))
    }

    async fn delete(&self, _: Request<proto::DeleteRequest>) -> Result<Response<proto::DeleteResponse>, Status> {
        Err(Status::unimplemented("no"))
    }
}

/// What happens to a job that ends as `end`.
fn events(end: i32) -> Vec<JobEvent> {
    let state = |state: i32| job_event::What::State(proto::JobStateChange { state, attempt: 1 });
    let stage = proto::JobStage { name: "sample".to_owned(), done: 1, total: 3 };
    let (kind, energy, ms) = ("lloyd".to_owned(), 1.5, 2.0);
    let step = proto::JobIteration { index: 0, total: 35, kind, energy, energy_ratio: 1.5, gradient_norm: 0.1, ms };
    let all = [
        (1, state(JobState::Queued.into())),
        (2, state(JobState::Running.into())),
        (3, job_event::What::Stage(stage)),
        (4, job_event::What::Iteration(step)),
        // One was thinned out.
        (6, state(end)),
    ];
    all.into_iter().map(|(number, what)| JobEvent { number, at: moment(), what: Some(what) }).collect()
}

#[tonic::async_trait]
impl JobService for Fake {
    type WatchJobStream = Answers<proto::WatchJobResponse>;

    async fn create_job(
        &self,
        request: Request<proto::CreateJobRequest>,
    ) -> Result<Response<proto::CreateJobResponse>, Status> {
        let tenant = request.metadata().get("tessera-tenant").map(|value| value.to_str().unwrap().to_owned());
        let request = request.into_inner();
        let existed = {
            let mut state = self.state();
            let known = |(before, _): &(proto::CreateJobRequest, _)| before.request_id == request.request_id;
            let existed = !request.request_id.is_empty() && state.created.iter().any(known);
            state.created.push((request.clone(), tenant));
            existed
        };
        self.lose().await;
        let job = Job { spec: request.spec, ..job(JobState::Queued) };
        Ok(Response::new(proto::CreateJobResponse { job: Some(job), existed, reused: false }))
    }

    async fn get_job(&self, request: Request<proto::GetJobRequest>) -> Result<Response<proto::GetJobResponse>, Status> {
        Ok(Response::new(proto::GetJobResponse { job: Some(self.job(&request.into_inner().id)?) }))
    }

    async fn list_jobs(
        &self,
        request: Request<proto::ListJobsRequest>,
    ) -> Result<Response<proto::ListJobsResponse>, Status> {
        let request = request.into_inner();
        let mut state = self.state();
        state.listed = Some(request.clone());
        let from: usize = request.page_token.parse().unwrap_or(0);
        let to = (from + request.page_size as usize).min(state.jobs.len());
        let next_page_token = match state.lie {
            Lie::Pages => "0".to_owned(),
            _ if to < state.jobs.len() => to.to_string(),
            _ => String::new(),
        };
        Ok(Response::new(proto::ListJobsResponse { jobs: state.jobs[from..to].to_vec(), next_page_token }))
    }

    async fn watch_job(
        &self,
        request: Request<proto::WatchJobRequest>,
    ) -> Result<Response<Self::WatchJobStream>, Status> {
        let proto::WatchJobRequest { id, after } = request.into_inner();
        self.job(&id)?;
        let (ended, lie) = {
            let mut state = self.state();
            state.watched.push(after);
            (state.ended.clone(), state.lie)
        };
        let fake = self.clone();
        Ok(answers(move |sender| async move {
            let ended = ended.unwrap();
            let mut all = events(ended.state);
            match lie {
                Lie::Events => all[2].number = 1,
                Lie::EndOfEvents => all.truncate(2),
                _ => fake.state().jobs = vec![ended],
            }
            for event in all.into_iter().filter(|event| event.number > after || lie == Lie::Events) {
                let number = event.number;
                if sender.send(Ok(proto::WatchJobResponse { event: Some(event) })).await.is_err() {
                    return;
                }
                if fake.state().hold {
                    sender.closed().await;
                }
                if number > 1 {
                    fake.lose().await;
                }
            }
        }))
    }

    async fn cancel_job(
        &self,
        request: Request<proto::CancelJobRequest>,
    ) -> Result<Response<proto::CancelJobResponse>, Status> {
        let job = self.job(&request.into_inner().id)?;
        if job.state() == JobState::Succeeded {
            return Err(Status::failed_precondition("it has ended"));
        }
        let job = Job { state: JobState::Cancelled.into(), ..job };
        self.state().jobs = vec![job.clone()];
        Ok(Response::new(proto::CancelJobResponse { job: Some(job) }))
    }

    async fn delete_job(
        &self,
        request: Request<proto::DeleteJobRequest>,
    ) -> Result<Response<proto::DeleteJobResponse>, Status> {
        if self.job(&request.into_inner().id)?.state() == JobState::Running {
            return Err(Status::failed_precondition("it has not ended"));
        }
        self.state().jobs.clear();
        Ok(Response::new(proto::DeleteJobResponse {}))
    }

    async fn estimate_job(
        &self,
        request: Request<proto::EstimateJobRequest>,
    ) -> Result<Response<proto::EstimateJobResponse>, Status> {
        let request = request.into_inner();
        self.state().estimated = Some((request.vertices, request.facets));
        let answer = proto::EstimateJobResponse { host_bytes: 300, fits: true, ..Default::default() };
        Ok(Response::new(answer))
    }
}
