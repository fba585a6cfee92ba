//! The input without what would tear a result.
//!
//! Purpose: corners that are nearly in one place are put there, facets that are there twice are left out, and such as are oriented
//! unlike their neighbours turned over, in this order, since each shows what the next has to do.
//! Invariant: vertices keep their numbers; what was done is counted. Must not know: density, seeds.

use super::report::InputFigures;
use crate::mesh::adjacency::Adjacency;
use crate::mesh::{TriMesh, layers, orient, stitch};
use crate::token::{Stopped, Token};

/// What came in, and the same without what would tear a result, if there is any of it: corners that are nearly in one place,
/// facets that are there twice, and facets that are oriented unlike their neighbours.
pub(super) fn without_tears(mesh: &TriMesh, token: &Token) -> Result<(InputFigures, Option<TriMesh>), Stopped> {
    let adjacency = Adjacency::new(mesh);
    token.check()?;
    let (mut figures, mut whole) = match stitch::rims(mesh, &adjacency, token)? {
        Some((stitched, moved)) => {
            (InputFigures { stitched_vertices: moved, ..InputFigures::of(&stitched, token)? }, Some(stitched))
        }
        None => (InputFigures::with(mesh, &adjacency, token)?, None),
    };
    token.check()?;
    if figures.inconsistent_edges + figures.topology.non_manifold_edges > 0
        && let Some((single, spare)) = layers::single(whole.as_ref().unwrap_or(mesh), token)?
    {
        let stitched_vertices = figures.stitched_vertices;
        figures = InputFigures { stitched_vertices, spare_facets: spare, ..InputFigures::of(&single, token)? };
        whole = Some(single);
    }
    token.check()?;
    if figures.inconsistent_edges > 0
        && let Some((alike, turned)) = orient::alike(whole.as_ref().unwrap_or(mesh), token)?
    {
        figures.turned_facets = turned;
        whole = Some(alike);
    }
    Ok((figures, whole))
}
