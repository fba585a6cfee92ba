//! A surface as the density sees it: welded vertices, the edges between them, areas.
//!
//! Purpose: [`Net`] is built once, for curvature, feature size and gradation.
//! Invariant: positions are relative to the longest side of the bounding box, so that no units overflow; a class of coincident
//! vertices is known by its lowest vertex; order depends on the mesh alone. The same bits with any number of threads.
//! Must not know: where sizes come from.

use std::ops::Range;

use glam::DVec3;
use rayon::prelude::*;

use super::outline::Outline;
use crate::mesh::TriMesh;
use crate::mesh::adjacency::{Adjacency, EdgeKind};
use crate::token::{Stopped, Token};

/// Places are the same in units of this part of the extent: moved there and back, they are off by rounding.
const SAME_PLACE: f64 = 1e-9;

/// See the module's head.
#[derive(Clone, Debug)]
pub struct Net {
    pub(super) outline: Outline,
    /// Caller's coordinates of the box's lower corner.
    pub(super) low: DVec3,
    /// Lowest vertex at the same position, for each vertex.
    pub(super) class: Vec<u32>,
    /// In the box of side 1; zero for vertices that no facet uses.
    pub(super) points: Vec<DVec3>,
    /// Facets that have an area, by class, with that area.
    pub(super) facets: Vec<([u32; 3], f64)>,
    /// Boundary edges, by class.
    pub(super) boundary: Vec<[u32; 2]>,
    /// A third of the area of each class's facets; 0 for a vertex that is not its class's lowest.
    pub(super) area: Vec<f64>,
    /// First entry of each vertex in `ends`, and one more.
    starts: Vec<u32>,
    /// Other end and length of each edge, both ways. Facets without area have edges too.
    ends: Vec<(u32, f64)>,
}

impl Net {
    /// Reads `mesh`.
    pub fn new(mesh: &TriMesh, token: &Token) -> Result<Self, Stopped> {
        let adjacency = Adjacency::unless(mesh, token)?;
        let outline = Outline::of(mesh, &adjacency, token)?;
        token.check()?;
        let class = adjacency.representative().to_vec();
        let (low, _) = mesh.bounds();
        let vertices = mesh.positions().len();
        let mut points = vec![DVec3::ZERO; vertices];
        for &v in mesh.facets().iter().flatten() {
            let point = (mesh.positions()[v as usize] - low) / outline.extent;
            (points[v as usize], points[class[v as usize] as usize]) = (point, point);
        }
        let mut facets = Vec::with_capacity(mesh.facets().len());
        let mut area = vec![0.0; vertices];
        let mut boundary = Vec::new();
        let mut edges: Vec<(u32, u32)> = Vec::with_capacity(6 * mesh.facets().len());
        token.check()?;
        for (f, corners) in mesh.facets().iter().enumerate() {
            token.check_at(f)?;
            let v = corners.map(|c| class[c as usize]);
            for e in 0..3 {
                let (from, to) = (v[e], v[(e + 1) % 3]);
                if from != to {
                    edges.extend([(from, to), (to, from)]);
                }
                if adjacency.kind(3 * f + e) == EdgeKind::Boundary {
                    boundary.push([from, to]);
                }
            }
            if mesh.is_degenerate(f) {
                continue;
            }
            let [a, b, c] = v.map(|v| points[v as usize]);
            let size = 0.5 * (b - a).cross(c - a).length();
            v.iter().for_each(|&v| area[v as usize] += size / 3.0);
            facets.push((v, size));
        }
        token.check()?;
        edges.par_sort_unstable();
        edges.dedup();
        token.check()?;
        let mut starts = vec![0u32; vertices + 1];
        edges.iter().for_each(|&(from, _)| starts[from as usize + 1] += 1);
        (0..vertices).for_each(|v| starts[v + 1] += starts[v]);
        token.check()?;
        let length = |(from, to): (u32, u32)| (points[from as usize] - points[to as usize]).length();
        let ends = edges.iter().map(|&edge| (edge.1, length(edge))).collect();
        Ok(Self { outline, low, class, points, facets, boundary, area, starts, ends })
    }

    /// Area, boundary and χ.
    pub fn outline(&self) -> &Outline {
        &self.outline
    }

    pub(super) fn vertices(&self) -> usize {
        self.class.len()
    }

    /// Vertices across an edge from `v` (lowest of its class), with distances.
    pub(super) fn neighbours(&self, v: usize) -> &[(u32, f64)] {
        let Range { start, end } = self.starts[v] as usize..self.starts[v + 1] as usize;
        &self.ends[start..end]
    }

    /// Boundary edges, by class. Edges along which a surface was divided are not of its boundary: there is another
    /// in the same place, where `place` says that each vertex was (caller's units).
    pub(super) fn rims(&self, place: impl Fn(usize) -> DVec3) -> Vec<[u32; 2]> {
        let unit = self.outline.extent * SAME_PLACE;
        let place = |v: u32| ((place(v as usize) - self.low) / unit).round().to_array().map(|x| x as i64);
        let undirected = |a: [i64; 3], b: [i64; 3]| [a.min(b), a.max(b)];
        let mut edges: Vec<_> = self.boundary.iter().map(|&[a, b]| (undirected(place(a), place(b)), [a, b])).collect();
        edges.sort_unstable();
        let alone = edges.chunk_by(|a, b| a.0 == b.0).filter(|edges| edges.len() == 1);
        alone.map(|edges| edges[0].1).collect()
    }

