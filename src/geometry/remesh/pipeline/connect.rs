//! Boundaries that nearly meet, connected.
//!
//! Purpose: [`Connected::of`] moves boundary vertices that nearly coincide to one place, then divides boundary edges at vertices on
//! them. [`gaps`] counts the boundary edges that stay open beside others, and finds the distance that joins them.
//! Invariant: vertices keep their numbers, and facets their sides; what is found depends on the surface and the distance alone. Must
//! not know: other defects of a surface, options.

use crate::mesh::TriMesh;
use crate::mesh::adjacency::Adjacency;
use crate::mesh::hanging::{self, Divided, DividedEdges};
use crate::mesh::input::{InputFigures, Reach, stitch_boundaries};
use crate::remesh::constants::{MOST_GAP_DIAGONAL, WELD_GROWTH, WELD_STEPS, WELD_STEPS_IN_VAIN};
use crate::token::{Stopped, Token};

/// A surface whose boundaries are connected where they meet.
pub(super) struct Connected {
    /// If anything had to be changed.
    pub(super) mesh: Option<TriMesh>,
    pub(super) adjacency: Adjacency,
    pub(super) stitched_vertices: usize,
    /// For each facet the one that it is of, and the edges that were divided, if any were.
    pub(super) divided: Option<(Vec<u32>, DividedEdges)>,
}

impl Connected {
    /// `weld`: how far boundaries may be apart that are joined, caller's units.
    pub(super) fn of(given: &TriMesh, weld: Option<f64>, token: &Token) -> Result<Self, Stopped> {
        let adjacency = Adjacency::unless(given, token)?;
        let reach = Reach::of(given, weld);
        let mut all = Self { mesh: None, adjacency, stitched_vertices: 0, divided: None };
        if let Some((stitched, moved)) = stitch_boundaries(given, &all.adjacency, reach, token)? {
            all.adjacency = Adjacency::unless(&stitched, token)?;
            (all.mesh, all.stitched_vertices) = (Some(stitched), moved);
        }
        token.check()?;
        if all.adjacency.boundary_edges > 0
            && let Some(found) =
                hanging::divide(all.mesh.as_ref().unwrap_or(given), &all.adjacency, reach.distance, token)?
        {
            let Divided { mesh, origin, edges, .. } = found;
            all.adjacency = Adjacency::unless(&mesh, token)?;
            (all.mesh, all.divided) = (Some(mesh), Some((origin, edges)));
        }
        token.check()?;
        Ok(all)
    }
}

/// Sets the figures of the gaps that are left in `clean`. `given`: the surface before it was connected.
pub(super) fn gaps(
    (given, clean): (&TriMesh, &TriMesh),
    adjacency: &Adjacency,
    figures: &mut InputFigures,
    token: &Token,
) -> Result<(), Stopped> {
    let (low, high) = clean.bounds();
    let most = MOST_GAP_DIAGONAL * (high - low).length();
    let open = hanging::gaps(clean, adjacency, most, token)?;
    (figures.gap_edges, figures.gap_distance) = (open.edges, open.distance);
    if open.edges == 0 {
        return Ok(());
    }
    let (mut fewest, mut in_vain) = (open.edges, 0);
    let mut weld = open.distance;
    for _ in 0..WELD_STEPS {
        let tried = rounded_up(weld);
        let Connected { mesh, adjacency, .. } = Connected::of(given, Some(tried), token)?;
        let left = hanging::gaps(mesh.as_ref().unwrap_or(given), &adjacency, most, token)?.edges;
        if left < fewest {
            (fewest, in_vain) = (left, 0);
            (figures.gap_weld, figures.gap_edges_left) = (tried, left);
        } else {
            in_vain += 1;
        }
        if left == 0 || in_vain == WELD_STEPS_IN_VAIN {
            break;
        }
        weld *= WELD_GROWTH;
    }
    Ok(())
}

/// The least number of three digits that is no less.
fn rounded_up(distance: f64) -> f64 {
    let step = 10f64.powf(distance.log10().floor() - 2.0);
    // As it is printed, so that the caller gives the number that was tried.
    let printed = format!("{:.2e}", (distance / step).ceil() * step);
    printed.parse().unwrap_or(distance)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_named_distance_is_no_less_and_has_three_digits() {
        for (distance, named) in [(1.0, 1.0), (1.001, 1.01), (9.991, 10.0), (2.3456e-7, 2.35e-7), (4.0e12, 4e12)] {
            assert_eq!(rounded_up(distance), named);
        }
    }
}
