//! Figures of many servers on one database: docs/scaling.md. Not a test: `cargo test --release --test jobs scaling -- --ignored`.
//!
//! Servers that only wait, each with a store of its own, claim and end jobs without doing them. The environment variables
//! `TESSERA_SCALING_NODES` and `TESSERA_SCALING_JOBS` set their numbers. The answer is JSON.

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use jobs::postgres::{PostgresOptions, PostgresStore};
use jobs::record::state::State;
use jobs::record::{Bytes, Change, Spec};
use jobs::store::shared::Node;
use jobs::store::*;
use needs::needs;
use serde_json::json;

use glam::DVec3;
use jobs::blob::BlobInfo;
use jobs::blob::index::Stored;
use jobs::executor::api::JobApi;
use jobs::{Backends, JobError};
use object_store::memory::InMemory;
use tessera::rvd::{
    Backend, BackendChoice, BackendKind, CellSums, PassStats, PieceBatch, Resident, RvdError, Serial, Session,
    SessionOptions, Surface,
};
use tessera::token::Token;

use crate::postgres_server::{self as server, Database};
use crate::{input, message, shared};

const LEASE: Duration = Duration::from_secs(60);
const ROOM: Bytes = Bytes { host: 1 << 30, device: 0 };
const TENANTS: usize = 10;
/// Jobs a second while most servers wait.
const CALM: u64 = 40;
const CALM_JOBS: usize = 400;

fn number(name: &str, usual: usize) -> usize {
    std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(usual)
}

/// A server that only waits.
async fn node(store: Arc<PostgresStore>, ended: Arc<AtomicUsize>, claims: Arc<AtomicU64>) {
    let holder = store.shared().unwrap().holder().to_owned();
    let mut work = store.shared().unwrap().work();
    let mut beat = Instant::now() - LEASE;
    loop {
        if beat.elapsed() > Duration::from_secs(4) {
            beat = Instant::now();
            let node = Node { name: holder.clone(), places: 1, memory: ROOM, ..Node::default() };
            let _ = store.shared().unwrap().beat(node).await;
        }
        if store.shared().unwrap().sweeps().await.unwrap_or(false) {
            let keep = Retention { results: Duration::from_secs(3600), records: Duration::from_secs(3600) };
            let _ = store.expire(keep, 1000).await;
        }
        work.mark_unchanged();
        claims.fetch_add(1, Ordering::Relaxed);
        match store.claim_next(Offer::new(holder.clone(), LEASE, ROOM)).await {
            Ok(Some(job)) => {
                store.change(job.id, job.status.version, Change::Succeed(Default::default())).await.unwrap();
                ended.fetch_add(1, Ordering::Relaxed);
            }
            _ => drop(tokio::time::timeout(Duration::from_secs(1), work.changed()).await),
        }
    }
}

async fn create(store: &PostgresStore, number: usize) {
    let spec = Spec::new(message(1), format!("tenant{}", number % TENANTS), format!("r{number}")).unwrap();
    let needs = Bytes { host: 1 << 20, device: 0 };
    let new = NewJob { random: number as u128, spec, needs, cost: Cost { seconds: 0.01, weight: 1.0 } };
    store.create(new).await.unwrap();
}

