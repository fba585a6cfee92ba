//! How dense points are for unit triangles in a metric.
//!
//! Purpose: [`check`] refuses what is no metric; [`lengths`] finds for each vertex the edge length of round triangles that are as
//! large as the unit triangles there. Invariant: the tensor counts in the planes of the facets alone: lengths across the surface
//! make no points. Must not know: how facets get their shape.

use super::DensityError;
use super::net::Net;
use crate::mesh::tensor::Tensor;
use crate::token::Token;

/// Whether `tensors` are a metric for each of so many vertices: finite and positive definite.
pub fn check(tensors: &[Tensor], vertices: usize, token: &Token) -> Result<(), DensityError> {
    if tensors.len() != vertices {
        return Err(DensityError::MetricCount { given: tensors.len(), vertices });
    }
    for (vertex, tensor) in tensors.iter().enumerate() {
        token.check_at(vertex)?;
        if !tensor.is_finite() {
            return Err(DensityError::MetricNotFinite { vertex });
        }
        if let Some(least) = tensor.not_positive() {
            return Err(DensityError::MetricNotPositive { vertex, least });
        }
    }
    Ok(())
}

/// Lengths at the vertices, caller's units. A triangle is √det M times as large in the metric, with M in the triangle's plane.
pub(super) fn lengths(net: &Net, tensors: &[Tensor], token: &Token) -> Result<Vec<f64>, DensityError> {
    check(tensors, net.vertices(), token)?;
    // By class: area of the facets, in the box of side 1 and in the metric.
    let mut areas = vec![[0.0; 2]; net.vertices()];
    for (f, &(corners, area)) in net.facets.iter().enumerate() {
        token.check_at(f)?;
        let [a, b, c] = corners.map(|v| net.points[v as usize] * net.outline.extent);
        for v in corners {
            let own = &mut areas[v as usize];
            own[0] += area;
            own[1] += 0.5 * tensors[v as usize].parallelogram(b - a, c - a);
        }
    }
    let of = |v: usize| {
        let [area, in_metric] = areas[net.class[v] as usize];
        // A vertex that no facet uses has the length of the others.
        if area > 0.0 { net.outline.extent * (area / in_metric).sqrt() } else { 1.0 }
    };
    let lengths: Vec<f64> = (0..net.vertices()).map(of).collect();
    // A tensor may be so small or large that its areas are no numbers.
    match lengths.iter().position(|h| !(h.is_finite() && *h > 0.0)) {
        Some(vertex) => Err(DensityError::MetricRange { vertex }),
        None => Ok(lengths),
    }
}
