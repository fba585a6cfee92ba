//! Surfaces with curves, and what is found on them.
#![allow(dead_code)]

use geometry::mesh::features::{CurveKind, FeatureError, FeatureOptions, Features};
use glam::{DVec3, dvec3};
use tessera::mesh::TriMesh;
use tessera::token::Token;

pub fn creases_above(crease_angle_deg: f64) -> FeatureOptions {
    FeatureOptions { crease_angle_deg, turn_reach: 0.05, ..FeatureOptions::default() }
}

pub fn find(mesh: &TriMesh, options: &FeatureOptions) -> Result<Features, FeatureError> {
    Features::find(mesh, mesh.positions(), options, &Token::default())
}

/// (boundaries, creases, corners).
pub fn counts(features: &Features) -> (usize, usize, usize) {
    let of = |kind| features.curves.iter().filter(|c| c.kind == kind).count();
    (of(CurveKind::Boundary), of(CurveKind::Crease), features.corners.len())
}

pub fn length(mesh: &TriMesh, vertices: &[u32]) -> f64 {
    vertices.windows(2).map(|w| mesh.positions()[w[0] as usize].distance(mesh.positions()[w[1] as usize])).sum()
}

/// A prism over a polygon in the plane, counter-clockwise, in `layers` layers; each side is divided so that its
/// parts are about `step` long. `lids` are the triangles of the polygon's corners that fill it.
pub fn prism(polygon: &[(f64, f64)], lids: &[[usize; 3]], step: f64, height: f64) -> TriMesh {
    let mut soup: Vec<[DVec3; 3]> = Vec::new();
    let at = |k: usize, z: f64| dvec3(polygon[k % polygon.len()].0, polygon[k % polygon.len()].1, z);
    for &[a, b, c] in lids {
        soup.push([at(a, height), at(b, height), at(c, height)]);
        soup.push([at(a, 0.0), at(c, 0.0), at(b, 0.0)]);
    }
    for k in 0..polygon.len() {
        let [a, b] = [at(k, 0.0), at(k + 1, 0.0)];
        let [c, d] = [at(k + 1, height), at(k, height)];
        soup.extend([[a, b, c], [a, c, d]]);
    }
    // Halving all edges keeps neighbours matched; midpoints are the same bits from either side.
    let mut longest = soup.iter().map(|t| t[0].distance(t[1])).fold(0.0, f64::max);
    while longest > step {
        soup = soup
            .into_iter()
            .flat_map(|[a, b, c]| {
                let (ab, bc, ca) = (0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a));
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            })
            .collect();
        longest *= 0.5;
    }
    indexed(&soup)
}

/// Triangles that share the vertices that are the same.
fn indexed(soup: &[[DVec3; 3]]) -> TriMesh {
    let mut numbers = std::collections::HashMap::new();
    let mut positions = Vec::new();
    let mut facets = Vec::new();
    for t in soup {
        facets.push(t.map(|p| {
            *numbers.entry(p.to_array().map(f64::to_bits)).or_insert_with(|| {
                positions.push(p);
                positions.len() as u32 - 1
            })
        }));
    }
    TriMesh::new(positions, facets).unwrap()
}

