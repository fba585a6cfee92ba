//! Jobs in a PostgreSQL database that several servers share.
//!
//! Purpose: [`PostgresStore`] is a [`JobStore`]. Each operation is one short transaction: it reads a row for update, decides by
//! the same machine as every store, and writes. [`migrations`] has the schema, [`pool`] the connections, [`jobs`] and [`upkeep`]
//! the operations, [`index`] the blobs. Invariant: what was answered is committed; after [`StoreError::Unavailable`] it is unknown
//! until the job is read again, and a request with a number can be repeated. Only the database's clock decides. Progress is
//! kept at once, and may be lost only with its day. Must not know: messages, how jobs are done.

mod cluster;
mod index;
mod jobs;
mod listen;
mod migrations;
mod operator;
mod pool;
mod rows;
mod upkeep;

use std::collections::{BTreeMap, HashMap};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use tokio::sync::watch;
use tokio::task::JoinHandle;

pub use operator::{Checked, Operator};
pub use pool::PostgresOptions;

use crate::beside::Beside;
use crate::blob::Digest;
use crate::blob::index::BlobIndex;
use crate::lock;
use crate::record::event::{Events, Progress};
use crate::record::{Change, Job, JobId, Spec};
use crate::store::shared::{Document, Node, Overview, Unschedulable};
use crate::store::{
    Answer, Created, JobStore, NewJob, Offer, Orphans, Page, Query, Recovered, Retention, SharedStore, StoreError,
    Swept, Waiters,
};
use index::PostgresIndex;
use jobs::Work;
use listen::{Ears, Voice};
use pool::Database;

/// A wait looks this often, woken or not: progress wakes nothing.
const POLL: Duration = Duration::from_millis(500);
/// How often the days of progress are looked at.
const DAYS: Duration = Duration::from_secs(600);

/// See the module's head. It belongs to the runtime in which it was opened.
#[derive(Debug)]
pub struct PostgresStore {
    database: Database,
    index: Arc<PostgresIndex>,
    holder: String,
    silence: Duration,
    waiters: Arc<Waiters>,
    /// Changes when jobs may have come to wait.
    work: Arc<watch::Sender<()>>,
    voice: Voice,
    /// Servers that are alive beside this one.
    others: Arc<AtomicU32>,
    listener: JoinHandle<()>,
    /// When the days of progress were last looked at.
    days: Mutex<Instant>,
}

impl PostgresStore {
    /// Connects, and brings the schema of the database up to date. Errors: `Unusable`, `Unavailable`, `UnknownVersion`.
    pub async fn open(options: PostgresOptions) -> Result<Self, StoreError> {
        let database = Database::open(&options).await?;
        turn_days(&database).await?;
        let index = Arc::new(PostgresIndex::new(database.clone(), options.same_use));
        let waiters = Arc::<Waiters>::default();
        let work = Arc::new(watch::Sender::new(()));
        let others = Arc::<AtomicU32>::default();
        let ears = Ears { waiters: Arc::clone(&waiters), work: Arc::clone(&work), others: Arc::clone(&others) };
        let listener = tokio::spawn(listen::listen(Database::apart(&options)?, ears.clone()));
        let voice = Voice::new(database.pool().clone(), ears);
        let PostgresOptions { holder, silence, .. } = options;
        let days = Mutex::new(Instant::now());
        Ok(Self { database, index, holder, silence, waiters, work, voice, others, listener, days })
    }

    async fn keep_days(&self) {
        {
            let mut days = lock(&self.days);
            if days.elapsed() < DAYS {
                return;
            }
            *days = Instant::now();
        }
        if let Err(error) = turn_days(&self.database).await {
            tracing::warn!(%error, "progress of earlier days could not be let go of");
        }
    }
}

/// Makes room for the progress of the days to come, and lets go of that of the days before.
async fn turn_days(database: &Database) -> Result<(), StoreError> {
    sqlx::query("select tessera.turn_days()").execute(database.pool()).await?;
    Ok(())
}

/// An operation in a transaction of its own. A closure's future could not be seen to be `Send`.
macro_rules! transaction {
    ($store:ident . $run:ident, |$work:ident| $operation:expr) => {
        Box::pin($store.database.$run(async move {
            let mut $work = Work::begin(&$store.database).await?;
            let done = $operation.await;
            $work.end(done, Some(&$store.voice)).await
        }))
    };
}

/// What needs no transaction.
macro_rules! connection {
    ($store:ident, |$connection:ident| $operation:expr) => {
        Box::pin($store.database.run(async move {
            let mut acquired = $store.database.pool().acquire().await?;
            let $connection = &mut *acquired;
            $operation.await
        }))
    };
}

