//! The journal: jobs in one file that survives the process and the machine's power.
//!
//! Purpose: [`RedbStore`]. One thread writes. It takes what waits, does it in one transaction, makes that durable with one
//! commit, and only then answers all of it. While a commit is on its way to the disk the next group gathers.
//! Invariant: what was answered is on the disk, and a group is there as a whole or not at all. Readers see committed groups
//! only. Progress of running jobs needs no commit: it is in memory, and gets into the journal with the next change of the job's
//! state. A failed commit ends the store, since it is unknown what of it the disk has. Must not know: what operations do.

mod directory;
pub(crate) mod repair;

use std::cell::Cell;
use std::collections::HashMap;
use std::ops::{Bound, ControlFlow};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use ::redb::{
    Database, Durability, ReadTransaction, ReadableDatabase, ReadableTable, StorageBackend, StorageError,
    TableDefinition, WriteTransaction,
};
use tokio::sync::{mpsc, oneshot};

use super::container::Container;
use super::tables::{Live, Order, Table, Tables, TablesMut, Visit, Waiters};
use super::{Answer, Clock, StoreError};
use crate::beside::Beside;
use crate::blob::index::LocalIndex;
use crate::lock;
use crate::record::event::Log;
use crate::record::{JobId, Time};
use directory::Directory;

/// Operations that wait for the writer; more wait for a place.
const WAITING: usize = 1024;
/// The most operations of one commit, so that the first of them does not wait long.
const GROUP: usize = 512;

/// The longest that a group gathers.
const PATIENCE: Duration = Duration::from_millis(2);

type Bytes = &'static [u8];

fn definition(table: Table) -> TableDefinition<'static, Bytes, Bytes> {
    TableDefinition::new(table.name())
}

#[derive(Clone, Debug)]
pub struct RedbOptions {
    /// Pages that are kept in memory, bytes.
    pub cache_bytes: usize,
    pub clock: Clock,
}

impl Default for RedbOptions {
    fn default() -> Self {
        Self { cache_bytes: 32 << 20, clock: Clock::default() }
    }
}

/// See the module's head. Dropping it ends the writer, once what waits is written.
#[derive(Debug)]
pub struct RedbStore {
    shared: Arc<Shared>,
    commands: Option<mpsc::Sender<Command>>,
    writer: Option<JoinHandle<()>>,
}

#[derive(Debug)]
struct Shared {
    database: Database,
    path: PathBuf,
    /// Progress as far as it can be seen: what the writer has, after the commit that it may depend on.
    progress: Mutex<HashMap<JobId, Log>>,
    waiters: Waiters,
    clock: Clock,
    index: Arc<LocalIndex>,
    beside: (Beside, bool),
    /// Held after the database, so dropped after it.
    _directory: Option<Directory>,
}

/// An operation. It gives the reply for its caller, which is sent once the group is committed.
type Command = Box<dyn FnOnce(&mut dyn TablesMut, &mut Live) -> Reply + Send>;
type Reply = Box<dyn FnOnce(Result<(), StoreError>) + Send>;

impl RedbStore {
    /// Opens the journal of a directory; makes both if they are not there. Nothing is recovered yet: `JobStore::recover`.
    /// Errors: `InUse`, `Damaged`, `UnknownVersion`, `Io`.
    pub fn open(directory: &Path, options: RedbOptions) -> Result<Self, StoreError> {
        let (directory, database) = Directory::open(directory, options.cache_bytes)?;
        Self::start(database, directory.journal(), options.clock, Some(directory))
    }

    /// A journal in something else than a file, as tests need it.
    pub fn with_backend(backend: impl StorageBackend, options: RedbOptions) -> Result<Self, StoreError> {
        let path = PathBuf::from("journal");
        let database = directory::database(&path, options.cache_bytes, |builder| builder.create_with_backend(backend))?;
        Self::start(database, path, options.clock, None)
    }

