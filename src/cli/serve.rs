//! `tessera serve`.
//!
//! Order: configuration checked, storage opened, backends made and warmed up, jobs queued, then the port. Each step has its
//! time. A server that listens works.

use std::convert::Infallible;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use glam::DVec3;
use tokio::net::TcpListener;
use tokio::task::JoinSet;

use super::exit::{BadTls, NoDevice, NotWritten, Stuck, Unavailable};
use super::{backends, interrupt};
use geometry::cvt::Projection;
use geometry::mesh::TriMesh;
use geometry::remesh::{RemeshOptions, Seeds, remesh};
use geometry::rvd::BackendChoice;
use geometry::token::Token;
use jobs::blob::BlobOptions;
use jobs::executor::api::{JobApi, JobApiError};
use jobs::executor::{DatabaseOptions, NodeOptions, host_name};
use jobs::memory;
use jobs::store::StoreError;
use jobs::{Backends, Ceilings, Engine, EngineOptions, Executor, ExecutorOptions, JobError, LossPolicy, Stores};
use server::admin::{self, Admin};
use server::config::BackendArg;
pub(crate) use server::config::{OnLoss, SecurityArgs, ServeArgs, ServeConfig};
use server::hosts::Hosts;
use server::http;
use server::lifecycle::{self, LifeCycle, Step, TooLong};
use server::metrics::Metrics;
use server::readiness::{Readiness, Reason};
use server::service::{self, About, Access, AccessOptions, Door, Jobs, Parts, ServeError};
use transport::Tls;

async fn stores(config: &ServeConfig) -> Result<Stores> {
    let (quota_bytes, reserve_bytes) = (config.blob_bytes, config.disk_reserve_bytes);
    let room = BlobOptions { quota_bytes, reserve_bytes, ..BlobOptions::default() };
    let Some(folder) = &config.data_dir else {
        tracing::info!("jobs and blobs are kept in memory and gone with the server");
        return Ok(Stores::ephemeral(room));
    };
    let cannot = |error| Unavailable(format!("cannot make {}: {error}; give another --data-dir", folder.display()));
    std::fs::create_dir_all(folder).map_err(cannot)?;
    let stores = match (&config.database, &config.bucket) {
        (Some((url, password)), Some(bucket)) => {
            let (node, may_lose) = (config.node.as_str(), config.store_may_lose);
            let database = DatabaseOptions { node, url, password: password.clone(), may_lose };
            Stores::in_database(database, bucket, room, (folder.join("cache"), config.cache_bytes)).await
        }
        (_, None) => Stores::in_folder(folder.clone(), room).await,
        (None, Some(url)) => Stores::in_bucket(folder.clone(), url, room).await,
    };
    let stores = stores.map_err(|error| unusable(config, &error))?;
    let (bucket, database) = (config.bucket.as_deref(), config.database.is_some());
    tracing::info!(folder = %folder.display(), bucket, database, "jobs and blobs are kept");
    Ok(stores)
}

/// Names of this server, and sites whose pages may use it.
fn hosts(args: &ServeArgs) -> Hosts {
    let SecurityArgs { public_host, cors_origin, .. } = &args.security;
    // The name that the listeners have may resolve to a loopback address too.
    let listened = [&args.http_listen, &args.watching.admin_listen].into_iter().flatten().chain([&args.listen]);
    let names = listened.filter_map(|place| place.rsplit_once(':')).map(|(host, _)| host.to_owned());
    let origins = cors_origin.iter().filter_map(|site| site.to_ascii_lowercase().try_into().ok()).collect();
    Hosts { names: public_host.iter().cloned().chain(names).collect(), origins }
}

