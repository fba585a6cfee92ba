//! Promise: closest points, samples and measures are right on generated and on real surfaces.
//!
//! Real surfaces are read from the folder that `TESSERA_MESHES` names; without it those tests are ignored.

use std::path::PathBuf;

use glam::{DVec3, dvec3};
use needs::needs;
use tessera::mesh::closest_point::{ClosestPoint, SurfacePoint};
use tessera::mesh::io::read;
use tessera::mesh::measure::{quality, topology};
use tessera::mesh::sample::sample;
use tessera::mesh::shapes::Shape;
use tessera::mesh::{MeshError, TriMesh};
use tessera::token::{Stopped, Token};

/// For tests that `#[needs(meshes)]`.
fn real(name: &str) -> TriMesh {
    let folder = std::env::var_os("TESSERA_MESHES").expect("TESSERA_MESHES names a folder");
    read(&PathBuf::from(folder).join(name)).unwrap()
}

/// Points on, near and far from a surface.
fn queries(mesh: &TriMesh, count: usize) -> Vec<DVec3> {
    let (low, high) = mesh.bounds();
    let size = (high - low).max_element();
    let noise = sample(&Shape::Sphere.build(500), None, count, 5);
    let on = sample(mesh, None, count, 6);
    let reach = [0.0, 1e-12, 1e-3, 0.1, 3.0];
    noise.iter().zip(&on).enumerate().map(|(i, (n, s))| s.position + n.position * size * reach[i % 5]).collect()
}

/// Distance to all triangles by normal equations and three segments: slow, and simple enough to trust.
fn brute(mesh: &TriMesh, p: DVec3) -> f64 {
    let facet = |f: usize| {
        let [a, b, c] = mesh.corners(f);
        let segment = |a: DVec3, b: DVec3| {
            let t = ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
            (p - a.lerp(b, t)).length()
        };
        let (e, f) = (b - a, c - a);
        let (g, h, k) = (e.dot(e), e.dot(f), f.dot(f));
        let (r, s) = (e.dot(p - a), f.dot(p - a));
        let det = g * k - h * h;
        let (v, w) = ((r * k - s * h) / det, (s * g - r * h) / det);
        let edges = segment(a, b).min(segment(b, c)).min(segment(c, a));
        if v >= 0.0 && w >= 0.0 && v + w <= 1.0 { edges.min((p - a - e * v - f * w).length()) } else { edges }
    };
    (0..mesh.facets().len()).filter(|&f| !mesh.is_degenerate(f)).map(facet).fold(f64::INFINITY, f64::min)
}

fn check_point(mesh: &TriMesh, found: &SurfacePoint, size: f64) {
    let [a, b, c] = mesh.corners(found.facet as usize);
    let [u, v, w] = found.barycentric;
    assert!(u >= 0.0 && v >= 0.0 && w >= 0.0 && (u + v + w - 1.0).abs() < 1e-12, "{found:?}");
    assert!((a * u + b * v + c * w - found.position).length() <= 1e-12 * size, "{found:?}");
}

#[test]
fn closest_points_equal_brute_force() {
    for shape in Shape::ALL {
        let mesh = shape.build(400);
        let closest = ClosestPoint::new(&mesh);
        let (low, high) = mesh.bounds();
        let size = (high - low).max_element();
        for p in queries(&mesh, 200) {
            let found = closest.project(p);
            check_point(&mesh, &found, size);
            let (d, expected) = ((p - found.position).length(), brute(&mesh, p));
            assert!((d - expected).abs() <= 1e-9 * (size + expected), "{shape} {p}: {d} not {expected}");
            assert!((closest.distance(p) - d).abs() <= 1e-12 * (size + d), "{shape} {p}");
        }
    }
}

#[test]
fn vertices_answer_with_their_lowest_facet() {
    for mesh in [Shape::Torus.build(600), Shape::Block.build(600)] {
        let closest = ClosestPoint::new(&mesh);
        for (v, &p) in mesh.positions().iter().enumerate() {
            let found = closest.project(p);
            let lowest = mesh.facets().iter().position(|f| f.contains(&(v as u32))).unwrap();
            assert_eq!((found.position, found.facet), (p, lowest as u32));
        }
    }
}

