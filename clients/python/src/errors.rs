//! The engine's errors as Python's.
//!
//! Purpose: one exception class for each thing that a caller can do about an error.
//! Invariant: the text is the engine's. Must not know: what was being done.

use pyo3::create_exception;
use pyo3::exceptions::{PyException, PyValueError};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyDict, PyTuple, PyType};
use tessera::cvt::DensityError;
use tessera::{RemeshError, RvdError, Stopped};

create_exception!(tessera_remesh, TesseraError, PyException, "Base of all errors of this package.");
create_exception!(
    tessera_remesh,
    BackendError,
    TesseraError,
    "The backend that was asked for is not here, or its device failed."
);
create_exception!(tessera_remesh, TooLargeError, TesseraError, "The work needs more memory than there is.");
create_exception!(tessera_remesh, Cancelled, TesseraError, "The work was cancelled, or its time was over.");

/// `InputError`, which is a `ValueError` too: the macro makes classes of one base.
fn input_error(py: Python<'_>) -> PyResult<&Bound<'_, PyType>> {
    static CLASS: PyOnceLock<Py<PyType>> = PyOnceLock::new();
    let made = || {
        let bases = PyTuple::new(py, [py.get_type::<TesseraError>(), py.get_type::<PyValueError>()])?;
        let entries = PyDict::new(py);
        entries.set_item("__module__", "tessera_remesh")?;
        entries.set_item("__doc__", "The mesh, an array or an option is wrong; the message says which.")?;
        let class = py.get_type::<PyType>().call1(("InputError", bases, entries))?;
        PyResult::Ok(class.cast_into::<PyType>()?.unbind())
    };
    Ok(CLASS.get_or_try_init(py, made)?.bind(py))
}

/// Puts the classes where Python finds them.
pub(crate) fn add_to(module: &Bound<'_, PyModule>) -> PyResult<()> {
    let py = module.py();
    module.add("TesseraError", py.get_type::<TesseraError>())?;
    module.add("InputError", input_error(py)?)?;
    module.add("BackendError", py.get_type::<BackendError>())?;
    module.add("TooLargeError", py.get_type::<TooLargeError>())?;
    module.add("Cancelled", py.get_type::<Cancelled>())
}

/// What is wrong with an array or an option.
pub(crate) fn input(message: impl ToString) -> PyErr {
    let text = message.to_string();
    Python::attach(|py| input_error(py).map_or_else(|error| error, |class| PyErr::from_type(class.clone(), text)))
}

/// The engine's error.
pub(crate) fn engine(error: RemeshError) -> PyErr {
    let text = error.to_string();
    match &error {
        RemeshError::Rvd(error) => diagram(error, text),
        RemeshError::Density(DensityError::Stopped(_)) => Cancelled::new_err(text),
        _ => input(text),
    }
}

fn diagram(error: &RvdError, text: String) -> PyErr {
    match error {
        RvdError::Stopped(Stopped::Memory { .. }) | RvdError::NeverFits { .. } | RvdError::OutOfMemory { .. } => {
            TooLargeError::new_err(text)
        }
        RvdError::Stopped(_) => Cancelled::new_err(text),
        RvdError::BackendUnavailable { .. } | RvdError::DeviceLost(_) | RvdError::Device(_) => {
            BackendError::new_err(text)
        }
        RvdError::Internal(_) => TesseraError::new_err(text),
        _ => input(text),
    }
}
