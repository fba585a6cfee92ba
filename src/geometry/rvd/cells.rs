//! RVD pieces, packed for streaming.
//!
//! Purpose: the polygons in which cells meet facets, in flat arrays.
//! Invariant: `offset` has one entry more than `facet` and `seed`; piece i owns the vertices
//! `offset[i]..offset[i + 1]`. A piece has at least three vertices, counter-clockwise as its facet.
//! Must not know: backends, what pieces are for.

use glam::DVec3;

/// `opposite` value of a polygon edge that lies on edge `e` of the facet (from corner `e` to
/// corner `(e + 1) % 3`): [`FACET_EDGE`]` - e`. Seed indices are always smaller.
pub const FACET_EDGE: u32 = u32::MAX;

/// The facet edge a label stands for, or `None` if it is a seed.
pub fn facet_edge(label: u32) -> Option<usize> {
    (label >= FACET_EDGE - 2).then(|| (FACET_EDGE - label) as usize)
}

/// Pieces of one batch of facets.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PieceBatch {
    /// Facet of each piece, ascending.
    pub facet: Vec<u32>,
    /// Seed of each piece, ascending within a facet.
    pub seed: Vec<u32>,
    /// First vertex of each piece, and the total at the end.
    pub offset: Vec<u32>,
    /// Vertex positions: unit frame from a [`Session`](super::Session), caller's coordinates from a
    /// [`Diagram`](super::Diagram).
    pub position: Vec<DVec3>,
    /// Density weight at each vertex.
    pub weight: Vec<f64>,
    /// For the edge from each vertex to the next of its piece: the seed on the other side, or
    /// a facet edge ([`facet_edge`]).
    pub opposite: Vec<u32>,
}

impl PieceBatch {
    /// How many pieces there are.
    pub fn len(&self) -> usize {
        self.facet.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.facet.is_empty()
    }

    /// Empties it and keeps the memory.
    pub fn clear(&mut self) {
        self.facet.clear();
        self.seed.clear();
        self.offset.clear();
        self.offset.push(0);
        self.position.clear();
        self.weight.clear();
        self.opposite.clear();
    }

    /// Vertices of piece `i`.
    pub fn vertices(&self, i: usize) -> std::ops::Range<usize> {
        self.offset[i] as usize..self.offset[i + 1] as usize
    }

    /// Appends a piece. `vertices` yields (position, weight, opposite).
    pub fn push(&mut self, facet: u32, seed: u32, vertices: impl IntoIterator<Item = (DVec3, f64, u32)>) {
        if self.offset.is_empty() {
            self.offset.push(0);
        }
        self.facet.push(facet);
        self.seed.push(seed);
        for (position, weight, opposite) in vertices {
            self.position.push(position);
            self.weight.push(weight);
            self.opposite.push(opposite);
        }
        self.offset.push(self.position.len() as u32);
    }

    /// Orders the pieces by facet, then by seed.
    pub fn sort(&mut self) {
        let mut order: Vec<usize> = (0..self.len()).collect();
        if !self.facet.is_sorted() {
            order.sort_by_key(|&i| self.facet[i]);
        }
        // Those of one facet are few.
        let of_facet = order.chunk_by_mut(|&i, &j| self.facet[i] == self.facet[j]);
        of_facet.for_each(|pieces| pieces.sort_unstable_by_key(|&i| self.seed[i]));
        if order.is_sorted() {
            return;
        }
        let mut sorted = PieceBatch::default();
        for i in order {
            let vertices = self.vertices(i).map(|v| (self.position[v], self.weight[v], self.opposite[v]));
            sorted.push(self.facet[i], self.seed[i], vertices);
        }
        *self = sorted;
    }

    /// Area of piece `i`, in the units of the positions squared.
    pub fn area(&self, i: usize) -> f64 {
        let p = &self.position[self.vertices(i)];
        let twice = (2..p.len()).fold(DVec3::ZERO, |sum, k| sum + (p[k - 1] - p[0]).cross(p[k] - p[0]));
        0.5 * twice.length()
    }

    /// Appends all pieces of `other`.
    pub fn extend(&mut self, other: &PieceBatch) {
        if self.offset.is_empty() {
            self.offset.push(0);
        }
        let base = self.position.len() as u32;
        self.facet.extend_from_slice(&other.facet);
        self.seed.extend_from_slice(&other.seed);
        self.offset.extend(other.offset.iter().skip(1).map(|o| o + base));
        self.position.extend_from_slice(&other.position);
        self.weight.extend_from_slice(&other.weight);
        self.opposite.extend_from_slice(&other.opposite);
    }
}
