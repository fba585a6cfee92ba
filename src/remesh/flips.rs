//! Edges turned to lie along ridges.
//!
//! Purpose: where an edge of a triangulation lies across a ridge of the input, the ridge sticks out between
//! its ends however these are placed; the other diagonal of its two facets lies along it. Edges are turned
//! where a tip of the input comes nearer to the facets by it.
//! Invariant: the result is a manifold if the triangulation was one, inner valences stay between 5 and 7 where they
//! were, no facet turns over or becomes a sliver, edges of curves stay. Deterministic.
//! Must not know: seeds, diagrams, files.

use std::collections::HashSet;

use glam::DVec3;
use rayon::prelude::*;

use super::tips::{Offset, Offsets, TIP};
use super::triangle::{score, unit_normal};
use crate::mesh::closest_point::closest_on_facet;
use crate::mesh::csr::Csr;
use crate::mesh::edges::undirected;
use crate::mesh::measure::{facet_quality, least_angle};
use crate::token::Token;

/// A tip comes nearer by at least this factor.
const GAIN: f64 = 0.8;
/// New facets have at least this quality and smallest angle, degrees, and normals within this cosine of the old.
const LEAST_SHAPE: f64 = 0.63;
const LEAST_ANGLE: f64 = 35.0;
const LEAST_COSINE: f64 = 0.3;

/// A vertex of more facets than these is looked at by a set, not by comparing each with each.
const MANY: usize = 64;

/// Turns edges that are not in `curves` (lower end first); returns the facets that changed.
pub(super) fn along_ridges(
    positions: &[DVec3],
    facets: &mut [[u32; 3]],
    around: &Csr<u32>,
    offsets: &Offsets<'_>,
    curves: &HashSet<[u32; 2]>,
    token: &Token,
) -> Vec<u32> {
    let far = offsets.far(|o| o.share > TIP);
    let mut touched = vec![false; facets.len()];
    let patch = Patch { positions, facets, around };
    // What would be best for each if nothing else changed.
    let wish = |(k, o): &(usize, Offset)| match token.is_stopped() {
        true => None,
        false => patch.best(offsets.place(*k), o.facet, curves, &touched),
    };
    let wishes: Vec<Option<Turn>> = far.par_iter().map(wish).collect();
    let mut changed = Vec::new();
    for ((k, o), wish) in far.into_iter().zip(wishes) {
        if token.is_stopped() {
            break;
        }
        let stands =
            !touched[o.facet as usize] && wish.is_none_or(|t| !touched[t.0 as usize] && !touched[t.1 as usize]);
        let patch = Patch { positions, facets, around };
        let turn = if stands { wish } else { patch.best(offsets.place(k), o.facet, curves, &touched) };
        if let Some((f, g, new)) = turn {
            // Around a changed facet nothing else changes in this round: `around` is of before.
            touch(&mut touched, around, [facets[f as usize], facets[g as usize]]);
            (facets[f as usize], facets[g as usize]) = (new[0], new[1]);
            changed.extend([f, g]);
        }
    }
    changed
}

/// Turns edges of facets with a score below `goal` where the lesser of the two facets' scores grows;
/// returns whether any was.
pub(super) fn for_angles(
    positions: &[DVec3],
    facets: &mut [[u32; 3]],
    around: &Csr<u32>,
    curves: &HashSet<[u32; 2]>,
    goal: f64,
    token: &Token,
) -> bool {
    let angle = |t: &[u32; 3]| score(t.map(|v| positions[v as usize]));
    let angles = facets.par_iter().enumerate().map(|(f, t)| (angle(t), f as u32));
    let mut poor: Vec<(f64, u32)> = angles.filter(|p| p.0 < goal).collect();
    poor.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut touched = vec![false; facets.len()];
    let mut changed = false;
    for (_, f) in poor {
        if token.is_stopped() {
            break;
        }
        let patch = Patch { positions, facets, around };
        let turns = (0..3).filter_map(|e| patch.turn(f, e, curves, &touched));
        let gain = |t: &Turn| {
            let before = angle(&facets[t.0 as usize]).min(angle(&facets[t.1 as usize]));
            angle(&t.2[0]).min(angle(&t.2[1])) - before
        };
        let best = turns.map(|t| (gain(&t), t)).max_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((gain, (f, g, new))) = best
            && gain > 0.5
        {
            touch(&mut touched, around, [facets[f as usize], facets[g as usize]]);
            (facets[f as usize], facets[g as usize]) = (new[0], new[1]);
            changed = true;
        }
    }
    changed
}

