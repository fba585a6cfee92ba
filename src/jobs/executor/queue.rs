//! Jobs of the store that wait for their turn.
//!
//! Purpose: [`JobQueue`] is what the executor needs of a queue, and [`LocalQueue`] the one of this process: the engine's,
//! with its fair shares. Invariant: a job is in line once; what it is lies in the store, and a queue that is lost can be
//! filled from there. Must not know: stores, what a job does.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use async_trait::async_trait;

use crate::call::{ATTEMPTS, Retry, WorkContext};
use crate::engine::{Engine, Pending};
use crate::record::JobId;
use crate::{Admission, AdmissionRequest, Backends, JobError};

/// See the module's head. Nothing here assumes that the jobs are done by the process that put them in line.
#[async_trait]
pub(super) trait JobQueue: Send + Sync {
    /// Puts a job in line; it may be at work for `limit`.
    ///
    /// # Errors
    /// `Draining`.
    fn push(&self, id: JobId, request: AdmissionRequest, limit: Option<Duration>) -> Result<(), JobError>;

    /// Takes a job out of the line, and stops its work. One that is not in line is none of its business.
    fn remove(&self, id: JobId);

    /// How many are in line or at work.
    fn len(&self) -> usize;

    /// How many of them are this tenant's.
    fn len_of(&self, tenant: &str) -> usize;

    /// Whether it begins nothing more.
    fn is_draining(&self) -> bool;

    /// Begins nothing more. Ends once nothing is at work.
    async fn drain(&self);
}

/// Work on one job, called again after a lost device.
pub(super) type Work = Box<dyn FnMut(&Backends, &WorkContext) -> Result<(), JobError> + Send>;

/// The engine's queue.
pub(super) struct LocalQueue {
    engine: Engine,
    begin: Box<dyn Fn(JobId) -> Work + Send + Sync>,
    state: Arc<State>,
}

#[derive(Default)]
struct State {
    jobs: Mutex<Jobs>,
    draining: AtomicBool,
}

#[derive(Default)]
struct Jobs {
    entries: HashMap<JobId, Entry>,
    /// How many each tenant has.
    tenants: HashMap<Arc<str>, usize>,
}

impl Jobs {
    fn insert(&mut self, id: JobId, entry: Entry) {
        *self.tenants.entry(Arc::clone(&entry.tenant)).or_default() += 1;
        self.entries.insert(id, entry);
    }

    fn remove(&mut self, id: JobId) -> Option<Entry> {
        let entry = self.entries.remove(&id)?;
        if let Some(count) = self.tenants.get_mut(&entry.tenant) {
            *count -= 1;
            if *count == 0 {
                self.tenants.remove(&entry.tenant);
            }
        }
        Some(entry)
    }
}

struct Entry {
    tenant: Arc<str>,
    /// Dropping it cancels the work.
    pending: Pending<()>,
    running: bool,
}

impl State {
    fn lock(&self) -> MutexGuard<'_, Jobs> {
        self.jobs.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether it is still this job's turn.
    fn begins(&self, id: JobId) -> bool {
        match self.lock().entries.get_mut(&id) {
            Some(entry) if !self.draining.load(Ordering::Acquire) => {
                entry.running = true;
                true
            }
            _ => false,
        }
    }

    fn forget(&self, id: JobId) {
        let gone = self.lock().remove(id);
        drop(gone);
    }
}

impl LocalQueue {
    /// `begin` makes the work of a job when it is put in line.
    pub(super) fn new(engine: Engine, begin: impl Fn(JobId) -> Work + Send + Sync + 'static) -> Self {
        Self { engine, begin: Box::new(begin), state: Arc::default() }
    }
}

#[async_trait]
impl JobQueue for LocalQueue {
    fn push(&self, id: JobId, request: AdmissionRequest, limit: Option<Duration>) -> Result<(), JobError> {
        let (state, mut work, mut attempts) = (Arc::clone(&self.state), (self.begin)(id), 0);
        let go = move |backends: &Backends, context: &WorkContext| {
            attempts += 1;
            if attempts == 1 && !state.begins(id) {
                state.forget(id);
                return Ok(());
            }
            let done = work(backends, context);
            let again = done.as_ref().is_err_and(JobError::is_device_lost) && attempts < ATTEMPTS;
            if !again {
                state.forget(id);
            }
            done
        };
        // The lock is held until it is in the table: it may begin at once, and end.
        let mut jobs = self.state.lock();
        let tenant = Arc::clone(&request.tenant);
        let pending =
            self.engine.submit_as(self.engine.token_within(limit), Admission::Reserved(request), Retry::Restart, go)?;
        jobs.insert(id, Entry { tenant, pending, running: false });
        Ok(())
    }

    fn remove(&self, id: JobId) {
        let gone = self.state.lock().remove(id);
        if let Some(entry) = gone {
            entry.pending.token().cancel();
        }
    }

    fn len(&self) -> usize {
        self.state.lock().entries.len()
    }

    fn len_of(&self, tenant: &str) -> usize {
        self.state.lock().tenants.get(tenant).copied().unwrap_or(0)
    }

    fn is_draining(&self) -> bool {
        self.state.draining.load(Ordering::Acquire)
    }

    async fn drain(&self) {
        self.state.draining.store(true, Ordering::Release);
        // Those that only wait are out of the line; nothing counts them any more.
        self.state.lock().entries.retain(|_, entry| entry.running);
        while self.len() > 0 {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    }
}
