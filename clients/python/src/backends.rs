//! Backends, opened once for each process.
//!
//! Invariant: a process that was forked opens its own: threads do not come along. Must not know: what they work at.

use std::sync::{Arc, Mutex, PoisonError};

use pyo3::prelude::*;
use pyo3::types::PyDict;
use tessera::{Backend, BackendChoice, BackendKind, BackendOptions};

use crate::errors::{engine, input};
use crate::options::Options;

/// As many as the command takes.
const MAX_THREADS: usize = 4096;

/// An open backend: the process that opened it, and what was asked for.
type Opened = (u32, BackendOptions, Arc<dyn Backend>);

static OPEN: Mutex<Vec<Opened>> = Mutex::new(Vec::new());

/// "auto", "gpu", "parallel" or "serial", with so many threads.
pub(crate) fn open(name: &str, threads: Option<usize>) -> PyResult<Arc<dyn Backend>> {
    let choice = match name {
        "auto" => BackendChoice::Auto,
        "gpu" => BackendChoice::Only(BackendKind::Gpu),
        "parallel" => BackendChoice::Only(BackendKind::Parallel),
        "serial" => BackendChoice::Only(BackendKind::Serial),
        other => return Err(input(format!("backend {other:?} is none of auto, gpu, parallel, serial"))),
    };
    if let Some(threads) = threads.filter(|threads| !(1..=MAX_THREADS).contains(threads)) {
        return Err(input(format!("threads is {threads}; 1 to {MAX_THREADS} are possible")));
    }
    let mut options = BackendOptions::new().with_choice(choice);
    options.threads = threads;
    let process = std::process::id();
    let mut open = OPEN.lock().unwrap_or_else(PoisonError::into_inner);
    // Another process's threads are not here: it is left alone, since its end would wait for them.
    for (of, _, backend) in open.extract_if(.., |(of, ..)| *of != process) {
        debug_assert_ne!(of, process);
        std::mem::forget(backend);
    }
    if let Some((.., backend)) = open.iter().find(|(_, of, _)| *of == options) {
        return Ok(Arc::clone(backend));
    }
    let backend = options.open().map_err(|error| engine(error.into()))?;
    open.push((process, options, Arc::clone(&backend)));
    Ok(backend)
}

/// The one that options ask for.
pub(crate) fn of(py: Python<'_>, options: &Options<'_>) -> PyResult<Arc<dyn Backend>> {
    let (name, threads) = options.backend()?;
    py.detach(|| open(&name, threads))
}

/// `backend(name, threads) -> dict`: describes a backend.
///
/// The backend that work is done on: its kind, threads, and the adapter of a GPU.
#[pyfunction]
#[pyo3(signature = (name = "auto", threads = None))]
pub(crate) fn backend<'py>(py: Python<'py>, name: &str, threads: Option<usize>) -> PyResult<Bound<'py, PyDict>> {
    let name = name.to_owned();
    let backend = py.detach(|| open(&name, threads))?;
    let facts = PyDict::new(py);
    facts.set_item("kind", backend.kind().name())?;
    facts.set_item("threads", backend.threads())?;
    facts.set_item("adapter", backend.adapter())?;
    Ok(facts)
}
