//! Jobs of a store that several processes share.
//!
//! Purpose: [`pull`] claims jobs while the engine has a free place; [`renew`] renews the leases of claimed jobs; [`Leases`] knows
//! them. Invariant: a job that was claimed is in [`Leases`] until its end is recorded or it was given back, so that a drain waits
//! for it. A lease is renewed only while its work advances. Work whose lease is lost stops, and its result is not kept.
//! Must not know: how a job is done, which store it is.

use std::collections::{BTreeMap, HashMap};
use std::sync::{Arc, Mutex, Weak};
use std::time::{Duration, Instant};

use futures_util::future::join_all;

use super::storage::RETRY_PERIOD;
use super::{ALONE_CHECK, Inner, is_outdated};
use crate::lock;
use crate::record::{Change, Job, JobId};
use crate::store::{Offer, Orphans, SharedStore, StoreError};
use geometry::rvd::{BackendChoice, BackendKind};
use geometry::token::Token;

/// A process with room looks for work this often, woken or not.
const POLL: Duration = Duration::from_secs(1);
pub(super) const GPU: BackendChoice = BackendChoice::Only(BackendKind::Gpu);
/// Renewals in the time of a lease.
const RENEWALS: u32 = 3;
/// Looks for leases that are over, in the time of a lease.
const RECOVERIES: u32 = 12;
/// How long the numbers of waiting jobs are used.
const NUMBERS: Duration = Duration::from_secs(1);

/// A job that this process has claimed.
#[derive(Clone, Debug)]
struct Lease {
    /// The version that the claim gave.
    at: u64,
    token: Token,
    /// Whether the work has begun.
    begun: bool,
}

impl Lease {
    fn advances(&self, silence: Duration) -> bool {
        !self.begun || self.token.is_suspended() || self.token.silent_for() < silence
    }
}

/// The claims of this process.
#[derive(Debug, Default)]
pub(super) struct Leases(Mutex<BTreeMap<JobId, Lease>>);

impl Leases {
    fn insert(&self, job: &Job, token: Token) {
        lock(&self.0).insert(job.id, Lease { at: job.status.version, token, begun: false });
    }

    /// The work of the claim that gave version `at` begins, or begins again. `false` if the job was given back.
    pub(super) fn begin(&self, id: JobId, at: u64) -> bool {
        let mut leases = lock(&self.0);
        leases.get_mut(&id).filter(|lease| lease.at == at).map(|lease| lease.begun = true).is_some()
    }

    /// The claim that gave version `at` is over. `false` if it was before.
    pub(super) fn end(&self, id: JobId, at: u64) -> bool {
        let mut leases = lock(&self.0);
        leases.get(&id).is_some_and(|lease| lease.at == at) && leases.remove(&id).is_some()
    }

    pub(super) fn is_empty(&self) -> bool {
        self.len() == 0
    }

    pub(super) fn len(&self) -> usize {
        lock(&self.0).len()
    }

    fn get(&self, id: JobId, at: u64) -> Option<Lease> {
        lock(&self.0).get(&id).filter(|lease| lease.at == at).cloned()
    }

    /// Takes the claims out whose work has not begun.
    fn take_waiting(&self) -> Vec<(JobId, u64)> {
        lock(&self.0).extract_if(.., |_, lease| !lease.begun).map(|(id, lease)| (id, lease.at)).collect()
    }

    fn advancing(&self, silence: Duration) -> Vec<(JobId, u64)> {
        let leases = lock(&self.0);
        leases.iter().filter(|(_, lease)| lease.advances(silence)).map(|(id, lease)| (*id, lease.at)).collect()
    }
}

/// Jobs that wait in the store by tenant, as they were a moment ago.
#[derive(Debug, Default)]
pub(super) struct Numbers {
    at: Option<Instant>,
    tenants: HashMap<String, usize>,
}

/// Claims jobs while there is a free place, for as long as the executor lives.
pub(super) async fn pull(inner: Weak<Inner>) {
    let work = |inner: Arc<Inner>| {
        let works = inner.options.node.role.works();
        inner.stores.jobs.shared().filter(|_| works).map(|shared| (shared.work(), inner.drained.subscribe()))
    };
    let Some((mut work, mut drained)) = inner.upgrade().and_then(work) else { return };
    loop {
        let Some(this) = inner.upgrade() else { return };
        work.mark_unchanged();
        match this.pull_one().await {
            Ok(true) => continue,
            Ok(false) => {}
            Err(error) => tracing::warn!(%error, "no job could be claimed; trying again"),
        }
        let engine = this.engine.clone();
        drop(this);
        tokio::select! {
            _ = work.changed() => {}
            _ = drained.changed() => {}
            () = engine.freed() => {}
            () = tokio::time::sleep(POLL) => {}
        }
    }
}

/// Renews leases, for as long as the executor lives.
pub(super) async fn renew(inner: Weak<Inner>) {
    let mut pause = Duration::ZERO;
    loop {
        tokio::time::sleep(pause).await;
        let Some(inner) = inner.upgrade() else { return };
        let usual = inner.options.lease / RENEWALS;
        pause = if inner.renew_all().await { usual } else { usual.min(RETRY_PERIOD) };
    }
}

