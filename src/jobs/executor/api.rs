//! What callers can do with jobs.
//!
//! Purpose: [`JobApi`], what the services and the command see of jobs.
//! Invariant: a job of another tenant does not exist for a caller. An answer that is not an error says what is kept.
//! Must not know: streams, how work is done, where jobs are kept.

use std::collections::BTreeMap;
use std::sync::Arc;

use async_trait::async_trait;
use tokio::sync::watch;

pub use crate::admission::{JobApiError, Memory};
use crate::blob::BlobError;
pub use crate::observe::preview::{Preview, PreviewReceiver};
use crate::record::event::Events;
use crate::record::{Job, JobId, Spec};
use crate::store::shared::Overview;
use crate::store::{Created, Page, Query};

/// See the module's head. A call of [`create`](Self::create), [`cancel`](Self::cancel) or [`delete`](Self::delete) must
/// be run to its end, even if the caller is gone. Every call may fail with `Store`.
#[async_trait]
pub trait JobApi: Send + Sync {
    /// Keeps a job and queues it, unless an earlier one is the answer by `reuse`. Errors: `Input`, `TooLarge`, `Packed`; `Blob`, or `InputMissing` in `Store`, if its input is not stored; `Store` if
    /// the request came before with another body; `Job` if the queue is full or the server drains.
    async fn create(&self, spec: Spec, reuse: Reuse) -> Result<Created, JobApiError>;

    async fn get(&self, tenant: &str, id: JobId) -> Result<Job, JobApiError>;

    /// Jobs, the newest first. The query names its tenant.
    async fn list(&self, query: Query) -> Result<Page, JobApiError>;

    /// At most `most` events after number `after`; none if none came.
    async fn events(&self, tenant: &str, id: JobId, after: u64, most: usize) -> Result<Events, JobApiError>;

    /// Ends once the job has an event after number `after`. Errors: `Store`; `NotFound` in it also if the job is deleted
    /// meanwhile.
    async fn wait(&self, tenant: &str, id: JobId, after: u64) -> Result<(), JobApiError>;

    /// The newest seeds of a job at work, from now on until it ends; the sender is then gone. Sets of more than a million are
    /// not shown.
    async fn preview(&self, tenant: &str, id: JobId) -> Result<PreviewReceiver, JobApiError>;

    /// Cancels a job; one that is cancelled already stays so.
    async fn cancel(&self, tenant: &str, id: JobId) -> Result<Job, JobApiError>;

    /// Forgets a job that has ended, and lets its result go.
    async fn delete(&self, tenant: &str, id: JobId) -> Result<(), JobApiError>;

    /// What a job would need. Counts that are not given are read from the job's input. Errors: `Input`, `TooLarge`,
    /// `Packed`; `Blob` if counts are not given and the input is not stored.
    async fn estimate(&self, spec: Spec, vertices: Option<u64>, facets: Option<u64>) -> Result<Estimate, JobApiError>;

    /// Ends if nothing can be kept any more: only a new process can go on.
    async fn failed(&self);

    /// Why blobs cannot be stored now; `None` if they can. Jobs wait meanwhile.
    fn storage(&self) -> watch::Receiver<Option<BlobError>>;

    /// Takes nothing new and begins nothing more. Ends once nothing is at work; what waits is done after the next start.
    async fn drain(&self);

    /// What there is more where several servers share the store.
    fn cluster(&self) -> Option<&dyn ClusterApi> {
        None
    }
}

/// What there is more where several servers share a store.
#[async_trait]
pub trait ClusterApi: Send + Sync {
    /// The process that has a job at work, if it is another one that shares the store: that one alone shows its seeds.
    async fn at_work_elsewhere(&self, tenant: &str, id: JobId) -> Result<Option<String>, JobApiError>;

    /// Why no server that is alive does a queued job; `None` if one can.
    async fn unschedulable(&self, job: &Job) -> Result<Option<String>, JobApiError>;

    /// All servers and all work, a moment old.
    async fn overview(&self) -> Result<Arc<Overview>, JobApiError>;

    /// If this server does no streams, since it does no work or is to take no more: where one that does takes calls, if any is known.
    async fn streams_elsewhere(&self) -> Option<Option<String>>;

    /// This server takes calls at this address.
    fn advertise(&self, address: String);

    /// Tells how many calls are open here by key, and gives how many are at the other servers; nothing if the store does not answer.
    async fn share_calls(&self, open: BTreeMap<String, u32>) -> BTreeMap<String, u32>;

    /// Whether an operator wants this server to take no more work.
    fn drained(&self) -> watch::Receiver<bool>;
}

/// Whether a new job may be answered with an earlier one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Reuse {
    #[default]
    Never,
    /// With one whose result is kept and has the same bits, but for times in the report.
    SameBits,
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct Estimate {
    /// Predicted peak memory of the process, bytes.
    pub host_bytes: u64,
    /// Memory available to jobs, bytes.
    pub host_limit_bytes: u64,
    /// Memory of the device, bytes; 0 on a CPU.
    pub device_bytes: u64,
    /// The device's memory for jobs; 0 if it is not known.
    pub device_limit_bytes: u64,
    /// Seconds of work, if nothing else is at work.
    pub seconds: f64,
    pub fits: bool,
    /// Why no server that is alive does it; `None` if one can, or if this one alone does jobs.
    pub unschedulable: Option<String>,
}
