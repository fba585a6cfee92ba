//! Ridges: edges below the crease angle that continue a crease.
//!
//! Purpose: a crease may fade, or end in a ridge of about twenty degrees, which is as visible in a remesh. A ridge differs
//! from the facets of a rounding by its smooth surroundings: within a few edges of the remesh, no edge beside it has nearly
//! its angle. As in Canny's edge detector (1986, section VI), there are two thresholds: an edge above the lower one counts
//! if it continues an edge above the higher one.
//! Invariant: depends on the mesh alone.
//! Must not know: seeds, diagrams.

use glam::DVec3;
use rayon::prelude::*;

use super::{Edge, EdgeInfo, Graph, Metric};
use crate::mesh::TriMesh;
use crate::mesh::adjacency::{Adjacency, EdgeKind};
use crate::mesh::edges::undirected;
use crate::token::{Stopped, Token};

/// Least dihedral angle of a ridge, share of the crease angle.
const RIDGE_ANGLE_SHARE: f64 = 0.5;
/// Largest dihedral angle of an edge beside a ridge, share of the ridge's own.
const NEIGHBOUR_ANGLE_SHARE: f64 = 0.55;
/// A ridge that continues a crease from its free end is at least this share of the clearance long, other ridges all of it.
const MIN_CONTINUATION: f64 = 0.6;
/// Half-edges per task.
const CHUNK: usize = 8192;
/// Facets that are looked at on either side, at most.
const MAX_FACETS: usize = 200;

/// Dihedral angles of a surface's edges.
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
        let halves = (0..3 * mesh.facets().len()).into_par_iter().with_min_len(CHUNK);
        let lower = |half: usize| adjacency.opposite(half).is_some_and(|other| half < other);
        let degrees = halves.map(|half| if lower(half) { angles.measure(half) } else { None }.unwrap_or(f64::NAN));
        angles.degrees = degrees.collect();
        angles
    }

    fn corners(&self, f: usize) -> [DVec3; 3] {
        self.mesh.facets()[f].map(|v| self.metric.at(v))
    }

    fn normal(&self, f: usize) -> DVec3 {
        let [a, b, c] = self.corners(f);
        (b - a).cross(c - a).normalize_or_zero()
    }

    /// In the middle of a facet.
    fn resolution(&self, f: usize) -> f64 {
        self.mesh.facets()[f].map(|v| self.metric.resolution(v)).iter().sum::<f64>() / 3.0
    }

    /// The dihedral angle at a half-edge, degrees; `None` if it has not two facets with an area.
    pub(super) fn at(&self, half: usize) -> Option<f64> {
        Some(self.degrees[half.min(self.adjacency.opposite(half)?)]).filter(|angle| !angle.is_nan())
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

    /// Whether a straight way into the facet of `half`, across it and `reach` long, meets no edge that is sharp by
    /// more than `most`. It ends at a crease or a boundary.
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
        let class = self.adjacency.representative();
        let mut found = Vec::new();
        for half in 0..3 * self.mesh.facets().len() {
            token.check_at(8 * half)?;
            let Some(other) = self.adjacency.opposite(half).filter(|&other| half < other) else { continue };
            let Some(angle) = self.at(half).filter(|b| (RIDGE_ANGLE_SHARE * crease..=crease).contains(b)) else {
                continue;
            };
            if [half, other].into_iter().all(|h| self.is_smooth_beside(h, NEIGHBOUR_ANGLE_SHARE * angle, crease, reach))
            {
                let corners = self.mesh.facets()[half / 3];
                let [a, b] = [half % 3, (half + 1) % 3].map(|k| class[corners[k] as usize]);
                found.push((undirected([a, b]), angle));
            }
        }
        found.sort_unstable_by_key(|r| r.0);
        Ok(found)
    }

    /// Adds ridges to a graph of creases: chains between two creases, chains from the free end of one, and other chains of
    /// at least `min_length`.
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
                ridges.insert(e, EdgeInfo { kind: super::CurveKind::Crease, required: false, angle });
            }
        }
        let nodes: std::collections::BTreeSet<u32> =
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
