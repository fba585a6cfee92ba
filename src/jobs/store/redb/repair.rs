//! A journal that is looked at and mended while no server uses it.
//!
//! Purpose: [`check`] says whether a journal is whole and how many of its jobs can be read; [`repair`] puts a new journal
//! with those jobs in its place. [`Rows`] reads a copy row by row, as far as each table goes from both of its ends. Invariant:
//! the damaged journal is kept beside the new one, under another name; no fault of its pages ends the process. Must not know:
//! the command line.

use std::collections::BTreeMap;
use std::fs::{self, OpenOptions};
use std::io::{Seek, SeekFrom, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

use ::redb::{Builder, ConcurrencyMode, ReadTransaction, ReadableDatabase, ReadableTable};

use super::directory::{Directory, database, io};
use super::{RedbOptions, RedbStore, StoreError, Table, definition};
use crate::record::event::Log;
use crate::record::{JobId, Spec};
use crate::store::codec::{Head, decode, encode};
use crate::store::operations as ops;

/// The name of the copy that is read.
const COPY: &str = "journal.copy";
/// The name of a damaged journal that was replaced.
const DAMAGED: &str = "journal.damaged";
/// The folder of the new journal until it is whole.
const NEW: &str = "journal.repaired";

#[derive(Debug)]
pub struct Findings {
    /// What is wrong with it; nothing if it is whole.
    pub faults: Vec<String>,
    pub jobs: usize,
    /// Jobs of which a part is missing.
    pub lost: Vec<JobId>,
    /// Where the damaged journal lies, if it was replaced.
    pub damaged: Option<PathBuf>,
}

/// Reads the journal of a folder. Whether it is whole is what a server would say that opens it.
fn read(directory: &Directory, folder: &Path) -> Result<(Rows, Vec<String>), StoreError> {
    let (journal, copy) = (directory.journal(), folder.join(COPY));
    let make_copy = || fs::copy(&journal, &copy).map_err(io("copy", &journal));
    make_copy()?;
    // Every page is checked, and the copy is recovered if it can be.
    let opened = database(&copy, RedbOptions::default().cache_bytes, |builder| builder.open(&copy));
    let mut faults = Vec::from_iter(directory.version_fault()?);
    match opened {
        Ok(recovered) => drop(recovered),
        Err(error) => {
            faults.push(match error {
                StoreError::Damaged { what, .. } => what,
                other => other.to_string(),
            });
            make_copy()?;
        }
    }
    let rows = Rows::read(&copy);
    fs::remove_file(&copy).map_err(io("remove", &copy))?;
    let mut rows = rows.map_err(|what| StoreError::Unreadable { path: journal, what })?;
    faults.append(&mut rows.faults);
    Ok((rows, faults))
}

/// Looks at the journal of a folder. Nothing is changed. Errors: `InUse` if a server uses it; `Unreadable` if nothing of it
/// can be read; `Io`.
pub fn check(folder: &Path) -> Result<Findings, StoreError> {
    let directory = Directory::locked(folder)?;
    let (rows, faults) = read(&directory, folder)?;
    let (whole, lost) = rows.jobs();
    Ok(Findings { faults, jobs: whole.len(), lost, damaged: None })
}

/// Puts a new journal with all jobs that can be read in the place of a damaged one. One that is whole stays as it is.
pub async fn repair(folder: &Path) -> Result<Findings, StoreError> {
    let directory = Directory::locked(folder)?;
    let (rows, faults) = read(&directory, folder)?;
    let (whole, lost) = rows.jobs();
    let jobs = whole.len();
    if faults.len() == usize::from(directory.version_fault()?.is_some()) && lost.is_empty() {
        directory.put_version()?;
        return Ok(Findings { faults, jobs, lost, damaged: None });
    }
    let new = folder.join(NEW);
    if new.exists() {
        fs::remove_dir_all(&new).map_err(io("remove", &new))?;
    }
    let store = RedbStore::open(&new, RedbOptions::default())?;
    for job in whole {
        store.send(move |tables, _| ops::adopt(tables, job.id, &job.head, &job.spec, &job.log)).await?;
    }
    drop(store);
    let damaged = (0..u32::MAX)
        .map(|i| folder.join(if i == 0 { DAMAGED.to_owned() } else { format!("{DAMAGED}.{i}") }))
        .find(|path| !path.exists())
        .unwrap_or_else(|| folder.join(DAMAGED));
    let journal = directory.journal();
    let made = new.join(journal.file_name().unwrap_or_default());
    fs::rename(&journal, &damaged).map_err(io("rename", &journal))?;
    directory.name(&made, &journal)?;
    directory.put_version()?;
    fs::remove_dir_all(&new).map_err(io("remove", &new))?;
    Ok(Findings { faults, jobs, lost, damaged: Some(damaged) })
}

/// The byte of redb's header that says which of the two roots counts, and whether the file is to be recovered before it is
/// used (redb's `docs/design.md`, "Super-header").
const FLAGS_AT: u64 = 9;
const SECOND_ROOT: u8 = 1;
const TO_BE_RECOVERED: u8 = 2;

/// The most that a file may have been longer, as a factor.
const LONGEST_CUT: u64 = 64;

type TableRows = BTreeMap<Vec<u8>, Vec<u8>>;

struct Rows {
    heads: TableRows,
    specs: TableRows,
    logs: TableRows,
    /// What was wrong, if anything was.
    faults: Vec<String>,
}

/// A job as it can be written again.
struct SalvagedJob {
    id: JobId,
    head: Head,
    spec: Vec<u8>,
    log: Vec<u8>,
}

/// Does `work`; a panic is a fault of the file.
fn carefully<T>(work: impl FnOnce() -> Result<T, ::redb::Error>) -> Result<T, String> {
    match catch_unwind(AssertUnwindSafe(work)) {
        Ok(done) => done.map_err(|error| error.to_string()),
        Err(_) => Err("its pages do not fit together".to_owned()),
    }
}

impl Rows {
    /// Reads what there is in the file at `copy`, which is changed for it.
    ///
    /// A journal whose process was killed is to be recovered, which fails if a single page is damaged. So it is read as it
    /// lies, from the one root and from the other, and what gives more counts.
    fn read(copy: &Path) -> Result<Self, String> {
        let flags = fs::read(copy).ok().and_then(|bytes| bytes.get(FLAGS_AT as usize).copied());
        let flags = flags.ok_or("it has no header")? & !TO_BE_RECOVERED;
        // A file that was cut off gets its length again: its last pages are then damaged, and the others can be read. What is
        // not written takes no room on the disk.
        let file = OpenOptions::new().write(true).open(copy).map_err(|error| error.to_string())?;
        let bytes = file.metadata().map_err(|error| error.to_string())?.len();
        drop(file.set_len(bytes.saturating_mul(LONGEST_CUT)));
        let mut found: Option<Self> = None;
        let mut fault = String::new();
        for flags in [flags, flags ^ SECOND_ROOT] {
            match Self::read_with(copy, flags) {
                Ok(rows) if found.as_ref().is_none_or(|found| found.heads.len() < rows.heads.len()) => {
                    found = Some(rows)
                }
                Ok(_) => {}
                Err(why) => fault = why,
            }
        }
        found.ok_or(fault)
    }

    /// The same with these flags in its header.
    fn read_with(copy: &Path, flags: u8) -> Result<Self, String> {
        let file = OpenOptions::new().write(true).open(copy);
        let put = file.and_then(|mut file| {
            file.seek(SeekFrom::Start(FLAGS_AT))?;
            file.write_all(&[flags])
        });
        put.map_err(|error| error.to_string())?;
        // A reader beside a writer needs no list of free pages, which is there only after an orderly end.
        let mut builder = Builder::new();
        builder.set_concurrency_mode(ConcurrencyMode::SingleWriter);
        let database = carefully(|| Ok(builder.open_read_only(copy)?))?;
        let mut faults = Vec::new();
        let transaction = carefully(|| Ok(database.begin_read()?))?;
        let mut read = |table| {
            let (rows, fault) = rows(&transaction, table);
            faults.extend(fault.map(|fault| format!("{}: {fault}", table.name())));
            rows
        };
        let (heads, specs, logs) = (read(Table::Heads), read(Table::Specs), read(Table::Logs));
        Ok(Self { heads, specs, logs, faults })
    }

    /// The jobs that are whole, and the names of those that are not.
    fn jobs(self) -> (Vec<SalvagedJob>, Vec<JobId>) {
        let (mut whole, mut lost) = (Vec::new(), Vec::new());
        let ids: std::collections::BTreeSet<_> = self.heads.keys().chain(self.specs.keys()).cloned().collect();
        for key in ids {
            let Some(id) = key.last_chunk().map(|bytes| JobId(*bytes)) else { continue };
            let head = self.heads.get(&key).and_then(|bytes| decode::<Head>("head", bytes).ok());
            let spec = self.specs.get(&key).filter(|bytes| decode::<Spec>("spec", bytes).is_ok());
            // Without its events a job is still what it is.
            let log = self.logs.get(&key).filter(|bytes| decode::<Log>("log", bytes).is_ok()).cloned();
            let log = log.or_else(|| encode("log", &Log::default()).ok());
            match (head, spec, log) {
                (Some(head), Some(spec), Some(log)) => whole.push(SalvagedJob { id, head, spec: spec.clone(), log }),
                _ => lost.push(id),
            }
        }
        (whole, lost)
    }
}

/// All rows of a table that can be read, and why there may be more.
fn rows(transaction: &ReadTransaction, table: Table) -> (TableRows, Option<String>) {
    let mut kept = TableRows::new();
    let up = walk(transaction, table, &mut kept, false);
    let Err(fault) = up else { return (kept, None) };
    // What lies behind the damage can be reached from the other end.
    drop(walk(transaction, table, &mut kept, true));
    (kept, Some(fault))
}

fn walk(transaction: &ReadTransaction, table: Table, kept: &mut TableRows, down: bool) -> Result<(), String> {
    carefully(|| {
        let table = transaction.open_table(definition(table))?;
        let mut range = table.iter()?;
        while let Some(row) = if down { range.next_back() } else { range.next() } {
            let (key, value) = row?;
            kept.insert(key.value().to_vec(), value.value().to_vec());
        }
        Ok(())
    })
}
