//! Promise: work goes on while the database is away, and its end is kept once it is back.

use std::sync::Arc;
use std::time::{Duration, Instant};

use jobs::blob::{BlobOptions, ObjectBlobs, put_of};
use jobs::executor::api::{JobApi, Reuse};
use jobs::postgres::{PostgresOptions, PostgresStore};
use jobs::record::Spec;
use jobs::record::state::State;
use jobs::store::JobStore;
use jobs::{Backends, Engine, EngineOptions, Executor, ExecutorOptions, JobError, Stores};
use needs::needs;
use tessera::BackendChoice;
use tessera::mesh::io::{self, Format};
use tessera::mesh::shapes::Shape;
use tessera::proto::*;
use tessera::rvd::{Backend, Parallel, Serial};
use wire::counts::Bounds;

use crate::postgres_server as server;

pub fn backends() -> Result<Backends, JobError> {
    Ok(Backends {
        gpu: Err("none".to_owned()),
        parallel: Arc::new(Parallel::new(Some(1))?) as Arc<dyn Backend>,
        serial: Arc::new(Serial),
        default: BackendChoice::Auto,
        pools: None,
    })
}

#[needs(postgres)]
#[test]
fn a_job_outlives_an_outage_of_the_database() {
    let database = server::database_apart();
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    let (engine, _thread) = Engine::start(backends, EngineOptions::default()).unwrap();
    runtime.block_on(async {
        let store = Arc::new(PostgresStore::open(PostgresOptions::new(database.url(), "one")).await.unwrap());
        let blobs = Arc::new(ObjectBlobs::in_memory_with(store.index(), BlobOptions::default()));
        let jobs: Arc<dyn JobStore> = store;
        let stores = Stores { jobs: Arc::clone(&jobs), blobs };
        let executor =
            Executor::start(engine, stores.clone(), ExecutorOptions::new(Bounds::of_library())).await.unwrap();
        let mesh = io::encode(Format::Ply, &Shape::Torus.build(4000)).unwrap();
        let digest = put_of(&*stores.blobs, "t", None, mesh.into()).await.unwrap().digest.to_string();
        let file = MeshFile { digest, format: MeshFormat::Ply.into(), attributes: None };
        let spec = JobSpec {
            mesh: Some(JobMesh { source: Some(job_mesh::Source::File(file)) }),
            work: Some(job_spec::Work::Remesh(RemeshOptions { points: Some(3000), ..Default::default() })),
            ..JobSpec::default()
        };
        let spec = Spec::new(spec, "t".to_owned(), "r".to_owned()).unwrap();
        let id = executor.create(spec, Reuse::Never).await.unwrap().job.id;
        while jobs.get(id).await.unwrap().status.state == State::Queued {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        database.cluster.stop_immediate();
        tokio::time::sleep(Duration::from_secs(4)).await;
        database.cluster.start();
        let end = Instant::now() + Duration::from_secs(120);
        let job = loop {
            let job = jobs.get(id).await.unwrap();
            if job.status.state.is_ended() {
                break job;
            }
            assert!(Instant::now() < end, "{:?}", job.status);
            tokio::time::sleep(Duration::from_millis(50)).await;
        };
        assert_eq!((job.status.state, job.status.attempts), (State::Succeeded, 1), "{:?}", job.status);
        // The result is pinned, the input no longer.
        let usage = jobs.index().usage().await.unwrap();
        assert!(usage.pinned_bytes > 0 && usage.pinned_bytes < usage.blob_bytes, "{usage:?}");
    });
}
