//! A server on port 0, clients, uploads, and backends that misbehave on purpose.

pub mod idle_jobs;

use std::net::SocketAddr;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use glam::{DVec3, dvec3};
use idle_jobs::Idle;
use jobs::blob::index::BlobIndex;
use jobs::blob::{BlobError, BlobOptions, ObjectBlobs};
use jobs::store::{JobStore, MemoryStore};
use jobs::{Backends, Ceilings, Engine, EngineOptions, JobError};
use server::config::Limits;
use server::metrics::Metrics;
use server::readiness::Readiness;
use server::service::{self, About, Access, Jobs, Parts, ServeError};
use tessera::proto::remesh_service_client::RemeshServiceClient;
use tessera::proto::*;
use tessera::rvd::{Backend, BackendKind, CellSums, PassStats, PieceBatch, RvdError, Session, SessionOptions, Surface};
use tessera::rvd::{Parallel, Serial};
use tessera::token::Token;
use tokio::net::TcpListener;
use tokio::sync::{mpsc, oneshot};
use tokio_stream::wrappers::ReceiverStream;
use tonic::transport::Channel;
use transport::Tls;

/// How long a test waits for what has to come. A loaded machine is far from it; without an end nothing would come at all.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// How a [`Fake`] session behaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mood {
    /// Never ends by itself, but looks at its token.
    Busy,
    /// Panics.
    Panics,
    /// Loses its device so many times.
    Loses(usize),
    /// Does not look at its token until it is released.
    Deaf,
}

/// A backend with a mood, and counters to look at.
#[derive(Debug)]
pub struct Fake {
    pub mood: Mood,
    /// Passes at work now.
    pub running: Arc<AtomicUsize>,
    /// Passes begun.
    pub begun: Arc<AtomicUsize>,
    /// Set by the test when a deaf pass may look up.
    pub released: Arc<AtomicBool>,
}

impl Fake {
    pub fn new(mood: Mood) -> Self {
        Self { mood, running: Arc::default(), begun: Arc::default(), released: Arc::default() }
    }
}

impl Backend for Fake {
    fn kind(&self) -> BackendKind {
        BackendKind::Serial
    }
    fn threads(&self) -> usize {
        1
    }
    fn session(&self, surface: Arc<Surface>, options: SessionOptions) -> Result<Box<dyn Session>, RvdError> {
        let real = Serial.session(surface, options)?;
        let (running, begun, released) = (self.running.clone(), self.begun.clone(), self.released.clone());
        Ok(Box::new(FakeSession { mood: self.mood, running, begun, released, real }))
    }
}

struct FakeSession {
    mood: Mood,
    running: Arc<AtomicUsize>,
    begun: Arc<AtomicUsize>,
    released: Arc<AtomicBool>,
    real: Box<dyn Session>,
}

struct Running(Arc<AtomicUsize>);

impl Drop for Running {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::SeqCst);
    }
}

impl FakeSession {
    fn act(&self, token: &Token) -> Result<(), RvdError> {
        let before = self.begun.fetch_add(1, Ordering::SeqCst);
        self.running.fetch_add(1, Ordering::SeqCst);
        let _running = Running(self.running.clone());
        match self.mood {
            Mood::Panics => panic!("a fault on purpose"),
            Mood::Loses(times) if before < times => Err(RvdError::DeviceLost("on purpose".into())),
            Mood::Loses(_) => Ok(()),
            Mood::Deaf => {
                while !self.released.load(Ordering::SeqCst) {
                    std::thread::sleep(Duration::from_millis(5));
                }
                Ok(token.check()?)
            }
            Mood::Busy => loop {
                token.check()?;
                std::thread::sleep(Duration::from_millis(5));
            },
        }
    }
}

impl Session for FakeSession {
    fn set_seeds(&mut self, seeds: &[DVec3]) -> Result<(), RvdError> {
        self.real.set_seeds(seeds)
    }
    fn sums(&mut self, out: &mut CellSums, token: &Token) -> Result<PassStats, RvdError> {
        self.act(token)?;
        self.real.sums(out, token)
    }
    fn pieces(&mut self, facets: Range<u32>, out: &mut PieceBatch, token: &Token) -> Result<PassStats, RvdError> {
        self.act(token)?;
        self.real.pieces(facets, out, token)
    }
}

