//! The part of a triangulation that a round of a fit works on.
//!
//! Purpose: some vertices, the facets that have one of them, and the corners of these, with places for each, so that
//! a round in a small part costs no more than the part.
//! Invariant: vertices and facets ascend. Must not know: what is done there.

use crate::mesh::csr::Csr;

/// A tip moves vertices that are so many edges away from it, with it.
const RINGS: usize = 3;
/// Not there.
pub(super) const NONE: u32 = u32::MAX;

/// See the module's head.
pub(super) struct Region {
    /// Facets with a corner inside, and the place of each facet among them.
    pub(super) facets: Vec<u32>,
    place: Vec<u32>,
    /// Their corners, and the place of each vertex among them.
    pub(super) reached: Vec<u32>,
    slot: Vec<u32>,
    inside: Vec<bool>,
}

impl Region {
    /// All of a triangulation.
    pub(super) fn everywhere(vertices: usize, facets: usize) -> Self {
        let all = |n: usize| (0..n as u32).collect::<Vec<u32>>();
        Self {
            facets: all(facets),
            place: all(facets),
            reached: all(vertices),
            slot: all(vertices),
            inside: vec![true; vertices],
        }
    }

    /// The vertices within a few edges of `front`.
    pub(super) fn around_of(mut front: Vec<u32>, vertices: usize, facets: &[[u32; 3]], around: &Csr<u32>) -> Self {
        let mut inside = vec![false; vertices];
        front.iter().for_each(|&v| inside[v as usize] = true);
        let mut within = front.clone();
        for _ in 0..RINGS {
            let mut next = Vec::new();
            for u in front.iter().flat_map(|&v| around.of(v)).flat_map(|&f| facets[f as usize]) {
                if !std::mem::replace(&mut inside[u as usize], true) {
                    next.push(u);
                }
            }
            within.extend(&next);
            front = next;
        }
        let (mut place, mut slot) = (vec![NONE; facets.len()], vec![NONE; vertices]);
        let touched = numbered(within.into_iter().flat_map(|v| around.of(v)).copied(), &mut place);
        let reached = numbered(touched.iter().flat_map(|&f| facets[f as usize]), &mut slot);
        Self { facets: touched, place, reached, slot, inside }
    }

    /// The vertices inside.
    pub(super) fn inside(&self) -> impl Iterator<Item = u32> + '_ {
        self.reached.iter().copied().filter(|&v| self.inside[v as usize])
    }

    /// The place of facet `f` in `facets`; [`NONE`] if it is none of them.
    pub(super) fn place(&self, f: u32) -> u32 {
        self.place.get(f as usize).copied().unwrap_or(NONE)
    }

    /// The place of vertex `v` in `reached`; [`NONE`] if it is none of them.
    pub(super) fn slot(&self, v: u32) -> u32 {
        self.slot[v as usize]
    }

    /// Whether vertex `v` has a facet with a corner inside.
    pub(super) fn reaches(&self, v: u32) -> bool {
        self.slot[v as usize] != NONE
    }
}

/// The numbers that come, each once and ascending, and the place of each.
fn numbered(numbers: impl Iterator<Item = u32>, place: &mut [u32]) -> Vec<u32> {
    let mut found: Vec<u32> = numbers.filter(|&k| std::mem::replace(&mut place[k as usize], 0) == NONE).collect();
    found.sort_unstable();
    found.iter().zip(0..).for_each(|(&k, i)| place[k as usize] = i);
    found
}