    /// Mean length of an edge, in units of the extent.
    pub(super) fn mean_edge(&self) -> f64 {
        self.ends.iter().map(|end| end.1).sum::<f64>() / self.ends.len().max(1) as f64
    }

    /// How short the edges around each vertex are, in units of the extent: the edge of an equilateral triangle that is as
    /// high as a middle one of the facets there, the lower one of two. A sliver among others does not count, nor do large
    /// facets beside as many small ones. Infinite where no facet has area.
    pub(super) fn resolution(&self) -> Vec<f64> {
        let mut heights: Vec<(u32, f64)> = Vec::with_capacity(3 * self.facets.len());
        for &(corners, area) in &self.facets {
            let [a, b, c] = corners.map(|v| self.points[v as usize]);
            let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
            heights.extend(corners.map(|v| (v, 2.0 * area / longest)));
        }
        heights.par_sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
        let mut edges = vec![f64::INFINITY; self.vertices()];
        for around in heights.chunk_by(|a, b| a.0 == b.0) {
            let (v, height) = around[(around.len() - 1) / 2];
            edges[v as usize] = height * (2.0 / 3f64.sqrt());
        }
        (0..edges.len()).map(|v| edges[self.class[v] as usize]).collect()
    }

    /// The value that half of the area has at most. Vertices without area have no say.
    pub(super) fn median(&self, values: &[f64]) -> f64 {
        let mut order: Vec<u32> = (0..values.len() as u32)
            .filter(|&v| self.area[v as usize] > 0.0 && values[v as usize].is_finite())
            .collect();
        order.sort_unstable_by(|&a, &b| values[a as usize].total_cmp(&values[b as usize]).then(a.cmp(&b)));
        let half = 0.5 * order.iter().map(|&v| self.area[v as usize]).sum::<f64>();
        let mut sum = 0.0;
        let middle = order.iter().find(|&&v| {
            sum += self.area[v as usize];
            sum >= half
        });
        middle.map_or(f64::NAN, |&v| values[v as usize])
    }

    /// Values at some vertices, the least of each place, by vertex: NaN where there is none.
    pub(super) fn by_vertex(&self, values: &[(u32, f64)]) -> Vec<f64> {
        if values.is_empty() {
            return Vec::new();
        }
        let mut all = vec![f64::NAN; self.vertices()];
        for &(v, value) in values {
            let lowest = self.class[v as usize] as usize;
            all[lowest] = all[lowest].min(value);
        }
        (0..all.len()).map(|v| all[self.class[v] as usize]).collect()
    }

    /// Gives every vertex the value of its class, and `other` to those that no facet with area uses.
    pub(super) fn spread(&self, values: &mut [f64], other: f64) {
        for v in 0..values.len() {
            let lowest = self.class[v] as usize;
            values[v] = if self.neighbours(lowest).is_empty() { other } else { values[lowest] };
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn edges_along_which_a_surface_was_divided_are_no_rims() {
        // A triangle, and two of its copies moved aside.
        let copies = |count: u32| {
            let points =
                (0..3 * count).map(|v| f64::from(v / 3) * 0.7 * DVec3::Z + DVec3::AXES[v as usize % 3]).collect();
            TriMesh::new(points, (0..count).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect()).unwrap()
        };
        for (count, alone) in [(1, 3), (2, 0), (3, 0)] {
            let mesh = copies(count);
            let net = Net::new(&mesh, &Token::default()).unwrap();
            assert_eq!(net.rims(|v| mesh.positions()[v]).len(), 3 * count as usize);
            // Off by rounding.
            let before = |v: usize| mesh.positions()[v] - (v / 3) as f64 * (0.7 + 1e-15) * DVec3::Z;
            assert_eq!(net.rims(before).len(), alone);
        }
    }

    #[test]
    fn a_sliver_says_nothing_of_how_short_edges_are_and_small_facets_more_than_large_ones() {
        // A fan of unit facets about the first vertex, two of which are parted by a sliver.
        let at = |degrees: f64| DVec3::from((glam::DVec2::from_angle(degrees.to_radians()), 0.0));
        let fan = |angles: &[f64]| {
            let points = std::iter::once(DVec3::ZERO).chain(angles.iter().map(|&a| at(a))).collect();
            let facets = (1..angles.len() as u32).map(|k| [0, k, k + 1]).collect();
            TriMesh::new(points, facets).unwrap()
        };
        let of_first = |mesh: &TriMesh| {
            let net = Net::new(mesh, &Token::default()).unwrap();
            net.resolution()[0] * net.outline.extent
        };
        let even = [0.0, 60.0, 120.0, 180.0, 240.0];
        assert!((of_first(&fan(&even)) - 1.0).abs() < 1e-12);
        assert!((of_first(&fan(&[0.0, 60.0, 120.0, 120.1, 180.0, 240.0])) - 1.0).abs() < 1e-12);
        // Two small facets, two ten times as large: a seam of a fine part and a coarse one.
        let mut points = fan(&even).into_parts().0;
        points.extend([180.0, 240.0, 300.0].map(|angle| 10.0 * at(angle)));
        let seam = TriMesh::new(points, vec![[0, 1, 2], [0, 2, 3], [0, 6, 7], [0, 7, 8]]).unwrap();
        assert!(of_first(&seam) < 1.01, "{}", of_first(&seam));
        // A vertex that no facet uses.
        let mesh = TriMesh::new(vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z], vec![[0, 1, 2]]).unwrap();
        assert_eq!(Net::new(&mesh, &Token::default()).unwrap().resolution()[3], f64::INFINITY);
    }
}
