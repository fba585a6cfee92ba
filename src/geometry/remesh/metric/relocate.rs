//! Relocation of vertices towards unit edges.
//!
//! Purpose: passes over the vertices. Each one is pulled by edges that are too long and pushed by short ones, and goes as far that way
//! as the edges and facets around it gain. Invariant: the module's above; the cost around a vertex falls with each move.
//! Must not know: other passes.

use glam::DVec3;

use super::rails::Beside;
use super::{Adapting, Mobility};
use crate::mesh::metric::{Site, length, quality};
use crate::remesh::Result;
use crate::remesh::constants::*;
use crate::tasks;

struct Proposal {
    gain: f64,
    v: u32,
    site: Site,
    /// How far along a curve.
    along: Option<(Beside, f64)>,
}

impl Adapting<'_> {
    /// Moves vertices while that helps, in so many passes at most.
    pub(super) fn relocate(&mut self, passes: usize) -> Result<()> {
        let mut waiting: Vec<u32> = (0..self.sites.len() as u32).collect();
        for _ in 0..passes {
            let propose = |&v: &u32| if self.token.is_stopped() { None } else { self.better_place(v) };
            let mut proposals: Vec<Proposal> = tasks::flat_map(waiting.len(), |k| propose(&waiting[k]));
            self.token.check()?;
            proposals.sort_by(|a, b| b.gain.total_cmp(&a.gain).then(a.v.cmp(&b.v)));
            let mut touched = vec![false; self.sites.len()];
            let mut next = Vec::new();
            for Proposal { v, site, along, .. } in proposals {
                let around = self.mesh.neighbours(v);
                next.extend_from_slice(&around);
                if around.iter().any(|&u| touched[u as usize]) {
                    continue;
                }
                touched[v as usize] = true;
                self.put(v, site);
                if let Some((beside, by)) = along {
                    self.rails.shift(v, &beside, by);
                }
            }
            if next.is_empty() {
                break;
            }
            waiting = crate::mesh::csr::ascending(next);
        }
        Ok(())
    }

    fn better_place(&self, v: u32) -> Option<Proposal> {
        let here = self.cost(v, self.site(v), f64::INFINITY);
        let mut best: Option<Proposal> = None;
        let mut offer = |site: Site, along: Option<(Beside, f64)>| {
            let most = best.as_ref().map_or(here - LEAST_MOVE_GAIN, |best| here - best.gain);
            let cost = self.cost(v, &site, most);
            if cost < most && self.faces_at(v, site.position) {
                best = Some(Proposal { gain: here - cost, v, site, along });
            }
        };
        match self.mobility[v as usize] {
            Mobility::Fixed => return None,
            Mobility::Free => {
                let (p, step) = (self.site(v).position, self.pull(v));
                MOVE_SHARES.iter().for_each(|share| offer(self.field.site(p + share * step), None));
            }
            Mobility::Along => {
                let beside = self.rails.beside(&self.mesh, v)?;
                // To where both edges are as long.
                let [back, ahead] = beside.ends.map(|u| self.length([v, u]));
                let way = if ahead > back { beside.reach[1] / ahead } else { -beside.reach[0] / back };
                let step = 0.5 * (ahead - back) * way;
                for share in MOVE_SHARES {
                    let by = share * step;
                    offer(self.field.at(self.rails.after(&beside, by)), Some((beside, by)));
                }
            }
        }
        best
    }

    /// Whether the facets around a vertex face as they should with it at a place.
    fn faces_at(&self, v: u32, place: DVec3) -> bool {
        let ring = self.mesh.ring(v);
        let corners: Vec<_> = ring.iter().map(|&f| self.mesh.corners_with(f, v, place)).collect();
        self.face(&corners, ring.iter().map(|&f| self.mesh.corners(f)))
    }

    /// The step that makes the edges of a vertex unit edges, in the mean.
    fn pull(&self, v: u32) -> DVec3 {
        let around = self.mesh.neighbours(v);
        let others = around.iter().filter(|&&u| u != v);
        let force: DVec3 = others
            .map(|&u| {
                let length = self.length([v, u]);
                (self.site(u).position - self.site(v).position) * (1.0 - 1.0 / length.max(SHORTEST_PULLED))
            })
            .sum();
        // Two opposite edges change by a step along them.
        force * (2.0 / (around.len() - 1).max(1) as f64)
    }

    /// What the edges and facets around `v` lack with it at a site, or any number not less than `most` if it is not less.
    /// Infinite if a facet turned over, or became a poor one.
    fn cost(&self, v: u32, site: &Site, most: f64) -> f64 {
        let mut cost = 0.0;
        // Of the shapes around it, there and here.
        let (mut least, mut before) = (f64::INFINITY, f64::INFINITY);
        for &f in self.mesh.ring(v) {
            let t = self.mesh.facets()[f as usize];
            if self.mesh.is_turned(f, self.mesh.corners_with(f, v, site.position), TURNED_COSINE) {
                return f64::INFINITY;
            }
            let of = |u: u32| if u == v { site } else { self.site(u) };
            let shape = quality(t.map(of));
            (least, before) = (least.min(shape), before.min(self.quality(t)));
            cost += SHAPE_WEIGHT * (1.0 - shape).powi(2);
            // Each edge is that of two facets.
            let others = t.into_iter().filter(|&u| u != v);
            cost += others.map(|u| 0.5 * length(site, self.site(u)).ln().powi(2)).sum::<f64>();
            if cost >= most {
                return cost;
            }
        }
        // As for collapses: beside a crease a vertex would be pulled onto it.
        if least < POOR_QUALITY && least < before { f64::INFINITY } else { cost }
    }
}
