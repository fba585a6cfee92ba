//! The stores of one process: operations on tables, with a clock.
//!
//! Purpose: [`Container`] is what a store of one process needs for all of [`JobStore`]. [`MemoryStore`] is one whose jobs are gone
//! with the process: for `--ephemeral`, and for jobs of the streams. Invariant: an operation that writes sees no other under
//! way; the lock of the store in memory is held for one operation. Must not know: what operations do.

use std::collections::BTreeMap;
use std::ops::{Bound, ControlFlow};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use super::tables::{Live, Order, Table, Tables, TablesMut, Visit, Waiters};
use super::{
    Answer, Clock, Created, JobStore, NewJob, Offer, Orphans, Page, Query, Recovered, Retention, StoreError, Swept,
    operations as ops,
};
use crate::beside::Beside;
use crate::blob::Digest;
use crate::blob::index::{BlobIndex, LocalIndex};
use crate::lock;
use crate::record::event::{Events, Log, Progress};
use crate::record::{Change, Job, JobId, Spec, Time};

pub(crate) trait Container: Send + Sync {
    /// Changes the tables at the time of the clock.
    fn write<T: Send + 'static>(
        &self,
        operation: impl FnOnce(&mut dyn TablesMut, &mut Live, Time) -> Result<T, StoreError> + Send + 'static,
    ) -> Answer<'_, T>;

    /// Reads. With `live`, the operation also gets that job's progress, as it was before the tables: it may follow on a
    /// state that is in them by now, and must not be seen without.
    fn read<T: Send + 'static>(
        &self,
        live: Option<JobId>,
        operation: impl FnOnce(&dyn Tables, Option<Log>) -> Result<T, StoreError> + Send + 'static,
    ) -> Answer<'_, T>;

    fn waiters(&self) -> &Waiters;

    fn index(&self) -> &Arc<LocalIndex>;

    /// The count of work beside the jobs, and whether there was some when the last process went down.
    fn beside(&self) -> (Beside, bool);
}

impl<C: Container> JobStore for C {
    fn index(&self) -> Arc<dyn BlobIndex> {
        Container::index(self).clone()
    }

    fn create(&self, job: NewJob) -> Answer<'_, Created> {
        self.write(|tables, live, now| ops::create(tables, live, job, now))
    }

    fn requested(&self, spec: Spec) -> Answer<'_, Option<Job>> {
        self.read(None, move |tables, _| ops::requested(tables, &spec))
    }

    fn same(&self, tenant: String, fingerprint: Digest) -> Answer<'_, Option<Job>> {
        self.read(None, move |tables, _| ops::same(tables, &tenant, fingerprint))
    }

    fn get(&self, id: JobId) -> Answer<'_, Job> {
        self.read(None, move |tables, _| ops::get(tables, id))
    }

    fn list(&self, query: Query) -> Answer<'_, Page> {
        self.read(None, move |tables, _| ops::list(tables, &query))
    }

    fn claim_next(&self, offer: Offer) -> Answer<'_, Option<Job>> {
        self.write(|tables, live, now| ops::claim_next(tables, live, offer, now))
    }

    fn renew(&self, id: JobId, at: u64, lease: Duration) -> Answer<'_, ()> {
        self.write(move |tables, _, now| ops::renew(tables, id, at, now.after(lease)))
    }

    fn change(&self, id: JobId, at: u64, change: Change) -> Answer<'_, Job> {
        self.write(move |tables, live, now| ops::change(tables, live, (id, Some(at)), change, now))
    }

    fn cancel(&self, id: JobId) -> Answer<'_, Job> {
        self.write(move |tables, live, now| ops::cancel(tables, live, id, now))
    }

    fn progress(&self, id: JobId, at: u64, progress: Progress) -> Answer<'_, u64> {
        self.write(move |tables, live, now| ops::progress(tables, live, (id, at), progress, now))
    }

    fn events(&self, id: JobId, after: u64, most: usize) -> Answer<'_, Events> {
        self.read(Some(id), move |tables, progress| ops::events(tables, progress.as_ref(), id, after, most))
    }

    fn wait(&self, id: JobId, after: u64) -> Answer<'_, ()> {
        Box::pin(self.waiters().until(self, (id, after), None))
    }

    fn delete(&self, id: JobId) -> Answer<'_, ()> {
        self.write(move |tables, live, _| ops::delete(tables, live, id))
    }

    fn expire(&self, keep: Retention, most: usize) -> Answer<'_, Swept> {
        self.write(move |tables, live, now| ops::expire(tables, live, now, keep, most))
    }

    fn recover(&self, orphans: Orphans, max_crashes: u32) -> Answer<'_, Recovered> {
        let (_, had_others) = Container::beside(self);
        self.write(move |tables, live, now| ops::recover(tables, live, now, orphans, (max_crashes, had_others)))
    }

    fn beside(&self) -> Beside {
        Container::beside(self).0
    }
}

