//! The input by result vertex.
//!
//! Purpose: [`InputSamples`] has the samples and the vertices of the input in the cell of each result vertex, for the fit and
//! for distances of the whole result. [`Reference`] has the facets that the cell meets, for distances in one place. Neither
//! needs a search over the whole surface.
//! Invariant: depends on the diagram alone. Must not know: how the result is changed.

use glam::DVec3;

use crate::mesh::csr::Csr;
use crate::rvd::Surface;

/// A point of the input with its share of the area.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SurfaceSample {
    /// Unit frame.
    pub(crate) position: DVec3,
    /// Unit normal of the input there.
    pub(crate) normal: DVec3,
    /// Area it stands for.
    pub(crate) area: f64,
}

/// The input as points, by result vertex.
#[derive(Debug)]
pub(crate) struct InputSamples {
    pub(crate) samples: Csr<SurfaceSample>,
    /// Unit frame. The nearest facet is sought in the one-ring of the result vertex.
    pub(crate) vertices: Csr<DVec3>,
}

/// The input as facets and vertices, by result vertex.
pub(crate) struct Reference<'a> {
    surface: &'a Surface,
    facets: Csr<u32>,
    vertices: Csr<DVec3>,
}

impl<'a> Reference<'a> {
    /// `facets` and `vertices` are those of the input by result vertex.
    pub(crate) fn new(surface: &'a Surface, facets: Csr<u32>, vertices: Csr<DVec3>) -> Self {
        Self { surface, facets, vertices }
    }

    /// Input facets that the cell of result vertex `v` meets.
    pub(crate) fn facets(&self, v: u32) -> &[u32] {
        self.facets.of(v)
    }

    /// Input vertices in the cell of result vertex `v`, unit frame.
    pub(crate) fn vertices(&self, v: u32) -> &[DVec3] {
        self.vertices.of(v)
    }

    /// Corners of an input facet, unit frame.
    pub(crate) fn corners(&self, facet: u32) -> [DVec3; 3] {
        self.surface.facets()[facet as usize].map(|v| self.surface.positions()[v as usize])
    }
}
