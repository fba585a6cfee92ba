//! Jobs that are kept, done by this process.
//!
//! Purpose: [`Executor`] is the [`JobApi`] of one server: it keeps jobs in a [`JobStore`], queues them for the engine, does
//! them and stores their results; and it takes them up again after a restart. Of a store that several processes share it
//! queues none: it claims what it has room for ([`sharing`]).
//! Invariant: an acknowledged job is in the store, which pins its input. A result is pinned from before it is visible. A
//! job is done by the executor that claimed it: what becomes of one that was cancelled or expired meanwhile is thrown away.
//! A job fails for crashes only if it was at work alone. Must not know: messages, clients, which store.

pub mod api;
mod cluster;
mod creating;
pub mod diagram;
mod fingerprint;
mod input;
mod perform;
pub mod prepared;
mod running;
pub mod session;
mod sharing;
mod storage;
pub mod streams;

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, OnceLock, Weak};
use std::time::{Duration, Instant};

use async_trait::async_trait;
use tokio::runtime::Handle;
use tokio::sync::{mpsc, watch};

use crate::admission::forecast::Forecast;
use crate::blob::{BlobError, BlobOptions, BlobStore, ObjectBlobs};
use crate::engine::{AdmissionRequest, Engine};
use crate::executor::api::{ClusterApi, Estimate, JobApi, JobApiError, Reuse};
use crate::observe::preview::{PreviewReceiver, Previews};
use crate::record::event::{Events, Progress};
use crate::record::{Change, FailureKind, Job, JobId, Spec};
use crate::store::shared::Overview;
use crate::store::{
    Cost, Created, JobStore, MAX_CRASHES, MemoryStore, NewJob, Orphans, Page, Query, RedbOptions, RedbStore, Retention,
    StoreError,
};
use crate::{JobError, admission, lock};
pub use cluster::{NodeOptions, host_name};
use fingerprint::fingerprint;
use geometry::token::Token;
use sharing::{Leases, Numbers};
use storage::Storage;
use wire::counts::Bounds;

/// How often jobs that are over are looked for.
const SWEEP: Duration = Duration::from_secs(1);
/// Between two checks of a storage that is well, and how long one may take: new jobs of servers that share a bucket are to be
/// refused soon after it hangs, while a disk may be slow for a moment.
const STORAGE_CHECK: (Duration, Duration) = (Duration::from_secs(5), Duration::from_secs(10));
const BUCKET_CHECK: (Duration, Duration) = (Duration::from_secs(2), Duration::from_secs(2));
/// Sweeps between two looks for abandoned uploads.
const SWEEP_UPLOADS: u32 = 600;
/// Jobs that one sweep removes at most.
const SWEEP_BATCH: usize = 1000;
/// How long a shared store may take to answer the first question of a new job.
const PATIENCE: Duration = Duration::from_millis(1800);
/// Between two looks whether a job that is tried alone has ended.
const ALONE_CHECK: Duration = Duration::from_millis(50);
/// Progress that waits to be recorded.
const PROGRESS: usize = 4096;

#[derive(Clone, Debug)]
pub struct ExecutorOptions {
    pub waiting_jobs: usize,
    /// How long results are kept after a job has ended.
    pub keep_results: Duration,
    /// How long jobs without a result are kept.
    pub keep_records: Duration,
    /// Times that a job may be at work when the process goes down; then it fails.
    pub max_crashes: u32,
    /// How long a claim is good without a renewal.
    pub lease: Duration,
    /// In a store that several processes share, the lease of work that has not checked its token for so long is not renewed.
    /// Longer than one submission to the device may take.
    pub silence: Duration,
    pub node: NodeOptions,
    pub bounds: Bounds,
}

impl ExecutorOptions {
    pub fn new(bounds: Bounds) -> Self {
        Self {
            waiting_jobs: 100_000,
            keep_results: Duration::from_secs(24 * 3600),
            keep_records: Duration::from_secs(7 * 24 * 3600),
            max_crashes: MAX_CRASHES,
            lease: Duration::from_secs(60),
            silence: Duration::from_secs(120),
            node: NodeOptions::default(),
            bounds,
        }
    }
}

