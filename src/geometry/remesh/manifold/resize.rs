//! Local operators that change the number of vertices.
//!
//! Purpose: [`LocalMesh::split`] puts a vertex into an edge, [`LocalMesh::collapse`] takes one vertex of an edge out, if
//! [`LocalMesh::may_collapse`] allows it. Vertices and facets that are taken out keep their numbers until [`LocalMesh::compact`].
//! Invariant: as in the module above. A curve stays in one piece, and a boundary where it is.
//! Must not know: why the number changes.

use glam::DVec3;
use rayon::prelude::*;

use super::LocalMesh;
use crate::mesh::edges::{sides, undirected};
use crate::remesh::triangle::unit_normal;
use crate::tasks;

/// Corners of a facet that was taken out.
const GONE: [u32; 3] = [0; 3];

impl LocalMesh {
    pub(crate) fn is_curve(&self, ends: [u32; 2]) -> bool {
        self.curves.contains(&undirected(ends))
    }

    /// The facets with an edge, and the corner of each that is no end of it.
    pub(crate) fn beside(&self, [a, b]: [u32; 2]) -> Vec<(u32, u32)> {
        let opposite = |f: u32| self.facets[f as usize].into_iter().find(|&v| v != a && v != b);
        let facets = self.ring(a).iter().filter(|&&f| self.facets[f as usize].contains(&b));
        facets.filter_map(|&f| Some((f, opposite(f)?))).collect()
    }

    /// Each edge once, lower end first, ascending.
    pub(crate) fn edges(&self) -> Vec<[u32; 2]> {
        let mut edges = tasks::flat_map(self.facets.len(), |f| sides(self.facets[f]).map(undirected));
        edges.par_sort_unstable();
        edges.dedup();
        edges
    }

    /// The corners of the facets that a vertex in this edge makes of those beside it; `u32::MAX` stands for the vertex.
    pub(crate) fn split_corners(&self, [a, b]: [u32; 2]) -> Vec<[u32; 3]> {
        let halves = |(f, _): (u32, u32)| [a, b].map(|end| self.with(f, end, u32::MAX));
        self.beside([a, b]).into_iter().flat_map(halves).collect()
    }

    fn with(&self, f: u32, v: u32, other: u32) -> [u32; 3] {
        self.facets[f as usize].map(|u| if u == v { other } else { u })
    }

    /// Puts a vertex at `p` into an edge, which is on the boundary if it has one facet. Returns the vertex.
    pub(crate) fn split(&mut self, [a, b]: [u32; 2], p: DVec3) -> u32 {
        let beside = self.beside([a, b]);
        let new = self.positions.len() as u32;
        self.positions.push(p);
        self.outside.push(0);
        self.on_boundary.push(beside.len() == 1);
        self.rings.push();
        for (f, _) in beside {
            let (kept, added) = (self.with(f, b, new), self.with(f, a, new));
            self.replace(f, kept);
            self.normals[f as usize] = unit_normal(self.corners(f));
            let g = self.facets.len() as u32;
            self.facets.push(added);
            self.rings.replace(g, [], added);
            self.normals.push(unit_normal(self.corners(g)));
        }
        if self.curves.remove(&undirected([a, b])) {
            self.curves.extend([undirected([a, new]), undirected([new, b])]);
        }
        new
    }

    /// Whether `from` may become `to`, its neighbour: the link condition holds; a vertex of a curve or of the boundary moves along
    /// it, and what remains of a curve does not fold back on another edge of one.
    pub(crate) fn may_collapse(&self, from: u32, to: u32) -> bool {
        let beside = self.beside([from, to]);
        let (around, others) = (self.neighbours(from), self.neighbours(to));
        let common = around.iter().filter(|v| ![from, to].contains(v) && others.binary_search(v).is_ok()).count();
        let along = self.is_curve([from, to]);
        let curves = || around.iter().filter(|&&u| u != from && self.is_curve([from, u]));
        // The facet between would be lost, with the curve on both of its sides.
        let folds = || curves().any(|&u| u != to && self.is_curve([to, u]));
        // Two facets with the same corners would be left of three around a vertex.
        let is_spent = |&(_, v): &(u32, u32)| !self.is_on_boundary(v) && self.valence(v) <= 3;
        common == beside.len()
            && (!self.is_on_boundary(from) || beside.len() == 1)
            && self.ring(from).len() > beside.len()
            && !beside.iter().any(is_spent)
            && (along && curves().count() == 2 && !folds() || !along && curves().count() == 0)
    }

