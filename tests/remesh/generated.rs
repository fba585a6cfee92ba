//! Generated surfaces of the kinds that public collections have: limbs close to each other, turned parts with long facets,
//! lists of triangles, many parts, sheets that meet.

use std::collections::HashMap;
use std::f64::consts::{PI, TAU};

use glam::{DVec3, dvec3};
use tessera::mesh::TriMesh;
use tessera::mesh::shapes::Shape;

use crate::rough::Random;

/// A line with a radius.
type Limb = (DVec3, DVec3, f64);

/// The surface of the union of some limbs, by tetrahedra on a grid of cubes `cell` wide; open below `floor`.
fn limbs(limbs: &[Limb], cell: f64, floor: f64) -> TriMesh {
    let field = |p: DVec3| {
        let of = |&(a, b, radius): &Limb| {
            let t = ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
            p.distance(a.lerp(b, t)) - radius
        };
        limbs.iter().map(of).fold(f64::INFINITY, f64::min)
    };
    let ends = limbs.iter().flat_map(|&(a, b, r)| [a - r, b - r, a + r, b + r]);
    let (low, high) = ends.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), p| (l.min(p), h.max(p)));
    // Off the axes, so that no corner of the grid is on the surface.
    let low = low - cell * dvec3(1.13, 1.27, 1.39);
    let [nx, ny, nz] = ((high - low) / cell).to_array().map(|x| x.ceil() as i64 + 2);
    let at = |c: [i64; 3]| low + cell * dvec3(c[0] as f64, c[1] as f64, c[2] as f64);
    let number = |c: [i64; 3]| ((c[0] * ny + c[1]) * nz + c[2]) as usize;
    let mut values = Vec::new();
    for x in 0..nx {
        for y in 0..ny {
            values.extend((0..nz).map(|z| field(at([x, y, z]))));
        }
    }
    let (mut positions, mut facets, mut cuts) = (Vec::new(), Vec::new(), HashMap::new());
    let mut cut = |a: [i64; 3], b: [i64; 3]| {
        let (a, b) = if number(a) < number(b) { (a, b) } else { (b, a) };
        *cuts.entry((number(a), number(b))).or_insert_with(|| {
            let (va, vb) = (values[number(a)], values[number(b)]);
            positions.push(at(a).lerp(at(b), (va / (va - vb)).clamp(0.1, 0.9)));
            positions.len() as u32 - 1
        })
    };
    let mut triangles: Vec<([u32; 3], DVec3)> = Vec::new();
    let cubes = (0..nx - 1).flat_map(|x| (0..ny - 1).flat_map(move |y| (0..nz - 1).map(move |z| [x, y, z])));
    for cube in cubes {
        // The six paths from one corner to the opposite one.
        for order in [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]] {
            let mut corner = cube;
            let mut corners = vec![corner];
            for axis in order {
                corner[axis] += 1;
                corners.push(corner);
            }
            let (inside, outside): (Vec<_>, Vec<_>) = corners.into_iter().partition(|&c| values[number(c)] < 0.0);
            let middle = |all: &[[i64; 3]]| all.iter().map(|&c| at(c)).sum::<DVec3>() / all.len().max(1) as f64;
            let out = middle(&outside) - middle(&inside);
            match (inside.len(), outside.len()) {
                (1, 3) => triangles.push(([0, 1, 2].map(|k| cut(inside[0], outside[k])), out)),
                (3, 1) => triangles.push(([0, 1, 2].map(|k| cut(inside[k], outside[0])), out)),
                (2, 2) => {
                    let q = [(0, 0), (0, 1), (1, 1), (1, 0)].map(|(i, o)| cut(inside[i], outside[o]));
                    triangles.extend([([q[0], q[1], q[2]], out), ([q[0], q[2], q[3]], out)]);
                }
                _ => {}
            }
        }
    }
    for ([a, b, c], out) in triangles {
        let [p, q, r] = [a, b, c].map(|v| positions[v as usize]);
        if (p + q + r).z / 3.0 > floor {
            facets.push(if (q - p).cross(r - p).dot(out) < 0.0 { [a, c, b] } else { [a, b, c] });
        }
    }
    TriMesh::new(positions, facets).unwrap()
}

/// A forearm, open at its lower end, with five fingers close to each other.
pub(crate) fn arm(cell: f64) -> TriMesh {
    let mut all = vec![(dvec3(0.0, 0.0, -1.4), dvec3(0.0, 0.0, 0.2), 0.22)];
    for k in 0..5 {
        let x = -0.2 + 0.1 * f64::from(k);
        let tip = 0.75 + 0.08 * (2.0 - (f64::from(k) - 2.0).abs());
        all.push((dvec3(0.7 * x, 0.0, 0.2), dvec3(1.1 * x, 0.02 * f64::from(k % 2), tip), 0.045));
    }
    limbs(&all, cell, -1.1)
}