/// A database that several servers share.
#[derive(Clone, Debug)]
pub struct DatabaseOptions<'a> {
    /// This server's name among them.
    pub node: &'a str,
    /// `postgres://USER@HOST/DATABASE`.
    pub url: &'a str,
    /// A file with its password, if the URL has none.
    pub password: Option<PathBuf>,
    /// Whether a crash or a failover of the database may lose jobs that were acknowledged.
    pub may_lose: bool,
}

#[derive(Clone)]
pub struct Stores {
    pub jobs: Arc<dyn JobStore>,
    pub blobs: Arc<dyn BlobStore>,
}

impl Stores {
    /// In a folder, which is made if need be. Errors: `InUse` if another process has it, or why it cannot be used.
    pub async fn in_folder(folder: PathBuf, blobs: BlobOptions) -> Result<Self, JobApiError> {
        let jobs = journal(folder.clone()).await?;
        let blobs = ObjectBlobs::local_with(jobs.index(), folder.join("blobs"), blobs).await?;
        Ok(Self { jobs, blobs: Arc::new(blobs) })
    }

    /// Jobs in a folder, which is made if need be; blobs in a bucket, `s3://bucket/prefix`, whose address and keys are in
    /// the variables `AWS_ENDPOINT`, `AWS_REGION`, `AWS_ACCESS_KEY_ID` and so on. Errors: `InUse` if another process has
    /// the folder, or why folder or bucket cannot be used.
    pub async fn in_bucket(folder: PathBuf, url: &str, blobs: BlobOptions) -> Result<Self, JobApiError> {
        #[cfg(feature = "s3")]
        {
            let jobs = journal(folder).await?;
            let blobs = ObjectBlobs::s3(jobs.index(), url, [], blobs).await?;
            Ok(Self { jobs, blobs: Arc::new(blobs) })
        }
        #[cfg(not(feature = "s3"))]
        {
            let _ = (folder, blobs);
            Err(BlobError::Unavailable(format!("{url}: this program was built without the feature s3")).into())
        }
    }

    /// Jobs in a PostgreSQL database that several servers share; blobs in a bucket, as in [`Self::in_bucket`]. `copies` is a folder for
    /// copies of blobs, and how many bytes they may take. Errors: why database or bucket cannot be used.
    pub async fn in_database(
        database: DatabaseOptions<'_>,
        bucket: &str,
        blobs: BlobOptions,
        (copies, copies_bytes): (PathBuf, u64),
    ) -> Result<Self, JobApiError> {
        #[cfg(all(feature = "postgres", feature = "s3"))]
        {
            use crate::postgres::{PostgresOptions, PostgresStore};
            let DatabaseOptions { node, url, password: password_file, may_lose } = database;
            let holder = cluster::unique_name(node)?;
            let options = PostgresOptions { password_file, may_lose, ..PostgresOptions::new(url, holder) };
            let jobs = PostgresStore::open(options).await?;
            let blobs = ObjectBlobs::s3(jobs.index(), bucket, [], blobs).await?;
            let blobs = blobs.with_cache(copies, copies_bytes).await?;
            Ok(Self { jobs: Arc::new(jobs), blobs: Arc::new(blobs) })
        }
        #[cfg(not(all(feature = "postgres", feature = "s3")))]
        {
            let _ = (database, bucket, blobs, copies, copies_bytes);
            let cause = "this program was built without the feature postgres or s3".to_owned();
            Err(StoreError::Unusable { cause }.into())
        }
    }

    /// In memory, gone with the process.
    pub fn ephemeral(blobs: BlobOptions) -> Self {
        let jobs = MemoryStore::default();
        let blobs = ObjectBlobs::in_memory_with(jobs.index(), blobs);
        Self { jobs: Arc::new(jobs), blobs: Arc::new(blobs) }
    }
}

async fn journal(folder: PathBuf) -> Result<Arc<dyn JobStore>, JobApiError> {
    let opened = tokio::task::spawn_blocking(move || RedbStore::open(&folder, RedbOptions::default())).await;
    Ok(Arc::new(opened.map_err(|error| JobApiError::Job(JobError::Panicked(error.to_string())))??))
}

/// See the module's head. Clones share one state.
#[derive(Clone)]
pub struct Executor {
    inner: Arc<Inner>,
}

