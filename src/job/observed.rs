//! A CPU backend whose passes are told.
//!
//! Purpose: [`Observed`] hands everything on to the backend inside, and tells when a pass began and ended.
//! Invariant: what is observed does what the inner backend does, with the same bits. Must not know: who counts.

use std::ops::Range;
use std::sync::Arc;

use glam::DVec3;

use super::observer::Told;
use crate::rvd::{
    Backend, BackendKind, CellSums, DeviceFacts, DeviceWork, PassStats, PhasesMs, PieceBatch, Resident, RvdError,
    Session, SessionOptions, Surface,
};
use crate::token::Token;

/// See the module's head.
pub(crate) struct Observed {
    pub(crate) inner: Arc<dyn Backend>,
    pub(crate) told: Arc<Told>,
}

impl Observed {
    fn session_of(&self, session: Box<dyn Session>) -> Box<dyn Session> {
        Box::new(ObservedSession { session, kind: self.inner.kind(), told: Arc::clone(&self.told) })
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

struct ObservedSession {
    session: Box<dyn Session>,
    kind: BackendKind,
    told: Arc<Told>,
}

impl Session for ObservedSession {
    fn set_seeds(&mut self, seeds: &[DVec3]) -> Result<(), RvdError> {
        self.session.set_seeds(seeds)
    }

    fn sums(&mut self, out: &mut CellSums, token: &Token) -> Result<PassStats, RvdError> {
        let _pass = self.told.pass("sums", self.kind);
        self.session.sums(out, token)
    }

    fn pieces(&mut self, facets: Range<u32>, out: &mut PieceBatch, token: &Token) -> Result<PassStats, RvdError> {
        let _pass = self.told.pass("pieces", self.kind);
        self.session.pieces(facets, out, token)
    }

    fn device_bytes(&self) -> u64 {
        self.session.device_bytes()
    }

    fn device_work(&self) -> DeviceWork {
        self.session.device_work()
    }

    fn device_phases(&self) -> Option<PhasesMs> {
        self.session.device_phases()
    }

    fn resident(&mut self) -> Option<&mut dyn Resident> {
        self.session.resident()
    }
}
