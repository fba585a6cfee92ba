//! Results whose facets cross each other.
//!
//! Purpose: chords leave a bent sheet by more than another sheet is away, and their facets cross. [`Job::uncross`] remeshes again with
//! shorter edges there, as long as fewer cross.
//! Invariant: of the results that lose no more curves, the one with the fewest crossing facets comes back. Where the input itself has some,
//! nothing changes.
//! Must not know: how a result is made.

use rayon::prelude::*;

use super::Job;
use super::prepare::with_source;
use super::tolerance::Attempt;
use crate::cvt::density::DensitySource;
use crate::mesh::TriMesh;
use crate::mesh::closest_point::ClosestPoint;
use crate::mesh::crossings::crossing_facets;
use crate::remesh::constants::{CROSSING_REACH, CROSSING_SHORTER, MAX_CROSSING_ROUNDS, THIN_LONGEST};
use crate::remesh::triangle::longest_side;
use crate::remesh::{RemeshOptions, Result};
use crate::rvd::RvdError;
use crate::token::{Stopped, Token};

impl<'a> Job<'a, '_> {
    /// The facets of a result that cross others, its sheets in their places.
    pub(super) fn crossing(&self, result: &TriMesh) -> Result<Vec<u32>> {
        let Some(apart) = self.apart else { return Ok(crossing_facets(result, self.token)?) };
        let broken = |e| RvdError::Internal(format!("a surface was valid where its parts were apart: {e}"));
        Ok(crossing_facets(&apart.mesh_back(result, self.token)?.map_err(broken)?, self.token)?)
    }

    /// A result in place of `best` with fewer crossing facets, if there is one, and how many it has. `None` if some cross and the surface
    /// is `divisible`: divided, it has room for its cells.
    pub(super) fn uncross(
        &mut self,
        mut best: Attempt<'a>,
        (divisible, is_divided): (bool, bool),
        options: &RemeshOptions,
    ) -> Result<Option<(Attempt<'a>, usize)>> {
        let mut crossing = self.crossing(&best.built.mesh)?;
        if crossing.is_empty() || !crossing_facets(self.clean, self.token)?.is_empty() {
            return Ok(Some((best, crossing.len())));
        }
        if divisible {
            return Ok(None);
        }
        self.may_divide = false;
        let mut fewest = crossing.len();
        let mut lengths = best.plan.lengths(self.separated, self.token)?;
        shorten_near(&mut lengths, self.separated, (&best.built.mesh, &crossing), self.token)?;
        for _ in 0..MAX_CROSSING_ROUNDS {
            let options = with_source(options, DensitySource::Sizes(lengths));
            let Some(prepared) = self.prepare_again(&options, None)? else { break };
            let median = best.plan.figures.edge_median.zip(prepared.plan.figures.edge_median);
            if median.is_some_and(|(before, now)| now > THIN_LONGEST * before) {
                break;
            }
            let Ok(mut next) = self.attempt(prepared, &options, None) else { break };
            crossing = self.crossing(&next.built.mesh)?;
            lengths = next.plan.lengths(self.separated, self.token)?;
            shorten_near(&mut lengths, self.separated, (&next.built.mesh, &crossing), self.token)?;
            if !next.is_whole || crossing.len() >= fewest || next.lost_curves() > best.lost_curves() {
                best.figures.refine.evaluations += next.figures.passes();
                // Of a bent wall, edges may have to be shorter still.
                if is_divided && next.is_whole {
                    continue;
                }
                break;
            }
            fewest = crossing.len();
            next.plan.figures.source = best.plan.figures.source;
            next.figures.refine.evaluations += best.figures.passes();
            best = next;
            if fewest == 0 {
                break;
            }
        }
        self.token.check()?;
        Ok(Some((best, fewest)))
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
