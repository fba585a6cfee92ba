//! The dual of the diagram: the restricted Delaunay triangulation (RDT).
//!
//! Purpose: triangles between cells that meet in a point of the surface, read from the symbolic
//! identities of the pieces' vertices (facet, two bisectors), never from coordinates.
//! Invariant: every connected component of a restricted cell is a vertex of its own (\[YBZW14\]),
//! so that no triangle joins two sheets; triangles are oriented as the facet they were found in.
//! Must not know: which backend made the pieces, what happens to the triangles.

mod conditions;
mod pieces;

use glam::DVec3;

use pieces::Pieces;

use super::{PassStats, PieceBatch, RvdError, Session, Surface};
use crate::token::Token;

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
    pub inconsistent: usize,
    /// Components that are not a disk: their surroundings may have another topology than the surface. Ascending.
    pub not_disks: Vec<u32>,
    /// Pairs of components that meet in more than one curve, ascending.
    pub multiple_edges: Vec<[u32; 2]>,
    /// Components that meet the boundary in more than one stretch, ascending.
    pub multiple_boundary_arcs: Vec<u32>,
    /// The pieces, in facet order.
    pub pieces: Vec<Piece>,
    /// Area of all pieces, unit frame.
    pub area: f64,
    /// Cells without any piece.
    pub empty_cells: usize,
    /// What the pass did.
    pub stats: PassStats,
}

/// Where a cell meets a facet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Piece {
    /// The part of a cell that it belongs to, in [`Dual::components`].
    pub component: u32,
    /// The facet.
    pub facet: u32,
    /// Bit c: corner c of the facet is in it.
    pub corners: u8,
    /// Its area, unit frame.
    pub area: f64,
    /// Its centroid, unit frame.
    pub centroid: DVec3,
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

/// Facets per batch: bounds the memory of polygons whatever the mesh, and the next batch finds it there.
const BATCH: u32 = 1 << 14;

/// Reads the dual of the session's present seeds (there are `seeds` of them).
pub(crate) fn extract(
    session: &mut dyn Session,
    surface: &Surface,
    seeds: usize,
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
        let (done, ()) = rayon::join(|| session.pieces(range, &mut next, token), || pieces.take(&made));
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
