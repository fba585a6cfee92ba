//! What the operations need of a container: a few ordered tables of bytes, and progress that is not in them yet.
//!
//! | table | key | value |
//! | --- | --- | --- |
//! | heads | job | tenant, labels, request, status, numbers of events |
//! | specs | job | the specification |
//! | logs | job | state changes, and the progress kept at the last of them |
//! | requests | tenant, 0, request | job |
//! | states | state, job | nothing |
//! | due | time, job | nothing: jobs with a deadline that runs |
//! | ended | time, job | 1 if there is a result: jobs that have ended |
//! | line | priority, job | nothing: jobs that wait |
//! | terms | label or tenant, job | nothing: for lists |
//! | same | tenant, 0, fingerprint, job | nothing: results that are kept |
//!
//! Purpose: [`Tables`], so that the stores of one process share their operations; [`Live`]: iterations come often and matter
//! little, so they are kept in memory until the state changes; pins follow from the tables. Invariant: keys are in the order of their bytes. An entry of
//! [`Live`] is of the attempt that runs; its numbers are below what the head has reserved. [`Waiters`] wakes waits once the event
//! can be read. Must not know: what the bytes mean, clocks.

use std::collections::HashMap;
use std::ops::ControlFlow;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use strum::VariantArray;
use tokio::sync::watch;

use super::pins::Pins;
use super::{JobStore, StoreError};
use crate::blob::index::LocalIndex;
use crate::lock;
use crate::record::JobId;
use crate::record::event::Log;

#[derive(Clone, Copy, Debug, PartialEq, Eq, strum::IntoStaticStr, VariantArray)]
#[strum(serialize_all = "snake_case")]
pub(crate) enum Table {
    Heads,
    Specs,
    Logs,
    Requests,
    States,
    Due,
    Ended,
    Terms,
    Line,
    Same,
}

impl Table {
    pub(crate) const ALL: &[Self] = Self::VARIANTS;

    pub(crate) fn name(self) -> &'static str {
        self.into()
    }
}

/// Which way a range is visited.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Order {
    Up,
    Down,
}

pub(crate) type Visit<'a> = dyn FnMut(&[u8], &[u8]) -> Result<ControlFlow<()>, StoreError> + 'a;

pub(crate) trait Tables {
    fn get(&self, table: Table, key: &[u8]) -> Result<Option<Vec<u8>>, StoreError>;

    /// Visits keys from `from` to before `to` until told to break.
    fn visit(&self, table: Table, range: (&[u8], &[u8]), order: Order, visit: &mut Visit<'_>)
    -> Result<(), StoreError>;
}

pub(crate) trait TablesMut: Tables {
    fn put(&mut self, table: Table, key: &[u8], value: &[u8]) -> Result<(), StoreError>;
    fn remove(&mut self, table: Table, key: &[u8]) -> Result<(), StoreError>;
}

#[derive(Clone, Debug, Default)]
pub(crate) struct Entry {
    /// The next number that is given away.
    pub next: u64,
    /// What came since the state changed.
    pub log: Log,
}

#[derive(Debug, Default)]
pub(crate) struct Live {
    pub jobs: HashMap<JobId, Entry>,
    /// Jobs with something new to be seen: an event, or their end.
    pub touched: Vec<JobId>,
    pub(super) pins: Pins,
}

impl Live {
    pub(crate) fn new(index: Arc<LocalIndex>) -> Self {
        Self { pins: Pins::new(index), ..Self::default() }
    }
}

/// Waits, by job.
#[derive(Debug, Default)]
pub(crate) struct Waiters(Mutex<HashMap<JobId, watch::Sender<()>>>);

impl Waiters {
    /// From now on changes of the job are seen by what is returned.
    pub(crate) fn join(&self, id: JobId) -> watch::Receiver<()> {
        lock(&self.0).entry(id).or_insert_with(|| watch::channel(()).0).subscribe()
    }

    pub(crate) fn wake(&self, ids: &[JobId]) {
        let mut waiters = lock(&self.0);
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
        let mut waiters = lock(&self.0);
        if waiters.get(&id).is_some_and(|sender| sender.receiver_count() == 0) {
            waiters.remove(&id);
        }
    }

    /// Wakes everybody: something may have been missed.
    #[cfg(feature = "postgres")]
    pub(crate) fn wake_all(&self) {
        lock(&self.0).retain(|_, sender| sender.send(()).is_ok());
    }

    /// Ends once the job has an event after number `after`, or is gone. With `poll`, also looks without being woken.
    pub(crate) async fn until(
        &self,
        store: &dyn JobStore,
        (id, after): (JobId, u64),
        poll: Option<Duration>,
    ) -> Result<(), StoreError> {
        let mut changes = Place { waiters: self, id, changes: Some(self.join(id)) };
        loop {
            if !store.events(id, after, 1).await?.events.is_empty() {
                return Ok(());
            }
            if let Some(changes) = &mut changes.changes {
                let changed = changes.changed();
                let woken = match poll {
                    Some(time) => tokio::time::timeout(time, changed).await.unwrap_or(Ok(())),
                    None => changed.await,
                };
                woken.map_err(|_| StoreError::Closed)?;
            }
        }
    }

    /// Wakes everybody: the store is closing.
    pub(crate) fn close(&self) {
        lock(&self.0).clear();
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
