//! Edge flips in a whole result.
//!
//! Purpose: an edge that lies across a ridge of the input lets the ridge stick out wherever its ends are; the other diagonal of
//! its two facets lies along the ridge. [`flip_along_ridges`] flips such edges, [`flip_for_angles`] edges of bad triangles.
//! Invariant: a manifold stays one, inner valences stay between 5 and 7 where they were, no facet turns over or becomes a
//! sliver, edges of curves stay. The same bits whatever the number of threads.
//! Must not know: seeds, diagrams, files.

use std::collections::HashSet;

use glam::DVec3;
use rayon::prelude::*;

use crate::mesh::closest_point::closest_on_facet;
use crate::mesh::csr::Csr;
use crate::mesh::edges::undirected;
use crate::mesh::measure::{facet_quality, least_angle};
use crate::remesh::distance::deviation::{Deviation, InputDeviation, STICKS_OUT};
use crate::remesh::triangle::{score, unit_normal};
use crate::token::Token;

/// A vertex of the input that sticks out comes nearer by at least this factor.
const GAIN: f64 = 0.8;
/// New facets at ridges have at least this quality,
const LEAST_QUALITY: f64 = 0.63;
/// this smallest angle, degrees,
const LEAST_ANGLE: f64 = 35.0;
/// and, as all new facets, a normal of at least this cosine to the mean of the old ones.
const LEAST_COSINE: f64 = 0.3;
/// A flip for angles raises the lesser score by more than this, degrees.
const LEAST_GAIN: f64 = 0.5;
/// The valences that flips keep.
const VALENCES: [usize; 2] = [5, 7];

/// One-rings of more facets than this are searched through a set, not by comparing each facet with each.
const LARGE_RING: usize = 64;

/// Flips edges that are not in `curves` (lower end first). Returns the facets that changed. `rings` are the one-rings before.
pub(in crate::remesh) fn flip_along_ridges(
    positions: &[DVec3],
    facets: &mut [[u32; 3]],
    rings: &Csr<u32>,
    deviations: &InputDeviation<'_>,
    curves: &HashSet<[u32; 2]>,
    token: &Token,
) -> Vec<u32> {
    let sticking_out = deviations.largest_first(|d| d.relative > STICKS_OUT);
    let mut touched = vec![false; facets.len()];
    let mesh = Triangulation { positions, facets, rings };
    // The best flip for each if nothing else changed.
    let alone = |(k, d): &(usize, Deviation)| match token.is_stopped() {
        true => None,
        false => mesh.best(deviations.position(*k), d.facet, curves, &touched),
    };
    let flips: Vec<Option<Flip>> = sticking_out.par_iter().map(alone).collect();
    let mut changed = Vec::new();
    for ((k, d), flip) in sticking_out.into_iter().zip(flips) {
        if token.is_stopped() {
            break;
        }
        let stands =
            !touched[d.facet as usize] && flip.is_none_or(|t| !touched[t.0 as usize] && !touched[t.1 as usize]);
        let mesh = Triangulation { positions, facets, rings };
        let flip = if stands { flip } else { mesh.best(deviations.position(k), d.facet, curves, &touched) };
        if let Some((f, g, new)) = flip {
            // Nothing else changes around a changed facet in this round, since `rings` are those before.
            touch(&mut touched, rings, [facets[f as usize], facets[g as usize]]);
            (facets[f as usize], facets[g as usize]) = (new[0], new[1]);
            changed.extend([f, g]);
        }
    }
    changed
}

/// Flips edges of facets with a score below `goal` where the lesser score of the two facets grows. Returns whether any was
/// flipped.
pub(in crate::remesh) fn flip_for_angles(
    positions: &[DVec3],
    facets: &mut [[u32; 3]],
    rings: &Csr<u32>,
    curves: &HashSet<[u32; 2]>,
    goal: f64,
    token: &Token,
) -> bool {
    let score = |t: &[u32; 3]| score(t.map(|v| positions[v as usize]));
    let scores = facets.par_iter().enumerate().map(|(f, t)| (score(t), f as u32));
    let mut poor: Vec<(f64, u32)> = scores.filter(|p| p.0 < goal).collect();
    poor.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut touched = vec![false; facets.len()];
    let mut changed = false;
    for (_, f) in poor {
        if token.is_stopped() {
            break;
        }
        let mesh = Triangulation { positions, facets, rings };
        let flips = (0..3).filter_map(|side| mesh.flip(f, side, curves, &touched));
        let gain = |flip: &Flip| {
            let before = score(&facets[flip.0 as usize]).min(score(&facets[flip.1 as usize]));
            score(&flip.2[0]).min(score(&flip.2[1])) - before
        };
        let best = flips.map(|flip| (gain(&flip), flip)).max_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((gain, (f, g, new))) = best
            && gain > LEAST_GAIN
        {
            touch(&mut touched, rings, [facets[f as usize], facets[g as usize]]);
            (facets[f as usize], facets[g as usize]) = (new[0], new[1]);
            changed = true;
        }
    }
    changed
}

