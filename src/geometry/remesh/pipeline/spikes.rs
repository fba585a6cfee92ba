//! Spikes of the input.
//!
//! Purpose: points spread evenly over a surface with a spike that is far longer than the rest is wide all lie on the spike.
//! Such a surface is remeshed with its far vertices drawn in; [`put_back`] moves the result to where they were.
//! Invariant: only positions change. A vertex beside a spike keeps its barycentric coordinates; the vertex nearest to a far
//! one goes there. Must not know: how the result was made.

use glam::DVec3;

use super::compare;
use crate::mesh::TriMesh;
use crate::mesh::closest_point::{ClosestPoint, SurfacePoint};
use crate::mesh::input::outliers;
use crate::remesh::{Remesh, RemeshError};
use crate::rvd::RvdError;
use crate::token::Token;

/// Makes the result of `near`, which is `given` with its far vertices drawn in, one of `given`.
pub(super) fn put_back(done: &mut Remesh, given: &TriMesh, near: &TriMesh, token: &Token) -> Result<(), RemeshError> {
    let far = outliers(given);
    let closest = ClosestPoint::new(near);
    let back = |p: DVec3, SurfacePoint { position, facet, barycentric }: SurfacePoint| {
        let corners = given.facets()[facet as usize];
        if !corners.iter().any(|v| far.binary_search(v).is_ok()) {
            return p;
        }
        let place: DVec3 = (0..3).map(|k| given.positions()[corners[k] as usize] * barycentric[k]).sum();
        place + (p - position)
    };
    let mut places = done.mesh.positions().to_vec();
    let near_places = closest.project_all(&places, token)?;
    for &v in &far {
        token.check()?;
        let apart = |p: &DVec3| p.distance_squared(near.positions()[v as usize]);
        let nearest = (0..places.len())
            .min_by(|&a, &b| apart(&done.mesh.positions()[a]).total_cmp(&apart(&done.mesh.positions()[b])));
        nearest.into_iter().for_each(|k| places[k] = given.positions()[v as usize]);
    }
    for ((place, &was), point) in places.iter_mut().zip(done.mesh.positions()).zip(near_places) {
        if *place == was {
            *place = back(was, point);
        }
    }
    // Only one thing can be wrong with it: beside very long spikes no facet has an area.
    done.mesh = TriMesh::new(places, done.mesh.facets().to_vec()).map_err(|_| RvdError::NoArea)?;
    let near_seeds = closest.project_all(&done.seeds, token)?;
    done.seeds.iter_mut().zip(near_seeds).for_each(|(seed, point)| *seed = back(*seed, point));
    let report = &mut done.report;
    (report.input.area, report.input.outlier_vertices) = (given.area(), far.len());
    if report.result.quality.is_some() {
        (report.result.quality, report.result.lost) = Some(compare(given, None, &done.mesh, token)?).unzip();
    }
    Ok(())
}
