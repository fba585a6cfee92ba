//! Splits of edges that are too long.
//!
//! Purpose: one pass over the edges, the longest first. Invariant: the module's above. Must not know: other passes.

use super::{Adapting, Mobility};
use crate::mesh::edges::{sides, undirected};
use crate::mesh::metric::{Site, length};
use crate::remesh::Result;
use crate::remesh::constants::*;
use crate::tasks;

struct Proposal {
    length: f64,
    edge: [u32; 2],
    site: Site,
    mobility: Mobility,
}

impl Adapting<'_> {
    /// Splits long edges. Returns how many, and how many of them for facets that do not face as the input does.
    pub(super) fn split(&mut self) -> Result<[usize; 2]> {
        let astray = self.astray()?;
        let propose = |edge: &[u32; 2]| {
            let length = self.length(*edge);
            let is_long = length > SPLIT_LENGTH || length > LEAST_ASTRAY && astray.binary_search(edge).is_ok();
            (is_long && !self.token.is_stopped()).then(|| self.proposed_split(*edge, length)).flatten()
        };
        let edges = self.mesh.edges();
        let mut proposals: Vec<Proposal> = tasks::flat_map(edges.len(), |k| propose(&edges[k]));
        self.token.check()?;
        proposals.sort_by(|a, b| b.length.total_cmp(&a.length).then(a.edge.cmp(&b.edge)));
        let mut touched = vec![false; self.sites.len()];
        let mut count = [0; 2];
        for Proposal { length, edge, site, mobility } in proposals {
            let mut footprint = edge.to_vec();
            footprint.extend(self.mesh.beside(edge).iter().map(|&(_, v)| v));
            if footprint.iter().any(|&v| touched[v as usize]) || self.sites.len() >= self.most {
                continue;
            }
            footprint.iter().for_each(|&v| touched[v as usize] = true);
            let new = self.mesh.split(edge, site.position);
            self.rails.split(edge, new);
            self.sites.push(site);
            self.mobility.push(mobility);
            self.origin.push(None);
            count[0] += 1;
            count[1] += usize::from(length <= SPLIT_LENGTH);
        }
        Ok(count)
    }

    /// The longest edges of facets that do not face as the input does: the metric's edges are too long for how it bends. Ascending.
    fn astray(&self) -> Result<Vec<[u32; 2]>> {
        let longest = |(): &mut (), f: usize| {
            let t = self.mesh.facets()[f];
            self.token.check_at(f)?;
            if self.field.facing(self.mesh.places(t)) >= FACING_COSINE {
                return Ok(None);
            }
            let sides = sides(t).map(undirected).into_iter();
            Ok(sides.max_by(|a, b| self.length(*a).total_cmp(&self.length(*b)).then(a.cmp(b))))
        };
        let longest: Result<Vec<Option<[u32; 2]>>> = tasks::try_map(self.mesh.facets().len(), || (), longest);
        let mut edges: Vec<[u32; 2]> = longest?.into_iter().flatten().collect();
        edges.sort_unstable();
        Ok(edges)
    }

    fn proposed_split(&self, edge: [u32; 2], length_here: f64) -> Option<Proposal> {
        let beside = self.mesh.beside(edge);
        let middle = edge.map(|v| self.site(v).position).iter().sum::<glam::DVec3>() * 0.5;
        let (site, mobility) = match self.rails.middle(edge) {
            Some(p) => (self.field.at(p), Mobility::Along),
            // A boundary without a curve stays where it is.
            None if beside.len() < 2 => (self.field.at(middle), Mobility::Fixed),
            None => (self.field.site(middle), Mobility::Free),
        };
        // Edges that are much too short would be taken out again: a vertex beside a curve is then drawn into it.
        let shortest = beside.iter().map(|&(_, v)| length(&site, self.site(v))).fold(f64::INFINITY, f64::min);
        if mobility == Mobility::Free && shortest < SHORTEST_NEW && length_here < FAR_TOO_LONG {
            return None;
        }
        let place = |v: u32| if v == u32::MAX { site.position } else { self.site(v).position };
        let new: Vec<_> = self.mesh.split_corners(edge).into_iter().map(|t| t.map(place)).collect();
        let old = beside.iter().map(|&(f, _)| self.mesh.corners(f));
        self.face(&new, old).then_some(Proposal { length: length_here, edge, site, mobility })
    }
}
