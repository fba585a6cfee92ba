//! The surface as the backends see it.
//!
//! Purpose: a mesh moved into the unit box, with a weight per vertex, and lifted to R^6 where that is asked for.
//! Invariant: the scale is a power of two, so scaling rounds nothing; coordinates are in about [-1/2, 1/2] whatever the
//! caller's units and offset. Must not know: seeds, backends.

use glam::DVec3;
use rayon::prelude::*;

use super::{MAX_SEED_DISTANCE, RvdError};
use crate::knn::{Lifted, Point};
use crate::mesh::closest_point::{ClosestPoint, SurfacePoint};
use crate::mesh::{TriMesh, adjacency::weld_unless};
use crate::tasks;
use crate::token::Token;

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

/// Unit-frame positions of vertices and seeds are multiples of 1/`GRID`, 2·10⁻¹⁶ of the bounding box.
pub const GRID: f64 = (1u64 << 52) as f64;

/// The nearest point whose coordinates are multiples of 2⁻⁵²: a difference of two such points
/// inside the box is exact, and so are the decisions of `rvd::exact`.
pub fn snap(p: DVec3) -> DVec3 {
    DVec3::from_array(p.to_array().map(snapped))
}

fn snapped(x: f64) -> f64 {
    let x = x * GRID;
    // A sum of this size has no digits behind the point, and is rounded to the even one of two.
    let rounded = if x.abs() < 0.5 * GRID { (x + 1.5 * GRID) - 1.5 * GRID } else { x.round_ties_even() };
    rounded / GRID
}

/// [`snap`] of every coordinate.
pub(super) fn snap_point<P: Point>(p: P) -> P {
    let coordinates = p.coordinates();
    P::from_coordinates(P::each(|c| snapped(coordinates.as_ref()[c])))
}

/// Whether a facet with these corners in the unit frame has no area.
pub(super) fn is_flat<P: Point>([a, b, c]: [P; 3]) -> bool {
    let longest = (b - a).length_squared().max((c - b).length_squared()).max((a - c).length_squared());
    (b - a).parallelogram(c - a) <= 1e-15 * longest
}

/// Facets of a task that sets them.
const ALONE: usize = 4096;

/// The energy of regular hexagons, for ∫√w.
pub(super) fn hexagonal_energy(root_mass: f64, seeds: usize) -> f64 {
    5.0 / (18.0 * 3f64.sqrt()) * root_mass * root_mass / seeds as f64
}

/// Area of a facet with these corners.
pub(super) fn area_of<P: Point>([a, b, c]: [P; 3]) -> f64 {
    0.5 * (b - a).parallelogram(c - a)
}

/// A mesh in the unit frame, with weights. Immutable; sessions share it.
#[derive(Clone, Debug)]
pub struct Surface<P: Point = DVec3> {
    frame: Frame,
    positions: Vec<P>,
    weights: Vec<f64>,
    uniform: bool,
    facets: Vec<[u32; 3]>,
    welded: Vec<[u32; 3]>,
    skip: Vec<bool>,
    area: f64,
    mass: f64,
    root_mass: f64,
}

/// A surface of which a window is taken.
#[derive(Clone, Copy, Debug)]
pub(super) struct Whole {
    pub frame: Frame,
    /// Of all its facets, unit frame.
    pub area: f64,
}

impl Surface {
    /// One without facets, to be set.
    pub(super) fn none() -> Self {
        Self {
            frame: Frame { centre: DVec3::ZERO, scale: 1.0 },
            positions: Vec::new(),
            weights: Vec::new(),
            uniform: true,
            facets: Vec::new(),
            welded: Vec::new(),
            skip: Vec::new(),
            area: 0.0,
            mass: 0.0,
            root_mass: 0.0,
        }
    }