/// Marks all facets around two.
fn touch(touched: &mut [bool], around: &Csr<u32>, two: [[u32; 3]; 2]) {
    two.into_iter().flatten().flat_map(|v| around.of(v)).for_each(|&f| touched[f as usize] = true);
}

/// The triangulation as it is.
struct Patch<'a> {
    positions: &'a [DVec3],
    facets: &'a [[u32; 3]],
    around: &'a Csr<u32>,
}

type Turn = (u32, u32, [[u32; 3]; 2]);

impl Patch<'_> {
    /// The edge of `f`, or of a facet across one, whose turning brings the facets nearest to `p`.
    fn best(&self, p: DVec3, f: u32, curves: &HashSet<[u32; 2]>, touched: &[bool]) -> Option<Turn> {
        let distance = |t: &[u32; 3]| closest_on_facet(p, t.map(|v| self.positions[v as usize]), *t).0;
        let before = distance(&self.facets[f as usize]);
        let mut best: Option<(f64, Turn)> = None;
        let mut near: Vec<u32> = Vec::new();
        for &g in self.facets[f as usize].into_iter().flat_map(|v| self.around.of(v)) {
            if !near.contains(&g) {
                near.push(g);
            }
        }
        for f in near {
            for e in 0..3 {
                let Some(turn) = self.turn(f, e, curves, touched).filter(|t| self.is_fine(t)) else { continue };
                let after = turn.2.iter().map(distance).fold(f64::INFINITY, f64::min);
                if after < GAIN * GAIN * before && best.is_none_or(|(least, _)| after < least) {
                    best = Some((after, turn));
                }
            }
        }
        best.map(|(_, turn)| turn)
    }

    /// The two facets at edge `e` of `f` and what they become, if that is allowed.
    fn turn(&self, f: u32, e: usize, curves: &HashSet<[u32; 2]>, touched: &[bool]) -> Option<Turn> {
        let t = self.facets[f as usize];
        let (a, b, c) = (t[e], t[(e + 1) % 3], t[(e + 2) % 3]);
        let other =
            |&&g: &&u32| (0..3).any(|k| self.facets[g as usize][k] == b && self.facets[g as usize][(k + 1) % 3] == a);
        // Both ends have it; one of them may have very many.
        let end = if self.around.of(a).len() <= self.around.of(b).len() { a } else { b };
        let &g = self.around.of(end).iter().find(other)?;
        let d = *self.facets[g as usize].iter().find(|&&v| v != a && v != b)?;
        // Those of a boundary have no valence to keep.
        let lose = |v: u32| self.around.of(v).len() > 5 || self.is_on_rim(v);
        let win = |v: u32| self.around.of(v).len() < 7 || self.is_on_rim(v);
        if touched[f as usize] || touched[g as usize] || !(lose(a) && lose(b) && win(c) && win(d)) {
            return None;
        }
        let (few, other) = if self.around.of(c).len() <= self.around.of(d).len() { (c, d) } else { (d, c) };
        let joined = self.around.of(few).iter().any(|&h| self.facets[h as usize].contains(&other));
        if joined || curves.contains(&undirected([a, b])) {
            return None;
        }
        let corners = |t: [u32; 3]| t.map(|v| self.positions[v as usize]);
        let normal = |t: [u32; 3]| unit_normal(corners(t));
        let new = [[a, d, c], [d, b, c]];
        let mean = (normal(t) + normal(self.facets[g as usize])).normalize_or_zero();
        new.into_iter().all(|t| normal(t).dot(mean) >= LEAST_COSINE).then_some((f, g, new))
    }

    /// Whether an edge of `v` has no facet behind it.
    fn is_on_rim(&self, v: u32) -> bool {
        let around = self.around.of(v);
        let after = |f: &u32, by: usize| {
            let t = self.facets[*f as usize];
            (0..3).find(|&k| t[k] == v).map(|k| t[(k + by) % 3])
        };
        if around.len() <= MANY {
            return around.iter().any(|f| !around.iter().any(|g| after(g, 2) == after(f, 1)));
        }
        let before: HashSet<Option<u32>> = around.iter().map(|g| after(g, 2)).collect();
        around.iter().any(|f| !before.contains(&after(f, 1)))
    }

    fn is_fine(&self, turn: &Turn) -> bool {
        let corners = |t: [u32; 3]| t.map(|v| self.positions[v as usize]);
        turn.2.iter().all(|&t| facet_quality(corners(t)) >= LEAST_SHAPE && least_angle(corners(t)) >= LEAST_ANGLE)
    }
}
