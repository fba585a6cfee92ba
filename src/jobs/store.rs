//! Where jobs are kept.
//!
//! Purpose: [`JobStore`], what a store of jobs can do; [`MemoryStore`] and [`RedbStore`] are two, a third is in `postgres`.
//! Invariant: an answer that is not an error says what is kept: in a journal it is on the disk. An operation that gets an error
//! has changed nothing, except [`StoreError::Broken`] and [`StoreError::Closed`], after which it is unknown until the store
//! is opened again, and [`StoreError::Unavailable`], after which it is unknown until the job is read again. A state changes only from the version that its changer has seen. Nothing here needs the caller to be
//! the only process. Only the store's own clock decides on times, leases and deadlines. The store has the index of blobs
//! too: a job's pins are set and end in the same step as the change of the job.
//! Must not know: messages, how jobs are done, in which order they should be, where the bytes of blobs lie.

pub(crate) mod codec;
mod container;
mod operations;
pub(crate) mod pins;
mod redb;
pub(crate) mod rules;
pub mod shared;
mod tables;

use std::collections::BTreeMap;
use std::fmt;
use std::path::PathBuf;
use std::pin::Pin;
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use crate::beside::Beside;
use crate::blob::index::BlobIndex;
use crate::blob::{Digest, Owner};
use crate::record::event::{Events, Progress};
use crate::record::state::{State, TransitionError};
use crate::record::{Bytes, Change, Job, JobId, Spec, Time};

pub use self::redb::repair::{Findings, check, repair};
pub use self::redb::{RedbOptions, RedbStore};
pub use container::MemoryStore;
pub use pins::result_pin;
pub use shared::SharedStore;
#[cfg(feature = "postgres")]
pub(crate) use tables::Waiters;

pub type Answer<'a, T> = Pin<Box<dyn Future<Output = Result<T, StoreError>> + Send + 'a>>;

/// A store of jobs. See the module's head for what an answer promises. An operation whose future is dropped may still happen.
///
/// A job's input is pinned in its tenant's name from [`Self::create`] until it has ended. Its result is pinned by whoever
/// does the job, under [`result_pin`]; the store ends that pin when the result expires, with a deleted job, and after an
/// attempt that did not succeed.
pub trait JobStore: Send + Sync {
    /// The index of the blobs that jobs name. The store of blobs keeps bytes by it.
    fn index(&self) -> Arc<dyn BlobIndex>;

    /// Keeps a new job, queued, and pins its input. A request that came before with the same tenant and number gives its job
    /// again. Errors: `AlreadyExists` if that request had another body; `NameTaken`; `InputMissing`.
    fn create(&self, job: NewJob) -> Answer<'_, Created>;

    /// The job that a request with the same tenant, number and body made before; none if it has no number or is new.
    /// Errors: `AlreadyExists` if that request had another body.
    fn requested(&self, spec: Spec) -> Answer<'_, Option<Job>>;

    /// The newest job of a tenant whose result has this fingerprint and is still kept.
    fn same(&self, tenant: String, fingerprint: Digest) -> Answer<'_, Option<Job>>;

    fn get(&self, id: JobId) -> Answer<'_, Job>;

    /// Jobs, the newest first.
    fn list(&self, query: Query) -> Answer<'_, Page>;

    /// Takes a queued job, counts an attempt and begins a lease. Of the jobs of a tenant that fit the offer the first has the
    /// highest priority, then the greatest age; of tenants a shared store takes the one that has had least, any other store the
    /// one with that job. `None` if none fits.
    fn claim_next(&self, offer: Offer) -> Answer<'_, Option<Job>>;

    /// Extends the lease of a claim; it ends `lease` from now. `at` is the version that [`Self::claim_next`] gave. A lease
    /// that is over can be renewed as long as the job was not taken back. Errors: `NotFound`; `Stale` if the job is no
    /// longer the caller's.
    fn renew(&self, id: JobId, at: u64, lease: Duration) -> Answer<'_, ()>;

    /// Changes the state of a job that is at version `at`. Errors: `NotFound`, `Stale`, `Transition`.
    fn change(&self, id: JobId, at: u64, change: Change) -> Answer<'_, Job>;

    /// Cancels a job, in whatever version; one that is cancelled already stays so. The executor finds out by its next
    /// [`Self::renew`] or [`Self::progress`], or by an event. Errors: `NotFound`; `Transition` if it has ended otherwise.
    fn cancel(&self, id: JobId) -> Answer<'_, Job>;

