//! Triangle surfaces.
//!
//! Purpose: one validated type, [`TriMesh`], that other modules can trust, and operations on a single surface: files,
//! adjacency, samples, closest points, quality. Invariant: a `TriMesh` has finite positions, indices in range and at least
//! one facet with an area. Facets without area stay in the list, so that facet numbers are the caller's, and are marked
//! [`TriMesh::is_degenerate`]; integration ignores them. Must not know: seeds, Voronoi cells, backends, jobs.

pub mod adjacency;
pub(crate) mod apart;
pub mod attributes;
pub(crate) mod bvh;
pub mod closest_point;
pub mod coincident;
pub(crate) mod comparison;
pub mod crossings;
pub mod csr;
pub(crate) mod duplicates;
pub mod edges;
pub(crate) mod facet_set;
pub mod features;
pub(crate) mod hanging;
pub(crate) mod input;
pub mod io;
pub mod measure;
pub mod metric;
pub mod motion;
pub mod numbers;
pub mod out_of_core;
pub(crate) mod pairs;
pub mod parts;
pub mod plane;
pub mod regions;
pub mod sample;
pub mod shapes;
pub(crate) mod sheets;
pub mod tensor;
pub(crate) mod tips;

use crate::tasks;
pub use features::FeatureError;
use glam::DVec3;
use rayon::prelude::*;

/// A validated triangle surface in the caller's own coordinates, double precision.
#[derive(Clone, Debug, PartialEq)]
pub struct TriMesh {
    positions: Vec<DVec3>,
    facets: Vec<[u32; 3]>,
    degenerate: Vec<bool>,
    degenerate_count: usize,
    area: f64,
}

/// Why a surface was refused. Every variant names the element to look at.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MeshError {
    /// A coordinate is NaN or infinite.
    #[error("vertex {vertex} has a coordinate that is not finite: ({}, {}, {})", .position.x, .position.y, .position.z)]
    NonFinitePosition {
        /// Index of the vertex, from 0.
        vertex: usize,
        /// Its position as given.
        position: DVec3,
    },
    /// A corner names a vertex that does not exist.
    #[error("facet {facet}, corner {corner} names vertex {index}, but there are {vertices} vertices (0 to {})", .vertices.saturating_sub(1))]
    IndexOutOfRange {
        /// Index of the facet, from 0.
        facet: usize,
        /// 0, 1 or 2.
        corner: usize,
        /// The index as given.
        index: u32,
        /// Number of vertices.
        vertices: usize,
    },
    /// The facet list is empty.
    #[error("the mesh has no facets; give at least one triangle")]
    NoFacets,
    /// Every facet is a point or a segment.
    #[error("none of the {facets} facets has an area; the surface is empty")]
    NoArea {
        /// Number of facets.
        facets: usize,
    },
    /// More than 2^31 - 1 vertices or facets.
    #[error("{what}: {count} is more than the {MAX_ELEMENTS} that 32-bit indices allow")]
    TooLarge {
        /// "vertices" or "facets".
        what: &'static str,
        /// How many were given.
        count: usize,
    },
    /// Coordinates so large that areas overflow double precision, and the longest side of the bounding box.
    #[error("the bounding box is {0:e} wide; its square overflows. Scale the mesh to below 1e150")]
    ExtentTooLarge(f64),
    /// Coordinates so small that double precision has few digits left for them, and the same side.
    #[error("the bounding box is {0:e} wide; coordinates that small lose their digits. Scale the mesh to above 1e-305")]
    ExtentTooSmall(f64),
}

/// The largest number of vertices or facets: indices above are used as labels.
pub const MAX_ELEMENTS: usize = (i32::MAX as usize) - 8;

impl TriMesh {
    /// Checks and takes a surface, in the caller's units. Facets are counter-clockwise from outside, three indices from 0.
    ///
    /// ```
    /// use tessera::mesh::{MeshError, TriMesh};
    /// use glam::dvec3;
    /// let corners = vec![dvec3(0., 0., 0.), dvec3(1., 0., 0.), dvec3(0., 1., 0.)];
    /// let mesh = TriMesh::new(corners.clone(), vec![[0, 1, 2]])?;
    /// assert_eq!(mesh.area(), 0.5);
    /// assert!(matches!(TriMesh::new(corners, vec![[0, 1, 3]]), Err(MeshError::IndexOutOfRange { index: 3, .. })));
    /// # Ok::<(), MeshError>(())
    /// ```
    pub fn new(positions: Vec<DVec3>, facets: Vec<[u32; 3]>) -> Result<Self, MeshError> {
        for (what, count) in [("vertices", positions.len()), ("facets", facets.len())] {
            if count > MAX_ELEMENTS {
                return Err(MeshError::TooLarge { what, count });
            }
        }
        if facets.is_empty() {
            return Err(MeshError::NoFacets);
        }
        if let Some(vertex) = positions.par_iter().position_first(|p| !p.is_finite()) {
            return Err(MeshError::NonFinitePosition { vertex, position: positions[vertex] });
        }
        let outside = |&index: &u32| index as usize >= positions.len();
        if let Some(facet) = facets.par_iter().position_first(|corners| corners.iter().any(outside)) {
            let corner = facets[facet].iter().position(outside).unwrap_or(0);
            let (index, vertices) = (facets[facet][corner], positions.len());
            return Err(MeshError::IndexOutOfRange { facet, corner, index, vertices });
        }
        let (low, high) = bounds(&positions, &facets);
        let extent = (high - low).max_element();
        check_extent(extent)?;
        let mesh = Self::measured(positions, facets, low, extent);
        if mesh.degenerate_count == mesh.facets.len() {
            return Err(MeshError::NoArea { facets: mesh.facets.len() });
        }
        Ok(mesh)
    }

