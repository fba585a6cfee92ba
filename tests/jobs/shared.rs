//! Promise: servers on one database and one bucket are one service: each job is done once, any server answers for it, and a job
//! whose server went away is done by another.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use futures_util::{StreamExt, TryStreamExt};
use jobs::blob::{BlobOptions, BlobStore, Digest, ObjectBlobs, put, put_of};
use jobs::executor::api::{JobApi, JobApiError, Reuse};
use jobs::postgres::PostgresStore;
use jobs::record::state::State;
use jobs::record::{Change, Job, JobId, Outcome, Spec};
use jobs::store::{JobStore, StoreError, result_pin};
use jobs::{Admission, AdmissionRequest, Engine, EngineOptions, Executor, ExecutorOptions, Pending, Retry, Stores};
use needs::needs;
use object_store::ObjectStoreExt;
use object_store::memory::InMemory;
use tessera::mesh::io::{self, Format};
use tessera::mesh::shapes::Shape;
use tessera::proto::*;
use tokio::runtime::Runtime;
use wire::counts::Bounds;

use crate::outage::backends;
use crate::postgres_server::{self as server, Database};

const TENANT: &str = "t";
/// For anything that a test waits for.
pub const PATIENCE: Duration = Duration::from_secs(120);
const LEASE: Duration = Duration::from_secs(1);
/// A job of a few seconds.
const LONG: (usize, u32) = (40_000, 20_000);

/// What makes the backends of a server.
pub type Factory = fn() -> Result<jobs::Backends, jobs::JobError>;

/// A server without its ports.
pub struct Node {
    pub executor: Executor,
    engine: Engine,
    stores: Stores,
    _thread: JoinHandle<()>,
}

pub fn options() -> ExecutorOptions {
    ExecutorOptions { lease: LEASE, ..ExecutorOptions::new(Bounds::of_library()) }
}

impl Node {
    async fn start(stores: Stores, options: ExecutorOptions) -> Self {
        Self::with(stores, options, backends).await
    }

    /// With these backends, one job at once.
    async fn with(stores: Stores, options: ExecutorOptions, factory: Factory) -> Self {
        let engine_options = EngineOptions { jobs_at_once: 1, ..EngineOptions::default() };
        let (engine, thread) = Engine::start(factory, engine_options).unwrap();
        let executor = Executor::start(engine.clone(), stores.clone(), options).await.unwrap();
        Self { executor, engine, stores, _thread: thread }
    }

    pub async fn shared(name: &str, database: &Database, bucket: &Arc<InMemory>, options: ExecutorOptions) -> Self {
        Self::shared_with(name, (database, bucket), options, backends).await
    }

    pub async fn shared_with(
        name: &str,
        (database, bucket): (&Database, &Arc<InMemory>),
        options: ExecutorOptions,
        factory: Factory,
    ) -> Self {
        let store = PostgresStore::open(database.options(name)).await.unwrap();
        let blobs = ObjectBlobs::shared_with(store.index(), Arc::clone(bucket), BlobOptions::default());
        let blobs = Arc::new(blobs.await.unwrap());
        Self::with(Stores { jobs: Arc::new(store), blobs }, options, factory).await
    }

    /// Takes its one place until what this gives is dropped.
    fn occupy(&self) -> Pending<()> {
        let request = Admission::New(AdmissionRequest::default());
        let endless = |_: &jobs::Backends, context: &jobs::WorkContext| loop {
            context.token.check()?;
            std::thread::sleep(Duration::from_millis(2));
        };
        self.engine.submit(request, Retry::Never, endless).unwrap()
    }

