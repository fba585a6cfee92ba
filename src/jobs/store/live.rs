//! Progress of running jobs that is not in the tables yet, and waits for events.
//!
//! Purpose: [`Live`]: iterations come often and matter little, so they are kept in memory until the state changes.
//! Invariant: an entry is of the attempt that runs. Numbers are given away only below what the head has reserved.
//! [`Waiters`] wakes waits once the event can be read. Must not know: tables, clocks.

use std::collections::HashMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

use tokio::sync::watch;

use super::{JobStore, StoreError};
use crate::record::JobId;
use crate::record::event::Log;

/// Progress of one running job.
#[derive(Clone, Debug, Default)]
pub(crate) struct Entry {
    /// The next number that is given away.
    pub next: u64,
    /// What came since the state changed.
    pub log: Log,
}

/// See the module's head.
#[derive(Debug, Default)]
pub(crate) struct Live {
    pub jobs: HashMap<JobId, Entry>,
    /// Jobs with something new to be seen: an event, or their end.
    pub touched: Vec<JobId>,
}

impl Live {
    /// Takes the progress of a job whose state changes.
    pub(crate) fn take(&mut self, id: JobId) -> Option<Entry> {
        self.jobs.remove(&id)
    }
}

/// Waits, by job.
#[derive(Debug, Default)]
pub(crate) struct Waiters(Mutex<HashMap<JobId, watch::Sender<()>>>);

impl Waiters {
    /// From now on changes of the job are seen by what is returned.
    pub(crate) fn join(&self, id: JobId) -> watch::Receiver<()> {
        self.lock().entry(id).or_insert_with(|| watch::channel(()).0).subscribe()
    }

    /// Wakes the waits for these.
    pub(crate) fn wake(&self, ids: &[JobId]) {
        let mut waiters = self.lock();
        if waiters.is_empty() {
            return;
        }
        for id in ids {
            if waiters.get(id).is_some_and(|sender| sender.send(()).is_err()) {
                waiters.remove(id);
            }
        }
    }

    /// Forgets a job without waits.
    pub(crate) fn leave(&self, id: JobId) {
        let mut waiters = self.lock();
        if waiters.get(&id).is_some_and(|sender| sender.receiver_count() == 0) {
            waiters.remove(&id);
        }
    }

    /// Ends once the job has an event after number `after`, or is gone.
    pub(crate) async fn until(&self, store: &dyn JobStore, id: JobId, after: u64) -> Result<(), StoreError> {
        let mut changes = Place { waiters: self, id, changes: Some(self.join(id)) };
        loop {
            if !store.events(id, after, 1).await?.events.is_empty() {
                return Ok(());
            }
            if let Some(changes) = &mut changes.changes {
                changes.changed().await.map_err(|_| StoreError::Closed)?;
            }
        }
    }

    /// Wakes everybody: the store is closing.
    pub(crate) fn close(&self) {
        self.lock().clear();
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<JobId, watch::Sender<()>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A wait, which may be dropped at any time.
struct Place<'a> {
    waiters: &'a Waiters,
    id: JobId,
    changes: Option<watch::Receiver<()>>,
}

impl Drop for Place<'_> {
    fn drop(&mut self) {
        self.changes = None;
        self.waiters.leave(self.id);
    }
}
