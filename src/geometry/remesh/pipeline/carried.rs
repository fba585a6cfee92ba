//! The input's attributes on a result.
//!
//! Purpose: [`carry`] interpolates them where the result's vertices lie on the input, and gives facets their regions.
//! Invariant: none are made up; without attributes nothing is looked for. Must not know: how a result is made.

use super::job::Job;
use crate::mesh::TriMesh;
use crate::mesh::attributes::Attributes;
use crate::mesh::closest_point::ClosestPoint;
use crate::remesh::attributes::{self, Provenance};
use crate::remesh::report::RegionFigures;
use crate::remesh::{RemeshError, RemeshOptions, Result};
use crate::token::Token;

/// What the result has of the input's attributes.
#[derive(Default)]
pub(super) struct Carried {
    pub(super) attributes: Option<Attributes>,
    /// Where its vertices lie on the input.
    pub(super) provenance: Vec<Provenance>,
    pub(super) regions: Vec<RegionFigures>,
}

/// The input's attributes on the result, if there are any.
pub(super) fn transfer(
    job: &mut Job<'_, '_>,
    given: &TriMesh,
    options: &RemeshOptions,
    (result, curve_edges): (&TriMesh, &[[u32; 2]]),
) -> Result<Carried, RemeshError> {
    if options.attributes.is_some() {
        job.enter("attributes");
    }
    carry(given, options.attributes.as_ref(), (result, curve_edges), job.token)
}

/// `attributes` of `given` on the result, if there are any.
pub(super) fn carry(
    given: &TriMesh,
    attributes: Option<&Attributes>,
    (result, curve_edges): (&TriMesh, &[[u32; 2]]),
    token: &Token,
) -> Result<Carried> {
    let Some(attributes) = attributes else { return Ok(Carried::default()) };
    let closest = ClosestPoint::unless(given, token)?;
    let provenance = attributes::provenance(&closest, result.positions(), token)?;
    token.check()?;
    let mut carried = attributes::carry(given, attributes, &closest, result, &provenance)?;
    let mut figures = Vec::new();
    if let Some(regions) = attributes.regions() {
        let of_facet = attributes::regions::carry((given, regions), &closest, (result, curve_edges), token)?;
        figures = attributes::regions::figures(regions, given, (result, &of_facet));
        carried.set_regions(regions.with_facets(of_facet))?;
    }
    Ok(Carried { attributes: Some(carried), provenance, regions: figures })
}
