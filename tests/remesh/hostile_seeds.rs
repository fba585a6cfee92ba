//! Promise: seeds that lie on each other, in a lattice, on a circle, on the mesh's own vertices or far from the surface give an
//! oriented 2-manifold or a typed error, on every backend. The diagrams of the same seeds are in `common/conformance/degenerate.rs`.

use std::sync::Arc;

use crate::hostile::{backends, options, remeshed, run};
use crate::{cases, points};
use glam::{DVec3, dvec3};
use tessera::mesh::TriMesh;
use tessera::mesh::measure::topology;
use tessera::mesh::shapes::Shape;
use tessera::remesh::{RemeshError, Seeds};
use tessera::rvd::Serial;
use tessera::rvd::{MAX_SEED_DISTANCE, RvdError, Surface};

fn surface(mesh: &TriMesh) -> Arc<Surface> {
    Arc::new(Surface::new(mesh, None).unwrap())
}

fn on(surface: &Surface, count: usize) -> Vec<DVec3> {
    points::on_surface(surface, count, &mut points::rng(9)).into_iter().map(|x| x.1).collect()
}

fn world(surface: &Surface, seeds: &[DVec3]) -> Seeds {
    Seeds::Given(seeds.iter().map(|&p| surface.frame().to_world(p)).collect())
}

#[test]
fn one_two_and_three() {
    let mesh = Shape::Sphere.build(500);
    let surface = surface(&mesh);
    let seeds = [DVec3::X * 0.5, DVec3::Y * 0.5, dvec3(-0.3, -0.3, 0.2)];
    for count in 1..=3 {
        // The cells of three seeds meet in two points: one triangle and its back, which close on each other.
        for (backend, _) in backends() {
            let out = run(&mesh, &options(world(&surface, &seeds[..count]), 0), backend);
            assert!(matches!(out, Err(RemeshError::TooFewSeeds { seeds, .. }) if seeds == count), "{count}");
        }
    }
}

#[test]
fn on_each_other() {
    let mesh = Shape::Torus.build(600);
    let surface = surface(&mesh);
    let single = on(&surface, 80);
    for (name, seeds, duplicates) in points::duplicate_sets(&single) {
        // Lloyd places twins anew; without a step they are left out, and the report says so.
        let wish = options(world(&surface, &seeds), 0);
        match run(&mesh, &wish, &Serial) {
            Ok(out) => assert_eq!(out.report.rvd.duplicate_seeds, duplicates, "{name}"),
            Err(error) => {
                assert!(matches!(error, RemeshError::TooFewSeeds { .. } | RemeshError::NoThickness), "{name}: {error}")
            }
        }
        for out in remeshed(name, &mesh, &options(world(&surface, &seeds), 12)) {
            assert_eq!(out.seeds.len(), seeds.len(), "{name}");
        }
    }
    let pairs: Vec<DVec3> = single.iter().flat_map(|&p| [p, p]).collect();
    for out in remeshed("pairs as they are", &mesh, &options(world(&surface, &pairs), 0)) {
        assert_eq!((out.report.rvd.empty_cells, out.report.rvd.duplicate_seeds), (80, 80));
        assert!(out.vertex_seed.iter().all(|s| s % 2 == 0));
    }
}

#[test]
fn nearly_on_each_other() {
    let mesh = Shape::Sphere.build(500);
    let surface = surface(&mesh);
    let single = on(&surface, 60);
    for gap in [1e-7, 1e-9, 1e-12, 1e-15] {
        let seeds = points::nearly_twice(&single, gap);
        let out = run(&mesh, &options(world(&surface, &seeds), 0), &Serial).unwrap();
        cases::manifold(out.mesh.facets(), out.mesh.positions().len()).unwrap_or_else(|e| panic!("{gap} apart: {e}"));
    }
}

#[test]
fn in_lattices_and_on_circles() {
    for side in [2, 5, 16] {
        let plane = Shape::Plane.build(2 * side * side);
        let surface = surface(&plane);
        // In the corners and in the middles of the facets' own grid.
        for shift in [0.0, 0.5] {
            let seeds = points::square_lattice(side, shift);
            let name = format!("{side} by {side} shifted {shift}");
            for out in remeshed(&name, &plane, &options(world(&surface, &seeds), 0)) {
                let seen = topology(&out.mesh);
                assert_eq!((seen.euler, seen.components, seen.boundary_loops), (1, 1, 1), "{name}");
            }
        }
    }
    let square = Shape::Plane.build(200);
    let surface = surface(&square);
    for count in [4, 6, 12, 64] {
        let seeds = points::on_circle(count);
        let name = format!("{count} on a circle");
        for out in remeshed(&name, &square, &options(world(&surface, &seeds), 0)) {
            assert_eq!(out.mesh.facets().len(), count - 2, "{name}");
        }
    }
    let sphere = Shape::Sphere.build(500);
    let surface = Arc::new(Surface::new(&sphere, None).unwrap());
    remeshed("a lattice through a sphere", &sphere, &options(world(&surface, &points::cube_lattice()), 0));
}

#[test]
fn on_the_mesh_itself() {
    for mesh in [Shape::Torus.build(500), Shape::Plane.build(300), Shape::Block.build(500)] {
        let surface = surface(&mesh);
        for (name, seeds) in points::on_the_mesh(&surface) {
            remeshed(name, &mesh, &options(world(&surface, &seeds), 0));
        }
    }
}

#[test]
fn more_seeds_than_facets() {
    for (shape, facets, count) in [(Shape::Square, 2, 3000), (Shape::Sphere, 20, 2000)] {
        let mesh = shape.build(facets);
        let surface = surface(&mesh);
        let seeds = on(&surface, count);
        for out in remeshed(&shape.to_string(), &mesh, &options(world(&surface, &seeds), 0)) {
            assert_eq!(topology(&out.mesh).euler, shape.euler(), "{shape}");
        }
    }
}

#[test]
fn far_from_the_surface() {
    let mesh = Shape::Torus.build(500);
    let surface = surface(&mesh);
    let near = on(&surface, 50);
    for far in [1.0, 1e2, 1e4, MAX_SEED_DISTANCE] {
        for (name, seeds) in points::far_sets(&near, far) {
            let name = format!("{name} at {far}");
            match run(&mesh, &options(world(&surface, &seeds), 3), &Serial) {
                Ok(out) => cases::manifold(out.mesh.facets(), out.mesh.positions().len()).unwrap(),
                Err(error) => assert!(
                    matches!(error, RemeshError::TooFewSeeds { .. } | RemeshError::NoThickness),
                    "{name}: {error}"
                ),
            }
        }
    }
    // In the caller's coordinates, where the way to the unit frame may overflow.
    let tiny = TriMesh::new(mesh.positions().iter().map(|p| *p * 1e-200).collect(), mesh.facets().to_vec()).unwrap();
    let mut given: Vec<DVec3> = tiny.positions()[..9].to_vec();
    given[4].x = 1e200;
    let error = run(&tiny, &options(Seeds::Given(given), 1), &Serial).unwrap_err();
    assert!(matches!(
        error,
        RemeshError::Rvd(RvdError::SeedTooFar { seed: 4, .. } | RvdError::NonFiniteSeed { seed: 4 })
    ));
}
