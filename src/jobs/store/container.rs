//! The stores of one process: operations on tables, with a clock.
//!
//! Purpose: [`Container`] is what a store of one process needs for all of [`JobStore`]. Invariant: an operation that writes
//! sees no other under way. Must not know: what operations do.

use super::live::{Live, Waiters};
use super::tables::{Tables, TablesMut};
use super::{
    Answer, Created, JobStore, NewJob, Offer, Orphans, Page, Query, Recovered, Retention, StoreError, Swept,
    operations as ops,
};
use crate::record::event::{Events, Log, Progress};
use crate::record::{Change, Job, JobId, Spec, Time};
use std::time::Duration;

/// See the module's head.
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

    /// Those that wait for events.
    fn waiters(&self) -> &Waiters;
}

impl<C: Container> JobStore for C {
    fn create(&self, job: NewJob) -> Answer<'_, Created> {
        self.write(|tables, live, now| ops::create(tables, live, job, now))
    }

    fn requested(&self, spec: Spec) -> Answer<'_, Option<Job>> {
        self.read(None, move |tables, _| ops::requested(tables, &spec))
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
        Box::pin(self.waiters().until(self, id, after))
    }

    fn delete(&self, id: JobId) -> Answer<'_, ()> {
        self.write(move |tables, live, _| ops::delete(tables, live, id))
    }

    fn expire(&self, keep: Retention, most: usize) -> Answer<'_, Swept> {
        self.write(move |tables, live, now| ops::expire(tables, live, now, keep, most))
    }

    fn recover(&self, orphans: Orphans, max_crashes: u32) -> Answer<'_, Recovered> {
        self.write(move |tables, live, now| ops::recover(tables, live, now, orphans, max_crashes))
    }
}