/// How a test server is set up.
pub struct Setup {
    pub limits: Limits,
    pub queue_jobs: usize,
    pub ceilings: Ceilings,
    /// One, unless several are looked at: so that a test knows which job is at work.
    pub jobs_at_once: usize,
    /// Stands in for the serial backend.
    pub serial: Arc<dyn Backend>,
    /// Stands in for the parallel one, which is the default and so the one that is probed.
    pub parallel: Option<Arc<dyn Backend>>,
    /// Of the blobs, which lie in memory unless `folder` is given.
    pub blobs: BlobOptions,
    pub folder: Option<PathBuf>,
    pub tls: Option<Arc<Tls>>,
    pub access: Access,
}

impl Default for Setup {
    fn default() -> Self {
        Self {
            limits: Limits::default(),
            queue_jobs: 8,
            ceilings: Ceilings::default(),
            jobs_at_once: 1,
            serial: Arc::new(Serial),
            parallel: None,
            blobs: BlobOptions::default(),
            folder: None,
            tls: None,
            access: Access::open(),
        }
    }
}

impl Setup {
    /// With this in the serial backend's place.
    pub fn fake(fake: &Arc<Fake>) -> Self {
        Self { serial: fake.clone(), ..Self::default() }
    }
}

pub type Client = RemeshServiceClient<Channel>;

/// A server that runs until it is told to stop.
pub struct Server {
    pub address: SocketAddr,
    pub engine: Engine,
    /// Its jobs and blobs.
    pub idle: Arc<Idle>,
    /// Whether it is ready.
    pub readiness: Readiness,
    stop: Option<oneshot::Sender<()>>,
    served: tokio::task::JoinHandle<Result<(), ServeError>>,
}

/// A process that another test starts holds all files of this one until it is another program.
async fn opened(index: &Arc<dyn BlobIndex>, folder: &Path, options: BlobOptions) -> ObjectBlobs {
    let begin = Instant::now();
    loop {
        match ObjectBlobs::local_with(Arc::clone(index), folder, options).await {
            Err(BlobError::InUse { .. }) if begin.elapsed() < PATIENCE => {
                tokio::time::sleep(Duration::from_millis(10)).await;
            }
            opened => return opened.unwrap(),
        }
    }
}

impl Server {
    pub async fn start(setup: Setup) -> Self {
        let (serial, parallel) = (setup.serial, setup.parallel);
        let factory = move || -> Result<Backends, JobError> {
            Ok(Backends {
                gpu: Err("no GPU in this test; use another backend".to_owned()),
                parallel: match &parallel {
                    Some(parallel) => parallel.clone(),
                    None => Arc::new(Parallel::new(Some(2))?),
                },
                serial: serial.clone(),
                default: tessera::BackendChoice::Auto,
                pools: if parallel.is_some() {
                    None
                } else {
                    Some(|threads| Ok(Arc::new(Parallel::new(Some(threads))?)))
                },
            })
        };
        let Setup { queue_jobs, ceilings, jobs_at_once, .. } = setup;
        let options = EngineOptions { queue_jobs, ceilings, jobs_at_once, ..EngineOptions::default() };
        let (engine, worker) = Engine::start(factory, options).unwrap();
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let (stop, stopped) = oneshot::channel();
        let store = MemoryStore::default();
        let blobs = match setup.folder {
            None => ObjectBlobs::in_memory_with(store.index(), setup.blobs),
            Some(folder) => opened(&store.index(), &folder, setup.blobs).await,
        };
        let idle = Arc::new(Idle::new(store, Arc::new(blobs)));
        let jobs = Some(Jobs { blobs: idle.blobs.clone(), api: idle.clone() });
        let readiness = Readiness::new();
        let (metrics, about) = (Metrics::default(), About::default());
        let Setup { limits, tls, access, .. } = setup;
        let door = None;
        let parts = Parts {
            engine: engine.clone(),
            worker,
            limits,
            jobs,
            tls,
            access,
            metrics,
            readiness: readiness.clone(),
            about,
            door,
        };
        let served = tokio::spawn(service::run(listener, parts, async {
            let _ = stopped.await;
        }));
        Self { address, engine, idle, readiness, stop: Some(stop), served }
    }

