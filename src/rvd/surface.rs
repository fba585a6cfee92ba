//! The surface as the backends see it.
//!
//! Purpose: a mesh moved into the unit box, with a weight per vertex.
//! Invariant: the scale is a power of two, so scaling rounds nothing; coordinates are in about
//! [-1/2, 1/2] whatever the caller's units and offset.
//! Must not know: seeds, backends.

use glam::DVec3;

use super::RvdError;
use crate::mesh::TriMesh;

/// The map between the caller's coordinates and the unit frame: unit = (p - centre) * scale.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// Centre of the bounding box, caller's coordinates.
    pub centre: DVec3,
    /// A power of two, in 1 / caller's unit.
    pub scale: f64,
}

impl Frame {
    /// The frame of a box.
    pub fn of_bounds(low: DVec3, high: DVec3) -> Self {
        let extent = (high - low).max_element();
        let scale = if extent > 0.0 { (-extent.log2().ceil()).exp2() } else { 1.0 };
        // Halves first: low + high may overflow where the halves do not.
        Self { centre: low * 0.5 + high * 0.5, scale }
    }

    /// Caller's coordinates to unit frame.
    pub fn to_unit(&self, p: DVec3) -> DVec3 {
        (p - self.centre) * self.scale
    }

    /// Unit frame to caller's coordinates.
    pub fn to_world(&self, p: DVec3) -> DVec3 {
        p / self.scale + self.centre
    }
}

/// A mesh in the unit frame, with weights. Immutable; sessions share it.
#[derive(Clone, Debug)]
pub struct Surface {
    frame: Frame,
    positions: Vec<DVec3>,
    weights: Vec<f64>,
    uniform: bool,
    facets: Vec<[u32; 3]>,
    skip: Vec<bool>,
    area: f64,
}

impl Surface {
    /// Takes a mesh and, if the density is not uniform, one weight per vertex
    /// (linear in each facet; edge length h needs w ∝ h⁻⁴).
    ///
    /// # Errors
    /// `WeightCount`, `BadWeight`.
    pub fn new(mesh: &TriMesh, weights: Option<&[f64]>) -> Result<Self, RvdError> {
        let (low, high) = mesh.bounds();
        let frame = Frame::of_bounds(low, high);
        let vertices = mesh.positions().len();
        let weights = match weights {
            None => None,
            Some(given) if given.len() != vertices => {
                return Err(RvdError::WeightCount { given: given.len(), vertices });
            }
            Some(given) => {
                if let Some(vertex) = given.iter().position(|w| !(w.is_finite() && *w >= 0.0)) {
                    return Err(RvdError::BadWeight { vertex, value: given[vertex] });
                }
                let largest = given.iter().copied().fold(0.0, f64::max);
                if largest == 0.0 {
                    return Err(RvdError::BadWeight { vertex: 0, value: 0.0 });
                }
                // Scaled so that the largest is in (1/2, 1]: only ratios matter, and f32 must hold them.
                let scale = (-largest.log2().ceil()).exp2();
                Some(given.iter().map(|w| w * scale).collect::<Vec<_>>())
            }
        };
        let positions: Vec<DVec3> = mesh.positions().iter().map(|&p| frame.to_unit(p)).collect();
        let skip: Vec<bool> = (0..mesh.facets().len()).map(|f| mesh.is_degenerate(f)).collect();
        let mut area = 0.0;
        for (f, corners) in mesh.facets().iter().enumerate() {
            if !skip[f] {
                let [a, b, c] = corners.map(|v| positions[v as usize]);
                area += 0.5 * (b - a).cross(c - a).length();
            }
        }
        Ok(Self {
            frame,
            uniform: weights.is_none(),
            weights: weights.unwrap_or_else(|| vec![1.0; vertices]),
            positions,
            facets: mesh.facets().to_vec(),
            skip,
            area,
        })
    }

    /// The map to the caller's coordinates.
    pub fn frame(&self) -> Frame {
        self.frame
    }

    /// Vertex positions in the unit frame. A vertex that no facet uses may lie anywhere.
    pub fn positions(&self) -> &[DVec3] {
        &self.positions
    }

    /// One weight per vertex, the largest in (1/2, 1]; all 1 if uniform.
    pub fn weights(&self) -> &[f64] {
        &self.weights
    }

    /// Whether the density is the same everywhere.
    pub fn is_uniform(&self) -> bool {
        self.uniform
    }

    /// Facets: vertex indices, in the mesh's order.
    pub fn facets(&self) -> &[[u32; 3]] {
        &self.facets
    }

    /// Centroid of facet `f`.
    pub fn centroid(&self, f: u32) -> DVec3 {
        let [a, b, c] = self.facets[f as usize].map(|v| self.positions[v as usize]);
        (a + b + c) / 3.0
    }

    /// Whether facet `f` is degenerate and left out.
    pub fn skips(&self, f: usize) -> bool {
        self.skip[f]
    }

    /// Area of all facets that are not left out, unit frame.
    pub fn area(&self) -> f64 {
        self.area
    }
}
