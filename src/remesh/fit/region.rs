//! The part of a triangulation that a round of the fit works on.
//!
//! Purpose: some vertices, the facets that have one of them, and the corners of these, each with a local number. A round in a
//! small region costs no more than the region.
//! Invariant: vertices and facets ascend. Must not know: what is done there.

use crate::mesh::csr::Csr;

/// Vertices so many edges away from a pulled vertex move with it.
const RINGS: usize = 3;
/// The number of what is not in the region.
pub(super) const NONE: u32 = u32::MAX;

/// See the module's head.
pub(super) struct Region {
    /// Facets with a corner inside, and for each facet of all its number among them.
    pub(super) facets: Vec<u32>,
    facet_number: Vec<u32>,
    /// Their corners, and for each vertex of all its number among them.
    pub(super) vertices: Vec<u32>,
    vertex_number: Vec<u32>,
    inside: Vec<bool>,
}

impl Region {
    /// All of a triangulation.
    pub(super) fn everywhere(vertices: usize, facets: usize) -> Self {
        let all = |n: usize| (0..n as u32).collect::<Vec<u32>>();
        Self {
            facets: all(facets),
            facet_number: all(facets),
            vertices: all(vertices),
            vertex_number: all(vertices),
            inside: vec![true; vertices],
        }
    }

    /// The vertices within a few edges of `front`.
    pub(super) fn around_of(mut front: Vec<u32>, vertices: usize, facets: &[[u32; 3]], rings: &Csr<u32>) -> Self {
        let mut inside = vec![false; vertices];
        front.iter().for_each(|&v| inside[v as usize] = true);
        let mut within = front.clone();
        for _ in 0..RINGS {
            let mut next = Vec::new();
            for u in front.iter().flat_map(|&v| rings.of(v)).flat_map(|&f| facets[f as usize]) {
                if !std::mem::replace(&mut inside[u as usize], true) {
                    next.push(u);
                }
            }
            within.extend(&next);
            front = next;
        }
        let (mut facet_number, mut vertex_number) = (vec![NONE; facets.len()], vec![NONE; vertices]);
        let touched = numbered(within.into_iter().flat_map(|v| rings.of(v)).copied(), &mut facet_number);
        let reached = numbered(touched.iter().flat_map(|&f| facets[f as usize]), &mut vertex_number);
        Self { facets: touched, facet_number, vertices: reached, vertex_number, inside }
    }

    /// The vertices inside.
    pub(super) fn inside(&self) -> impl Iterator<Item = u32> + '_ {
        self.vertices.iter().copied().filter(|&v| self.inside[v as usize])
    }

    /// The number of facet `f` in `facets`; [`NONE`] if it is none of them.
    pub(super) fn facet_number(&self, f: u32) -> u32 {
        self.facet_number.get(f as usize).copied().unwrap_or(NONE)
    }

    /// The number of vertex `v` in `vertices`; [`NONE`] if it is none of them.
    pub(super) fn vertex_number(&self, v: u32) -> u32 {
        self.vertex_number[v as usize]
    }

    /// Whether vertex `v` has a facet with a corner inside.
    pub(super) fn reaches(&self, v: u32) -> bool {
        self.vertex_number[v as usize] != NONE
    }
}

/// The elements that come, each once and ascending. Writes the number of each into `number`.
fn numbered(elements: impl Iterator<Item = u32>, number: &mut [u32]) -> Vec<u32> {
    let mut found: Vec<u32> = elements.filter(|&k| std::mem::replace(&mut number[k as usize], 0) == NONE).collect();
    found.sort_unstable();
    found.iter().zip(0..).for_each(|(&k, i)| number[k as usize] = i);
    found
}
