//! Moves shortened until no facet turns or becomes a sliver.
//!
//! Purpose: what a facet was before a fit, and what it may become.
//! Invariant: a facet is looked at again only if a corner's move was shortened: the answer is that of looking at all.
//! Must not know: why vertices move.

use glam::DVec3;
use rayon::prelude::*;

use super::Draft;
use super::region::Region;
use crate::mesh::measure::facet_quality;

/// Facets keep at least this quality (1 is equilateral) and this smallest angle in degrees, or what they had.
const LEAST_SHAPE: f64 = 0.63;
const LEAST_ANGLE: f64 = 35.0;
/// A facet's normal turns by at most this cosine from that before the fit.
const LEAST_COSINE: f64 = 0.5;
/// Times that moves are halved, and then that they are dropped.
const HALVINGS: usize = 4;
const DROPS: usize = 4;
/// Facets that are not worth a task of their own.
const SHARE: usize = 256;

/// What a facet is.
pub(super) struct Facet {
    normal: DVec3,
    shape: f64,
    /// Cotangent of its smallest angle.
    cotangent: f64,
}

impl Facet {
    pub(super) fn of(positions: &[DVec3], t: [u32; 3]) -> Self {
        Self::with(t.map(|v| positions[v as usize]))
    }

    fn with([a, b, c]: [DVec3; 3]) -> Self {
        let (u, v, w) = (b - a, c - b, a - c);
        let across = u.cross(-w);
        let twice = across.length();
        // The smallest angle lies between the sides with the largest product.
        let most = -u.dot(v).min(v.dot(w)).min(w.dot(u));
        let cotangent = if twice > 0.0 { most / twice } else { f64::INFINITY };
        Self { normal: across.normalize_or_zero(), shape: facet_quality([a, b, c]), cotangent }
    }
}

/// Shortens `moves`, one a vertex, of those inside the region.
pub(super) fn restrain(draft: &Draft<'_>, first: &[Facet], region: &Region, moves: &mut [DVec3]) {
    let sharpest = 1.0 / LEAST_ANGLE.to_radians().tan();
    let mut looked_at = region.facets.clone();
    for round in 0..HALVINGS + DROPS {
        let is_spoilt = |f: &u32| {
            let before = &first[*f as usize];
            let t = draft.facets[*f as usize];
            let after = Facet::with(t.map(|v| draft.positions[v as usize] + moves[v as usize]));
            after.normal.dot(before.normal) < LEAST_COSINE
                || after.shape < before.shape.min(LEAST_SHAPE)
                || after.cotangent > before.cotangent.max(sharpest)
        };
        let spoilt: Vec<u32> = looked_at.par_iter().with_min_len(SHARE).copied().filter(is_spoilt).collect();
        if spoilt.is_empty() {
            return;
        }
        let factor = if round < HALVINGS { 0.5 } else { 0.0 };
        let mut shortened: Vec<u32> = spoilt.iter().flat_map(|&f| draft.facets[f as usize]).collect();
        shortened.sort_unstable();
        shortened.dedup();
        shortened.iter().for_each(|&v| moves[v as usize] *= factor);
        looked_at = shortened.iter().flat_map(|&v| draft.around.of(v)).copied().collect();
        looked_at.retain(|&f| region.place(f) != super::region::NONE);
        looked_at.sort_unstable();
        looked_at.dedup();
    }
}
