//! A session whose facets are read in windows.
//!
//! Purpose: seeds, their rows and sums stay in memory; every pass takes the facets of a [`FacetFile`] from one end to the other.
//! Invariant: the bits of a session with all facets. Facets come in its order, windows begin where its blocks do, and rows,
//! which are made once for a pass, find the same seeds for a facet as its lists. Must not know: files.

use std::ops::Range;
use std::sync::Arc;

use glam::DVec3;

use super::{From, MANY, Parallel, ParallelSession, block_of};
use crate::knn::{SeedIndex, Threads};
use crate::rvd::on_host::OnHost;
use crate::rvd::out_of_core::FacetFile;
use crate::rvd::{CellSums, PassStats, PieceBatch, RvdError, Session, SessionOptions, Surface};
use crate::token::Token;

struct WindowedSession {
    session: ParallelSession<DVec3>,
    facets: Arc<FacetFile>,
    bytes: Vec<u8>,
}

impl Parallel {
    /// A session for a surface that is larger than memory. It has sums, and no pieces.
    pub fn windowed_session(&self, facets: Arc<FacetFile>, options: SessionOptions) -> Box<dyn Session> {
        let mut session = ParallelSession::new(&self.pool, Arc::new(Surface::none()), options);
        session.of = facets.facets();
        Box::new(OnHost::new(WindowedSession { session, facets, bytes: Vec::new() }, Some(Arc::clone(&self.pool))))
    }
}

impl WindowedSession {
    fn sum_up(&mut self, out: &mut CellSums, token: &Token) -> Result<PassStats, RvdError> {
        let Self { session, facets, bytes } = self;
        if session.stale {
            // Before there is a new one.
            session.index = SeedIndex::with_threads(&[], Threads::One);
        }
        let mut stats = PassStats { neighbours_ms: session.refresh_rows(token)?, ..PassStats::default() };
        stats.duplicate_seeds = session.index.duplicates() as u64;
        out.reset(session.seeds.len());
        session.lists.leave();
        let coarse = session.seeds.len() > MANY * facets.facets();
        let block = block_of(session.seeds.len(), session.of);
        let window = (facets.window() / block * block).max(block);
        for first in (0..facets.count()).step_by(window) {
            token.check()?;
            let count = window.min(facets.count() - first);
            let surface = Arc::get_mut(&mut session.surface)
                .ok_or_else(|| RvdError::Internal("a window is shared".to_owned()))?;
            facets.read(first, count, bytes, surface)?;
            session.order.take_in_turn(&session.surface);
            if let Some(added) = session.add_facets(out, From::Rows { coarse }, token)? {
                stats.add(&added.stats);
            }
        }
        Ok(stats)
    }
}

impl Session for WindowedSession {
    fn set_seeds(&mut self, seeds: &[DVec3]) -> Result<(), RvdError> {
        self.session.set_seeds(seeds)
    }

    fn sums(&mut self, out: &mut CellSums, token: &Token) -> Result<PassStats, RvdError> {
        let pool = Arc::clone(&self.session.pool);
        pool.install(|| self.sum_up(out, token))
    }

    fn pieces(&mut self, _: Range<u32>, out: &mut PieceBatch, _: &Token) -> Result<PassStats, RvdError> {
        out.clear();
        Err(RvdError::NoPieces)
    }
}
