//! A journal that is looked at and mended while no server uses it.
//!
//! Purpose: [`check`] says whether a journal is whole and how many of its jobs can be read; [`repair`] puts a new journal
//! with those jobs in its place. Invariant: the damaged journal is kept beside the new one, under another name. Must not know:
//! the command line.

use std::fs;
use std::path::{Path, PathBuf};

use super::directory::{Directory, database};
use super::salvage::Rows;
use super::{RedbOptions, RedbStore, StoreError};
use crate::record::JobId;
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
    /// Jobs that can be read.
    pub jobs: usize,
    /// Jobs of which a part is missing.
    pub lost: Vec<JobId>,
    /// Where the damaged journal lies, if it was replaced.
    pub damaged: Option<PathBuf>,
}

fn io<'a>(action: &'static str, path: &'a Path) -> impl FnOnce(std::io::Error) -> StoreError + 'a {
    move |cause| StoreError::Io { action, path: path.to_owned(), cause: cause.to_string() }
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

/// Looks at the journal of a folder. Nothing is changed.
///
/// # Errors
/// `InUse` if a server uses it; `Unreadable` if nothing of it can be read; `Io`.
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