    /// The corners of the facets that are there after a collapse, with the facets that they take the place of.
    pub(crate) fn collapse_corners(&self, from: u32, to: u32) -> Vec<(u32, [u32; 3])> {
        let stays = |&&f: &&u32| !self.facets[f as usize].contains(&to);
        self.ring(from).iter().filter(stays).map(|&f| (f, self.with(f, from, to))).collect()
    }

    /// Returns the facets that are no more.
    pub(crate) fn collapse(&mut self, from: u32, to: u32) -> Vec<u32> {
        let mut gone = Vec::new();
        let curves: Vec<u32> = self.neighbours(from).into_iter().filter(|&u| self.is_curve([from, u])).collect();
        for f in self.ring(from).to_vec() {
            let t = self.facets[f as usize];
            if t.contains(&to) {
                self.rings.replace(f, t, []);
                self.facets[f as usize] = GONE;
                gone.push(f);
            } else {
                self.replace(f, self.with(f, from, to));
                self.normals[f as usize] = unit_normal(self.corners(f));
            }
        }
        for u in curves {
            self.curves.remove(&undirected([from, u]));
            if u != to {
                self.curves.insert(undirected([to, u]));
            }
        }
        gone
    }

    /// The edges around some facets, in their direction. `None` if these are no disk with all corners on its rim.
    pub(crate) fn fan(&self, cavity: &[u32]) -> Option<Vec<[u32; 2]>> {
        let all: Vec<[u32; 2]> = cavity.iter().flat_map(|&f| sides(self.facets[f as usize])).collect();
        let rim: Vec<[u32; 2]> = all.iter().copied().filter(|&[a, b]| !all.contains(&[b, a])).collect();
        let mut corners: Vec<u32> = rim.iter().map(|side| side[0]).collect();
        corners.sort_unstable();
        corners.dedup();
        (rim.len() == cavity.len() + 2 && corners.len() == rim.len()).then_some(rim)
    }

    /// Puts a vertex without facets at `p`, in place of facets that have a [`Self::fan`]. `gone` are two that were taken out.
    pub(crate) fn insert(&mut self, v: u32, p: DVec3, cavity: &[u32], gone: &[u32]) {
        self.positions[v as usize] = p;
        let facets = cavity.iter().chain(gone).copied().zip(self.fan(cavity).unwrap_or_default()).collect::<Vec<_>>();
        for (f, [a, b]) in facets {
            let old = std::mem::replace(&mut self.facets[f as usize], [a, b, v]);
            self.rings.replace(f, old.into_iter().filter(|_| old != GONE), [a, b, v]);
            self.normals[f as usize] = unit_normal(self.corners(f));
        }
    }

