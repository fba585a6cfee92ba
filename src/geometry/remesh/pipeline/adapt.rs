//! The adaptation of a result to a metric.
//!
//! Purpose: [`adapt`] hands a result with the metric of the input to [`metric::adapt`], in the unit frame, and measures what comes
//! back. Invariant: corners of curves stay where they are. Must not know: how edges get their lengths.

use super::extract::Built;
use crate::mesh::TriMesh;
use crate::mesh::metric::{MetricField, MetricFigures};
use crate::mesh::tensor::Tensor;
use crate::remesh::features::KeptCurves;
use crate::remesh::metric::{self, Draft, Wanted};
use crate::remesh::report::AdaptedFigures;
use crate::remesh::{RemeshError, Result};
use crate::rvd::{RvdError, Surface};
use crate::token::Token;

/// The result with unit edges in the metric of `input`, which has a tensor for each vertex. With a number of vertices, the metric is
/// scaled for it.
pub(super) fn adapt(
    built: Built,
    (input, tensors): (&TriMesh, &[Tensor]),
    (surface, curves): (&Surface, &KeptCurves),
    wanted: Wanted,
    token: &Token,
) -> Result<Built> {
    let frame = surface.frame();
    let unit = |p: glam::DVec3| if p.is_finite() { frame.to_unit(p) } else { glam::DVec3::ZERO };
    let broken = |e| RvdError::Internal(format!("a surface was valid before: {e}"));
    let places = input.positions().iter().map(|&p| unit(p)).collect();
    let mut field = MetricField::new(&TriMesh::new(places, input.facets().to_vec()).map_err(broken)?, tensors, token)?;
    // A length of the unit frame is so many times the caller's.
    field.scale(frame.scale.recip());
    let (lines, stretches) = curves.stretches(surface, &built.segments, &built.vertex_seed);
    let mut on_curve = vec![false; built.vertex_seed.len()];
    stretches.iter().flat_map(|(edge, _)| edge).for_each(|&v| on_curve[v as usize] = true);
    let is_fixed = |(v, &seed): (usize, &u32)| curves.is_corner(seed) || curves.has_seed(seed) && !on_curve[v];
    let fixed: Vec<bool> = built.vertex_seed.iter().enumerate().map(is_fixed).collect();
    let Built { mesh, segments, repair, missed, .. } = built;
    let (places, facets) = mesh.into_parts();
    let positions = places.iter().map(|&p| unit(p)).collect();
    let adapted = metric::adapt(Draft { positions, facets, fixed, lines, stretches }, &mut field, wanted, token)?;
    // A fixed vertex has its own bits.
    let place = |(p, from): (&glam::DVec3, &Option<u32>)| from.map_or(frame.to_world(*p), |v| places[v as usize]);
    let world = adapted.positions.iter().zip(&adapted.fixed).map(place).collect();
    let unit_mesh = TriMesh::new(adapted.positions, adapted.facets).map_err(|_| RemeshError::too_few(places.len()))?;
    let figures = MetricFigures::of(&field, &unit_mesh, token)?;
    let mesh = TriMesh::new(world, unit_mesh.into_parts().1).map_err(|_| RemeshError::too_few(places.len()))?;
    let metric::Adapted { scale, rounds, facing_away, .. } = adapted;
    let metric = Some(AdaptedFigures { figures, scale, rounds, facing_away });
    let vertex_seed = (0..mesh.positions().len() as u32).collect();
    Ok(Built { mesh, vertex_seed, segments, curve_edges: adapted.curve_edges, repair, missed, metric })
}
