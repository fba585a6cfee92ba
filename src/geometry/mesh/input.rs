//! Figures of an input surface.
//!
//! Purpose: [`InputFigures`], the input block of a report.
//! Invariant: names that scripts read do not change.
//! Must not know: the use of the surface.

use serde::Serialize;

use super::adjacency::Adjacency;
use super::duplicates::{self, InputKind, Oddities};
use super::measure::{Topology, topology_unless};
use super::{TriMesh, outliers};
use crate::token::{Stopped, Token};

/// The input surface.
#[derive(Clone, Debug, Serialize)]
pub struct InputFigures {
    /// Kind of the input.
    pub kind: InputKind,
    /// Facets with more than two facets at every edge.
    pub enclosed_facets: usize,
    /// Facets that lie on others, corner on corner and back to back, and stay: they enclose nothing.
    pub back_to_back_facets: usize,
    /// Vertices as given.
    pub vertices: usize,
    /// Facets, degenerate ones included.
    pub facets: usize,
    /// Facets without area.
    pub degenerate_facets: usize,
    /// Edges of two facets that are oriented unlike each other.
    pub inconsistent_edges: usize,
    /// Facets that were turned over, to be oriented as their neighbours are.
    pub reoriented_facets: usize,
    /// Boundary vertices that were stitched to nearly coincident ones. The other figures describe the surface after
    /// stitching and without `coincident_facets`.
    pub stitched_vertices: usize,
    /// Duplicate facets that were removed: they lay on others, corner on corner, and the surface is connected without them.
    pub coincident_facets: usize,
    /// Vertices a thousand times as far from the middle as half of all are: wrong coordinates, most often. The surface has a
    /// spike there, which takes most of the points.
    pub outlier_vertices: usize,
    /// Caller's units squared.
    pub area: f64,
    /// Euler characteristic χ, components, holes, non-manifold elements.
    #[serde(flatten)]
    pub topology: Topology,
}

impl InputFigures {
    /// Measures the input surface.
    pub fn of(mesh: &TriMesh, token: &Token) -> Result<Self, Stopped> {
        let adjacency = Adjacency::new(mesh);
        token.check()?;
        Self::with(mesh, &adjacency, token)
    }

    /// Measures a surface with known adjacency.
    pub fn with(mesh: &TriMesh, adjacency: &Adjacency, token: &Token) -> Result<Self, Stopped> {
        let outlier_vertices = outliers::find(mesh).len();
        token.check()?;
        let oddities =
            if adjacency.non_manifold_edges() > 0 { duplicates::oddities(mesh) } else { Oddities::default() };
        token.check()?;
        Ok(Self {
            kind: oddities.kind(),
            enclosed_facets: oddities.enclosed,
            back_to_back_facets: oddities.back_to_back,
            vertices: mesh.positions().len(),
            facets: mesh.facets().len(),
            degenerate_facets: mesh.degenerate_count(),
            inconsistent_edges: adjacency.inconsistent_edges(),
            reoriented_facets: 0,
            stitched_vertices: 0,
            coincident_facets: 0,
            outlier_vertices,
            area: mesh.area(),
            topology: topology_unless(mesh, adjacency, token)?,
        })
    }
}
