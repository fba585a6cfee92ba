//! Promise: a density follows from lengths, curvature or feature size, whatever the surface; no input makes one that eats the
//! budget, and what is wrong is refused by name.

use crate::surfaces;
use geometry::cvt::density::{Net, Outline, Plan, plan};
use glam::DVec3;
use needs::needs;
use tessera::cvt::{Count, DensityError, DensityOptions, DensitySource};
use tessera::mesh::TriMesh;
use tessera::mesh::shapes::Shape;
use tessera::token::{Stopped, Token};

fn planned<'a>(mesh: &'a TriMesh, density: &DensityOptions, count: Count) -> Result<Plan<'a>, DensityError> {
    plan(mesh, density, count, &Token::default())
}

fn sizes(mesh: &TriMesh, size: impl Fn(DVec3) -> f64) -> DensityOptions {
    DensityOptions::from_source(DensitySource::Sizes(mesh.positions().iter().map(|&p| size(p)).collect()))
}

/// Mean length of all edges.
fn mean_edge(mesh: &TriMesh) -> f64 {
    let corners = mesh.facets().iter().map(|f| f.map(|v| mesh.positions()[v as usize]));
    let sum: f64 = corners.map(|[a, b, c]| a.distance(b) + b.distance(c) + c.distance(a)).sum();
    sum / (3 * mesh.facets().len()) as f64
}

/// One vertex with a millionth of the others' length: it is brought to the bound, and gradation lets its
/// neighbourhood take a few hundred points however many there are.
#[test]
fn a_spike_does_not_eat_the_budget() {
    let mesh = Shape::Sphere.build(5000);
    let spike = mesh.positions()[17];
    let density = sizes(&mesh, |p| if p == spike { 1e-6 } else { 1.0 });
    let points = 5000;
    let plan = planned(&mesh, &density, Count::Points(points)).unwrap();
    let figures = &plan.figures;
    assert_eq!(figures.clamped_vertices, 1);
    assert!(figures.edge_least.unwrap() > figures.edge_median.unwrap() / 33.0, "{figures:?}");
    let drawn = tessera::mesh::sample::sample(&plan.mesh, plan.weights.as_deref(), points, 1);
    let near = drawn.iter().filter(|p| p.position.distance(spike) < 0.25).count();
    // Even points would have 1.6 % of the sphere's area there.
    println!("{near} of {points} points near the spike; {figures:?}");
    assert!(near < points / 10, "{near}");
}

/// Folds of noise, whose feature size is next to nothing, and a wedge whose sheets are as close together.
#[test]
fn edges_are_no_shorter_than_the_meshs_own_but_between_sheets() {
    let ball = Shape::Sphere.build(8000);
    let noise = |v: usize| 1.0 + 0.02 * ((v * 7919 % 101) as f64 / 50.0 - 1.0);
    let noisy = ball.positions().iter().enumerate().map(|(v, &p)| p * noise(v)).collect();
    let noisy = TriMesh::new(noisy, ball.facets().to_vec()).unwrap();
    let least = |mesh: &TriMesh, source, points| {
        let figures = planned(mesh, &DensityOptions::from_source(source), Count::Points(points)).unwrap().figures;
        println!("{points} points: {figures:?}, own edges {}", mean_edge(mesh));
        assert!((figures.points_implied.unwrap() / points as f64 - 1.0).abs() < 0.01, "{figures:?}");
        figures.edge_least.unwrap()
    };
    let own = mean_edge(&noisy);
    for source in [DensitySource::Curvature, DensitySource::FeatureSize] {
        // Heights of facets differ by a few tenths.
        assert!(least(&noisy, source.clone(), 500) > 0.6 * own);
        // So many points are to show more than the mesh has: half of what even ones are apart.
        let even = Outline::new(&noisy, &Token::default()).unwrap().edge_length(40_000.0);
        assert!(least(&noisy, source, 40_000) > 0.499 * even);
    }
    // Sheets 0.02 to 0.4 apart, edges of 0.1.
    let sheets = Shape::Sheets.build(400);
    let (low, high) = sheets.bounds();
    let wedge = |p: DVec3| {
        let x = (p.x - low.x) / (high.x - low.x);
        DVec3::new(2.0 * x, 2.0 * (p.y - low.y) / (high.y - low.y), (p.z - low.z).signum() * (0.02 + 0.38 * x))
    };
    let wedge = TriMesh::new(sheets.positions().iter().map(|&p| wedge(p)).collect(), sheets.facets().to_vec()).unwrap();
    assert!(least(&wedge, DensitySource::FeatureSize, 2000) < 0.25 * mean_edge(&wedge));
}