/// Searches that begin where the last one ended find the same, to the bit, ties included.
#[test]
fn all_points_at_once() {
    for shape in Shape::ALL {
        let mesh = shape.build(700);
        let closest = ClosestPoint::new(&mesh);
        let mut points = queries(&mesh, 2000);
        points.extend_from_slice(mesh.positions());
        points.extend([DVec3::splat(-1e30), DVec3::splat(f64::MAX), DVec3::ZERO]);
        let (one, all) =
            (points.iter().map(|&p| closest.project(p)), closest.project_all(&points, &Token::default()).unwrap());
        assert!(one.eq(all), "{shape}");
        let (one, all) =
            (points.iter().map(|&p| closest.distance(p)), closest.distances(&points, &Token::default()).unwrap());
        assert!(one.eq(all), "{shape}");
        let stopped = Token::default();
        stopped.cancel();
        assert_eq!(closest.distances(&points, &stopped), Err(Stopped::Cancelled));
    }
}

#[test]
fn any_scale_any_place_any_shape() {
    let mesh = Shape::Block.build(500);
    for scale in [1e-300, 1e-30, 1.0, 1e30, 1e140] {
        let points: Vec<DVec3> = mesh.positions().iter().map(|p| *p * scale).collect();
        let scaled = TriMesh::new(points, mesh.facets().to_vec()).unwrap();
        let (one, other) = (ClosestPoint::new(&mesh), ClosestPoint::new(&scaled));
        for p in queries(&mesh, 100) {
            let (a, b) = (one.distance(p), other.distance(p * scale) / scale);
            assert!((a - b).abs() < 1e-12 * (1.0 + a), "{scale:e}: {a} {b}");
            check_point(&scaled, &other.project(p * scale), 2.0 * scale);
        }
        let q = quality(&scaled, &scaled);
        assert!(
            q.hausdorff_percent < 1e-10 && (q.q_avg - quality(&mesh, &mesh).q_avg).abs() < 1e-9,
            "{scale:e}: {q:?}"
        );
    }
    let closest = ClosestPoint::new(&mesh);
    for far in [1e20, 1e160, f64::MAX] {
        let found = closest.project(dvec3(-far, -far, -far));
        assert!(found.position.length() < 1e-9, "{found:?}");
    }
}

#[test]
fn degenerate_and_coincident_facets() {
    let points = vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::X * 2.0, DVec3::Z];
    let lists = [
        vec![[0, 1, 2]],
        vec![[0, 0, 1], [0, 1, 3], [0, 1, 2]],
        vec![[0, 1, 2]; 5000],
        vec![[0, 1, 1], [0, 1, 2], [1, 2, 4]],
    ];
    for facets in lists {
        let mesh = TriMesh::new(points.clone(), facets).unwrap();
        let closest = ClosestPoint::new(&mesh);
        for p in [DVec3::ZERO, dvec3(0.2, 0.2, 1.0), dvec3(9.0, 0.0, 0.0), dvec3(-1.0, -1.0, -1.0)] {
            let found = closest.project(p);
            check_point(&mesh, &found, 1.0);
            assert!(!mesh.is_degenerate(found.facet as usize));
            let same = |f: &usize| mesh.facets()[*f] == mesh.facets()[found.facet as usize];
            assert_eq!((0..mesh.facets().len()).find(same), Some(found.facet as usize));
        }
        assert!(quality(&mesh, &mesh).rms_percent < 1e-12);
    }
}

#[test]
fn samples_follow_the_density() {
    let plane = Shape::Plane.build(200);
    let count = 200_000;
    let uniform = sample(&plane, None, count, 1);
    assert_eq!(uniform.len(), count);
    let mean: DVec3 = uniform.iter().map(|s| s.position).sum::<DVec3>() / count as f64;
    assert!((mean - dvec3(0.5, 0.5, 0.0)).length() < 3e-3, "{mean}");
    uniform.iter().take(1000).for_each(|s| check_point(&plane, s, 1.0));
    assert_eq!(uniform[..100], sample(&plane, None, 100, 1));
    assert_ne!(uniform[..100], sample(&plane, None, 100, 2));

    // Two facets, w = 7x: density ∝ √x, so that the share below x is x^(3/2).
    let square = Shape::Square.build(2);
    let weights: Vec<f64> = square.positions().iter().map(|p| 7.0 * p.x).collect();
    let drawn = sample(&square, Some(&weights), count, 3);
    let below = |x: f64| drawn.iter().filter(|s| s.position.x < x).count() as f64 / count as f64;
    for x in [0.1f64, 0.25, 0.5, 0.9] {
        assert!((below(x) - x.powf(1.5)).abs() < 4e-3, "{x}: {}", below(x));
    }
    let none = vec![0.0; 4];
    assert_eq!(sample(&square, Some(&none), 10, 4), sample(&square, None, 10, 4));
    assert_eq!(sample(&square, Some(&[f64::NAN, 1.0, f64::INFINITY, -1.0]), 10, 4).len(), 10);
}

