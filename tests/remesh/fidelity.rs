//! Promise: fitted vertices bring the facets nearer to the input, refinement brings them within a tolerance, and
//! neither folds the surface.

use std::f64::consts::TAU;

use geometry::mesh::adjacency::Adjacency;
use glam::{DMat3, DVec3};
use tessera::mesh::TriMesh;
use tessera::mesh::closest_point::ClosestPoint;
use tessera::mesh::measure::{Topology, topology};
use tessera::mesh::shapes::Shape;
use tessera::remesh::report::RefineEnd;
use tessera::remesh::{Placement, Refine, Remesh, RemeshOptions, Seeds, Tolerance, remesh};
use tessera::rvd::Backend;
use tessera::rvd::Parallel;

use crate::long::some;
use crate::parts::tube;
use crate::rough::Random;
use tessera::token::Token;

fn options(points: usize) -> RemeshOptions {
    RemeshOptions::new(Seeds::Sample { points, seed: 2 }).with_newton(15).with_measure(false)
}

fn run_on(backend: &dyn Backend, mesh: &TriMesh, options: &RemeshOptions) -> Remesh {
    remesh(mesh, options, backend, &mut (), &Token::default()).unwrap()
}

fn run(mesh: &TriMesh, options: &RemeshOptions) -> Remesh {
    run_on(&Parallel::new(Some(2)).unwrap(), mesh, options)
}

fn distances(mesh: &TriMesh, result: &TriMesh) -> Vec<f64> {
    let tree = ClosestPoint::new(result);
    mesh.positions().iter().map(|&p| tree.distance(p)).collect()
}

/// Root of the mean square distance from the input's vertices, which are spread evenly, to the result.
fn rms(mesh: &TriMesh, result: &TriMesh) -> f64 {
    let all = distances(mesh, result);
    (all.iter().map(|d| d * d).sum::<f64>() / all.len() as f64).sqrt()
}

fn volume(mesh: &TriMesh) -> f64 {
    (0..mesh.facets().len()).map(|f| mesh.corners(f)).map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum()
}

fn normal(mesh: &TriMesh, f: usize) -> DVec3 {
    let [a, b, c] = mesh.corners(f);
    (b - a).cross(c - a).normalize_or_zero()
}

/// The smallest cosine between the normals of two neighbours.
fn sharpest(mesh: &TriMesh) -> f64 {
    let adjacency = Adjacency::new(mesh);
    (0..3 * mesh.facets().len())
        .filter_map(|h| adjacency.opposite(h).map(|o| normal(mesh, h / 3).dot(normal(mesh, o / 3))))
        .fold(1.0, f64::min)
}

/// Closed, outward, as the input has it, and with no two neighbours back to back.
fn is_sound(name: &str, mesh: &TriMesh, result: &TriMesh, least_cosine: f64) {
    let (before, after) = (topology(mesh), topology(result));
    let wanted = Topology { euler: before.euler, components: 1, ..Topology::default() };
    assert_eq!(after, wanted, "{name}");
    assert_eq!(Adjacency::new(result).inconsistent_edges, 0, "{name}");
    let kept = volume(result) / volume(mesh);
    assert!(kept > 0.85 && kept < 1.1, "{name}: volume {kept}");
    let cosine = sharpest(result);
    assert!(cosine > least_cosine, "{name}: neighbours at {}°", cosine.acos().to_degrees());
}

#[test]
fn fitted_beats_surface_beats_centroids() {
    for (shape, facets, points) in [(Shape::Sphere, 12_000, 400), (Shape::Torus, 12_000, 600)] {
        let mesh = shape.build(facets);
        let of = |placement| {
            let out = run(&mesh, &options(points).with_placement(placement));
            // Regular triangles on a curved surface, about ten edges around its tightest bend.
            is_sound(&format!("{shape}, {placement:?}"), &mesh, &out.mesh, 0.3);
            rms(&mesh, &out.mesh)
        };
        let [fitted, surface, centroids] = [Placement::Fitted, Placement::Surface, Placement::Centroids].map(of);
        println!("{shape}: fitted {fitted:e}, surface {surface:e}, centroids {centroids:e}");
        assert!(fitted < surface && surface < centroids, "{shape}: {fitted:e}, {surface:e}, {centroids:e}");
        // Facets on one side are off by κh²/12·√(…) in the mean; balanced ones by about a third of it.
        assert!(fitted < 0.6 * surface, "{shape}: {fitted:e} of {surface:e}");
    }
}

