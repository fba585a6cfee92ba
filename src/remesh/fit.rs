//! Fit of the result to the input.
//!
//! Purpose: a triangulation whose vertices lie on a curved surface lies on one side of it, off by a share of κh² everywhere.
//! [`fit`] moves the vertices so that the mean square distance from the input to the facets is least, tangent plane by
//! tangent plane ([`normal_equations`]): along the normals where the surface is smooth, and towards a ridge where samples of
//! its two sides ask for it. Vertices of the input that still stick out pull the nearest vertex to them.
//! Invariant: no facet turns over and none becomes a sliver ([`backtracking`]); fixed vertices stay. The same bits whatever the
//! number of threads.
//! Must not know: seeds, diagrams, files.

mod backtracking;
mod normal_equations;
mod region;

use std::collections::HashSet;

use glam::DVec3;
use rayon::prelude::*;

use crate::mesh::csr::Csr;
use crate::mesh::edges::undirected;
use crate::remesh::distance::deviation::{Deviation, InputDeviation, STICKS_OUT};
use crate::remesh::distance::reference::InputSamples;
use crate::remesh::features::envelope::CurveSample;
use crate::remesh::improve::flips::flip_along_ridges;
use crate::token::Token;
use backtracking::{FacetShape, backtrack};
use normal_equations::NormalEquations;
use region::Region;

/// What there is to fit to.
#[derive(Debug)]
pub(super) struct Target {
    /// By result vertex: the nearest facet is in its one-ring.
    pub(super) input: InputSamples,
    pub(super) curves: Vec<CurveSample>,
    /// Vertices that stay.
    pub(super) fixed: Vec<bool>,
}

/// Rounds of the whole fit: each finds the nearest points anew.
const ROUNDS: usize = 2;
/// Rounds after these, around vertices of the input that stick out.
const PULL_ROUNDS: usize = 6;
/// In one round those pull that stick out at least this share as far as the worst one.
const PULL_SHARE: f64 = 0.6;
/// A vertex of the input pulls a vertex of the result that is nearer than this share of the mean edge.
const PULL_REACH: f64 = 0.75;

/// Moves `positions`, and flips edges that lie across a ridge. Ends early where `token` is stopped.
pub(super) fn fit(positions: &mut [DVec3], facets: &mut [[u32; 3]], target: &Target, token: &Token) {
    let mut rings = Csr::one_rings(positions.len(), facets);
    let shapes: Vec<FacetShape> = facets.par_iter().map(|&t| FacetShape::of(positions, t)).collect();
    let mut state = State { start: positions.to_vec(), shapes, pulls: Vec::new() };
    let everywhere = Region::everywhere(positions.len(), facets.len());
    for _ in 0..ROUNDS {
        state.round(positions, facets, &rings, (target, &everywhere), token);
    }
    let mut deviations = InputDeviation::new(positions, facets, &rings, &target.input.vertices, token);
    let curves: HashSet<[u32; 2]> = target.curves.iter().map(|s| undirected(s.edge)).collect();
    for _ in 0..PULL_ROUNDS {
        if token.is_stopped() {
            return;
        }
        let flipped = flip_along_ridges(positions, facets, &rings, &deviations, &curves, token);
        if !flipped.is_empty() {
            rings = Csr::one_rings(positions.len(), facets);
            flipped.iter().for_each(|&f| state.shapes[f as usize] = FacetShape::of(positions, facets[f as usize]));
        }
        state.find_pulls(positions, facets, &rings, target, &deviations);
        let mut front: Vec<u32> = flipped.iter().flat_map(|&f| facets[f as usize]).collect();
        front.extend(state.pulls.iter().map(|p| p.0));
        if front.is_empty() {
            break;
        }
        let region = Region::around_of(front, positions.len(), facets, &rings);
        state.round(positions, facets, &rings, (target, &region), token);
        deviations.update(positions, facets, &rings, |v| region.reaches(v), token);
    }
}

/// What the rounds share.
struct State {
    start: Vec<DVec3>,
    /// Of the facets at the beginning, or after their last flip.
    shapes: Vec<FacetShape>,
    /// Vertices that are pulled, and where to.
    pulls: Vec<(u32, DVec3)>,
}

impl State {
    /// Moves the vertices of a region once.
    fn round(
        &self,
        positions: &mut [DVec3],
        facets: &[[u32; 3]],
        rings: &Csr<u32>,
        (target, region): (&Target, &Region),
        token: &Token,
    ) {
        let mesh = Triangulation { positions, facets, rings };
        let equations = NormalEquations::new(&mesh, target, region, (&self.start, &self.pulls), token);
        let mut moves = equations.solve(token);
        if token.is_stopped() {
            return;
        }
        backtrack(&mesh, &self.shapes, region, &mut moves);
        region.inside().for_each(|v| positions[v as usize] += moves[v as usize]);
    }

    /// Adds pulls: of the vertices that stick out most, none beside another.
    fn find_pulls(
        &mut self,
        positions: &[DVec3],
        facets: &[[u32; 3]],
        rings: &Csr<u32>,
        target: &Target,
        deviations: &InputDeviation<'_>,
    ) {
        let reaches = |k: usize, d: &Deviation| {
            let edge = d.distance / d.relative;
            positions[d.corner as usize].distance(deviations.position(k)) < PULL_REACH * edge
        };
        let sticking_out: Vec<(usize, Deviation)> = deviations
            .largest_first(|d| d.relative > STICKS_OUT && !target.fixed[d.corner as usize])
            .into_iter()
            .filter(|(k, d)| reaches(*k, d))
            .collect();
        let enough = PULL_SHARE * sticking_out.first().map_or(0.0, |d| d.1.relative);
        let mut taken = vec![false; positions.len()];
        let take = |v: u32, taken: &mut Vec<bool>| {
            rings.of(v).iter().flat_map(|&f| facets[f as usize]).for_each(|u| taken[u as usize] = true);
        };
        self.pulls.iter().for_each(|&(v, _)| take(v, &mut taken));
        for (k, d) in sticking_out.into_iter().take_while(|d| d.1.relative >= enough) {
            if !taken[d.corner as usize] {
                take(d.corner, &mut taken);
                self.pulls.push((d.corner, deviations.position(k)));
            }
        }
    }
}

/// The triangulation as it is.
struct Triangulation<'a> {
    positions: &'a [DVec3],
    facets: &'a [[u32; 3]],
    rings: &'a Csr<u32>,
}

impl Triangulation<'_> {
    fn corners(&self, f: u32) -> [DVec3; 3] {
        self.facets[f as usize].map(|v| self.positions[v as usize])
    }
}
