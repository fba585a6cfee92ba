//! Promise: what is thinner than the edges of a remesh stays, as edges become shorter there and nowhere else.

use glam::DVec3;
use tessera::cvt::{DensityOptions, DensitySource};
use tessera::mesh::TriMesh;
use tessera::mesh::closest_point::ClosestPoint;
use tessera::mesh::measure::topology;
use tessera::mesh::shapes::Shape;
use tessera::remesh::{Remesh, RemeshOptions, Seeds, remesh};
use tessera::rvd::Parallel;
use tessera::token::Token;

use super::rough::turned;

fn options(points: usize) -> RemeshOptions {
    RemeshOptions::new(Seeds::Sample { points, seed: 5 }).with_newton(10).with_crease_angle_deg(0.0)
}

fn run(mesh: &TriMesh, options: &RemeshOptions) -> Remesh {
    remesh(mesh, options, &Parallel::new(Some(2)).unwrap(), &mut (), &Token::default()).unwrap()
}

/// A unit ball with a horn, 3 long, whose radius goes from 0.15 to 0.05 and ends round.
fn horned() -> TriMesh {
    let horn = (0..60).map(|k| f64::from(k) / 60.0).map(|t| (1.0 + 3.0 * t, 0.15 - 0.1 * t));
    let end = (1..6).map(|k| f64::from(k) / 6.0 * std::f64::consts::FRAC_PI_2);
    let end = end.map(|t| (4.0 + 0.05 * t.sin(), 0.05 * t.cos()));
    let low = (-29..30).map(|k| f64::from(k) / 30.0 * std::f64::consts::FRAC_PI_2);
    let low = low.map(|t| (t.sin(), t.cos())).filter(|p| p.1 > 0.16 || p.0 < 0.0);
    let profile: Vec<(f64, f64)> =
        [(-1.0, 0.0)].into_iter().chain(low).chain(horn).chain(end).chain([(4.05, 0.0)]).collect();
    turned(&profile, 24)
}

/// Two unit balls 3 apart with a bridge of radius 0.04 between them.
fn bridged() -> TriMesh {
    let arc = |k: i32| f64::from(k) / 30.0 * std::f64::consts::FRAC_PI_2;
    let low = (-29..30).map(arc).map(|t| (t.sin(), t.cos())).filter(|p| p.1 > 0.05);
    let bridge = (0..=40).map(|k| (1.0 + f64::from(k) / 40.0, 0.04));
    let high = (-29..30).map(arc).map(|t| (3.0 + t.sin(), t.cos())).filter(|p| p.1 > 0.05);
    let profile: Vec<(f64, f64)> =
        [(-1.0, 0.0)].into_iter().chain(low).chain(bridge).chain(high).chain([(4.0, 0.0)]).collect();
    turned(&profile, 24)
}

/// A ring of radius 1 whose tube has radii from 0.04 to 0.4.
fn ring() -> TriMesh {
    let (positions, facets) = Shape::Torus.build(6000).into_parts();
    let thinner = |p: DVec3| {
        let on = DVec3::new(p.x, p.y, 0.0).normalize();
        on + (0.1 + 0.9 * (0.5 + 0.5 * on.x).powi(2)) * (p - on)
    };
    TriMesh::new(positions.into_iter().map(thinner).collect(), facets).unwrap()
}

/// A unit ball with a needle, 2 long, that ends in a point.
fn needled(radius: f64) -> TriMesh {
    let low = (-29..30).map(|k| f64::from(k) / 30.0 * std::f64::consts::FRAC_PI_2).map(|t| (t.sin(), t.cos()));
    let low = low.filter(|p| p.1 > 1.1 * radius || p.0 < 0.0);
    let needle = (0..40).map(|k| f64::from(k) / 40.0).map(|t| (1.0 + 2.0 * t, radius * (1.0 - t)));
    let profile: Vec<(f64, f64)> = [(-1.0, 0.0)].into_iter().chain(low).chain(needle).chain([(3.0, 0.0)]).collect();
    turned(&profile, 24)
}

