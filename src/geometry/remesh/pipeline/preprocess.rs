//! Preprocessing of the input.
//!
//! Purpose: [`preprocess`] stitches boundary vertices that nearly coincide, leaves out duplicate facets, then makes
//! orientations consistent. The order matters: each step exposes the defects of the next.
//! Invariant: vertices keep their numbers; every change is counted. Must not know: density, seeds.

use crate::mesh::adjacency::Adjacency;
use crate::mesh::input::{make_consistent, stitch_boundaries};
use crate::mesh::{TriMesh, duplicates};
use crate::remesh::report::InputFigures;
use crate::token::{Stopped, Token};

/// The figures of the input, and the changed surface if anything had to be changed.
pub(super) fn preprocess(given: &TriMesh, token: &Token) -> Result<(InputFigures, Option<TriMesh>), Stopped> {
    let adjacency = Adjacency::new(given);
    token.check()?;
    let (mut figures, mut changed) = match stitch_boundaries(given, &adjacency, token)? {
        Some((stitched, moved)) => {
            (InputFigures { stitched_vertices: moved, ..InputFigures::of(&stitched, token)? }, Some(stitched))
        }
        None => (InputFigures::with(given, &adjacency, token)?, None),
    };
    token.check()?;
    if figures.inconsistent_edges + figures.topology.non_manifold_edges > 0
        && let Some((single, spare)) = duplicates::remove(changed.as_ref().unwrap_or(given), token)?
    {
        let stitched_vertices = figures.stitched_vertices;
        figures = InputFigures { stitched_vertices, coincident_facets: spare, ..InputFigures::of(&single, token)? };
        changed = Some(single);
    }
    token.check()?;
    if figures.inconsistent_edges > 0
        && let Some((consistent, flipped)) = make_consistent(changed.as_ref().unwrap_or(given), token)?
    {
        figures.reoriented_facets = flipped;
        changed = Some(consistent);
    }
    Ok((figures, changed))
}