/// The bits of a fixed draw, so that another platform or a changed generator is noticed.
#[test]
fn samples_are_the_same_everywhere() {
    let drawn = sample(&Shape::Plane.build(50), None, 1000, 42);
    let bits = drawn.iter().flat_map(|s| s.position.to_array()).fold(0u64, |h, x| h.rotate_left(5) ^ x.to_bits());
    assert_eq!(bits, 0xb990_ad9a_0251_523a, "{bits:#x}");
}

/// Euler characteristic, components, boundary edges, non-manifold edges and vertices, as an
/// independent program counts them, and the holes.
#[needs(meshes)]
#[test]
fn topology_of_real_surfaces() {
    let expected = [
        ("stanford-bunny.obj", (-3, 1, 223, 0, 0, 5)),
        ("rocker-arm.obj", (0, 1, 0, 0, 0, 0)),
        ("fandisk.obj", (2, 1, 0, 0, 0, 0)),
        ("nefertiti.obj", (2, 1, 0, 0, 0, 0)),
        ("dragon_vrip_res3.ply", (1267, 1, 0, 2094, 2765, 0)),
    ];
    for (name, expected) in expected {
        let mesh = real(name);
        let t = topology(&mesh);
        let found =
            (t.euler, t.components, t.boundary_edges, t.non_manifold_edges, t.non_manifold_vertices, t.boundary_loops);
        assert_eq!(found, expected, "{name}");
    }
}

#[test]
fn quality_does_not_depend_on_threads() {
    let (fine, coarse) = (Shape::Torus.build(4000), Shape::Torus.build(500));
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| quality(&fine, &coarse))
    };
    let one = with(1);
    assert_eq!(one, with(3));
    assert!(one.hausdorff_percent > 0.1 && one.hausdorff_percent < 5.0 && one.rms_percent < one.hausdorff_percent);
}

#[test]
fn no_surface_at_all() {
    let corners = || vec![DVec3::ZERO, DVec3::X, DVec3::Y];
    let new = |positions: Vec<DVec3>, facets: &[[u32; 3]]| TriMesh::new(positions, facets.to_vec());
    assert_eq!(new(vec![], &[]), Err(MeshError::NoFacets));
    assert_eq!(new(corners(), &[]), Err(MeshError::NoFacets));
    let range = new(corners(), &[[0, 1, 2], [0, 1, u32::MAX]]).unwrap_err();
    assert!(matches!(range, MeshError::IndexOutOfRange { facet: 1, corner: 2, index: u32::MAX, vertices: 3 }));
    assert_eq!(new(corners(), &[[0, 0, 1], [2, 2, 2]]), Err(MeshError::NoArea { facets: 2 }));
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let error = new(vec![DVec3::ZERO, dvec3(1.0, bad, 0.0), DVec3::Y], &[[0, 1, 2]]).unwrap_err();
        assert!(matches!(error, MeshError::NonFinitePosition { vertex: 1, .. }), "{error}");
    }
    for extent in [1e150, 1e300, f64::MAX] {
        let huge = new(vec![DVec3::ZERO, DVec3::X * extent, DVec3::Y], &[[0, 1, 2]]).unwrap_err();
        assert!(matches!(huge, MeshError::ExtentTooLarge { .. }), "{huge}");
    }
    let wide = new(vec![DVec3::splat(-f64::MAX), DVec3::splat(f64::MAX), DVec3::Y], &[[0, 1, 2]]).unwrap_err();
    assert!(matches!(wide, MeshError::ExtentTooLarge { .. }), "{wide}");
}
