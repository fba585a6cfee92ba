//! The engine's errors as Python's.
//!
//! Purpose: one exception class for each thing that a caller can do about an error.
//! Invariant: the text is the engine's. Must not know: what was being done.

use pyo3::create_exception;
use pyo3::exceptions::PyException;
use pyo3::prelude::*;
use tessera::cvt::DensityError;
use tessera::{RemeshError, RvdError, Stopped};

create_exception!(tessera_remesh, TesseraError, PyException, "Base of all errors of this package.");
create_exception!(
    tessera_remesh,
    InputError,
    TesseraError,
    "The mesh, an array or an option is wrong; the message says which."
);
create_exception!(
    tessera_remesh,
    BackendError,
    TesseraError,
    "The backend that was asked for is not here, or its device failed."
);
create_exception!(tessera_remesh, TooLargeError, TesseraError, "The work needs more memory than there is.");
create_exception!(tessera_remesh, Cancelled, TesseraError, "The work was cancelled, or its time was over.");

/// Puts the classes where Python finds them.
pub(crate) fn add_to(module: &Bound<'_, PyModule>) -> PyResult<()> {
    let py = module.py();
    module.add("TesseraError", py.get_type::<TesseraError>())?;
    module.add("InputError", py.get_type::<InputError>())?;
    module.add("BackendError", py.get_type::<BackendError>())?;
    module.add("TooLargeError", py.get_type::<TooLargeError>())?;
    module.add("Cancelled", py.get_type::<Cancelled>())
}

/// What is wrong with an array or an option.
pub(crate) fn input(message: impl ToString) -> PyErr {
    InputError::new_err(message.to_string())
}

/// The engine's error.
pub(crate) fn engine(error: RemeshError) -> PyErr {
    let text = error.to_string();
    match &error {
        RemeshError::Rvd(error) => diagram(error, text),
        RemeshError::Density(DensityError::Stopped(_)) => Cancelled::new_err(text),
        _ => InputError::new_err(text),
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
        _ => InputError::new_err(text),
    }
}
