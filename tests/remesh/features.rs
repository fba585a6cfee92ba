//! Promise: creases, corners and boundaries are found, and a remesh keeps them.

use std::collections::BTreeSet;

use crate::gpu;
use glam::{DVec3, dvec3};
use tessera::cvt::density::{DensityOptions, DensitySource};
use tessera::mesh::TriMesh;
use tessera::mesh::adjacency::{Adjacency, EdgeKind};
use tessera::mesh::features::{CurveKind, FeatureError, FeatureOptions, Features};
use tessera::mesh::measure::topology;
use tessera::mesh::shapes::Shape;
use tessera::remesh::{Placement, Remesh, RemeshError, RemeshOptions, Seeds, remesh};
use tessera::rvd::gpu::Gpu;
use tessera::rvd::parallel::Parallel;
use tessera::rvd::{Backend, CancelFlag};

fn wish(crease_angle_deg: f64) -> FeatureOptions {
    FeatureOptions { crease_angle_deg, reach: 0.05, ..FeatureOptions::default() }
}

fn find(mesh: &TriMesh, options: &FeatureOptions) -> Result<Features, FeatureError> {
    Features::find(mesh, mesh.positions(), options)
}

/// (boundaries, creases, corners).
fn counts(features: &Features) -> (usize, usize, usize) {
    let of = |kind| features.curves.iter().filter(|c| c.kind == kind).count();
    (of(CurveKind::Boundary), of(CurveKind::Crease), features.corners.len())
}

fn length(mesh: &TriMesh, vertices: &[u32]) -> f64 {
    vertices.windows(2).map(|w| mesh.positions()[w[0] as usize].distance(mesh.positions()[w[1] as usize])).sum()
}