async fn access(args: &ServeArgs, config: &ServeConfig, stores: &Stores) -> Result<Access> {
    let SecurityArgs { require_keys, reflection, health_needs_key, .. } = args.security;
    let hosts = hosts(args);
    let options = AccessOptions { require_keys, reflection, health_needs_key, hosts };
    match &config.data_dir {
        _ if config.database.is_some() => {
            let access = Access::in_store(Arc::clone(&stores.jobs), options).await;
            Ok(access.map_err(|error| Unavailable(error.to_string()))?)
        }
        Some(folder) => Ok(Access::in_folder(folder, options).map_err(|error| Unavailable(error.to_string()))?),
        None => Ok(Access::open().with(options)),
    }
}

fn unusable(config: &ServeConfig, error: &JobApiError) -> Unavailable {
    match (&config.data_dir, error) {
        // It names the folder, and what to do.
        (_, JobApiError::Store(StoreError::InUse { .. })) | (None, _) => Unavailable(error.to_string()),
        (_, JobApiError::Blob(error)) if config.bucket.is_some() => {
            let bucket = config.bucket.as_deref().unwrap_or_default();
            Unavailable(format!("cannot use --blobs {bucket}: {error}; see the variables AWS_ENDPOINT and AWS_REGION"))
        }
        (_, JobApiError::Store(error)) if config.database.is_some() => {
            Unavailable(format!("cannot use --store: {error}"))
        }
        (Some(folder), _) => Unavailable(format!("cannot use --data-dir {}: {error}", folder.display())),
    }
}

/// How long connections get to close after the last stream.
const LEAVE: Duration = Duration::from_secs(2);

/// Says what is wrong with the options, and does nothing else.
pub(crate) fn check(args: &ServeArgs) -> Result<()> {
    prepare(args).map(|_| ())
}

/// Whatever can be refused before a port is bound or a folder is made.
fn prepare(args: &ServeArgs) -> Result<(ServeConfig, Option<Arc<Tls>>)> {
    let config = args.check()?;
    let tls = config.tls.clone().map(Tls::load).transpose().map_err(|error| BadTls(error.to_string()))?;
    Ok((config, tls.map(Arc::new)))
}

pub(crate) fn run(args: &ServeArgs) -> Result<()> {
    let begin = Instant::now();
    let (config, tls) = prepare(args)?;
    let metrics = Metrics::new(env!("CARGO_PKG_VERSION"), About::REVISION);
    lifecycle::ended(&metrics, Step::Configuration, begin);
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        // Files are read and written there: more at once than this are not faster, and hold a stack each.
        .max_blocking_threads(64)
        // The pool wakes any of those that wait: what is done every second would keep as many for ever as it does in this time.
        .thread_keep_alive(Duration::from_secs(2))
        .thread_name("tessera-io")
        .build()
        .context("cannot start the runtime")?;
    let result = runtime.block_on(serve(args, config, tls, metrics));
    runtime.shutdown_timeout(LEAVE);
    result
}

