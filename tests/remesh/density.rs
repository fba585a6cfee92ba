//! Promise: edges come out as long as they were asked to be. What a density is made of is tested in `tests/cvt/density.rs`.

use crate::surfaces;
use geometry::cvt::density::Outline;
use glam::DVec3;
use needs::needs;
use tessera::cvt::{DensityError, DensityOptions, DensitySource};
use tessera::mesh::TriMesh;
use tessera::mesh::closest_point::ClosestPoint;
use tessera::mesh::measure::topology;
use tessera::mesh::shapes::Shape;
use tessera::remesh::{Remesh, RemeshError, RemeshOptions, Seeds, remesh};
use tessera::rvd::Parallel;
use tessera::rvd::RvdError;
use tessera::token::{Stopped, Token};

fn run(mesh: &TriMesh, density: DensityOptions, seeds: Seeds, lloyd: usize) -> Result<Remesh, RemeshError> {
    let options = RemeshOptions::plain(seeds, lloyd).with_density(density);
    remesh(mesh, &options, &Parallel::new(None).unwrap(), &mut (), &Token::default())
}

fn sizes(mesh: &TriMesh, size: impl Fn(DVec3) -> f64) -> DensityOptions {
    DensityOptions::from_source(DensitySource::Sizes(mesh.positions().iter().map(|&p| size(p)).collect()))
}

/// Mean length of the edges at each vertex.
fn edges(mesh: &TriMesh) -> Vec<f64> {
    let mut sums = vec![(0.0, 0.0); mesh.positions().len()];
    for v in mesh.facets().iter().map(|f| f.map(|v| v as usize)) {
        for e in 0..3 {
            let (a, b) = (v[e], v[(e + 1) % 3]);
            let length = mesh.positions()[a].distance(mesh.positions()[b]);
            for end in [a, b] {
                sums[end] = (sums[end].0 + length, sums[end].1 + 1.0);
            }
        }
    }
    sums.into_iter().map(|(sum, count)| sum / count).collect()
}

/// Mean length of all edges.
fn mean_edge(mesh: &TriMesh) -> f64 {
    let corners = mesh.facets().iter().map(|f| f.map(|v| mesh.positions()[v as usize]));
    let sum: f64 = corners.map(|[a, b, c]| a.distance(b) + b.distance(c) + c.distance(a)).sum();
    sum / (3 * mesh.facets().len()) as f64
}

fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[((values.len() - 1) as f64 * share) as usize]
}

/// From 1 on the left to 20 on the right.
fn ramp(mesh: &TriMesh, least: f64) -> impl Fn(DVec3) -> f64 + use<> {
    let (low, high) = mesh.bounds();
    move |p: DVec3| least * (1.0 + 19.0 * ((p.x - low.x) / (high.x - low.x)).clamp(0.0, 1.0))
}

/// Medians over the result's vertices of |mean edge / target - 1|, and of the ratio itself.
fn departure(out: &Remesh, size: impl Fn(DVec3) -> f64) -> (f64, f64) {
    let lengths = edges(&out.mesh);
    let ratios: Vec<f64> = out.mesh.positions().iter().zip(lengths).map(|(&p, l)| l / size(p)).collect();
    (quantile(ratios.iter().map(|r| (r - 1.0).abs()).collect(), 0.5), quantile(ratios, 0.5))
}

#[test]
fn lengths_of_one_to_twenty_are_reproduced() {
    let cases = [
        (Shape::Sphere, 5000, 0.02),
        (Shape::Torus, 6000, 0.02),
        (Shape::Plane, 3000, 0.008),
        // Two facets: nearly all of the field is made by dividing them.
        (Shape::Square, 2, 0.008),
        (Shape::Sphere, 80, 0.02),
    ];
    for (shape, facets, least) in cases {
        let mesh = shape.build(facets);
        let size = ramp(&mesh, least);
        let out = run(&mesh, sizes(&mesh, &size), Seeds::Implied { seed: 1 }, 60).unwrap();
        let (off, ratio) = departure(&out, &size);
        let n = out.mesh.positions().len();
        let density = &out.report.density;
        println!("{shape} of {facets}: {n} vertices, median {off:.3} off, median ratio {ratio:.3}; {density:?}");
        assert!(off < 0.15, "{shape} of {facets}: {off}");
        let implied = density.points_implied.unwrap();
        assert!((n as f64 / implied - 1.0).abs() < 0.02, "{n} for {implied}");
        assert_eq!(density.clamped_vertices, 0);
        assert_eq!(topology(&out.mesh).euler, shape.euler());
    }
}