struct Inner {
    stores: Stores,
    engine: Engine,
    options: ExecutorOptions,
    forecast: Forecast,
    name: String,
    runtime: Handle,
    draining: AtomicBool,
    held: Mutex<Held>,
    /// Claims of this process in a shared store.
    leases: Leases,
    /// Held while a job is claimed.
    claiming: tokio::sync::Mutex<()>,
    numbers: tokio::sync::Mutex<Numbers>,
    overview: tokio::sync::Mutex<Option<(Instant, Arc<Overview>)>>,
    /// Whether an operator wants this process to take no more work of a shared store.
    drained: watch::Sender<bool>,
    /// Where this process takes calls.
    address: OnceLock<String>,
    storage: Storage,
    progress: mpsc::Sender<ProgressCommand>,
    previews: Previews,
    /// Whether the store has failed for good.
    broken: watch::Sender<bool>,
}

/// Jobs that wait until those that may have brought the process down have been tried, each alone.
#[derive(Default)]
struct Held {
    is_trying: bool,
    jobs: Vec<Job>,
}

/// What the task that records progress is to do, in order.
enum ProgressCommand {
    Record {
        id: JobId,
        at: u64,
        what: Progress,
    },
    /// All before it are kept.
    Flush(tokio::sync::oneshot::Sender<()>),
}

impl Executor {
    /// Takes up the jobs of `stores`: those that were at work when the process went down wait again, or fail if that was
    /// not the first time. To be called within a runtime.
    pub async fn start(engine: Engine, stores: Stores, options: ExecutorOptions) -> Result<Self, JobApiError> {
        let (progress, commands) = mpsc::channel(PROGRESS);
        let forecast = Forecast::new(Arc::clone(&stores.blobs), engine.clone(), options.bounds.max_seeds);
        let shared = stores.jobs.shared().map(|shared| shared.holder().to_owned());
        let is_shared = shared.is_some();
        let inner = Arc::new(Inner {
            stores,
            engine,
            options,
            forecast,
            name: shared.unwrap_or_else(|| format!("process {}", std::process::id())),
            runtime: Handle::current(),
            draining: AtomicBool::default(),
            held: Mutex::default(),
            leases: Leases::default(),
            claiming: tokio::sync::Mutex::default(),
            numbers: tokio::sync::Mutex::default(),
            overview: tokio::sync::Mutex::default(),
            drained: watch::Sender::new(false),
            address: OnceLock::new(),
            storage: Storage::default(),
            progress,
            previews: Previews::default(),
            broken: watch::Sender::new(false),
        });
        inner.engine.count_beside(inner.stores.jobs.beside());
        inner.recover().await?;
        tokio::spawn(record_progress((Arc::clone(&inner.stores.jobs), Arc::downgrade(&inner)), commands));
        tokio::spawn(sweep(Arc::downgrade(&inner)));
        tokio::spawn(check_storage(Arc::downgrade(&inner)));
        if is_shared {
            tokio::spawn(sharing::pull(Arc::downgrade(&inner)));
            tokio::spawn(sharing::renew(Arc::downgrade(&inner)));
            tokio::spawn(cluster::beat(Arc::downgrade(&inner)));
        }
        Ok(Self { inner })
    }
}

/// Records the progress of jobs. What is no longer of interest is left out by the store.
async fn record_progress(
    (jobs, inner): (Arc<dyn JobStore>, Weak<Inner>),
    mut commands: mpsc::Receiver<ProgressCommand>,
) {
    while let Some(command) = commands.recv().await {
        match command {
            ProgressCommand::Record { id, at, what } => {
                if let Err(error) = jobs.progress(id, at, what).await {
                    tracing::debug!(%id, %error, "progress not kept");
                    if is_outdated(&error) {
                        inner.upgrade().iter().for_each(|inner| inner.lose(id, at));
                    }
                }
            }
            ProgressCommand::Flush(done) => drop(done.send(())),
        }
    }
}

/// Checks the storage of blobs, for as long as the executor lives. Nothing else waits for a bucket that hangs.
async fn check_storage(inner: Weak<Inner>) {
    let mut pause = SWEEP;
    loop {
        tokio::time::sleep(pause).await;
        let Some(inner) = inner.upgrade() else { return };
        let (usual, limit) = if inner.shared().is_some() { BUCKET_CHECK } else { STORAGE_CHECK };
        inner.storage.check(inner.stores.blobs.as_ref(), limit).await;
        pause = if inner.storage.is_down() { SWEEP } else { usual };
    }
}

