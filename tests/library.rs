//! Promise: who needs the library alone finds it under one name, without any feature of the crate.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use tessera::mesh::sample::sample;
use tessera::mesh::shapes::Shape;
use tessera::{
    Backend, BackendChoice, BackendKind, BackendOptions, DensityOptions, DensitySource, Diagram, Placement, Refine,
    RemeshError, RemeshOptions, RvdError, Seeds, Stopped, Token, Tolerance, TriMesh, auto_backend, remesh,
};

fn parallel() -> std::sync::Arc<dyn Backend> {
    BackendOptions::new().with_choice(BackendChoice::Only(BackendKind::Parallel)).with_threads(2).open().unwrap()
}

#[test]
fn a_surface_is_remeshed_in_one_call() {
    let surface = Shape::Torus.build(1000);
    let density = DensityOptions::new().with_source(DensitySource::Curvature).with_gradation(0.5);
    let options = RemeshOptions::new(Seeds::Sample { points: 300, seed: 1 })
        .with_lloyd(3)
        .with_newton(3)
        .with_density(density)
        .with_placement(Placement::Fitted)
        .with_refine(Refine::new(Tolerance::Length(0.05)).with_max_points(800));
    let result = remesh(&surface, &options, auto_backend().unwrap().as_ref(), &mut (), &Token::default()).unwrap();
    assert_eq!(result.report.result.topology.euler, 0);
    let token = Token::default();
    token.cancel();
    let stopped = remesh(&surface, &options, parallel().as_ref(), &mut (), &token);
    assert!(matches!(stopped, Err(RemeshError::Rvd(RvdError::Stopped(Stopped::Cancelled)))));
}

/// A mesh far from the origin and in other units has the same diagram, in its own coordinates.
#[test]
fn a_diagram_is_in_the_caller_s_coordinates() {
    let near = Shape::Sphere.build(500);
    let seeds: Vec<_> = sample(&near, None, 40, 3).iter().map(|p| p.position).collect();
    let there = |p| 8.0 * p + glam::dvec3(64.0, 0.0, -32.0);
    let positions = near.positions().iter().map(|&p| there(p)).collect();
    let far = TriMesh::new(positions, near.facets().to_vec()).unwrap();
    let (backend, token) = (parallel(), Token::default());
    let mut a = Diagram::new(&near, &seeds, backend.as_ref()).unwrap();
    let moved: Vec<_> = seeds.iter().map(|&p| there(p)).collect();
    let mut b = Diagram::new(&far, &moved, backend.as_ref()).unwrap();
    let (here, far_off) = (a.cells(&token).unwrap(), b.cells(&token).unwrap());
    for i in 0..seeds.len() {
        assert!((far_off.areas[i] - 64.0 * here.areas[i]).abs() < 1e-9 * far.area());
        assert!((far_off.centroids[i] - there(here.centroids[i])).length() < 1e-9);
    }
    let facets = near.facets().len() as u32;
    let (all, none) = (b.pieces(0..u32::MAX, &token).unwrap(), b.pieces(facets..facets + 9, &token).unwrap());
    assert!(none.is_empty());
    let area: f64 = (0..all.len()).map(|i| all.area(i)).sum();
    assert!((area / far.area() - 1.0).abs() < 1e-9);
}

#[test]
fn what_is_wrong_is_said() {
    let mesh = Shape::Sphere.build(100);
    assert!(matches!(Diagram::new(&mesh, &[], parallel().as_ref()).err(), Some(RvdError::NoSeeds)));
    if cfg!(not(feature = "gpu")) {
        let gpu = BackendOptions::new().with_choice(BackendChoice::Only(BackendKind::Gpu)).open();
        let text = gpu.err().unwrap().to_string();
        assert!(text.contains("cargo feature `gpu`"), "{text}");
    }
}