/// 2 by 2 without a quarter, 1 high: 18 straight creases, 12 corners.
pub fn l_shape() -> TriMesh {
    let polygon = [(0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (1.0, 1.0), (1.0, 2.0), (0.0, 2.0)];
    prism(&polygon, &[[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]], 0.15, 1.0)
}

/// An open cylinder of radius 1 and height 2, `n` facets around.
pub fn tube(n: u32, layers: u32) -> TriMesh {
    let mut positions = Vec::new();
    for j in 0..=layers {
        for i in 0..n {
            let a = f64::from(i) / f64::from(n) * std::f64::consts::TAU;
            positions.push(dvec3(a.cos(), a.sin(), 2.0 * f64::from(j) / f64::from(layers)));
        }
    }
    let vertex = |i: u32, j: u32| j * n + i % n;
    let mut facets = Vec::new();
    for j in 0..layers {
        for i in 0..n {
            facets.push([vertex(i, j), vertex(i + 1, j), vertex(i + 1, j + 1)]);
            facets.push([vertex(i, j), vertex(i + 1, j + 1), vertex(i, j + 1)]);
        }
    }
    TriMesh::new(positions, facets).unwrap()
}

/// The unit disk in rings of `n` vertices.
pub fn disk(n: u32, rings: u32) -> TriMesh {
    let mut positions = vec![DVec3::ZERO];
    for j in 1..=rings {
        for i in 0..n {
            let a = f64::from(i) / f64::from(n) * std::f64::consts::TAU;
            positions.push(dvec3(a.cos(), a.sin(), 0.0) * (f64::from(j) / f64::from(rings)));
        }
    }
    let vertex = |i: u32, j: u32| 1 + (j - 1) * n + i % n;
    let mut facets: Vec<[u32; 3]> = (0..n).map(|i| [0, vertex(i, 1), vertex(i + 1, 1)]).collect();
    for j in 1..rings {
        for i in 0..n {
            facets.push([vertex(i, j), vertex(i, j + 1), vertex(i + 1, j + 1)]);
            facets.push([vertex(i, j), vertex(i + 1, j + 1), vertex(i + 1, j)]);
        }
    }
    TriMesh::new(positions, facets).unwrap()
}

/// Two squares that meet at the line x = 0 at an angle, each 1 wide; `n` cells a side.
pub fn fold(degrees: f64, n: u32) -> TriMesh {
    let slope = degrees.to_radians();
    let place = |i: u32, j: u32| {
        let (x, y) = (f64::from(i) / f64::from(n) - 1.0, f64::from(j) / f64::from(n));
        if x > 0.0 { dvec3(x * slope.cos(), y, x * slope.sin()) } else { dvec3(x, y, 0.0) }
    };
    let mut positions = Vec::new();
    (0..=n).for_each(|j| positions.extend((0..=2 * n).map(|i| place(i, j))));
    let vertex = |i: u32, j: u32| j * (2 * n + 1) + i;
    let mut facets = Vec::new();
    for j in 0..n {
        for i in 0..2 * n {
            facets.push([vertex(i, j), vertex(i + 1, j), vertex(i + 1, j + 1)]);
            facets.push([vertex(i, j), vertex(i + 1, j + 1), vertex(i, j + 1)]);
        }
    }
    TriMesh::new(positions, facets).unwrap()
}

/// A sheet, 2 by 1, with a slit through its middle, its rims in small teeth.
pub fn slit(n: u32) -> TriMesh {
    let tooth = |i: u32, j: u32| {
        let rim = (n / 2..=n / 2 + 1).contains(&j) && (n / 2..=3 * n / 2).contains(&i);
        if rim { 0.3 * f64::from(i * 7 % 5) / 4.0 - 0.15 } else { 0.0 }
    };
    let place = |i: u32, j: u32| dvec3(f64::from(i), f64::from(j) + tooth(i, j), 0.0) / f64::from(n);
    let positions = (0..=n).flat_map(|j| (0..=2 * n).map(move |i| place(i, j))).collect();
    let vertex = |i: u32, j: u32| j * (2 * n + 1) + i;
    let open = |i: u32, j: u32| j == n / 2 && (n / 2..3 * n / 2).contains(&i);
    let cells = (0..n).flat_map(|j| (0..2 * n).map(move |i| (i, j))).filter(|&(i, j)| !open(i, j));
    let facets = cells.flat_map(|(i, j)| {
        let [a, b, c, d] = [vertex(i, j), vertex(i + 1, j), vertex(i + 1, j + 1), vertex(i, j + 1)];
        [[a, b, c], [a, c, d]]
    });
    TriMesh::new(positions, facets.collect()).unwrap()
}
