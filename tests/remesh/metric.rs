//! Promise: with a metric, edges have about length 1 in it; the result is a manifold of the same topology on the input, with its
//! boundaries and corners, and no facet is turned over.

use geometry::mesh::crossings::crossings;
use glam::{DVec3, dvec3};
use tessera::cvt::DensityError;
use tessera::mesh::attributes::{Attributes, Scalar};
use tessera::mesh::closest_point::ClosestPoint;
use tessera::mesh::measure::topology;
use tessera::mesh::shapes::Shape;
use tessera::mesh::tensor::Tensor;
use tessera::remesh::{Anisotropy, Refine, Remesh, RemeshError, RemeshOptions, Seeds, Tolerance, remesh};
use tessera::rvd::Parallel;
use tessera::{DensityOptions, DensitySource, Token, TriMesh};

use crate::long::some;
use crate::metrics::{Ground, Wanted, unit_edges};
use crate::rough::Random;

fn options(tensors: Vec<Tensor>, points: Option<usize>) -> RemeshOptions {
    let seeds = points.map_or(Seeds::Implied { seed: 0 }, |points| Seeds::Sample { points, seed: 0 });
    RemeshOptions::new(seeds).with_density(DensityOptions::from_source(DensitySource::Metric(tensors)))
}

fn run(mesh: &TriMesh, options: &RemeshOptions) -> Result<Remesh, RemeshError> {
    remesh(mesh, options, &Parallel::new(Some(2)).unwrap(), &mut (), &Token::default())
}

/// Topology, orientation, boundaries; vertices on the input.
fn assert_sound(name: &str, mesh: &TriMesh, result: &TriMesh) {
    let key = |mesh: &TriMesh| {
        let of = topology(mesh);
        (of.euler, of.components, of.boundary_loops, of.non_manifold_edges, of.non_manifold_vertices)
    };
    assert_eq!(key(result), key(mesh), "{name}");
    assert_eq!(crossings(result, &Token::default()).unwrap().count, 0, "{name}");
    let tree = ClosestPoint::new(mesh);
    let normal = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a).normalize_or_zero();
    for f in 0..result.facets().len() {
        let corners = result.corners(f);
        let at = tree.project(corners.iter().sum::<DVec3>() / 3.0);
        let cosine = normal(corners).dot(normal(mesh.corners(at.facet as usize)));
        assert!(cosine > 0.0, "{name}: facet {f} at {corners:?} is turned over, {cosine}");
    }
    for p in result.positions() {
        assert!(tree.project(*p).position.distance(*p) < 1e-9, "{name}: {p} is off the input");
    }
}

/// Metrics with edges that are 20 to 30 times as long as wide, and smooth random ones with up to 10.
fn cases(ground: Ground) -> Vec<(String, Wanted)> {
    let round = ground == Ground::Cylinder;
    let (through, across) =
        if round { (0.5 * DVec3::Z, DVec3::Z) } else { (dvec3(0.5, 0.5, 0.0), dvec3(0.8, 0.6, 0.0)) };
    let wall = if round { DVec3::Z } else { DVec3::Y };
    let (centre, radius) = match ground {
        Ground::Square => (dvec3(0.45, 0.5, 0.0), 0.3),
        Ground::Cylinder => (dvec3(0.3, 0.0, 0.5), 0.25),
        Ground::Wing => (dvec3(0.5, 0.5, 0.05), 0.3),
    };
    // The nose of the wing has a radius of about 0.01.
    let (most, mean) = if ground == Ground::Wing { (0.06, 0.02) } else { (0.1, 0.04) };
    let mut random = Random::new(1 + ground as u64);
    vec![
        ("shock".to_owned(), Wanted::Shock { through, across, least: most / 20.0, growth: 0.2, most }),
        ("layer".to_owned(), Wanted::Layer { across: wall, wall: 0.0, least: most / 30.0, growth: 8.0, most }),
        ("ring".to_owned(), Wanted::Ring { centre, radius, least: 0.0025, growth: 0.2, along: 0.05, most }),
        ("waves".to_owned(), Wanted::random(&mut random, mean)),
        ("other waves".to_owned(), Wanted::random(&mut random, mean)),
    ]
}

fn unit_edges_on(ground: Ground) {
    let mesh = ground.mesh(100);
    for (name, wanted) in cases(ground) {
        let name = format!("{ground:?}, {name}");
        let done = run(&mesh, &options(wanted.on(&mesh), None)).unwrap();
        let metric = done.report.result.metric.unwrap();
        let exact = unit_edges(&done.mesh, &wanted, metric.scale);
        assert!(exact >= 95.0 && metric.figures.unit_edges_percent >= 97.0, "{name}: {exact}, {metric:?}");
        // A few facets at the sharp trailing edge are slender.
        let least = if ground == Ground::Wing { 0.05 } else { 0.5 };
        assert!(metric.figures.quality_least > least && metric.figures.quality_mean > 0.9, "{name}: {metric:?}");
        assert_eq!((metric.scale, metric.facing_away), (1.0, 0), "{name}");
        let vertices = done.mesh.positions().len() as f64;
        // Edges of length 1 in the mean, and not 1 in the mean square.
        let implied = done.report.density.points_implied.unwrap();
        assert!((0.9..1.3).contains(&(vertices / implied)), "{name}: {vertices} for {implied}");
        assert_sound(&name, &mesh, &done.mesh);
    }
}

