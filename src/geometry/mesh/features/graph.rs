//! The edges that are features: a graph without its short parts, and ridges.
//!
//! Purpose: [`Graph`] holds the edges with their kind and angle; [`Graph::prune`] removes creases with free ends, short networks
//! and tangles, [`Graph::drop_chords`] those that cut ears off curves. [`DihedralAngles::add_ridges`] adds edges below the crease angle
//! that continue a crease: a crease may fade, or end in a ridge of about twenty degrees, which is as visible in a remesh. A ridge differs
//! from the facets of a rounding by its smooth surroundings: within a few edges of the remesh, no edge beside it has nearly its angle. As in
//! Canny's edge detector (1986, section VI), there are two thresholds: an edge above the lower one counts if it continues an edge above
//! the higher one.
//! Invariant: an edge that is required stays. Must not know: curves, seeds, diagrams.

use std::collections::{BTreeMap, BTreeSet};

use glam::DVec3;

use super::{CurveKind, Edge, FLAT_DEG, Metric};
use crate::mesh::TriMesh;
use crate::mesh::adjacency::{Adjacency, EdgeKind};
use crate::mesh::edges::undirected;
use crate::mesh::normal as normal_of;
use crate::tasks;
use crate::token::{Stopped, Token};

/// A network is a tangle if its curves are on average shorter than this share of the shortest crease.
const TANGLED_SHARE: f64 = 0.5;
/// The same if most of the network is sharp, or bent more than moderately between plane faces: such edges are intended, and
/// short only compared with the remesh.
const TANGLED_SHARP_SHARE: f64 = 0.15;
/// Smaller angles, degrees, are creases only if the caller asks for them. Of a tangle with them, they alone go.
const MODERATE_ANGLE: f64 = 30.0;
/// How much longer the way along a curve may be than a crease that cuts it short.
const MOST_AROUND_CHORD: f64 = 3.0;
/// Larger angles, degrees, are sharp.
const SHARP_ANGLE: f64 = 75.0;

/// Feature edges, and at each vertex the other ends of its edges.
#[derive(Default)]
pub(super) struct Graph {
    pub(super) neighbours: BTreeMap<u32, Vec<u32>>,
    pub(super) edges: BTreeMap<Edge, EdgeInfo>,
}

#[derive(Clone, Copy)]
pub(super) struct EdgeInfo {
    pub(super) kind: CurveKind,
    /// Boundaries and edges that the caller named; they are never left out.
    pub(super) required: bool,
    /// Dihedral angle, degrees.
    pub(super) angle: f64,
    /// Whether each of its facets is in a plane with another.
    pub(super) beside_planes: bool,
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

    pub(super) fn chain_to(&self, v: u32, next: u32, corners: &BTreeSet<u32>) -> Vec<u32> {
        self.chain(v, next, |v| corners.contains(&v))
    }

    /// Removes creases shorter than `min_length` with a free end, then short networks and tangles. Returns how many edges.
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

    /// Removes creases shorter than `length` from one place of curves that stay to another that is not farther along these: ears.
    pub(super) fn drop_chords(&mut self, metric: Metric<'_>, length: f64, token: &Token) -> Result<(), Stopped> {
        let required = |&u: &u32, v: u32| self.edges[&undirected([v, u])].required;
        let on_required = |v: u32| self.neighbours[&v].iter().any(|u| required(u, v));
        let mut chords = Vec::new();
        for (&v, list) in self.neighbours.iter().filter(|(v, _)| on_required(**v)) {
            token.check()?;
            for &next in list.iter().filter(|u| !required(u, v)) {
                let chain = self.chain(v, next, |v| self.degree(v) != 2);
                let end = chain[chain.len() - 1];
                let most = MOST_AROUND_CHORD * metric.chain(&chain);
                if most < MOST_AROUND_CHORD * length
                    && on_required(end)
                    && self.is_removable(&chain)
                    && self.required_path(v, end, most, metric)
                {
                    chords.push(chain);
                }
            }
        }
        for chain in chords {
            chain.windows(2).for_each(|p| self.remove(undirected([p[0], p[1]])));
        }
        Ok(())
    }

