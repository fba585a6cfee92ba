//! Surfaces in formats of single precision.
//!
//! Purpose: [`check`] refuses what rounding would spoil. Must not know: formats.

use glam::DVec3;

use super::DataError;
use crate::mesh::TriMesh;

/// Facets that single precision makes lines or points of may have this share of the area.
const LOSS: f64 = 1e-3;

/// # Errors
/// [`DataError::SinglePrecision`], [`DataError::Collapsed`].
pub(super) fn check(mesh: &TriMesh) -> Result<(), DataError> {
    let limit = f64::from(f32::MAX);
    if let Some(vertex) = mesh.positions().iter().position(|p| p.abs().max_element() > limit) {
        return Err(DataError::SinglePrecision { vertex, position: mesh.positions()[vertex] });
    }
    let joined = |p: DVec3, q: DVec3| p != q && p.as_vec3() == q.as_vec3();
    let collapses = |&facet: &usize| {
        let [a, b, c] = mesh.corners(facet);
        joined(a, b) || joined(b, c) || joined(c, a)
    };
    let collapsed: Vec<usize> = (0..mesh.facets().len()).filter(collapses).collect();
    if let Some(&facet) = collapsed.first() {
        // Scaled, so that no square vanishes. Slivers are no loss.
        let (low, high) = mesh.bounds();
        let extent = (high - low).max_element();
        let area = |facet: usize| {
            let [a, b, c] = mesh.corners(facet).map(|p| (p - low) / extent);
            (b - a).cross(c - a).length()
        };
        let all: f64 = (0..mesh.facets().len()).map(area).sum();
        if collapsed.into_iter().map(area).sum::<f64>() > LOSS * all {
            return Err(DataError::Collapsed { facet });
        }
    }
    Ok(())
}