/// Marks all facets around two.
fn touch(touched: &mut [bool], rings: &Csr<u32>, two: [[u32; 3]; 2]) {
    two.into_iter().flatten().flat_map(|v| rings.of(v)).for_each(|&f| touched[f as usize] = true);
}

/// The triangulation as it is.
struct Triangulation<'a> {
    positions: &'a [DVec3],
    facets: &'a [[u32; 3]],
    rings: &'a Csr<u32>,
}

/// Two facets, and what they become.
type Flip = (u32, u32, [[u32; 3]; 2]);

impl Triangulation<'_> {
    /// The flip of an edge of `f` or of a facet that shares a corner with it which brings the facets nearest to `p`.
    fn best(&self, p: DVec3, f: u32, curves: &HashSet<[u32; 2]>, touched: &[bool]) -> Option<Flip> {
        let distance = |t: &[u32; 3]| closest_on_facet(p, t.map(|v| self.positions[v as usize]), *t).0;
        let before = distance(&self.facets[f as usize]);
        let mut best: Option<(f64, Flip)> = None;
        let mut near: Vec<u32> = Vec::new();
        for &g in self.facets[f as usize].into_iter().flat_map(|v| self.rings.of(v)) {
            if !near.contains(&g) {
                near.push(g);
            }
        }
        for f in near {
            for side in 0..3 {
                let Some(flip) = self.flip(f, side, curves, touched).filter(|flip| self.is_fine(flip)) else {
                    continue;
                };
                let after = flip.2.iter().map(distance).fold(f64::INFINITY, f64::min);
                if after < GAIN * GAIN * before && best.is_none_or(|(least, _)| after < least) {
                    best = Some((after, flip));
                }
            }
        }
        best.map(|(_, flip)| flip)
    }

    /// The flip of a side of `f`, if that is allowed.
    fn flip(&self, f: u32, side: usize, curves: &HashSet<[u32; 2]>, touched: &[bool]) -> Option<Flip> {
        let t = self.facets[f as usize];
        let (a, b, c) = (t[side], t[(side + 1) % 3], t[(side + 2) % 3]);
        let other =
            |&&g: &&u32| (0..3).any(|k| self.facets[g as usize][k] == b && self.facets[g as usize][(k + 1) % 3] == a);
        // The smaller of the two one-rings: one of them may be very large.
        let end = if self.rings.of(a).len() <= self.rings.of(b).len() { a } else { b };
        let &g = self.rings.of(end).iter().find(other)?;
        let d = *self.facets[g as usize].iter().find(|&&v| v != a && v != b)?;
        // Vertices of a boundary have no valence to keep.
        let loses = |v: u32| self.rings.of(v).len() > VALENCES[0] || self.is_on_boundary(v);
        let gains = |v: u32| self.rings.of(v).len() < VALENCES[1] || self.is_on_boundary(v);
        if touched[f as usize] || touched[g as usize] || !(loses(a) && loses(b) && gains(c) && gains(d)) {
            return None;
        }
        let (few, other) = if self.rings.of(c).len() <= self.rings.of(d).len() { (c, d) } else { (d, c) };
        let joined = self.rings.of(few).iter().any(|&h| self.facets[h as usize].contains(&other));
        if joined || curves.contains(&undirected([a, b])) {
            return None;
        }
        let corners = |t: [u32; 3]| t.map(|v| self.positions[v as usize]);
        let normal = |t: [u32; 3]| unit_normal(corners(t));
        let new = [[a, d, c], [d, b, c]];
        let mean = (normal(t) + normal(self.facets[g as usize])).normalize_or_zero();
        new.into_iter().all(|t| normal(t).dot(mean) >= LEAST_COSINE).then_some((f, g, new))
    }

    /// Whether an edge of `v` has one facet.
    fn is_on_boundary(&self, v: u32) -> bool {
        let ring = self.rings.of(v);
        let after = |f: &u32, by: usize| {
            let t = self.facets[*f as usize];
            (0..3).find(|&k| t[k] == v).map(|k| t[(k + by) % 3])
        };
        if ring.len() <= LARGE_RING {
            return ring.iter().any(|f| !ring.iter().any(|g| after(g, 2) == after(f, 1)));
        }
        let before: HashSet<Option<u32>> = ring.iter().map(|g| after(g, 2)).collect();
        ring.iter().any(|f| !before.contains(&after(f, 1)))
    }

    fn is_fine(&self, flip: &Flip) -> bool {
        let corners = |t: [u32; 3]| t.map(|v| self.positions[v as usize]);
        flip.2.iter().all(|&t| facet_quality(corners(t)) >= LEAST_QUALITY && least_angle(corners(t)) >= LEAST_ANGLE)
    }
}
