//! Jobs in memory, gone with the process: for `--ephemeral`, and for jobs of the streams.
//!
//! Invariant: one lock, held for one operation; nobody waits under it. Must not know: what operations do.

use std::collections::BTreeMap;
use std::ops::{Bound, ControlFlow};
use std::sync::{Mutex, MutexGuard, PoisonError};

use super::live::{Live, Waiters};
use super::tables::{Order, Table, Tables, TablesMut, Visit};
use super::{
    Answer, Created, JobStore, NewJob, Orphans, Page, Query, Recovered, Retention, StoreError, Swept, operations as ops,
};
use crate::event::{Events, Progress};
use crate::record::{Change, Holder, Job, JobId, Time, ValidSpec};

/// See the module's head.
#[derive(Debug, Default)]
pub struct MemoryStore {
    contents: Mutex<Contents>,
    waiters: Waiters,
}

#[derive(Debug, Default)]
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
    /// Without jobs.
    pub fn new() -> Self {
        Self::default()
    }

    fn lock(&self) -> MutexGuard<'_, Contents> {
        self.contents.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn write<T: Send + 'static>(
        &self,
        operation: impl FnOnce(&mut dyn TablesMut, &mut Live) -> Result<T, StoreError> + Send,
    ) -> Answer<'_, T> {
        let touched;
        let result = {
            let mut contents = self.lock();
            let Contents { tables, live } = &mut *contents;
            let result = operation(tables, live);
            touched = std::mem::take(&mut live.touched);
            result
        };
        self.waiters.wake(&touched);
        Box::pin(std::future::ready(result))
    }
}

impl JobStore for MemoryStore {
    fn create(&self, job: NewJob) -> Answer<'_, Created> {
        self.write(|tables, live| ops::create(tables, live, job))
    }

    fn requested(&self, spec: ValidSpec) -> Answer<'_, Option<Job>> {
        let job = ops::requested(&self.lock().tables, &spec);
        Box::pin(std::future::ready(job))
    }

    fn get(&self, id: JobId) -> Answer<'_, Job> {
        let job = ops::get(&self.lock().tables, id);
        Box::pin(std::future::ready(job))
    }

    fn list(&self, query: Query) -> Answer<'_, Page> {
        let page = ops::list(&self.lock().tables, &query);
        Box::pin(std::future::ready(page))
    }

    fn claim(&self, id: JobId, holder: Holder, now: Time) -> Answer<'_, Job> {
        self.write(|tables, live| ops::change(tables, live, (id, None), Change::Claim(holder), now))
    }

    fn renew(&self, id: JobId, at: u64, until: Time) -> Answer<'_, ()> {
        self.write(|tables, _| ops::renew(tables, id, at, until))
    }

    fn change(&self, id: JobId, at: u64, change: Change, now: Time) -> Answer<'_, Job> {
        self.write(|tables, live| ops::change(tables, live, (id, Some(at)), change, now))
    }

    fn cancel(&self, id: JobId, now: Time) -> Answer<'_, Job> {
        self.write(|tables, live| ops::cancel(tables, live, id, now))
    }

    fn progress(&self, id: JobId, at: u64, progress: Progress, now: Time) -> Answer<'_, u64> {
        self.write(|tables, live| ops::progress(tables, live, (id, at), progress, now))
    }

    fn events(&self, id: JobId, after: u64, most: usize) -> Answer<'_, Events> {
        let contents = self.lock();
        let progress = contents.live.jobs.get(&id).map(|entry| &entry.log);
        let events = ops::events(&contents.tables, progress, id, after, most);
        Box::pin(std::future::ready(events))
    }

    fn wait(&self, id: JobId, after: u64) -> Answer<'_, ()> {
        Box::pin(self.waiters.until(self, id, after))
    }

    fn delete(&self, id: JobId) -> Answer<'_, ()> {
        self.write(|tables, live| ops::delete(tables, live, id))
    }

    fn expire(&self, now: Time, keep: Retention, most: usize) -> Answer<'_, Swept> {
        self.write(|tables, live| ops::expire(tables, live, now, keep, most))
    }

    fn recover(&self, now: Time, orphans: Orphans, max_crashes: u32) -> Answer<'_, Recovered> {
        self.write(|tables, live| ops::recover(tables, live, now, orphans, max_crashes))
    }
}
