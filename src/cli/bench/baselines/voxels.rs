//! Voxels of a surface.
//!
//! Purpose: the voxels of a cubic grid that a facet touches, by separating axes (Akenine-Möller 2001), with the area of the
//! surface in each; layers around them; and the dual of their labels, from blocks of eight.
//! Invariant: a voxel is closed: a facet that touches its face, edge or corner is in it. The areas of a facet's parts add up
//! to the facet's. Must not know: how labels are found.

use std::collections::{BTreeSet, HashSet};

use glam::DVec3;
use rayon::prelude::*;

use super::sums::Part;
use geometry::mesh::closest_point::SurfacePoint;
use geometry::rvd::Surface;

/// Bytes of a voxel of the surface while it is made and afterwards, about, at most.
const BYTES: f64 = 400.0;
/// Voxels that a plane touches, per square of a voxel's side, at most.
const MOST_TOUCHED: f64 = 3.0;
/// Voxels left free on each side of the surface.
const MARGIN: f64 = 1.5;
/// The grid is moved by this share of a voxel, so that a box's faces, and a plane through its centre, lie within voxels.
const SHIFT: f64 = 0.25;

/// A grid of N³ voxels around a surface, unit frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Grid {
    pub(super) n: u32,
    low: DVec3,
    size: f64,
}

impl Grid {
    pub(super) fn new(surface: &Surface, n: u32) -> Self {
        let used = (0..surface.facets().len()).filter(|&f| !surface.skips(f));
        let corners = used.flat_map(|f| surface.corners(f as u32));
        let none = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let (low, high) = corners.fold(none, |(low, high), p| (low.min(p), high.max(p)));
        let size = (high - low).max_element() / (f64::from(n) - 2.0 * MARGIN);
        Self { n, low: (low + high) * 0.5 - DVec3::splat((0.5 * f64::from(n) - SHIFT) * size), size }
    }

    /// Bytes for the voxels of a surface, about, and for `of_all` bytes a voxel of the grid.
    pub(super) fn plan(&self, surface: &Surface, of_all: u64) -> u64 {
        let touched = MOST_TOUCHED * surface.area() / (self.size * self.size) + 8.0 * surface.facets().len() as f64;
        of_all * u64::from(self.n).pow(3) + (BYTES * touched) as u64
    }

    /// A point in units of a voxel: voxel (i, j, k) is from (i, j, k) to (i + 1, j + 1, k + 1).
    pub(super) fn to_voxels(self, p: DVec3) -> DVec3 {
        (p - self.low) / self.size
    }

    /// Seeds in the same units, in single precision.
    pub(super) fn places(self, seeds: &[DVec3]) -> Vec<[f32; 3]> {
        seeds.iter().map(|&p| self.to_voxels(p).to_array().map(|x| x as f32)).collect()
    }

    pub(super) fn centre(self, code: u32) -> DVec3 {
        let at = self.at(code).map(|i| f64::from(i) + 0.5);
        self.low + self.size * DVec3::from_array(at)
    }

    /// The voxel that holds a point, or the nearest one.
    pub(super) fn code_of(self, p: DVec3) -> u32 {
        let most = f64::from(self.n - 1);
        self.code(self.to_voxels(p).to_array().map(|x| x.floor().clamp(0.0, most) as u32))
    }

    fn code(self, [x, y, z]: [u32; 3]) -> u32 {
        x + self.n * (y + self.n * z)
    }

    fn at(self, code: u32) -> [u32; 3] {
        [code % self.n, code / self.n % self.n, code / self.n / self.n]
    }

    /// Voxels whose coordinates are larger by 0 or 1, or smaller by 0 or 1, within the grid.
    fn block(self, code: u32, sign: i64) -> impl Iterator<Item = u32> {
        let at = self.at(code).map(i64::from);
        let n = i64::from(self.n);
        (0..8).filter_map(move |bits| {
            let beside: [i64; 3] = std::array::from_fn(|k| at[k] + sign * ((bits >> k) & 1));
            beside.iter().all(|x| (0..n).contains(x)).then(|| self.code(beside.map(|x| x as u32)))
        })
    }
}