    /// Leaves out what was taken out. Returns the vertices that remain by their old numbers, ascending, and the new number of each
    /// old one.
    pub(crate) fn compact(&mut self) -> (Vec<u32>, Vec<u32>) {
        let kept: Vec<u32> = (0..self.positions.len() as u32).filter(|&v| !self.ring(v).is_empty()).collect();
        let mut number = vec![u32::MAX; self.positions.len()];
        kept.iter().zip(0..).for_each(|(&v, k)| number[v as usize] = k);
        let facets = self.facets.iter().filter(|t| **t != GONE).map(|t| t.map(|v| number[v as usize])).collect();
        let positions = kept.iter().map(|&v| self.positions[v as usize]).collect();
        let curves = self.curves.iter().map(|e| e.map(|v| number[v as usize])).collect();
        *self = Self::new(positions, facets, curves);
        (kept, number)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;

    /// A regular grid of squares of two facets each.
    fn grid(side: u32, curves: &[[u32; 2]]) -> LocalMesh {
        let at = |k: u32| DVec3::new(f64::from(k % (side + 1)), f64::from(k / (side + 1)), 0.0);
        let square = |k: u32| {
            let a = k % side + (side + 1) * (k / side);
            let (b, c, d) = (a + 1, a + side + 2, a + side + 1);
            [[a, b, c], [a, c, d]]
        };
        let positions = (0..(side + 1) * (side + 1)).map(at).collect();
        LocalMesh::new(positions, (0..side * side).flat_map(square).collect(), curves.iter().copied().collect())
    }

    fn area(mesh: &LocalMesh) -> f64 {
        let own = |t: &[u32; 3]| {
            let [a, b, c] = mesh.places(*t);
            0.5 * (b - a).cross(c - a).z
        };
        mesh.facets().iter().map(own).sum()
    }

    #[test]
    fn a_collapse_undoes_a_split() {
        for edge in [[5, 10], [5, 6], [1, 2]] {
            let mut mesh = grid(3, &[[5, 6], [0, 1], [1, 2], [2, 3]]);
            let before = mesh.clone();
            let middle = mesh.positions[edge[0] as usize].midpoint(mesh.positions[edge[1] as usize]);
            let new = mesh.split(edge, middle);
            assert!((area(&mesh) - 9.0).abs() < 1e-12);
            assert_eq!(mesh.is_on_boundary(new), edge == [1, 2]);
            assert_eq!(mesh.is_curve([edge[0], new]), edge != [5, 10]);
            assert!(mesh.may_collapse(new, edge[1]), "{edge:?}");
            mesh.collapse(new, edge[1]);
            assert_eq!(mesh.compact().0.len(), 16);
            assert_eq!(mesh.edges(), before.edges());
            assert_eq!(mesh.curves, before.curves);
            assert!((area(&mesh) - 9.0).abs() < 1e-12);
        }
    }

    #[test]
    fn a_vertex_is_taken_out_and_put_in_elsewhere() {
        // Facets 8 and 9 are the halves of one square.
        for cavity in [vec![8], vec![8, 9]] {
            let mut mesh = grid(4, &[]);
            let p = mesh.corners(8).iter().sum::<DVec3>() / 3.0;
            assert_eq!(mesh.fan(&cavity).map(|rim| rim.len()), Some(cavity.len() + 2));
            let gone = mesh.collapse(18, 17);
            mesh.insert(18, p, &cavity, &gone);
            assert!((area(&mesh) - 16.0).abs() < 1e-12, "{cavity:?}");
            assert_eq!((mesh.ring(18).len(), mesh.positions[18]), (cavity.len() + 2, p));
            assert_eq!(mesh.compact().0.len(), 25);
        }
        let mesh = grid(4, &[]);
        assert_eq!(mesh.fan(&[0, 30]), None, "they have no edge in common");
        assert_eq!(mesh.fan(mesh.ring(6)), None, "a vertex within");
    }

    #[test]
    fn a_collapse_that_would_break_something_is_refused() {
        let mesh = grid(3, &[[5, 6], [6, 7], [6, 10]]);
        assert!(!mesh.may_collapse(1, 5), "a vertex of the boundary would leave it");
        assert!(!mesh.may_collapse(5, 10), "a vertex of a curve would leave it");
        assert!(!mesh.may_collapse(6, 5), "where curves meet");
        assert!(mesh.may_collapse(9, 10) && mesh.may_collapse(9, 8));
        // A tetrahedron, and a ring of three facets around an edge.
        let positions = vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
        let closed = LocalMesh::new(positions, vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], HashSet::new());
        assert!((0..4).all(|v| (0..4).all(|u| u == v || !closed.may_collapse(v, u))), "the link condition");
        let fan = LocalMesh::new(
            vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::new(-1.0, -1.0, 0.0)],
            vec![[0, 1, 2], [0, 2, 3], [0, 3, 1]],
            [[1, 2], [2, 3], [1, 3]].into_iter().collect(),
        );
        assert!(!fan.may_collapse(1, 2), "a boundary of three edges");
        assert!(fan.may_collapse(0, 1));
    }
}
