//! Promise: creases, corners and boundaries are found, by angle and at the scale of the result.

use geometry::mesh::features::{CurveKind, FeatureError, FeatureOptions, Features};
use glam::{DVec3, dvec3};
use tessera::mesh::TriMesh;
use tessera::mesh::shapes::Shape;
use tessera::token::Token;

use crate::parts::{counts, creases_above, find, fold, l_shape, length, prism, tube};

#[test]
fn squares_have_one_boundary_with_four_corners() {
    for mesh in [Shape::Square.build(2), Shape::Plane.build(800)] {
        let features = find(&mesh, &creases_above(30.0)).unwrap();
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
    let found = find(&slab, &creases_above(30.0)).unwrap();
    assert_eq!(counts(&found), (0, 12, 8));
    for curve in &found.curves {
        // Edges of a box meet at right angles; a cross product is good to 1e-15.
        assert!((curve.angle_deg - 90.0).abs() < 1e-9 && !curve.closed);
    }
    assert_eq!(counts(&find(&l_shape(), &creases_above(30.0)).unwrap()), (0, 18, 12));
    let block = Shape::Block.build(1200);
    let found = find(&block, &creases_above(30.0)).unwrap();
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
            assert_eq!(counts(&find(mesh, &creases_above(angle)).unwrap()), (0, 0, 0), "{angle}°");
        }
    }
}

#[test]
fn smooth_surfaces_have_none() {
    for shape in [Shape::Torus, Shape::Sphere] {
        let features = find(&shape.build(4000), &creases_above(30.0)).unwrap();
        assert_eq!(counts(&features), (0, 0, 0), "{shape}");
    }
}

#[test]
fn a_tube_has_two_closed_boundaries() {
    let mesh = tube(48, 12);
    let features = find(&mesh, &FeatureOptions { turn_reach: 0.2, ..creases_above(30.0) }).unwrap();
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
        let found = find(&mesh, &FeatureOptions { min_crease_length: 0.4, ..creases_above(angle) }).unwrap();
        assert_eq!(counts(&found).1, 2, "{angle}");
        let rims: f64 = found.curves.iter().map(|c| length(&mesh, &c.round().collect::<Vec<_>>())).sum();
        assert!((rims / (2.0 * std::f64::consts::TAU) - 1.0).abs() < 1e-3, "{angle}: {rims}");
    }
}

#[test]
fn angles_are_measured() {
    for degrees in [20.0, 45.0, 100.0, 170.0] {
        let mesh = fold(degrees, 8);
        let found = find(&mesh, &creases_above(degrees - 1.0)).unwrap();
        // The crease divides the rim, at whose corners it is cut: three sides on either side of it.
        assert_eq!(counts(&found), (6, 1, 6), "{degrees}°");
        let crease = found.curves.iter().find(|c| c.kind == CurveKind::Crease).unwrap();
        assert!((crease.angle_deg - degrees).abs() < 1e-9, "{degrees}°: {}", crease.angle_deg);
        assert_eq!(counts(&find(&mesh, &creases_above(degrees + 1.0)).unwrap()).1, 0);
    }
}

/// A ridge of twenty degrees between two rims is one if it is alone; the edges of a tube, bent as much, are not.
#[test]
fn a_ridge_below_the_angle_of_creases_stands_alone() {
    let creases = |mesh: &TriMesh, ridge_clearance: f64| {
        counts(&find(mesh, &FeatureOptions { ridge_clearance, ..creases_above(30.0) }).unwrap()).1
    };
    assert_eq!([0.0, 0.3].map(|clearance| creases(&fold(20.0, 8), clearance)), [0, 1]);
    assert_eq!(creases(&fold(10.0, 8), 0.3), 0, "less than half of a crease");
    let tube = tube(18, 12);
    // Its facets are 0.35 wide; to who looks no farther each edge is alone.
    assert_eq!([0.8, 0.3].map(|clearance| creases(&tube, clearance)), [0, 18]);
}

#[test]
fn wrong_wishes_are_refused() {
    let mesh = Shape::Sphere.build(500);
    for angle in [200.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(matches!(find(&mesh, &creases_above(angle)), Err(FeatureError::BadAngle(_))), "{angle}");
    }
    let [a, b, c] = mesh.facets()[0];
    let others = (0..mesh.positions().len() as u32)
        .find(|v| *v != a && !mesh.facets().iter().any(|t| t.contains(&a) && t.contains(v)));
    for wrong in [[a, others.unwrap()], [a, a], [b, u32::MAX]] {
        let given = vec![[a, b], [c, b], wrong, [a, c]];
        let refused = FeatureError::NoSuchEdge { crease: 2, a: wrong[0], b: wrong[1] };
        assert_eq!(Features::check(&mesh, 30.0, &given, &Token::default()), Err(refused.clone()));
        assert_eq!(find(&mesh, &FeatureOptions { given_creases: given, ..creases_above(30.0) }), Err(refused));
    }
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
    let creases = |min_crease_length, given: &[[u32; 2]]| {
        let options = FeatureOptions { min_crease_length, given_creases: given.to_vec(), ..creases_above(30.0) };
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
    let options = FeatureOptions { min_crease_length: 0.5, given_creases: given.to_vec(), ..creases_above(30.0) };
    let found = find(&mesh, &options).unwrap();
    for [a, b] in given {
        let has = |c: &&geometry::mesh::features::Curve| {
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
        min_crease_length: 0.5,
        turn_reach: 0.25,
        ridge_clearance: 0.25,
        resolution: mesh.positions().iter().map(|&p| f(p)).collect(),
        ..creases_above(30.0)
    };
    let found = |options: &FeatureOptions| find(&mesh, options).unwrap();
    let without = |by: f64| {
        found(&FeatureOptions {
            min_crease_length: 0.5 / by,
            turn_reach: 0.25 / by,
            ridge_clearance: 0.25 / by,
            ..creases_above(30.0)
        })
    };
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

#[test]
fn what_is_retained_keeps_its_corners() {
    let mesh = Shape::Genus(0).build(600);
    let mut features = find(&mesh, &creases_above(30.0)).unwrap();
    features.retain(|k, _| k == 0);
    assert_eq!(counts(&features), (0, 1, 2));
    features.retain(|_, _| false);
    assert_eq!(counts(&features), (0, 0, 0));
}
