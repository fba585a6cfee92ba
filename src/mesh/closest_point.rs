//! (being built)
use super::TriMesh;
use glam::DVec3;
/// A point of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Where it is, caller's coordinates.
    pub position: DVec3,
    /// On which facet.
    pub facet: u32,
    /// Barycentric coordinates in it.
    pub barycentric: [f64; 3],
}
/// Answers closest-point queries on one surface.
pub struct ClosestPoint;
impl ClosestPoint {
    /// Builds the bounding-volume hierarchy.
    pub fn new(_mesh: &TriMesh) -> Self {
        todo!()
    }
    /// The closest point of the surface; the lowest facet among equals.
    pub fn project(&self, _p: DVec3) -> SurfacePoint {
        todo!()
    }
}