#[needs(meshes)]
#[test]
fn real_scans_and_parts_have_a_density() {
    for name in ["stanford-bunny.obj", "fandisk.obj", "rocker-arm.obj"] {
        let mesh = surfaces::real(name);
        for source in [DensitySource::Curvature, DensitySource::FeatureSize] {
            let begin = std::time::Instant::now();
            let density = DensityOptions::from_source(source);
            let plan = planned(&mesh, &density, Count::Points(5000)).unwrap();
            let figures = &plan.figures;
            println!("{name}, {} facets, {} ms: {figures:?}", mesh.facets().len(), begin.elapsed().as_millis());
            assert!((figures.points_implied.unwrap() / 5000.0 - 1.0).abs() < 0.01, "{figures:?}");
            let ratio = figures.edge_largest.unwrap() / figures.edge_least.unwrap();
            assert!(ratio > 1.5 && ratio <= 100.0 * (1.0 + 1e-12), "{name}: {ratio}");
            let gathered = plan.weights.unwrap();
            assert!(gathered.iter().all(|w| (1e-9..=1.0).contains(w)));
        }
    }
}

#[test]
fn the_same_bits_on_any_number_of_threads() {
    let mesh = Shape::Hills.build(4000);
    for source in [DensitySource::Curvature, DensitySource::FeatureSize] {
        let density = DensityOptions::from_source(source);
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| planned(&mesh, &density, Count::Points(800)).unwrap().weights.unwrap())
        };
        let one = on(1);
        assert!(on(2) == one && on(5) == one);
    }
}

#[test]
fn units_and_offset_do_not_matter() {
    let mesh = Shape::Torus.build(2000);
    for source in [DensitySource::Curvature, DensitySource::FeatureSize] {
        let density = DensityOptions::from_source(source);
        let want = planned(&mesh, &density, Count::Points(500)).unwrap().sizes.unwrap();
        for (scale, offset) in [(1e-200, 0.0), (1e100, 0.0), (1e-9, 0.0), (1.0, 1e5)] {
            let moved = mesh.positions().iter().map(|&p| p * scale + DVec3::splat(offset)).collect();
            let moved = TriMesh::new(moved, mesh.facets().to_vec()).unwrap();
            let got = planned(&moved, &density, Count::Points(500)).unwrap().sizes.unwrap();
            let off = want.iter().zip(&got).map(|(w, g)| (g / scale / w - 1.0).abs()).fold(0.0, f64::max);
            // At an offset of 1e5 coordinates have 11 digits; a ball that stops a sample earlier moves a length
            // by about the square of the samples' distance.
            assert!(off < 1e-2, "{density:?}: scale {scale:e}, offset {offset:e}: {off}");
            let edge = Outline::new(&moved, &Token::default()).unwrap().edge_length(1000.0);
            assert!(
                (edge / scale / Outline::new(&mesh, &Token::default()).unwrap().edge_length(1000.0) - 1.0).abs() < 1e-6
            );
        }
    }
}

