//! A CPU backend whose passes are counted and traced.
//!
//! Purpose: [`Observed`] hands everything on to the backend inside; its sessions report when a pass began and ended.
//! Invariant: what is observed does what the inner backend does, with the same bits. Must not know: who counts.

use std::sync::Arc;

use super::gate::GatedSession;
use super::observer::Activity;
use geometry::rvd::{Backend, BackendKind, DeviceFacts, RvdError, Session, SessionOptions, Surface};

/// See the module's head.
pub(crate) struct Observed {
    pub inner: Arc<dyn Backend>,
    pub activity: Arc<Activity>,
}

impl Observed {
    fn session_of(&self, session: Box<dyn Session>) -> Box<dyn Session> {
        Box::new(GatedSession::new(session, None, self.inner.kind(), Arc::clone(&self.activity)))
    }
}

impl Backend for Observed {
    fn pool(&self) -> Option<Arc<rayon::ThreadPool>> {
        self.inner.pool()
    }

    fn kind(&self) -> BackendKind {
        self.inner.kind()
    }

    fn adapter(&self) -> Option<String> {
        self.inner.adapter()
    }

    fn device_facts(&self) -> Option<DeviceFacts> {
        self.inner.device_facts()
    }

    fn threads(&self) -> usize {
        self.inner.threads()
    }

    fn exact_session(&self, surface: Arc<Surface>, options: SessionOptions) -> Result<Box<dyn Session>, RvdError> {
        Ok(self.session_of(self.inner.exact_session(surface, options)?))
    }

    fn session(&self, surface: Arc<Surface>, options: SessionOptions) -> Result<Box<dyn Session>, RvdError> {
        Ok(self.session_of(self.inner.session(surface, options)?))
    }
}
