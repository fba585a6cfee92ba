//! Surfaces that are no manifolds, or not in one piece.
#![allow(dead_code)]

use glam::{DVec3, dvec3};
use tessera::mesh::TriMesh;
use tessera::mesh::shapes::Shape;

/// Several surfaces as one.
pub fn join(parts: &[&TriMesh]) -> TriMesh {
    let (mut positions, mut facets) = (Vec::new(), Vec::new());
    for part in parts {
        let base = positions.len() as u32;
        positions.extend_from_slice(part.positions());
        facets.extend(part.facets().iter().map(|f| f.map(|v| v + base)));
    }
    TriMesh::new(positions, facets).unwrap()
}

pub fn map(mesh: &TriMesh, to: impl Fn(DVec3) -> DVec3) -> TriMesh {
    TriMesh::new(mesh.positions().iter().map(|&p| to(p)).collect(), mesh.facets().to_vec()).unwrap()
}

/// The same corners with no vertex shared, as an STL file or a textured OBJ has them.
pub fn soup(mesh: &TriMesh) -> TriMesh {
    let positions = (0..mesh.facets().len()).flat_map(|f| mesh.corners(f)).collect();
    TriMesh::new(positions, (0..mesh.facets().len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect()).unwrap()
}

/// Pages that share the spine, an edge with as many facets as there are pages.
pub fn book(pages: u32, side: u32) -> TriMesh {
    let mut positions: Vec<DVec3> = (0..=side).map(|k| DVec3::Z * f64::from(k) / f64::from(side)).collect();
    let mut facets = Vec::new();
    for page in 0..pages {
        let (sin, cos) = (f64::from(page) / f64::from(pages) * std::f64::consts::TAU).sin_cos();
        let base = positions.len() as u32;
        for x in 1..=side {
            for z in 0..=side {
                positions.push(dvec3(cos * f64::from(x), sin * f64::from(x), f64::from(z)) / f64::from(side));
            }
        }
        let at = |x: u32, z: u32| if x == 0 { z } else { base + (x - 1) * (side + 1) + z };
        for (x, z) in (0..side).flat_map(|x| (0..side).map(move |z| (x, z))) {
            facets.push([at(x, z), at(x + 1, z), at(x + 1, z + 1)]);
            facets.push([at(x, z), at(x + 1, z + 1), at(x, z + 1)]);
        }
    }
    TriMesh::new(positions, facets).unwrap()
}

/// A band with half a turn: no orientation at all.
pub fn moebius(length: u32, width: u32) -> TriMesh {
    let mut positions = Vec::new();
    for i in 0..length {
        let turn = f64::from(i) / f64::from(length) * std::f64::consts::TAU;
        for j in 0..=width {
            let s = f64::from(j) / f64::from(width) - 0.5;
            let (half, r) = (0.5 * turn, 1.0 + s * (0.5 * turn).cos());
            positions.push(dvec3(r * turn.cos(), r * turn.sin(), s * half.sin()));
        }
    }
    // The last row is the first one, upside down.
    let at = |i: u32, j: u32| if i == length { width - j } else { i * (width + 1) + j };
    let mut facets = Vec::new();
    for (i, j) in (0..length).flat_map(|i| (0..width).map(move |j| (i, j))) {
        facets.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
        facets.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
    }
    TriMesh::new(positions, facets).unwrap()
}

/// Both sides of a square, sewn together at the rim: closed, and of no thickness.
pub fn pillow(facets: usize) -> TriMesh {
    let (positions, mut facets) = Shape::Plane.build(facets).into_parts();
    let back: Vec<[u32; 3]> = facets.iter().map(|&[a, b, c]| [a, c, b]).collect();
    facets.extend(back);
    TriMesh::new(positions, facets).unwrap()
}

/// The mesh with a point, a segment and three points in a row as facets, and vertices that nobody uses, one of them very far away.
pub fn with_facets_without_area(mesh: &TriMesh) -> TriMesh {
    let (mut positions, mut facets) = mesh.clone().into_parts();
    let first = positions.len() as u32;
    positions.extend([DVec3::ZERO, DVec3::X, DVec3::splat(0.1), DVec3::splat(0.2), DVec3::splat(0.3)]);
    positions.extend([DVec3::splat(1e300), DVec3::splat(-7.0)]);
    facets.extend([[5, 5, 5], [5, 6, 5], [first, first + 1, first], [first + 2, first + 3, first + 4]]);
    TriMesh::new(positions, facets).unwrap()
}

/// 27 copies of a sphere in a cube, three a side.
pub fn spheres(one: &TriMesh) -> TriMesh {
    let place = |k: u32| 3.0 * dvec3(f64::from(k % 3), f64::from(k / 3 % 3), f64::from(k / 9));
    let parts: Vec<TriMesh> = (0..27).map(|k| map(one, |p| p + place(k))).collect();
    join(&parts.iter().collect::<Vec<_>>())
}

/// Two copies of a surface that touch in its top vertex.
pub fn touching(mesh: &TriMesh) -> TriMesh {
    let top = mesh.positions().iter().copied().fold(DVec3::splat(-2.0), |a, b| if b.z > a.z { b } else { a });
    join(&[mesh, &map(mesh, |p| 2.0 * top - p)])
}

/// One facet in `every` turned over.
pub fn turned_over(mesh: &TriMesh, every: usize) -> TriMesh {
    let facets = mesh.facets().iter().enumerate();
    let facets = facets.map(|(f, &[a, b, c])| if f % every == 0 { [a, c, b] } else { [a, b, c] });
    TriMesh::new(mesh.positions().to_vec(), facets.collect()).unwrap()
}

/// [`soup`], whose corners were rounded one by one.
pub fn nearly_one(mesh: &TriMesh) -> TriMesh {
    let corners = mesh.facets().iter().flatten().enumerate();
    let off = |k: usize| DVec3::new(k as f64, (k * k) as f64, (3 * k) as f64).map(f64::sin);
    let places = corners.map(|(k, &v)| mesh.positions()[v as usize] + 1e-8 * off(k)).collect();
    TriMesh::new(places, (0..mesh.facets().len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect()).unwrap()
}

/// The mesh with some facets twice.
pub fn facets_twice(mesh: &TriMesh, which: std::ops::Range<usize>) -> TriMesh {
    let (positions, mut facets) = mesh.clone().into_parts();
    facets.extend_from_within(which);
    TriMesh::new(positions, facets).unwrap()
}

/// A surface and one a millionth of its size.
pub fn with_dust(mesh: &TriMesh) -> TriMesh {
    join(&[mesh, &map(&Shape::Sphere.build(80), |p| p * 1e-6 + DVec3::X * 2.0)])
}

/// T-shaped: a sliver of this altitude between proper facets.
pub fn sliver(altitude: f64) -> TriMesh {
    let corners = vec![
        dvec3(0.0, 0.0, 0.0),
        dvec3(1.0, 0.0, 0.0),
        dvec3(0.5, altitude, 0.0),
        dvec3(0.5, 1.0, 0.0),
        dvec3(0.5, -1.0, 0.0),
    ];
    TriMesh::new(corners, vec![[0, 1, 2], [2, 1, 3], [0, 2, 3], [1, 0, 4]]).unwrap()
}

/// Altitudes of slivers: some digits, a rounding, and next to nothing.
pub const ALTITUDES: [f64; 4] = [1e-7, 1e-12, 3e-16, 1e-17];

/// The surface in other units, next to the origin and a million boxes away.
pub fn units(mesh: &TriMesh) -> impl Iterator<Item = (String, TriMesh)> {
    let all = [1e-30, 1e-12, 1e12, 1e30].into_iter().flat_map(|scale| [0.0, 1e6].map(|boxes| (scale, boxes)));
    all.map(move |(scale, boxes)| {
        let moved = map(mesh, |p| (p + dvec3(1.0, -0.5, 0.25) * 3.0 * boxes) * scale);
        (format!("scale {scale}, {boxes} boxes off"), moved)
    })
}

/// A surface with a vertex that no facet uses, its last, and weights of any size.
pub fn with_extreme_weights(mesh: &TriMesh) -> (TriMesh, [(&'static str, Vec<f64>); 5]) {
    let (mut positions, facets) = mesh.clone().into_parts();
    positions.push(DVec3::ONE);
    let count = positions.len();
    let like = |of: &dyn Fn(usize) -> f64| -> Vec<f64> { (0..count).map(of).collect() };
    let ramp = |v: usize| 1.0 + (v % 7) as f64;
    let weights = [
        ("tiny", like(&|v| 1e-300 * ramp(v))),
        ("subnormal", like(&|v| f64::from_bits(1 << (v % 7)))),
        ("huge", like(&|v| 1e307 * ramp(v))),
        ("zero but for one", like(&|v| f64::from(v == 17))),
        ("an unused vertex's is the largest", like(&|v| if v + 1 == count { 1e300 } else { ramp(v) })),
    ];
    (TriMesh::new(positions, facets).unwrap(), weights)
}
