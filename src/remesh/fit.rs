//! Vertices where the surface through them is nearest to the input.
//!
//! Purpose: a triangulation whose vertices lie on a curved surface lies on one side of it, off by a
//! share of κh² everywhere. This moves the vertices so that the mean square distance from the input to the
//! facets is least, tangent plane by tangent plane ([`equations`]): along the normals where the surface is smooth, and
//! towards a ridge where samples of its two sides ask for it. Tips that still stick out pull the
//! nearest vertex to them.
//! Invariant: no facet turns over and none becomes a sliver ([`restrain`]); fixed vertices stay; deterministic.
//! Must not know: seeds, diagrams, files.

mod equations;
mod far;
mod region;
mod restrain;

use std::collections::HashSet;

use glam::DVec3;
use rayon::prelude::*;

use super::fences::CurveSample;
use super::flips;
use super::tips::{Offset, Offsets, TIP, Tip};
use crate::mesh::csr::Csr;
use crate::mesh::edges::undirected;
use crate::token::Token;
use equations::Equations;
pub(super) use far::{Far, missed};
use region::Region;
use restrain::{Facet, restrain};

/// A point of the input with its share of the area.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    /// Where it is.
    pub(super) position: DVec3,
    /// Unit normal of the input there.
    pub(super) normal: DVec3,
    /// Area it stands for.
    pub(super) area: f64,
}

/// What there is to fit to.
#[derive(Debug)]
pub(super) struct Target {
    /// By result vertex; the nearest facet is one of those around it.
    pub(super) samples: Csr<Sample>,
    pub(super) curves: Vec<CurveSample>,
    pub(super) tips: Csr<Tip>,
    /// Vertices that stay.
    pub(super) fixed: Vec<bool>,
}

/// Times that nearest points are found anew,
const ROUNDS: usize = 2;
/// and after these around tips alone, which then pull.
const TIP_ROUNDS: usize = 6;
/// Tips that stick out at least this share as far as the worst one pull next.
const FARTHEST: f64 = 0.6;
/// A tip that sticks out pulls a vertex that is not farther away than this share of an edge.
const TIP_REACH: f64 = 0.75;

/// Moves `positions`, and turns edges that lie across a ridge. Ends early where `token` is stopped.
pub(super) fn fit(positions: &mut [DVec3], facets: &mut [[u32; 3]], target: &Target, token: &Token) {
    let mut around = Csr::one_rings(positions.len(), facets);
    let first: Vec<Facet> = facets.par_iter().map(|&t| Facet::of(positions, t)).collect();
    let mut state = State { start: positions.to_vec(), first, pulls: Vec::new() };
    let everywhere = Region::everywhere(positions.len(), facets.len());
    for _ in 0..ROUNDS {
        state.round(positions, facets, &around, (target, &everywhere), token);
    }
    let mut offsets = Offsets::new(positions, facets, &around, &target.tips, token);
    let curves: HashSet<[u32; 2]> = target.curves.iter().map(|s| undirected(s.edge)).collect();
    for _ in 0..TIP_ROUNDS {
        if token.is_stopped() {
            return;
        }
        let flipped = flips::along_ridges(positions, facets, &around, &offsets, &curves, token);
        if !flipped.is_empty() {
            around = Csr::one_rings(positions.len(), facets);
            flipped.iter().for_each(|&f| state.first[f as usize] = Facet::of(positions, facets[f as usize]));
        }
        state.find_pulls(positions, facets, &around, target, &offsets);
        let mut front: Vec<u32> = flipped.iter().flat_map(|&f| facets[f as usize]).collect();
        front.extend(state.pulls.iter().map(|p| p.0));
        if front.is_empty() {
            break;
        }
        let region = Region::around_of(front, positions.len(), facets, &around);
        state.round(positions, facets, &around, (target, &region), token);
        offsets.look(positions, facets, &around, |v| region.reaches(v), token);
    }
}

/// What the rounds share.
struct State {
    start: Vec<DVec3>,
    first: Vec<Facet>,
    /// Vertices that tips pull, and where to.
    pulls: Vec<(u32, DVec3)>,
}

impl State {
    /// Moves the vertices of a region once.
    fn round(
        &self,
        positions: &mut [DVec3],
        facets: &[[u32; 3]],
        around: &Csr<u32>,
        (target, region): (&Target, &Region),
        token: &Token,
    ) {
        let draft = Draft { positions, facets, around };
        let mut moves = Equations::new(&draft, target, region, (&self.start, &self.pulls), token).solve(token);
        if token.is_stopped() {
            return;
        }
        restrain(&draft, &self.first, region, &mut moves);
        region.inside().for_each(|v| positions[v as usize] += moves[v as usize]);
    }

    /// More vertices that tips pull: those that stick out most first, none beside another.
    fn find_pulls(
        &mut self,
        positions: &[DVec3],
        facets: &[[u32; 3]],
        around: &Csr<u32>,
        target: &Target,
        offsets: &Offsets<'_>,
    ) {
        let reaches = |k: usize, o: &Offset| {
            let edge = o.distance / o.share;
            positions[o.corner as usize].distance(offsets.place(k)) < TIP_REACH * edge
        };
        let out: Vec<(usize, Offset)> = offsets
            .far(|o| o.share > TIP && !target.fixed[o.corner as usize])
            .into_iter()
            .filter(|(k, o)| reaches(*k, o))
            .collect();
        let enough = FARTHEST * out.first().map_or(0.0, |o| o.1.share);
        let mut taken = vec![false; positions.len()];
        let take = |v: u32, taken: &mut Vec<bool>| {
            around.of(v).iter().flat_map(|&f| facets[f as usize]).for_each(|u| taken[u as usize] = true);
        };
        self.pulls.iter().for_each(|&(v, _)| take(v, &mut taken));
        for (k, o) in out.into_iter().take_while(|o| o.1.share >= enough) {
            if !taken[o.corner as usize] {
                take(o.corner, &mut taken);
                self.pulls.push((o.corner, offsets.place(k)));
            }
        }
    }
}

/// The triangulation as it is.
struct Draft<'a> {
    positions: &'a [DVec3],
    facets: &'a [[u32; 3]],
    around: &'a Csr<u32>,
}

impl Draft<'_> {
    fn corners(&self, f: u32) -> [DVec3; 3] {
        self.facets[f as usize].map(|v| self.positions[v as usize])
    }
}