    /// Adds an event to a running job and gives its number. `at` is the version that [`Self::claim_next`] gave. May be lost
    /// if the process goes down before the state changes; its number is not used again. Errors: `NotFound`; `Stale` if the
    /// job is no longer the caller's.
    fn progress(&self, id: JobId, at: u64, progress: Progress) -> Answer<'_, u64>;

    /// At most `most` events after number `after`; none if none came. Errors: `NotFound`.
    fn events(&self, id: JobId, after: u64, most: usize) -> Answer<'_, Events>;

    /// Ends once the job has an event after number `after`. Errors: `NotFound`, also if it is deleted meanwhile.
    fn wait(&self, id: JobId, after: u64) -> Answer<'_, ()>;

    /// Forgets a job that has ended, its events and its request. Errors: `NotFound`, `NotEnded`.
    fn delete(&self, id: JobId) -> Answer<'_, ()>;

    /// Lets go of what is over, at most `most` jobs: those whose deadline has passed expire, results that were kept long
    /// enough expire, and jobs without a result that were kept long enough are deleted. An error may leave a part of it done.
    fn expire(&self, keep: Retention, most: usize) -> Answer<'_, Swept>;

    /// Puts orphaned jobs back into the queue, each with its crash counted; one with `max_crashes` of them fails if nothing
    /// else was at work at its last. With [`Orphans::All`], a store whose pins do not outlive the process sets them again. An error may leave a part of it done;
    /// doing it again is harmless.
    fn recover(&self, orphans: Orphans, max_crashes: u32) -> Answer<'_, Recovered>;

    /// Marks work that is none of the store's jobs, for the next [`Self::recover`].
    fn beside(&self) -> Beside;

    /// What a store has more if several processes use it at the same time. `None` in a store of one process.
    fn shared(&self) -> Option<&dyn SharedStore> {
        None
    }
}

/// Times that a job may be at work when the process goes down: the second time it fails, if it was at work alone.
pub const MAX_CRASHES: u32 = 2;

/// A job that is to be created. Its name has the store's time.
#[derive(Clone, Debug)]
pub struct NewJob {
    /// For its name, if the request did not come before: a number from a source that others do not have.
    pub random: u128,
    pub spec: Spec,
    pub needs: Bytes,
    pub cost: Cost,
}

/// What a job takes of its tenant's share.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cost {
    /// Predicted seconds of work.
    pub seconds: f64,
    /// The tenant's share beside others: 1 if nothing else is said.
    pub weight: f64,
}

impl Default for Cost {
    fn default() -> Self {
        Self { seconds: 1.0, weight: 1.0 }
    }
}

/// What a process can do now.
#[derive(Clone, Debug)]
pub struct Offer {
    pub holder: String,
    /// The time until others may take the job for orphaned.
    pub lease: Duration,
    /// Memory that is free now.
    pub room: Bytes,
    /// Memory that is there when nothing is at work.
    pub whole: Bytes,
    /// Whether jobs that need a GPU can be done. A store of one process has all its jobs done by it.
    pub has_gpu: bool,
    /// This job alone: for a process that has all waiting jobs in a queue of its own.
    pub job: Option<JobId>,
}

impl Offer {
    /// An offer with this much memory for any job.
    pub fn new(holder: impl Into<String>, lease: Duration, room: Bytes) -> Self {
        Self { holder: holder.into(), lease, room, whole: room, has_gpu: true, job: None }
    }

    /// An offer for one job, whatever it needs.
    pub fn of(holder: impl Into<String>, lease: Duration, job: JobId) -> Self {
        Self { job: Some(job), ..Self::new(holder, lease, Bytes::MAX) }
    }
}

/// The clock of a store of one process.
#[derive(Clone)]
pub struct Clock(Arc<dyn Fn() -> Time + Send + Sync>);

impl Clock {
    pub fn new(read: impl Fn() -> Time + Send + Sync + 'static) -> Self {
        Self(Arc::new(read))
    }

    pub(crate) fn now(&self) -> Time {
        (self.0)()
    }
}

// The time of day when this was made, and the time that has passed since: a clock that somebody sets ends no deadline.
impl Default for Clock {
    fn default() -> Self {
        let (wall, begin) = (SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default(), Instant::now());
        Self::new(move || {
            let since = wall.saturating_add(begin.elapsed());
            Time(u64::try_from(since.as_millis()).unwrap_or(u64::MAX))
        })
    }
}

impl fmt::Debug for Clock {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Clock")
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct Created {
    pub job: Job,
    /// Whether its request came before, or it is reused.
    pub existed: bool,
    /// Whether it is an earlier job with the same result.
    pub reused: bool,
}

impl Created {
    pub fn new(job: Job) -> Self {
        Self { job, existed: false, reused: false }
    }

