//! The combinatorics of a triangulation.
//!
//! Purpose: [`repair`] makes an oriented 2-manifold of the dual's triangles, [`boundary_ears`] restores edges of boundaries.
//! [`LocalMesh`] is the result while it changes, or a part cut out of it, with its local operators: [`LocalMesh::flip`] and
//! [`LocalMesh::turns`] say what is allowed; [`LocalMesh::apply`] does it. [`resize`] has operators that change the number of vertices.
//! Invariant: a manifold stays one. An edge of a curve or of the boundary stays. No facet turns over, but by [`LocalMesh::flip_any`]. Valences stay within the
//! range that a flip is given. One-rings are up to date after each operator.
//! Must not know: seeds, diagrams, distances, why something changes.

pub(super) mod boundary_ears;
pub(super) mod notches;
pub(super) mod repair;
mod resize;
pub(super) mod rims;

use std::collections::HashSet;

use glam::DVec3;

use super::constants::{FLIPPED_COSINE, REGULAR_VALENCE};
use super::triangle::unit_normal;
use crate::mesh::csr::{OneRings, ascending};
use crate::mesh::edges::{sides, undirected};
use crate::tasks;

#[derive(Clone, Debug)]
pub(crate) struct LocalMesh {
    pub(crate) positions: Vec<DVec3>,
    facets: Vec<[u32; 3]>,
    rings: OneRings,
    /// Facets around each vertex that are not in this mesh.
    outside: Vec<u32>,
    on_boundary: Vec<bool>,
    /// Edges that stay, lower end first.
    curves: HashSet<[u32; 2]>,
    /// Unit normals since [`Self::mark`], or since the facet's last flip.
    normals: Vec<DVec3>,
}

/// Two facets with a common edge, and what they become with the other diagonal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Flip {
    pub(crate) facets: [u32; 2],
    pub(crate) corners: [[u32; 3]; 2],
}

impl LocalMesh {
    /// A whole triangulation. Edges in `curves` (lower end first) stay.
    pub(crate) fn new(positions: Vec<DVec3>, facets: Vec<[u32; 3]>, curves: HashSet<[u32; 2]>) -> Self {
        let rings = OneRings::new(positions.len(), &facets);
        let outside = vec![0; positions.len()];
        let mut mesh = Self { on_boundary: Vec::new(), normals: Vec::new(), positions, facets, rings, outside, curves };
        let is_open = |&[a, b]: &[u32; 2]| mesh.facet_along(b, a).is_none();
        let open = tasks::flat_map(mesh.facets.len(), |f| sides(mesh.facets[f]).into_iter().filter(is_open));
        let mut on_boundary = vec![false; mesh.positions.len()];
        open.into_iter().flatten().for_each(|v| on_boundary[v as usize] = true);
        mesh.on_boundary = on_boundary;
        mesh.mark();
        mesh
    }

