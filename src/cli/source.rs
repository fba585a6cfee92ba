//! A file that is sent as it is.
//!
//! Purpose: its digest and its pieces. Invariant: memory for a piece, whatever the size. A pipe, which can be read only once,
//! is kept in a temporary file. Must not know: where it is sent.

use std::fs::File;
use std::io::{BufReader, ErrorKind, Read, Result as IoResult, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use tempfile::NamedTempFile;

use super::exit::NoInput;
use super::files::unread;
use geometry::mesh::io::{self, Format};
use wire::pieces::{Hash, PIECE_BYTES};

#[derive(Debug)]
pub(crate) struct Source {
    pub(crate) path: PathBuf,
    /// The SHA-256 of its bytes, as blobs are named.
    pub(crate) digest: String,
    pub(crate) size: u64,
    kept: Option<NamedTempFile>,
}

impl Source {
    /// Reads it once.
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let unread = |cause| NoInput { path: path.to_owned(), cause };
        let file = File::open(path).map_err(unread)?;
        let meta = file.metadata().map_err(unread)?;
        if meta.is_dir() {
            return Err(unread(ErrorKind::IsADirectory.into()).into());
        }
        let kept = (!meta.is_file()).then(NamedTempFile::new).transpose();
        let mut kept = kept.context("cannot keep what the pipe brings")?;
        let (mut hash, mut file, mut buffer) = (Hash::default(), BufReader::new(file), vec![0; 1 << 16]);
        loop {
            match file.read(&mut buffer) {
                Ok(0) => break,
                Ok(bytes) => {
                    hash.add(&buffer[..bytes]);
                    let keep = kept.as_mut().map_or(Ok(()), |kept| kept.write_all(&buffer[..bytes]));
                    keep.context("cannot keep what the pipe brings")?;
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(unread(error).into()),
            }
        }
        Ok(Self { path: path.to_owned(), digest: hash.digest(), size: hash.bytes(), kept })
    }

    /// A surface, which stands by itself: a `.gltf` takes in the files that it names.
    pub(crate) fn surface(path: &Path, format: Format) -> Result<Self> {
        if format != Format::Gltf {
            return Self::open(path);
        }
        Self::of(path, &io::read_bytes(path, format).map_err(unread)?)
    }

    /// What was made of a file.
    pub(crate) fn of(path: &Path, bytes: &[u8]) -> Result<Self> {
        let mut kept = NamedTempFile::new().context("cannot keep what is made of the file")?;
        kept.write_all(bytes).context("cannot keep what is made of the file")?;
        let mut hash = Hash::default();
        hash.add(bytes);
        Ok(Self { path: path.to_owned(), digest: hash.digest(), size: hash.bytes(), kept: Some(kept) })
    }

    /// The pieces from byte `offset` on: where each begins, and its bytes. After an error there are no more.
    pub(crate) fn pieces(&self, offset: u64) -> IoResult<Pieces> {
        let mut file = File::open(self.kept.as_ref().map_or(self.path.as_path(), |kept| kept.path()))?;
        file.seek(SeekFrom::Start(offset))?;
        Ok(Pieces { file, at: offset, size: self.size })
    }
}

#[derive(Debug)]
pub(crate) struct Pieces {
    file: File,
    at: u64,
    size: u64,
}

impl Iterator for Pieces {
    type Item = IoResult<(u64, Vec<u8>)>;

    fn next(&mut self) -> Option<Self::Item> {
        let (at, left) = (self.at, self.size - self.at.min(self.size));
        if left == 0 {
            return None;
        }
        let mut piece = vec![0; left.min(PIECE_BYTES as u64) as usize];
        self.at += piece.len() as u64;
        Some(match self.file.read_exact(&mut piece) {
            Ok(()) => Ok((at, piece)),
            Err(error) => {
                self.at = self.size;
                Err(match error.kind() {
                    ErrorKind::UnexpectedEof => std::io::Error::other("it became shorter while it was read"),
                    _ => error,
                })
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_are_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x");
        let bytes: Vec<u8> = (0..3 * PIECE_BYTES / 2).map(|i| (i % 251) as u8).collect();
        std::fs::write(&path, &bytes).unwrap();
        let source = Source::open(&path).unwrap();
        assert_eq!(source.size, bytes.len() as u64);
        for offset in [0, 5, PIECE_BYTES, bytes.len()] {
            let mut came = Vec::new();
            for piece in source.pieces(offset as u64).unwrap() {
                let (at, piece) = piece.unwrap();
                assert_eq!(at as usize, offset + came.len());
                came.extend(piece);
            }
            assert_eq!(came, bytes[offset..]);
        }
        std::fs::write(&path, "short").unwrap();
        let all: Vec<_> = source.pieces(0).unwrap().collect();
        assert!(all.len() == 1 && all[0].is_err());
        assert!(Source::open(folder.path()).is_err());
    }
}
