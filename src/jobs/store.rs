//! Where jobs are kept.
//!
//! Purpose: [`JobStore`], what a store of jobs can do; [`MemoryStore`] and [`RedbStore`] are two.
//! Invariant: an answer that is not an error says what is kept: in a journal it is on the disk. An operation that gets an error
//! has changed nothing, except [`StoreError::Broken`] and [`StoreError::Closed`], after which it is unknown until the store
//! is opened again. A state changes only from the version that its changer has seen. Nothing here needs the caller to be
//! the only process. Only the store's own clock decides on times, leases and deadlines.
//! Must not know: messages, how jobs are done, in which order they should be.

mod codec;
mod container;
mod live;
mod memory;
mod operations;
mod redb;
mod tables;

use std::collections::BTreeMap;
use std::fmt;
use std::path::PathBuf;
use std::pin::Pin;
use std::str::FromStr;
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use crate::record::event::{Events, Progress};
use crate::record::state::{State, TransitionError};
use crate::record::{Bytes, Change, Job, JobId, JobIdError, Spec, Time};

pub use self::redb::repair::{Findings, check, repair};
pub use self::redb::{RedbOptions, RedbStore};
pub use memory::MemoryStore;

/// What an operation comes to.
pub type Answer<'a, T> = Pin<Box<dyn Future<Output = Result<T, StoreError>> + Send + 'a>>;

/// A store of jobs. See the module's head for what an answer promises. An operation whose future is dropped may still happen.
pub trait JobStore: Send + Sync {
    /// Keeps a new job, queued. A request that came before with the same tenant and number gives its job again.
    ///
    /// # Errors
    /// `AlreadyExists` if that request had another body; `NameTaken`.
    fn create(&self, job: NewJob) -> Answer<'_, Created>;

    /// The job that a request with the same tenant, number and body made before; none if it has no number or is new.
    ///
    /// # Errors
    /// `AlreadyExists` if that request had another body.
    fn requested(&self, spec: Spec) -> Answer<'_, Option<Job>>;

    /// A job.
    ///
    /// # Errors
    /// `NotFound`.
    fn get(&self, id: JobId) -> Answer<'_, Job>;

    /// Jobs, the newest first.
    fn list(&self, query: Query) -> Answer<'_, Page>;

    /// Takes a queued job, counts an attempt and begins a lease. Of the jobs that fit the offer the first has the highest
    /// priority, then the greatest age. `None` if none fits.
    fn claim_next(&self, offer: Offer) -> Answer<'_, Option<Job>>;

    /// Extends the lease of a claim; it ends `lease` from now. `at` is the version that [`Self::claim_next`] gave. A lease
    /// that is over can be renewed as long as the job was not taken back.
    ///
    /// # Errors
    /// `NotFound`; `Stale` if the job is no longer the caller's.
    fn renew(&self, id: JobId, at: u64, lease: Duration) -> Answer<'_, ()>;

    /// Changes the state of a job that is at version `at`.
    ///
    /// # Errors
    /// `NotFound`, `Stale`, `Transition`.
    fn change(&self, id: JobId, at: u64, change: Change) -> Answer<'_, Job>;

    /// Cancels a job, in whatever version; one that is cancelled already stays so. The executor finds out by its next
    /// [`Self::renew`] or [`Self::progress`], or by an event.
    ///
    /// # Errors
    /// `NotFound`; `Transition` if it has ended otherwise.
    fn cancel(&self, id: JobId) -> Answer<'_, Job>;

    /// Adds an event to a running job and gives its number. `at` is the version that [`Self::claim_next`] gave. May be lost if
    /// the process goes down before the state changes; its number is not used again.
    ///
    /// # Errors
    /// `NotFound`; `Stale` if the job is no longer the caller's.
    fn progress(&self, id: JobId, at: u64, progress: Progress) -> Answer<'_, u64>;

    /// At most `most` events after number `after`; none if none came.
    ///
    /// # Errors
    /// `NotFound`.
    fn events(&self, id: JobId, after: u64, most: usize) -> Answer<'_, Events>;