    pub async fn channel(&self) -> Channel {
        tonic::transport::Endpoint::from_shared(format!("http://{}", self.address)).unwrap().connect().await.unwrap()
    }

    pub async fn client(&self) -> Client {
        RemeshServiceClient::new(self.channel().await).max_decoding_message_size(8 << 20)
    }

    /// Tells it to stop, and goes on.
    pub fn begin_stop(&mut self) {
        let _ = self.stop.take().unwrap().send(());
    }

    /// Waits until it ends by itself.
    pub async fn ended(self) -> Result<(), ServeError> {
        tokio::time::timeout(PATIENCE, self.served).await.expect("the server ends").unwrap()
    }

    /// Tells it to stop and waits.
    pub async fn stop(mut self) -> Result<(), ServeError> {
        if let Some(stop) = self.stop.take() {
            let _ = stop.send(());
        }
        tokio::time::timeout(PATIENCE, self.served).await.expect("the server stops").unwrap()
    }
}

/// Waits until `condition` holds; says how long it took.
pub async fn until(what: &str, condition: impl Fn() -> bool) -> Duration {
    let start = Instant::now();
    while !condition() {
        assert!(start.elapsed() < PATIENCE, "{what}: not within {PATIENCE:?}");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    start.elapsed()
}

/// A request stream that is sent to by hand.
pub fn by_hand<T: Send + 'static>() -> (mpsc::Sender<T>, ReceiverStream<T>) {
    let (sender, receiver) = mpsc::channel(64);
    (sender, ReceiverStream::new(receiver))
}

pub fn octahedron() -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let points = vec![DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y, DVec3::Z, DVec3::NEG_Z];
    let facets = vec![[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]];
    (points, facets)
}

/// A sphere of 8·4^level facets.
pub fn sphere(level: usize) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let (mut points, mut facets) = octahedron();
    for _ in 0..level {
        let mut middle = std::collections::HashMap::new();
        let mut next = Vec::with_capacity(4 * facets.len());
        for [a, b, c] in facets {
            let mut mid = |i: u32, j: u32| {
                *middle.entry((i.min(j), i.max(j))).or_insert_with(|| {
                    points.push((points[i as usize] + points[j as usize]).normalize());
                    points.len() as u32 - 1
                })
            };
            let (d, e, f) = (mid(a, b), mid(b, c), mid(c, a));
            next.extend([[a, d, f], [d, b, e], [f, e, c], [d, e, f]]);
        }
        facets = next;
    }
    (points, facets)
}

/// `n` points spread on the unit sphere.
pub fn spiral(n: usize) -> Vec<DVec3> {
    let turn = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    (0..n)
        .map(|i| {
            let z = 1.0 - (2.0 * i as f64 + 1.0) / n as f64;
            let r = (1.0 - z * z).sqrt();
            dvec3(r * (turn * i as f64).cos(), r * (turn * i as f64).sin(), z)
        })
        .collect()
}

pub fn point_bytes(points: &[DVec3]) -> Vec<u8> {
    points.iter().flat_map(|p| p.to_array()).flat_map(f64::to_le_bytes).collect()
}

pub fn facet_bytes(facets: &[[u32; 3]]) -> Vec<u8> {
    facets.iter().flatten().flat_map(|v| v.to_le_bytes()).collect()
}

pub fn chunk(kind: ArrayKind, offset: u64, data: &[u8]) -> Chunk {
    let crc32c = crc32c::crc32c(data);
    Chunk { kind: kind.into(), offset, data: data.to_vec().into(), crc32c, ..Chunk::default() }
}

/// An array in chunks of an awkward size.
pub fn chunks(kind: ArrayKind, data: &[u8]) -> Vec<Chunk> {
    const SIZE: usize = 100_003;
    data.chunks(SIZE).enumerate().map(|(i, part)| chunk(kind, (i * SIZE) as u64, part)).collect()
}

pub fn mesh_header(points: &[DVec3], facets: &[[u32; 3]]) -> MeshHeader {
    MeshHeader {
        vertices: points.len() as u64,
        facets: facets.len() as u64,
        position_type: PositionType::F64.into(),
        ..MeshHeader::default()
    }
}