/// Lets go of what is over, again and again.
async fn sweep(inner: Weak<Inner>) {
    let (mut sweeps, mut recovered, mut is_away) = (0u32, Instant::now(), false);
    loop {
        tokio::time::sleep(SWEEP).await;
        let Some(inner) = inner.upgrade() else { return };
        sweeps = sweeps.wrapping_add(1);
        if sweeps.is_multiple_of(SWEEP_UPLOADS)
            && let Err(error) = inner.stores.blobs.sweep().await
        {
            tracing::error!(%error, "uploads that nobody continues could not be let go of");
        }
        let swept = match inner.sweeps().await {
            Ok(true) => inner.expire().await,
            Ok(false) => continue,
            Err(error) => Err(error),
        };
        match swept {
            Ok(()) => is_away = false,
            Err(error @ StoreError::Unavailable { .. }) => {
                if !std::mem::replace(&mut is_away, true) {
                    tracing::error!(%error, "jobs that are over cannot be let go of; trying again");
                }
                continue;
            }
            Err(error @ (StoreError::Broken { .. } | StoreError::Closed)) => {
                tracing::error!(%error, "nothing more can be kept");
                inner.broken.send_replace(true);
                return;
            }
            Err(error) => tracing::error!(%error, "jobs that are over could not be let go of"),
        }
        if inner.is_recovery_due(recovered) {
            recovered = Instant::now();
            if let Err(error) = inner.recover_lost().await {
                tracing::warn!(%error, "leases that are over could not be looked for");
            }
        }
    }
}

impl Inner {
    async fn recover(self: &Arc<Self>) -> Result<(), JobApiError> {
        let jobs = &self.stores.jobs;
        let recovered = jobs.recover(Orphans::All, self.options.max_crashes).await?;
        if !recovered.requeued.is_empty() || !recovered.failed.is_empty() {
            let (again, failed) = (recovered.requeued.len(), recovered.failed.len());
            tracing::warn!(again, failed, "the process went down with jobs at work");
        }
        // Each process claims what it has room for.
        if self.shared().is_some() {
            return Ok(());
        }
        // Blobs of earlier versions have no owner.
        for (owner, digests) in &recovered.pinned {
            self.stores.blobs.claim(*owner, digests).await?;
        }
        let mut suspects = Vec::new();
        for id in &recovered.queued {
            let job = jobs.get(*id).await?;
            match job.status.crashes >= self.options.max_crashes {
                true => suspects.push(job),
                false => lock(&self.held).jobs.push(job),
            }
        }
        if suspects.is_empty() {
            self.let_go().await;
        } else {
            tracing::warn!(jobs = suspects.len(), "the process went down with these jobs: each is tried alone");
            lock(&self.held).is_trying = true;
            tokio::spawn(Arc::clone(self).try_each_alone(suspects));
        }
        if !recovered.queued.is_empty() {
            tracing::info!(jobs = recovered.queued.len(), "taken up again");
        }
        Ok(())
    }

    /// Does each of these jobs while no other job of the store is at work, then lets all others go.
    async fn try_each_alone(self: Arc<Self>, suspects: Vec<Job>) {
        for job in suspects {
            if self.is_draining() {
                return;
            }
            self.enqueue_or_log(&job).await;
            while self.engine.kept(None) > 0 {
                tokio::time::sleep(ALONE_CHECK).await;
            }
        }
        self.let_go().await;
    }

    /// Queues the jobs that were held.
    async fn let_go(self: &Arc<Self>) {
        loop {
            let jobs = {
                let mut held = lock(&self.held);
                held.is_trying = !held.jobs.is_empty();
                std::mem::take(&mut held.jobs)
            };
            if jobs.is_empty() || self.is_draining() {
                return;
            }
            for job in jobs {
                self.enqueue_or_log(&job).await;
            }
        }
    }

    /// Kept is kept: if a job cannot be queued now, the next start does.
    async fn enqueue_or_log(self: &Arc<Self>, job: &Job) {
        if let Err(error) = self.enqueue(job, None).await {
            tracing::warn!(id = %job.id, %error, "a job waits for the next start");
        }
    }

