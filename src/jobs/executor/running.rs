//! One job at work.
//!
//! Purpose: [`Work`] claims a job, does it on a host thread, keeps its result and says how it ended.
//! Invariant: a result is pinned before it is named by the job. An executor that finds the job changed by others stops and leaves no
//! pin. A stop because of a shutdown puts the job back. Must not know: queues, messages.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, Weak};
use std::time::{Duration, Instant};

use glam::DVec3;

use super::storage::{RETRY_PERIOD, StorageError};
use super::{Inner, ProgressCommand, failed, fingerprint, is_outdated};
use crate::admission::forecast::{must_end, must_fit};
use crate::blob::{BlobError, Owner, put};
use crate::engine::worker::{Device, WorkContext, text};
use crate::executor::input::{Blobs, Reader, WorkError, failure};
use crate::executor::perform::{JobContext, Parts, perform};
use crate::observe::activity::{Activity, JobOutcome, Listener};
use crate::record::event::Progress;
use crate::record::state::State;
use crate::record::{Cause, Change, FailureKind, Job, JobId, ResultSet};
use crate::store::{Offer, StoreError, result_pin};
use crate::{BackendInfo, Backends, JobError, lock};
use geometry::cvt::Iteration;
use geometry::cvt::density::Expected;
use geometry::remesh::RemeshError;
use geometry::rvd::RvdError;
use geometry::token::{Stopped, Token};

/// How long the last progress of a job may take to be recorded.
const FLUSH_TIMEOUT: Duration = Duration::from_secs(2);

/// How long the end of stopped work is tried to be recorded: a shutdown waits for it.
const STOPPED_PATIENCE: Duration = Duration::from_secs(4);
/// Between two iterations that are recorded in a store that several processes share.
const BETWEEN_ITERATIONS: Duration = Duration::from_millis(500);

/// See the module's head. Called again after a lost device.
pub(super) struct Work {
    inner: Weak<Inner>,
    id: JobId,
    claimed: Option<Job>,
    /// Whether the job was claimed before it was queued: its lease is then among those of the executor.
    is_leased: bool,
}

impl Drop for Work {
    // Work that was never called, or not again, has recorded no end.
    fn drop(&mut self) {
        let Some((inner, job)) = self.inner.upgrade().zip(self.claimed.take()) else { return };
        let (id, at) = (job.id, job.status.version);
        if self.is_leased && inner.leases.end(id, at) {
            let runtime = inner.runtime.clone();
            runtime.spawn(async move { inner.give_back(id, at).await });
        }
    }
}

fn is_ending(inner: &Inner) -> bool {
    *inner.engine.watch_device().borrow() == Device::Missing
}

impl Work {
    pub(super) fn new(inner: Weak<Inner>, id: JobId, claimed: Option<Job>) -> Self {
        let is_leased = claimed.is_some();
        Self { inner, id, claimed, is_leased }
    }

    pub(super) fn run(&mut self, backends: &Backends, context: &WorkContext) -> Result<(), JobError> {
        let Some(inner) = self.inner.upgrade() else { return Ok(()) };
        let Some(job) = self.claim(&inner) else { return Ok(()) };
        let (id, at) = (job.id, job.status.version);
        // It was given back.
        if self.is_leased && !inner.leases.begin(id, at) {
            return Ok(());
        }
        let recorder = Recorder { inner: Arc::clone(&inner), id, at, iteration: Mutex::default() };
        context.activity.listen(Arc::new(recorder));
        let at_work = AtWork { inner, job, token: context.token.clone(), activity: Arc::clone(&context.activity) };
        // A fault of the work is an end as well.
        let outcome = catch_unwind(AssertUnwindSafe(|| at_work.perform(backends)))
            .unwrap_or_else(|panic| Err(JobError::Panicked(text(panic.as_ref())).into()));
        let lost = match &outcome {
            Err(WorkError::Job(error)) if error.is_device_lost() => Some(error.clone()),
            _ => None,
        };
        match lost {
            Some(error) if context.may_retry => Err(error),
            lost => {
                at_work.record_outcome(outcome);
                at_work.inner.previews.end(self.id);
                at_work.inner.leases.end(id, at);
                lost.map_or(Ok(()), Err)
            }
        }
    }

