//! A remesh of arrays.

use pyo3::prelude::*;
use pyo3::types::{PyDict, PyString};
use tessera::mesh::attributes::{Attributes, ColourDepth, Normals};
use tessera::mesh::closest_point::ClosestPoint;
use tessera::rvd::on_threads_of;
use tessera::{Remesh, RvdError};

use crate::options::Options;
use crate::{arrays, backends, errors, running};

/// `remesh(vertices, faces, options, progress) -> dict`
///
/// `tessera_remesh.remesh` says what the options are.
#[pyfunction]
#[pyo3(signature = (vertices, faces, options, progress = None))]
pub(crate) fn remesh<'py>(
    py: Python<'py>,
    vertices: &Bound<'py, PyAny>,
    faces: &Bound<'py, PyAny>,
    options: &Bound<'py, PyDict>,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let given = Options::new(options);
    let backend = backends::of(py, &given)?;
    let mesh = arrays::mesh(vertices, faces, backend.as_ref())?;
    let options = given.remesh(&mesh)?;
    given.end()?;
    let done = running::run(py, progress, |events, token| {
        on_threads_of(backend.as_ref(), || tessera::remesh(&mesh, &options, backend.as_ref(), events, token))
    })?;
    let done = done.map_err(errors::engine)?;
    result(py, done)
}

/// `nearest_faces(vertices, faces, points) -> array`: (n,) int32, the face of a surface that is nearest to each point.
#[pyfunction]
pub(crate) fn nearest_faces<'py>(
    py: Python<'py>,
    vertices: &Bound<'py, PyAny>,
    faces: &Bound<'py, PyAny>,
    points: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    let backend = py.detach(|| backends::open("parallel", None))?;
    let mesh = arrays::mesh(vertices, faces, backend.as_ref())?;
    let points = arrays::points(points, "points")?;
    let nearest = running::run(py, None, |_, token| {
        on_threads_of(backend.as_ref(), || ClosestPoint::new(&mesh).project_all(&points, token))
    })?;
    let nearest = nearest.map_err(|stopped| errors::engine(RvdError::from(stopped).into()))?;
    Ok(arrays::of_counts(py, nearest.into_iter().map(|point| point.facet).collect()))
}

fn result(py: Python<'_>, done: Remesh) -> PyResult<Bound<'_, PyDict>> {
    let Remesh { mesh, vertex_seed, curve_edges, seeds, report, attributes, provenance } = done;
    let (positions, facets) = mesh.into_parts();
    let dict = PyDict::new(py);
    dict.set_item("vertices", arrays::of_points(py, positions)?)?;
    dict.set_item("faces", arrays::of_indices(py, facets)?)?;
    dict.set_item("vertex_seeds", arrays::of_counts(py, vertex_seed))?;
    dict.set_item("creases", arrays::of_indices(py, curve_edges)?)?;
    dict.set_item("seeds", arrays::of_points(py, seeds)?)?;
    let report = serde_json::to_string(&report).map_err(errors::input)?;
    dict.set_item("report", PyString::new(py, &report))?;
    if let Some(attributes) = attributes {
        dict.set_item("attributes", carried(py, &attributes)?)?;
        let (facets, barycentric): (Vec<_>, Vec<_>) =
            provenance.iter().map(|p| (p.facet, glam::DVec3::from_array(p.barycentric))).unzip();
        dict.set_item("source_faces", arrays::of_counts(py, facets))?;
        dict.set_item("source_barycentric", arrays::of_points(py, barycentric)?)?;
    }
    Ok(dict)
}

pub(crate) fn carried<'py>(py: Python<'py>, attributes: &Attributes) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    match attributes.normals() {
        Some(Normals::PerVertex(values)) => dict.set_item("normals", arrays::of_points(py, values.clone())?)?,
        Some(Normals::PerCorner(normals)) => {
            dict.set_item("normals", arrays::of_points(py, normals.values.clone())?)?;
            dict.set_item("normal_corners", arrays::of_indices(py, normals.corners.clone())?)?;
        }
        None => {}
    }
    if let Some(texture) = attributes.texture() {
        dict.set_item("texture", arrays::of_pairs(py, texture.values.clone())?)?;
        dict.set_item("texture_corners", arrays::of_indices(py, texture.corners.clone())?)?;
    }
    if let Some(colours) = attributes.colours() {
        dict.set_item("colours", arrays::of_fours(py, colours.values.clone())?)?;
        dict.set_item("colours_of_eight_bits", colours.depth == ColourDepth::Eight)?;
    }
    if let Some(regions) = attributes.regions() {
        dict.set_item("regions", arrays::of_numbers(py, regions.numbers().map(|number| number as f64).collect()))?;
        let named = regions.all().iter().map(|region| (region.number, region.name.clone())).collect::<Vec<_>>();
        dict.set_item("region_names", named)?;
    }
    let scalars = PyDict::new(py);
    for scalar in attributes.scalars() {
        let values = arrays::of_numbers(py, scalar.values.clone());
        scalars.set_item(&scalar.name, (values, arrays::word(scalar.number), scalar.components))?;
    }
    dict.set_item("scalars", scalars)?;
    Ok(dict)
}
