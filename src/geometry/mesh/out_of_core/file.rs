//! Files that are read and written at any place.
//!
//! Purpose: positioned reads and writes, and scratch files without a name, which the system removes when they are closed.
//! Invariant: a read that the file is too short for is an error. Must not know: records.

use std::fs::File;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use super::MeshFileError;

/// A file that is read.
#[derive(Debug)]
pub(crate) struct ReadAt {
    file: File,
    bytes: u64,
}

impl ReadAt {
    pub(crate) fn open(path: &Path) -> io::Result<Self> {
        let file = File::open(path)?;
        let meta = file.metadata()?;
        if !meta.is_file() {
            return Err(io::Error::new(
                ErrorKind::InvalidInput,
                "it is no regular file, and cannot be read in windows",
            ));
        }
        Ok(Self { file, bytes: meta.len() })
    }

    pub(crate) fn bytes(&self) -> u64 {
        self.bytes
    }

    /// The first bytes, at most so many.
    pub(crate) fn head(&self, most: usize) -> io::Result<Vec<u8>> {
        let mut head = vec![0; usize::try_from(self.bytes).unwrap_or(usize::MAX).min(most)];
        self.read(0, &mut head)?;
        Ok(head)
    }

    pub(crate) fn read(&self, at: u64, out: &mut [u8]) -> io::Result<()> {
        read_at(&self.file, at, out)
    }
}

/// Where scratch files go.
#[derive(Clone, Debug)]
pub struct Scratch {
    folder: PathBuf,
}

impl Scratch {
    /// A folder with room for them. Not one that lies in memory.
    pub fn new(folder: &Path) -> Self {
        Self { folder: folder.to_owned() }
    }

    pub(crate) fn file(&self) -> Result<WriteAt, MeshFileError> {
        let file = tempfile::tempfile_in(&self.folder).map_err(|cause| self.failed(cause))?;
        Ok(WriteAt { file, scratch: self.clone() })
    }

    fn failed(&self, cause: io::Error) -> MeshFileError {
        MeshFileError::Scratch { folder: self.folder.clone(), cause }
    }
}

/// A scratch file.
#[derive(Debug)]
pub(crate) struct WriteAt {
    file: File,
    scratch: Scratch,
}

impl WriteAt {
    pub(crate) fn read(&self, at: u64, out: &mut [u8]) -> Result<(), MeshFileError> {
        read_at(&self.file, at, out).map_err(|cause| self.scratch.failed(cause))
    }

    pub(crate) fn write(&self, at: u64, bytes: &[u8]) -> Result<(), MeshFileError> {
        write_at(&self.file, at, bytes).map_err(|cause| self.scratch.failed(cause))
    }
}

#[cfg(unix)]
fn read_at(file: &File, at: u64, out: &mut [u8]) -> io::Result<()> {
    std::os::unix::fs::FileExt::read_exact_at(file, out, at)
}

#[cfg(unix)]
fn write_at(file: &File, at: u64, bytes: &[u8]) -> io::Result<()> {
    std::os::unix::fs::FileExt::write_all_at(file, bytes, at)
}

#[cfg(windows)]
fn read_at(file: &File, mut at: u64, mut out: &mut [u8]) -> io::Result<()> {
    while !out.is_empty() {
        match std::os::windows::fs::FileExt::seek_read(file, out, at)? {
            0 => return Err(ErrorKind::UnexpectedEof.into()),
            read => (at, out) = (at + read as u64, &mut out[read..]),
        }
    }
    Ok(())
}

#[cfg(windows)]
fn write_at(file: &File, mut at: u64, mut bytes: &[u8]) -> io::Result<()> {
    while !bytes.is_empty() {
        match std::os::windows::fs::FileExt::seek_write(file, bytes, at)? {
            0 => return Err(ErrorKind::WriteZero.into()),
            written => (at, bytes) = (at + written as u64, &bytes[written..]),
        }
    }
    Ok(())
}