/// A closed sheet in three waves, 1 long and 0.5 wide.
fn waves(thickness: f64) -> TriMesh {
    let (along, across) = (120u32, 12u32);
    let place = |k: u32, side: f64| {
        let (x, y) = (f64::from(k / (across + 1)) / f64::from(along), f64::from(k % (across + 1)) / f64::from(across));
        let turn = 6.0 * std::f64::consts::PI * x;
        let normal = DVec3::new(-0.3 * std::f64::consts::PI * turn.cos(), 0.0, 1.0).normalize();
        DVec3::new(x, 0.5 * y, 0.05 * turn.sin()) + 0.5 * side * thickness * normal
    };
    let count = (along + 1) * (across + 1);
    let positions = [1.0, -1.0].into_iter().flat_map(|side| (0..count).map(move |k| place(k, side))).collect();
    let at = |i: u32, j: u32| i * (across + 1) + j;
    let mut facets: Vec<[u32; 3]> = Vec::new();
    for (i, j) in (0..along).flat_map(|i| (0..across).map(move |j| (i, j))) {
        let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
        facets.extend([[a, b, c], [a, c, d]]);
        facets.extend([[a, c, b], [a, d, c]].map(|t| t.map(|v| v + count)));
    }
    let mut rim: Vec<u32> = (0..along).map(|i| at(i, 0)).collect();
    rim.extend((0..across).map(|j| at(along, j)));
    rim.extend((1..=along).rev().map(|i| at(i, across)));
    rim.extend((1..=across).rev().map(|j| at(0, j)));
    for k in 0..rim.len() {
        let [a, b] = [rim[k], rim[(k + 1) % rim.len()]];
        facets.extend([[b, a, a + count], [b, a + count, b + count]]);
    }
    TriMesh::new(positions, facets).unwrap()
}

/// How far the input's vertices are from a result at most.
fn farthest(mesh: &TriMesh, result: &TriMesh) -> f64 {
    let tree = ClosestPoint::new(result);
    mesh.positions().iter().map(|&p| tree.project(p).position.distance(p)).fold(0.0, f64::max)
}

/// The edge of a triangle, where so many vertices are even on a surface.
fn edge(mesh: &TriMesh, points: usize) -> f64 {
    (2.0 / 3f64.sqrt() * mesh.area() / points as f64).sqrt()
}

#[test]
fn a_horn_stays() {
    let mesh = horned();
    let points = 300;
    let even = run(&mesh, &options(points).with_keep_thin(false));
    let finer = run(&mesh, &options(points));
    let edge = edge(&mesh, points);
    // Around the horn's tip are 0.31, less than two edges.
    assert!(edge > 0.2, "{edge}");
    let (before, after) = (farthest(&mesh, &even.mesh), farthest(&mesh, &finer.mesh));
    assert!(before > 2.0 * edge, "the test shows nothing: {before}");
    // The last cell, which holds the tip as a whole, is the smallest of a few that are graded.
    assert!(after < 0.5 * edge, "{after}, edges {edge}");
    let refine = &finer.report.refine;
    assert!(refine.closed_ball_rounds > 0 && refine.closed_ball_failures == 0, "{refine:?}");
    assert_eq!((topology(&finer.mesh).euler, topology(&finer.mesh).components), (2, 1));
    assert_eq!(finer.seeds.len(), points);
    assert_eq!(finer.report.density.source, "uniform");
    // Not more than half of the points are there, so that edges elsewhere are longer by the root of two at most.
    let figures = &finer.report.density;
    assert!(figures.edge_median.unwrap() < 1.42 * even.report.density.edge_median.unwrap());
    assert!(figures.edge_least.unwrap() < 0.7 * edge);
}

#[test]
fn a_bridge_and_a_thin_ring_stay() {
    for (name, mesh, euler) in [("bridge", bridged(), 2), ("ring", ring(), 0)] {
        let points = 600;
        let finer = run(&mesh, &options(points));
        let after = topology(&finer.mesh);
        assert_eq!((after.euler, after.components, after.boundary_loops), (euler, 1, 0), "{name}");
        let even = run(&mesh, &options(points).with_keep_thin(false));
        let fails = !even.report.topology_changes.is_empty() || even.report.result.repair.seeds_without_vertex > 0;
        assert!(fails, "{name}: the test shows nothing");
        assert!(finer.report.topology_changes.is_empty(), "{name}: {:?}", finer.report.topology_changes);
    }
}

