//! The graph of feature edges, without its short parts.
//!
//! Purpose: [`Graph`] holds the edges with their kind and angle; [`Graph::prune`] removes creases with free ends, short networks
//! and tangles.
//! Invariant: an edge that is required stays. Must not know: curves, seeds.

use std::collections::{BTreeMap, BTreeSet};

use super::{CurveKind, Edge, Metric};
use crate::mesh::edges::undirected;
use crate::token::{Stopped, Token};

/// A network is a tangle if its curves are on average shorter than this share of the shortest crease.
const TANGLED_SHARE: f64 = 0.5;
/// The share that replaces [`TANGLED_SHARE`] if most of the network is sharp: sharp edges are intended, and short only
/// compared with the remesh.
const TANGLED_SHARP_SHARE: f64 = 0.15;
/// Smaller angles, degrees, count as creases only if the caller asks for them. If they make a network a tangle, they alone are
/// removed.
const MODERATE_ANGLE: f64 = 30.0;
/// Larger angles, degrees, are sharp.
const SHARP_ANGLE: f64 = 75.0;

/// Feature edges, and at each vertex the other ends of its edges.
#[derive(Default)]
pub(super) struct Graph {
    pub(super) neighbours: BTreeMap<u32, Vec<u32>>,
    pub(super) edges: BTreeMap<Edge, EdgeInfo>,
}

/// Data of a feature edge.
#[derive(Clone, Copy)]
pub(super) struct EdgeInfo {
    pub(super) kind: CurveKind,
    /// Boundaries and edges that the caller named; they are never left out.
    pub(super) required: bool,
    /// Dihedral angle, degrees.
    pub(super) angle: f64,
}

impl Graph {
    /// Adds an edge that is not there yet.
    pub(super) fn insert(&mut self, e: Edge, info: EdgeInfo) {
        if e[0] != e[1] && !self.edges.contains_key(&e) {
            self.edges.insert(e, info);
            self.neighbours.entry(e[0]).or_default().push(e[1]);
            self.neighbours.entry(e[1]).or_default().push(e[0]);
        }
    }

    fn remove(&mut self, e: Edge) {
        self.edges.remove(&e);
        for (v, u) in [(e[0], e[1]), (e[1], e[0])] {
            if let Some(list) = self.neighbours.get_mut(&v) {
                list.retain(|&x| x != u);
                if list.is_empty() {
                    self.neighbours.remove(&v);
                }
            }
        }
    }

    pub(super) fn degree(&self, v: u32) -> usize {
        self.neighbours.get(&v).map_or(0, Vec::len)
    }

    /// The chain that begins with the edge from `v` to `next`, up to `v` or a vertex that ends chains. All others have two edges.
    fn chain(&self, v: u32, next: u32, ends: impl Fn(u32) -> bool) -> Vec<u32> {
        let mut chain = vec![v, next];
        let (mut before, mut here) = (v, next);
        while here != v && !ends(here) {
            let list = &self.neighbours[&here];
            let ahead = if list[0] == before { list[1] } else { list[0] };
            chain.push(ahead);
            (before, here) = (here, ahead);
        }
        chain
    }

    /// A chain that ends at corners.
    pub(super) fn chain_to(&self, v: u32, next: u32, corners: &BTreeSet<u32>) -> Vec<u32> {
        self.chain(v, next, |v| corners.contains(&v))
    }

    /// Removes creases with a free end that are shorter than `min_length`, repeatedly, and then short networks and tangles.
    /// Returns how many edges were removed.
    pub(super) fn prune(&mut self, metric: Metric<'_>, min_length: f64, token: &Token) -> Result<usize, Stopped> {
        let before = self.edges.len();
        loop {
            self.drop_loose_ends(metric, min_length, token)?;
            if !self.drop_short_networks(metric, min_length, token)? {
                return Ok(before - self.edges.len());
            }
        }
    }