    /// Some facets of it, with the vertices numbered anew: vertex `k` of the part is `vertices[k]`. Both lists ascend.
    pub(crate) fn part(&self, facets: &[u32], vertices: &[u32]) -> Self {
        let local = |v: u32| vertices.binary_search(&v).unwrap_or_default() as u32;
        let of = |f: &u32| self.facets[*f as usize].map(local);
        let own: Vec<[u32; 3]> = facets.iter().map(of).collect();
        let rings = OneRings::new(vertices.len(), &own);
        let outside = |(&v, k): (&u32, u32)| (self.valence(v) - rings.of(k).len()) as u32;
        let edges = own.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]).map(undirected);
        let is_curve = |e: &[u32; 2]| self.curves.contains(&e.map(|v| vertices[v as usize]));
        let mut part = Self {
            positions: vertices.iter().map(|&v| self.positions[v as usize]).collect(),
            outside: vertices.iter().zip(0..).map(outside).collect(),
            on_boundary: vertices.iter().map(|&v| self.on_boundary[v as usize]).collect(),
            curves: edges.filter(is_curve).collect(),
            normals: Vec::new(),
            facets: own,
            rings,
        };
        part.mark();
        part
    }

    /// Puts a part back: the inverse of [`Self::part`]. Vertices stay as many.
    pub(crate) fn put_back(&mut self, part: &Self, facets: &[u32], vertices: &[u32]) {
        vertices.iter().zip(&part.positions).for_each(|(&v, &p)| self.positions[v as usize] = p);
        for (&f, t) in facets.iter().zip(&part.facets) {
            self.replace(f, t.map(|v| vertices[v as usize]));
        }
    }

    pub(crate) fn facets(&self) -> &[[u32; 3]] {
        &self.facets
    }

    pub(crate) fn into_parts(self) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        (self.positions, self.facets)
    }

    /// Facets around vertex `v`, ascending.
    pub(crate) fn ring(&self, v: u32) -> &[u32] {
        self.rings.of(v)
    }

    /// The vertices of the facets around `v`, that vertex included, ascending.
    pub(crate) fn neighbours(&self, v: u32) -> Vec<u32> {
        self.corners_around(&[v])
    }

    /// The corners of all facets around some vertices, ascending.
    pub(crate) fn corners_around(&self, vertices: &[u32]) -> Vec<u32> {
        let facets = vertices.iter().flat_map(|&v| self.ring(v));
        ascending(facets.flat_map(|&f| self.facets[f as usize]))
    }

    /// The facets around some vertices, ascending.
    pub(crate) fn facets_around(&self, vertices: &[u32]) -> Vec<u32> {
        ascending(vertices.iter().flat_map(|&v| self.ring(v)).copied())
    }

    pub(crate) fn corners(&self, f: u32) -> [DVec3; 3] {
        self.places(self.facets[f as usize])
    }

    pub(crate) fn corners_with(&self, f: u32, v: u32, p: DVec3) -> [DVec3; 3] {
        self.facets[f as usize].map(|u| if u == v { p } else { self.positions[u as usize] })
    }

    pub(crate) fn places(&self, t: [u32; 3]) -> [DVec3; 3] {
        t.map(|v| self.positions[v as usize])
    }

    pub(crate) fn valence(&self, v: u32) -> usize {
        self.ring(v).len() + self.outside[v as usize] as usize
    }

    /// Whether all facets of a vertex are in this mesh.
    pub(crate) fn is_inside(&self, v: u32) -> bool {
        self.outside[v as usize] == 0
    }

    pub(crate) fn is_on_boundary(&self, v: u32) -> bool {
        self.on_boundary[v as usize]
    }

    pub(crate) fn is_on_curve(&self, v: u32) -> bool {
        self.neighbours(v).into_iter().any(|u| self.curves.contains(&undirected([u, v])))
    }

    /// By how much the valence of an inner vertex is off the range that flips keep.
    pub(crate) fn irregularity(&self, v: u32) -> usize {
        match self.valence(v).abs_diff(REGULAR_VALENCE) {
            0 | 1 => 0,
            _ if self.is_on_boundary(v) => 0,
            off => off,
        }
    }

    pub(crate) fn keep(&mut self, ends: [u32; 2]) {
        self.curves.insert(undirected(ends));
    }

    /// Moves a vertex; the facets around it turn from the normals that they have then.
    pub(crate) fn place(&mut self, v: u32, p: DVec3) {
        self.positions[v as usize] = p;
        for k in 0..self.ring(v).len() {
            let f = self.ring(v)[k];
            self.normals[f as usize] = unit_normal(self.corners(f));
        }
    }

    /// Facets turn from the normals that they have now.
    pub(crate) fn mark(&mut self) {
        self.normals = tasks::map(self.facets.len(), |f| unit_normal(self.corners(f as u32)));
    }

    pub(crate) fn marked_normal(&self, f: u32) -> DVec3 {
        self.normals[f as usize]
    }

    pub(crate) fn vertex_normal(&self, v: u32) -> DVec3 {
        self.ring(v).iter().map(|&f| unit_normal(self.corners(f))).sum::<DVec3>().normalize_or(DVec3::Z)
    }

    /// Whether facet `f` with these corners is turned by more than this cosine from its marked normal.
    pub(crate) fn is_turned(&self, f: u32, corners: [DVec3; 3], least_cosine: f64) -> bool {
        unit_normal(corners).dot(self.normals[f as usize]) < least_cosine
    }

    /// Whether a facet would turn by more than this cosine from its marked normal with vertex `v` at `p`.
    pub(crate) fn turns(&self, v: u32, p: DVec3, least_cosine: f64) -> bool {
        self.ring(v).iter().any(|&f| self.is_turned(f, self.corners_with(f, v, p), least_cosine))
    }

    /// The facet with a side from `a` to `b`.
    fn facet_along(&self, a: u32, b: u32) -> Option<u32> {
        // The smaller of the two one-rings: one of them may be very large.
        let end = if self.ring(a).len() <= self.ring(b).len() { a } else { b };
        let runs = |t: [u32; 3]| (0..3).any(|k| t[k] == a && t[(k + 1) % 3] == b);
        self.ring(end).iter().copied().find(|&f| runs(self.facets[f as usize]))
    }

    /// Whether a facet has both vertices.
    fn are_joined(&self, c: u32, d: u32) -> bool {
        let (few, other) = if self.ring(c).len() <= self.ring(d).len() { (c, d) } else { (d, c) };
        self.ring(few).iter().any(|&f| self.facets[f as usize].contains(&other))
    }

    /// The flip of a side of `f`, if that is allowed: the link condition holds, the edge is no curve's, inner valences stay in
    /// the range or come nearer to it, and neither new facet turns over.
    pub(crate) fn flip(&self, f: u32, side: usize, valences: [usize; 2]) -> Option<Flip> {
        let flip = self.flip_any(f, side, valences)?;
        let mean = flip.facets.iter().map(|&f| unit_normal(self.corners(f))).sum::<DVec3>().normalize_or_zero();
        self.faces(&flip, mean, FLIPPED_COSINE).then_some(flip)
    }

    /// Whether both facets that a flip makes face a direction.
    pub(crate) fn faces(&self, flip: &Flip, direction: DVec3, least_cosine: f64) -> bool {
        flip.corners.iter().all(|&t| unit_normal(self.places(t)).dot(direction) >= least_cosine)
    }

    /// As [`Self::flip`], whichever way the facets face.
    pub(crate) fn flip_any(&self, f: u32, side: usize, [least, most]: [usize; 2]) -> Option<Flip> {
        let t = self.facets[f as usize];
        let (a, b, c) = (t[side], t[(side + 1) % 3], t[(side + 2) % 3]);
        let g = self.facet_along(b, a)?;
        let d = self.facets[g as usize].into_iter().find(|&v| v != a && v != b)?;
        let loses = |v: u32| self.is_on_boundary(v) || self.valence(v) > least;
        let gains = |v: u32| self.is_on_boundary(v) || self.valence(v) < most;
        // A facet outside may join them too.
        let joined = !self.is_inside(c) && !self.is_inside(d) || self.are_joined(c, d);
        if joined || self.curves.contains(&undirected([a, b])) || !(loses(a) && loses(b) && gains(c) && gains(d)) {
            return None;
        }
        Some(Flip { facets: [f, g], corners: [[a, d, c], [d, b, c]] })
    }

    pub(crate) fn apply(&mut self, flip: &Flip) {
        for (&f, &t) in flip.facets.iter().zip(&flip.corners) {
            self.replace(f, t);
            self.normals[f as usize] = unit_normal(self.corners(f));
        }
    }

    fn replace(&mut self, f: u32, t: [u32; 3]) {
        let old = std::mem::replace(&mut self.facets[f as usize], t);
        if old != t {
            self.rings.replace(f, old, t);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::remesh::constants::VALENCES;

    /// Two facets with the edge 0-1 in a plane, and four around them.
    fn diamond(curve: &[[u32; 2]]) -> LocalMesh {
        let at = |x: f64, y: f64| DVec3::new(x, y, 0.0);
        let positions = vec![at(0.0, -1.0), at(0.0, 1.0), at(-1.0, 0.0), at(1.0, 0.0), at(-2.0, 2.0), at(2.0, 2.0)];
        let facets = vec![[0, 1, 2], [1, 0, 3], [2, 1, 4], [1, 3, 5]];
        LocalMesh::new(positions, facets, curve.iter().copied().collect())
    }

    #[test]
    fn a_flip_replaces_a_diagonal_and_its_inverse_brings_it_back() {
        let mut mesh = diamond(&[]);
        let flip = mesh.flip(0, 0, VALENCES).unwrap();
        assert_eq!(flip.corners, [[0, 3, 2], [3, 1, 2]]);
        mesh.apply(&flip);
        assert_eq!([0, 1, 2, 3].map(|v| mesh.ring(v).to_vec()), [vec![0], vec![1, 2, 3], vec![0, 1, 2], vec![0, 1, 3]]);
        let side = (0..3).find(|&k| mesh.facets()[0][k] == 3).unwrap();
        let back = mesh.flip(0, side, VALENCES).unwrap();
        mesh.apply(&back);
        assert!(mesh.are_joined(0, 1) && !mesh.are_joined(2, 3));
    }

    #[test]
    fn a_flip_that_would_break_something_is_refused() {
        assert!(diamond(&[[0, 1]]).flip(0, 0, VALENCES).is_none(), "a curve's edge");
        assert!(diamond(&[]).flip(0, 2, VALENCES).is_none(), "an edge of the boundary");
        let mut dented = diamond(&[]);
        dented.positions[0] = DVec3::new(0.0, 0.5, 0.0);
        dented.mark();
        assert!(dented.flip(0, 0, VALENCES).is_none(), "a facet would turn over");
        // A tetrahedron: the other diagonal is there.
        let positions = vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
        let closed = LocalMesh::new(positions, vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], HashSet::new());
        assert!((0..12).all(|h| closed.flip(h / 3, h as usize % 3, VALENCES).is_none()), "the link condition");
    }

    #[test]
    fn a_vertex_moves_as_long_as_no_facet_turns_over() {
        let mut mesh = diamond(&[]);
        assert!(!mesh.turns(2, DVec3::new(-0.5, 0.2, 0.1), 0.5));
        mesh.positions[2] = DVec3::new(-0.5, 0.2, 0.1);
        assert!(mesh.turns(2, DVec3::new(1.0, 0.0, 0.0), 0.5));
        assert_eq!(mesh.positions[2], DVec3::new(-0.5, 0.2, 0.1));
    }

    #[test]
    fn a_part_knows_what_is_outside_and_goes_back() {
        let mut mesh = diamond(&[[1, 2]]);
        let (facets, vertices) = ([0, 1], [0, 1, 2, 3]);
        let mut part = mesh.part(&facets, &vertices);
        assert_eq!((part.valence(1), part.is_inside(1), part.is_inside(0)), (4, false, true));
        assert!(part.flip(0, 0, VALENCES).is_none(), "2 and 3 may be joined outside");
        part.positions[0] *= 2.0;
        mesh.put_back(&part, &facets, &vertices);
        assert_eq!(mesh.positions[0], DVec3::new(0.0, -2.0, 0.0));
    }
}
