//! Edge flips in a patch.
//!
//! Purpose: which edges of a patch may be flipped, the flip itself, and the way of a changed patch back into the result.
//! Invariant: a flip keeps a manifold, leaves edges of curves alone and turns no facet over. Valences of inner vertices stay
//! within the given range, or come nearer to it.
//! Must not know: why an edge is flipped.

use glam::DVec3;

use super::patch::Patch;
use crate::remesh::manifold::one_rings::EditedRings;
use crate::remesh::triangle::unit_normal;

/// Normals of the facets of a flipped edge keep this cosine to the mean of the two before.
const FLIPPED_COSINE: f64 = 0.3;
/// The valences that flips keep,
const VALENCES: [usize; 2] = [5, 7];
/// and those that they may make where an edge of a curve is recovered.
const RECOVERY_VALENCES: [usize; 2] = [4, 8];
/// Valence of a vertex of the regular triangulation.
const REGULAR_VALENCE: usize = 6;

/// The other facet of a flipped edge, and what the two facets become.
type Flip = (usize, [[usize; 3]; 2]);

impl Patch {
    /// Edges of the centre's facets that may be flipped: facet and side of it.
    pub(super) fn flips(&self) -> Vec<(usize, usize)> {
        self.edges_around().into_iter().filter(|&(f, side)| self.flipped(f, side, VALENCES).is_some()).collect()
    }

    /// What a flip of a side of `f` makes, if it is allowed with these valences.
    fn flipped(&self, f: usize, side: usize, [least, most]: [usize; 2]) -> Option<Flip> {
        let t = self.facets[f];
        let (a, b, c) = (t[side], t[(side + 1) % 3], t[(side + 2) % 3]);
        let runs_back = |g: &&usize| (0..3).any(|k| self.facets[**g][k] == b && self.facets[**g][(k + 1) % 3] == a);
        let &g = self.rings[a].iter().find(runs_back)?;
        let d = *self.facets[g].iter().find(|&&v| v != a && v != b)?;
        let joined = self.rings[c].iter().any(|&h| self.facets[h].contains(&d));
        // A facet outside may join them too.
        let may_be_joined = self.outside[c] > 0 && self.outside[d] > 0;
        if joined || may_be_joined || self.curve_edges.contains(&[a.min(b), a.max(b)]) {
            return None;
        }
        let loses = |v: usize| self.on_boundary[v] || self.valence(v) > least;
        let gains = |v: usize| self.on_boundary[v] || self.valence(v) < most;
        if !(loses(a) && loses(b) && gains(c) && gains(d)) {
            return None;
        }
        let new = [[a, d, c], [d, b, c]];
        let mean = (unit_normal(self.corners(f)) + unit_normal(self.corners(g))).normalize_or_zero();
        let fine = new.iter().all(|t| unit_normal(t.map(|v| self.positions[v])).dot(mean) >= FLIPPED_COSINE);
        fine.then_some((g, new))
    }

    /// Flips an edge, if that is allowed.
    pub(super) fn flip(&mut self, f: usize, side: usize) -> bool {
        let flip = self.flipped(f, side, VALENCES);
        self.replace(f, flip)
    }

    /// Flips an edge to recover an edge of a curve: a wider range of valences is allowed.
    pub(super) fn flip_for_recovery(&mut self, f: usize, side: usize) -> bool {
        let flip = self.flipped(f, side, RECOVERY_VALENCES);
        self.replace(f, flip)
    }

    /// Edges of the centre's facets, each once: facet and side of it.
    pub(super) fn edges_around(&self) -> Vec<(usize, usize)> {
        let all = self.rings[self.centre].iter().flat_map(|&f| (0..3).map(move |side| (f, side)));
        all.filter(|&(f, side)| self.facets[f][side] != self.centre).collect()
    }

    /// Edges whose flip joins the centre and vertex `to` of the result.
    pub(super) fn flips_joining(&self, to: u32) -> Vec<(usize, usize)> {
        let Ok(to) = self.vertices.binary_search(&to) else { return Vec::new() };
        let joins = |&(f, side): &(usize, usize)| {
            self.facets[f][(side + 2) % 3] == self.centre
                && self.flipped(f, side, RECOVERY_VALENCES).is_some_and(|(_, new)| new[0].contains(&to))
        };
        self.edges_around().into_iter().filter(joins).collect()
    }

    /// Whether the centre has 5 to 7 neighbours.
    pub(super) fn is_regular(&self) -> bool {
        (VALENCES[0]..=VALENCES[1]).contains(&self.valence(self.centre))
    }

    /// Whether the centre's valence is nearer to that of a regular vertex than it was.
    pub(super) fn is_more_regular_than(&self, before: &Self) -> bool {
        self.valence(self.centre).abs_diff(REGULAR_VALENCE) < before.valence(self.centre).abs_diff(REGULAR_VALENCE)
    }

    fn replace(&mut self, f: usize, flip: Option<Flip>) -> bool {
        let Some((g, new)) = flip else { return false };
        for (h, t) in [(f, new[0]), (g, new[1])] {
            for v in self.facets[h] {
                self.rings[v].retain(|&x| x != h);
            }
            self.facets[h] = t;
        }
        for h in [f, g] {
            for v in self.facets[h] {
                self.rings[v].push(h);
                self.rings[v].sort_unstable();
            }
            self.normals[h] = unit_normal(self.corners(h));
            self.update_distances(h);
        }
        true
    }

    /// Puts it back into the result.
    pub(super) fn apply(&self, positions: &mut [DVec3], facets: &mut [[u32; 3]], rings: &mut EditedRings) {
        for (v, &id) in self.vertices.iter().enumerate() {
            positions[id as usize] = self.positions[v];
        }
        for (t, &id) in self.facets.iter().zip(&self.facet_ids) {
            let new = t.map(|v| self.vertices[v]);
            if facets[id as usize] != new {
                rings.replace(id, facets[id as usize], new);
                facets[id as usize] = new;
            }
        }
    }
}