    fn drop_loose_ends(&mut self, metric: Metric<'_>, min_length: f64, token: &Token) -> Result<(), Stopped> {
        loop {
            let ends: Vec<u32> = self.neighbours.iter().filter(|(_, l)| l.len() == 1).map(|(&v, _)| v).collect();
            let mut loose: Vec<(f64, Vec<u32>)> = Vec::new();
            for v in ends {
                token.check()?;
                let chain = self.chain(v, self.neighbours[&v][0], |v| self.degree(v) != 2);
                let length = metric.chain(&chain);
                if length < min_length && self.is_removable(&chain) {
                    loose.push((length, chain));
                }
            }
            // The shortest first, one at a time at a junction: the rest there may be one long curve.
            loose.sort_by(|a, b| a.0.total_cmp(&b.0).then_with(|| a.1.cmp(&b.1)));
            let mut touched = BTreeSet::new();
            let mut removed = 0;
            for (_, chain) in loose {
                token.check()?;
                let ends = [chain[0], chain[chain.len() - 1]];
                if ends.iter().any(|v| touched.contains(v)) {
                    continue;
                }
                touched.extend(ends);
                chain.windows(2).for_each(|p| self.remove(undirected([p[0], p[1]])));
                removed += 1;
            }
            if removed == 0 {
                return Ok(());
            }
        }
    }

    fn is_removable(&self, chain: &[u32]) -> bool {
        chain.windows(2).all(|p| self.edges.get(&undirected([p[0], p[1]])).is_none_or(|info| !info.required))
    }

    /// Removes short networks and tangles. Of a tangle with edges of moderate angle, only these are removed; returns whether
    /// there were any, so that the rest is examined again.
    fn drop_short_networks(&mut self, metric: Metric<'_>, min_length: f64, token: &Token) -> Result<bool, Stopped> {
        let mut weakened = false;
        let mut seen = BTreeSet::new();
        let starts: Vec<u32> = self.neighbours.keys().copied().collect();
        for start in starts {
            if !seen.insert(start) {
                continue;
            }
            let (mut stack, mut edges) = (vec![start], BTreeSet::new());
            let mut ends = 0;
            token.check()?;
            while let Some(v) = stack.pop() {
                token.check_at(edges.len())?;
                ends += if self.degree(v) == 2 { 0 } else { self.degree(v) };
                for &u in self.neighbours.get(&v).into_iter().flatten() {
                    edges.insert(undirected([v, u]));
                    if seen.insert(u) {
                        stack.push(u);
                    }
                }
            }
            if edges.iter().any(|e| self.edges.get(e).is_some_and(|info| info.required)) {
                continue;
            }
            let length = |e: &Edge| metric.edge(e[0], e[1]);
            let total: f64 = edges.iter().map(length).sum();
            let sharp: f64 = edges.iter().filter(|e| self.edges[*e].angle >= SHARP_ANGLE).map(length).sum();
            let chains = (ends / 2).max(1) as f64;
            let least = if sharp >= 0.5 * total { TANGLED_SHARP_SHARE } else { TANGLED_SHARE };
            let tangled = total < least * min_length * chains;
            let weakest = edges.iter().map(|e| self.edges[e].angle).fold(f64::INFINITY, f64::min);
            let removed = if total < 2.0 * min_length {
                f64::INFINITY
            } else if !tangled {
                continue;
            } else if weakest < MODERATE_ANGLE {
                weakened = true;
                MODERATE_ANGLE.min(2.0 * weakest)
            } else {
                f64::INFINITY
            };
            let sharp = |e: &Edge| self.edges[e].angle;
            let removed: Vec<Edge> = edges.into_iter().filter(|e| sharp(e) < removed || sharp(e) == weakest).collect();
            for (k, e) in removed.into_iter().enumerate() {
                token.check_at(64 * k)?;
                self.remove(e);
            }
        }
        Ok(weakened)
    }
}