#[test]
fn edges_are_unit_edges_on_a_square() {
    unit_edges_on(Ground::Square);
}

#[test]
fn edges_are_unit_edges_on_a_cylinder() {
    unit_edges_on(Ground::Cylinder);
}

#[test]
fn edges_are_unit_edges_on_a_wing() {
    unit_edges_on(Ground::Wing);
}

fn waves(seed: u64) -> Wanted {
    Wanted::random(&mut Random::new(seed), 0.04)
}

/// Of the square: its corners, its area, and the places of all vertices of the boundary.
#[test]
fn boundaries_stay_and_a_number_of_vertices_is_reached() {
    let mesh = Ground::Square.mesh(40);
    for (seed, points) in [(1, 300), (2, 1000), (3, 2500)] {
        let done = run(&mesh, &options(waves(seed).on(&mesh), Some(points))).unwrap();
        let result = &done.mesh;
        let vertices = result.positions().len();
        // Lengths change by a few percent before an edge is split or collapses.
        assert!(vertices.abs_diff(points) <= points / 20, "{vertices} for {points}");
        let metric = done.report.result.metric.unwrap();
        assert!(metric.figures.unit_edges_percent > 97.0 && metric.scale != 1.0, "{metric:?}");
        assert!(unit_edges(result, &waves(seed), metric.scale) > 95.0);
        assert!((result.area() - 1.0).abs() < 1e-12, "{}", result.area());
        for corner in [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::X + DVec3::Y] {
            assert!(result.positions().contains(&corner), "{corner}");
        }
        for v in done.curve_edges.as_flattened() {
            let p = result.positions()[*v as usize];
            assert!([p.x, p.y].iter().any(|x| x.abs() < 1e-14 || (x - 1.0).abs() < 1e-14), "{p}");
        }
        assert_sound("square", &mesh, result);
    }
}

/// A metric is often known up to a factor: with a number of vertices the factor changes nothing.
#[test]
fn the_number_of_vertices_is_reached_whatever_the_scale() {
    let torus = Shape::Torus.build(2000);
    let tensor = Tensor::of_lengths([DVec3::X, DVec3::Y, DVec3::Z], [0.06, 0.3, 0.3]);
    let square = Ground::Square.mesh(30);
    for (name, mesh, tensors, points) in [
        ("torus", &torus, vec![tensor; torus.positions().len()], 400),
        ("torus", &torus, vec![tensor; torus.positions().len()], 1500),
        ("square", &square, vec![Tensor::of_length(0.05); square.positions().len()], 1200),
    ] {
        for factor in some(3, [1e-2, 0.1, 1.0, 10.0, 100.0]) {
            let scaled = tensors.iter().map(|&tensor| tensor * (factor * factor)).collect();
            let done = run(mesh, &options(scaled, Some(points))).unwrap();
            let vertices = done.mesh.positions().len();
            assert!(vertices.abs_diff(points) <= points / 20, "{name}, {factor}: {vertices} for {points}");
            let metric = done.report.result.metric.unwrap();
            assert!(metric.figures.unit_edges_percent > 95.0, "{name}, {factor}: {metric:?}");
            assert!((0.9..1.1).contains(&metric.figures.edge_mean), "{name}, {factor}: {metric:?}");
            assert_eq!(metric.facing_away, 0, "{name}, {factor}");
        }
    }
}

/// Creases are kept in one piece: all vertices of the block's edges are on them, and the length is the same.
#[test]
fn creases_stay() {
    let mesh = Shape::Block.build(3000);
    let axes = [DVec3::X, DVec3::Y, DVec3::Z];
    let tensors = vec![Tensor::of_lengths(axes, [0.05, 0.2, 0.2]); mesh.positions().len()];
    let done = run(&mesh, &options(tensors, None)).unwrap();
    let figures = done.report.result.metric.unwrap().figures;
    assert!(figures.unit_edges_percent > 90.0, "{figures:?}");
    assert_sound("block", &mesh, &done.mesh);
    assert!((done.mesh.area() / mesh.area() - 1.0).abs() < 1e-9, "{} {}", done.mesh.area(), mesh.area());
    let creases = |mesh: &TriMesh| -> f64 {
        let mut sides: std::collections::HashMap<[u32; 2], Vec<DVec3>> = std::collections::HashMap::new();
        for &[a, b, c] in mesh.facets() {
            let [p, q, r] = [a, b, c].map(|v| mesh.positions()[v as usize]);
            let normal = (q - p).cross(r - p).normalize();
            for [a, b] in [[a, b], [b, c], [c, a]] {
                sides.entry([a.min(b), a.max(b)]).or_default().push(normal);
            }
        }
        let at = |v: u32| mesh.positions()[v as usize];
        let bent = sides.iter().filter(|(_, normals)| normals[0].dot(normals[1]) < 0.5);
        bent.map(|([a, b], _)| at(*a).distance(at(*b))).sum()
    };
    assert!((creases(&done.mesh) - creases(&mesh)).abs() < 1e-9);
}

