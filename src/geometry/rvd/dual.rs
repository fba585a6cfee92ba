//! The dual of the diagram: the restricted Delaunay triangulation (RDT).
//!
//! Purpose: triangles between cells that meet in a point of the surface, read from the symbolic identities of the pieces'
//! vertices (facet, two bisectors), never from coordinates; and what keeps the dual from the topology of the surface. The two are
//! homeomorphic if every component of a restricted cell is a disk that meets the boundary in at most one stretch, and two of them
//! meet in at most one curve (the closed ball property, Edelsbrunner and Shah 1997); where that fails, more seeds are the cure.
//! Invariant: every connected component of a restricted cell is a vertex of its own (\[YBZW14\]), so that no triangle joins two
//! sheets; triangles are oriented as the facet they were found in. A mesh line meets a convex cell in one segment, so a component
//! with F pieces, E mesh edges between two of its pieces and V mesh vertices inside has χ = F - E + V, and is a disk if that is 1.
//! Must not know: which backend made the pieces, what happens to the triangles.

mod pieces;

use glam::DVec3;
use rayon::prelude::*;

use super::{PassStats, PieceBatch, RvdError, Session, Surface};
use crate::knn::Point;
use crate::mesh::edges::DisjointSets;
use crate::token::Token;
use pieces::Pieces;

/// A triangulation whose vertices are components of restricted cells.
#[derive(Clone, Debug, Default)]
pub struct Dual {
    /// Three components a triangle.
    pub triangles: Vec<[u32; 3]>,
    /// The components, ordered by seed and then by first facet.
    pub components: Vec<Component>,
    pub split_cells: usize,
    /// RVD vertices whose three cells disagree. Their triangles go to the largest component of the cell that does not know.
    pub inconsistent: usize,
    /// Components that are not a disk: their surroundings may have another topology than the surface. Ascending.
    pub not_disks: Vec<u32>,
    /// Pairs of components that meet in more than one curve, ascending.
    pub multiple_edges: Vec<[u32; 2]>,
    /// Components that meet the boundary in more than one stretch, ascending.
    pub multiple_boundary_arcs: Vec<u32>,
    /// Components that meet the boundary, ascending.
    pub at_boundary: Vec<u32>,
    /// The pieces, in facet order.
    pub pieces: Vec<Piece>,
    pub area: f64,
    pub empty_cells: usize,
    pub stats: PassStats,
}

/// Where a cell meets a facet, unit frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Piece {
    /// The part of a cell that it belongs to, in [`Dual::components`].
    pub component: u32,
    pub facet: u32,
    /// Bit c: corner c of the facet is in it.
    pub corners: u8,
    pub area: f64,
    pub centroid: DVec3,
}

/// One connected part of a restricted cell, unit frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Component {
    pub seed: u32,
    pub area: f64,
    /// For density 1.
    pub centroid: DVec3,
    /// Whether it is all of its cell.
    pub whole: bool,
}

/// Facets per batch: bounds the memory of polygons whatever the mesh, and the next batch finds it there.
const BATCH: u32 = 1 << 14;

/// Reads the dual of the session's present seeds (there are `seeds` of them). The session may have further points behind these;
/// `owners` says of which seed each is, and its cell is part of that seed's.
pub(crate) fn extract<P: Point>(
    session: &mut dyn Session<P>,
    surface: &Surface,
    (seeds, owners): (usize, &[u32]),
    token: &Token,
) -> Result<Dual, RvdError> {
    let mut pieces = Pieces::default();
    let mut stats = PassStats::default();
    let facets = surface.facets().len() as u32;
    // While one batch is taken in the next is made.
    let (mut made, mut next) = (PieceBatch::default(), PieceBatch::default());
    for first in (0..facets).step_by(BATCH as usize) {
        token.check()?;
        let range = first..facets.min(first + BATCH);
        let owned = |next: &mut PieceBatch| {
            let done = session.pieces(range, next, token)?;
            next.own(seeds as u32, owners);
            Ok::<_, RvdError>(done)
        };
        let (done, ()) = rayon::join(|| owned(&mut next), || pieces.take(&made));
        stats.add(&done?);
        std::mem::swap(&mut made, &mut next);
    }
    // As one task of the pool, so that its threads are awake at each part.
    let mut dual = rayon::scope(|_| {
        pieces.take(&made);
        pieces.close(facets);
        pieces.join(surface, seeds, token)
    })?;
    token.check()?;
    dual.stats = stats;
    Ok(dual)
}

/// A stretch of the curve in which two cells meet, within one facet: the pieces on its two sides.
pub(super) type Stretch = [u32; 2];

/// Where such a curve crosses a mesh edge: (edge, seeds in order) -> stretch.
pub(super) type Crossing = ((u32, [u32; 2]), u32);

/// `pieces` has the component of each piece, `joints` of each mesh edge between two, `inner` of each mesh vertex inside.
pub(super) fn not_disks(components: usize, pieces: &[u32], joints: &[u32], inner: &[u32]) -> Vec<u32> {
    let mut chi = vec![0i64; components];
    pieces.iter().for_each(|&c| chi[c as usize] += 1);
    joints.iter().for_each(|&c| chi[c as usize] -= 1);
    inner.iter().for_each(|&c| chi[c as usize] += 1);
    numbers(chi, |&chi| chi != 1)
}

/// `ends` has the component of every end of a stretch of boundary.
pub(super) fn multiple_boundary_arcs(components: usize, ends: impl Iterator<Item = u32>) -> Vec<u32> {
    let mut count = vec![0u32; components];
    ends.for_each(|c| count[c as usize] += 1);
    numbers(count, |&ends| ends > 2)
}

fn numbers<T>(of: Vec<T>, is_so: impl Fn(&T) -> bool) -> Vec<u32> {
    (0..).zip(of).filter(|(_, value)| is_so(value)).map(|(number, _)| number).collect()
}

pub(super) fn multiple_edges(stretches: &[Stretch], mut crossings: Vec<Crossing>, component: &[u32]) -> Vec<[u32; 2]> {
    let mut curves = DisjointSets::new(stretches.len());
    crossings.par_sort_unstable();
    for here in crossings.chunk_by(|a, b| a.0 == b.0) {
        here.windows(2).for_each(|pair| curves.join(pair[0].1 as usize, pair[1].1 as usize));
    }
    let mut pairs: Vec<[u32; 2]> = (0..stretches.len())
        .filter(|&s| curves.root(s) == s)
        .map(|s| {
            let [a, b] = stretches[s].map(|piece| component[piece as usize]);
            [a.min(b), a.max(b)]
        })
        .collect();
    pairs.sort_unstable();
    pairs.chunk_by(|a, b| a == b).filter(|same| same.len() > 1).map(|same| same[0]).collect()
}