    /// Ends once the job has an event after number `after`.
    ///
    /// # Errors
    /// `NotFound`, also if it is deleted meanwhile.
    fn wait(&self, id: JobId, after: u64) -> Answer<'_, ()>;

    /// Forgets a job that has ended, its events and its request.
    ///
    /// # Errors
    /// `NotFound`, `NotEnded`.
    fn delete(&self, id: JobId) -> Answer<'_, ()>;

    /// Lets go of what is over, at most `most` jobs: those whose deadline has passed expire, results that were kept long
    /// enough expire, and jobs without a result that were kept long enough are deleted. An error may leave a part of it done.
    fn expire(&self, keep: Retention, most: usize) -> Answer<'_, Swept>;

    /// Puts orphaned jobs back into the queue, each with its crash counted; one with `max_crashes` of them fails. An error may
    /// leave a part of it done; doing it again is harmless.
    fn recover(&self, orphans: Orphans, max_crashes: u32) -> Answer<'_, Recovered>;
}

/// Times that a job may bring the process down: the second time it fails.
pub const MAX_CRASHES: u32 = 2;

/// A job that is to be created. Its name has the store's time.
#[derive(Clone, Debug)]
pub struct NewJob {
    /// For its name, if the request did not come before: a number from a source that others do not have.
    pub random: u128,
    /// What is asked for.
    pub spec: Spec,
    /// Memory that it is expected to need.
    pub needs: Bytes,
}

/// What a process can do now.
#[derive(Clone, Debug)]
pub struct Offer {
    /// The name of the process.
    pub holder: String,
    /// The time until others may take the job for orphaned.
    pub lease: Duration,
    /// Memory that is free for the job.
    pub room: Bytes,
    /// This job alone: for a process that has all waiting jobs in a queue of its own.
    pub job: Option<JobId>,
}

impl Offer {
    /// An offer with this much memory for any job.
    pub fn new(holder: impl Into<String>, lease: Duration, room: Bytes) -> Self {
        Self { holder: holder.into(), lease, room, job: None }
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
    /// A clock that gives what `read` gives.
    pub fn new(read: impl Fn() -> Time + Send + Sync + 'static) -> Self {
        Self(Arc::new(read))
    }

    pub(crate) fn now(&self) -> Time {
        (self.0)()
    }
}

/// The clock of the operating system.
impl Default for Clock {
    fn default() -> Self {
        Self::new(|| {
            let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
            Time(u64::try_from(since.as_millis()).unwrap_or(u64::MAX))
        })
    }
}

impl fmt::Debug for Clock {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Clock")
    }
}

/// What [`JobStore::create`] gives.
#[derive(Clone, Debug, PartialEq)]
pub struct Created {
    /// The job.
    pub job: Job,
    /// Whether an earlier request had created it.
    pub existed: bool,
}

/// Which jobs are listed.
#[derive(Clone, Debug, Default)]
pub struct Query {
    /// In one of these states; all if none.
    pub states: Vec<State>,
    /// With these labels.
    pub labels: BTreeMap<String, String>,
    /// Of this tenant.
    pub tenant: Option<String>,
    /// Jobs created at this time or later.
    pub since: Option<Time>,
    /// Jobs created before this time.
    pub before: Option<Time>,
    /// How many at most; 1 to [`Query::MAX_LIMIT`], and 100 if 0.
    pub limit: usize,
    /// Goes on after an earlier page of the same query.
    pub token: Option<PageToken>,
}

impl Query {
    /// The most jobs of a page.
    pub const MAX_LIMIT: usize = 1000;

    /// Jobs of a page: as asked, at most [`Self::MAX_LIMIT`], 100 if nothing is asked.
    pub fn limit(&self) -> usize {
        if self.limit == 0 { 100 } else { self.limit.min(Self::MAX_LIMIT) }
    }
}

/// Where the next page begins. A text that only this crate reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PageToken(pub JobId);

impl fmt::Display for PageToken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl FromStr for PageToken {
    type Err = JobIdError;

    fn from_str(text: &str) -> Result<Self, JobIdError> {
        text.parse().map(Self)
    }
}