/// A prism over a polygon in the plane, counter-clockwise, in `layers` layers; each side is divided so that its
/// parts are about `step` long. `lids` are the triangles of the polygon's corners that fill it.
fn prism(polygon: &[(f64, f64)], lids: &[[usize; 3]], step: f64, height: f64) -> TriMesh {
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
fn l_shape() -> TriMesh {
    let polygon = [(0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (1.0, 1.0), (1.0, 2.0), (0.0, 2.0)];
    prism(&polygon, &[[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]], 0.15, 1.0)
}

/// An open cylinder of radius 1 and height 2, `n` facets around.
fn tube(n: u32, layers: u32) -> TriMesh {
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
fn disk(n: u32, rings: u32) -> TriMesh {
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
fn fold(degrees: f64, n: u32) -> TriMesh {
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

#[test]
fn squares_have_one_boundary_with_four_corners() {
    for mesh in [Shape::Square.build(2), Shape::Plane.build(800)] {
        let features = find(&mesh, &wish(30.0)).unwrap();
        // The rim is cut at its corners, into four sides.
        assert_eq!(counts(&features), (4, 0, 4));
        let corners: Vec<DVec3> = features.corners.iter().map(|&v| mesh.positions()[v as usize]).collect();
        assert_eq!(corners, [dvec3(0., 0., 0.), dvec3(1., 0., 0.), dvec3(0., 1., 0.), dvec3(1., 1., 0.)]);
        for curve in &features.curves {
            assert_eq!((curve.closed, curve.angle_deg), (false, 180.0));
            assert!((length(&mesh, &curve.vertices) - 1.0).abs() < 1e-12);
        }
    }
}

#[test]
fn boxes_have_twelve_creases_and_eight_corners() {
    let slab = Shape::Genus(0).build(1200);
    let found = find(&slab, &wish(30.0)).unwrap();
    assert_eq!(counts(&found), (0, 12, 8));
    for curve in &found.curves {
        // Edges of a box meet at right angles; a cross product is good to 1e-15.
        assert!((curve.angle_deg - 90.0).abs() < 1e-9 && !curve.closed);
    }
    assert_eq!(counts(&find(&l_shape(), &wish(30.0)).unwrap()), (0, 18, 12));
    let block = Shape::Block.build(1200);
    let found = find(&block, &wish(30.0)).unwrap();
    // A box without two of its cubes; all creases are straight.
    let (boundaries, creases, corners) = counts(&found);
    // Twelve and eight of the box; each notch takes a corner and adds seven. Twelve faces, by Euler's formula.
    assert_eq!((boundaries, creases, corners), (0, 30, 20));
    for curve in &found.curves {
        let ends = [curve.vertices[0], curve.vertices[curve.vertices.len() - 1]].map(|v| block.positions()[v as usize]);
        assert!((length(&block, &curve.vertices) - ends[0].distance(ends[1])).abs() < 1e-12, "a straight line");
        assert!(curve.vertices.iter().skip(1).rev().skip(1).all(|v| !found.corners.contains(v)));
    }
    for mesh in [&slab, &block] {
        for angle in [0.0, 90.5, 180.0] {
            assert_eq!(counts(&find(mesh, &wish(angle)).unwrap()), (0, 0, 0), "{angle}°");
        }
    }
}

#[test]
fn smooth_surfaces_have_none() {
    for shape in [Shape::Torus, Shape::Sphere] {
        let features = find(&shape.build(4000), &wish(30.0)).unwrap();
        assert_eq!(counts(&features), (0, 0, 0), "{shape}");
    }
}

#[test]
fn a_tube_has_two_closed_boundaries() {
    let mesh = tube(48, 12);
    let features = find(&mesh, &FeatureOptions { reach: 0.2, ..wish(30.0) }).unwrap();
    assert_eq!(counts(&features), (2, 0, 0));
    for curve in &features.curves {
        assert!(curve.closed);
        assert_eq!((curve.vertices.len(), curve.round().count()), (48, 49));
    }
}

/// Where a small angle makes creases of all edges of a round side, those that a larger one finds stay.
#[test]
fn a_smaller_angle_keeps_what_a_larger_one_does() {
    let turn = |k: usize| (k as f64 / 128.0 * std::f64::consts::TAU).sin_cos();
    let polygon: Vec<(f64, f64)> = (0..128).map(turn).map(|(sin, cos)| (cos, sin)).collect();
    let lids: Vec<[usize; 3]> = (1..127).map(|k| [0, k, k + 1]).collect();
    let mesh = prism(&polygon, &lids, 0.2, 0.3);
    for angle in [30.0, 10.0, 2.0, 1.0] {
        let found = find(&mesh, &FeatureOptions { shortest: 0.4, ..wish(angle) }).unwrap();
        assert_eq!(counts(&found).1, 2, "{angle}");
        let rims: f64 = found.curves.iter().map(|c| length(&mesh, &c.round().collect::<Vec<_>>())).sum();
        assert!((rims / (2.0 * std::f64::consts::TAU) - 1.0).abs() < 1e-3, "{angle}: {rims}");
    }
}

#[test]
fn angles_are_measured() {
    for degrees in [20.0, 45.0, 100.0, 170.0] {
        let mesh = fold(degrees, 8);
        let found = find(&mesh, &wish(degrees - 1.0)).unwrap();
        // The crease divides the rim, at whose corners it is cut: three sides on either side of it.
        assert_eq!(counts(&found), (6, 1, 6), "{degrees}°");
        let crease = found.curves.iter().find(|c| c.kind == CurveKind::Crease).unwrap();
        assert!((crease.angle_deg - degrees).abs() < 1e-9, "{degrees}°: {}", crease.angle_deg);
        assert_eq!(counts(&find(&mesh, &wish(degrees + 1.0)).unwrap()).1, 0);
    }
}

/// A ridge of twenty degrees between two rims is one if it is alone; the edges of a tube, bent as much, are not.
#[test]
fn a_ridge_below_the_angle_of_creases_stands_alone() {
    let creases = |mesh: &TriMesh, alone: f64| counts(&find(mesh, &FeatureOptions { alone, ..wish(30.0) }).unwrap()).1;
    assert_eq!([0.0, 0.3].map(|alone| creases(&fold(20.0, 8), alone)), [0, 1]);
    assert_eq!(creases(&fold(10.0, 8), 0.3), 0, "less than half of a crease");
    let tube = tube(18, 12);
    // Its facets are 0.35 wide; to who looks no farther each edge is alone.
    assert_eq!([0.8, 0.3].map(|alone| creases(&tube, alone)), [0, 18]);
}

#[test]
fn wrong_wishes_are_refused() {
    let mesh = Shape::Sphere.build(500);
    for angle in [200.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(matches!(find(&mesh, &wish(angle)), Err(FeatureError::BadAngle(_))), "{angle}");
    }
    let [a, b, c] = mesh.facets()[0];
    let others = (0..mesh.positions().len() as u32)
        .find(|v| *v != a && !mesh.facets().iter().any(|t| t.contains(&a) && t.contains(v)));
    for wrong in [[a, others.unwrap()], [a, a], [b, u32::MAX]] {
        let given = vec![[a, b], [c, b], wrong, [a, c]];
        let refused = FeatureError::NoSuchEdge { crease: 2, a: wrong[0], b: wrong[1] };
        assert_eq!(Features::check(&mesh, 30.0, &given), Err(refused.clone()));
        assert_eq!(find(&mesh, &FeatureOptions { given: given.clone(), ..wish(30.0) }), Err(refused));
        let options = RemeshOptions { creases: given, ..RemeshOptions::new(Seeds::Sample { points: 50, seed: 1 }) };
        let error = run(&mesh, &options).unwrap_err();
        assert!(matches!(error, RemeshError::Feature(FeatureError::NoSuchEdge { crease: 2, .. })), "{error}");
    }
    let options = RemeshOptions { crease_angle_deg: 200.0, ..options(50) };
    assert!(matches!(run(&mesh, &options), Err(RemeshError::Feature(FeatureError::BadAngle(_)))));
}

/// A crease that fades out within a plate: short, it goes; given, it stays.
#[test]
fn short_open_creases_are_left_out_unless_they_were_given() {
    // The fold is straightened but for a stretch of it in the middle: a bump there.
    let mesh = Shape::Plane.build(800);
    let (mut positions, facets) = mesh.into_parts();
    let top = positions.iter().position(|p| p.distance(dvec3(0.5, 0.5, 0.0)) < 1e-9).unwrap();
    positions[top].z = 0.05;
    let mesh = TriMesh::new(positions, facets).unwrap();
    let creases = |shortest, given: &[[u32; 2]]| {
        let options = FeatureOptions { shortest, given: given.to_vec(), ..wish(30.0) };
        let found = find(&mesh, &options).unwrap();
        (found.curves.iter().filter(|c| c.kind == CurveKind::Crease).count(), found.left_out)
    };
    let (all, none) = creases(0.0, &[]);
    assert!(all > 0 && none == 0);
    let (left, out) = creases(0.5, &[]);
    assert_eq!(left, 0);
    assert!(out >= all);
    // One edge at the tip and one far from it, where nothing is bent.
    let neighbour = |v: u32| mesh.facets().iter().find(|t| t.contains(&v)).unwrap().iter().copied().find(|u| *u != v);
    let given = [[top as u32, neighbour(top as u32).unwrap()], [45, neighbour(45).unwrap()]];
    let options = FeatureOptions { shortest: 0.5, given: given.to_vec(), ..wish(30.0) };
    let found = find(&mesh, &options).unwrap();
    for [a, b] in given {
        let has = |c: &&tessera::mesh::features::Curve| {
            let round: Vec<u32> = c.round().collect();
            round.windows(2).any(|w| w == [a, b] || w == [b, a])
        };
        let curve = found.curves.iter().find(has).unwrap();
        assert_eq!(curve.kind, CurveKind::Crease);
    }
}

/// Lengths count by how fine the remesh is to be where they are.
#[test]
fn what_is_short_depends_on_the_edges_that_there_are_to_be() {
    let mesh = Shape::Plane.build(800);
    let (mut positions, facets) = mesh.into_parts();
    let bump = dvec3(0.5, 0.5, 0.0);
    let top = positions.iter().position(|p| p.distance(bump) < 1e-9).unwrap();
    positions[top].z = 0.05;
    let mesh = TriMesh::new(positions, facets).unwrap();
    let fine = |f: &dyn Fn(DVec3) -> f64| FeatureOptions {
        shortest: 0.5,
        reach: 0.25,
        alone: 0.25,
        fineness: mesh.positions().iter().map(|&p| f(p)).collect(),
        ..wish(30.0)
    };
    let found = |options: &FeatureOptions| find(&mesh, options).unwrap();
    let without =
        |by: f64| found(&FeatureOptions { shortest: 0.5 / by, reach: 0.25 / by, alone: 0.25 / by, ..wish(30.0) });
    // A power of two, so that nothing is rounded.
    for by in [0.5, 1.0, 16.0] {
        assert_eq!(found(&fine(&|_| by)), without(by), "{by}");
    }
    assert_eq!(counts(&without(1.0)).1, 0, "too short for coarse edges");
    assert!(counts(&without(16.0)).1 > 0, "long enough for fine ones");
    let [elsewhere, there] =
        [false, true].map(|near| found(&fine(&|p| if (p.distance(bump) < 0.25) == near { 16.0 } else { 1.0 })));
    assert_eq!((counts(&elsewhere).1, counts(&there).1), (0, counts(&without(16.0)).1));
}

/// What is noise beside the edges of a remesh stays that where other edges of it are much shorter.
#[test]
fn an_adaptive_remesh_takes_no_noise_for_creases() {
    let ball = Shape::Sphere.build(8000);
    // Bumps of one vertex each on one side, and edges that are to be a tenth as long as there on the other.
    let bumps = |(v, &p): (usize, &DVec3)| if v % 11 == 0 && p.x < 0.5 { 1.03 * p } else { p };
    let positions = ball.positions().iter().enumerate().map(bumps).collect();
    let mesh = TriMesh::new(positions, ball.facets().to_vec()).unwrap();
    assert!(counts(&find(&mesh, &wish(30.0)).unwrap()).1 > 100);
    let size = |p: DVec3| if p.x > 0.9 { 0.1 } else { 1.0 };
    let sizes = DensitySource::Sizes(mesh.positions().iter().map(|&p| size(p)).collect());
    for source in [DensitySource::Uniform, sizes, DensitySource::Curvature, DensitySource::FeatureSize] {
        let name = source.name();
        let density = DensityOptions::from_source(source);
        let options = RemeshOptions { density, lloyd: 1, newton: 0, ..options(2000) };
        let features = run(&mesh, &options).unwrap().report.features;
        println!("{name}: {features:?}");
        assert_eq!(features.creases, 0, "{name}");
    }
}

/// The faces of a part may be a few large facets. Seeds of a side that is one edge of the mesh once gathered in four places.
#[test]
fn a_few_large_facets_are_remeshed_as_well_as_many() {
    // What is flat is met, and a fitted vertex may leave a crease by 6 % of an edge, 0.2 % of the diagonal.
    for (shape, facets, most) in [(Shape::Square, 2, 1e-9), (Shape::Plane, 8, 1e-9), (Shape::Genus(0), 12, 0.2)] {
        let mesh = shape.build(facets);
        let out = run(&mesh, &RemeshOptions::new(Seeds::Sample { points: 2000, seed: 5 })).unwrap();
        let quality = out.report.result.quality.unwrap();
        println!("{shape} of {} facets: {quality:?}", mesh.facets().len());
        assert!(quality.q_min > 0.5 && quality.q_avg > 0.91 && quality.theta_min_deg > 30.0, "{shape}: {quality:?}");
        assert!(quality.hausdorff_percent < most, "{shape}: {quality:?}");
        assert_eq!(out.report.features.missing_segments, 0, "{shape}");
    }
}

#[test]
fn what_is_retained_keeps_its_corners() {
    let mesh = Shape::Genus(0).build(600);
    let mut features = find(&mesh, &wish(30.0)).unwrap();
    features.retain(|k, _| k == 0);
    assert_eq!(counts(&features), (0, 1, 2));
    features.retain(|_, _| false);
    assert_eq!(counts(&features), (0, 0, 0));
}

fn options(points: usize) -> RemeshOptions {
    RemeshOptions {
        newton: 15,
        placement: Placement::Surface,
        measure: false,
        ..RemeshOptions::new(Seeds::Sample { points, seed: 5 })
    }
}

fn run_on(backend: &dyn Backend, mesh: &TriMesh, options: &RemeshOptions) -> Result<Remesh, RemeshError> {
    remesh(mesh, options, backend, &mut (), &CancelFlag::default())
}

fn run(mesh: &TriMesh, options: &RemeshOptions) -> Result<Remesh, RemeshError> {
    run_on(&Parallel::new(Some(2)).unwrap(), mesh, options)
}

fn edges(mesh: &TriMesh) -> BTreeSet<[u32; 2]> {
    let of = |t: &[u32; 3]| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]];
    mesh.facets().iter().flat_map(of).map(|[a, b]| [a.min(b), a.max(b)]).collect()
}

/// Every straight crease of the input is a chain of edges of the result, its corners are vertices, and the result has
/// the input's topology. Vertices of curves are at most `off` from them.
fn keeps_creases(name: &str, mesh: &TriMesh, out: &Remesh, off: f64) {
    let figures = &out.report.features;
    assert_eq!((figures.missing_segments, figures.broken_curves, figures.given_up), (0, 0, 0), "{name}: {figures:?}");
    assert_eq!(out.report.topology_changes, Vec::<String>::new(), "{name}");
    let wanted = find(mesh, &wish(30.0)).unwrap();
    assert_eq!(figures.boundaries + figures.creases, wanted.curves.len(), "{name}");
    assert_eq!(figures.corners, wanted.corners.len(), "{name}");
    for &v in &wanted.corners {
        let corner = mesh.positions()[v as usize];
        assert!(out.mesh.positions().contains(&corner), "{name}: {corner} is no vertex");
    }
    let there = edges(&out.mesh);
    let lines: Vec<[DVec3; 2]> = wanted
        .curves
        .iter()
        .map(|c| [c.vertices[0], c.vertices[c.vertices.len() - 1]].map(|v| mesh.positions()[v as usize]))
        .collect();
    let mut covered = vec![0.0; lines.len()];
    for &[a, b] in &out.curve_edges {
        assert!(there.contains(&[a.min(b), a.max(b)]), "{name}: a curve edge is none of the mesh");
        let ends = [a, b].map(|v| out.mesh.positions()[v as usize]);
        let on = |[p, q]: &[DVec3; 2]| {
            let way = (*q - *p).normalize();
            ends.iter().all(|&e| {
                (e - *p).reject_from_normalized(way).length() < off && {
                    let s = (e - *p).dot(way);
                    s > -off && s < p.distance(*q) + off
                }
            })
        };
        let k = lines.iter().position(on).unwrap_or_else(|| panic!("{name}: {ends:?} is on no crease"));
        covered[k] += ends[0].distance(ends[1]);
    }
    for (covered, [p, q]) in covered.iter().zip(&lines) {
        // A zigzag of slope s is longer by s²/2.
        let longer = 1e-9 + 5.0 * off * off;
        assert!((covered - p.distance(*q)).abs() < longer, "{name}: {covered} of the crease from {p} to {q}");
    }
}

/// Coordinates are a few units large and go to the unit frame and back.
fn keeps_straight_creases(name: &str, mesh: &TriMesh, out: &Remesh) {
    keeps_creases(name, mesh, out, 1e-9);
}

#[test]
fn creases_are_edges_and_corners_are_vertices() {
    for (name, mesh) in [("block", Shape::Block.build(3000)), ("slab", Shape::Genus(0).build(2000)), ("L", l_shape())] {
        for points in [300, 800] {
            let out = run(&mesh, &options(points)).unwrap();
            keeps_straight_creases(&format!("{name}, {points}"), &mesh, &out);
        }
        // The fit weighs creases against faces: a vertex may leave its crease by a part of an edge; corners stay.
        let fitted = run(&mesh, &RemeshOptions { placement: Placement::Fitted, ..options(500) }).unwrap();
        let edge = (mesh.area() / 500.0).sqrt();
        keeps_creases(&format!("{name}, fitted"), &mesh, &fitted, 0.25 * edge);
        let plain = run(&mesh, &RemeshOptions { crease_angle_deg: 0.0, ..options(300) }).unwrap();
        assert!(plain.curve_edges.is_empty());
        assert_eq!(plain.report.features.seeds, 0);
    }
}

#[test]
fn the_gpu_keeps_creases_too() {
    let Some(device) = gpu::device() else { return };
    let gpu = Gpu::new(device, None).unwrap();
    let mesh = l_shape();
    let out = run_on(&gpu, &mesh, &options(300)).unwrap();
    keeps_straight_creases("L on the GPU", &mesh, &out);
    let mesh = Shape::Plane.build(800);
    keeps_straight_creases("plane on the GPU", &mesh, &run_on(&gpu, &mesh, &options(150)).unwrap());
}

/// Given creases of a smooth surface: the equator of a tube's middle.
#[test]
fn given_creases_are_kept() {
    let mesh = tube(48, 12);
    let ring: Vec<[u32; 2]> = (0..48).map(|i| [6 * 48 + i, 6 * 48 + (i + 1) % 48]).collect();
    let out = run(&mesh, &RemeshOptions { creases: ring, ..options(500) }).unwrap();
    let figures = &out.report.features;
    assert_eq!((figures.boundaries, figures.creases, figures.missing_segments), (2, 1, 0));
    let middle = |v: u32| (out.mesh.positions()[v as usize].z - 1.0).abs() < 1e-9;
    let on: Vec<&[u32; 2]> = out.curve_edges.iter().filter(|e| e.iter().all(|&v| middle(v))).collect();
    let around: f64 = on.iter().map(|e| length(&out.mesh, &e[..])).sum();
    // A polygon of about thirty corners in the circle.
    assert!(around > 0.99 * std::f64::consts::TAU && around < std::f64::consts::TAU, "{around}");
}

/// Length of the boundary.
fn rim(mesh: &TriMesh) -> f64 {
    let adjacency = Adjacency::new(mesh);
    let half = |h: usize| mesh.positions()[mesh.facets()[h / 3][h % 3] as usize];
    (0..3 * mesh.facets().len())
        .filter(|&h| adjacency.kind(h) == EdgeKind::Boundary)
        .map(|h| half(h).distance(half(3 * (h / 3) + (h + 1) % 3)))
        .sum()
}

#[test]
fn an_open_plane_does_not_shrink() {
    let mesh = Shape::Plane.build(800);
    for points in [60, 400] {
        let out = run(&mesh, &options(points)).unwrap();
        keeps_straight_creases("plane", &mesh, &out);
        let after = topology(&out.mesh);
        assert_eq!((after.boundary_loops, after.euler, after.components), (1, 1, 1));
        // Straight sides and exact corners.
        assert!((out.mesh.area() - mesh.area()).abs() < 1e-9, "{}", out.mesh.area());
        assert!((rim(&out.mesh) - 4.0).abs() < 1e-9);
    }
    // Where boundaries are free the rim is about half an edge inside.
    let free = run(&mesh, &RemeshOptions { keep_boundaries: false, ..options(400) }).unwrap();
    assert_eq!((topology(&free.mesh).boundary_loops, topology(&free.mesh).euler), (1, 1));
    assert!(free.curve_edges.is_empty());
    assert!(free.mesh.area() < 0.97 && free.mesh.area() > 0.85, "{}", free.mesh.area());
    assert!(free.mesh.positions().iter().all(|p| (0.0..1.0).contains(&p.x) && p.x > 0.0 && p.y > 0.0 && p.y < 1.0));
}

/// Nearly all points, or all, are on the boundary where a strip is narrower than an edge; it keeps its width.
#[test]
fn a_narrow_strip_keeps_its_boundary() {
    let plane = Shape::Plane.build(800);
    let narrow = |p: &DVec3| DVec3::new(p.x * 6.0, p.y * 0.2, p.z);
    let mesh = TriMesh::new(plane.positions().iter().map(narrow).collect(), plane.facets().to_vec()).unwrap();
    for points in [100, 150, 200] {
        let out = run(&mesh, &options(points)).unwrap();
        assert!((out.mesh.area() / mesh.area() - 1.0).abs() < 1e-9, "{points}: {}", out.mesh.area());
        assert!((rim(&out.mesh) - 12.4).abs() < 1e-9, "{points}: {}", rim(&out.mesh));
        assert_eq!(topology(&out.mesh), topology_of_open(1), "{points}");
    }
}

#[test]
fn closed_boundaries_stay() {
    for (name, mesh, loops) in [("disk", disk(96, 16), 1), ("tube", tube(96, 24), 2)] {
        for placement in [Placement::Surface, Placement::Fitted] {
            let out = run(&mesh, &RemeshOptions { placement, ..options(600) }).unwrap();
            let figures = &out.report.features;
            assert_eq!((figures.boundaries, figures.creases, figures.missing_segments), (loops, 0, 0), "{name}");
            assert_eq!(topology(&out.mesh), topology_of_open(loops), "{name}");
            let kept = rim(&out.mesh) / rim(&mesh);
            // Of a polygon of n corners in a circle π²/6n² is missing: 0.5 % of twenty.
            assert!((kept - 1.0).abs() < 0.01, "{name}: {kept}");
        }
        let free = run(&mesh, &RemeshOptions { keep_boundaries: false, ..options(600) }).unwrap();
        assert!(free.mesh.area() < 0.97 * mesh.area(), "{name}");
    }
}

/// A sheet, 2 by 1, with a slit through its middle, its rims in small teeth.
fn slit(n: u32) -> TriMesh {
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

/// Its rims are a third of an edge apart, and both stay.
#[test]
fn a_slit_keeps_both_its_rims() {
    let mesh = slit(40);
    let out = run(&mesh, &options(500)).unwrap();
    let figures = &out.report.features;
    assert_eq!((figures.missing_segments, topology(&out.mesh).boundary_loops), (0, 2), "{figures:?}");
}

fn topology_of_open(loops: usize) -> TopologyWithoutEdges {
    TopologyWithoutEdges { euler: 2 - loops as i64, components: 1, boundary_loops: loops }
}

#[derive(Debug)]
struct TopologyWithoutEdges {
    euler: i64,
    components: usize,
    boundary_loops: usize,
}

impl PartialEq<TopologyWithoutEdges> for tessera::mesh::measure::Topology {
    fn eq(&self, other: &TopologyWithoutEdges) -> bool {
        (self.euler, self.components, self.boundary_loops) == (other.euler, other.components, other.boundary_loops)
            && (self.non_manifold_edges, self.non_manifold_vertices) == (0, 0)
    }
}

/// More curves than so few points can follow: creases go first, boundaries stay even with nearly all points, and the remesh
/// is still one.
#[test]
fn too_few_points_give_curves_up() {
    let mesh = tube(48, 12);
    // Eleven rings.
    let ring = |j: u32| (0..48).map(move |i| [j * 48 + i, j * 48 + (i + 1) % 48]);
    let creases: Vec<[u32; 2]> = (1..12).flat_map(ring).collect();
    for (points, given_up, boundaries) in [(60, 11, 2), (20, 11, 2)] {
        let out = run(&mesh, &RemeshOptions { creases: creases.clone(), ..options(points) }).unwrap();
        let figures = &out.report.features;
        assert_eq!((figures.given_up, figures.creases, figures.boundaries), (given_up, 0, boundaries), "{figures:?}");
        assert_eq!(topology(&out.mesh), topology_of_open(2), "{points} points");
        assert_eq!(out.seeds.len(), points);
    }
    let out = run(&mesh, &RemeshOptions { creases, ..options(1200) }).unwrap();
    let figures = &out.report.features;
    assert_eq!((figures.given_up, figures.creases, figures.missing_segments), (0, 11, 0), "{figures:?}");
}

/// Seeds of a closed curve move to its kinks; two of them never to the same one, where it begins either.
#[test]
fn closed_curves_have_no_seed_twice() {
    let mesh = tube(24, 12);
    for points in [200, 500] {
        let out = run(&mesh, &RemeshOptions { newton: 4, ..options(points) }).unwrap();
        let figures = &out.report.features;
        assert_eq!((figures.boundaries, figures.missing_segments), (2, 0), "{points} points");
    }
}

/// What is short beside the edges of the remesh goes without a curve; the result is valid all the same.
#[test]
fn holes_smaller_than_an_edge_leave_a_valid_surface() {
    let mesh = Shape::Genus(6).build(8000);
    let out = run(&mesh, &options(120)).unwrap();
    assert!(out.report.features.short_crease_edges + out.report.features.given_up > 0);
    let after = topology(&out.mesh);
    assert_eq!((after.non_manifold_edges, after.non_manifold_vertices, after.boundary_edges), (0, 0, 0));
    let many = run(&mesh, &options(2000)).unwrap();
    keeps_straight_creases("six holes", &mesh, &many);
}