/// Voxels of a surface.
pub(super) struct Voxels {
    pub(super) grid: Grid,
    /// Numbers of the voxels, ascending.
    pub(super) codes: Vec<u32>,
    /// What of the surface is in each.
    pub(super) parts: Vec<Part>,
    /// Sum of the facets' normals in each, times the area.
    normals: Vec<DVec3>,
}

impl Voxels {
    /// The voxels that a facet touches.
    pub(super) fn new(surface: &Surface, grid: Grid) -> Self {
        let of_facet = |f: u32| {
            let mut found = Vec::new();
            if surface.skips(f as usize) {
                return found;
            }
            let corners = surface.corners(f).map(|p| grid.to_voxels(p));
            touched(corners, grid.n, |at| found.push((grid.code(at), within(corners, at))));
            // Where a facet lies between two voxels, its parts are in both.
            let total: f64 = found.iter().map(|(_, [area, ..])| area).sum();
            let factor = if total > 0.0 { surface.facet_area(f) / total } else { 0.0 };
            found.iter_mut().for_each(|(_, sums)| sums.iter_mut().for_each(|sum| *sum *= factor));
            found
        };
        let facets = 0..surface.facets().len() as u32;
        let mut all: Vec<(u32, u32, [f64; 5])> = facets
            .into_par_iter()
            .flat_map_iter(|f| of_facet(f).into_iter().map(move |(code, sums)| (code, f, sums)))
            .collect();
        all.par_sort_unstable_by_key(|&(code, facet, _)| (code, facet));
        let mut voxels = Self { grid, codes: Vec::new(), parts: Vec::new(), normals: Vec::new() };
        for here in all.chunk_by(|a, b| a.0 == b.0) {
            let mut sums = [0.0; 5];
            let mut normal = DVec3::ZERO;
            for (_, facet, part) in here {
                sums.iter_mut().zip(part).for_each(|(sum, part)| *sum += part);
                normal += part[0] * surface.normal(*facet);
            }
            let [area, x, y, z, second] = sums;
            voxels.codes.push(here[0].0);
            voxels.normals.push(normal);
            voxels.parts.push(if area > 0.0 {
                let mean = DVec3::new(x, y, z) / area;
                let spread = (second / area - mean.length_squared()).max(0.0) * grid.size * grid.size;
                Part { area, centroid: grid.low + grid.size * mean, spread }
            } else {
                Part { area: 0.0, centroid: grid.centre(here[0].0), spread: 0.0 }
            });
        }
        voxels
    }

    /// Adds `layers` layers of voxels on all sides; they have no area.
    pub(super) fn widened(self, layers: u32) -> Self {
        if layers == 0 {
            return self;
        }
        let mut codes = self.codes.clone();
        for _ in 0..layers {
            let near = |&code: &u32| self.grid.block(code, 1).flat_map(|code| self.grid.block(code, -1));
            codes = codes.par_iter().flat_map_iter(near).collect();
            codes.par_sort_unstable();
            codes.dedup();
        }
        let old = |code: &u32| self.find(*code);
        let parts = codes.iter().map(|code| old(code).map_or_else(Part::default, |k| self.parts[k])).collect();
        let normals = codes.iter().map(|code| old(code).map_or(DVec3::ZERO, |k| self.normals[k])).collect();
        Self { grid: self.grid, codes, parts, normals }
    }

    pub(super) fn bytes(&self) -> u64 {
        let each = size_of::<u32>() + size_of::<Part>() + size_of::<DVec3>();
        (self.codes.capacity() * each) as u64
    }

    fn find(&self, code: u32) -> Option<usize> {
        self.codes.binary_search(&code).ok()
    }