/// What every upload holds.
pub fn all_chunks(points: &[DVec3], facets: &[[u32; 3]], seeds: &[DVec3]) -> Vec<Chunk> {
    let mut all = chunks(ArrayKind::Positions, &point_bytes(points));
    all.extend(chunks(ArrayKind::Facets, &facet_bytes(facets)));
    all.extend(chunks(ArrayKind::Seeds, &point_bytes(seeds)));
    all
}

/// A whole Remesh request; `arrays` are what it has beside mesh and seeds.
pub fn remesh_request(
    header: RemeshHeader,
    points: &[DVec3],
    facets: &[[u32; 3]],
    seeds: &[DVec3],
    arrays: Vec<Chunk>,
) -> Vec<RemeshRequest> {
    use remesh_request::Message;
    let mut all = vec![Message::Header(header)];
    all.extend(all_chunks(points, facets, seeds).into_iter().chain(arrays).map(Message::Chunk));
    all.push(Message::Finish(Finish {}));
    all.into_iter().map(|message| RemeshRequest { message: Some(message) }).collect()
}

pub fn rvd_message(message: compute_rvd_request::Message) -> ComputeRvdRequest {
    ComputeRvdRequest { message: Some(message) }
}

/// A whole ComputeRvd request.
pub fn rvd_request(
    points: &[DVec3],
    facets: &[[u32; 3]],
    seeds: &[DVec3],
    backend: BackendChoice,
    outputs: &[RvdOutput],
) -> Vec<ComputeRvdRequest> {
    let header = ComputeRvdHeader {
        mesh: Some(mesh_header(points, facets)),
        seeds: seeds.len() as u64,
        backend: backend.into(),
        options: Some(DiagramOptions { outputs: outputs.iter().map(|&o| o.into()).collect(), ..Default::default() }),
    };
    let mut all = vec![rvd_message(compute_rvd_request::Message::Header(header))];
    all.extend(
        all_chunks(points, facets, seeds).into_iter().map(|c| rvd_message(compute_rvd_request::Message::Chunk(c))),
    );
    all.push(rvd_message(compute_rvd_request::Message::Finish(Finish {})));
    all
}

/// A small ComputeRvd request.
pub fn small_rvd(backend: BackendChoice) -> Vec<ComputeRvdRequest> {
    let (points, facets) = octahedron();
    rvd_request(&points, &facets, &spiral(20), backend, &[RvdOutput::Cells, RvdOutput::Centroids, RvdOutput::Sums])
}

/// Sends everything and reads to the end.
pub async fn ask_rvd(
    client: &mut Client,
    requests: Vec<ComputeRvdRequest>,
) -> Result<Vec<compute_rvd_response::Message>, tonic::Status> {
    let mut answers = client.compute_rvd(tokio_stream::iter(requests)).await?.into_inner();
    let mut all = Vec::new();
    while let Some(answer) = answers.message().await? {
        all.push(answer.message.expect("no empty answers"));
    }
    Ok(all)
}

/// The whole of an array, checked.
pub fn gather(chunks: &[Chunk], kind: ArrayKind) -> Vec<u8> {
    let mut data = Vec::new();
    let mut total = 0;
    for chunk in chunks.iter().filter(|c| c.kind == i32::from(kind)) {
        assert_eq!(chunk.offset as usize, data.len());
        assert_eq!(crc32c::crc32c(&chunk.data), chunk.crc32c);
        data.extend_from_slice(&chunk.data);
        total = chunk.total_bytes;
    }
    assert_eq!(total as usize, data.len(), "{kind:?} is whole");
    data
}

pub fn f64s(data: &[u8]) -> Vec<f64> {
    data.as_chunks::<8>().0.iter().map(|b| f64::from_le_bytes(*b)).collect()
}

pub fn u32s(data: &[u8]) -> Vec<u32> {
    data.as_chunks::<4>().0.iter().map(|b| u32::from_le_bytes(*b)).collect()
}

pub fn points_of(data: &[u8]) -> Vec<DVec3> {
    f64s(data).as_chunks::<3>().0.iter().map(|p| DVec3::from_array(*p)).collect()
}
