//! Regions of the input on the result.
//!
//! Purpose: [`carry`] gives each facet of the result a region of the input. Borders of regions are curves, so the pieces of the result
//! between curves are votes of one region: each of their facets votes by the input nearest to it. Where a border was dropped, a piece
//! is of several regions, and its facets keep their own votes.
//! Invariant: regions keep their numbers and names, the lost ones too. Depends on the meshes and the curves alone. Must not know: how
//! curves came about, files.

use glam::DVec3;

use crate::mesh::closest_point::ClosestPoint;
use crate::mesh::edges::{DisjointSets, EdgeGroups, sides, undirected};
use crate::mesh::regions::{Region, Regions};
use crate::mesh::{TriMesh, normal};
use crate::remesh::constants::ONE_REGION_SHARE;
use crate::remesh::report::RegionFigures;
use crate::tasks;
use crate::token::{Stopped, Token};

/// Points of a facet that vote.
const VOTERS: [[f64; 3]; 4] = [
    [1.0 / 3.0; 3],
    [2.0 / 3.0, 1.0 / 6.0, 1.0 / 6.0],
    [1.0 / 6.0, 2.0 / 3.0, 1.0 / 6.0],
    [1.0 / 6.0, 1.0 / 6.0, 2.0 / 3.0],
];

/// The region of each facet of `result`, which is the index of one of `regions` of `mesh`. `closest` answers for `mesh`, and
/// `curve_edges` are the edges of the result that lie on curves.
pub(crate) fn carry(
    (mesh, regions): (&TriMesh, &Regions),
    closest: &ClosestPoint,
    (result, curve_edges): (&TriMesh, &[[u32; 2]]),
    token: &Token,
) -> Result<Vec<u32>, Stopped> {
    let votes = |(): &mut (), f: usize| -> Result<[u32; 4], Stopped> {
        token.check_at(f)?;
        let corners = result.corners(f);
        let facing = normal(corners);
        let own: [(u32, bool); 4] = VOTERS.map(|weights| {
            let p: DVec3 = corners.iter().zip(weights).map(|(&corner, weight)| corner * weight).sum();
            let facet = closest.project(p).facet as usize;
            (regions.of_facet()[facet], normal(mesh.corners(facet)).dot(facing) >= 0.0)
        });
        // What faces away is the other skin of a thin wall.
        let known = own.iter().find(|vote| vote.1).map_or(own[0].0, |vote| vote.0);
        Ok(own.map(|(region, faces)| if faces { region } else { known }))
    };
    let votes = tasks::try_map(result.facets().len(), || (), votes)?;
    let mut curves: Vec<[u32; 2]> = curve_edges.iter().copied().map(undirected).collect();
    curves.sort_unstable();
    let mut pieces = DisjointSets::new(result.facets().len());
    let facets = result.facets().iter().copied().enumerate();
    EdgeGroups::unless(result.positions().len(), facets, token)?.for_each(|_, halves| {
        let half = halves[0];
        let edge = undirected(sides(result.facets()[half.facet as usize])[half.side]);
        if curves.binary_search(&edge).is_err() {
            halves.windows(2).for_each(|pair| pieces.join(pair[0].facet as usize, pair[1].facet as usize));
        }
    });
    let area: Vec<f64> = (0..result.facets().len()).map(|f| 0.5 * normal(result.corners(f)).length()).collect();
    let mut ballots: Vec<(u32, u32, f64)> = Vec::with_capacity(votes.len());
    for (f, regions) in votes.iter().enumerate() {
        let piece = pieces.root(f) as u32;
        // Nearly all facets vote for one region.
        let alike = regions.chunk_by(|a, b| a == b);
        ballots.extend(alike.map(|same| (piece, same[0], 0.25 * same.len() as f64 * area[f])));
    }
    ballots.sort_by_key(|&(piece, region, _)| (piece, region));
    let mut of_piece = vec![None; result.facets().len()];
    for piece in ballots.chunk_by(|a, b| a.0 == b.0) {
        let sums =
            piece.chunk_by(|a, b| a.1 == b.1).map(|same| (same[0].1, same.iter().map(|vote| vote.2).sum::<f64>()));
        let (mut total, mut most) = (0.0, (0, f64::NEG_INFINITY));
        for (region, sum) in sums {
            total += sum;
            if sum > most.1 {
                most = (region, sum);
            }
        }
        of_piece[piece[0].0 as usize] = (most.1 >= ONE_REGION_SHARE * total).then_some(most.0);
    }
    let own = |votes: &[u32; 4]| {
        let count = |region: u32| votes.iter().filter(|&&vote| vote == region).count();
        votes.iter().copied().rev().max_by_key(|&region| count(region)).unwrap_or(votes[0])
    };
    Ok((0..votes.len()).map(|f| of_piece[pieces.root(f)].unwrap_or_else(|| own(&votes[f]))).collect())
}

/// What the report says: the area of each region, in the input and in the result.
pub(crate) fn figures(regions: &Regions, mesh: &TriMesh, (result, of_facet): (&TriMesh, &[u32])) -> Vec<RegionFigures> {
    let areas = |mesh: &TriMesh, of_facet: &[u32]| {
        let mut areas = vec![(0, 0.0); regions.all().len()];
        for (f, &region) in of_facet.iter().enumerate() {
            let (facets, area): &mut (usize, f64) = &mut areas[region as usize];
            (*facets, *area) = (*facets + 1, *area + 0.5 * normal(mesh.corners(f)).length());
        }
        areas
    };
    let (before, after) = (areas(mesh, regions.of_facet()), areas(result, of_facet));
    let of = |(k, region): (usize, &Region)| RegionFigures {
        number: region.number,
        name: region.name.clone(),
        input_area: before[k].1,
        facets: after[k].0,
        area: after[k].1,
    };
    // A region without area has no facet to lose.
    regions.all().iter().enumerate().map(of).filter(|figures| figures.input_area > 0.0).collect()
}