    fn start(
        database: Database,
        path: PathBuf,
        clock: Clock,
        directory: Option<Directory>,
    ) -> Result<Self, StoreError> {
        let (progress, waiters, index) = (Mutex::default(), Waiters::default(), Arc::default());
        let beside = directory.as_ref().map(Directory::beside).transpose()?.unwrap_or_default();
        let shared =
            Arc::new(Shared { database, path, progress, waiters, clock, index, beside, _directory: directory });
        shared.make_tables()?;
        let (commands, waiting) = mpsc::channel(WAITING);
        let writer = Writer { shared: Arc::clone(&shared), live: Live::new(Arc::clone(&shared.index)), broken: None };
        let spawned = std::thread::Builder::new().name("journal".to_owned()).spawn(move || writer.run(waiting));
        let writer = spawned.map_err(|cause| shared.io("start the thread that writes", &cause))?;
        Ok(Self { shared, commands: Some(commands), writer: Some(writer) })
    }

    fn send<T: Send + 'static>(
        &self,
        operation: impl FnOnce(&mut dyn TablesMut, &mut Live) -> Result<T, StoreError> + Send + 'static,
    ) -> Answer<'_, T> {
        let (sender, answer) = oneshot::channel();
        let command: Command = Box::new(move |tables, live| {
            let result = operation(tables, live);
            // A refusal counts only with the state that it saw, too.
            Box::new(move |committed| drop(sender.send(committed.and(result))))
        });
        Box::pin(async move {
            let commands = self.commands.as_ref().ok_or(StoreError::Closed)?;
            commands.send(command).await.map_err(|_| StoreError::Closed)?;
            answer.await.map_err(|_| StoreError::Closed)?
        })
    }
}

impl Container for RedbStore {
    fn write<T: Send + 'static>(
        &self,
        operation: impl FnOnce(&mut dyn TablesMut, &mut Live, Time) -> Result<T, StoreError> + Send + 'static,
    ) -> Answer<'_, T> {
        let clock = self.shared.clock.clone();
        self.send(move |tables, live| operation(tables, live, clock.now()))
    }

    fn read<T: Send + 'static>(
        &self,
        live: Option<JobId>,
        operation: impl FnOnce(&dyn Tables, Option<Log>) -> Result<T, StoreError> + Send + 'static,
    ) -> Answer<'_, T> {
        let shared = Arc::clone(&self.shared);
        let work = move || {
            let progress = live.and_then(|id| lock(&shared.progress).get(&id).cloned());
            operation(&shared.reading()?, progress)
        };
        Box::pin(async move {
            // Pages may have to come from the disk.
            match tokio::runtime::Handle::try_current() {
                Ok(runtime) => runtime.spawn_blocking(work).await.map_err(|_| StoreError::Closed)?,
                Err(_) => work(),
            }
        })
    }

    fn waiters(&self) -> &Waiters {
        &self.shared.waiters
    }

    fn index(&self) -> &Arc<LocalIndex> {
        &self.shared.index
    }

    fn beside(&self) -> (Beside, bool) {
        self.shared.beside.clone()
    }
}

impl Drop for RedbStore {
    fn drop(&mut self) {
        self.commands = None;
        self.shared.waiters.close();
        // It has no more to do than what waits; its caller has heard of a panic.
        drop(self.writer.take().map(JoinHandle::join));
    }
}

impl Shared {
    fn make_tables(&self) -> Result<(), StoreError> {
        let failed =
            |what: &dyn std::fmt::Display| StoreError::Damaged { path: self.path.clone(), what: what.to_string() };
        let transaction = self.database.begin_write().map_err(|e| failed(&e))?;
        for table in Table::ALL {
            transaction.open_table(definition(*table)).map_err(|e| failed(&e))?;
        }
        transaction.commit().map_err(|e| failed(&e))
    }

    fn io(&self, action: &'static str, cause: &dyn std::fmt::Display) -> StoreError {
        StoreError::Io { action, path: self.path.clone(), cause: cause.to_string() }
    }