    /// Takes facets with area and corners of their own, of a uniform density; area and mass are those of the whole. `facet` has
    /// corners on the grid of the unit frame, and numbers from 0 to 2 in the order of the facet's vertices.
    pub(super) fn set_alone<I: Send>(
        &mut self,
        whole: Whole,
        each: impl IndexedParallelIterator<Item = I>,
        facet: impl Fn(I) -> ([DVec3; 3], [u32; 3]) + Sync,
    ) {
        let count = each.len();
        self.frame = whole.frame;
        (self.area, self.mass, self.root_mass) = (whole.area, whole.area, whole.area);
        self.positions.resize(3 * count, DVec3::ZERO);
        self.weights.resize(3 * count, 1.0);
        self.facets.clear();
        self.facets.extend((0..count as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]));
        self.welded.resize(count, [0; 3]);
        self.skip.resize(count, false);
        let slots = self.positions.par_chunks_exact_mut(3).zip(&mut self.welded);
        each.zip(slots).enumerate().with_min_len(ALONE).for_each(|(f, (item, (positions, welded)))| {
            let (corners, order) = facet(item);
            positions.copy_from_slice(&corners);
            *welded = order.map(|rank| 3 * f as u32 + rank);
        });
    }

    /// Takes a mesh and, if the density is not uniform, one weight per vertex (linear in each facet; edge length h needs
    /// w ∝ h⁻⁴). Errors: `WeightCount`, `BadWeight`, `NoArea`.
    pub fn new(mesh: &TriMesh, weights: Option<&[f64]>) -> Result<Self, RvdError> {
        Self::unless(mesh, weights, &Token::default())
    }

    /// As [`Self::new`]. Errors: `Stopped` too.
    pub fn unless(mesh: &TriMesh, weights: Option<&[f64]>, token: &Token) -> Result<Self, RvdError> {
        Self::of(mesh, weights, |_, place| place, token)
    }
}

impl Surface<Lifted> {
    /// The surface lifted to R^6: vertex v of `mesh` at (p, `lift[v]`), in the caller's unit of length. The lift is a normal
    /// times a length; where the normal turns at a crease, the mesh has a vertex for each side. Errors: as
    /// [`Surface::unless`]; `BadLift` if one is longer than [`MAX_SEED_DISTANCE`] boxes or not finite, or if there are not as many
    /// as vertices.
    pub fn lifted(mesh: &TriMesh, weights: Option<&[f64]>, lift: &[DVec3], token: &Token) -> Result<Self, RvdError> {
        let (low, high) = mesh.bounds();
        let scale = Frame::of_bounds(low, high).scale;
        let vertices = mesh.positions().len();
        // Exact decisions hold coordinates as far out as those of seeds.
        let fits = |v: usize| v < vertices && lift.get(v).is_some_and(|n| (*n * scale).length() <= MAX_SEED_DISTANCE);
        if let Some(vertex) = (0..vertices.max(lift.len())).find(|&v| !fits(v)) {
            return Err(RvdError::BadLift { vertex });
        }
        Self::of(mesh, weights, |v, place| Lifted { place, lift: snap(lift[v] * scale) }, token)
    }
}