    async fn unpin(&self, name: &str) {
        if let Err(error) = self.stores.blobs.unpin(name).await {
            tracing::error!(%error, name, "blobs stay pinned");
        }
    }

    /// `claimed`: the token of a job that was claimed before.
    async fn enqueue(self: &Arc<Self>, job: &Job, claimed: Option<Token>) -> Result<(), JobApiError> {
        // Its blobs may be gone.
        let counts = self.forecast.counts(&job.spec, None).await.ok();
        let request = match &counts {
            Some(counts) => admission::request(&self.engine, &job.spec.tenant, counts, &self.forecast.need(counts)),
            None => AdmissionRequest { tenant: job.spec.tenant.as_str().into(), seconds: 1.0, ..Default::default() },
        };
        let request = AdmissionRequest {
            weight: self.engine.weights().of(&job.spec.tenant),
            priority: job.spec.task().priority,
            kept: Some(job.id),
            origin: counts.as_ref().map(|counts| counts.origin(Some(job.id))),
            ..request
        };
        let mut work = running::Work::new(Arc::downgrade(self), job.id, claimed.is_some().then(|| job.clone()));
        let token = claimed.unwrap_or_else(|| self.engine.token_within(job.spec.task().deadlines.run));
        Ok(self.engine.submit_kept(token, request, move |backends, context| work.run(backends, context))?)
    }

    fn is_draining(&self) -> bool {
        self.draining.load(Ordering::Acquire)
    }

    async fn of_tenant(&self, tenant: &str, id: JobId) -> Result<Job, JobApiError> {
        let job = self.stores.jobs.get(id).await?;
        if job.spec.tenant != tenant {
            return Err(StoreError::NotFound { id }.into());
        }
        Ok(job)
    }

    async fn expire(&self) -> Result<(), StoreError> {
        let keep = Retention { results: self.options.keep_results, records: self.options.keep_records };
        loop {
            let swept = self.stores.jobs.expire(keep, SWEEP_BATCH).await?;
            for id in swept.expired.iter().chain(&swept.deleted) {
                self.engine.remove_kept(*id);
                self.previews.end(*id);
            }
            if !swept.more {
                return Ok(());
            }
        }
    }
}

#[async_trait]
impl JobApi for Executor {
    fn cluster(&self) -> Option<&dyn ClusterApi> {
        self.inner.shared().map(|_| self as &dyn ClusterApi)
    }

    async fn create(&self, spec: Spec, reuse: Reuse) -> Result<Created, JobApiError> {
        let this = &self.inner;
        let begun = match this.shared() {
            None => this.begin_create(&spec, reuse).await?,
            Some(_) => tokio::time::timeout(PATIENCE, this.begin_create(&spec, reuse)).await.map_err(|_| {
                let cause = format!("no answer within {} s", PATIENCE.as_secs_f64());
                StoreError::Unavailable { cause }
            })??,
        };
        if let Some(earlier) = begun {
            return Ok(earlier);
        }
        this.check_input(&spec).await?;
        let need = this.admit(&spec).await?;
        let cost = Cost { seconds: need.seconds, weight: this.engine.weights().of(&spec.tenant) };
        let new = NewJob { random: getrandom_u128()?, spec, needs: need.memory, cost };
        let created = this.stores.jobs.create(new).await?;
        if this.shared().is_some() {
            if !created.existed {
                this.count_waiting(&created.job.spec.tenant).await;
            }
            return Ok(created);
        }
        let is_held = || {
            let mut held = lock(&this.held);
            held.is_trying.then(|| held.jobs.push(created.job.clone())).is_some()
        };
        if !created.existed && !is_held() {
            this.enqueue_or_log(&created.job).await;
        }
        Ok(created)
    }

    async fn get(&self, tenant: &str, id: JobId) -> Result<Job, JobApiError> {
        self.inner.of_tenant(tenant, id).await
    }

    async fn list(&self, query: Query) -> Result<Page, JobApiError> {
        Ok(self.inner.stores.jobs.list(query).await?)
    }

    async fn events(&self, tenant: &str, id: JobId, after: u64, most: usize) -> Result<Events, JobApiError> {
        self.inner.of_tenant(tenant, id).await?;
        Ok(self.inner.stores.jobs.events(id, after, most).await?)
    }

