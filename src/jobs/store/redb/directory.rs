//! The directory of a journal.
//!
//! | file | what it is |
//! | --- | --- |
//! | `lock` | locked by the one process that uses the directory, whose number it holds |
//! | `version` | the layout of the directory; written once the journal is there |
//! | `journal.redb` | the journal |
//! | `beside` | how many pieces of other work are under way |
//!
//! Purpose: [`Directory`]: one process, one layout, and no journal taken for empty that is not.
//! Invariant: a journal appears under its name when it is whole. Where `version` is, a journal must be: one that is missing or
//! empty is damage. Must not know: what is in the journal.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{ErrorKind, Read, Seek, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

use ::redb::{Builder, Database, DatabaseError, StorageError};

use super::StoreError;
use crate::beside::Beside;

const LAYOUT: u32 = 1;

/// A directory that is ours until this is dropped.
#[derive(Debug)]
pub(super) struct Directory {
    path: PathBuf,
    _lock: File,
}

pub(super) fn io<'a>(action: &'static str, path: &'a Path) -> impl FnOnce(std::io::Error) -> StoreError + 'a {
    move |cause| StoreError::Io { action, path: path.to_owned(), cause: cause.to_string() }
}

fn damaged(path: &Path, what: impl Into<String>) -> StoreError {
    StoreError::Damaged { path: path.to_owned(), what: what.into() }
}

/// There was a journal, or there should be one.
fn missing(folder: &Path) -> StoreError {
    StoreError::Unreadable { path: folder.to_owned(), what: "it has no file journal.redb".to_owned() }
}

fn unknown(folder: &Path, found: u32) -> StoreError {
    StoreError::UnknownVersion { what: format!("the data directory {}", folder.display()), found, known: LAYOUT }
}

impl Directory {
    pub(super) fn open(path: &Path, cache_bytes: usize) -> Result<(Self, Database), StoreError> {
        fs::create_dir_all(path).map_err(io("create", path))?;
        let directory = Self { path: path.to_owned(), _lock: lock(path)? };
        let (journal, version) = (directory.journal(), path.join("version"));
        match (read_version(&version)?, length(&journal)?) {
            (Some(found), _) if found != LAYOUT => return Err(unknown(path, found)),
            (Some(_), None) => return Err(missing(path)),
            (_, Some(0)) => return Err(damaged(&journal, "it is empty")),
            (_, Some(_)) => {}
            (None, None) => directory.make_journal(cache_bytes)?,
        }
        let database = database(&journal, cache_bytes, |builder| builder.open(&journal))?;
        directory.put_version()?;
        Ok((directory, database))
    }

    /// A directory that is there, with nothing in it opened.
    pub(super) fn locked(path: &Path) -> Result<Self, StoreError> {
        let directory = Self { path: path.to_owned(), _lock: lock(path)? };
        length(&directory.journal())?.map(|_| directory).ok_or_else(|| missing(path))
    }

    /// What is wrong with the file `version`, if it can be written anew.
    pub(super) fn version_fault(&self) -> Result<Option<String>, StoreError> {
        match read_version(&self.path.join("version")) {
            Ok(Some(found)) if found != LAYOUT => Err(unknown(&self.path, found)),
            Ok(_) => Ok(None),
            Err(StoreError::Damaged { path, what }) => Ok(Some(format!("{}: {what}", path.display()))),
            Err(error) => Err(error),
        }
    }

    /// Says that a journal is there.
    pub(super) fn put_version(&self) -> Result<(), StoreError> {
        self.put("version", &format!("{LAYOUT}\n"))
    }

    pub(super) fn journal(&self) -> PathBuf {
        self.path.join("journal.redb")
    }

    /// The count of work beside the jobs, and whether the last process went down with some.
    pub(super) fn beside(&self) -> Result<(Beside, bool), StoreError> {
        let path = self.path.join("beside");
        Beside::open(&path).map_err(io("open", &path))
    }

    /// A journal without jobs, under its name once it is whole.
    fn make_journal(&self, cache_bytes: usize) -> Result<(), StoreError> {
        let new = self.path.join("journal.new");
        match fs::remove_file(&new) {
            Err(cause) if cause.kind() != ErrorKind::NotFound => return Err(io("remove", &new)(cause)),
            _ => {}
        }
        let made = database(&new, cache_bytes, |builder| builder.create(&new))?;
        made.close().map_err(|e| told(&new, e))?;
        File::open(&new).and_then(|file| file.sync_all()).map_err(io("write", &new))?;
        self.name(&new, &self.journal())
    }