/// No cell is as small as what is near the tip of a needle.
#[test]
fn a_needle_keeps_its_tip() {
    for (radius, points) in [(0.02, 60), (0.02, 300), (0.1, 100), (0.1, 1000)] {
        let mesh = needled(radius);
        let out = run(&mesh, &options(points));
        let (far, edge) = (farthest(&mesh, &out.mesh), edge(&mesh, points));
        assert!(far < 0.5 * edge, "{radius}, {points} points: {far}, edges {edge}");
        let after = topology(&out.mesh);
        assert_eq!((after.euler, after.components, after.non_manifold_edges), (2, 1, 0), "{radius}, {points} points");
        assert_eq!(out.report.result.crossings.as_ref().unwrap().count, 0);
    }
}

/// Chords leave a wave by more than the sheet is thick.
#[test]
fn bent_sheets_do_not_cross() {
    let (mesh, points) = (waves(0.01), 500);
    let crossing = |out: &Remesh| out.report.result.crossings.as_ref().unwrap().count;
    assert!(crossing(&run(&mesh, &options(points).with_keep_thin(false))) > 0, "the test shows nothing");
    let out = run(&mesh, &RemeshOptions::new(Seeds::Sample { points, seed: 0 }).with_crease_angle_deg(0.0));
    assert_eq!(crossing(&out), 0);
    assert_eq!((topology(&out.mesh).euler, topology(&out.mesh).boundary_edges), (2, 0));
    let vertices = out.mesh.positions().len();
    assert!(vertices.abs_diff(points) <= points / 50, "{vertices} of {points}");
}

/// What holds is left as it is, and who says how long edges are is not contradicted.
#[test]
fn nothing_changes_where_cells_hold_or_lengths_are_given() {
    let same = |a: &Remesh, b: &Remesh| a.mesh == b.mesh && a.seeds == b.seeds;
    for mesh in [Shape::Sphere.build(3000), Shape::Genus(2).build(3000)] {
        let even = run(&mesh, &options(700).with_keep_thin(false));
        let finer = run(&mesh, &options(700));
        assert!(same(&even, &finer));
        assert_eq!((finer.report.refine.closed_ball_rounds, finer.report.refine.closed_ball_failures), (0, 0));
    }
    let mesh = horned();
    let lengths = vec![1.0; mesh.positions().len()];
    let density = DensityOptions::from_source(DensitySource::Sizes(lengths));
    let given = options(200).with_density(density);
    let out = run(&mesh, &given);
    assert_eq!(out.report.refine.closed_ball_rounds, 0);
    assert!(same(&out, &run(&mesh, &given.with_keep_thin(false))));
}

#[test]
fn the_same_bits_on_any_number_of_threads() {
    let mesh = horned();
    let on = |threads| {
        let backend = Parallel::new(Some(threads)).unwrap();
        remesh(&mesh, &options(200), &backend, &mut (), &Token::default()).unwrap()
    };
    let (one, three) = (on(1), on(3));
    assert!(one.report.refine.closed_ball_rounds > 0);
    assert!(one.mesh == three.mesh);
}

/// Two horns that touch in a point, where no seeds can help: rounds end, and the result is a manifold.
#[test]
fn what_is_no_manifold_is_not_looked_at_for_ever() {
    let horn = horned();
    let (mut positions, mut facets) = horn.clone().into_parts();
    let n = positions.len() as u32;
    // The other one upside down above it; they share the tip.
    positions.extend(horn.positions().iter().map(|p| DVec3::new(p.x, -p.y, 8.1 - p.z)));
    facets.extend(horn.facets().iter().map(|t| t.map(|v| if v == n - 1 { v } else { v + n })));
    let mesh = TriMesh::new(positions, facets).unwrap();
    assert_eq!(topology(&mesh).non_manifold_vertices, 1);
    let out = run(&mesh, &options(500));
    let after = out.report.result.topology;
    assert_eq!((after.non_manifold_vertices, after.non_manifold_edges, after.boundary_edges), (0, 0, 0));
    assert!(farthest(&mesh, &out.mesh) < edge(&mesh, 500));
}
