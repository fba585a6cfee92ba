//! Centroidal iterations of arrays, step by step.

use std::sync::{Arc, Mutex, PoisonError};

use pyo3::prelude::*;
use pyo3::types::PyDict;
use tessera::rvd::on_threads_of;
use tessera::{Backend, CvtOptions, RemeshError, RvdError, Token};

use crate::errors::{engine, input};
use crate::options::Options;
use crate::start::{Start, start};
use crate::{arrays, backends, running};

/// Cvt(vertices, faces, options)
///
/// A session of steps. `tessera_remesh.cvt` says what the options are.
#[pyclass(frozen)]
pub(crate) struct Cvt {
    session: Mutex<tessera::Cvt>,
    /// Threads of the backend do all of the work.
    backend: Arc<dyn Backend>,
}

#[pymethods]
impl Cvt {
    #[new]
    fn new(
        py: Python<'_>,
        vertices: &Bound<'_, PyAny>,
        faces: &Bound<'_, PyAny>,
        options: &Bound<'_, PyDict>,
    ) -> PyResult<Self> {
        let given = Options::new(options);
        let backend = backends::of(py, &given)?;
        let mesh = arrays::mesh(vertices, faces, backend.as_ref())?;
        let (seeds, density, projection) = (given.seeds()?, given.density()?, given.projection()?);
        given.end()?;
        let open = |token: &Token| -> Result<tessera::Cvt, RemeshError> {
            let Start { surface, seeds } = start(&mesh, &density, seeds, true, token)?;
            let options = CvtOptions::new().with_projection(projection);
            Ok(tessera::Cvt::new(backend.as_ref(), surface, &seeds, options)?)
        };
        let session = running::run(py, None, |_, token| on_threads_of(backend.as_ref(), || open(token)))?;
        Ok(Self { session: Mutex::new(session.map_err(engine)?), backend })
    }

    /// `step(kind) -> dict`: takes a step, "lloyd" or "newton".
    fn step<'py>(&self, py: Python<'py>, kind: &str) -> PyResult<Bound<'py, PyDict>> {
        let newton = match kind {
            "lloyd" => false,
            "newton" => true,
            other => return Err(input(format!("step {other:?} is neither lloyd nor newton"))),
        };
        let (step, seeds, converged) = running::run(py, None, |_, token| {
            on_threads_of(self.backend.as_ref(), || {
                let mut session = self.session.lock().unwrap_or_else(PoisonError::into_inner);
                let mut of = || {
                    let step = if newton { session.lbfgs(token)? } else { session.lloyd(token)? };
                    Ok::<_, RvdError>((step, session.seeds()?, session.converged()))
                };
                of().map_err(|error| engine(error.into()))
            })
        })??;
        let dict = PyDict::new(py);
        dict.set_item("index", step.index)?;
        dict.set_item("kind", step.kind.name())?;
        dict.set_item("energy", step.energy)?;
        dict.set_item("energy_ratio", step.energy_ratio)?;
        dict.set_item("gradient_norm", step.gradient_norm)?;
        dict.set_item("empty_cells", step.empty_cells)?;
        dict.set_item("milliseconds", step.ms)?;
        dict.set_item("converged", converged)?;
        dict.set_item("seeds", arrays::of_points(py, seeds)?)?;
        Ok(dict)
    }
}