/// Facets without area, edges of three facets, several components, vertices that no facet uses.
#[test]
fn broken_surfaces_have_a_density() {
    let fan = |extra: &[[u32; 3]]| {
        let mut points: Vec<DVec3> = (0..12).map(|i| DVec3::new(f64::from(i % 4), f64::from(i / 4), 0.0)).collect();
        points.extend([DVec3::new(1.0, 1.0, 2.0), DVec3::splat(1e200), DVec3::splat(5.0)]);
        let mut facets = vec![[0, 1, 4], [1, 5, 4], [1, 2, 5], [2, 6, 5], [1, 5, 12], [8, 9, 10], [3, 3, 7]];
        facets.extend_from_slice(extra);
        TriMesh::new(points, facets).unwrap()
    };
    let mut all: Vec<TriMesh> = Shape::ALL.iter().map(|s| s.build(60)).collect();
    all.extend([fan(&[]), fan(&[[5, 1, 0], [10, 9, 8]]), fan(&[[0, 1, 2], [4, 5, 6]])]);
    for mesh in &all {
        for source in [DensitySource::Curvature, DensitySource::FeatureSize] {
            for points in if source == DensitySource::Curvature { vec![1, 20, 3000] } else { vec![20] } {
                let plan = planned(mesh, &DensityOptions::from_source(source.clone()), Count::Points(points)).unwrap();
                assert!(plan.sizes.unwrap().iter().all(|h| h.is_finite() && *h > 0.0));
                assert!(plan.weights.unwrap().iter().all(|w| w.is_finite() && *w > 0.0 && *w <= 1.0));
            }
        }
    }
}

#[test]
fn bad_values_are_refused_by_name() {
    let mesh = Shape::Sphere.build(200);
    let vertices = mesh.positions().len();
    let implied = |density: &DensityOptions| planned(&mesh, density, Count::Implied).unwrap_err();
    for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let mut given = vec![1.0; vertices];
        given[7] = bad;
        let error = implied(&DensityOptions::from_source(DensitySource::Sizes(given)));
        assert!(matches!(error, DensityError::BadSize { vertex: 7, .. }), "{error}");
        assert!(error.to_string().contains("vertex 7"));
        for density in [
            DensityOptions::new().with_edge_length(bad),
            DensityOptions::new().with_gradation(-bad.abs()),
            DensityOptions::new().with_ratio(bad),
            DensityOptions::new().with_adaptivity(-2.0 - bad),
        ] {
            assert!(matches!(implied(&density), DensityError::BadOption { .. }), "{density:?}");
        }
    }
    let short = DensityOptions::from_source(DensitySource::Sizes(vec![1.0; 5]));
    assert_eq!(implied(&short), DensityError::SizeCount { given: 5, vertices });
    assert_eq!(implied(&DensityOptions::default()), DensityError::NoCount);
    assert_eq!(implied(&DensityOptions::from_source(DensitySource::Curvature)), DensityError::NoCount);
    for tiny in [1e-9, 1e-200, 5e-324] {
        let density = DensityOptions::new().with_edge_length(tiny).with_max_points(1000);
        assert!(matches!(implied(&density), DensityError::TooManyPoints { limit: 1000, .. }));
        let density = sizes(&mesh, |_| tiny).with_max_points(1000);
        assert!(matches!(implied(&density), DensityError::TooManyPoints { limit: 1000, .. }));
    }
    for source in [DensitySource::Uniform, DensitySource::Curvature] {
        let density = DensityOptions::from_source(source).with_max_points(1000);
        let error = plan(&mesh, &density, Count::Points(1001), &Token::default()).unwrap_err();
        assert_eq!(error, DensityError::PointLimit { points: 1001, limit: 1000 });
    }
    let stopped_token = Token::default();
    stopped_token.cancel();
    let stopped =
        plan(&mesh, &DensityOptions::from_source(DensitySource::Curvature), Count::Points(10), &stopped_token);
    assert_eq!(stopped.unwrap_err(), DensityError::Stopped(Stopped::Cancelled));
    assert_eq!(Net::new(&mesh, &Token::default()).unwrap().outline(), &Outline::new(&mesh, &Token::default()).unwrap());
}
