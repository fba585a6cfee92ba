//! How much work a surface makes, before it is done.
//!
//! Purpose: [`Expected::of`] finds how many points a density implies and how many cells its facets meet, from areas and lengths
//! alone. Invariant: linear in the facets. Figures are estimates: within a factor of two for spread points.
//! Must not know: memory, seconds.

use glam::DVec3;

use super::outline::POINTS_PER_AREA;
use super::{Count, DensityOptions, DensitySource};
use crate::mesh::TriMesh;
use crate::mesh::parts::Part;
use crate::token::{Stopped, Token};

/// Cells of a spread of one seed per unit of volume that a line of unit length crosses (1.455 for random ones).
const PER_LENGTH: f64 = 1.46;
/// Cells of such a spread that meet a unit of area. Of soups of random facets, 1,000 to 10,000 with 2,000 points.
const PER_AREA: f64 = 2.5;
/// The same pairs, of well-shaped facets with even points: each facet, so many for the square root of facets times points, and
/// so many for a point.
const USUAL: [f64; 2] = [3.25, 2.4];
/// A surface has needles or crowded sheets if it has this many times the usual pairs.
const UNUSUAL: f64 = 2.0;

/// What a surface and a density make one expect.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Expected {
    /// Points, at least 1 and at most as options allow.
    pub points: usize,
    /// Pairs of a facet and a cell that meet, beyond twice those of well-shaped facets: of needles, fans and soups.
    pub extra_pairs: u64,
    /// Whether sheets are nearer to one another than points, so that cells have neighbours all around.
    pub is_crowded: bool,
}

impl Expected {
    /// Looks at `mesh`. A surface that is of no use has no extra pairs.
    pub fn of(mesh: &TriMesh, options: &DensityOptions, count: Count, token: &Token) -> Result<Self, Stopped> {
        let (low, high) = mesh.bounds();
        let extent = (high - low).max_element();
        let sizes = match &options.source {
            DensitySource::Sizes(sizes) if sizes.len() == mesh.positions().len() => Some(sizes),
            _ => None,
        };
        // In the box of side 1: the area of a facet, and half its length around.
        let sizes_of = |f: usize| {
            let [a, b, c] = mesh.corners(f).map(|p| (p - low) / extent);
            let around = (b - a).length() + (c - b).length() + (a - c).length();
            (0.5 * (b - a).cross(c - a).length(), 0.5 * around)
        };
        let (mut area, mut implied) = (0.0, 0.0);
        for (f, facet) in mesh.facets().iter().enumerate() {
            token.check_at(f)?;
            let (own, _) = sizes_of(f);
            area += own;
            let least = |sizes: &Vec<f64>| facet.iter().map(|&v| sizes[v as usize]).fold(f64::INFINITY, f64::min);
            // At most what lies in zones, each of which is as large as it may be in a plane. A region may be all of the surface.
            for zone in &options.zones {
                let within = zone.part.most_area() / extent / extent;
                let touched = !within.is_finite() || touches(&zone.part, mesh.corners(f));
                let length = zone.length / extent;
                implied += if touched { POINTS_PER_AREA * own.min(within) / length / length } else { 0.0 };
            }
            let edge = options.edge_length.or_else(|| sizes.map(least)).unwrap_or(f64::INFINITY) / extent;
            implied += POINTS_PER_AREA * own / edge / edge;
        }
        let points = match count {
            Count::Points(points) => points,
            // A number that is no number is none at all.
            Count::Implied => implied as usize,
        };
        let points = points.clamp(1, options.max_points.max(1));
        let (facets, n) = (mesh.facets().len() as f64, points as f64);
        let edge = (POINTS_PER_AREA * area / n).sqrt();
        let sides = ((high - low) / extent).max(glam::DVec3::splat(edge));
        let (sheets, solid) = (area * edge, sides.element_product());
        let reach = (n / sheets.min(solid)).cbrt();
        let mut pairs = 0.0;
        for f in 0..mesh.facets().len() {
            token.check_at(f)?;
            let (area, length) = sizes_of(f);
            // A facet meets each cell once, however long it is.
            pairs += (1.0 + PER_LENGTH * length * reach + PER_AREA * area * reach * reach).min(n.max(1.0));
        }
        let usual = facets + USUAL[0] * (facets * n).sqrt() + USUAL[1] * n;
        // Neither is a number if there is no area.
        let extra = (pairs - UNUSUAL * usual).max(0.0);
        Ok(Self { points, extra_pairs: if extra.is_finite() { extra as u64 } else { 0 }, is_crowded: solid < sheets })
    }
}

