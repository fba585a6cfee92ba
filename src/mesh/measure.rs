//! (being built)
use super::TriMesh;
use serde::Serialize;

/// Topology of a surface.
#[derive(Clone, Copy, Debug, Serialize, PartialEq, Eq, Default)]
pub struct Topology {
    /// Euler characteristic V - E + F of the used vertices.
    pub euler: i64,
    /// Connected components (through shared vertices).
    pub components: usize,
    /// Closed chains of boundary edges.
    pub boundary_loops: usize,
    /// Edges with exactly one facet.
    pub boundary_edges: usize,
    /// Edges with more than two facets.
    pub non_manifold_edges: usize,
    /// Vertices whose facets form more than one fan.
    pub non_manifold_vertices: usize,
}

/// Geometry of a remesh, as the CVT literature reports it. Angles in degrees.
#[derive(Clone, Copy, Debug, Serialize, PartialEq, Default)]
pub struct Quality {
    /// Smallest Q = (6/√3) S/(p h).
    pub q_min: f64,
    /// Mean Q.
    pub q_avg: f64,
    /// Smallest angle.
    pub theta_min_deg: f64,
    /// Mean of each triangle's smallest angle.
    pub theta_avg_deg: f64,
    /// Share of triangles with an angle under 30°.
    pub under_30_percent: f64,
    /// Share of interior vertices with 5 to 7 neighbours.
    pub v567_percent: f64,
    /// Hausdorff distance, both ways, % of the input's bounding-box diagonal.
    pub hausdorff_percent: f64,
    /// Larger of both ways' root mean square distance, same unit.
    pub rms_percent: f64,
}

/// Topology of `mesh`, exactly coincident vertices counted as one.
pub fn topology(_mesh: &TriMesh) -> Topology {
    todo!()
}

/// Quality of `result` against `original`.
pub fn quality(_original: &TriMesh, _result: &TriMesh) -> Quality {
    todo!()
}