    /// What reading said.
    fn store_error(&self, error: impl Into<::redb::Error>) -> StoreError {
        match error.into() {
            ::redb::Error::Corrupted(what) => StoreError::Damaged { path: self.path.clone(), what },
            error => self.io("read", &error),
        }
    }

    fn reading(&self) -> Result<Reading<'_>, StoreError> {
        let transaction = self.database.begin_read().map_err(|e| self.store_error(e))?;
        Ok(Reading { shared: self, transaction })
    }
}

struct Reading<'a> {
    shared: &'a Shared,
    transaction: ReadTransaction,
}

fn get(table: &impl ReadableTable<Bytes, Bytes>, key: &[u8]) -> Result<Option<Vec<u8>>, StorageError> {
    Ok(table.get(key)?.map(|guard| guard.value().to_vec()))
}

fn visit(
    shared: &Shared,
    table: &impl ReadableTable<Bytes, Bytes>,
    (from, to): (&[u8], &[u8]),
    order: Order,
    visit: &mut Visit<'_>,
) -> Result<(), StoreError> {
    let bounds = (Bound::Included(from), Bound::Excluded(to));
    let mut range = table.range::<&[u8]>(bounds).map_err(|e| shared.store_error(e))?;
    while let Some(entry) = if order == Order::Up { range.next() } else { range.next_back() } {
        let (key, value) = entry.map_err(|e| shared.store_error(e))?;
        if let ControlFlow::Break(()) = visit(key.value(), value.value())? {
            break;
        }
    }
    Ok(())
}

impl Tables for Reading<'_> {
    fn get(&self, table: Table, key: &[u8]) -> Result<Option<Vec<u8>>, StoreError> {
        let table = self.transaction.open_table(definition(table)).map_err(|e| self.shared.store_error(e))?;
        get(&table, key).map_err(|e| self.shared.store_error(e))
    }

    fn visit(&self, table: Table, range: (&[u8], &[u8]), order: Order, each: &mut Visit<'_>) -> Result<(), StoreError> {
        let table = self.transaction.open_table(definition(table)).map_err(|e| self.shared.store_error(e))?;
        visit(self.shared, &table, range, order, each)
    }
}

struct Writing<'t> {
    shared: &'t Shared,
    tables: Vec<::redb::Table<'t, Bytes, Bytes>>,
    /// Whether there is something to commit.
    is_changed: bool,
    /// Whether something could not be read: an operation may have stopped half-way.
    unread: Cell<bool>,
    /// Why nothing of this group may be committed.
    broken: Option<String>,
}

impl<'t> Writing<'t> {
    fn begin(shared: &'t Shared, transaction: &'t WriteTransaction) -> Result<Self, ::redb::TableError> {
        let tables = Table::ALL.iter().map(|table| transaction.open_table(definition(*table)));
        Ok(Self {
            shared,
            tables: tables.collect::<Result<_, _>>()?,
            is_changed: false,
            unread: Cell::new(false),
            broken: None,
        })
    }

    /// Whether there is something to commit, or why it must not be.
    fn outcome(mut self) -> Result<bool, String> {
        match self.broken.take() {
            Some(cause) => Err(cause),
            None if self.is_changed && self.unread.get() => Err("a page could not be read".to_owned()),
            None => Ok(self.is_changed),
        }
    }

    fn broke(&mut self, error: &StorageError) -> StoreError {
        let cause = error.to_string();
        self.broken = Some(cause.clone());
        StoreError::Broken { cause }
    }
}

impl Tables for Writing<'_> {
    fn get(&self, table: Table, key: &[u8]) -> Result<Option<Vec<u8>>, StoreError> {
        get(&self.tables[table as usize], key).map_err(|e| {
            self.unread.set(true);
            self.shared.store_error(e)
        })
    }

    fn visit(&self, table: Table, range: (&[u8], &[u8]), order: Order, each: &mut Visit<'_>) -> Result<(), StoreError> {
        let visited = visit(self.shared, &self.tables[table as usize], range, order, each);
        self.unread.set(self.unread.get() || visited.is_err());
        visited
    }
}