#[test]
fn the_bits_do_not_depend_on_threads_and_units_do_not_matter() {
    let mesh = Ground::Wing.mesh(40);
    let tensors = waves(7).on(&mesh);
    let on = |mesh: &TriMesh, options: &RemeshOptions, threads: usize| {
        remesh(mesh, options, &Parallel::new(Some(threads)).unwrap(), &mut (), &Token::default()).unwrap().mesh
    };
    let one = on(&mesh, &options(tensors.clone(), None), 1);
    assert_eq!(one, on(&mesh, &options(tensors.clone(), None), 4));
    let larger = mesh.positions().iter().map(|&p| 1024.0 * p).collect();
    let larger = TriMesh::new(larger, mesh.facets().to_vec()).unwrap();
    let tensors = tensors.iter().map(|&tensor| tensor * 1024f64.powi(-2)).collect();
    let in_other_units = on(&larger, &options(tensors, None), 2);
    let ratio = in_other_units.positions().len() as f64 / one.positions().len() as f64;
    assert!((0.97..1.03).contains(&ratio), "{ratio}");
    assert!((in_other_units.area() / one.area() / 1024f64.powi(2) - 1.0).abs() < 1e-3);
}

#[test]
fn parts_stay_apart_and_attributes_are_carried() {
    let mesh = Shape::Sheets.build(2000);
    let mut attributes = Attributes::new(&mesh);
    let heights = mesh.positions().iter().map(|p| p.x + 2.0 * p.y).collect();
    attributes.add_scalar(Scalar::new("height", heights)).unwrap();
    let axes = [DVec3::X, DVec3::Y, DVec3::Z];
    let tensors = vec![Tensor::of_lengths(axes, [0.05, 0.2, 0.2]); mesh.positions().len()];
    let done = run(&mesh, &options(tensors, None).with_attributes(attributes)).unwrap();
    assert_eq!(topology(&done.mesh).components, 2);
    assert_eq!((done.mesh.positions().len(), done.seeds.len()), (done.provenance.len(), done.vertex_seed.len()));
    let carried = done.attributes.unwrap();
    for (p, value) in done.mesh.positions().iter().zip(&carried.scalars()[0].values) {
        assert!((p.x + 2.0 * p.y - value).abs() < 1e-6, "{p}: {value}");
    }
    assert_sound("sheets", &mesh, &done.mesh);
}

#[test]
fn what_is_no_metric_is_refused() {
    let mesh = Ground::Square.mesh(4);
    let good = vec![Tensor::of_length(0.2); mesh.positions().len()];
    let refused = |change: &dyn Fn(&mut Vec<Tensor>)| {
        let mut tensors = good.clone();
        change(&mut tensors);
        match run(&mesh, &options(tensors, None)).unwrap_err() {
            RemeshError::Density(error) => error,
            other => panic!("{other}"),
        }
    };
    assert_eq!(refused(&|all| _ = all.pop()), DensityError::MetricCount { given: 24, vertices: 25 });
    assert_eq!(refused(&|all| all[3].0[1] = f64::NAN), DensityError::MetricNotFinite { vertex: 3 });
    assert_eq!(refused(&|all| all[4].0[5] = f64::INFINITY), DensityError::MetricNotFinite { vertex: 4 });
    let flat = |all: &mut Vec<Tensor>| all[7].0[5] = 0.0;
    assert_eq!(refused(&flat), DensityError::MetricNotPositive { vertex: 7, least: 0.0 });
    assert!(refused(&flat).to_string().contains("vertex 7"));
    let tiny = |all: &mut Vec<Tensor>| all.iter_mut().for_each(|tensor| *tensor = *tensor * 1e300);
    assert!(matches!(refused(&tiny), DensityError::TooManyPoints { .. } | DensityError::MetricRange { .. }));
    let of = |options: RemeshOptions| match run(&mesh, &options).unwrap_err() {
        RemeshError::Beside { other, .. } => other,
        other => panic!("{other}"),
    };
    assert_eq!(of(options(good.clone(), None).with_anisotropy(Anisotropy::Auto)), "anisotropy");
    let refine = Refine::new(Tolerance::DiagonalPercent(1.0));
    assert_eq!(of(options(good.clone(), Some(50)).with_refine(refine)), "a tolerance");
    assert_eq!(of(options(good.clone(), None).with_seeds(Seeds::Given(vec![DVec3::ZERO; 9]))), "seeds");
    assert_eq!(of(options(good.clone(), None).with_keep_non_manifold(true)), "non_manifold keep");
}