    /// The voxel that stands for a point of the surface. Beside the one that holds it, as rounding may tell.
    pub(super) fn of_point(&self, at: &SurfacePoint) -> Option<usize> {
        let code = self.grid.code_of(at.position);
        let near = self.grid.block(code, 1).flat_map(|code| self.grid.block(code, -1));
        std::iter::once(code).chain(near).find_map(|code| self.find(code))
    }

    /// Triangles between labels that meet in a block of 2 × 2 × 2 voxels. More than three are ordered about the surface's
    /// normal there: two triangles on the shorter diagonal of four, a fan of more.
    pub(super) fn triangles(&self, label: impl Fn(usize) -> u32, seeds: &[DVec3]) -> Vec<[u32; 3]> {
        let blocks: BTreeSet<u32> = self.codes.iter().flat_map(|&code| self.grid.block(code, -1)).collect();
        let mut found = Unique::default();
        for block in blocks {
            let here: Vec<usize> = self.grid.block(block, 1).filter_map(|code| self.find(code)).collect();
            let labels: BTreeSet<u32> = here.iter().map(|&k| label(k)).collect();
            let labels: Vec<u32> = labels.into_iter().filter(|&l| (l as usize) < seeds.len()).collect();
            let normal: DVec3 = here.iter().map(|&k| self.normals[k]).sum();
            found.polygon(labels, normal, seeds);
        }
        found.triangles
    }
}

/// Triangles, each once whatever the order of its corners.
#[derive(Default)]
pub(super) struct Unique {
    pub(super) triangles: Vec<[u32; 3]>,
    known: HashSet<[u32; 3]>,
}

impl Unique {
    pub(super) fn add(&mut self, triangle: [u32; 3]) {
        let mut sorted = triangle;
        sorted.sort_unstable();
        if self.known.insert(sorted) {
            self.triangles.push(triangle);
        }
    }

    /// Triangles of a polygon whose corners may be in any order.
    fn polygon(&mut self, mut corners: Vec<u32>, normal: DVec3, seeds: &[DVec3]) {
        if corners.len() < 3 {
            return;
        }
        let at = |corner: u32| seeds[corner as usize];
        let centre = corners.iter().map(|&c| at(c)).sum::<DVec3>() / corners.len() as f64;
        let (x, y) = normal.normalize_or(DVec3::Z).any_orthonormal_pair();
        let angle = |corner: u32| (at(corner) - centre).dot(y).atan2((at(corner) - centre).dot(x));
        corners.sort_by(|&a, &b| angle(a).total_cmp(&angle(b)));
        self.fan(corners, seeds);
    }

    /// Triangles of a polygon, counter-clockwise; a quadrilateral has its shorter diagonal.
    pub(super) fn fan(&mut self, mut corners: Vec<u32>, seeds: &[DVec3]) {
        if let &[a, b, c, d] = &corners[..] {
            let length = |a: u32, b: u32| seeds[a as usize].distance_squared(seeds[b as usize]);
            if length(b, d) < length(a, c) {
                corners.rotate_left(1);
            }
        }
        for pair in corners.windows(2).skip(1) {
            self.add([corners[0], pair[0], pair[1]]);
        }
    }
}

