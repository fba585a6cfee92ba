//! Tessera's engine as a Python module, `tessera_remesh._engine`.
//!
//! Purpose: the thinnest layer between numpy arrays and the engine. The package around it, in Python, has the interface that
//! people see.
//! Invariant: the interpreter is free while the engine works, and hears of Ctrl-C within a tenth of a second. No panic reaches
//! Python. Must not know: trimesh, pyvista, servers.

mod arrays;
mod backends;
mod cvt;
mod errors;
mod files;
mod options;
mod remesh;
mod running;
mod rvd;
mod start;

use pyo3::prelude::*;

/// Tessera's engine. The package `tessera_remesh` is what to import.
#[pymodule]
mod _engine {
    use pyo3::prelude::*;

    #[pymodule_export]
    use crate::backends::backend;
    #[pymodule_export]
    use crate::cvt::Cvt;
    #[pymodule_export]
    use crate::files::{read, write};
    #[pymodule_export]
    use crate::remesh::{nearest_faces, remesh};
    #[pymodule_export]
    use crate::rvd::rvd;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        crate::errors::add_to(module)?;
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
