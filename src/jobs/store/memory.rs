//! Jobs in memory, gone with the process: for `--ephemeral`, and for jobs of the streams.
//!
//! Invariant: one lock, held for one operation; no wait under it. Must not know: what operations do.

use std::collections::BTreeMap;
use std::ops::{Bound, ControlFlow};
use std::sync::{Mutex, MutexGuard, PoisonError};

use super::container::Container;
use super::live::{Live, Waiters};
use super::tables::{Order, Table, Tables, TablesMut, Visit};
use super::{Answer, Clock, StoreError};
use crate::record::event::Log;
use crate::record::{JobId, Time};

/// See the module's head.
#[derive(Debug, Default)]
pub struct MemoryStore {
    contents: Mutex<Contents>,
    waiters: Waiters,
    clock: Clock,
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
    /// A store without jobs, with this clock.
    pub fn with_clock(clock: Clock) -> Self {
        Self { clock, ..Self::default() }
    }

    fn lock(&self) -> MutexGuard<'_, Contents> {
        self.contents.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Container for MemoryStore {
    fn write<T: Send + 'static>(
        &self,
        operation: impl FnOnce(&mut dyn TablesMut, &mut Live, Time) -> Result<T, StoreError> + Send + 'static,
    ) -> Answer<'_, T> {
        let touched;
        let result = {
            let mut contents = self.lock();
            let Contents { tables, live } = &mut *contents;
            let result = operation(tables, live, self.clock.now());
            touched = std::mem::take(&mut live.touched);
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
        let contents = self.lock();
        let progress = live.and_then(|id| contents.live.jobs.get(&id)).map(|entry| entry.log.clone());
        Box::pin(std::future::ready(operation(&contents.tables, progress)))
    }

    fn waiters(&self) -> &Waiters {
        &self.waiters
    }
}
