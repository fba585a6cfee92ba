//! The dual of the diagram: the restricted Delaunay triangulation (RDT).
//!
//! Purpose: triangles between cells that meet in a point of the surface, read from the symbolic
//! identities of the pieces' vertices (facet, two bisectors), never from coordinates.
//! Invariant: every connected component of a restricted cell is a vertex of its own (\[YBZW14\]),
//! so that no triangle joins two sheets; triangles are oriented as the facet they were found in.
//! Must not know: which backend made the pieces, what happens to the triangles.

use glam::DVec3;
use rayon::prelude::*;

use super::cells::facet_edge;
use super::{CancelFlag, PassStats, PieceBatch, RvdError, Session, Surface};
use crate::mesh::disjoint::DisjointSets;

/// A triangulation whose vertices are components of restricted cells.
#[derive(Clone, Debug, Default)]
pub struct Dual {
    /// Three components a triangle.
    pub triangles: Vec<[u32; 3]>,
    /// The components, ordered by seed and then by first facet.
    pub components: Vec<Component>,
    /// Cells with more than one component.
    pub split_cells: usize,
    /// RVD vertices whose three cells do not agree that they meet there. Their triangles are
    /// attached to the largest component of the cell that does not know.
    pub disputed: usize,
    /// Area of all pieces, unit frame.
    pub area: f64,
    /// Cells without any piece.
    pub empty_cells: usize,
    /// What the pass did.
    pub stats: PassStats,
}

/// One connected part of a restricted cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Component {
    /// The cell's seed.
    pub seed: u32,
    /// Its area, unit frame.
    pub area: f64,
    /// Its centroid (density 1), unit frame.
    pub centroid: DVec3,
    /// Whether it is all of its cell.
    pub whole: bool,
}

/// Facets per batch: bounds the memory of polygons whatever the mesh.
const BATCH: u32 = 1 << 15;

/// Reads the dual of the session's present seeds (there are `seeds` of them).
pub fn extract(
    session: &mut dyn Session,
    surface: &Surface,
    seeds: usize,
    cancel: &CancelFlag,
) -> Result<Dual, RvdError> {
    let mut pieces = Pieces::default();
    let mut batch = PieceBatch::default();
    let mut stats = PassStats::default();
    let facets = surface.facets().len() as u32;
    for first in (0..facets).step_by(BATCH as usize) {
        stats.add(&session.pieces(first..facets.min(first + BATCH), &mut batch, cancel)?);
        pieces.take(&batch);
    }
    pieces.close(facets);
    cancel.check()?;
    let mut dual = pieces.join(surface, seeds);
    dual.stats = stats;
    Ok(dual)
}

/// What the dual needs of each piece, in facet order.
#[derive(Default)]
struct Pieces {
    facet: Vec<u32>,
    seed: Vec<u32>,
    area: Vec<f64>,
    /// ∫ p, unit frame.
    moment: Vec<DVec3>,
    /// Bit e: the piece reaches facet edge e.
    edges: Vec<u8>,
    /// First piece of each facet.
    first: Vec<u32>,
    /// (piece of the lowest seed, the other two seeds in order).
    vertices: Vec<(u32, [u32; 2])>,
}

impl Pieces {
    fn take(&mut self, batch: &PieceBatch) {
        for i in 0..batch.len() {
            let (facet, seed) = (batch.facet[i], batch.seed[i]);
            let piece = self.facet.len() as u32;
            self.first.resize(self.first.len().max(facet as usize + 1), piece);
            let range = batch.vertices(i);
            let (p, label) = (&batch.position[range.clone()], &batch.opposite[range]);
            let (mut area, mut moment) = (0.0, DVec3::ZERO);
            for k in 2..p.len() {
                let part = 0.5 * (p[k - 1] - p[0]).cross(p[k] - p[0]).length();
                area += part;
                moment += part / 3.0 * (p[0] + p[k - 1] + p[k]);
            }
            let mut edges = 0;
            for k in 0..label.len() {
                let (before, after) = (label[if k == 0 { label.len() - 1 } else { k - 1 }], label[k]);
                match (facet_edge(before), facet_edge(after)) {
                    (_, Some(e)) => edges |= 1 << e,
                    // Around the vertex, counter-clockwise: this cell, the one across the edge
                    // that arrives, the one across the edge that leaves.
                    (None, None) if before != after && seed < before && seed < after => {
                        self.vertices.push((piece, [before, after]));
                    }
                    _ => {}
                }
            }
            self.facet.push(facet);
            self.seed.push(seed);
            self.area.push(area);
            self.moment.push(moment);
            self.edges.push(edges);
        }
    }