/// Calls `found` for each voxel that a triangle touches; units of a voxel.
fn touched(corners: [DVec3; 3], n: u32, mut found: impl FnMut([u32; 3])) {
    let [a, b, c] = corners;
    let normal = (b - a).cross(c - a);
    let along = normal.abs().to_array();
    let k = (0..3).max_by(|&i, &j| along[i].total_cmp(&along[j])).unwrap_or(0);
    let (i, j) = ((k + 1) % 3, (k + 2) % 3);
    let (low, high) = (a.min(b).min(c), a.max(b).max(c));
    let most = f64::from(n - 1);
    // A whole number is in the voxels on both sides.
    let first = |x: f64| (x.ceil() - 1.0).clamp(0.0, most) as u32;
    let last = |x: f64| x.floor().clamp(0.0, most) as u32;
    let (si, sj) = (normal[i] / normal[k], normal[j] / normal[k]);
    // Over a column of voxels the plane is within this of its height in the middle, and rounding.
    let half = 0.5 * (si.abs() + sj.abs()) + 1e-6;
    for u in first(low[i])..=last(high[i]) {
        for v in first(low[j])..=last(high[j]) {
            let middle = a[k] - si * (f64::from(u) + 0.5 - a[i]) - sj * (f64::from(v) + 0.5 - a[j]);
            let (from, to) = ((middle - half).max(low[k]), (middle + half).min(high[k]));
            for w in first(from)..=last(to) {
                let mut at = [0; 3];
                (at[i], at[j], at[k]) = (u, v, w);
                if touches(corners, at) {
                    found(at);
                }
            }
        }
    }
}

/// Whether a triangle and a closed voxel have a point in common; units of a voxel.
fn touches(corners: [DVec3; 3], at: [u32; 3]) -> bool {
    let centre = DVec3::from_array(at.map(|x| f64::from(x) + 0.5));
    let [a, b, c] = corners.map(|p| p - centre);
    let apart = |axis: DVec3| {
        let [p, q, r] = [a.dot(axis), b.dot(axis), c.dot(axis)];
        let reach = 0.5 * (axis.x.abs() + axis.y.abs() + axis.z.abs());
        p.min(q).min(r) > reach || p.max(q).max(r) < -reach
    };
    let edges = [b - a, c - b, a - c];
    !DVec3::AXES.iter().any(|&axis| apart(axis) || edges.iter().any(|edge| apart(edge.cross(axis))))
        && !apart(edges[0].cross(edges[1]))
}