async fn serve(args: &ServeArgs, config: ServeConfig, tls: Option<Arc<Tls>>, metrics: Metrics) -> Result<()> {
    let life = LifeCycle::new(metrics.clone(), config.start);
    let late = |error: TooLong| Unavailable(error.to_string());
    // Before the backends: a signal while they warm up ends the process cleanly too.
    let mut signals = interrupt::signals().context("cannot listen for signals")?;
    // Whatever there is to be read again: without this the signal would end the process. Keys listen for themselves.
    let certificates = tls.clone();
    let look = move || certificates.iter().for_each(|tls| tls.look());
    interrupt::on_hangup(look).context("cannot listen for signals")?;
    let role = config.role;
    let mut options = args.backend.clone();
    if !role.works() {
        options.backend = BackendArg::Serial;
    }
    options.gpu_timeout = Some(config.device.timeout);
    let factory = move || {
        let backends = backends::all(&options)?;
        warm_up(&backends)?;
        Ok(backends)
    };
    // What is left is for everything else, and for what the last look did not see.
    let machine = || memory::machine_memory_bytes().map(|bytes| bytes / 4 * 3);
    let ceilings = Ceilings { memory_bytes: config.ceilings.memory_bytes.or_else(machine), ..config.ceilings };
    let usual = EngineOptions::default();
    let jobs_at_once = config.jobs_at_once.unwrap_or(usual.jobs_at_once);
    let queue_jobs = config.queue_jobs;
    let device_memory_bytes = config.device.memory_bytes;
    let loss = match config.device.on_loss {
        OnLoss::Exit => LossPolicy::End,
        OnLoss::Cpu => LossPolicy::Cpu,
    };
    let loss_patience = config.device.patience;
    let nice = config.nice;
    let engine_options =
        EngineOptions { queue_jobs, ceilings, jobs_at_once, device_memory_bytes, loss, loss_patience, nice, ..usual };
    // Before the backends take their time: another server may have the folder.
    let stores = life.step(Step::Storage, stores(&config)).await.map_err(late)??;
    let access = access(args, &config, &stores).await?;
    let counts = Arc::new(metrics.clone());
    let starting = tokio::task::spawn_blocking(move || Engine::start_observed(factory, engine_options, counts));
    let (engine, worker) = tokio::select! {
        started = life.step(Step::Backends, starting) => started.map_err(late)?.context("starting the backends")?.context("starting the backends")?,
        _ = &mut signals => return Ok(()),
    };
    let by = engine.backend(BackendChoice::Auto)?;
    let options = ExecutorOptions {
        waiting_jobs: config.waiting_jobs,
        keep_results: config.keep.0,
        keep_records: config.keep.1,
        max_crashes: config.max_crashes,
        node: NodeOptions { name: config.node.clone(), role, version: env!("CARGO_PKG_VERSION").to_owned() },
        ..ExecutorOptions::new(config.limits.bounds())
    };
    let blobs = Arc::clone(&stores.blobs);
    let executor = life.step(Step::Jobs, Executor::start(engine.clone(), stores, options)).await.map_err(late)?;
    let executor = executor.map_err(|error| unusable(&config, &error))?;
    let calls = |addresses| if role.takes_calls() { addresses } else { &[][..] };
    let listener = life.step(Step::Port, bind("--listen", calls(&config.listen))).await.map_err(late)??;
    // All ports, before anybody hears of one.
    let http = bind("--http-listen", calls(&config.http)).await?;
    let operators = bind("--admin-listen", &config.admin).await?;
    let address = listener.as_ref().map(TcpListener::local_addr).transpose().context("asking for the port")?;
    if let Some((address, cluster)) = address.zip(executor.cluster()) {
        cluster.advertise(config.advertise.clone().unwrap_or_else(|| advertised(address, tls.is_some())));
    }
    let executor: Arc<dyn JobApi> = Arc::new(executor);
    tracing::info!(
        address = address.map(tracing::field::display),
        backend = by.kind.name(),
        adapter = by.adapter,
        threads = by.threads,
        queue_jobs = config.queue_jobs,
        tls = tls.is_some(),
        keys = config.requires_keys,
        "serving"
    );
    match address {
        Some(address) => outln!("tessera listens on {address}")?,
        None => outln!("tessera works as {}", config.node)?,
    }
    if config.database.is_some() {
        metrics.node(&config.node, &role.to_string());
    }
    let readiness = Readiness::new();
    readiness.set(Reason::Starting, true);
    // Ends with this, after the server: its state is visible while it drains.
    let _admin =
        operators.map(|port| open_admin(port, hosts(args), (&engine, &executor), &metrics, &readiness)).transpose()?;
    let door = http.map(|port| open_door(&config, port)).transpose()?;
    let about = About {
        machine_bytes: memory::machine_memory_bytes(),
        job_limit_bytes: ceilings.memory_bytes,
        job_time: ceilings.time,
        jobs_at_once,
        ..About::default()
    };
    let jobs = Some(Jobs { blobs, api: executor });
    let limits = config.limits;
    let parts = Parts { engine, worker, limits, jobs, tls, access, metrics, readiness, about, door };
    let shutdown = async {
        // Without a sender no signal can come; go on serving.
        if signals.await.is_err() {
            std::future::pending::<()>().await;
        }
    };
    let served = service::run(listener, parts, shutdown).await.map_err(|error| match error {
        ServeError::WorkStuck { .. } => Stuck(error.to_string()).into(),
        ServeError::Journal => NotWritten(error.to_string()).into(),
        ServeError::DeviceMissing => NoDevice(error.to_string()).into(),
        other => anyhow::Error::new(other),
    });
    served.context("serving")
}

