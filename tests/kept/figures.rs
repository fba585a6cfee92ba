//! What sharing and keeping cost: programs that print JSON, for docs/performance.md. Nothing here is asserted about time.

use std::ops::Range;
use std::path::PathBuf;
use std::sync::{Arc, mpsc};
use std::time::{Duration, Instant};

use glam::DVec3;
use jobs::{Admission, Retry};
use jobs::{AdmissionRequest, Backends, Engine, EngineOptions, JobError};
use serde_json::json;
use tessera::mesh::io;
use tessera::mesh::shapes::Shape;
use tessera::proto::*;
use tessera::rvd::{
    Backend, BackendKind, CellSums, Parallel, PassStats, PieceBatch, RvdError, Serial, Session, SessionOptions, Surface,
};
use tessera::token::Token;

use super::program::*;
use super::sharing::cancels;

const LIMIT: Duration = Duration::from_secs(600);

/// A real mesh, as a PLY file.
fn real(name: &str) -> Option<Vec<u8>> {
    let folder = PathBuf::from(std::env::var_os("TESSERA_MESHES")?);
    let mesh = io::read(&folder.join(name)).ok()?;
    io::encode(io::Format::Ply, &mesh).ok()
}

fn quantile(times: &mut [Duration], part: f64) -> f64 {
    times.sort_unstable();
    let last = times.len().saturating_sub(1);
    times.get((last as f64 * part).round() as usize).map_or(0.0, |time| time.as_secs_f64() * 1e3)
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "a program that prints figures"]
async fn figures_of_throughput() {
    let Some(mesh) = real("fandisk.obj") else { return println!("TESSERA_MESHES is not set: NOTHING MEASURED") };
    let mut seconds = Vec::new();
    for (at_once, clients) in [("1", 1), ("1", 8), ("2", 8), ("3", 8)] {
        let folder = tempfile::tempdir().unwrap();
        let program = Program::start(folder.path(), &["--jobs-at-once", at_once]);
        let mut client = program.client().await.of("all");
        let digest = client.put(&mesh).await;
        let warm = client.submit(remesh(&digest, 500, 99)).await;
        client.end(&warm, LIMIT).await;
        let begin = Instant::now();
        let mut tasks = Vec::new();
        for who in 0..clients {
            let (mut client, digest) = (client.clone(), digest.clone());
            tasks.push(tokio::spawn(async move {
                for job in 0..32 / clients {
                    let id = client.submit(remesh(&digest, 3_000, who * 100 + job)).await;
                    client.end(&id, LIMIT).await;
                }
            }));
        }
        for task in tasks {
            task.await.unwrap();
        }
        seconds.push(json!({ "jobs_at_once": at_once, "clients": clients, "seconds": begin.elapsed().as_secs_f64() }));
    }
    println!("{}", json!({ "jobs": "32 x fandisk/3,000", "runs": seconds }));
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "a program that prints figures"]
async fn figures_of_a_flood() {
    let (Some(huge), Some(tiny)) = (real("nefertiti.obj"), real("fandisk.obj")) else {
        return println!("TESSERA_MESHES is not set: NOTHING MEASURED");
    };
    let folder = tempfile::tempdir().unwrap();
    let program = Program::start(folder.path(), &[]);
    let client = program.client().await;
    let (mut flood, mut other) = (client.of("flood"), client.of("other"));
    let (huge, tiny) = (flood.put(&huge).await, other.put(&tiny).await);
    let mut alone = Vec::new();
    for i in 0..6 {
        let begin = Instant::now();
        let id = other.submit(remesh(&tiny, 1_000, i)).await;
        other.end(&id, LIMIT).await;
        alone.push(begin.elapsed());
    }
    for i in 0..30 {
        flood.submit(remesh(&huge, 50_000, i)).await;
    }
    tokio::time::sleep(Duration::from_secs(2)).await;
    let mut beside = Vec::new();
    for i in 0..6 {
        let begin = Instant::now();
        let id = other.submit(remesh(&tiny, 1_000, 10 + i)).await;
        other.end(&id, LIMIT).await;
        beside.push(begin.elapsed());
    }
    let (alone, beside) = (quantile(&mut alone, 0.5), quantile(&mut beside, 0.5));
    println!("{}", json!({ "fandisk_1000_alone_ms": alone, "beside_a_flood_ms": beside, "ratio": beside / alone }));
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "a program that prints figures"]
async fn figures_of_ten_thousand_jobs() {
    let folder = tempfile::tempdir().unwrap();
    let mut program = Program::start(folder.path(), &["--jobs-at-once", "1"]);
    let mut client = program.client().await;
    let digest = client.put_mesh(&Shape::Genus(3).build(4_000)).await;
    // One that keeps the only slot, and always the same memory.
    let step = CvtStep { iterations: 9_900, ..CvtStep::default() };
    let commands = vec![CvtJobCommand { command: Some(cvt_job_command::Command::Step(step)) }];
    let options = Some(CvtOptions { points: Some(2_000), ..CvtOptions::default() });
    let mut spec = remesh(&digest, 1, 0);
    spec.work = Some(job_spec::Work::Cvt(CvtJob { options, commands }));
    let long = client.submit(spec).await;
    let small = client.put_mesh(&Shape::Torus.build(200)).await;
    tokio::time::sleep(Duration::from_secs(1)).await;
    let (before, ..) = program.held();
    let begin = Instant::now();
    let mut tasks = Vec::new();
    for who in 0..64 {
        let (mut client, small) = (client.clone(), small.clone());
        tasks.push(tokio::spawn(async move {
            for job in (who..10_000).step_by(64) {
                client.submit(remesh(&small, 20, job)).await;
            }
        }));
    }
    for task in tasks {
        task.await.unwrap();
    }
    let created = begin.elapsed();
    let (after, ..) = program.held();
    let mut pages = Vec::new();
    for _ in 0..50 {
        let begin = Instant::now();
        let page =
            client.jobs.list_jobs(ListJobsRequest { page_size: 100, ..ListJobsRequest::default() }).await.unwrap();
        assert_eq!(page.into_inner().jobs.len(), 100);
        pages.push(begin.elapsed());
    }
    let running = client.get(&long).await.state();
    program.kill();
    let begin = Instant::now();
    let program = Program::start(folder.path(), &["--jobs-at-once", "1"]);
    let mut client = program.client().await;
    client.get(&long).await;
    let started = begin.elapsed();
    println!(
        "{}",
        json!({
            "creates_a_second": 10_000.0 / created.as_secs_f64(),
            "list_page_ms": quantile(&mut pages, 0.99),
            "memory_a_job_bytes": (after.saturating_sub(before)) / 10_000,
            "start_after_kill_s": started.as_secs_f64(),
            "the_long_one_still_ran": running == JobState::Running,
        })
    );
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "a program that prints figures"]
async fn figures_of_cancels() {
    let folder = tempfile::tempdir().unwrap();
    let program = Program::start(folder.path(), &["--jobs-at-once", "1"]);
    cancels(&program, 5).await;
    let before = program.held();
    let mut times = cancels(&program, 1000).await;
    tokio::time::sleep(Duration::from_secs(12)).await;
    let after = program.held();
    println!(
        "{}",
        json!({
            "cancels": times.len(),
            "p50_ms": quantile(&mut times, 0.5),
            "p99_ms": quantile(&mut times, 0.99),
            "max_ms": quantile(&mut times, 1.0),
            "memory_descriptors_threads": [before, after],
        })
    );
}

