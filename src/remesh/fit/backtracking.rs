//! Backtracking of the fit's moves.
//!
//! Purpose: [`backtrack`] shortens moves until no facet turns over or becomes a sliver beside what it was.
//! Invariant: the answer is that of checking all facets each time, though a facet is checked again only if a corner's move was
//! shortened. Must not know: why vertices move.

use glam::DVec3;
use rayon::prelude::*;

use super::Triangulation;
use super::region::{NONE, Region};
use crate::mesh::measure::facet_quality;

/// Facets keep at least this quality (1 is equilateral), or what they had,
const LEAST_QUALITY: f64 = 0.63;
/// this smallest angle in degrees, or what they had,
const LEAST_ANGLE: f64 = 35.0;
/// and a normal of at least this cosine to that before the fit.
const LEAST_COSINE: f64 = 0.5;
/// Rounds that halve the moves of bad facets,
const HALVINGS: usize = 4;
/// and rounds after these that drop them.
const DROPS: usize = 4;
/// Facets per parallel task, at least.
const FACETS_PER_TASK: usize = 256;

/// The shape of a facet.
pub(super) struct FacetShape {
    normal: DVec3,
    quality: f64,
    /// Cotangent of its smallest angle.
    cotangent: f64,
}

impl FacetShape {
    pub(super) fn of(positions: &[DVec3], t: [u32; 3]) -> Self {
        Self::with(t.map(|v| positions[v as usize]))
    }

    fn with([a, b, c]: [DVec3; 3]) -> Self {
        let (u, v, w) = (b - a, c - b, a - c);
        let across = u.cross(-w);
        let twice = across.length();
        // The smallest angle lies between the sides of the largest scalar product.
        let most = -u.dot(v).min(v.dot(w)).min(w.dot(u));
        let cotangent = if twice > 0.0 { most / twice } else { f64::INFINITY };
        Self { normal: across.normalize_or_zero(), quality: facet_quality([a, b, c]), cotangent }
    }
}

/// Shortens `moves`, one a vertex, of the vertices inside the region. `first` are the shapes before the fit.
pub(super) fn backtrack(mesh: &Triangulation<'_>, first: &[FacetShape], region: &Region, moves: &mut [DVec3]) {
    let sharpest = 1.0 / LEAST_ANGLE.to_radians().tan();
    let mut checked = region.facets.clone();
    for round in 0..HALVINGS + DROPS {
        let is_bad = |f: &u32| {
            let before = &first[*f as usize];
            let t = mesh.facets[*f as usize];
            let after = FacetShape::with(t.map(|v| mesh.positions[v as usize] + moves[v as usize]));
            after.normal.dot(before.normal) < LEAST_COSINE
                || after.quality < before.quality.min(LEAST_QUALITY)
                || after.cotangent > before.cotangent.max(sharpest)
        };
        let bad: Vec<u32> = checked.par_iter().with_min_len(FACETS_PER_TASK).copied().filter(is_bad).collect();
        if bad.is_empty() {
            return;
        }
        let factor = if round < HALVINGS { 0.5 } else { 0.0 };
        let mut shortened: Vec<u32> = bad.iter().flat_map(|&f| mesh.facets[f as usize]).collect();
        shortened.sort_unstable();
        shortened.dedup();
        shortened.iter().for_each(|&v| moves[v as usize] *= factor);
        checked = shortened.iter().flat_map(|&v| mesh.rings.of(v)).copied().collect();
        checked.retain(|&f| region.facet_number(f) != NONE);
        checked.sort_unstable();
        checked.dedup();
    }
}
