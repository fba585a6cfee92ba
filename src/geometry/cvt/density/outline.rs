//! How many points an edge length needs on a surface, and the other way round.
//!
//! Purpose: [`Outline`] has what the count depends on: area, length of the boundary, χ. Invariant: the two directions are each
//! other's inverse; no power of a length overflows. Must not know: densities that vary.

use glam::DVec3;

use crate::mesh::TriMesh;
use crate::mesh::adjacency::{Adjacency, EdgeKind};
use crate::mesh::measure::topology_unless;
use crate::token::{Stopped, Token};

/// 2/√3: points per area where edges have length 1, as each owns a hexagon of area √3/2.
pub(super) const POINTS_PER_AREA: f64 = 1.154_700_538_379_251_6;

/// Area, boundary and χ of a surface.
///
/// A triangulation with b vertices on the boundary has T = 2n - b - 2χ triangles. With equilateral ones
/// of edge length h, T = 4A/(√3 h²) and b = ℓ/h, so n = (2/√3) A/h² + ℓ/(2h) + χ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outline {
    /// Longest side of the bounding box, caller's units.
    pub(super) extent: f64,
    /// In units of `extent`².
    pub(super) area: f64,
    /// Length of all boundary edges, in units of `extent`.
    pub(super) boundary: f64,
    pub(super) euler: f64,
}

impl Outline {
    /// Measures `mesh`.
    pub fn new(mesh: &TriMesh, token: &Token) -> Result<Self, Stopped> {
        let adjacency = Adjacency::unless(mesh, token)?;
        Self::of(mesh, &adjacency, token)
    }

    pub(super) fn of(mesh: &TriMesh, adjacency: &Adjacency, token: &Token) -> Result<Self, Stopped> {
        let (low, high) = mesh.bounds();
        let extent = (high - low).max_element();
        let boundary = boundary_edges(mesh, adjacency).map(|[a, b]| ((a - b) / extent).length()).sum();
        // In the box of side 1: the area of a mesh scaled by 1e-200 is no number.
        let area = (0..mesh.facets().len())
            .filter(|&f| !mesh.is_degenerate(f))
            .map(|f| mesh.corners(f).map(|p| (p - low) / extent))
            .map(|[a, b, c]| 0.5 * (b - a).cross(c - a).length())
            .sum();
        token.check()?;
        let euler = topology_unless(mesh, adjacency, token)?.euler as f64;
        Ok(Self { extent, area, boundary, euler })
    }

    /// The number of points that edges of length `edge` (caller's units) need, not rounded.
    pub fn points(&self, edge: f64) -> f64 {
        let h = edge / self.extent;
        self.count(POINTS_PER_AREA * self.area / h / h, self.boundary / h)
    }

    /// The edge length, caller's units, that `points` points have if they are spread evenly.
    pub fn edge_length(&self, points: f64) -> f64 {
        let area = POINTS_PER_AREA * self.area;
        let half = 0.5 * self.boundary;
        // n h² - ℓ/2 h - (2/√3) A = 0, with χ bounded as in `count`.
        let n = (points - self.euler).max(0.5 * points).min(2.0 * points);
        let h = (0.5 * half + (0.25 * half * half + n * area).sqrt()) / n;
        h * self.extent
    }

    /// Points from the two integrals: over the area, and over the boundary. χ is taken into account as long as
    /// it changes them by no more than a factor of two: a torn surface may have a χ of any size.
    pub(super) fn count(&self, cells: f64, boundary: f64) -> f64 {
        let flat = cells + 0.5 * boundary;
        // Lengths so small that they vanish beside the extent: 0 of a boundary over 0.
        if flat.is_nan() {
            return f64::INFINITY;
        }
        (flat + self.euler).max(0.5 * flat).min(2.0 * flat).max(1.0)
    }
}

fn boundary_edges<'a>(mesh: &'a TriMesh, adjacency: &'a Adjacency) -> impl Iterator<Item = [DVec3; 2]> + 'a {
    let halves = (0..3 * mesh.facets().len()).filter(|&half| adjacency.kind(half) == EdgeKind::Boundary);
    halves.map(|half| {
        let corners = mesh.corners(half / 3);
        [corners[half % 3], corners[(half % 3 + 1) % 3]]
    })
}
