//! RVD pieces as a file that appears under its name only when it is whole.
//!
//! Invariant: what was there before is replaced by a whole file or stays. Must not know: where pieces come from, how the file
//! looks inside (`rvd::cell_file`).

use std::fs::File;
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};

use anyhow::Result;
use tempfile::NamedTempFile;

use super::exit::NotWritten;
use super::files;
use geometry::rvd::PieceBatch;
use geometry::rvd::cell_file::CellWriter;

pub(crate) struct CellFile {
    path: PathBuf,
    writer: CellWriter<BufWriter<NamedTempFile>, File>,
}

impl CellFile {
    /// Begins a file that will be `path`.
    pub(crate) fn create(path: &Path) -> Result<Self> {
        let begin = || {
            let vertices = BufWriter::new(files::begin(path)?);
            let folder = vertices.get_ref().path().parent().unwrap_or(Path::new("."));
            let polygons = tempfile::tempfile_in(folder)?;
            CellWriter::new(vertices, polygons)
        };
        let writer = begin().map_err(|e| unwritten(path, &e))?;
        Ok(Self { path: path.to_owned(), writer })
    }

    pub(crate) fn append(&mut self, cells: &PieceBatch) -> Result<()> {
        Ok(self.writer.append(cells).map_err(|e| unwritten(&self.path, &e))?)
    }

    /// Gives the file its name.
    pub(crate) fn finish(self) -> Result<()> {
        let Self { path, writer } = self;
        let finish = || {
            let file = writer.finish()?.into_inner().map_err(io::IntoInnerError::into_error)?;
            files::keep(file.into_temp_path(), &path)
        };
        Ok(finish().map_err(|e| unwritten(&path, &e))?)
    }
}

fn unwritten(path: &Path, error: &io::Error) -> NotWritten {
    NotWritten(format!("cannot write {}: {error}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn a_file_has_its_name_once_it_is_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cells.ply");
        let mut file = CellFile::create(&path).unwrap();
        let mut batch = PieceBatch::default();
        batch.push(7, 3, [DVec3::X, DVec3::Y, DVec3::Z].map(|p| (p, 1.0, 0)));
        file.append(&batch).unwrap();
        assert!(!path.exists(), "not before it is whole");
        file.finish().unwrap();
        let bytes = std::fs::read(&path).unwrap();
        assert!(bytes.starts_with(b"ply\n") && bytes.len() == 512 + 3 * 24 + 24, "{}", bytes.len());
    }
}
