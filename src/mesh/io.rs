//! (being built)
use super::TriMesh;
use std::path::Path;
/// Why a file could not be read or written.
#[derive(Debug, thiserror::Error)]
#[error("being built")]
pub struct FileError;
/// Reads a mesh; the format is the extension's.
pub fn read(_path: &Path) -> Result<TriMesh, FileError> {
    todo!()
}
/// Writes a mesh; the format is the extension's.
pub fn write(_path: &Path, _mesh: &TriMesh) -> Result<(), FileError> {
    todo!()
}