/// A body with nine thin limbs, some of which nearly touch.
pub(crate) fn creature(cell: f64) -> TriMesh {
    let mut all = vec![(dvec3(0.0, 0.0, -0.3), dvec3(0.0, 0.0, 0.4), 0.28)];
    for k in 0..4 {
        let x = -0.25 + 0.165 * f64::from(k);
        all.push((dvec3(0.6 * x, 0.0, 0.4), dvec3(x, 0.0, 1.1), 0.075));
        all.push((dvec3(0.6 * x, 0.0, -0.3), dvec3(x, 0.05, -1.1), 0.07));
    }
    all.push((dvec3(0.0, 0.2, 0.0), dvec3(0.0, 0.5, 0.9), 0.05));
    limbs(&all, cell, f64::NEG_INFINITY)
}

/// A turned joint: steps, a collar and a pin, with facets as long as its cylinders.
pub(crate) fn joint(around: u32) -> TriMesh {
    let profile = [
        (1.0, 0.0),
        (1.0, 0.3),
        (0.4, 0.3),
        (0.4, 1.5),
        (0.55, 1.5),
        (0.55, 1.55),
        (0.4, 1.55),
        (0.4, 2.5),
        (0.38, 2.52),
        (0.05, 2.52),
        (0.05, 3.2),
    ];
    let mut positions = Vec::new();
    for (r, z) in profile {
        let angle = |k: u32| f64::from(k) * TAU / f64::from(around);
        positions.extend((0..around).map(|k| dvec3(r * angle(k).cos(), r * angle(k).sin(), z)));
    }
    let rings = profile.len() as u32;
    let at = |ring: u32, k: u32| ring * around + k % around;
    let [low, high] = [positions.len() as u32, positions.len() as u32 + 1];
    positions.extend([DVec3::Z * profile[0].1, DVec3::Z * profile[profile.len() - 1].1]);
    let mut facets = Vec::new();
    for k in 0..around {
        facets.extend([[low, at(0, k + 1), at(0, k)], [high, at(rings - 1, k), at(rings - 1, k + 1)]]);
        for ring in 0..rings - 1 {
            let (a, b, c, d) = (at(ring, k), at(ring, k + 1), at(ring + 1, k + 1), at(ring + 1, k));
            facets.extend([[a, b, c], [a, c, d]]);
        }
    }
    TriMesh::new(positions, facets).unwrap()
}

/// Several surfaces as one.
fn joined(parts: impl IntoIterator<Item = TriMesh>) -> TriMesh {
    let (mut positions, mut facets): (Vec<DVec3>, Vec<[u32; 3]>) = (Vec::new(), Vec::new());
    for part in parts {
        let base = positions.len() as u32;
        positions.extend(part.positions());
        facets.extend(part.facets().iter().map(|f| f.map(|v| v + base)));
    }
    TriMesh::new(positions, facets).unwrap()
}

fn ball(facets: usize, centre: DVec3, radius: f64) -> TriMesh {
    let (positions, facets) = Shape::Sphere.build(facets).into_parts();
    TriMesh::new(positions.into_iter().map(|p| centre + radius * p).collect(), facets).unwrap()
}

/// So many balls that go through each other.
pub(crate) fn balls(count: usize, least: f64, largest: f64) -> TriMesh {
    let mut random = Random::new(7);
    joined((0..count).map(|_| {
        let radius = least + (largest - least) * random.unit();
        ball(500, random.point(), radius)
    }))
}

/// The triangles of a ball, each smaller than it was, so that none touches another.
pub(crate) fn shrunk_triangles(facets: usize) -> TriMesh {
    let ball = Shape::Sphere.build(facets);
    let mut positions = Vec::new();
    for f in 0..ball.facets().len() {
        let corners = ball.corners(f);
        let centre = corners.iter().sum::<DVec3>() / 3.0;
        positions.extend(corners.map(|p| centre + 0.9 * (p - centre)));
    }
    let triangles = (0..positions.len() as u32 / 3).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect();
    TriMesh::new(positions, triangles).unwrap()
}

/// Triangles anywhere in a unit box, through each other.
pub(crate) fn scattered_triangles(count: u32, size: f64) -> TriMesh {
    let mut random = Random::new(11);
    let mut positions = Vec::new();
    for _ in 0..count {
        let centre = random.point();
        positions.extend((0..3).map(|_| centre + size * (random.point() - 0.5)));
    }
    TriMesh::new(positions, (0..count).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect()).unwrap()
}