/// What the vertices of a placement are.
#[test]
fn vertices_are_where_the_placement_says() {
    let mesh = Shape::Torus.build(4000);
    let tree = ClosestPoint::new(&mesh);
    let farthest = |placement| {
        let out = run(&mesh, &options(300).with_placement(placement));
        assert_eq!(out.mesh.positions().len(), 300);
        out.mesh.positions().iter().map(|&p| tree.distance(p)).fold(0.0, f64::max)
    };
    assert!(farthest(Placement::Surface) < 1e-12);
    assert!(farthest(Placement::Fitted) > 1e-6);
    assert!(farthest(Placement::Centroids) > 1e-6);
}

/// Vertices of curves may leave these for the shapes of facets, but not so far that points are added for it.
#[test]
fn a_tolerance_holds_beside_curves() {
    for (name, mesh) in [("block", Shape::Block.build(5000)), ("tube", tube(96, 24))] {
        let (low, high) = mesh.bounds();
        let tolerance = 0.004 * (high - low).length();
        let mut added = 0;
        let seeds = some(5, 1..=24);
        for &seed in &seeds {
            let refine = Refine::new(Tolerance::Length(tolerance)).with_max_points(2500);
            let wish = options(250).with_refine(refine).with_seeds(Seeds::Sample { points: 250, seed }).with_newton(8);
            let figures = run(&mesh, &wish).report.refine;
            assert!(figures.out_of_tolerance == 0 && figures.added_seeds <= 10, "{name}, seed {seed}: {figures:?}");
            added += figures.added_seeds;
        }
        // One a remesh.
        assert!(added <= seeds.len(), "{name}: {added}");
    }
}

/// Points for a tolerance are as well spread as those that are asked for: the same number of these has triangles that are
/// not much rounder, and is farther away.
#[test]
fn points_for_a_tolerance_leave_triangles_round() {
    // A bump that a few points miss, on a ball.
    let ball = Shape::Sphere.build(20_000);
    let bump = |p: DVec3| p * (1.0 + 0.25 * (-80.0 * p.distance_squared(DVec3::X)).exp());
    let mesh = TriMesh::new(ball.positions().iter().map(|&p| bump(p)).collect(), ball.facets().to_vec()).unwrap();
    let farthest = |out: &Remesh| distances(&mesh, &out.mesh).into_iter().fold(0.0, f64::max);
    let measured = options(400).with_measure(true);
    let coarse = run(&mesh, &measured);
    let tolerance = 0.4 * farthest(&coarse);
    let refine = Refine::new(Tolerance::Length(tolerance)).with_max_points(1600);
    let fine = run(&mesh, &measured.clone().with_refine(refine));
    let even = run(&mesh, &options(fine.seeds.len()).with_measure(true));
    println!("{} points, {:?}", fine.seeds.len(), fine.report.refine);
    assert_eq!(fine.report.refine.out_of_tolerance, 0);
    assert!(farthest(&fine) <= tolerance && farthest(&fine) < farthest(&even));
    assert!(fine.seeds.len() < 800, "more than the bump has got points");
    let quality = fine.report.result.quality.unwrap();
    assert!(quality.theta_min_deg > 25.0 && quality.under_30_percent < 0.5, "{quality:?}");
}

#[test]
fn refinement_keeps_its_tolerance_or_uses_its_points_up() {
    let mut met = 0;
    let shapes = some(2, [Shape::Sphere, Shape::Torus, Shape::Block, Shape::Genus(1)]);
    for shape in &shapes {
        let mesh = shape.build(5000);
        let extent = (mesh.bounds().1 - mesh.bounds().0).max_element();
        for (share, max_points) in [(0.02, 2500), (0.006, 2500), (0.0005, 450)] {
            let tolerance = share * extent;
            let refine = Refine::new(Tolerance::Length(tolerance)).with_max_points(max_points);
            let out = run(&mesh, &options(250).with_refine(refine).with_newton(8));
            let name = format!("{shape}, {tolerance}, {max_points} points");
            let figures = &out.report.refine;
            let worst = distances(&mesh, &out.mesh).into_iter().fold(0.0, f64::max);
            println!("{name}: {} seeds, {worst:e} off, {figures:?}", out.seeds.len());
            assert!(out.seeds.len() <= max_points, "{name}");
            assert!(figures.added_seeds < out.seeds.len(), "{name}");
            if figures.out_of_tolerance == 0 {
                met += 1;
                assert!(worst <= tolerance * (1.0 + 1e-9), "{name}: {worst:e}");
                assert_eq!(figures.ended, Some(RefineEnd::Reached), "{name}");
            } else {
                let spent = out.seeds.len() as f64 > 0.9 * max_points as f64;
                assert!(spent || figures.ended == Some(RefineEnd::NoProgress), "{name}: {figures:?}");
            }
            is_sound(&name, &mesh, &out.mesh, -0.9);
        }
    }
    let all = 3 * shapes.len();
    assert!(12 * met >= 5 * all, "{met} of {all} tolerances were met");
}