    /// The job, if it still is to be done.
    fn claim(&mut self, inner: &Inner) -> Option<Job> {
        if self.claimed.is_none() && !inner.is_draining() {
            let offer = Offer::of(&inner.name, inner.options.lease, self.id);
            match inner.runtime.block_on(inner.stores.jobs.claim_next(offer)) {
                Ok(claimed) => self.claimed = claimed,
                Err(error) => {
                    tracing::error!(id = %self.id, %error, "a job could not be claimed; it waits for the next start");
                }
            }
        }
        self.claimed.clone()
    }
}

fn unkept(unstored: StorageError) -> WorkError {
    match unstored {
        StorageError::Stopped(reason) => WorkError::from(reason),
        StorageError::Blob(error) => {
            let kind = match error {
                BlobError::TooLarge { .. } => FailureKind::TooLarge,
                _ => FailureKind::Unavailable,
            };
            failure(kind, format!("the result cannot be kept: {error}"))
        }
    }
}

struct AtWork {
    inner: Arc<Inner>,
    job: Job,
    token: Token,
    activity: Arc<Activity>,
}

/// Records the progress of a claimed job and shows its seeds.
struct Recorder {
    inner: Arc<Inner>,
    id: JobId,
    /// The version of the claim.
    at: u64,
    /// When an iteration was recorded last.
    iteration: Mutex<Option<Instant>>,
}

impl Recorder {
    fn record(&self, what: Progress) {
        // What the journal is too slow for is left out: the report has all.
        let _ = self.inner.progress.try_send(ProgressCommand::Record { id: self.id, at: self.at, what });
    }
}

impl Listener for Recorder {
    fn stage(&self, name: &'static str, done: u64, total: u64) {
        self.record(Progress::Stage { name: name.to_owned(), done, total });
    }

    fn iteration(&self, it: &Iteration, total: usize) {
        if self.inner.shared().is_some() {
            let mut last = lock(&self.iteration);
            if last.is_some_and(|last| last.elapsed() < BETWEEN_ITERATIONS) {
                return;
            }
            *last = Some(Instant::now());
        }
        self.record(Progress::Iteration {
            index: it.index as u64,
            total: total as u64,
            kind: it.kind.name().to_owned(),
            energy: it.energy,
            energy_ratio: it.energy_ratio,
            gradient_norm: it.gradient_norm,
            ms: it.ms,
        });
    }

    fn wants_seeds(&self) -> bool {
        self.inner.previews.is_watched(self.id)
    }

    fn seeds(&self, steps: usize, seeds: &[DVec3]) {
        self.inner.previews.show(self.id, steps as u64, seeds);
    }
}

impl Inner {
    /// Ends the pins of a result that was not kept. Another process that has the job pins its result under the same name; the
    /// store ends those pins when that attempt fails.
    async fn unpin_unneeded(&self, id: JobId) {
        let is_needed = match self.shared() {
            None => false,
            Some(_) => match self.stores.jobs.get(id).await {
                Ok(job) => !job.status.state.is_ended() || job.status.state == State::Succeeded,
                Err(error) => !matches!(error, StoreError::NotFound { .. }),
            },
        };
        if !is_needed {
            self.unpin(&result_pin(id)).await;
        }
    }

    /// Records the end of an attempt. A store that does not answer for a while loses no result: the same change is tried again,
    /// for as long as the lease lasts, or [`STOPPED_PATIENCE`] if the work was stopped. A change whose answer was lost counts if the
    /// job has become what it says.
    async fn keep_end(&self, job: &Job, change: Change, token: &Token) -> Result<Job, StoreError> {
        let (jobs, id, at) = (&self.stores.jobs, job.id, job.status.version);
        let begin = Instant::now();
        let may_wait = || {
            let patience = if token.is_told_to_stop() { STOPPED_PATIENCE } else { self.options.lease };
            begin.elapsed() < patience
        };
        let mut changed = jobs.change(id, at, change.clone()).await;
        while matches!(changed, Err(StoreError::Unavailable { .. })) && may_wait() {
            tokio::time::sleep(RETRY_PERIOD).await;
            changed = match jobs.change(id, at, change.clone()).await {
                Err(error) if is_outdated(&error) => match jobs.get(id).await {
                    Ok(now) if job.became(&now.status, &change) => Ok(now),
                    Err(away @ StoreError::Unavailable { .. }) => Err(away),
                    _ => Err(error),
                },
                changed => changed,
            };
        }
        changed
    }
}