    pub async fn create(&self, size: (usize, u32)) -> JobId {
        let mesh = io::encode(Format::Ply, &Shape::Torus.build(size.0)).unwrap();
        let digest = put_of(&*self.stores.blobs, TENANT, None, mesh.into()).await.unwrap().digest.to_string();
        let file = MeshFile { digest, format: MeshFormat::Ply.into(), attributes: None };
        let spec = JobSpec {
            mesh: Some(JobMesh { source: Some(job_mesh::Source::File(file)) }),
            work: Some(job_spec::Work::Remesh(RemeshOptions { points: Some(size.1), ..Default::default() })),
            ..JobSpec::default()
        };
        let spec = Spec::new(spec, TENANT.to_owned(), String::new()).unwrap();
        self.executor.create(spec, Reuse::Never).await.unwrap().job.id
    }

    pub async fn get(&self, id: JobId) -> Job {
        self.executor.get(TENANT, id).await.unwrap()
    }

    pub async fn until(&self, id: JobId, is_so: impl Fn(&Job) -> bool) -> Job {
        let end = Instant::now() + PATIENCE;
        loop {
            let job = self.get(id).await;
            if is_so(&job) {
                return job;
            }
            assert!(Instant::now() < end, "{:?}", job.status);
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    }

    pub async fn ended(&self, id: JobId) -> Job {
        self.until(id, |job| job.status.state.is_ended()).await
    }

    pub async fn at_work(&self, id: JobId, at: &str) -> Job {
        self.until(id, |job| job.status.holder.as_ref().is_some_and(|holder| holder.name == at)).await
    }

    /// Waits until the engine has nothing more to do.
    async fn idle(&self) {
        let end = Instant::now() + PATIENCE;
        while self.engine.load() != (0, false) {
            assert!(Instant::now() < end, "work goes on");
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    }
}

/// The digest of the surface that a job gave.
fn surface(job: &Job) -> Digest {
    let Some(Outcome::Succeeded(result)) = &job.status.outcome else { panic!("{:?}", job.status) };
    *result.blobs.iter().find(|(name, _)| name.starts_with("mesh")).unwrap().1
}

pub fn runtime() -> Runtime {
    tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap()
}

#[needs(postgres)]
#[test]
fn jobs_of_two_servers_are_done_once_with_the_results_of_one() {
    const JOBS: u32 = 30;
    let (database, bucket) = (server::database(), Arc::new(InMemory::new()));
    runtime().block_on(async {
        let alone = Node::start(Stores::ephemeral(BlobOptions::default()), options()).await;
        let [a, b] = [
            Node::shared("a", &database, &bucket, options()).await,
            Node::shared("b", &database, &bucket, options()).await,
        ];
        let (mut expected, mut created) = (Vec::new(), Vec::new());
        for number in 0..JOBS {
            let size = (200, 40 + number);
            expected.push(alone.create(size).await);
            created.push(if number % 2 == 0 { a.create(size).await } else { b.create(size).await });
        }
        for (expected, id) in expected.into_iter().zip(&created) {
            let (one, shared) = (alone.ended(expected).await, b.ended(*id).await);
            assert_eq!(surface(&shared), surface(&one));
            assert_eq!((shared.status.attempts, shared.status.crashes), (1, 0));
        }
        assert_eq!(database.sql("select count(*) from tessera.leases"), "0");
        for node in [&a, &b] {
            node.executor.drain().await;
        }
    });
}

#[needs(postgres)]
#[test]
fn a_job_is_watched_and_fetched_at_another_server() {
    let (database, bucket) = (server::database(), Arc::new(InMemory::new()));
    runtime().block_on(async {
        let a = Node::shared("a", &database, &bucket, options()).await;
        let b = Node::shared("b", &database, &bucket, options()).await;
        let busy = b.occupy();
        let id = a.create((200, 50)).await;
        let (mut last, end) = (0, Instant::now() + PATIENCE);
        while !b.get(id).await.status.state.is_ended() {
            assert!(Instant::now() < end);
            b.executor.wait(TENANT, id, last).await.unwrap();
            let events = b.executor.events(TENANT, id, last, 100).await.unwrap().events;
            last = events.last().map_or(last, |event| event.number);
        }
        let digest = surface(&b.get(id).await);
        let read = b.stores.blobs.read(digest, 0..u64::MAX).await.unwrap();
        let bytes: Vec<u8> = read.bytes.map_ok(|bytes| bytes.to_vec()).boxed().try_concat().await.unwrap();
        assert_eq!(Digest::of(&bytes), digest);
        drop(busy);
    });
}

#[needs(postgres)]
#[test]
fn a_job_that_is_cancelled_at_another_server_stops() {
    let (database, bucket) = (server::database(), Arc::new(InMemory::new()));
    runtime().block_on(async {
        let a = Node::shared("a", &database, &bucket, options()).await;
        let b = Node::shared("b", &database, &bucket, options()).await;
        let busy = b.occupy();
        let id = a.create(LONG).await;
        b.at_work(id, "a").await;
        b.executor.cancel(TENANT, id).await.unwrap();
        let begin = Instant::now();
        a.idle().await;
        assert!(begin.elapsed() < Duration::from_secs(20), "{:?}", begin.elapsed());
        assert_eq!(a.get(id).await.status.state, State::Cancelled);
        assert_eq!(a.stores.blobs.usage().await.unwrap().pinned_bytes, 0);
        drop(busy);
    });
}

#[needs(postgres)]
#[test]
fn a_job_whose_lease_is_over_is_done_by_another_server() {
    let (database, bucket) = (server::database(), Arc::new(InMemory::new()));
    runtime().block_on(async {
        // Its work never counts as advancing, so that nothing renews its leases.
        let still = ExecutorOptions { silence: Duration::ZERO, ..options() };
        let a = Node::shared("a", &database, &bucket, still).await;
        let b = Node::shared("b", &database, &bucket, options()).await;
        let busy = b.occupy();
        let id = a.create(LONG).await;
        let first = b.at_work(id, "a").await;
        drop(busy);
        let second = b.at_work(id, "b").await;
        assert_eq!((second.status.attempts, second.status.crashes), (2, 1));
        // The first server's end comes late.
        let late = a.stores.jobs.change(id, first.status.version, Change::Succeed(Default::default())).await;
        assert!(matches!(late, Err(StoreError::Stale { .. })), "{late:?}");
        a.idle().await;
        let done = b.ended(id).await;
        assert_eq!((done.status.attempts, done.status.crashes), (2, 1));
        surface(&done);
        assert!(b.stores.blobs.usage().await.unwrap().pinned_bytes > 0, "the result stays");
    });
}

/// As a server that was stopped (SIGSTOP) for longer than its lease leaves it: it stores and pins after another has done the job.
#[needs(postgres)]
#[test]
fn what_a_server_stores_for_a_job_that_it_lost_is_collected() {
    let (database, bucket) = (server::database(), Arc::new(InMemory::new()));
    runtime().block_on(async {
        let a = Node::shared("a", &database, &bucket, options()).await;
        let b = Node::shared("b", &database, &bucket, options()).await;
        let soon = BlobOptions { keep_unneeded: Duration::ZERO, ..BlobOptions::default() };
        let sweeping = ObjectBlobs::shared_with(b.stores.jobs.index(), Arc::clone(&bucket), soon).await.unwrap();
        let pinned = |id: JobId| {
            let names = format!("select count(*) from tessera.pins where name = '{}'", result_pin(id));
            database.sql(&names).parse::<usize>().unwrap()
        };
        let late = |id: JobId, what: &'static str| {
            let blobs = Arc::clone(&a.stores.blobs);
            async move { put(&*blobs, what.into(), Some(&result_pin(id))).await.unwrap().digest }
        };
        // One that another server has done.
        let done = a.create((200, 50)).await;
        let job = a.ended(done).await;
        let Some(Outcome::Succeeded(result)) = &job.status.outcome else { panic!("{:?}", job.status) };
        let count = result.blobs.len();
        let mut lost = vec![late(done, "another result").await];
        assert_eq!(pinned(done), count + 1);
        // One that was cancelled, one that is no more, one that waits.
        let busy = [a.occupy(), b.occupy()];
        let [cancelled, deleted, waiting] = [a.create(LONG).await, a.create(LONG).await, a.create(LONG).await];
        for id in [cancelled, deleted] {
            a.executor.cancel(TENANT, id).await.unwrap();
        }
        a.stores.jobs.delete(deleted).await.unwrap();
        lost.push(late(cancelled, "of a cancelled job").await);
        lost.push(late(deleted, "of a deleted job").await);
        lost.push(late(waiting, "of a job that waits").await);
        sweeping.sweep().await.unwrap();
        assert_eq!([done, cancelled, deleted, waiting].map(pinned), [count, 0, 0, 0]);
        for digest in lost {
            let path = format!("blobs/{}/{digest}", &digest.to_string()[..2]).into();
            assert!(bucket.head(&path).await.is_err(), "its object is still there");
        }
        // A job at work keeps what is pinned for it.
        drop(busy);
        let running = b.until(waiting, |job| job.status.holder.is_some()).await.id;
        late(running, "of the server at work, as far as anybody knows").await;
        sweeping.sweep().await.unwrap();
        assert_eq!(pinned(running), 1);
        for digest in result.blobs.values() {
            read(&*b.stores.blobs, *digest).await;
        }
        for node in [&a, &b] {
            node.executor.cancel(TENANT, running).await.unwrap();
            node.idle().await;
        }
    });
}

/// All bytes of a blob.
async fn read(blobs: &dyn BlobStore, digest: Digest) -> Vec<bytes::Bytes> {
    blobs.read(digest, 0..u64::MAX).await.unwrap().bytes.try_collect().await.unwrap()
}

#[needs(postgres)]
#[test]
fn a_drained_server_gives_its_work_back() {
    let (database, bucket) = (server::database(), Arc::new(InMemory::new()));
    runtime().block_on(async {
        let a = Node::shared("a", &database, &bucket, options()).await;
        let b = Node::shared("b", &database, &bucket, options()).await;
        let busy = b.occupy();
        let ids = [a.create(LONG).await, a.create((200, 50)).await];
        b.at_work(ids[0], "a").await;
        let draining = async {
            tokio::time::sleep(Duration::from_millis(50)).await;
            a.engine.cancel_all();
        };
        tokio::join!(a.executor.drain(), draining);
        assert_eq!(database.sql("select count(*) from tessera.leases"), "0");
        drop(busy);
        let states: BTreeSet<_> = [b.ended(ids[0]).await, b.ended(ids[1]).await].map(|job| job.status.crashes).into();
        assert_eq!(states, BTreeSet::from([0]));
    });
}

#[needs(postgres)]
#[test]
fn too_many_waiting_jobs_are_refused_and_a_database_that_is_away_is_said_soon() {
    let (database, bucket) = (server::database_apart(), Arc::new(InMemory::new()));
    runtime().block_on(async {
        let few = ExecutorOptions { waiting_jobs: 2, ..options() };
        let a = Node::shared("a", &database, &bucket, few).await;
        let busy = a.occupy();
        let first = a.create((200, 50)).await;
        let spec = a.get(first).await.spec;
        let mut refused = None;
        for _ in 0..4 {
            refused = a.executor.create(spec.clone(), Reuse::Never).await.err().or(refused);
        }
        assert!(matches!(&refused, Some(JobApiError::Job(jobs::JobError::QueueFull { .. }))), "{refused:?}");
        database.cluster.stop_immediate();
        tokio::time::sleep(Duration::from_millis(1500)).await;
        let begin = Instant::now();
        let away = a.executor.create(spec, Reuse::Never).await.unwrap_err();
        assert!(matches!(away, JobApiError::Store(StoreError::Unavailable { .. })), "{away}");
        assert!(begin.elapsed() < Duration::from_secs(10), "{:?}", begin.elapsed());
        database.cluster.start();
        drop(busy);
        a.ended(first).await;
    });
}