/// A device whose passes take so long, whatever they do.
struct Slow(Duration);

struct SlowSession(Duration, Box<dyn Session>);

impl Backend for Slow {
    fn kind(&self) -> BackendKind {
        BackendKind::Gpu
    }
    fn threads(&self) -> usize {
        1
    }
    fn session(&self, surface: Arc<Surface>, options: SessionOptions) -> Result<Box<dyn Session>, RvdError> {
        Ok(Box::new(SlowSession(self.0, Serial.session(surface, options)?)))
    }
}

impl Session for SlowSession {
    fn set_seeds(&mut self, seeds: &[DVec3]) -> Result<(), RvdError> {
        self.1.set_seeds(seeds)
    }
    fn sums(&mut self, out: &mut CellSums, token: &Token) -> Result<PassStats, RvdError> {
        std::thread::sleep(self.0);
        self.1.sums(out, token)
    }
    fn pieces(&mut self, facets: Range<u32>, out: &mut PieceBatch, token: &Token) -> Result<PassStats, RvdError> {
        self.1.pieces(facets, out, token)
    }
}

type Command = Box<dyn FnOnce() + Send>;

/// The other way to share: every call goes to the device's own thread and waits for its answer.
struct Proxy(Arc<dyn Backend>, mpsc::Sender<Command>);

