//! Threads for jobs.
//!
//! Purpose: [`Pools`] leases a CPU backend with threads of its own to each job at work. Invariant: no two jobs share a
//! pool. In a shared one a thread that waits within one job may begin another whole job, and the first then waits for the
//! second. Results do not depend on the number of threads. Must not know: jobs, the queue.

use std::ops::Deref;
use std::sync::{Arc, Mutex};

use crate::{Backends, PoolFactory, lock};
use geometry::rvd::Backend;

pub(crate) struct Pools {
    make: Option<PoolFactory>,
    /// Used where no other can be had.
    base: Arc<dyn Backend>,
    /// Threads of a job that is alone, and of one among others.
    all: usize,
    share: usize,
    free: Mutex<Vec<(usize, Arc<dyn Backend>)>>,
}

impl Pools {
    /// For `jobs` jobs at once.
    pub(crate) fn new(backends: &Backends, jobs: usize) -> Self {
        let all = backends.parallel.threads().max(1);
        Self {
            make: backends.pools,
            base: Arc::clone(&backends.parallel),
            all,
            share: (all / jobs).max(1),
            free: Mutex::default(),
        }
    }

    /// Threads for a job: all that the processor has if it is alone, else its share.
    pub(crate) fn take(&self, is_alone: bool) -> PoolLease<'_> {
        let threads = if is_alone { self.all } else { self.share };
        let mut free = lock(&self.free);
        let found = free.iter().position(|(count, _)| *count == threads).map(|at| free.swap_remove(at).1);
        drop(free);
        let made = || match self.make?(threads) {
            Ok(backend) => Some(backend),
            Err(error) => {
                tracing::warn!(%error, threads, "no threads for a job of its own; it shares those of others");
                None
            }
        };
        let own = found.or_else(made);
        let backend = own.as_ref().unwrap_or(&self.base).clone();
        PoolLease { pools: self, backend, own: own.map(|own| (threads, own)) }
    }
}

pub(crate) struct PoolLease<'a> {
    pools: &'a Pools,
    backend: Arc<dyn Backend>,
    own: Option<(usize, Arc<dyn Backend>)>,
}

impl PoolLease<'_> {
    /// Whether no other job has these threads.
    pub(crate) fn is_own(&self) -> bool {
        self.own.is_some()
    }
}

impl Deref for PoolLease<'_> {
    type Target = Arc<dyn Backend>;

    fn deref(&self) -> &Arc<dyn Backend> {
        &self.backend
    }
}

impl Drop for PoolLease<'_> {
    fn drop(&mut self) {
        lock(&self.pools.free).extend(self.own.take());
    }
}
