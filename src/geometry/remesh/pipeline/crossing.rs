//! Facets of a result that cross each other.
//!
//! Purpose: [`Job::crossing`] finds them, [`shorten_near`] makes edges shorter there, and [`Job::divide_crossing`] divides their edges.
//! Invariant: nothing changes where no facets cross, and edges of curves stay. Must not know: how a result is made.

use std::collections::{BTreeSet, HashSet};

use super::extract::Built;
use super::job::Job;
use crate::mesh::TriMesh;
use crate::mesh::closest_point::ClosestPoint;
use crate::mesh::crossings::crossing_facets;
use crate::mesh::edges::{sides, undirected};
use crate::remesh::Result;
use crate::remesh::constants::{CROSSING_REACH, CROSSING_SHORTER, DIVIDING_ROUNDS, MOST_DIVIDED, MOST_DIVIDED_FOR_ALL};
use crate::remesh::manifold::LocalMesh;
use crate::remesh::triangle::longest_side;
use crate::rvd::RvdError;
use crate::tasks;
use crate::token::{Stopped, Token};

impl Job<'_, '_> {
    /// The facets of a result that cross others, its sheets in their places.
    pub(super) fn crossing(&self, result: &TriMesh) -> Result<Vec<u32>> {
        let Some(apart) = self.apart else { return Ok(crossing_facets(result, self.token)?) };
        let broken = |e| RvdError::Internal(format!("a surface was valid where its parts were apart: {e}"));
        Ok(crossing_facets(&apart.mesh_back(result, self.token)?.map_err(broken)?, self.token)?)
    }

    /// Puts vertices at places of the surface into the longest edges of the few facets that cross, as long as fewer do. If some are left,
    /// more vertices take away all of them, or none. Returns how many cross then.
    pub(super) fn divide_crossing(&self, built: &mut Built, mut crossing: Vec<u32>) -> Result<usize> {
        if crossing.is_empty() {
            return Ok(0);
        }
        let closest = ClosestPoint::unless(self.separated, self.token)?;
        let curves: HashSet<[u32; 2]> = built.curve_edges.iter().map(|&edge| undirected(edge)).collect();
        for (share, all) in [(MOST_DIVIDED, false), (MOST_DIVIDED_FOR_ALL, true)] {
            let most = (share * built.mesh.positions().len() as f64) as usize;
            let found = self.divided(&built.mesh, &crossing, most, (&curves, &closest))?;
            if let Some((mesh, left)) = found.filter(|(_, left)| left.is_empty() || !all) {
                let last = built.vertex_seed.last().copied().unwrap_or(0);
                built.vertex_seed.resize(mesh.positions().len(), last);
                (built.mesh, crossing) = (mesh, left);
            }
            if crossing.is_empty() {
                break;
            }
        }
        Ok(crossing.len())
    }

    /// A result with at most so many vertices more and the fewest facets that cross, and these; `None` if no fewer do.
    fn divided(
        &self,
        mesh: &TriMesh,
        crossing: &[u32],
        mut most: usize,
        (curves, closest): (&HashSet<[u32; 2]>, &ClosestPoint),
    ) -> Result<Option<(TriMesh, Vec<u32>)>> {
        let (mut now, mut crossing) = (mesh.clone(), crossing.to_vec());
        let mut fewest = crossing.len();
        let mut best = None;
        for _ in 0..DIVIDING_ROUNDS {
            let mut mesh = LocalMesh::new(now.positions().to_vec(), now.facets().to_vec(), curves.clone());
            let at = |v: u32| now.positions()[v as usize];
            let may_divide = |edge: &[u32; 2]| !mesh.is_curve(*edge) && mesh.beside(*edge).len() == 2;
            let length = |edge: &[u32; 2]| at(edge[0]).distance(at(edge[1]));
            let longest = |&f: &u32| {
                let sides = sides(now.facets()[f as usize]).map(undirected).into_iter();
                sides.filter(may_divide).max_by(|a, b| length(a).total_cmp(&length(b)).then(b.cmp(a)))
            };
            let edges: BTreeSet<[u32; 2]> = crossing.iter().filter_map(longest).collect();
            let mut edges: Vec<[u32; 2]> = edges.into_iter().collect();
            edges.sort_by(|a, b| length(b).total_cmp(&length(a)));
            edges.truncate(most);
            if edges.is_empty() {
                break;
            }
            most -= edges.len();
            for ends in edges {
                mesh.split(ends, closest.project(at(ends[0]).midpoint(at(ends[1]))).position);
            }
            let (positions, facets) = mesh.into_parts();
            // A place of the surface may be in the line of an edge beside it.
            let Ok(divided) = TriMesh::new(positions, facets) else { break };
            crossing = self.crossing(&divided)?;
            now = divided;
            if crossing.len() < fewest {
                fewest = crossing.len();
                best = Some((now.clone(), crossing.clone()));
            }
            if crossing.is_empty() {
                break;
            }
        }
        Ok(best)
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
    let near = tasks::map(mesh.positions().len(), |v| {
        let p = mesh.positions()[v];
        let there = closest.project(p);
        there.position.distance(p) < CROSSING_REACH * longest(there.facet)
    });
    token.check()?;
    lengths.iter_mut().zip(near).filter(|(_, near)| *near).for_each(|(length, _)| *length *= CROSSING_SHORTER);
    Ok(())
}