    fn close(&mut self, facets: u32) {
        self.first.resize(facets as usize + 1, self.facet.len() as u32);
    }

    fn of_facet(&self, facet: u32) -> std::ops::Range<usize> {
        self.first[facet as usize] as usize..self.first[facet as usize + 1] as usize
    }

    /// The piece of `seed` in `facet`.
    fn find(&self, facet: u32, seed: u32) -> Option<u32> {
        let range = self.of_facet(facet);
        let start = range.start;
        self.seed[range].binary_search(&seed).ok().map(|k| (start + k) as u32)
    }

    /// Joins pieces of one cell across mesh edges, numbers the components, and names the triangles.
    fn join(&self, surface: &Surface, seeds: usize) -> Dual {
        let mut sets = DisjointSets::new(self.facet.len());
        for group in edge_groups(surface).chunk_by(|a, b| a.0 == b.0) {
            let [(_, first), rest @ ..] = group else { continue };
            let (f, e) = (first / 3, first % 3);
            for piece in self.of_facet(f).filter(|&p| self.edges[p] & (1 << e) != 0) {
                for (g, d) in rest.iter().map(|&(_, half)| (half / 3, half % 3)) {
                    if let Some(other) = self.find(g, self.seed[piece])
                        && self.edges[other as usize] & (1 << d) != 0
                    {
                        sets.join(piece, other as usize);
                    }
                }
            }
        }
        self.number(sets, seeds)
    }

    fn number(&self, mut sets: DisjointSets, seeds: usize) -> Dual {
        // A root is the lowest piece of its set, so (seed, root) orders by first facet.
        let mut sums = vec![(0.0, DVec3::ZERO); self.facet.len()];
        let mut components = Vec::new();
        for piece in 0..self.facet.len() {
            let root = sets.root(piece);
            if root == piece {
                components.push((self.seed[piece], root));
            }
            sums[root].0 += self.area[piece];
            sums[root].1 += self.moment[piece];
        }
        components.sort_unstable();
        let mut dual = Dual { area: self.area.iter().sum(), ..Dual::default() };
        let mut number = vec![u32::MAX; self.facet.len()];
        let mut largest: Vec<u32> = vec![u32::MAX; seeds];
        for (seed, root) in components {
            let (area, moment) = sums[root];
            let id = dual.components.len() as u32;
            number[root] = id;
            let best = &mut largest[seed as usize];
            let whole = *best == u32::MAX;
            if whole || dual.components[*best as usize].area < area {
                *best = id;
            }
            let centroid = if area > 0.0 { moment / area } else { DVec3::ZERO };
            dual.components.push(Component { seed, area, centroid, whole });
        }
        for pair in 1..dual.components.len() {
            if dual.components[pair].seed == dual.components[pair - 1].seed {
                dual.split_cells += usize::from(dual.components[pair - 1].whole);
                dual.components[pair - 1].whole = false;
                dual.components[pair].whole = false;
            }
        }
        dual.empty_cells = largest.iter().filter(|&&id| id == u32::MAX).count();
        for &(piece, others) in &self.vertices {
            let facet = self.facet[piece as usize];
            let corners = others.map(|seed| match self.find(facet, seed) {
                Some(p) => number[sets.root(p as usize)],
                None => {
                    dual.disputed += 1;
                    largest[seed as usize]
                }
            });
            let own = number[sets.root(piece as usize)];
            if corners.iter().all(|&c| c != u32::MAX) {
                dual.triangles.push([own, corners[0], corners[1]]);
            }
        }
        dual
    }
}

/// (edge, facet * 3 + local edge) of every facet with an area, sorted: halves of one edge side by side.
fn edge_groups(surface: &Surface) -> Vec<(u64, u32)> {
    let mut halves: Vec<(u64, u32)> = Vec::with_capacity(surface.welded().len() * 3);
    for (f, corners) in surface.welded().iter().enumerate().filter(|&(f, _)| !surface.skips(f)) {
        for e in 0..3 {
            let (a, b) = (corners[e], corners[(e + 1) % 3]);
            halves.push((u64::from(a.min(b)) << 32 | u64::from(a.max(b)), (f * 3 + e) as u32));
        }
    }
    halves.par_sort_unstable();
    halves
}