struct ProxySession(Option<Box<dyn Session>>, mpsc::Sender<Command>);

fn on_device<R: Send + 'static>(device: &mpsc::Sender<Command>, work: impl FnOnce() -> R + Send + 'static) -> R {
    let (reply, answer) = mpsc::sync_channel(1);
    device.send(Box::new(move || drop(reply.send(work())))).unwrap();
    answer.recv().unwrap()
}

impl Backend for Proxy {
    fn kind(&self) -> BackendKind {
        BackendKind::Serial
    }
    fn threads(&self) -> usize {
        1
    }
    fn session(&self, surface: Arc<Surface>, options: SessionOptions) -> Result<Box<dyn Session>, RvdError> {
        let device = Arc::clone(&self.0);
        let session = on_device(&self.1, move || device.session(surface, options))?;
        Ok(Box::new(ProxySession(Some(session), self.1.clone())))
    }
}

impl Session for ProxySession {
    fn set_seeds(&mut self, seeds: &[DVec3]) -> Result<(), RvdError> {
        self.0.as_mut().unwrap().set_seeds(seeds)
    }
    fn sums(&mut self, out: &mut CellSums, token: &Token) -> Result<PassStats, RvdError> {
        let (mut session, mut sums, token) = (self.0.take().unwrap(), std::mem::take(out), token.clone());
        let (session, sums, stats) = on_device(&self.1, move || {
            let stats = session.sums(&mut sums, &token);
            (session, sums, stats)
        });
        (self.0, *out) = (Some(session), sums);
        stats
    }
    fn pieces(&mut self, facets: Range<u32>, out: &mut PieceBatch, token: &Token) -> Result<PassStats, RvdError> {
        self.0.as_mut().unwrap().pieces(facets, out, token)
    }
}

/// Passes of a job, and how long each takes on the device and between two on the host.
const PASSES: u32 = 10;
const STAGE: Duration = Duration::from_millis(20);

fn job(backend: &dyn Backend, token: &Token) -> Result<(), JobError> {
    let mesh = Shape::Sphere.build(100);
    let surface = Arc::new(Surface::new(&mesh, None)?);
    let mut session = backend.session(surface, SessionOptions::new(1))?;
    session.set_seeds(&[DVec3::X])?;
    let mut sums = CellSums::default();
    for _ in 0..PASSES {
        session.sums(&mut sums, token)?;
        // The host works: no sleep.
        let begin = Instant::now();
        while begin.elapsed() < STAGE {
            std::hint::spin_loop();
        }
    }
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "a program that prints figures"]
async fn figures_of_a_shared_device() {
    let mut runs = Vec::new();
    for (way, at_once) in [("gate", 1), ("gate", 2), ("gate", 3), ("proxy", 2), ("proxy", 3)] {
        let (device, commands) = mpsc::channel::<Command>();
        let thread = std::thread::spawn(move || commands.into_iter().for_each(|command| command()));
        let proxy: Arc<dyn Backend> = Arc::new(Proxy(Arc::new(Slow(STAGE)), device));
        let factory = move || -> Result<Backends, JobError> {
            Ok(Backends {
                gpu: Ok(Arc::new(Slow(STAGE))),
                parallel: Arc::new(Parallel::new(Some(2))?),
                serial: proxy.clone(),
                default: tessera::BackendChoice::Auto,
                pools: None,
            })
        };
        let options = EngineOptions { jobs_at_once: at_once, ..EngineOptions::default() };
        let (engine, worker) = Engine::start(factory, options).unwrap();
        let begin = Instant::now();
        let mut all: Vec<_> = (0..8)
            .map(|_| {
                let submitted =
                    engine.submit(Admission::New(AdmissionRequest::default()), Retry::Never, move |backends, turn| {
                        let kind = if way == "gate" { BackendKind::Gpu } else { BackendKind::Serial };
                        job(backends.choose(tessera::BackendChoice::Only(kind))?.as_ref(), &turn.token)
                    });
                submitted.unwrap()
            })
            .collect();
        for pending in &mut all {
            pending.wait().await.unwrap();
        }
        runs.push(json!({ "way": way, "jobs_at_once": at_once, "seconds": begin.elapsed().as_secs_f64() }));
        engine.close();
        worker.join().unwrap();
        drop(all);
        drop(engine);
        thread.join().unwrap();
    }
    println!("{}", json!({ "jobs": 8, "passes": PASSES, "stage_ms": STAGE.as_millis() as u64, "runs": runs }));
}