    /// Takes a surface that is known to be valid.
    fn assemble(positions: Vec<DVec3>, facets: Vec<[u32; 3]>) -> Self {
        let (low, high) = bounds(&positions, &facets);
        Self::measured(positions, facets, low, (high - low).max_element())
    }

    /// [`Self::assemble`] with a known bounding box.
    fn measured(positions: Vec<DVec3>, facets: Vec<[u32; 3]>, low: DVec3, extent: f64) -> Self {
        // Areas are taken in the unit box, so that a mesh scaled by 1e-200 keeps its facets.
        let scale = if extent > 0.0 { extent } else { 1.0 };
        let mut degenerate = vec![false; facets.len()];
        let measure = |(flats, facets): (&mut [bool], &[[u32; 3]])| {
            let (mut area, mut degenerate_count) = (0.0, 0);
            for (flat, corners) in flats.iter_mut().zip(facets) {
                let twice = twice_area(corners.map(|v| (positions[v as usize] - low) / scale));
                *flat = twice.is_none();
                match twice {
                    None => degenerate_count += 1,
                    Some(twice) => area += 0.5 * twice,
                }
            }
            (area, degenerate_count)
        };
        let parts: Vec<_> = degenerate.par_chunks_mut(CHUNK).zip(facets.par_chunks(CHUNK)).map(measure).collect();
        let (area, degenerate_count) = parts.iter().fold((0.0, 0), |sum, part| (sum.0 + part.0, sum.1 + part.1));
        Self { positions, facets, degenerate, degenerate_count, area: area * scale * scale }
    }

    /// Vertex positions, as given.
    pub fn positions(&self) -> &[DVec3] {
        &self.positions
    }

    /// Facets, as given: three vertex indices each.
    pub fn facets(&self) -> &[[u32; 3]] {
        &self.facets
    }

    /// Whether facet `facet` has no area and is left out of every integral.
    pub fn is_degenerate(&self, facet: usize) -> bool {
        self.degenerate[facet]
    }

    /// How many facets are degenerate.
    pub fn degenerate_count(&self) -> usize {
        self.degenerate_count
    }

    /// Sum of the facets' areas, in the caller's units squared.
    pub fn area(&self) -> f64 {
        self.area
    }

    /// Lower and upper corner of the box around all vertices that a facet uses.
    pub fn bounds(&self) -> (DVec3, DVec3) {
        bounds(&self.positions, &self.facets)
    }

    /// Corner positions of facet `facet`.
    pub fn corners(&self, facet: usize) -> [DVec3; 3] {
        self.facets[facet].map(|v| self.positions[v as usize])
    }

    /// Splits the mesh into its arrays.
    pub fn into_parts(self) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        (self.positions, self.facets)
    }
}

/// Refuses a bounding box whose longest side areas cannot be computed with.
pub(crate) fn check_extent(extent: f64) -> Result<(), MeshError> {
    if extent >= 1e150 {
        return Err(MeshError::ExtentTooLarge(extent));
    }
    // Below 2.2e-308 numbers are subnormal, and the scale to a unit box overflows. A width of 0 has no area.
    if extent > 0.0 && extent < 1e-305 {
        return Err(MeshError::ExtentTooSmall(extent));
    }
    Ok(())
}

/// Twice the area of a facet with these corners in the unit box; `None` if it has none.
pub(crate) fn twice_area([a, b, c]: [DVec3; 3]) -> Option<f64> {
    let twice = (b - a).cross(c - a).length();
    // Repeated corners, or an area within rounding: an altitude below 1e-15 longest edges has no direction.
    let longest = (b - a).length_squared().max((c - a).length_squared()).max((c - b).length_squared());
    (twice > 1e-15 * longest).then_some(twice)
}

/// The normal of a facet with these corners, as long as twice its area.
pub(crate) fn normal([a, b, c]: [DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a)
}

/// Facets per partial sum; partial sums are added in order, so that threads do not change them.
pub(crate) const CHUNK: usize = 1 << 14;

fn bounds(positions: &[DVec3], facets: &[[u32; 3]]) -> (DVec3, DVec3) {
    let empty = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let part = |facets: &[[u32; 3]]| {
        let corners = facets.iter().flatten().map(|&v| positions[v as usize]);
        corners.fold(empty, |(low, high), p| (low.min(p), high.max(p)))
    };
    let parts =
        tasks::alone(facets.len().div_ceil(CHUNK), |k| part(&facets[k * CHUNK..facets.len().min((k + 1) * CHUNK)]));
    parts.into_iter().fold(empty, |(low, high), part| (low.min(part.0), high.max(part.1)))
}