#[test]
fn no_facet_turns_over() {
    for shape in [Shape::Torus, Shape::Slivers, Shape::Block, Shape::Genus(1)] {
        let mesh = shape.build(4000);
        for points in [500, 1200] {
            let out = run(&mesh, &options(points));
            let name = format!("{shape}, {points}");
            let after = topology(&out.mesh);
            assert_eq!((after.non_manifold_edges, after.boundary_edges), (0, 0), "{name}");
            assert!(volume(&out.mesh) > 0.0, "{name}");
            let cosine = sharpest(&out.mesh);
            // Right angles of blocks are the sharpest that there is; a fold is at 180°.
            assert!(cosine > -0.8, "{name}: neighbours at {}°", cosine.acos().to_degrees());
        }
    }
}

#[test]
fn the_same_bits_on_any_number_of_threads() {
    for mesh in [Shape::Torus.build(3000), Shape::Block.build(2000)] {
        let refine = Refine::new(Tolerance::Length(0.004)).with_max_points(500);
        for options in [options(300), options(300).with_refine(refine).with_newton(4)] {
            let want = run_on(&Parallel::new(Some(2)).unwrap(), &mesh, &options);
            for threads in [1, 3] {
                let got = run_on(&Parallel::new(Some(threads)).unwrap(), &mesh, &options);
                assert!(got.mesh == want.mesh, "{threads} threads");
                assert_eq!(got.vertex_seed, want.vertex_seed);
                assert_eq!(got.curve_edges, want.curve_edges);
                assert!(got.seeds == want.seeds);
                assert_eq!(got.report.refine, want.report.refine);
            }
        }
    }
}

/// The worst facets of an even result are made better where that brings no place farther from the input.
#[test]
fn smooth_surfaces_have_no_small_angles() {
    for shape in [Shape::Sphere, Shape::Torus] {
        let mesh = shape.build(20_000);
        for points in [2_000, 8_000] {
            let done = run(&mesh, &options(points).with_newton(40).with_measure(true));
            let quality = done.report.result.quality.as_ref().unwrap();
            assert!(quality.q_min > 0.7 && quality.theta_min_deg > 38.8, "{shape}, {points}: {quality:?}");
        }
    }
}

/// A boundary that bends between straight lines of a plane is no smooth curve: the bends stay, however small.
#[test]
fn plane_polygons_keep_their_corners() {
    let random = &mut Random::new(46);
    for sides in [5, 7, 10, 13, 17, 24u32] {
        let mut angle = |k: u32| TAU * (f64::from(k) + 0.25 * random.signed()) / f64::from(sides);
        let corners: Vec<DVec3> = (0..sides).map(&mut angle).map(|a| DVec3::new(a.cos(), a.sin(), 0.0)).collect();
        let turn = DMat3::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), f64::from(sides));
        // Each side in two edges.
        let rim = (0..corners.len()).flat_map(|k| [corners[k], 0.5 * (corners[k] + corners[(k + 1) % corners.len()])]);
        let positions: Vec<DVec3> = rim.chain([DVec3::ZERO]).map(|p| turn * p).collect();
        let around = 2 * sides;
        let mesh = TriMesh::new(positions, (0..around).map(|k| [k, (k + 1) % around, around]).collect()).unwrap();
        let done = run(&mesh, &options(4_000));
        let to = ClosestPoint::new(&done.mesh);
        let farthest = mesh.positions().iter().map(|&p| to.distance(p)).fold(0.0, f64::max);
        assert!(farthest < 1e-7, "{sides} sides: {farthest}");
    }
}
