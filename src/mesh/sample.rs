//! (being built)
use super::TriMesh;
use super::closest_point::SurfacePoint;
/// `count` random points on `mesh`, ∝ area times √weight (linear in each facet), from `seed`.
pub fn sample(_mesh: &TriMesh, _weights: Option<&[f64]>, _count: usize, _seed: u64) -> Vec<SurfacePoint> {
    todo!()
}