#[needs(meshes)]
#[test]
fn the_bunny_too() {
    let mesh = surfaces::real("stanford-bunny.obj");
    let (low, high) = mesh.bounds();
    let size = ramp(&mesh, 0.003 * (high.x - low.x));
    let tree = ClosestPoint::new(&mesh);
    let out = run(&mesh, sizes(&mesh, &size), Seeds::Implied { seed: 1 }, 60).unwrap();
    let (off, ratio) = departure(&out, |p| size(tree.project(p).position));
    println!("bunny: {} vertices, median {off:.3} off, median ratio {ratio:.3}", out.mesh.positions().len());
    assert!(off < 0.15, "{off}");
}

#[test]
fn an_edge_length_comes_out_on_closed_and_open_surfaces() {
    for (shape, edge) in [
        (Shape::Sphere, 0.1),
        (Shape::Torus, 0.08),
        (Shape::Plane, 0.025),
        (Shape::Hills, 0.025),
        (Shape::Genus(3), 0.05),
    ] {
        let mesh = shape.build(4000);
        let (low, high) = mesh.bounds();
        let edge = edge * if matches!(shape, Shape::Genus(_)) { (high - low).max_element() } else { 1.0 };
        let density = DensityOptions::new().with_edge_length(edge);
        let out = run(&mesh, density, Seeds::Implied { seed: 2 }, 60).unwrap();
        let mean = mean_edge(&out.mesh);
        println!("{shape}: {} vertices, mean edge {:.3} of the target", out.mesh.positions().len(), mean / edge);
        assert!((mean / edge - 1.0).abs() < 0.05, "{shape}: {mean} for {edge}");
        let outline = Outline::new(&mesh, &Token::default()).unwrap();
        assert!((outline.edge_length(outline.points(edge)) / edge - 1.0).abs() < 1e-9);
    }
}

#[test]
fn curvature_and_feature_size_gather_points_where_they_should() {
    // An ellipsoid, four times as long as thick: its ends are bent 16 times as much as its sides, and thinner.
    let ball = Shape::Sphere.build(6000);
    let stretch = DVec3::new(4.0, 1.0, 1.0);
    let mesh = TriMesh::new(ball.positions().iter().map(|&p| p * stretch).collect(), ball.facets().to_vec()).unwrap();
    for source in [DensitySource::Curvature, DensitySource::FeatureSize] {
        let name = source.name();
        let mut ends = Vec::new();
        for adaptivity in [0.0, 0.5, 1.0] {
            let density = DensityOptions::from_source(source.clone()).with_adaptivity(adaptivity);
            let out = run(&mesh, density, Seeds::Sample { points: 1500, seed: 1 }, 20).unwrap();
            let figures = &out.report.density;
            assert!((figures.points_implied.unwrap() / 1500.0 - 1.0).abs() < 0.01, "{figures:?}");
            let lengths = edges(&out.mesh);
            let mean = |wanted: &dyn Fn(DVec3) -> bool| {
                let some: Vec<f64> =
                    out.mesh.positions().iter().zip(&lengths).filter(|(p, _)| wanted(**p)).map(|(_, &l)| l).collect();
                some.iter().sum::<f64>() / some.len() as f64
            };
            ends.push(mean(&|p| p.x.abs() > 3.8) / mean(&|p| p.x.abs() < 1.0));
            println!("{name}, adaptivity {adaptivity}: {figures:?}");
        }
        println!("{name}: edges at the ends over edges at the sides {ends:.3?}");
        // At the ends both curvatures are 4 (a/b²), at the sides the larger is 1 (1/b): lengths 1 : 2. The medial
        // axis ends b²/a = 0.25 from the ends and is 1 from the sides: 1 : 4 at the very ends, less beside.
        assert!((ends[0] - 1.0).abs() < 0.1, "{ends:?}");
        assert!(ends[2] < 0.7 && ends[2] < ends[1] - 0.05 && ends[1] < ends[0] - 0.05, "{name}: {ends:?}");
    }
}