#[derive(Debug)]
pub struct MemoryStore {
    contents: Mutex<Contents>,
    index: Arc<LocalIndex>,
    waiters: Waiters,
    clock: Clock,
}

#[derive(Debug)]
struct Contents {
    tables: Trees,
    live: Live,
}

#[derive(Debug, Default)]
struct Trees([BTreeMap<Vec<u8>, Vec<u8>>; Table::ALL.len()]);

impl Tables for Trees {
    fn get(&self, table: Table, key: &[u8]) -> Result<Option<Vec<u8>>, StoreError> {
        Ok(self.0[table as usize].get(key).cloned())
    }

    fn visit(
        &self,
        table: Table,
        (from, to): (&[u8], &[u8]),
        order: Order,
        visit: &mut Visit<'_>,
    ) -> Result<(), StoreError> {
        let mut range = self.0[table as usize].range::<[u8], _>((Bound::Included(from), Bound::Excluded(to)));
        while let Some((key, value)) = if order == Order::Up { range.next() } else { range.next_back() } {
            if let ControlFlow::Break(()) = visit(key, value)? {
                break;
            }
        }
        Ok(())
    }
}

impl TablesMut for Trees {
    fn put(&mut self, table: Table, key: &[u8], value: &[u8]) -> Result<(), StoreError> {
        self.0[table as usize].insert(key.to_vec(), value.to_vec());
        Ok(())
    }

    fn remove(&mut self, table: Table, key: &[u8]) -> Result<(), StoreError> {
        self.0[table as usize].remove(key);
        Ok(())
    }
}

impl MemoryStore {
    /// A store without jobs, with this clock.
    pub fn with_clock(clock: Clock) -> Self {
        let index = Arc::<LocalIndex>::default();
        let contents = Contents { tables: Trees::default(), live: Live::new(Arc::clone(&index)) };
        Self { contents: Mutex::new(contents), index, waiters: Waiters::default(), clock }
    }
}

impl Default for MemoryStore {
    fn default() -> Self {
        Self::with_clock(Clock::default())
    }
}

impl Container for MemoryStore {
    fn write<T: Send + 'static>(
        &self,
        operation: impl FnOnce(&mut dyn TablesMut, &mut Live, Time) -> Result<T, StoreError> + Send + 'static,
    ) -> Answer<'_, T> {
        let touched;
        let result = {
            let mut contents = lock(&self.contents);
            let Contents { tables, live } = &mut *contents;
            let result = operation(tables, live, self.clock.now());
            touched = std::mem::take(&mut live.touched);
            live.pins.settle();
            result
        };
        self.waiters.wake(&touched);
        Box::pin(std::future::ready(result))
    }

    fn read<T: Send + 'static>(
        &self,
        live: Option<JobId>,
        operation: impl FnOnce(&dyn Tables, Option<Log>) -> Result<T, StoreError> + Send + 'static,
    ) -> Answer<'_, T> {
        let contents = lock(&self.contents);
        let progress = live.and_then(|id| contents.live.jobs.get(&id)).map(|entry| entry.log.clone());
        Box::pin(std::future::ready(operation(&contents.tables, progress)))
    }

    fn waiters(&self) -> &Waiters {
        &self.waiters
    }

    fn index(&self) -> &Arc<LocalIndex> {
        &self.index
    }

    // Nothing outlives the process.
    fn beside(&self) -> (Beside, bool) {
        (Beside::default(), false)
    }
}
