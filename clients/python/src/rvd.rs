//! A restricted Voronoi diagram of arrays.

use pyo3::prelude::*;
use pyo3::types::PyDict;
use tessera::rvd::on_threads_of;
use tessera::{Diagram, RemeshError, Token};

use crate::errors::engine;
use crate::options::Options;
use crate::start::{Start, start};
use crate::{arrays, backends, running};

/// `rvd(vertices, faces, options) -> dict`
///
/// `tessera_remesh.rvd` says what the options are.
#[pyfunction]
pub(crate) fn rvd<'py>(
    py: Python<'py>,
    vertices: &Bound<'py, PyAny>,
    faces: &Bound<'py, PyAny>,
    options: &Bound<'py, PyDict>,
) -> PyResult<Bound<'py, PyDict>> {
    let given = Options::new(options);
    let backend = backends::of(py, &given)?;
    let mesh = arrays::mesh(vertices, faces, backend.as_ref())?;
    let (seeds, density) = (given.seeds()?, given.density()?);
    let wants_pieces: bool = given.get("pieces", "True or False")?.unwrap_or(true);
    given.end()?;
    let work = |token: &Token| -> Result<_, RemeshError> {
        let Start { surface, seeds } = start(&mesh, &density, seeds, false, token)?;
        let facets = surface.facets().len() as u32;
        let mut diagram = Diagram::on(surface, &seeds, backend.as_ref())?;
        let cells = diagram.cells(token)?;
        let pieces = if wants_pieces { Some(diagram.pieces(0..facets, token)?) } else { None };
        Ok((seeds, cells, pieces))
    };
    let done = running::run(py, None, |_, token| on_threads_of(backend.as_ref(), || work(token)))?;
    let (seeds, cells, pieces) = done.map_err(engine)?;
    let dict = PyDict::new(py);
    dict.set_item("seeds", arrays::of_points(py, seeds)?)?;
    dict.set_item("centroids", arrays::of_points(py, cells.centroids)?)?;
    dict.set_item("masses", arrays::of_numbers(py, cells.masses))?;
    dict.set_item("areas", arrays::of_numbers(py, cells.areas))?;
    dict.set_item("energies", arrays::of_numbers(py, cells.energies))?;
    if let Some(pieces) = pieces {
        dict.set_item("piece_faces", arrays::of_counts(py, pieces.facet))?;
        dict.set_item("piece_seeds", arrays::of_counts(py, pieces.seed))?;
        dict.set_item("piece_offsets", arrays::of_counts(py, pieces.offset))?;
        dict.set_item("piece_vertices", arrays::of_points(py, pieces.position)?)?;
    }
    Ok(dict)
}