/// Area, first and second moments of what of a triangle is in a voxel; units of a voxel.
fn within(corners: [DVec3; 3], at: [u32; 3]) -> [f64; 5] {
    let low = DVec3::from_array(at.map(f64::from));
    let (mut polygon, mut next) = (corners.to_vec(), Vec::new());
    for axis in 0..3 {
        for (sign, bound) in [(1.0, low[axis]), (-1.0, -low[axis] - 1.0)] {
            let inside = |p: &DVec3| sign * p[axis] - bound;
            next.clear();
            for (m, p) in polygon.iter().enumerate() {
                let q = &polygon[(m + 1) % polygon.len()];
                let (dp, dq) = (inside(p), inside(q));
                if dp >= 0.0 {
                    next.push(*p);
                }
                if (dp > 0.0 && dq < 0.0) || (dp < 0.0 && dq > 0.0) {
                    next.push(p.lerp(*q, dp / (dp - dq)));
                }
            }
            std::mem::swap(&mut polygon, &mut next);
        }
    }
    let mut sums = [0.0; 5];
    for pair in polygon.windows(2).skip(1) {
        let [a, b, c] = [polygon[0], pair[0], pair[1]];
        let area = 0.5 * (b - a).cross(c - a).length();
        let sum = a + b + c;
        let squares = a.length_squared() + b.length_squared() + c.length_squared();
        let part = [1.0, sum.x / 3.0, sum.y / 3.0, sum.z / 3.0, (squares + sum.length_squared()) / 12.0];
        sums.iter_mut().zip(part).for_each(|(total, part)| *total += area * part);
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::mesh::shapes::Shape;

    /// The squared distance from a voxel to a triangle by subdivision: an upper bound that gets close to it.
    fn distance(corners: [DVec3; 3], at: [u32; 3], depth: u32) -> f64 {
        let low = DVec3::from_array(at.map(f64::from));
        let of = |p: DVec3| p.distance_squared(p.clamp(low, low + DVec3::ONE));
        let parts = 1 << depth;
        let points = (0..=parts).flat_map(|i| (0..=parts - i).map(move |j| (i, j)));
        let share = 1.0 / f64::from(parts);
        let [a, b, c] = corners;
        let point = |(i, j): (i32, i32)| a + (b - a) * (f64::from(i) * share) + (c - a) * (f64::from(j) * share);
        points.map(|at| of(point(at))).fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn touched_voxels_are_those_of_brute_force() {
        let random = |k: u32| ((f64::from(k) * 12.9898).sin() * 43758.5453).rem_euclid(1.0);
        for case in 0..40u32 {
            let size = if case % 2 == 0 { 6.0 } else { 1.5 };
            let point = |m: u32| {
                let x: [f64; 3] = std::array::from_fn(|axis| random(case * 31 + m * 7 + axis as u32) * size + 1.0);
                // Every fourth triangle has corners of voxels.
                DVec3::from_array(if case % 4 == 0 { x.map(f64::round) } else { x })
            };
            let corners = [point(0), point(1), point(2)];
            if (corners[1] - corners[0]).cross(corners[2] - corners[0]).length() < 1e-3 {
                continue;
            }
            let mut found = HashSet::new();
            touched(corners, 9, |at| assert!(found.insert(at), "{at:?} twice"));
            for code in 0..9u32.pow(3) {
                let at = [code % 9, code / 9 % 9, code / 81];
                let near = distance(corners, at, 6);
                // A point of the triangle is in it, or samples come nowhere near.
                assert!(near > 0.0 || found.contains(&at), "{case}: {at:?} is touched");
                assert!(near < 0.02 || !found.contains(&at), "{case}: {at:?} is {near} away");
            }
        }
    }

    #[test]
    fn parts_add_up_to_the_surface() {
        for shape in [Shape::Sphere, Shape::Genus(2), Shape::Plane, Shape::Square] {
            let surface = Surface::new(&shape.build(300), None).unwrap();
            for n in [8, 31] {
                let voxels = Voxels::new(&surface, Grid::new(&surface, n));
                let area: f64 = voxels.parts.iter().map(|part| part.area).sum();
                assert!((area / surface.area() - 1.0).abs() < 1e-9, "{shape}: {area}");
                let points = super::super::sums::Points::new(surface.area(), voxels.parts.iter().copied());
                let mut out = geometry::rvd::CellSums::default();
                points.add_up(|_| 0, &[DVec3::ZERO], &mut out);
                let mut exact = [0.0; 4];
                for f in 0..surface.facets().len() as u32 {
                    let [a, b, c] = surface.corners(f);
                    let squares = a.length_squared() + b.length_squared() + c.length_squared();
                    let second = (squares + (a + b + c).length_squared()) / 12.0;
                    let centroid = surface.centroid(f);
                    let sums = [centroid.x, centroid.y, centroid.z, second];
                    exact.iter_mut().zip(sums).for_each(|(sum, part)| *sum += surface.facet_area(f) * part);
                }
                let moment = DVec3::new(exact[0], exact[1], exact[2]);
                assert!(out.moment[0].distance(moment) < 1e-6 * surface.area(), "{shape}: {moment}");
                assert!((out.energy[0] / exact[3] - 1.0).abs() < 1e-5, "{shape}: {} {}", out.energy[0], exact[3]);
            }
        }
    }

    #[test]
    fn layers_are_on_all_sides() {
        let surface = Surface::new(&Shape::Square.build(2), None).unwrap();
        let grid = Grid::new(&surface, 16);
        let thin = Voxels::new(&surface, grid);
        let flat: BTreeSet<u32> = thin.codes.iter().map(|&code| grid.at(code)[2]).collect();
        assert_eq!((thin.codes.len(), flat.len()), (14 * 14, 1));
        let thick = thin.widened(1);
        assert_eq!(thick.codes.len(), 16 * 16 * 3);
        let area: f64 = thick.parts.iter().map(|part| part.area).sum();
        assert!((area / surface.area() - 1.0).abs() < 1e-9);
    }
}