    /// The job of a request that came before.
    pub fn before(job: Job) -> Self {
        Self { job, existed: true, reused: false }
    }

    pub fn reused(job: Job) -> Self {
        Self { job, existed: true, reused: true }
    }
}

#[derive(Clone, Debug, Default)]
pub struct Query {
    /// In one of these states; all if none.
    pub states: Vec<State>,
    pub labels: BTreeMap<String, String>,
    pub tenant: Option<String>,
    pub since: Option<Time>,
    pub before: Option<Time>,
    /// How many at most; 1 to [`Query::MAX_LIMIT`], and 100 if 0.
    pub limit: usize,
    /// Goes on after an earlier page of the same query.
    pub token: Option<JobId>,
}

impl Query {
    pub const MAX_LIMIT: usize = 1000;

    /// Jobs of a page: as asked, at most [`Self::MAX_LIMIT`], 100 if nothing is asked.
    pub fn limit(&self) -> usize {
        if self.limit == 0 { 100 } else { self.limit.min(Self::MAX_LIMIT) }
    }
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct Page {
    /// The newest first.
    pub jobs: Vec<Job>,
    /// The token of the next page, if there may be more.
    pub next: Option<JobId>,
}

/// How long things are kept after a job has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Retention {
    pub results: Duration,
    /// Jobs without a result, those whose result expired included, from then on.
    pub records: Duration,
}

#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Swept {
    pub expired: Vec<JobId>,
    pub deleted: Vec<JobId>,
    pub more: bool,
}

/// Which running jobs have lost their executor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Orphans {
    /// All: the only process that can have run them says so at its start. In a store that several processes share: those
    /// that a process with this one's name took, and those whose lease has run out.
    All,
    /// Those whose lease has run out: where several processes share a store.
    LeaseOver,
}

#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Recovered {
    /// Orphaned jobs that wait again.
    pub requeued: Vec<JobId>,
    /// Orphaned jobs that failed, since they had crashed often enough.
    pub failed: Vec<JobId>,
    /// With [`Orphans::All`], all jobs that wait now, those included, the oldest first.
    pub queued: Vec<JobId>,
    /// Blobs that were to be pinned again, each list with the tenant of its job.
    pub pinned: Vec<(Owner, Vec<Digest>)>,
}

/// Why an operation on a store was refused or failed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum StoreError {
    #[error("there is no job {id}; it may have been deleted")]
    NotFound { id: JobId },
    #[error("request {request_id:?} came before with another body and made job {id}; take another request_id")]
    AlreadyExists { request_id: String, id: JobId },
    #[error("job {id} is there already; take another name")]
    NameTaken { id: JobId },
    #[error("blob {digest} is not stored; upload it")]
    InputMissing { digest: Digest },
    #[error("job {id} is at version {found}, not {expected}: it changed meanwhile; read it again")]
    Stale { id: JobId, expected: u64, found: u64 },
    #[error("job {id}: {cause}")]
    Transition { id: JobId, cause: TransitionError },
    #[error("job {id} is {}; cancel it first", state.name())]
    NotEnded { id: JobId, state: State },
    #[error(
        "{} is in use by another server{}; stop that one, or give another --data-dir, or --ephemeral",
        path.display(),
        holder.as_ref().map_or_else(String::new, |pid| format!(" (process {pid})"))
    )]
    InUse { path: PathBuf, holder: Option<String> },
    #[error("the journal {} is damaged: {what}; `tessera journal repair` saves what can be read; or restore it from a copy, or move it away to begin with none", path.display())]
    Damaged { path: PathBuf, what: String },
    #[error("nothing of the journal {} can be read: {what}; restore it from a copy, or move it away to begin with none", path.display())]
    Unreadable { path: PathBuf, what: String },
    #[error(
        "{what} has version {found}, and this program reads up to {known}; use the release that wrote it, or a later one"
    )]
    UnknownVersion { what: String, found: u32, known: u32 },
    #[error("cannot {action} {}: {cause}", path.display())]
    Io { action: &'static str, path: PathBuf, cause: String },
    #[error(
        "the journal cannot be written ({cause}); see that the disk has room and is sound, and start the server again"
    )]
    Broken { cause: String },
    #[error("the store of jobs is closed; the server is ending")]
    Closed,
    #[error("the database of jobs does not answer ({cause}); try again")]
    Unavailable { cause: String },
    #[error("the database of jobs cannot be used: {cause}")]
    Unusable { cause: String },
}
