//! The diagram in f64, where single precision lost some of it.
//!
//! Purpose: pieces that do not cover the surface are not an answer. Seeds a rounding apart, facets
//! in the bisector of two seeds, surfaces made of slivers: there single precision gives one point to
//! two cells or to none, the areas do not add up, and the pass is done again in f64.
//! Invariant: a GPU session covers the surface to [`COVER`], or is exact.
//! Must not know: why the areas did not add up.

use std::ops::Range;
use std::sync::Arc;

use super::GpuSession;
use super::search::Place;
use crate::rvd::parallel::Parallel;
use crate::rvd::{Backend, CellSums, PassStats, PieceBatch, RvdError, Session, SessionOptions};
use crate::token::Token;

/// Relative error of the area that single precision may have. Where nothing is lost it is below 10⁻⁷.
const COVER: f64 = 1e-6;

impl GpuSession {
    /// Whether `area` is that of the facets in `facets`.
    pub(super) fn covers(&self, area: f64, facets: Range<u32>) -> bool {
        let whole = facets.len() == self.facets.len();
        let expected = if whole {
            self.surface.area()
        } else {
            facets.filter(|&f| !self.surface.skips(f as usize)).map(|f| self.surface.facet_area(f)).sum()
        };
        (area - expected).abs() <= COVER * expected
    }

    /// Units of area, as limbs, between which the pieces of all facets cover the surface; within what
    /// [`Self::covers`] says by more than a rounding.
    pub(super) fn area_bounds(&self) -> ([u32; 2], [u32; 2]) {
        let at = |share: f64| self.scales.area * self.surface.area() * (1.0 + 0.999 * share);
        let limbs = |units: u64| [units as u32, (units >> 32) as u32];
        (limbs(at(-COVER).ceil() as u64), limbs(at(COVER).floor() as u64))
    }

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
        let options = SessionOptions::new(self.max_seeds);
        let mut session = Parallel::on(Arc::clone(&self.pool)).session(Arc::clone(&self.surface), options)?;
        if self.place == Place::Set {
            session.set_seeds(&self.seeds)?;
        } else {
            self.view()?;
            session.set_seeds(&self.host.seen)?;
        }
        Ok(session)
    }
}

/// The totals of both passes; every pair was finished in f64.
fn finished(lost: PassStats, done: PassStats) -> PassStats {
    let mut stats = lost;
    stats.add(&done);
    PassStats { pairs: done.pairs, f64_finished: done.pairs, duplicate_seeds: lost.duplicate_seeds, ..stats }
}