impl TablesMut for Writing<'_> {
    fn put(&mut self, table: Table, key: &[u8], value: &[u8]) -> Result<(), StoreError> {
        self.is_changed = true;
        let failed = self.tables[table as usize].insert(key, value).err();
        failed.map_or(Ok(()), |e| Err(self.broke(&e)))
    }

    fn remove(&mut self, table: Table, key: &[u8]) -> Result<(), StoreError> {
        self.is_changed = true;
        let failed = self.tables[table as usize].remove(key).err();
        failed.map_or(Ok(()), |e| Err(self.broke(&e)))
    }
}

/// How many operations are likely to come, and how long they are worth waiting for: without this the first caller that
/// comes back after a commit has the next one for itself, and the others wait for two.
struct Expected {
    count: usize,
    patience: Duration,
}

impl Expected {
    fn gather(&self, waiting: &mut mpsc::Receiver<Command>, group: &mut Vec<Command>) {
        let end = Instant::now() + self.patience.min(PATIENCE);
        while group.len() < self.count.min(GROUP) && Instant::now() < end {
            match waiting.try_recv() {
                Ok(command) => group.push(command),
                Err(mpsc::error::TryRecvError::Empty) => std::thread::sleep(Duration::from_micros(50)),
                Err(mpsc::error::TryRecvError::Disconnected) => break,
            }
        }
    }
}

struct Writer {
    shared: Arc<Shared>,
    live: Live,
    /// Why nothing is written any more.
    broken: Option<String>,
}

impl Writer {
    fn run(mut self, mut waiting: mpsc::Receiver<Command>) {
        let mut group = Vec::new();
        let mut expected = Expected { count: 0, patience: Duration::ZERO };
        while waiting.blocking_recv_many(&mut group, GROUP) > 0 {
            expected.gather(&mut waiting, &mut group);
            let start = Instant::now();
            let mut replies = Vec::with_capacity(group.len());
            if self.broken.is_none() {
                self.broken = self.write(group.drain(..), &mut replies).err();
            }
            let outcome = match &self.broken {
                Some(cause) => Err(StoreError::Broken { cause: cause.clone() }),
                None => Ok(()),
            };
            if outcome.is_ok() {
                self.live.pins.settle();
            }
            let touched = std::mem::take(&mut self.live.touched);
            self.publish(&touched);
            // Callers that are answered now are likely to come back with more.
            expected = Expected { count: waiting.len() + replies.len(), patience: start.elapsed() / 8 };
            replies.into_iter().for_each(|reply| reply(outcome.clone()));
            // Those that were not begun hear that the store is closed.
            group.clear();
            self.shared.waiters.wake(&touched);
        }
    }

    /// Does a group and makes it durable. `replies` has those that were done, whatever becomes of them.
    fn write(&mut self, group: impl Iterator<Item = Command>, replies: &mut Vec<Reply>) -> Result<(), String> {
        let mut transaction = self.shared.database.begin_write().map_err(|e| e.to_string())?;
        transaction.set_durability(Durability::Immediate).map_err(|e| e.to_string())?;
        let shared = Arc::clone(&self.shared);
        let is_changed = {
            let mut writing = Writing::begin(&shared, &transaction).map_err(|e| e.to_string())?;
            for command in group {
                replies.push(command(&mut writing, &mut self.live));
            }
            writing.outcome()?
        };
        match is_changed {
            true => transaction.commit().map_err(|e| e.to_string()),
            false => transaction.abort().map_err(|e| e.to_string()),
        }
    }

    fn publish(&self, touched: &[JobId]) {
        let mut progress = lock(&self.shared.progress);
        for id in touched {
            match self.live.jobs.get(id) {
                Some(entry) => drop(progress.insert(*id, entry.log.clone())),
                None => drop(progress.remove(id)),
            }
        }
    }
}