/// Whether a facet may have a point in a box or a ball.
fn touches(part: &Part, [a, b, c]: [DVec3; 3]) -> bool {
    let middle = (a + b + c) / 3.0;
    part.distance(middle) <= middle.distance(a).max(middle.distance(b)).max(middle.distance(c))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::sync::Arc;

    use glam::DVec3;

    use super::*;
    use crate::mesh::sample::sample;
    use crate::mesh::shapes::Shape;
    use crate::rvd::{Backend, CellSums, Serial, SessionOptions, Surface};

    fn pairs(mesh: &TriMesh, points: usize) -> u64 {
        let surface = Arc::new(Surface::new(mesh, None).unwrap());
        let seeds = sample(mesh, None, points, 1);
        let seeds: Vec<DVec3> = seeds.iter().map(|p| surface.frame().to_unit(p.position)).collect();
        let mut session = Serial.session(surface, SessionOptions::new(seeds.len())).unwrap();
        session.set_seeds(&seeds).unwrap();
        session.sums(&mut CellSums::default(), &Token::default()).unwrap().pairs
    }

    fn expected(mesh: &TriMesh, points: usize) -> Expected {
        Expected::of(mesh, &DensityOptions::default(), Count::Points(points), &Token::default()).unwrap()
    }

    #[test]
    fn well_shaped_facets_have_nothing_unusual() {
        for shape in [Shape::Torus, Shape::Sphere, Shape::Plane, Shape::Hills, Shape::Genus(3), Shape::Block] {
            for (facets, points) in [(12, 1000), (1000, 300), (10_000, 1000), (3000, 20_000)] {
                let mesh = shape.build(facets);
                assert_eq!(expected(&mesh, points).extra_pairs, 0, "{shape} {facets} {points}");
            }
        }
    }

    /// A vertex far away makes a few facets long, and no facet meets more cells than there are.
    #[test]
    fn a_facet_meets_no_cell_twice() {
        for distance in [1e3, 1e7, 1e12] {
            let (mut positions, facets) = Shape::Sphere.build(320).into_parts();
            positions[40].y = distance;
            let mesh = TriMesh::new(positions, facets).unwrap();
            let most = 7 * 500 + 320;
            assert!(expected(&mesh, 500).extra_pairs <= most, "{distance:e}");
        }
    }

    #[test]
    fn needles_fans_and_soups_are_expected() {
        let mesh = |corners: Vec<[DVec3; 3]>| {
            let facets = (0..corners.len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect();
            TriMesh::new(corners.into_flattened(), facets).unwrap()
        };
        let fan = |height: f64| {
            let rim = |k: usize| DVec3::new((k as f64 * 0.005).cos(), (k as f64 * 0.005).sin(), 0.0);
            mesh((0..1200).map(|k| [DVec3::Z * height, rim(k), rim(k + 1)]).collect())
        };
        let strip = (0..1000).map(|k| {
            let [a, b] = [k, k + 1].map(|k| f64::from(k) * 0.001);
            [DVec3::new(0.0, a, 0.0), DVec3::new(9.0, a, 0.0), DVec3::new(0.0, b, 0.0)]
        });
        let mut state = 1u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        let soup = (0..300).map(|_| [(); 3].map(|()| DVec3::new(random(), random(), random()))).collect();
        let cases = [("fan", fan(0.0)), ("cone", fan(1.0)), ("strip", mesh(strip.collect())), ("soup", mesh(soup))];
        for (name, mesh) in cases {
            let (facets, n) = (mesh.facets().len() as f64, 1000.0f64);
            let usual = UNUSUAL * (facets + USUAL[0] * (facets * n).sqrt() + USUAL[1] * n);
            let expected = expected(&mesh, 1000);
            let ratio = (expected.extra_pairs as f64 + usual) / pairs(&mesh, 1000) as f64;
            assert!((0.5..=2.0).contains(&ratio) && expected.extra_pairs > 0, "{name}: {ratio}");
            assert_eq!(expected.is_crowded, name == "soup", "{name}");
        }
    }

    #[test]
    fn points_are_those_that_lengths_imply() {
        let mesh = Shape::Sphere.build(5000);
        let even = DensityOptions { edge_length: Some(0.05), ..DensityOptions::default() };
        let sizes = DensityOptions {
            source: DensitySource::Sizes(vec![0.05; mesh.positions().len()]),
            ..DensityOptions::default()
        };
        for options in [even, sizes] {
            let plan = super::super::plan(&mesh, &options, Count::Implied, &Token::default()).unwrap();
            let expected = Expected::of(&mesh, &options, Count::Implied, &Token::default()).unwrap();
            let ratio = expected.points as f64 / plan.points as f64;
            assert!((0.8..=1.25).contains(&ratio), "{ratio}");
        }
    }
}
