//! Jobs: the queue, the threads that do the work, and jobs as data.
//!
//! A job as data is a [`record`], moves along the machine of [`record::state`], says what happens by [`record::event`], and is kept in a
//! [`store`].
//!
//! Purpose: [`Engine`] takes work from many callers and does it on a bounded number of host threads, which share the
//! device. A piece is short or checks its [`Token`], and never waits for a client: state that outlives a piece (a session)
//! moves out and in again. Invariant: every submitted piece is answered exactly once or its caller has gone; a panic ends
//! the piece and not the thread; work of a caller that is gone is skipped or cancelled. Must not know: gRPC, messages, the
//! command line.

#![warn(unreachable_pub)]
// Fields, variants and errors that their names or messages explain; the callers are crates of this workspace.
#![allow(missing_docs)]

pub mod admission;
pub mod beside;
pub mod blob;
pub mod engine;
pub mod executor;
pub mod memory;
pub mod observe;
pub mod places;
#[cfg(feature = "postgres")]
pub mod postgres;
pub mod record;
pub mod store;

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use geometry::mesh::MeshError;
use geometry::remesh::RemeshError;
use geometry::rvd::{Backend, BackendChoice, BackendKind, RvdError};
use geometry::token::{Stopped, Token};

pub use engine::{Admission, AdmissionRequest, Bytes, Ceilings, Engine, EngineOptions, LossPolicy, Retry, Weights};
pub use engine::{Device, Pending, Reservation, Timed, Work, WorkContext};
pub use executor::{Executor, ExecutorOptions, Stores};

/// Locks a mutex whose content is never left half changed, so that it is good even after a panic.
pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Makes a CPU backend with this many threads of its own.
pub type PoolFactory = fn(usize) -> Result<Arc<dyn Backend>, RvdError>;

#[derive(Clone)]
pub struct Backends {
    /// The GPU backend, or the reason why there is none.
    pub gpu: Result<Arc<dyn Backend>, String>,
    /// Double precision on all threads of a pool.
    pub parallel: Arc<dyn Backend>,
    /// Double precision on one thread.
    pub serial: Arc<dyn Backend>,
    /// What [`BackendChoice::Auto`] means here; `Auto` again means the GPU if there is one.
    pub default: BackendChoice,
    /// Makes more of `parallel`, so that each job at work has threads of its own; without, all jobs share `parallel`.
    pub pools: Option<PoolFactory>,
}

impl Backends {
    /// What a job sees: `host` in place of `parallel`, and the GPU through the gate. Passes are counted and traced.
    fn for_job(
        &self,
        gate: &Arc<engine::Gate>,
        host: Option<&Arc<dyn Backend>>,
        activity: &Arc<observe::activity::Activity>,
    ) -> Self {
        let seen = |backend: &Arc<dyn Backend>, shared| -> Arc<dyn Backend> {
            Arc::new(engine::Gated { backend: Arc::clone(backend), shared, activity: Arc::clone(activity) })
        };
        let (host, serial) = (seen(host.unwrap_or(&self.parallel), None), seen(&self.serial, None));
        let shared = |device: &Arc<dyn Backend>| seen(device, Some((Arc::clone(gate), Arc::clone(&host))));
        let gpu = self.gpu.as_ref().map(shared).map_err(Clone::clone);
        Self { gpu, parallel: host, serial, ..self.clone() }
    }

    /// The backend for a choice. Errors: [`RvdError::BackendUnavailable`] if the GPU is asked for and there is none.
    pub fn choose(&self, choice: BackendChoice) -> Result<&Arc<dyn Backend>, JobError> {
        let choice = if choice == BackendChoice::Auto { self.default } else { choice };
        match (choice, &self.gpu) {
            (BackendChoice::Auto | BackendChoice::Only(BackendKind::Gpu), Ok(gpu)) => Ok(gpu),
            (BackendChoice::Only(BackendKind::Gpu), Err(reason)) => {
                Err(RvdError::BackendUnavailable { wanted: BackendKind::Gpu, reason: reason.clone() }.into())
            }
            (BackendChoice::Auto | BackendChoice::Only(BackendKind::Parallel), _) => Ok(&self.parallel),
            (BackendChoice::Only(BackendKind::Serial), _) => Ok(&self.serial),
        }
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BackendInfo {
    pub kind: BackendKind,
    pub adapter: Option<String>,
    /// Of a GPU: its interface and its driver.
    pub driver: Option<String>,
    pub threads: usize,
}

impl BackendInfo {
    pub fn of(backend: &dyn Backend) -> Self {
        let driver = backend.device_facts().map(|facts| format!("{} {}", facts.api, facts.driver));
        Self { kind: backend.kind(), adapter: backend.adapter(), driver, threads: backend.threads() }
    }
}

#[derive(Clone, Debug, thiserror::Error)]
pub enum JobError {
    #[error("{waiting} jobs wait already, as many as may; try again in {} s", .retry_after.as_secs_f64())]
    QueueFull { waiting: usize, retry_after: Duration },
    #[error("the server is shutting down; try again, or try another server")]
    Draining,
    #[error("internal error: the work panicked: {0}")]
    Panicked(String),
    #[error("internal error: the engine has ended")]
    WorkerGone,
    #[error(transparent)]
    Mesh(#[from] MeshError),
    #[error(transparent)]
    Rvd(#[from] RvdError),
    #[error(transparent)]
    Remesh(#[from] RemeshError),
}

impl JobError {
    /// The diagram's error inside, wherever it came from.
    pub fn as_rvd(&self) -> Option<&RvdError> {
        match self {
            Self::Rvd(e) | Self::Remesh(RemeshError::Rvd(e)) => Some(e),
            _ => None,
        }
    }

    pub fn is_device_lost(&self) -> bool {
        matches!(self.as_rvd(), Some(RvdError::DeviceLost(_)))
    }

    pub fn is_cancelled(&self) -> bool {
        matches!(self.as_rvd(), Some(RvdError::Stopped(Stopped::Cancelled)))
    }
}

impl From<Stopped> for JobError {
    fn from(reason: Stopped) -> Self {
        Self::Rvd(reason.into())
    }
}

/// Cancels when dropped: a caller that waits for work holds one, so that going away stops the work.
#[derive(Debug)]
pub struct CancelOnDrop(Option<Token>);

impl CancelOnDrop {
    pub fn new(token: &Token) -> Self {
        Self(Some(token.clone()))
    }

    /// The work has ended; the token may be that of more to come.
    pub fn disarm(mut self) {
        self.0 = None;
    }
}

impl Drop for CancelOnDrop {
    fn drop(&mut self) {
        self.0.iter().for_each(Token::cancel);
    }
}