    /// Writes a small file as a whole.
    fn put(&self, name: &str, text: &str) -> Result<(), StoreError> {
        let (new, path) = (self.path.join(format!("{name}.new")), self.path.join(name));
        if fs::read(&path).is_ok_and(|there| there == text.as_bytes()) {
            return Ok(());
        }
        let written = File::create(&new).and_then(|mut file| {
            file.write_all(text.as_bytes())?;
            file.sync_all()
        });
        written.map_err(io("write", &new))?;
        self.name(&new, &path)
    }

    pub(super) fn name(&self, new: &Path, path: &Path) -> Result<(), StoreError> {
        fs::rename(new, path).map_err(io("write", path))?;
        // Names are on the disk once their directory is. Only Unix opens directories as files.
        match cfg!(unix) {
            true => File::open(&self.path).and_then(|folder| folder.sync_all()).map_err(io("write", &self.path)),
            false => Ok(()),
        }
    }
}

fn lock(folder: &Path) -> Result<File, StoreError> {
    let path = folder.join("lock");
    let opened = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&path);
    let mut file = opened.map_err(io("open", &path))?;
    match file.try_lock() {
        Ok(()) => {}
        Err(TryLockError::WouldBlock) => {
            let mut holder = String::new();
            // What cannot be read is not told.
            drop(file.take(20).read_to_string(&mut holder));
            let is_number = !holder.trim().is_empty() && holder.trim().bytes().all(|b| b.is_ascii_digit());
            let holder = is_number.then(|| holder.trim().to_owned());
            return Err(StoreError::InUse { path: folder.to_owned(), holder });
        }
        Err(TryLockError::Error(cause)) => return Err(io("lock", &path)(cause)),
    }
    let told = file.set_len(0).and_then(|()| file.rewind()).and_then(|()| writeln!(file, "{}", std::process::id()));
    told.map_err(io("write", &path))?;
    Ok(file)
}

fn length(path: &Path) -> Result<Option<u64>, StoreError> {
    match fs::metadata(path) {
        Ok(metadata) if metadata.is_file() => Ok(Some(metadata.len())),
        // A pipe would be waited for.
        Ok(_) => Err(io("read", path)(std::io::Error::other("it is no regular file"))),
        Err(cause) if cause.kind() == ErrorKind::NotFound => Ok(None),
        Err(cause) => Err(io("read", path)(cause)),
    }
}

fn read_version(path: &Path) -> Result<Option<u32>, StoreError> {
    if length(path)?.is_none() {
        return Ok(None);
    }
    match fs::read(path) {
        Ok(bytes) => {
            let number = std::str::from_utf8(&bytes).ok().and_then(|text| text.trim().parse().ok());
            number.map(Some).ok_or_else(|| damaged(path, "it holds no number"))
        }
        Err(cause) if cause.kind() == ErrorKind::NotFound => Ok(None),
        Err(cause) => Err(io("read", path)(cause)),
    }
}

/// Opens a database with every page checked: redb itself may panic on a file that something else has changed.
pub(super) fn database(
    path: &Path,
    cache_bytes: usize,
    open: impl FnOnce(&Builder) -> Result<Database, DatabaseError>,
) -> Result<Database, StoreError> {
    let mut builder = Builder::new();
    builder.set_cache_size(cache_bytes).set_check_integrity_on_open(true);
    match catch_unwind(AssertUnwindSafe(|| open(&builder))) {
        Ok(opened) => opened.map_err(|e| told(path, e)),
        Err(_) => Err(damaged(path, "its pages do not fit together")),
    }
}

fn told(path: &Path, error: DatabaseError) -> StoreError {
    match error {
        DatabaseError::DatabaseAlreadyOpen => StoreError::InUse { path: path.to_owned(), holder: None },
        DatabaseError::UpgradeRequired(found) => StoreError::UnknownVersion {
            what: format!("the file format of {}", path.display()),
            found: found.into(),
            known: 3,
        },
        DatabaseError::Storage(StorageError::Io(cause))
            if !matches!(cause.kind(), ErrorKind::UnexpectedEof | ErrorKind::InvalidData | ErrorKind::InvalidInput) =>
        {
            io("open", path)(cause)
        }
        error => damaged(path, error.to_string()),
    }
}