impl AtWork {
    fn perform(&self, backends: &Backends) -> Result<ResultSet, WorkError> {
        let (inner, job) = (&*self.inner, &self.job);
        let (token, bounds) = (&self.token, &inner.options.bounds);
        let reader = Reader { blobs: Blobs(inner, token), bounds, token };
        let expects = |expected: &Expected| self.plan_again(expected);
        let context = JobContext { backends, reader, token, activity: &self.activity, expects: &expects };
        let parts = perform(job.spec.task(), &context).map_err(|trouble| match (trouble, self.token.stopped()) {
            // It was stopped while it waited for its input.
            (WorkError::Failure(_), Some(reason)) => WorkError::from(reason),
            (trouble, _) => trouble,
        })?;
        let by = BackendInfo::of(backends.choose(job.spec.task().backend)?.as_ref());
        let fingerprint = Some(fingerprint(job.spec.message(), &by, bounds));
        Ok(ResultSet { fingerprint, ..self.keep(parts)? })
    }

    /// Counts alone do not tell of needles, fans and soups, nor of points that lengths imply: now they are known. A job that
    /// needs more than there is, or would be at work far beyond its limit, ends before it begins.
    fn plan_again(&self, expected: &Expected) -> Result<(), WorkError> {
        let (inner, spec) = (&*self.inner, &self.job.spec);
        // Its blobs were read: what cannot be counted now was counted before.
        let Ok(counts) = inner.runtime.block_on(inner.forecast.counts_with(spec, expected)) else { return Ok(()) };
        let need = inner.forecast.need(&counts);
        must_fit(&need, inner.engine.memory())
            .and_then(|()| must_end(&need, self.token.time_limit()))
            .map_err(|error| failure(FailureKind::TooLarge, error.to_string()))?;
        inner.engine.plan_more(&self.token, need.seconds, need.memory);
        Ok(())
    }

    fn keep(&self, parts: Parts) -> Result<ResultSet, WorkError> {
        let inner = &*self.inner;
        let (bytes, limit) =
            (parts.iter().map(|part| part.1.len() as u64).sum::<u64>(), inner.stores.blobs.limit_bytes());
        if bytes > limit {
            let text = format!("the result has {bytes} bytes, and this server keeps {limit} in all; ask for less");
            return Err(failure(FailureKind::TooLarge, text));
        }
        // A fault in between, of the index or of the bucket, is waited for as well. What is stored already is not stored again.
        let store = || inner.runtime.block_on(self.store(&parts));
        let result = inner.storage.patiently(&self.token, store).map_err(unkept)?;
        // A server that was stopped for a while may have lost the job: its tenant gets nothing from here then.
        if inner.shared().is_some() {
            let (id, at) = (self.job.id, self.job.status.version);
            match inner.runtime.block_on(inner.stores.jobs.renew(id, at, inner.options.lease)) {
                Err(error) if is_outdated(&error) => return Err(WorkError::from(Stopped::Cancelled)),
                _ => {}
            }
        }
        let give = || inner.runtime.block_on(self.give(&result));
        inner.storage.patiently(&self.token, give).map_err(unkept)?;
        Ok(result)
    }

    async fn store(&self, parts: &Parts) -> Result<ResultSet, BlobError> {
        let (blobs, pin) = (self.inner.stores.blobs.as_ref(), result_pin(self.job.id));
        let mut result = ResultSet::default();
        for (name, bytes) in parts {
            let info = put(blobs, bytes.clone(), Some(&pin)).await?;
            result.blobs.insert(name.clone(), info.digest);
        }
        Ok(result)
    }

