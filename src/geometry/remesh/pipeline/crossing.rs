//! Facets of a result that cross each other.
//!
//! Purpose: [`Job::crossing`] finds them, and [`shorten_near`] makes edges shorter there.
//! Invariant: nothing changes where no facets cross. Must not know: how a result is made.

use rayon::prelude::*;

use super::Job;
use crate::mesh::TriMesh;
use crate::mesh::closest_point::ClosestPoint;
use crate::mesh::crossings::crossing_facets;
use crate::remesh::Result;
use crate::remesh::constants::{CROSSING_REACH, CROSSING_SHORTER};
use crate::remesh::triangle::longest_side;
use crate::rvd::RvdError;
use crate::token::{Stopped, Token};

impl Job<'_, '_> {
    /// The facets of a result that cross others, its sheets in their places.
    pub(super) fn crossing(&self, result: &TriMesh) -> Result<Vec<u32>> {
        let Some(apart) = self.apart else { return Ok(crossing_facets(result, self.token)?) };
        let broken = |e| RvdError::Internal(format!("a surface was valid where its parts were apart: {e}"));
        Ok(crossing_facets(&apart.mesh_back(result, self.token)?.map_err(broken)?, self.token)?)
    }
}

/// Makes the lengths, one a vertex of `mesh`, shorter near the facets of a result that cross others.
pub(super) fn shorten_near(
    lengths: &mut [f64],
    mesh: &TriMesh,
    (result, crossing): (&TriMesh, &[u32]),
    token: &Token,
) -> std::result::Result<(), Stopped> {
    let facets: Vec<[u32; 3]> = crossing.iter().map(|&f| result.facets()[f as usize]).collect();
    // Facets without an area do not cross others.
    let Ok(crossing) = TriMesh::new(result.positions().to_vec(), facets) else { return Ok(()) };
    let closest = ClosestPoint::unless(&crossing, token)?;
    let longest = |f: u32| longest_side(crossing.corners(f as usize));
    let near: Vec<bool> = mesh
        .positions()
        .par_iter()
        .map(|&p| {
            let there = closest.project(p);
            there.position.distance(p) < CROSSING_REACH * longest(there.facet)
        })
        .collect();
    token.check()?;
    lengths.iter_mut().zip(near).filter(|(_, near)| *near).for_each(|(length, _)| *length *= CROSSING_SHORTER);
    Ok(())
}