    async fn wait(&self, tenant: &str, id: JobId, after: u64) -> Result<(), JobApiError> {
        self.inner.of_tenant(tenant, id).await?;
        Ok(self.inner.stores.jobs.wait(id, after).await?)
    }

    async fn preview(&self, tenant: &str, id: JobId) -> Result<PreviewReceiver, JobApiError> {
        self.inner.of_tenant(tenant, id).await?;
        let receiver = self.inner.previews.watch(id);
        // It may have ended before it was watched.
        if self.inner.of_tenant(tenant, id).await?.status.state.is_ended() {
            self.inner.previews.end(id);
        } else if self.inner.shared().is_some() {
            tokio::spawn(sharing::end_preview(Arc::downgrade(&self.inner), id));
        }
        Ok(receiver)
    }

    async fn cancel(&self, tenant: &str, id: JobId) -> Result<Job, JobApiError> {
        self.inner.of_tenant(tenant, id).await?;
        let job = self.inner.stores.jobs.cancel(id).await?;
        self.inner.engine.remove_kept(id);
        self.inner.previews.end(id);
        Ok(job)
    }

    async fn delete(&self, tenant: &str, id: JobId) -> Result<(), JobApiError> {
        self.inner.of_tenant(tenant, id).await?;
        Ok(self.inner.stores.jobs.delete(id).await?)
    }

    async fn estimate(&self, spec: Spec, vertices: Option<u64>, facets: Option<u64>) -> Result<Estimate, JobApiError> {
        let is_shared = self.inner.shared().is_some();
        if !is_shared {
            self.inner.engine.backend(spec.task().backend)?;
        }
        let given = vertices.zip(facets);
        let counts = self.inner.forecast.counts_by_surface(&spec, given).await?;
        let need = self.inner.forecast.need(&counts);
        let limits = self.inner.largest().await?;
        let unschedulable = self.inner.why_not(&need, &spec).await?;
        let in_bounds = self.inner.within_bounds(&counts).is_ok();
        Ok(Estimate {
            host_bytes: need.memory.host,
            host_limit_bytes: limits.host,
            device_bytes: need.memory.device,
            device_limit_bytes: if limits.device == u64::MAX { 0 } else { limits.device },
            seconds: need.seconds,
            fits: in_bounds && unschedulable.is_none() && (is_shared || need.memory.fits(limits)),
            unschedulable: unschedulable.map(|unschedulable| unschedulable.to_string()),
        })
    }

    async fn failed(&self) {
        let mut broken = self.inner.broken.subscribe();
        if broken.wait_for(|broken| *broken).await.is_err() {
            std::future::pending::<()>().await;
        }
    }

    fn storage(&self) -> watch::Receiver<Option<BlobError>> {
        self.inner.storage.watch()
    }

    async fn drain(&self) {
        self.inner.draining.store(true, Ordering::Release);
        // The store has those that wait.
        self.inner.engine.release_kept();
        self.inner.stop_pulling().await;
        if *self.inner.broken.borrow() {
            // No end of theirs can be kept.
            self.inner.engine.cancel_kept();
        }
        while self.inner.engine.kept(None) > 0 || !self.inner.leases.is_empty() {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
        if let Some(shared) = self.inner.shared()
            && let Err(error) = shared.leave().await
        {
            tracing::debug!(%error, "the others take this server for away in a moment");
        }
    }
}

fn getrandom_u128() -> Result<u128, JobApiError> {
    let mut bytes = [0; 16];
    getrandom::fill(&mut bytes).map_err(|error| {
        JobApiError::Job(JobError::Panicked(format!("the operating system gives no random numbers: {error}")))
    })?;
    Ok(u128::from_le_bytes(bytes))
}

/// Whether a change was refused because somebody else changed the job: it was cancelled, or its time was over.
fn is_outdated(error: &StoreError) -> bool {
    matches!(error, StoreError::Stale { .. } | StoreError::Transition { .. } | StoreError::NotFound { .. })
}

/// The longest message of a failure, characters: every list of jobs holds it.
const MOST_WORDS: usize = 1000;

fn failed(kind: FailureKind, message: impl Into<String>) -> Change {
    let mut message: String = message.into();
    if let Some((end, _)) = message.char_indices().nth(MOST_WORDS) {
        message.truncate(end);
        message.push_str("...");
    }
    Change::Fail(crate::record::Failure { kind, message })
}