/// Where others can tell clients to go.
fn advertised(address: SocketAddr, has_tls: bool) -> String {
    let scheme = if has_tls { "https" } else { "http" };
    match address.ip().is_unspecified() {
        true => format!("{scheme}://{}:{}", host_name(), address.port()),
        false => format!("{scheme}://{address}"),
    }
}

/// Binds one of these addresses, if there are any.
async fn bind(option: &str, addresses: &[SocketAddr]) -> Result<Option<TcpListener>> {
    if addresses.is_empty() {
        return Ok(None);
    }
    let all = || addresses.iter().map(SocketAddr::to_string).collect::<Vec<_>>().join(", ");
    let refused = |error| Unavailable(format!("cannot listen on {}: {error}; choose another {option}", all()));
    Ok(Some(TcpListener::bind(addresses).await.map_err(refused)?))
}

fn open_door(config: &ServeConfig, listener: TcpListener) -> Result<Door> {
    let address = listener.local_addr().context("asking for the HTTP port")?;
    tracing::info!(%address, page = config.ui, "HTTP");
    outln!("tessera speaks HTTP on {address}")?;
    #[cfg(feature = "ui")]
    if config.ui {
        return Ok(http::door_with_page(listener));
    }
    Ok(http::door(listener))
}

fn open_admin(
    listener: TcpListener,
    hosts: Hosts,
    (engine, api): (&Engine, &Arc<dyn JobApi>),
    metrics: &Metrics,
    readiness: &Readiness,
) -> Result<JoinSet<Infallible>> {
    let mut serving = JoinSet::new();
    let address = listener.local_addr().context("asking for the admin port")?;
    tracing::info!(%address, "metrics, health and readiness");
    outln!("tessera tells operators on {address}")?;
    let (engine, counted) = (engine.clone(), metrics.clone());
    let look = Arc::new(move || {
        counted.device_used(engine.device_facts().and_then(|facts| facts.allocated_bytes));
    });
    let (metrics, readiness, revision) = (metrics.clone(), readiness.clone(), About::REVISION);
    let api = Arc::clone(api);
    let scale = Arc::new(move || -> admin::Scale {
        let api = Arc::clone(&api);
        Box::pin(async move { server::cluster::scale(&*api).await })
    });
    serving.spawn(admin::serve(listener, Admin { metrics, readiness, revision, hosts, look, scale }));
    Ok(serving)
}

/// One small remesh on the backend that will be used: pipelines are compiled, and one that gives nonsense never serves.
fn warm_up(backends: &Backends) -> Result<(), JobError> {
    let axes = [DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y, DVec3::Z, DVec3::NEG_Z];
    let facets = vec![[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]];
    let octahedron = TriMesh::new(axes.to_vec(), facets)?;
    let plain = RemeshOptions::plain(Seeds::Given(axes.to_vec()), 1);
    let options = RemeshOptions { projection: Projection::OnSurface, ..plain };
    let backend = backends.choose(BackendChoice::Auto)?;
    let done = remesh(&octahedron, &options, backend.as_ref(), &mut (), &Token::default())?;
    let (facets, area) = (done.report.result.facets, done.report.rvd.area);
    tracing::info!(backend = backend.kind().name(), facets, area, "warmed up");
    Ok(())
}
