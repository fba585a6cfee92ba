//! A metric on a surface.
//!
//! Purpose: [`MetricField`] finds the point of a surface closest to a given one, with the metric there: the exponential of the
//! linear interpolation of the corners' logarithms. [`length`] and [`quality`] measure edges and facets between such points, and
//! [`MetricFigures`] all of a triangulation's. Invariant: coordinates are those of the surface; the same bits with any number
//! of threads. Must not know: how a triangulation is made.

use glam::DVec3;
use rayon::prelude::*;
use serde::Serialize;

use super::TriMesh;
use super::closest_point::{ClosestPoint, SurfacePoint};
use super::edges::{sides, undirected};
use super::tensor::Tensor;
use crate::tasks;
use crate::token::{Stopped, Token};

/// See the module's head.
pub struct MetricField {
    facets: Vec<[u32; 3]>,
    /// Unit normals of the facets, or zero.
    normals: Vec<DVec3>,
    closest: ClosestPoint,
    logarithms: Vec<Tensor>,
    /// Added to the logarithms' eigenvalues.
    shift: f64,
}

/// A point, and the metric there.
#[derive(Clone, Copy, Debug, Default)]
pub struct Site {
    /// In the coordinates of the field's surface.
    pub position: DVec3,
    /// Its metric.
    pub tensor: Tensor,
}

impl MetricField {
    /// `tensors` are those of the vertices of `mesh`, one for each and positive definite.
    pub fn new(mesh: &TriMesh, tensors: &[Tensor], token: &Token) -> Result<Self, Stopped> {
        let closest = ClosestPoint::unless(mesh, token)?;
        let logarithms = tasks::map(tensors.len(), |v| tensors[v].ln());
        let facets = mesh.facets().to_vec();
        let normals = tasks::map(facets.len(), |f| normal(mesh.corners(f)));
        token.check()?;
        Ok(Self { facets, normals, closest, logarithms, shift: 0.0 })
    }

    /// Makes all lengths so many times as large.
    pub fn scale(&mut self, factor: f64) {
        self.shift += 2.0 * factor.ln();
    }

    /// The closest point of the surface.
    pub fn site(&self, p: DVec3) -> Site {
        let SurfacePoint { position, facet, barycentric } = self.closest.project(p);
        let corners = self.facets[facet as usize];
        let of = |v: u32| self.logarithms.get(v as usize).copied().unwrap_or_default();
        let mean = corners.iter().zip(barycentric).fold(Tensor::default(), |sum, (&v, share)| sum + of(v) * share);
        Site { position, tensor: mean.shifted(self.shift).exp() }
    }

    /// A point that stays where it is, with the metric of the closest one.
    pub fn at(&self, p: DVec3) -> Site {
        Site { position: p, ..self.site(p) }
    }

    /// [`MetricField::at`] each of these points.
    pub fn sites(&self, points: &[DVec3], token: &Token) -> Result<Vec<Site>, Stopped> {
        tasks::try_map(points.len(), || (), |(), k| token.check_at(k).map(|()| self.at(points[k])))
    }

    /// The cosine between the normal of a facet and that of the surface where the facet's centroid is nearest.
    pub fn facing(&self, corners: [DVec3; 3]) -> f64 {
        let near = self.closest.project(corners.iter().sum::<DVec3>() / 3.0);
        normal(corners).dot(self.normals[near.facet as usize])
    }
}

/// The unit normal; zero for a facet without area.
fn normal([a, b, c]: [DVec3; 3]) -> DVec3 {
    /// A smaller sine between two sides is rounding, and its direction is none.
    const LEAST_SINE: f64 = 1e-9;
    let cross = (b - a).normalize_or_zero().cross((c - a).normalize_or_zero());
    if cross.length() < LEAST_SINE { DVec3::ZERO } else { cross.normalize() }
}

/// Length of an edge between two sites, by their metrics: exact where the logarithm of the length changes evenly along the edge.
pub fn length(a: &Site, b: &Site) -> f64 {
    let edge = b.position - a.position;
    let (u, v) = (a.tensor.length(edge), b.tensor.length(edge));
    let ratio = v / u;
    // An edge without length has no ratio.
    if u.min(v) <= 0.0 || (ratio - 1.0).abs() < EVEN { 0.5 * (u + v) } else { (v - u) / ratio.ln() }
}

/// Lengths at both ends that differ by less than this share are taken as even: the formula would lose its digits.
const EVEN: f64 = 1e-3;

/// Shape of a facet in the mean metric of its corners: 4√3 times its area over the sum of its squared sides, 1 at best.
pub fn quality([a, b, c]: [&Site; 3]) -> f64 {
    let mean = (a.tensor + b.tensor + c.tensor) * (1.0 / 3.0);
    let (u, v) = (b.position - a.position, c.position - a.position);
    let (uu, uv, vv) = (mean.product(u, u), mean.product(u, v), mean.product(v, v));
    let sum = 2.0 * (uu + vv - uv);
    // No facet without sides has a shape.
    if sum > 0.0 { 2.0 * 3f64.sqrt() * (uu * vv - uv * uv).max(0.0).sqrt() / sum } else { 0.0 }
}

