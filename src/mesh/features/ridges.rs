//! Ridges that are bent less than a crease and go on where one ends.
//!
//! Purpose: a crease may fade, or run out into a ridge that is bent by twenty degrees only. Such a ridge sticks
//! out of a remesh just the same, and is told from the facets of a rounding by being alone: within a few edges of
//! the remesh nothing beside it is bent nearly as much. Two thresholds, the lower one for what goes on from the
//! higher, are those of Canny's edges in pictures (1986, section VI).
//! Invariant: depends on the mesh alone. Must not know: seeds, diagrams.

use glam::DVec3;
use rayon::prelude::*;

use super::{Edge, Graph, Ruler, What, edge};
use crate::mesh::TriMesh;
use crate::mesh::adjacency::{Adjacency, EdgeKind};
use crate::token::{Stopped, Token};

/// A ridge is bent by more than this share of the angle of creases,
const FAINT: f64 = 0.5;
/// and what is beside it by no more than this share of its own bend.
const BESIDE: f64 = 0.55;
/// What goes on from the free end of a crease is at least this share of that length, other ridges all of it.
const LEAST: f64 = 0.6;
/// Half-edges per task.
const CHUNK: usize = 8192;
/// Facets that are looked at on either side, at most.
const MOST_FACETS: usize = 200;

/// Bends of a surface's edges.
pub(super) struct Bends<'a> {
    mesh: &'a TriMesh,
    ruler: Ruler<'a>,
    adjacency: &'a Adjacency,
    /// Of each edge, by the lower one of its half-edges; no number where there is none.
    degrees: Vec<f64>,
}

impl<'a> Bends<'a> {
    pub(super) fn new(mesh: &'a TriMesh, ruler: Ruler<'a>, adjacency: &'a Adjacency) -> Self {
        let mut bends = Self { mesh, ruler, adjacency, degrees: Vec::new() };
        let halves = (0..3 * mesh.facets().len()).into_par_iter().with_min_len(CHUNK);
        let lower = |half: usize| adjacency.opposite(half).is_some_and(|other| half < other);
        let degrees = halves.map(|half| if lower(half) { bends.measure(half) } else { None }.unwrap_or(f64::NAN));
        bends.degrees = degrees.collect();
        bends
    }

    fn corners(&self, f: usize) -> [DVec3; 3] {
        self.mesh.facets()[f].map(|v| self.ruler.at(v))
    }

    fn normal(&self, f: usize) -> DVec3 {
        let [a, b, c] = self.corners(f);
        (b - a).cross(c - a).normalize_or_zero()
    }

    /// In the middle of a facet.
    fn fineness(&self, f: usize) -> f64 {
        self.mesh.facets()[f].map(|v| self.ruler.fineness(v)).iter().sum::<f64>() / 3.0
    }

    /// By how much the surface is bent at a half-edge, degrees; `None` where it has not two facets with an area.
    pub(super) fn at(&self, half: usize) -> Option<f64> {
        Some(self.degrees[half.min(self.adjacency.opposite(half)?)]).filter(|bend| !bend.is_nan())
    }

    fn measure(&self, half: usize) -> Option<f64> {
        let kind = self.adjacency.kind(half);
        let other = self.adjacency.opposite(half)?;
        // A facet without area has no normal, and says nothing of a bend.
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

    /// Whether a straight way into the facet of `half`, across it and `reach` long, meets no edge that is bent by
    /// more than `most`. It ends at a crease or a boundary.
    fn is_smooth_beside(&self, half: usize, most: f64, crease: f64, reach: f64) -> bool {
        let (mut half, mut left) = (half, reach);
        let [a, b] = [half % 3, (half + 1) % 3].map(|k| self.corners(half / 3)[k]);
        let mut here = 0.5 * (a + b);
        let mut way = self.normal(half / 3).cross(b - a);
        for _ in 0..MOST_FACETS {
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
            left -= step * self.fineness(f);
            if left <= 0.0 {
                return true;
            }
            here += step * way;
            let crossed = f * 3 + (half % 3 + exit) % 3;
            match (self.at(crossed), self.adjacency.opposite(crossed)) {
                (Some(bend), Some(_)) if bend > most => return bend > crease,
                (Some(_), Some(next)) => half = next,
                _ => return true,
            }
        }
        true
    }

    /// Edges that are a ridge and no crease, with their bends, ascending.
    fn ridges(&self, crease: f64, reach: f64, token: &Token) -> Result<Vec<(Edge, f64)>, Stopped> {
        let class = self.adjacency.representative();
        let mut found = Vec::new();
        for half in 0..3 * self.mesh.facets().len() {
            token.check_at(8 * half)?;
            let Some(other) = self.adjacency.opposite(half).filter(|&other| half < other) else { continue };
            let Some(bend) = self.at(half).filter(|b| (FAINT * crease..=crease).contains(b)) else { continue };
            if [half, other].into_iter().all(|h| self.is_smooth_beside(h, BESIDE * bend, crease, reach)) {
                let corners = self.mesh.facets()[half / 3];
                let [a, b] = [half % 3, (half + 1) % 3].map(|k| class[corners[k] as usize]);
                found.push((edge(a, b), bend));
            }
        }
        found.sort_unstable_by_key(|r| r.0);
        Ok(found)
    }

    /// Puts ridges into a graph of creases: chains between two places where there are creases, such as go on
    /// from the free end of one, and others that are at least `shortest` long.
    pub(super) fn add_ridges(
        &self,
        graph: &mut Graph,
        crease: f64,
        (reach, shortest): (f64, f64),
        token: &Token,
    ) -> Result<(), Stopped> {
        let mut faint = Graph::default();
        for (e, angle) in self.ridges(crease, reach, token)? {
            if !graph.edges.contains_key(&e) {
                faint.insert(e, What { kind: super::CurveKind::Crease, kept: false, angle });
            }
        }
        let nodes: std::collections::BTreeSet<u32> =
            faint.around.iter().filter(|(v, l)| l.len() != 2 || graph.degree(**v) > 0).map(|(&v, _)| v).collect();
        let mut chosen = Vec::new();
        for &v in &nodes {
            token.check()?;
            for &next in &faint.around[&v] {
                let chain = faint.chain_to(v, next, &nodes);
                let (first, last) = (chain[0], chain[chain.len() - 1]);
                if first > last || (first == last && chain[1] > chain[chain.len() - 2]) {
                    // Seen from its other end.
                    continue;
                }
                let length = self.ruler.chain(&chain);
                let ends = [first, last].map(|v| graph.degree(v));
                let between = ends[0] > 0 && ends[1] > 0;
                let goes_on = ends.contains(&1);
                if length >= reach && (between || length >= shortest) || goes_on && length >= LEAST * reach {
                    chosen.push(chain);
                }
            }
        }
        for chain in chosen {
            for p in chain.windows(2) {
                let e = edge(p[0], p[1]);
                graph.insert(e, faint.edges[&e]);
            }
        }
        Ok(())
    }
}