    /// Whether edges that stay join two vertices in at most this length.
    fn required_path(&self, from: u32, to: u32, most: f64, metric: Metric<'_>) -> bool {
        let mut nearest: BTreeMap<u32, f64> = BTreeMap::from([(from, 0.0)]);
        let mut queue = vec![from];
        while let Some(v) = queue.pop() {
            let here = nearest[&v];
            for &u in self.neighbours[&v].iter().filter(|u| self.edges[&undirected([v, **u])].required) {
                let there = here + metric.edge(v, u);
                if there <= most && nearest.get(&u).is_none_or(|known| there < *known) {
                    nearest.insert(u, there);
                    queue.push(u);
                }
            }
        }
        nearest.contains_key(&to)
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
            let is_intended = |e: &&Edge| {
                let EdgeInfo { angle, beside_planes, .. } = self.edges[*e];
                angle >= SHARP_ANGLE || (beside_planes && angle >= MODERATE_ANGLE)
            };
            let intended: f64 = edges.iter().filter(is_intended).map(length).sum();
            let chains = (ends / 2).max(1) as f64;
            let least = if intended >= 0.5 * total { TANGLED_SHARP_SHARE } else { TANGLED_SHARE };
            let tangled = total < least * min_length * chains;
            let weakest = edges.iter().map(|e| self.edges[e].angle).fold(f64::INFINITY, f64::min);
            let short = total < 2.0 * min_length;
            if !short && !tangled {
                continue;
            }
            let moderate = !short && weakest < MODERATE_ANGLE;
            weakened |= moderate;
            let removed = if moderate { MODERATE_ANGLE.min(2.0 * weakest) } else { f64::INFINITY };
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

/// Least dihedral angle of a ridge, share of the crease angle.
const RIDGE_ANGLE_SHARE: f64 = 0.5;
/// Largest dihedral angle of an edge beside a ridge, share of the ridge's own.
const NEIGHBOUR_ANGLE_SHARE: f64 = 0.55;
/// A ridge that continues a crease from its free end is at least this share of the clearance long, other ridges all of it.
const MIN_CONTINUATION: f64 = 0.6;
/// Facets that are looked at on either side, at most.
const MAX_FACETS: usize = 200;

pub(super) struct DihedralAngles<'a> {
    mesh: &'a TriMesh,
    metric: Metric<'a>,
    adjacency: &'a Adjacency,
    /// Angle of each edge, by its lower half-edge; NaN without an edge.
    degrees: Vec<f64>,
}

impl<'a> DihedralAngles<'a> {
    pub(super) fn new(mesh: &'a TriMesh, metric: Metric<'a>, adjacency: &'a Adjacency) -> Self {
        let mut angles = Self { mesh, metric, adjacency, degrees: Vec::new() };
        let lower = |half: usize| adjacency.opposite(half).is_some_and(|other| half < other);
        let degrees = |half| if lower(half) { angles.measure(half) } else { None }.unwrap_or(f64::NAN);
        angles.degrees = tasks::map(3 * mesh.facets().len(), degrees);
        angles
    }

    fn corners(&self, f: usize) -> [DVec3; 3] {
        self.mesh.facets()[f].map(|v| self.metric.at(v))
    }

    fn normal(&self, f: usize) -> DVec3 {
        normal_of(self.corners(f)).normalize_or_zero()
    }

    /// In the middle of a facet.
    fn resolution(&self, f: usize) -> f64 {
        self.mesh.facets()[f].map(|v| self.metric.resolution(v)).iter().sum::<f64>() / 3.0
    }

    /// The dihedral angle at a half-edge, degrees; `None` if it has not two facets with an area.
    pub(super) fn at(&self, half: usize) -> Option<f64> {
        Some(self.degrees[half.min(self.adjacency.opposite(half)?)]).filter(|angle| !angle.is_nan())
    }

    /// Whether the facet of a half-edge is in a plane with another: each of its other sides is flat, or a crease, and not both are creases.
    pub(super) fn is_plane_beside(&self, half: usize, crease: f64) -> bool {
        let beside = [1, 2].map(|k| self.at(half / 3 * 3 + (half + k) % 3));
        let is_flat = |angle: &Option<f64>| angle.is_some_and(|angle| angle <= FLAT_DEG);
        let ends = |angle: &Option<f64>| is_flat(angle) || angle.is_none_or(|angle| angle > crease);
        beside.iter().all(ends) && beside.iter().any(is_flat)
    }

    fn measure(&self, half: usize) -> Option<f64> {
        let kind = self.adjacency.kind(half);
        let other = self.adjacency.opposite(half)?;
        // A facet without area has no normal, and so no angle.
        let turned = match kind {
            EdgeKind::Manifold => 1.0,
            EdgeKind::Inconsistent => -1.0,
            _ => return None,
        };
        let (f, g) = (half / 3, other / 3);
        if self.mesh.is_degenerate(f) || self.mesh.is_degenerate(g) {
            return None;
        }
        let (n, m) = (self.normal(f), turned * self.normal(g));
        Some(n.cross(m).length().atan2(n.dot(m)).to_degrees())
    }

