//! The GPU backend on several devices.
//!
//! Purpose: [`SharedGpu`] shares the facets of each surface out to its devices in ranges of one length. A lifted surface is done by
//! the first one alone.
//! Invariant: sums, and seeds that move, have the same bits on any number of devices of one kind. Must not know: how facets are done.

use std::sync::Arc;

use super::session::SharedSession;
use super::{Gpu, Result};
use geometry::rvd::{Backend, BackendKind, DeviceFacts, Lifted, RvdError, Session, SessionOptions, Surface};

/// Several devices that share the facets of each job.
#[derive(Debug)]
pub struct SharedGpu {
    gpus: Vec<Arc<Gpu>>,
}

impl SharedGpu {
    /// Shares facets out to these. The first one also moves seeds, and does what has to be done at one place.
    ///
    /// # Errors
    /// `Internal` without any.
    pub fn new(gpus: Vec<Arc<Gpu>>) -> Result<Self> {
        match gpus.is_empty() {
            true => Err(RvdError::Internal("no device to share facets out to".to_owned())),
            false => Ok(Self { gpus }),
        }
    }

    /// The devices.
    pub fn devices(&self) -> &[Arc<Gpu>] {
        &self.gpus
    }

    fn first(&self) -> &Gpu {
        &self.gpus[0]
    }
}

impl Backend for SharedGpu {
    fn kind(&self) -> BackendKind {
        BackendKind::Gpu
    }

    fn adapter(&self) -> Option<String> {
        let names = self.gpus.iter().filter_map(|gpu| gpu.adapter());
        Some(names.collect::<Vec<_>>().join(" + "))
    }

    fn device_facts(&self) -> Option<DeviceFacts> {
        let all = self.gpus.iter().filter_map(|gpu| gpu.device_facts()?.allocated_bytes);
        Some(DeviceFacts { allocated_bytes: all.reduce(|a, b| a + b), ..self.first().device_facts()? })
    }

    fn threads(&self) -> usize {
        self.first().threads()
    }

    fn pool(&self) -> Option<Arc<rayon::ThreadPool>> {
        self.first().pool()
    }

    fn exact_session(&self, surface: Arc<Surface>, options: SessionOptions) -> Result<Box<dyn Session>> {
        self.first().exact_session(surface, options)
    }

    fn session(&self, surface: Arc<Surface>, options: SessionOptions) -> Result<Box<dyn Session>> {
        Ok(Box::new(SharedSession::open(&self.gpus, &surface, options)?))
    }

    fn lifted_session(
        &self,
        surface: Arc<Surface<Lifted>>,
        options: SessionOptions,
    ) -> Result<Box<dyn Session<Lifted>>> {
        self.first().lifted_session(surface, options)
    }

    fn exact_lifted_session(
        &self,
        surface: Arc<Surface<Lifted>>,
        options: SessionOptions,
    ) -> Result<Box<dyn Session<Lifted>>> {
        self.first().exact_lifted_session(surface, options)
    }
}
