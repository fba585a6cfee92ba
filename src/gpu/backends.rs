//! Opens a backend: the only module that names all three.
//!
//! Purpose: [`BackendOptions::open`] makes the backend that a caller chooses, or the best one that is there. Invariant:
//! [`BackendChoice::Auto`] never fails for want of a GPU. Must not know: jobs, the command line.

use std::sync::Arc;
use std::time::Duration;

use geometry::rvd::{Backend, BackendChoice, BackendKind, Parallel, RvdError, Serial};
use geometry::setters;

#[cfg(feature = "device")]
use crate::diagram::{Gpu, SharedGpu};
#[cfg(feature = "device")]
use crate::{Device, DeviceOptions};

/// Which backend does the work, and with how many threads.
///
/// ```
/// use tessera::{BackendChoice, BackendKind, BackendOptions};
/// let backend = BackendOptions::new().with_choice(BackendChoice::Only(BackendKind::Parallel)).with_threads(2).open()?;
/// assert_eq!((backend.kind(), backend.threads()), (BackendKind::Parallel, 2));
/// # Ok::<(), tessera::RvdError>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct BackendOptions {
    /// Which backend. By default the GPU if there is one, else the parallel backend.
    pub choice: BackendChoice,
    /// Threads of the pool, at least 1. `None`, the default, is one for each core.
    pub threads: Option<usize>,
    /// Whether an adapter that runs on the CPU may stand in for a GPU. Off by default: it is slower than the parallel backend.
    pub software_gpu: bool,
    /// How long the GPU may take for one submission until it counts as lost; a minute by default.
    pub gpu_timeout: Option<Duration>,
    /// How many adapters share the facets of a job; 0, the default, and 1 are the best one alone, `usize::MAX` is all.
    pub gpu_adapters: usize,
    /// Memory of a device that a session may take, bytes. Records of facets that it does not hold are sent when their turn comes.
    pub gpu_memory_bytes: Option<u64>,
}

/// Why there is no GPU backend.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoGpu {
    /// The library was built without the feature `gpu`.
    #[error("this build has no GPU backend; build it with the cargo feature `gpu`")]
    NotBuilt,
    /// No adapter can be used.
    #[error("{0}")]
    NoAdapter(String),
    /// There are fewer adapters than are to share the work.
    #[error("{wanted} GPU adapters are asked for, and {found} can be used")]
    TooFew {
        /// How many are asked for.
        wanted: usize,
        /// How many there are.
        found: usize,
    },
    /// An adapter opens and then fails: a fault of its driver.
    #[error("the GPU was found but does not work: {0}")]
    Broken(String),
}

impl BackendOptions {
    /// The defaults.
    pub fn new() -> Self {
        Self::default()
    }

    setters! {
        with_choice(choice: BackendChoice),
        with_threads(threads: usize => Some(threads)),
        with_software_gpu(software_gpu: bool),
        with_gpu_timeout(gpu_timeout: Duration => Some(gpu_timeout)),
        with_gpu_adapters(gpu_adapters: usize),
        with_gpu_memory_bytes(gpu_memory_bytes: u64 => Some(gpu_memory_bytes)),
    }

    /// Makes the backend. One for each process is enough: it may be shared by threads and by calls.
    ///
    /// # Errors
    /// `BackendUnavailable` if the GPU alone is asked for and there is none; `Internal` if the system refuses threads.
    pub fn open(&self) -> Result<Arc<dyn Backend>, RvdError> {
        match self.choice {
            BackendChoice::Only(BackendKind::Serial) => Ok(Arc::new(Serial)),
            BackendChoice::Only(BackendKind::Parallel) => self.parallel(),
            BackendChoice::Only(wanted @ BackendKind::Gpu) => {
                self.gpu().map_err(|why| RvdError::BackendUnavailable { wanted, reason: why.to_string() })
            }
            BackendChoice::Auto => self.gpu().or_else(|_| self.parallel()),
        }
    }

    fn parallel(&self) -> Result<Arc<dyn Backend>, RvdError> {
        Ok(Arc::new(Parallel::new(self.threads)?))
    }

    #[cfg(feature = "device")]
    fn gpu(&self) -> Result<Arc<dyn Backend>, NoGpu> {
        self.open_gpus()
    }

    #[cfg(not(feature = "device"))]
    fn gpu(&self) -> Result<Arc<dyn Backend>, NoGpu> {
        Err(NoGpu::NotBuilt)
    }

    /// The GPU backend with all its methods.
    #[cfg(feature = "device")]
    pub fn open_gpu(&self) -> Result<Arc<Gpu>, NoGpu> {
        let device = Device::open(&self.device_options()).map_err(|e| NoGpu::NoAdapter(e.to_string()))?;
        Ok(Arc::new(Gpu::new(device, self.threads).map_err(|e| NoGpu::Broken(e.to_string()))?))
    }

    #[cfg(feature = "device")]
    fn device_options(&self) -> DeviceOptions {
        let usual = DeviceOptions::default();
        let timeout = self.gpu_timeout.unwrap_or(usual.timeout);
        DeviceOptions { software: self.software_gpu, timeout, memory_bytes: self.gpu_memory_bytes, ..usual }
    }

    /// The GPU backend on as many adapters as are asked for.
    #[cfg(feature = "device")]
    pub fn open_gpus(&self) -> Result<Arc<dyn Backend>, NoGpu> {
        if self.gpu_adapters <= 1 {
            return Ok(self.open_gpu()?);
        }
        let opened = Device::open_up_to(&self.device_options(), self.gpu_adapters);
        let devices = opened.map_err(|e| NoGpu::NoAdapter(e.to_string()))?;
        if self.gpu_adapters != usize::MAX && devices.len() < self.gpu_adapters {
            return Err(NoGpu::TooFew { wanted: self.gpu_adapters, found: devices.len() });
        }
        let broken = |e: RvdError| NoGpu::Broken(e.to_string());
        let gpus = devices.into_iter().map(|device| Gpu::new(device, self.threads).map(Arc::new));
        let mut gpus: Vec<Arc<Gpu>> = gpus.collect::<Result<_, _>>().map_err(broken)?;
        match (gpus.len(), gpus.pop()) {
            (1, Some(gpu)) => Ok(gpu),
            (_, last) => {
                gpus.extend(last);
                Ok(Arc::new(SharedGpu::new(gpus).map_err(broken)?))
            }
        }
    }
}

/// The GPU if there is one, else all cores of the CPU: [`BackendOptions::open`] with the defaults.
pub fn auto_backend() -> Result<Arc<dyn Backend>, RvdError> {
    BackendOptions::new().open()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_asks_for_anything_gets_something() {
        let backend = BackendOptions::new().with_threads(1).open().unwrap();
        assert_ne!(backend.kind(), BackendKind::Serial);
        let serial = BackendOptions::new().with_choice(BackendChoice::Only(BackendKind::Serial)).open().unwrap();
        assert_eq!((serial.kind(), serial.threads()), (BackendKind::Serial, 1));
    }

    #[test]
    fn a_gpu_that_is_not_there_is_an_error_only_for_who_wants_no_other() {
        match BackendOptions::new().with_choice(BackendChoice::Only(BackendKind::Gpu)).with_threads(1).open() {
            Ok(backend) => assert_eq!(backend.kind(), BackendKind::Gpu),
            Err(error) => assert!(matches!(error, RvdError::BackendUnavailable { wanted: BackendKind::Gpu, .. })),
        }
    }
}