    /// Whether a straight way of `reach` across the facet of `half` meets no edge above `most` before a crease or boundary.
    fn is_smooth_beside(&self, half: usize, most: f64, crease: f64, reach: f64) -> bool {
        let (mut half, mut left) = (half, reach);
        let [a, b] = [half % 3, (half + 1) % 3].map(|k| self.corners(half / 3)[k]);
        let mut here = 0.5 * (a + b);
        let mut way = self.normal(half / 3).cross(b - a);
        for _ in 0..MAX_FACETS {
            let f = half / 3;
            let corners = self.corners(f);
            let [p, q, r] = [0, 1, 2].map(|k| corners[(half + k) % 3]);
            let normal = self.normal(f);
            way = (way - normal * normal.dot(way)).normalize_or_zero();
            // Out through the side that the third corner is not on.
            let side = way.cross(r - here).dot(normal);
            let (exit, from, to) = if side > 0.0 { (1, q, r) } else { (2, r, p) };
            let across = normal.cross(to - from);
            let towards = way.dot(across);
            let step = if towards < 0.0 { ((from - here).dot(across) / towards).max(0.0) } else { 0.0 };
            left -= step * self.resolution(f);
            if left <= 0.0 {
                return true;
            }
            here += step * way;
            let crossed = f * 3 + (half % 3 + exit) % 3;
            match (self.at(crossed), self.adjacency.opposite(crossed)) {
                (Some(angle), Some(_)) if angle > most => return angle > crease,
                (Some(_), Some(next)) => half = next,
                _ => return true,
            }
        }
        true
    }

    /// Edges that are a ridge and no crease, with their angles, ascending.
    fn ridges(&self, crease: f64, reach: f64, token: &Token) -> Result<Vec<(Edge, f64)>, Stopped> {
        let mut found = Vec::new();
        for half in 0..3 * self.mesh.facets().len() {
            token.check_at(8 * half)?;
            let Some(other) = self.adjacency.opposite(half).filter(|&other| half < other) else { continue };
            let Some(angle) = self.at(half).filter(|b| (RIDGE_ANGLE_SHARE * crease..=crease).contains(b)) else {
                continue;
            };
            if [half, other].into_iter().all(|h| self.is_smooth_beside(h, NEIGHBOUR_ANGLE_SHARE * angle, crease, reach))
            {
                found.push((undirected(self.adjacency.ends(self.mesh, half)), angle));
            }
        }
        found.sort_unstable_by_key(|r| r.0);
        Ok(found)
    }

    /// Adds ridges to a graph of creases: chains between two creases or from a free end, others from `min_length` on.
    pub(super) fn add_ridges(
        &self,
        graph: &mut Graph,
        crease: f64,
        (clearance, min_length): (f64, f64),
        token: &Token,
    ) -> Result<(), Stopped> {
        let mut ridges = Graph::default();
        for (e, angle) in self.ridges(crease, clearance, token)? {
            if !graph.edges.contains_key(&e) {
                ridges.insert(e, EdgeInfo { kind: CurveKind::Crease, required: false, angle, beside_planes: false });
            }
        }
        let nodes: BTreeSet<u32> =
            ridges.neighbours.iter().filter(|(v, l)| l.len() != 2 || graph.degree(**v) > 0).map(|(&v, _)| v).collect();
        let mut chosen = Vec::new();
        for &v in &nodes {
            token.check()?;
            for &next in &ridges.neighbours[&v] {
                let chain = ridges.chain_to(v, next, &nodes);
                let (first, last) = (chain[0], chain[chain.len() - 1]);
                if first > last || (first == last && chain[1] > chain[chain.len() - 2]) {
                    // Seen from its other end.
                    continue;
                }
                let length = self.metric.chain(&chain);
                let ends = [first, last].map(|v| graph.degree(v));
                let between = ends[0] > 0 && ends[1] > 0;
                let goes_on = ends.contains(&1);
                if length >= clearance && (between || length >= min_length)
                    || goes_on && length >= MIN_CONTINUATION * clearance
                {
                    chosen.push(chain);
                }
            }
        }
        for chain in chosen {
            for p in chain.windows(2) {
                let e = undirected([p[0], p[1]]);
                graph.insert(e, ridges.edges[&e]);
            }
        }
        Ok(())
    }
}
