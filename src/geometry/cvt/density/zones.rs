//! Parts of a surface whose edges have lengths of their own.
//!
//! Purpose: [`plan`] divides facets until each zone has vertices, gives these the lengths of the zone, and plans the density with them.
//! Invariant: the first vertices stay the caller's. Must not know: how lengths become weights.

use std::borrow::Cow;

use glam::DVec3;

use super::outline::POINTS_PER_AREA;
use super::{Beside, Count, DensityError, DensityOptions, DensitySource, Plan, most_facets, refine, varying};
use crate::mesh::TriMesh;
use crate::mesh::parts::{Part, PartError, Zone};
use crate::token::Token;

/// Edges in a zone are divided until they are so many times its length; a zone has the vertices within the second share of it.
const DIVIDED: f64 = 2.0;
const NEAR: f64 = 1.2;
/// Facets are divided no more where zones need so many times the points that there are. Up to there what they need is found out.
const FAR_TOO_MANY: f64 = 16.0;
/// The ball around the middle of a facet's longest edge that holds the facet has this share of the edge as its radius.
const AROUND_EDGE: f64 = 0.87;

/// How many points the edges of zones need at least: those of facets that are in one wholly.
fn fewest_points(mesh: &TriMesh, zones: &[Zone], before: impl Fn(DVec3) -> DVec3) -> f64 {
    let of = |f: usize| {
        let corners = mesh.corners(f).map(&before);
        let within = zones.iter().filter(|zone| corners.iter().all(|&p| zone.part.distance(p) == 0.0));
        let length = within.map(|zone| zone.length).fold(f64::INFINITY, f64::min);
        let [a, b, c] = corners.map(|p| (p - corners[0]) / length);
        POINTS_PER_AREA * 0.5 * (b - a).cross(c - a).length()
    };
    (0..mesh.facets().len()).map(of).filter(|points| !points.is_nan()).sum()
}

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
                for facet in facets.iter() {
                    let facets = mesh.facets().len();
                    let corners = mesh.facets().get(facet as usize).ok_or(PartError::NoSuchFacet { facet, facets })?;
                    corners.iter().for_each(|&v| of_facets[v as usize] = of_facets[v as usize].min(*length));
                }
            }
            Part::Region(name) => return Err(PartError::NoRegions { name: name.clone() }.into()),
            Part::Vertices(_) => return Err(PartError::VerticesAlone.into()),
            Part::Box { .. } | Part::Sphere { .. } => {}
        }
    }
    let wanted = |least: f64| {
        move |a: DVec3, b: DVec3| {
            let (edge, middle) = (a.distance(b), before(a.midpoint(b)));
            let is_long = |zone: &&Zone| edge > DIVIDED * zone.length.max(least);
            options.zones.iter().filter(is_long).any(|zone| zone.part.distance(middle) <= AROUND_EDGE * edge)
        }
    };
    let points = if let Count::Points(points) = count { points } else { options.max_points };
    let most = most_facets(mesh, points);
    // Edges become shorter step by step, so that a length that needs too many points is refused before there are as many facets.
    let (low, high) = mesh.bounds();
    let mut least = (high - low).length();
    let shortest = options.zones.iter().map(|zone| zone.length).fold(f64::INFINITY, f64::min);
    // Lengths by vertex come along, and so does which vertices are of zones by facets.
    let mut owned = options.clone();
    let sizes = if let DensitySource::Sizes(sizes) = &mut owned.source { std::mem::take(sizes) } else { Vec::new() };
    if !sizes.is_empty() && sizes.len() != vertices {
        return Err(DensityError::SizeCount { given: sizes.len(), vertices });
    }
    let mut values = [of_facets, sizes];
    let mut divided: Option<TriMesh> = None;
    loop {
        let now = divided.as_ref().unwrap_or(mesh);
        let needed = fewest_points(now, &options.zones, before);
        match count {
            Count::Points(points) if needed > FAR_TOO_MANY * points as f64 => {
                return Err(DensityError::ZonesNeed { needed: needed as usize, points });
            }
            Count::Implied if needed > points as f64 => {
                return Err(DensityError::TooManyPoints { implied: needed, limit: points });
            }
            _ => {}
        }
        if least <= shortest {
            break;
        }
        least *= 0.5;
        if let Some((finer, of_finer)) = refine::resolve(now, &values, wanted(least), most, token)? {
            (divided, values) = (Some(finer), of_finer);
        }
    }
    let [mut lengths, of_sizes] = values;
    if let DensitySource::Sizes(sizes) = &mut owned.source {
        *sizes = of_sizes;
    }
    let fine = divided.as_ref().unwrap_or(mesh);
    for (length, &p) in lengths.iter_mut().zip(fine.positions()) {
        let place = before(p);
        let near = options.zones.iter().filter(|zone| zone.part.distance(place) <= NEAR * zone.length);
        *length = near.map(|zone| zone.length).fold(*length, f64::min);
    }
    let mut plan = varying(fine, &owned, count, (beside, &lengths), token)?;
    plan.sizes.iter_mut().for_each(|sizes| sizes.truncate(vertices));
    let mesh = match (divided.is_some(), plan.mesh) {
        // The plan's mesh is the one that was divided here, or made of it.
        (true, fine) => Cow::Owned(fine.into_owned()),
        (false, Cow::Owned(fine)) => Cow::Owned(fine),
        (false, Cow::Borrowed(_)) => Cow::Borrowed(mesh),
    };
    Ok(Plan { mesh, weights: plan.weights, sizes: plan.sizes, points: plan.points, figures: plan.figures })
}
