//! The diagram in f64, where single precision lost some of it.
//!
//! Purpose: pieces that do not cover the surface are not an answer. Seeds a rounding apart, facets
//! in the bisector of two seeds, surfaces made of slivers: there single precision gives one point to
//! two cells or to none, the areas do not add up, and the pass is done again in f64.
//! Invariant: a GPU session covers the surface within the tolerance of `Clip::covers`, or is exact.
//! Must not know: why the areas did not add up.

use std::ops::Range;
use std::sync::Arc;

use super::GpuSession;
use crate::diagram::neighbours::Place;
use geometry::rvd::parallel::Parallel;
use geometry::rvd::{Backend, CellSums, PassStats, PieceBatch, RvdError, Session, SessionOptions};
use geometry::token::Token;

impl GpuSession {
    /// The sums again, in f64. `lost` is what the device's pass did.
    pub(super) fn sums_in_f64(
        &mut self,
        out: &mut CellSums,
        lost: PassStats,
        token: &Token,
    ) -> Result<PassStats, RvdError> {
        Ok(finished(lost, self.in_f64()?.sums(out, token)?))
    }

    /// The pieces again, in f64.
    pub(super) fn pieces_in_f64(
        &mut self,
        facets: Range<u32>,
        out: &mut PieceBatch,
        lost: PassStats,
        token: &Token,
    ) -> Result<PassStats, RvdError> {
        Ok(finished(lost, self.in_f64()?.pieces(facets, out, token)?))
    }

    fn in_f64(&mut self) -> Result<Box<dyn Session>, RvdError> {
        // With capacities of its own: these may show in the last bits.
        let options = SessionOptions::new(self.cx.max_seeds);
        let mut session = Parallel::on(Arc::clone(&self.cx.pool)).session(Arc::clone(&self.cx.surface), options)?;
        if self.neighbours.place == Place::Set {
            session.set_seeds(&self.neighbours.seeds)?;
        } else {
            self.view()?;
            session.set_seeds(&self.neighbours.host.seen)?;
        }
        Ok(session)
    }
}

/// The figures of both passes; every pair was finished in f64.
fn finished(lost: PassStats, done: PassStats) -> PassStats {
    let mut stats = lost;
    stats.add(&done);
    PassStats { pairs: done.pairs, f64_finished: done.pairs, duplicate_seeds: lost.duplicate_seeds, ..stats }
}