/// Area of a facet in the mean metric of its corners.
pub(crate) fn area([a, b, c]: [&Site; 3]) -> f64 {
    let mean = (a.tensor + b.tensor + c.tensor) * (1.0 / 3.0);
    0.5 * mean.parallelogram(b.position - a.position, c.position - a.position)
}

/// How near the edges of a triangulation are to length 1 in a metric, and its facets to equilateral triangles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct MetricFigures {
    /// Edges whose length is from 0.71 to 1.41, percent.
    pub unit_edges_percent: f64,
    /// Shortest edge.
    pub edge_least: f64,
    /// Mean of the lengths.
    pub edge_mean: f64,
    /// Longest edge.
    pub edge_largest: f64,
    /// Shape of the worst facet: 4√3 times its area over the sum of its squared sides, 1 at best.
    pub quality_least: f64,
    /// Mean of the shapes.
    pub quality_mean: f64,
}

/// Lengths of unit edges: 1/√2 and √2, to two digits.
const UNIT: std::ops::RangeInclusive<f64> = 0.71..=1.41;

impl MetricFigures {
    /// Measures `mesh`, which lies near the field's surface.
    pub fn of(field: &MetricField, mesh: &TriMesh, token: &Token) -> Result<Self, Stopped> {
        let sites = field.sites(mesh.positions(), token)?;
        let of = |v: u32| &sites[v as usize];
        let mut edges = tasks::flat_map(mesh.facets().len(), |f| sides(mesh.facets()[f]).map(undirected));
        edges.par_sort_unstable();
        edges.dedup();
        token.check()?;
        let lengths: Vec<f64> = tasks::map(edges.len(), |k| length(of(edges[k][0]), of(edges[k][1])));
        let qualities: Vec<f64> = tasks::map(mesh.facets().len(), |f| quality(mesh.facets()[f].map(of)));
        token.check()?;
        let mean = |all: &[f64]| all.iter().sum::<f64>() / all.len().max(1) as f64;
        let least = |all: &[f64]| all.iter().copied().fold(f64::INFINITY, f64::min);
        let unit = lengths.iter().filter(|l| UNIT.contains(*l)).count();
        Ok(Self {
            unit_edges_percent: 100.0 * unit as f64 / lengths.len().max(1) as f64,
            edge_least: least(&lengths),
            edge_mean: mean(&lengths),
            edge_largest: lengths.iter().copied().fold(0.0, f64::max),
            quality_least: least(&qualities),
            quality_mean: mean(&qualities),
        })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::mesh::shapes::Shape;

    #[test]
    fn a_constant_metric_is_the_same_everywhere_and_a_unit_triangle_is_perfect() {
        let axes = [DVec3::new(0.8, 0.6, 0.0), DVec3::new(-0.6, 0.8, 0.0), DVec3::Z];
        let lengths = [0.5, 0.02, 0.1];
        let mesh = Shape::Plane.build(200);
        let tensor = Tensor::of_lengths(axes, lengths);
        let tensors = vec![tensor; mesh.positions().len()];
        let mut field = MetricField::new(&mesh, &tensors, &Token::default()).unwrap();
        let at = |field: &MetricField, x: f64, y: f64| {
            let p = 0.4 * DVec3::X + 0.4 * DVec3::Y + x * lengths[0] * axes[0] + y * lengths[1] * axes[1];
            field.site(p)
        };
        let corners = [at(&field, 0.0, 0.0), at(&field, 1.0, 0.0), at(&field, 0.5, 0.75f64.sqrt())];
        for k in 0..3 {
            assert!((length(&corners[k], &corners[(k + 1) % 3]) - 1.0).abs() < 1e-9);
        }
        assert!((quality([0, 1, 2].map(|k| &corners[k])) - 1.0).abs() < 1e-9);
        assert!(field.facing(corners.map(|c| c.position)) > 0.999);
        field.scale(3.0);
        assert!((length(&at(&field, 0.0, 0.0), &at(&field, 0.0, 1.0)) - 3.0).abs() < 1e-9);
    }

    #[test]
    fn lengths_along_an_edge_are_integrated() {
        let site = |x: f64, h: f64| Site { position: x * DVec3::X, tensor: Tensor::of_length(h) };
        // Lengths 1/h from 1 to 8: the integral of 8^x is 7 / ln 8.
        assert!((length(&site(0.0, 1.0), &site(1.0, 0.125)) - 7.0 / 8f64.ln()).abs() < 1e-12);
        let even = length(&site(0.0, 1.0), &site(1.0, 1.0 / 1.0009));
        assert!((even - 1.000_45).abs() < 1e-7);
    }
}