/// Sheets bent to parts of a cylinder are bent as much at their rims as inside: edges are as long there.
#[test]
fn rims_of_bent_sheets_have_edges_as_long_as_inside() {
    for (facets, points, turn) in [(5_000, 1_200, 1.5), (5_000, 300, 1.5), (20_000, 1_200, 1.0), (2_000, 600, 4.0)] {
        let sheet = Shape::Plane.build(facets);
        let bent = |p: &DVec3| DVec3::new((turn * p.x).cos(), (turn * p.x).sin(), turn * p.y);
        let mesh = TriMesh::new(sheet.positions().iter().map(bent).collect(), sheet.facets().to_vec()).unwrap();
        let density = DensityOptions::from_source(DensitySource::Curvature);
        let out = run(&mesh, density, Seeds::Sample { points, seed: 1 }, 30).unwrap();
        let mut count = std::collections::HashMap::new();
        for v in out.mesh.facets() {
            (0..3).for_each(|e| *count.entry([v[e].min(v[(e + 1) % 3]), v[e].max(v[(e + 1) % 3])]).or_insert(0) += 1);
        }
        let length = |[a, b]: [u32; 2]| out.mesh.positions()[a as usize].distance(out.mesh.positions()[b as usize]);
        let mean = |sides: i32| {
            let some: Vec<f64> = count.iter().filter(|(_, n)| **n == sides).map(|(&edge, _)| length(edge)).collect();
            some.iter().sum::<f64>() / some.len() as f64
        };
        let ratio = mean(1) / mean(2);
        println!("{facets} facets, {points} points, a turn of {turn}: {ratio:.3}");
        assert!((ratio - 1.0).abs() < 0.1, "{ratio}");
    }
}

/// Lengths that jump by ten: how round triangles are for several slopes. What 0.3 costs and brings is printed.
#[test]
fn gradation_keeps_triangles_round() {
    let mesh = Shape::Plane.build(8000);
    let jump = |p: DVec3| if p.x < 0.3 { 0.01 } else { 0.1 };
    let mut thin = Vec::new();
    for gradation in [0.1, 0.3, 0.6, f64::INFINITY] {
        let density = sizes(&mesh, jump).with_gradation(gradation);
        let out = run(&mesh, density, Seeds::Implied { seed: 1 }, 40).unwrap();
        let least: Vec<f64> = (0..out.mesh.facets().len())
            .map(|f| out.mesh.corners(f))
            .map(|p| {
                let angle = |e: usize| (p[(e + 1) % 3] - p[e]).angle_between(p[(e + 2) % 3] - p[e]).to_degrees();
                angle(0).min(angle(1)).min(angle(2))
            })
            .collect();
        let vertices = out.mesh.positions().len();
        let share = least.iter().filter(|&&a| a < 30.0).count() as f64 / least.len() as f64;
        let mean = least.iter().sum::<f64>() / least.len() as f64;
        println!("gradation {gradation}: {vertices} vertices, least angle {mean:.2} in the mean, under 30: {share:.4}");
        thin.push(share);
    }
    assert!(thin[1] < thin[3], "{thin:?}");
}

/// A coarse surface takes as many points as are asked for; a plan that was stopped stops the remesh.
#[test]
fn a_density_keeps_the_number_of_points_and_hears_the_token() {
    let mesh = Shape::ALL[0].build(60);
    let curvature = DensityOptions::from_source(DensitySource::Curvature);
    let out = run(&mesh, curvature, Seeds::Sample { points: 100, seed: 1 }, 3);
    assert_eq!(out.unwrap().mesh.positions().len(), 100);
    let cancelled = RemeshError::from(DensityError::Stopped(Stopped::Cancelled));
    assert!(matches!(cancelled, RemeshError::Rvd(RvdError::Stopped(Stopped::Cancelled))));
}
