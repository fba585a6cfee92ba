//! The whole pipeline on generated surfaces: topology kept, orientation kept, the same bits.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[path = "common/surfaces.rs"]
mod surfaces;

use glam::DVec3;
use tessera::cvt::Projection;
use tessera::mesh::TriMesh;
use tessera::mesh::measure::topology;
use tessera::mesh::shapes::Shape;
use tessera::remesh::{Remesh, RemeshError, RemeshOptions, Seeds, remesh};
use tessera::rvd::parallel::Parallel;
use tessera::rvd::serial::Serial;
use tessera::rvd::{Backend, CancelFlag, RvdError};

fn options(points: usize, lloyd: usize) -> RemeshOptions {
    RemeshOptions {
        seeds: Seeds::Sample { points, seed: 3 },
        lloyd,
        weights: None,
        projection: Projection::Free,
        measure: false,
    }
}

fn run(mesh: &TriMesh, options: &RemeshOptions, backend: &dyn Backend) -> Result<Remesh, RemeshError> {
    remesh(mesh, options, backend, &mut (), &CancelFlag::default())
}

/// Six times the volume inside a closed surface: positive if it is oriented outward.
fn volume(mesh: &TriMesh) -> f64 {
    (0..mesh.facets().len()).map(|f| mesh.corners(f)).map(|[a, b, c]| a.dot(b.cross(c))).sum()
}

#[test]
fn closed_surfaces_keep_their_topology_and_orientation() {
    let backend = Parallel::new(None).unwrap();
    for (shape, mesh) in surfaces::closed(4000) {
        for (points, lloyd) in [(1500, 0), (1500, 10), (400, 10)] {
            let out = run(&mesh, &options(points, lloyd), &backend).unwrap();
            let after = topology(&out.mesh);
            assert_eq!(after.euler, shape.euler(), "{shape}, {points} points, {lloyd} steps: {after:?}");
            assert_eq!(
                after,
                tessera::mesh::measure::Topology { euler: shape.euler(), components: 1, ..Default::default() }
            );
            let triangles = 2 * out.mesh.positions().len() as i64 - 2 * shape.euler();
            assert_eq!(out.mesh.facets().len() as i64, triangles, "{shape}");
            let kept = volume(&out.mesh) / volume(&mesh);
            assert!(kept > 0.7 && kept < 1.1, "{shape}, {points} points: volume {kept}");
            assert_eq!(out.vertex_seed.len(), out.mesh.positions().len());
        }
    }
}

#[test]
fn no_facet_joins_two_sheets() {
    let mesh = Shape::Sheets.build(2000);
    let out = run(&mesh, &options(300, 10), &Serial).unwrap();
    let after = topology(&out.mesh);
    assert_eq!((after.components, after.euler, after.boundary_loops), (2, 2, 2));
    let (low, high) = mesh.bounds();
    let middle = 0.5 * (low + high).z;
    for f in 0..out.mesh.facets().len() {
        let above = out.mesh.corners(f).map(|p| p.z > middle);
        assert!(above == [true; 3] || above == [false; 3], "facet {f} joins the sheets");
    }
}

#[test]
fn the_same_bits_on_any_number_of_threads() {
    for mesh in [Shape::Torus.build(3000), Shape::Slivers.build(3000)] {
        let want = run(&mesh, &options(500, 5), &Serial).unwrap();
        for threads in [1, 2, 3] {
            let backend = Parallel::new(Some(threads)).unwrap();
            let got = run(&mesh, &options(500, 5), &backend).unwrap();
            assert_eq!(got.mesh, want.mesh);
            assert_eq!(got.vertex_seed, want.vertex_seed);
        }
    }
}

#[test]
fn units_and_offset_do_not_matter() {
    let mesh = Shape::Torus.build(2000);
    let moved = |scale: f64, offset: DVec3| {
        let positions = mesh.positions().iter().map(|&p| p * scale + offset).collect();
        TriMesh::new(positions, mesh.facets().to_vec()).unwrap()
    };
    for (scale, offset) in [(1e-30, DVec3::ZERO), (1e30, DVec3::ZERO), (1.0, DVec3::splat(1e6))] {
        let out = run(&moved(scale, offset), &options(300, 5), &Serial).unwrap();
        let after = topology(&out.mesh);
        assert_eq!((after.euler, after.non_manifold_edges), (0, 0), "scale {scale}, offset {offset}");
        assert_eq!(out.mesh.positions().len(), 300);
    }
}

#[test]
fn given_seeds_are_the_vertices() {
    let mesh = Shape::Sphere.build(3000);
    let seeds: Vec<DVec3> = tessera::mesh::sample::sample(&mesh, None, 200, 9).iter().map(|p| p.position).collect();
    let out = run(&mesh, &RemeshOptions { seeds: Seeds::Given(seeds.clone()), ..options(0, 0) }, &Serial).unwrap();
    assert_eq!(out.mesh.positions().len(), 200);
    for (p, &seed) in out.mesh.positions().iter().zip(&out.vertex_seed) {
        assert!(p.distance(seeds[seed as usize]) < 1e-12);
    }
    assert!(matches!(
        run(&mesh, &RemeshOptions { seeds: Seeds::Given(vec![]), ..options(0, 0) }, &Serial),
        Err(RemeshError::Rvd(RvdError::NoSeeds))
    ));
    assert!(matches!(
        run(&mesh, &RemeshOptions { seeds: Seeds::Given(seeds[..2].to_vec()), ..options(0, 0) }, &Serial),
        Err(RemeshError::TooFewSeeds { seeds: 2 })
    ));
}

#[test]
fn weights_gather_seeds() {
    let mesh = Shape::Plane.build(4000);
    let weights: Vec<f64> = mesh.positions().iter().map(|p| if p.x > 0.5 { 1.0 } else { 1.0 / 256.0 }).collect();
    let out = run(&mesh, &RemeshOptions { weights: Some(weights), ..options(1000, 20) }, &Serial).unwrap();
    let right = out.mesh.positions().iter().filter(|p| p.x > 0.5).count() as f64;
    // Edge length ∝ w^(-1/4): four times as fine on the right, sixteen times as many seeds.
    let ratio = right / (1000.0 - right);
    assert!(ratio > 11.0 && ratio < 20.0, "{ratio}");
}