impl JobStore for PostgresStore {
    fn index(&self) -> Arc<dyn BlobIndex> {
        self.index.clone()
    }

    fn create(&self, job: NewJob) -> Answer<'_, Created> {
        transaction!(self.run, |work| work.create(job))
    }

    fn requested(&self, spec: Spec) -> Answer<'_, Option<Job>> {
        connection!(self, |connection| jobs::requested(connection, &spec))
    }

    fn same(&self, tenant: String, fingerprint: Digest) -> Answer<'_, Option<Job>> {
        connection!(self, |connection| jobs::same(connection, &tenant, fingerprint))
    }

    fn get(&self, id: JobId) -> Answer<'_, Job> {
        connection!(self, |connection| jobs::get(connection, id))
    }

    fn list(&self, query: Query) -> Answer<'_, Page> {
        connection!(self, |connection| jobs::list(connection, &query))
    }

    fn claim_next(&self, offer: Offer) -> Answer<'_, Option<Job>> {
        transaction!(self.run, |work| work.claim_next(offer))
    }

    fn renew(&self, id: JobId, at: u64, lease: Duration) -> Answer<'_, ()> {
        connection!(self, |connection| jobs::renew(connection, id, at, lease))
    }

    fn change(&self, id: JobId, at: u64, change: Change) -> Answer<'_, Job> {
        transaction!(self.run, |work| work.change(id, at, change))
    }

    fn cancel(&self, id: JobId) -> Answer<'_, Job> {
        transaction!(self.run, |work| work.cancel(id))
    }

    fn progress(&self, id: JobId, at: u64, progress: Progress) -> Answer<'_, u64> {
        connection!(self, |connection| jobs::progress(connection, id, at, progress))
    }

    fn events(&self, id: JobId, after: u64, most: usize) -> Answer<'_, Events> {
        connection!(self, |connection| jobs::events(connection, id, after, most))
    }

    fn wait(&self, id: JobId, after: u64) -> Answer<'_, ()> {
        Box::pin(self.waiters.until(self, (id, after), Some(POLL)))
    }

    fn delete(&self, id: JobId) -> Answer<'_, ()> {
        transaction!(self.run, |work| work.delete(id))
    }

    fn expire(&self, keep: Retention, most: usize) -> Answer<'_, Swept> {
        Box::pin(async move {
            self.keep_days().await;
            upkeep::pulse(&self.database, self.silence).await?;
            transaction!(self.run_long, |work| work.expire(keep, most)).await
        })
    }

    fn recover(&self, orphans: Orphans, max_crashes: u32) -> Answer<'_, Recovered> {
        Box::pin(async move {
            let since = upkeep::pulse(&self.database, self.silence).await?;
            transaction!(self.run_long, |work| work.recover(orphans, (&self.holder, since), max_crashes)).await
        })
    }

    // What goes down with this process is seen by its leases.
    fn beside(&self) -> Beside {
        Beside::default()
    }

    fn shared(&self) -> Option<&dyn SharedStore> {
        Some(self)
    }
}

impl SharedStore for PostgresStore {
    fn holder(&self) -> &str {
        &self.holder
    }

    fn work(&self) -> watch::Receiver<()> {
        self.work.subscribe()
    }

    fn waiting(&self) -> Answer<'_, HashMap<String, usize>> {
        connection!(self, |connection| jobs::waiting(connection))
    }

    fn beat(&self, node: Node) -> Answer<'_, bool> {
        connection!(self, |connection| async {
            let (drain, others) = cluster::beat(connection, (&self.holder, self.index.process), &node).await?;
            self.others.store(others, Ordering::Relaxed);
            Ok(drain)
        })
    }

    fn sweeps(&self) -> Answer<'_, bool> {
        connection!(self, |connection| cluster::sweeps(connection))
    }

    fn share_calls(&self, open: BTreeMap<String, u32>) -> Answer<'_, BTreeMap<String, u32>> {
        connection!(self, |connection| cluster::share_calls(connection, &self.holder, open))
    }

    fn document(&self, name: &'static str) -> Answer<'_, Option<Document>> {
        connection!(self, |connection| cluster::document(connection, name))
    }

    fn leave(&self) -> Answer<'_, ()> {
        connection!(self, |connection| cluster::leave(connection, &self.holder))
    }

    fn overview(&self) -> Answer<'_, Overview> {
        connection!(self, |connection| cluster::overview(connection))
    }

    fn unschedulable(&self, id: JobId) -> Answer<'_, Option<Unschedulable>> {
        connection!(self, |connection| cluster::unschedulable(connection, id))
    }
}

impl Drop for PostgresStore {
    fn drop(&mut self) {
        self.listener.abort();
        self.waiters.close();
    }
}