/// Ends the watching of a job's seeds once the job has ended, since another process may do it.
pub(super) async fn end_preview(inner: Weak<Inner>, id: JobId) {
    loop {
        tokio::time::sleep(POLL).await;
        let Some(inner) = inner.upgrade().filter(|inner| inner.previews.is_watched(id)) else { return };
        match inner.stores.jobs.get(id).await {
            Ok(job) if !job.status.state.is_ended() => {}
            Err(StoreError::Unavailable { .. }) => {}
            _ => return inner.previews.end(id),
        }
    }
}

impl Inner {
    pub(super) fn shared(&self) -> Option<&dyn SharedStore> {
        self.stores.jobs.shared()
    }

    /// Claims a job and queues it, if there is a place for one.
    async fn pull_one(self: &Arc<Self>) -> Result<bool, StoreError> {
        let claiming = self.claiming.lock().await;
        if self.is_draining() || *self.drained.borrow() || !self.engine.has_place() {
            return Ok(false);
        }
        let whole = self.engine.memory();
        let room = whole.minus(self.engine.planned());
        let has_gpu = self.engine.backend(GPU).is_ok();
        let offer = Offer { whole, has_gpu, ..Offer::new(self.name.clone(), self.options.lease, room) };
        let Some(job) = self.stores.jobs.claim_next(offer).await? else { return Ok(false) };
        let token = self.engine.token_within(job.spec.task().deadlines.run);
        self.leases.insert(&job, token.clone());
        drop(claiming);
        // It may have brought processes down: nothing else is at work meanwhile.
        let is_suspect = job.status.crashes >= self.options.max_crashes;
        if is_suspect {
            tracing::warn!(id = %job.id, crashes = job.status.crashes, "processes went down with this job: it is tried alone");
            self.until_none_is_kept().await;
        }
        if let Err(error) = self.enqueue(&job, Some(token)).await {
            tracing::debug!(id = %job.id, %error, "a job is given back");
        }
        if is_suspect {
            self.until_none_is_kept().await;
        }
        Ok(true)
    }

    async fn until_none_is_kept(&self) {
        while self.engine.kept(None) > 0 && !self.is_draining() {
            tokio::time::sleep(ALONE_CHECK).await;
        }
    }

    /// Whether the store answered.
    async fn renew_all(&self) -> bool {
        let renewals = self.leases.advancing(self.options.silence).into_iter().map(|(id, at)| async move {
            match self.stores.jobs.renew(id, at, self.options.lease).await {
                Ok(()) => true,
                Err(error) if is_outdated(&error) => {
                    tracing::info!(%id, %error, "a job is no longer this server's: its work stops");
                    self.lose(id, at);
                    true
                }
                Err(error) => {
                    tracing::warn!(%id, %error, "a lease could not be renewed; trying again");
                    false
                }
            }
        });
        join_all(renewals).await.into_iter().all(|answered| answered)
    }

    /// Another process has the job, or it has ended: stops the work of the claim that gave version `at`.
    pub(super) fn lose(&self, id: JobId, at: u64) {
        let Some(lost) = self.leases.get(id, at) else { return };
        lost.token.cancel();
        if !lost.begun {
            self.engine.remove_kept(id);
        }
    }

    /// Puts a claimed job back that was not begun.
    pub(super) async fn give_back(&self, id: JobId, at: u64) {
        match self.stores.jobs.change(id, at, Change::Release).await {
            Ok(_) => {}
            Err(error) if is_outdated(&error) => {}
            Err(error) => {
                tracing::warn!(%id, %error, "a job could not be given back: it waits for the end of its lease")
            }
        }
    }

    /// No claim is under way from now on, and what has not begun is given back. To be called while draining.
    pub(super) async fn stop_pulling(&self) {
        drop(self.claiming.lock().await);
        join_all(self.leases.take_waiting().into_iter().map(|(id, at)| self.give_back(id, at))).await;
    }

    /// Whether it is time to look for leases that are over.
    pub(super) fn is_recovery_due(&self, last: Instant) -> bool {
        self.shared().is_some() && last.elapsed() >= self.options.lease / RECOVERIES
    }

    /// Takes back the jobs of processes that went down.
    pub(super) async fn recover_lost(&self) -> Result<(), StoreError> {
        let recovered = self.stores.jobs.recover(Orphans::LeaseOver, self.options.max_crashes).await?;
        if !recovered.requeued.is_empty() || !recovered.failed.is_empty() {
            let (again, failed) = (recovered.requeued.len(), recovered.failed.len());
            tracing::warn!(again, failed, "leases ran out: their processes went down, or cannot reach the database");
        }
        Ok(())
    }

    /// Jobs that wait in a shared store: a tenant's, and all. Up to a second old, this process's own new ones included.
    pub(super) async fn waiting(&self, shared: &dyn SharedStore, tenant: &str) -> Result<(usize, usize), StoreError> {
        let mut numbers = self.numbers.lock().await;
        if numbers.at.is_none_or(|at| at.elapsed() >= NUMBERS) {
            *numbers = Numbers { tenants: shared.waiting().await?, at: Some(Instant::now()) };
        }
        let own = numbers.tenants.get(tenant).copied().unwrap_or(0);
        Ok((own, numbers.tenants.values().sum()))
    }

    /// One more job of a tenant waits.
    pub(super) async fn count_waiting(&self, tenant: &str) {
        *self.numbers.lock().await.tenants.entry(tenant.to_owned()).or_default() += 1;
    }
}
