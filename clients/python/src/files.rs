//! Files of surfaces.
//!
//! Invariant: formats, checks and errors are those of the library. Must not know: what is done with a surface.

use std::io::ErrorKind;
use std::path::PathBuf;

use pyo3::exceptions::{PyFileNotFoundError, PyOSError, PyPermissionError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use tessera::TriMesh;
use tessera::mesh::attributes::Attributes;
use tessera::mesh::io::{self, FileError, Loaded};

use crate::arrays;
use crate::errors::input;
use crate::options::attributes;
use crate::remesh::carried;

/// An error of the system, or of what a file holds.
fn wrong(error: &FileError) -> PyErr {
    match error {
        FileError::Io { cause, .. } => match cause.kind() {
            ErrorKind::NotFound => PyFileNotFoundError::new_err(error.to_string()),
            ErrorKind::PermissionDenied => PyPermissionError::new_err(error.to_string()),
            _ => PyOSError::new_err(error.to_string()),
        },
        FileError::UnknownFormat { .. } | FileError::Data { .. } => input(error),
    }
}

/// `read(path) -> dict`: vertices, faces, attributes, edges that the file names in `creases` and vertices in `required`, and in
/// `left_aside` what is not read, a text each.
#[pyfunction]
pub(crate) fn read(py: Python<'_>, path: PathBuf) -> PyResult<Bound<'_, PyDict>> {
    let read = py.detach(|| io::read_with_attributes(&path)).map_err(|error| wrong(&error))?;
    let Loaded { mesh, attributes, creases, vertices: required, left_aside } = read;
    let (positions, facets) = mesh.into_parts();
    let dict = PyDict::new(py);
    dict.set_item("vertices", arrays::of_points(py, positions)?)?;
    dict.set_item("faces", arrays::of_indices(py, facets)?)?;
    if !attributes.is_empty() {
        dict.set_item("attributes", carried(py, &attributes)?)?;
    }
    dict.set_item("creases", arrays::of_indices(py, creases)?)?;
    dict.set_item("required", required)?;
    dict.set_item("left_aside", left_aside.iter().map(ToString::to_string).collect::<Vec<_>>())?;
    Ok(dict)
}

/// `write(path, vertices, faces, attributes) -> list`: what the format cannot hold.
#[pyfunction]
pub(crate) fn write(
    py: Python<'_>,
    path: PathBuf,
    vertices: &Bound<'_, PyAny>,
    faces: &Bound<'_, PyAny>,
    attributes_of: Option<&Bound<'_, PyAny>>,
) -> PyResult<Vec<String>> {
    let (positions, facets) = (arrays::points(vertices, "vertices")?, arrays::triples(faces, "faces")?);
    let mesh = TriMesh::new(positions, facets).map_err(input)?;
    let held = attributes_of.map(|given| attributes(given, &mesh)).transpose()?;
    let held = held.unwrap_or_else(|| Attributes::new(&mesh));
    let written = py.detach(|| io::write_with_attributes(&path, &mesh, &held));
    written.map_err(|error| wrong(&error))
}