impl<P: Point> Surface<P> {
    /// `at` says where a vertex is that has this place in the unit frame.
    fn of(
        mesh: &TriMesh,
        weights: Option<&[f64]>,
        at: impl Fn(usize, DVec3) -> P + Sync,
        token: &Token,
    ) -> Result<Self, RvdError> {
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
                // Vertices that no facet uses have no say.
                let used = mesh.facets().iter().flatten().map(|&v| given[v as usize]);
                let largest = used.fold(0.0, f64::max);
                if largest == 0.0 {
                    return Err(RvdError::BadWeight { vertex: mesh.facets()[0][0] as usize, value: 0.0 });
                }
                // Scaled so that the largest is in (1/2, 1]: only ratios matter, and f32 must hold them. In
                // two steps, as the scale of a subnormal weight is beyond the range.
                let half = (-largest.log2().ceil() * 0.5).floor().exp2();
                let rest = (-largest.log2().ceil() - half.log2()).exp2();
                Some(given.iter().map(|w| (w * half * rest).min(1.0)).collect::<Vec<_>>())
            }
        };
        // A vertex that no facet uses may be so far away that the unit frame cannot hold it.
        let held = |p: DVec3| if p.is_finite() { p } else { DVec3::ZERO };
        let unit = || {
            let place = |v: usize| at(v, held(snap(frame.to_unit(mesh.positions()[v]))));
            tasks::map(mesh.positions().len(), place)
        };
        let (positions, class): (Vec<P>, _) = rayon::join(unit, || weld_unless(mesh, token));
        let class = class?;
        // On the grid a facet may lose what area it had, by the same measure as in the mesh.
        let flat = |f: usize| is_flat(mesh.facets()[f].map(|v| positions[v as usize]));
        let skip = tasks::map(mesh.facets().len(), |f| mesh.is_degenerate(f) || flat(f));
        token.check()?;
        if skip.iter().all(|&skipped| skipped) {
            return Err(RvdError::NoArea);
        }
        let mut surface = Self {
            frame,
            uniform: weights.is_none(),
            weights: weights.unwrap_or_else(|| vec![1.0; vertices]),
            positions,
            facets: mesh.facets().to_vec(),
            welded: tasks::map(mesh.facets().len(), |f| mesh.facets()[f].map(|v| class[v as usize])),
            skip,
            area: 0.0,
            mass: 0.0,
            root_mass: 0.0,
        };
        token.check()?;
        surface.area =
            (0..surface.facets.len()).filter(|&f| !surface.skip[f]).map(|f| surface.facet_area(f as u32)).sum();
        token.check()?;
        surface.mass = surface.integral(|w| w);
        token.check()?;
        surface.root_mass = surface.integral(f64::sqrt);
        Ok(surface)
    }

    /// The map to the caller's coordinates.
    pub fn frame(&self) -> Frame {
        self.frame
    }

    /// Vertex positions in the unit frame, all finite. A vertex that no facet uses may lie anywhere.
    pub fn positions(&self) -> &[P] {
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

    /// Facets with the lowest vertex at exactly the same place for each, so that both sides of a texture seam share edges.
    pub fn welded(&self) -> &[[u32; 3]] {
        &self.welded
    }

    /// Corners of facet `f`.
    pub fn corners(&self, f: u32) -> [P; 3] {
        self.facets[f as usize].map(|v| self.positions[v as usize])
    }

    /// The point of the surface that has a place.
    pub fn point(&self, at: &SurfacePoint) -> P {
        let ([a, b, c], [u, v, w]) = (self.corners(at.facet), at.barycentric);
        (a * u + b * v + c * w).at(at.position)
    }

    /// Centroid of facet `f`.
    pub fn centroid(&self, f: u32) -> P {
        let [a, b, c] = self.corners(f);
        (a + b + c) / 3.0
    }

    /// Unit normal of facet `f` in R^3, or 0 if it has no area.
    pub fn normal(&self, f: u32) -> DVec3 {
        let [a, b, c] = self.corners(f).map(P::place);
        (b - a).cross(c - a).normalize_or_zero()
    }

    /// Whether facet `f` is degenerate and left out.
    pub fn skips(&self, f: usize) -> bool {
        self.skip[f]
    }

    /// What answers for closest points of it, unit frame.
    pub fn closest_points(&self, token: &Token) -> Result<ClosestPoint, RvdError> {
        let places = self.positions.iter().map(|p| p.place()).collect();
        let mesh = TriMesh::new(places, self.facets.clone())
            .map_err(|e| RvdError::Internal(format!("the surface was valid before: {e}")))?;
        Ok(ClosestPoint::unless(&mesh, token)?)
    }

    /// E_hex: the energy that `seeds` seeds would have on a flat surface of this size and density if every cell were a
    /// regular hexagon, 5/(18√3) (∫√w)²/n, unit frame. √w is taken as linear between the corners of a facet.
    pub fn hexagonal_energy(&self, seeds: usize) -> f64 {
        hexagonal_energy(self.root_mass, seeds)
    }

    /// ∫√w, unit frame, √w taken as linear between the corners of a facet.
    pub fn root_mass(&self) -> f64 {
        self.root_mass
    }

    /// ∫ w, unit frame.
    pub fn mass(&self) -> f64 {
        self.mass
    }

    /// The integral of what `of` makes of the weights, taken as linear between the corners of a facet.
    fn integral(&self, of: impl Fn(f64) -> f64) -> f64 {
        let mut sum = 0.0;
        for (f, corners) in self.facets.iter().enumerate().filter(|&(f, _)| !self.skip[f]) {
            let mean = corners.map(|v| of(self.weights[v as usize])).iter().sum::<f64>() / 3.0;
            sum += mean * self.facet_area(f as u32);
        }
        sum
    }

    /// Area of facet `f`, unit frame.
    pub fn facet_area(&self, f: u32) -> f64 {
        area_of(self.corners(f))
    }

    /// Whether facet `f` joins its neighbours: it has an area, or at least three corners in three places. A facet
    /// without area between two others is part of no integral, but the surface goes on across it.
    pub fn joins(&self, f: usize) -> bool {
        let [a, b, c] = self.welded[f];
        !self.skip[f] || (a != b && b != c && c != a)
    }

    /// Area of all facets that are not left out, unit frame.
    pub fn area(&self) -> f64 {
        self.area
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn snapping_rounds_to_the_even_one_of_two() {
        let plain = |x: f64| (x * GRID).round_ties_even() / GRID;
        let numbers = (0..2000).map(|k| f64::from(k).sin() * 1.1f64.powi(k % 200 - 100));
        let ties = (-40..40).map(|k| (f64::from(k) + 0.5) / GRID);
        for x in numbers.chain(ties).chain([0.5, -0.5, 0.499_999_999_999_999_9, 1e6 + 0.1, 0.0]) {
            assert_eq!(snap(DVec3::splat(x)), DVec3::splat(plain(x)), "{x:e}");
        }
    }
}