/// Square pages of unit size that meet in one spine: a non-manifold edge if there are more than two.
pub(crate) fn book(pages: u32, n: u32) -> TriMesh {
    let step = |k: u32| f64::from(k) / f64::from(n);
    let mut positions: Vec<DVec3> = (0..=n).map(|z| DVec3::Z * step(z)).collect();
    let mut facets = Vec::new();
    for page in 0..pages {
        let base = positions.len() as u32;
        let angle = TAU * f64::from(page) / f64::from(pages);
        for i in 1..=n {
            positions.extend((0..=n).map(|z| dvec3(angle.cos() * step(i), angle.sin() * step(i), step(z))));
        }
        let at = |i: u32, z: u32| if i == 0 { z } else { base + (i - 1) * (n + 1) + z };
        for (i, z) in (0..n).flat_map(|i| (0..n).map(move |z| (i, z))) {
            let [a, b, c, d] = [at(i, z), at(i + 1, z), at(i + 1, z + 1), at(i, z + 1)];
            facets.extend([[a, b, c], [a, c, d]]);
        }
    }
    TriMesh::new(positions, facets).unwrap()
}

/// A closed disk of radius 1 and so thick: two sides much nearer to each other than an edge.
pub(crate) fn thin_plate(thickness: f64, around: u32, rings: u32) -> TriMesh {
    let mut positions = Vec::new();
    let mut facets = Vec::new();
    for z in [thickness, 0.0] {
        positions.push(DVec3::Z * z);
        for ring in 1..=rings {
            let r = f64::from(ring) / f64::from(rings);
            let angle = |k: u32| (f64::from(k) + 0.5 * f64::from(ring % 2)) * TAU / f64::from(around);
            positions.extend((0..around).map(|k| dvec3(r * angle(k).cos(), r * angle(k).sin(), z)));
        }
    }
    let side = positions.len() as u32 / 2;
    let at = |ring: u32, k: u32| 1 + (ring - 1) * around + k % around;
    let mut both = |[a, b, c]: [u32; 3]| facets.extend([[a, b, c], [side + a, side + c, side + b]]);
    for k in 0..around {
        both([0, at(1, k), at(1, k + 1)]);
        for ring in 1..rings {
            let (a, b, c, d) = (at(ring, k), at(ring, k + 1), at(ring + 1, k + 1), at(ring + 1, k));
            both([a, d, c]);
            both([a, c, b]);
        }
    }
    for k in 0..around {
        let (a, b) = (at(rings, k), at(rings, k + 1));
        facets.extend([[a, side + a, side + b], [a, side + b, b]]);
    }
    TriMesh::new(positions, facets).unwrap()
}

/// Boxes that share edges and nothing else, as those of a chessboard.
pub(crate) fn chessboard(n: u32) -> TriMesh {
    let part = |i: u32, j: u32| {
        let (positions, facets) = Shape::Genus(0).build(300).into_parts();
        let (low, high) =
            positions.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), &p| (l.min(p), h.max(p)));
        let place = |p: DVec3| (p - low) / (high - low) + dvec3(f64::from(i), f64::from(j), 0.0);
        TriMesh::new(positions.into_iter().map(place).collect(), facets).unwrap()
    };
    joined((0..n).flat_map(|i| (0..n).map(move |j| (i, j))).filter(|(i, j)| (i + j) % 2 == 0).map(|(i, j)| part(i, j)))
}

#[test]
fn they_are_what_they_are_called() {
    use tessera::mesh::measure::topology;
    let limbs = topology(&creature(0.05));
    assert_eq!((limbs.components, limbs.boundary_edges, limbs.non_manifold_edges), (1, 0, 0), "{limbs:?}");
    assert_eq!(topology(&arm(0.04)).boundary_loops, 1);
    assert_eq!((topology(&joint(24)).euler, topology(&joint(24)).boundary_edges), (2, 0));
    assert_eq!(topology(&shrunk_triangles(500)).components, shrunk_triangles(500).facets().len());
    assert_eq!(topology(&book(5, 6)).non_manifold_edges, 6);
    let plate = thin_plate(0.01, 24, 8);
    assert_eq!((topology(&plate).euler, topology(&plate).boundary_edges), (2, 0));
    assert!((plate.area() / (2.0 * PI) - 1.0).abs() < 0.05);
    assert!(topology(&chessboard(3)).non_manifold_edges > 0);
}