/// Some jobs.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Page {
    /// The newest first.
    pub jobs: Vec<Job>,
    /// There may be more.
    pub next: Option<PageToken>,
}

/// How long things are kept after a job has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Retention {
    /// Results.
    pub results: Duration,
    /// Jobs without a result, those whose result expired included, from then on.
    pub records: Duration,
}

/// What [`JobStore::expire`] did.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Swept {
    /// Jobs that expired.
    pub expired: Vec<JobId>,
    /// Jobs that are forgotten.
    pub deleted: Vec<JobId>,
    /// Whether there may be more to do.
    pub more: bool,
}

/// Which running jobs have lost their executor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Orphans {
    /// All: the only process that can have run them says so at its start.
    All,
    /// Those whose lease has run out: where several processes share a store.
    LeaseOver,
}

/// What [`JobStore::recover`] found.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Recovered {
    /// Orphaned jobs that wait again.
    pub requeued: Vec<JobId>,
    /// Orphaned jobs that failed, since they had crashed often enough.
    pub failed: Vec<JobId>,
    /// All jobs that wait now, those included, the oldest first.
    pub queued: Vec<JobId>,
}

/// Why an operation on a store was refused or failed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum StoreError {
    /// There is no such job.
    #[error("there is no job {id}; it may have been deleted")]
    NotFound {
        /// Which.
        id: JobId,
    },
    /// The request came before with another body.
    #[error("request {request_id:?} came before with another body and made job {id}; take another request_id")]
    AlreadyExists {
        /// Which request.
        request_id: String,
        /// The job that it made.
        id: JobId,
    },
    /// The name of a new job is in use.
    #[error("job {id} is there already; take another name")]
    NameTaken {
        /// Which.
        id: JobId,
    },
    /// The job has changed since.
    #[error("job {id} is at version {found}, not {expected}: it changed meanwhile; read it again")]
    Stale {
        /// Which.
        id: JobId,
        /// The version that the caller has seen.
        expected: u64,
        /// The version that it has.
        found: u64,
    },
    /// The state does not allow it.
    #[error("job {id}: {cause}")]
    Transition {
        /// Which.
        id: JobId,
        /// What is not allowed.
        cause: TransitionError,
    },
    /// Only jobs that have ended can be deleted.
    #[error("job {id} is {}; cancel it first", state.name())]
    NotEnded {
        /// Which.
        id: JobId,
        /// Its state.
        state: State,
    },
    /// Another process has the directory.
    #[error(
        "{} is in use by another server{}; stop that one, or give another --data-dir, or --ephemeral",
        path.display(),
        holder.as_ref().map_or_else(String::new, |pid| format!(" (process {pid})"))
    )]
    InUse {
        /// The directory.
        path: PathBuf,
        /// Its process, if it can be read.
        holder: Option<String>,
    },
    /// What is kept cannot be read.
    #[error("the journal {} is damaged: {what}; `tessera journal repair` saves what can be read; or restore it from a copy, or move it away to begin with none", path.display())]
    Damaged {
        /// The file, or the record in it.
        path: PathBuf,
        /// What is wrong.
        what: String,
    },
    /// Nothing of a journal can be read, whatever is tried.
    #[error("nothing of the journal {} can be read: {what}; restore it from a copy, or move it away to begin with none", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        what: String,
    },
    /// What is kept was written by another release.
    #[error(
        "{what} has version {found}, and this program reads up to {known}; use the release that wrote it, or a later one"
    )]
    UnknownVersion {
        /// Which part.
        what: String,
        /// Its version.
        found: u32,
        /// The last version that is known.
        known: u32,
    },
    /// The operating system refused.
    #[error("cannot {action} {}: {cause}", path.display())]
    Io {
        /// What was tried.
        action: &'static str,
        /// With which file.
        path: PathBuf,
        /// What it said.
        cause: String,
    },
    /// Writing failed, and nothing is taken any more.
    #[error(
        "the journal cannot be written ({cause}); see that the disk has room and is sound, and start the server again"
    )]
    Broken {
        /// What went wrong.
        cause: String,
    },
    /// The store was closed.
    #[error("the store of jobs is closed; the server is ending")]
    Closed,
}