async fn until(ended: &AtomicUsize, jobs: usize) {
    while ended.load(Ordering::Relaxed) < jobs {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

fn figure(database: &Database, sql: &str) -> f64 {
    database.sql(sql).parse().unwrap()
}

#[needs(postgres)]
#[test]
#[ignore = "figures, not a test"]
fn scaling_figures() {
    let (nodes, jobs) = (number("TESSERA_SCALING_NODES", 100), number("TESSERA_SCALING_JOBS", 10_000));
    let database = server::database_apart();
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    let options = |holder: String, connections| PostgresOptions { connections, ..database.options(&holder) };
    runtime.block_on(async {
        let front = Arc::new(PostgresStore::open(options("front".to_owned(), 8)).await.unwrap());
        let blobs = vec![(BlobInfo { digest: input(), size_bytes: 1 }, 1)];
        front.index().enter(Stored { blobs, ..Stored::default() }).await.unwrap();
        let (ended, claims) = (Arc::<AtomicUsize>::default(), Arc::<AtomicU64>::default());
        for number in 0..nodes {
            let store = Arc::new(PostgresStore::open(options(format!("node {number}"), 1)).await.unwrap());
            tokio::spawn(node(store, Arc::clone(&ended), Arc::clone(&claims)));
        }
        // All have said that they are alive.
        tokio::time::sleep(Duration::from_secs(9)).await;
        let idle = claims.load(Ordering::Relaxed);
        tokio::time::sleep(Duration::from_secs(5)).await;
        let idle = (claims.load(Ordering::Relaxed) - idle) as f64 / 5.0;
        // Calm: nearly all servers wait.
        let before = claims.load(Ordering::Relaxed);
        for number in 0..CALM_JOBS {
            create(&front, number).await;
            tokio::time::sleep(Duration::from_millis(1000 / CALM)).await;
        }
        until(&ended, CALM_JOBS).await;
        let asked = (claims.load(Ordering::Relaxed) - before) as f64 / CALM_JOBS as f64;
        let wait = |part: f64| {
            let sql = format!(
                "select percentile_cont({part}) within group (order by (status::jsonb ->> 'started')::bigint - created) \
                 from tessera.jobs"
            );
            figure(&database, &sql)
        };
        let (p50, p99) = (wait(0.5), wait(0.99));
        // A flood.
        let wal = || figure(&database, "select pg_current_wal_lsn() - '0/0'");
        let (wal_before, begin) = (wal(), Instant::now());
        let creators: Vec<_> = (0..8)
            .map(|creator| {
                let front = Arc::clone(&front);
                tokio::spawn(async move {
                    for number in (creator..jobs).step_by(8) {
                        create(&front, CALM_JOBS + number).await;
                    }
                })
            })
            .collect();
        for creator in creators {
            creator.await.unwrap();
        }
        let created = begin.elapsed().as_secs_f64();
        until(&ended, CALM_JOBS + jobs).await;
        let done = begin.elapsed().as_secs_f64();
        let wal_bytes = (wal() - wal_before) / jobs as f64;
        tokio::time::sleep(Duration::from_secs(12)).await;
        let size = |table: &str| figure(&database, &format!("select pg_total_relation_size('tessera.{table}')"));
        let dead = figure(&database, "select coalesce(sum(n_dead_tup), 0) from pg_stat_user_tables");
        let vacuums = figure(&database, "select coalesce(sum(autovacuum_count), 0) from pg_stat_user_tables");
        let connections = figure(&database, "select count(*) from pg_stat_activity where datname = current_database()");
        let figures = json!({
            "nodes": nodes, "jobs": jobs, "tenants": TENANTS,
            "idle_claims_per_s": idle, "claims_per_calm_job": asked,
            "create_to_claim_ms": { "p50": p50, "p99": p99 },
            "creates_per_s": jobs as f64 / created, "jobs_per_s": jobs as f64 / done,
            "wal_bytes_per_job": wal_bytes, "connections": connections,
            "jobs_bytes_per_job": size("jobs") / (jobs + CALM_JOBS) as f64,
            "leases_bytes": size("leases"), "charges_bytes": size("charges"), "nodes_bytes": size("nodes"),
            "dead_rows": dead, "autovacuums": vacuums,
        });
        println!("{figures:#}");
    });
}

/// A device that takes its time and no host's: each pass waits, and then does its small work.
#[derive(Debug)]
struct Device;

const PASS: Duration = Duration::from_millis(5);

struct OnDevice(Box<dyn Session>);

impl Backend for Device {
    fn kind(&self) -> BackendKind {
        BackendKind::Serial
    }
    fn threads(&self) -> usize {
        1
    }
    fn session(&self, surface: Arc<Surface>, options: SessionOptions) -> Result<Box<dyn Session>, RvdError> {
        Ok(Box::new(OnDevice(Serial.session(surface, options)?)))
    }
}

impl Session for OnDevice {
    fn set_seeds(&mut self, seeds: &[DVec3]) -> Result<(), RvdError> {
        self.0.set_seeds(seeds)
    }
    fn sums(&mut self, out: &mut CellSums, token: &Token) -> Result<PassStats, RvdError> {
        std::thread::sleep(PASS);
        self.0.sums(out, token)
    }
    fn pieces(&mut self, facets: Range<u32>, out: &mut PieceBatch, token: &Token) -> Result<PassStats, RvdError> {
        std::thread::sleep(PASS);
        self.0.pieces(facets, out, token)
    }
    fn resident(&mut self) -> Option<&mut dyn Resident> {
        std::thread::sleep(PASS);
        self.0.resident()
    }
}

fn devices() -> Result<Backends, JobError> {
    let device: Arc<dyn Backend> = Arc::new(Device);
    let (parallel, serial) = (Arc::clone(&device), device);
    Ok(Backends { gpu: Err("none".to_owned()), parallel, serial, default: BackendChoice::Auto, pools: None })
}

/// Two servers beside one, whose devices do the work.
#[needs(postgres)]
#[test]
#[ignore = "figures, not a test"]
fn scaling_of_two_servers() {
    const JOBS: usize = 24;
    let time = |servers: usize| {
        let (database, bucket) = (server::database(), Arc::new(InMemory::new()));
        shared::runtime().block_on(async {
            let mut nodes = Vec::new();
            for name in ["a", "b"].into_iter().take(servers) {
                let node = shared::Node::shared_with(name, (&database, &bucket), shared::options(), devices);
                nodes.push(node.await);
            }
            let begin = Instant::now();
            let mut ids = Vec::new();
            for _ in 0..JOBS {
                ids.push(nodes[0].create((100, 40)).await);
            }
            for id in ids {
                let job = nodes[0].ended(id).await;
                assert_eq!(job.status.state, State::Succeeded, "{:?}", job.status);
            }
            let took = begin.elapsed().as_secs_f64();
            for node in &nodes {
                node.executor.drain().await;
            }
            took
        })
    };
    let (one, two) = (time(1), time(2));
    println!("{:#}", json!({ "jobs": JOBS, "one_server_s": one, "two_servers_s": two, "ratio": one / two }));
}
