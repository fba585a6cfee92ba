//! Parts of a surface whose edges have lengths of their own.
//!
//! Purpose: [`plan`] divides facets until each zone has vertices, gives these the lengths of the zone, and plans the density with them.
//! Invariant: the first vertices stay the caller's. Must not know: how lengths become weights.

use std::borrow::Cow;

use glam::DVec3;

use super::{Beside, Count, DensityError, DensityOptions, DensitySource, Plan, most_facets, refine, varying};
use crate::mesh::TriMesh;
use crate::mesh::parts::{Part, PartError, Zone};
use crate::token::Token;

/// Edges in a zone are divided until they are so many times its length; a zone has the vertices within the second share of it.
const DIVIDED: f64 = 1.0;
const NEAR: f64 = 0.6;
/// The ball around the middle of a facet's longest edge that holds the facet has this share of the edge as its radius.
const AROUND_EDGE: f64 = 0.87;

pub(super) fn plan<'a>(
    mesh: &'a TriMesh,
    options: &DensityOptions,
    count: Count,
    beside: Beside<'_>,
    token: &Token,
) -> Result<Plan<'a>, DensityError> {
    let before = |p: DVec3| beside.before.map_or(p, |before| before(p));
    let vertices = mesh.positions().len();
    let mut of_facets = vec![f64::NAN; vertices];
    for Zone { part, length } in &options.zones {
        match part {
            Part::Facets(facets) => {
                for &facet in facets {
                    let facets = mesh.facets().len();
                    let corners = mesh.facets().get(facet as usize).ok_or(PartError::NoSuchFacet { facet, facets })?;
                    corners.iter().for_each(|&v| of_facets[v as usize] = of_facets[v as usize].min(*length));
                }
            }
            Part::Region(name) => return Err(PartError::NoRegions { name: name.clone() }.into()),
            Part::Box { .. } | Part::Sphere { .. } => {}
        }
    }
    let is_wanted = |a: DVec3, b: DVec3| {
        let (edge, middle) = (a.distance(b), before(a.midpoint(b)));
        options
            .zones
            .iter()
            .any(|zone| edge > DIVIDED * zone.length && zone.part.distance(middle) <= AROUND_EDGE * edge)
    };
    let points = if let Count::Points(points) = count { points } else { options.max_points };
    // A number for each vertex that is linear in each facet comes along, and so does which vertices are of zones by facets.
    let most = most_facets(mesh, points);
    let divided = refine::resolve(mesh, &of_facets, is_wanted, most, token)?;
    let mut owned = options.clone();
    if let (Some(_), DensitySource::Sizes(sizes)) = (&divided, &mut owned.source)
        && sizes.len() == vertices
        && let Some((_, all)) = refine::resolve(mesh, sizes, is_wanted, most, token)?
    {
        *sizes = all;
    }
    let (fine, mut lengths) = match &divided {
        Some((fine, lengths)) => (fine, lengths.clone()),
        None => (mesh, of_facets),
    };
    for (length, &p) in lengths.iter_mut().zip(fine.positions()) {
        let place = before(p);
        let near = options.zones.iter().filter(|zone| zone.part.distance(place) <= NEAR * zone.length);
        *length = near.map(|zone| zone.length).fold(*length, f64::min);
    }
    let mut plan = varying(fine, &owned, count, (beside.lengths, &lengths), token)?;
    plan.sizes.iter_mut().for_each(|sizes| sizes.truncate(vertices));
    let mesh = match (divided.is_some(), plan.mesh) {
        // The plan's mesh is the one that was divided here, or made of it.
        (true, fine) => Cow::Owned(fine.into_owned()),
        (false, Cow::Owned(fine)) => Cow::Owned(fine),
        (false, Cow::Borrowed(_)) => Cow::Borrowed(mesh),
    };
    Ok(Plan { mesh, weights: plan.weights, sizes: plan.sizes, points: plan.points, figures: plan.figures })
}