    /// Before the job names its result: a tenant sees only its own blobs.
    async fn give(&self, result: &ResultSet) -> Result<(), BlobError> {
        let (blobs, pin) = (self.inner.stores.blobs.as_ref(), result_pin(self.job.id));
        let (owner, digests): (_, Vec<_>) =
            (Owner::of(&self.job.spec.tenant), result.blobs.values().copied().collect());
        blobs.pin_for(owner, &pin, &digests).await?;
        blobs.claim(owner, &digests).await
    }

    fn record_outcome(&self, outcome: Result<ResultSet, WorkError>) {
        let (inner, job) = (&*self.inner, &self.job);
        let change = match outcome {
            Ok(result) => Change::Succeed(result),
            Err(WorkError::Failure(failure)) => failed(failure.kind, failure.message),
            Err(WorkError::Job(error)) => match self.change_of(&error) {
                Some(change) => change,
                // Its caller cancelled it.
                None => {
                    self.activity.set_outcome(JobOutcome::Cancelled);
                    inner.runtime.block_on(inner.unpin_unneeded(job.id));
                    return;
                }
            },
        };
        match &change {
            Change::Succeed(_) => {}
            Change::Release => self.activity.set_outcome(JobOutcome::Released),
            _ => self.activity.set_outcome(JobOutcome::Failed),
        }
        let name = change.transition();
        inner.runtime.block_on(async {
            let (done, kept) = tokio::sync::oneshot::channel();
            if inner.progress.send(ProgressCommand::Flush(done)).await.is_ok() {
                let _ = tokio::time::timeout(FLUSH_TIMEOUT, kept).await;
            }
            let changed = inner.keep_end(job, change, &self.token).await;
            match &changed {
                Ok(_) => tracing::info!(id = %job.id, outcome = ?name, "a job ended"),
                Err(error) if is_outdated(error) => {}
                Err(error) => tracing::error!(id = %job.id, %error, "the end of a job could not be kept"),
            }
            if changed.is_err() {
                // The store may have let go of the job before this result was pinned.
                inner.unpin_unneeded(job.id).await;
            }
        });
    }

    /// What becomes of a job that was stopped or failed; nothing if somebody else has said so.
    fn change_of(&self, error: &JobError) -> Option<Change> {
        let (job, text) = (&self.job, error.to_string());
        let stopped = self.token.stopped().or(match error.as_rvd() {
            Some(RvdError::Stopped(reason)) => Some(*reason),
            _ => None,
        });
        match stopped {
            Some(Stopped::Cancelled) if self.inner.is_draining() => return Some(Change::Release),
            Some(Stopped::Cancelled) => return None,
            Some(Stopped::Time { limit }) if job.spec.task().deadlines.run.is_some_and(|own| own <= limit) => {
                return Some(Change::Expire(Cause::RunDeadline));
            }
            Some(Stopped::Time { .. } | Stopped::Memory { .. }) => return Some(failed(FailureKind::TooLarge, text)),
            None => {}
        }
        Some(match error {
            JobError::Draining => Change::Release,
            JobError::QueueFull { .. } => failed(FailureKind::Unavailable, text),
            JobError::Panicked(what) => {
                tracing::error!(id = %job.id, %what, "work panicked");
                failed(FailureKind::Internal, "the work failed by a fault of the server; its log says where")
            }
            JobError::WorkerGone => failed(FailureKind::Internal, "the work was lost by a fault of the server"),
            JobError::Mesh(_) => failed(FailureKind::BadInput, text),
            JobError::Rvd(error) | JobError::Remesh(RemeshError::Rvd(error)) => match error {
                RvdError::OutOfMemory { .. } | RvdError::NeverFits { .. } => failed(FailureKind::TooLarge, text),
                // The process ends; the next one, or another machine, has a device.
                RvdError::DeviceLost(_) if is_ending(&self.inner) => Change::Release,
                RvdError::DeviceLost(_) | RvdError::BackendUnavailable { .. } => failed(FailureKind::Unavailable, text),
                RvdError::Device(_) | RvdError::Internal(_) => {
                    tracing::error!(id = %job.id, %text, "work failed");
                    failed(FailureKind::Internal, "the work failed by a fault of the server; its log says why")
                }
                _ => failed(FailureKind::BadInput, text),
            },
            JobError::Remesh(_) => failed(FailureKind::BadInput, text),
        })
    }
}
