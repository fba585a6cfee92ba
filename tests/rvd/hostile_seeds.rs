//! Promise: seeds that lie on each other, in a lattice, on a circle, on the mesh's own vertices or far from the
//! surface give the diagram they have; too far is refused by naming the seed.

use std::sync::Arc;

use crate::hostile::{backends, covered, options, remeshed, run, sums};
use crate::{cases, points};
use glam::{DVec3, dvec3};
use tessera::mesh::TriMesh;
use tessera::mesh::measure::topology;
use tessera::mesh::shapes::Shape;
use tessera::remesh::{RemeshError, Seeds};
use tessera::rvd::Serial;
use tessera::rvd::{BackendKind, MAX_SEED_DISTANCE, RvdError, Surface};

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
        covered(&format!("{count} seeds"), &surface, &seeds[..count]);
        // The cells of three seeds meet in two points: one triangle and its back, which close on each other.
        for (backend, _) in backends() {
            let out = run(&mesh, &options(world(&surface, &seeds[..count]), 0), backend);
            assert!(matches!(out, Err(RemeshError::TooFewSeeds { seeds, .. }) if seeds == count), "{count}");
        }
    }
    for (backend, _) in backends() {
        assert!(matches!(sums(backend, &surface, &[]), Err(RvdError::NoSeeds)));
    }
}

#[test]
fn on_each_other() {
    let mesh = Shape::Torus.build(600);
    let surface = surface(&mesh);
    let single = on(&surface, 80);
    for (name, seeds, duplicates) in [
        ("all the same", vec![single[3]; 500], 499),
        ("pairs", single.iter().flat_map(|&p| [p, p]).collect(), 80),
        ("a hundred times two", [single[0], single[1]].repeat(100), 198),
        // -0 is 0.
        ("signs of zero", [&[dvec3(0.4, 0.0, 0.0), dvec3(0.4, -0.0, -0.0)], &single[..]].concat(), 1),
    ] {
        covered(name, &surface, &seeds);
        for (backend, _) in backends() {
            let (got, stats) = sums(backend, &surface, &seeds).unwrap();
            let who = format!("{name}, {}", backend.kind().name());
            assert_eq!(stats.duplicate_seeds, duplicates, "{who}");
            for i in 0..seeds.len() {
                let first = seeds.iter().position(|p| *p == seeds[i]).unwrap();
                assert!(first == i || (got.area[i], got.mass[i]) == (0.0, 0.0), "{who}: seed {i}");
            }
        }
        // Lloyd places twins anew; without a step they are left out, and the report says so.
        let wish = options(world(&surface, &seeds), 0);
        match run(&mesh, &wish, &Serial) {
            Ok(out) => assert_eq!(out.report.rvd.duplicate_seeds, duplicates as usize, "{name}"),
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
    for gap in [1e-3, 1e-5] {
        let seeds: Vec<DVec3> = single.iter().flat_map(|&p| [p, p + gap * dvec3(0.3, -0.5, 0.8)]).collect();
        covered(&format!("{gap} apart"), &surface, &seeds);
    }
    // The GPU is left out below: see the test that follows.
    for gap in [1e-7, 1e-9, 1e-12, 1e-15] {
        let seeds: Vec<DVec3> = single.iter().flat_map(|&p| [p, p + gap * dvec3(0.3, -0.5, 0.8)]).collect();
        let (got, _) = sums(&Serial, &surface, &seeds).unwrap();
        assert!((got.area.iter().sum::<f64>() / surface.area() - 1.0).abs() < 1e-10, "{gap} apart");
        let out = run(&mesh, &options(world(&surface, &seeds), 0), &Serial).unwrap();
        cases::manifold(out.mesh.facets(), out.mesh.positions().len()).unwrap_or_else(|e| panic!("{gap} apart: {e}"));
    }
}

#[test]
fn nearly_on_each_other_on_the_gpu() {
    let corners = vec![dvec3(-0.5, -0.5, 0.5), dvec3(0.5, 0.5, 0.5), dvec3(0.5, -0.5, -0.5)];
    let surface = surface(&TriMesh::new(corners, vec![[0, 1, 2]]).unwrap());
    for gap in [1e-6, 1e-7, 3.7e-9, 1e-12, 1e-15] {
        let near = dvec3(2.0, -0.375, 1.5);
        let seeds = [near + gap * dvec3(1.0, 1.0, 0.0), near, dvec3(1.0, 1.125, 1.5)];
        covered(&format!("{gap} apart"), &surface, &seeds);
    }
}

#[test]
fn mirror_images_in_the_plane_of_a_facet_on_the_gpu() {
    let corners = vec![dvec3(0.5, -0.5, 0.0), dvec3(0.5, 0.5, 0.0), dvec3(-0.5, -0.5, 0.0)];
    let surface = surface(&TriMesh::new(corners, vec![[0, 1, 2]]).unwrap());
    covered("mirrored", &surface, &[dvec3(-0.5, -0.5, -1.0), dvec3(-0.5, -0.5, 1.0), dvec3(0.5, 0.0, 0.0)]);
}

#[test]
fn a_surface_of_slivers_on_the_gpu() {
    for altitude in [1e-4, 1e-6, 1e-8, 1e-10] {
        let corners = vec![dvec3(-0.5, altitude, 0.5), dvec3(0.5, -altitude, -0.5), dvec3(-0.5, -altitude, 0.5)];
        let surface = surface(&TriMesh::new(corners, vec![[0, 1, 2]]).unwrap());
        covered(&format!("altitude {altitude}"), &surface, &[dvec3(-0.3, 0.38, 0.46)]);
    }
}

#[test]
fn in_lattices_and_on_circles() {
    for side in [2, 5, 16] {
        let plane = Shape::Plane.build(2 * side * side);
        let surface = surface(&plane);
        // In the corners and in the middles of the facets' own grid.
        for shift in [0.0, 0.5] {
            let seeds: Vec<DVec3> = (0..(side + 1) * (side + 1))
                .map(|k| dvec3((k % (side + 1)) as f64, (k / (side + 1)) as f64, 0.0))
                .map(|p| (p + dvec3(shift, shift, 0.0)) / side as f64 - dvec3(0.5, 0.5, 0.0))
                .collect();
            let name = format!("{side} by {side} shifted {shift}");
            covered(&name, &surface, &seeds);
            for out in remeshed(&name, &plane, &options(world(&surface, &seeds), 0)) {
                let seen = topology(&out.mesh);
                assert_eq!((seen.euler, seen.components, seen.boundary_loops), (1, 1, 1), "{name}");
            }
        }
    }
    let square = Shape::Plane.build(200);
    let surface = surface(&square);
    for count in [4, 6, 12, 64] {
        let seeds: Vec<DVec3> = (0..count)
            .map(|k| (k as f64 / count as f64 * std::f64::consts::TAU).sin_cos())
            .map(|(sin, cos)| 0.25 * dvec3(cos, sin, 0.0))
            .collect();
        let name = format!("{count} on a circle");
        covered(&name, &surface, &seeds);
        for out in remeshed(&name, &square, &options(world(&surface, &seeds), 0)) {
            assert_eq!(out.mesh.facets().len(), count - 2, "{name}");
        }
    }
    // In space: all corners of cubes.
    let sphere = Shape::Sphere.build(500);
    let surface = Arc::new(Surface::new(&sphere, None).unwrap());
    let seeds: Vec<DVec3> = (0..343)
        .map(|k| dvec3((k % 7) as f64, (k / 7 % 7) as f64, (k / 49) as f64) / 6.0 - DVec3::splat(0.5))
        .collect();
    covered("a lattice through a sphere", &surface, &seeds);
    remeshed("a lattice through a sphere", &sphere, &options(world(&surface, &seeds), 0));
}

#[test]
fn on_the_mesh_itself() {
    for mesh in [Shape::Torus.build(500), Shape::Plane.build(300), Shape::Block.build(500)] {
        let surface = surface(&mesh);
        let corners = |f: usize| surface.facets()[f].map(|v| surface.positions()[v as usize]);
        let facets = 0..surface.facets().len();
        let sets: [(&str, Vec<DVec3>); 4] = [
            ("vertices", surface.positions().to_vec()),
            ("middles of edges", facets.clone().map(|f| 0.5 * (corners(f)[0] + corners(f)[1])).collect()),
            ("middles of facets", facets.clone().map(|f| surface.centroid(f as u32)).collect()),
            // More seeds than facets, on every corner of every facet.
            ("corners", facets.flat_map(corners).collect()),
        ];
        for (name, seeds) in sets {
            covered(name, &surface, &seeds);
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
        covered(&shape.to_string(), &surface, &seeds);
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
        let away: Vec<DVec3> =
            near.iter().map(|p| (p.normalize() * far).clamp(DVec3::splat(-far), DVec3::splat(far))).collect();
        // Cells that the surface meets at all angles, and cells that it does not meet.
        for (name, seeds) in [("all", away.clone()), ("half", [&near[..25], &away[..25]].concat())] {
            let name = format!("{name} at {far}");
            let (got, _) = sums(&Serial, &surface, &seeds).unwrap();
            // A boundary is right to a rounding of the seeds' distance.
            let error = (got.area.iter().sum::<f64>() / surface.area() - 1.0).abs();
            assert!(error < 1e-11 * far.max(1.0), "{name}: {error:e}");
            for (backend, tolerance) in backends() {
                let (other, _) = sums(backend, &surface, &seeds).unwrap_or_else(|e| panic!("{name}: {e}"));
                let error = (other.area.iter().sum::<f64>() / surface.area() - 1.0).abs();
                assert!(error < tolerance.max(1e-11 * far), "{name}, {}: {error:e}", backend.kind().name());
            }
            match run(&mesh, &options(world(&surface, &seeds), 3), &Serial) {
                Ok(out) => cases::manifold(out.mesh.facets(), out.mesh.positions().len()).unwrap(),
                Err(error) => assert!(
                    matches!(error, RemeshError::TooFewSeeds { .. } | RemeshError::NoThickness),
                    "{name}: {error}"
                ),
            }
        }
    }
    for (backend, _) in backends() {
        for (bad, at) in [(1.01 * MAX_SEED_DISTANCE, 7), (1e300, 0), (-f64::MAX, 49)] {
            let mut seeds = near.clone();
            seeds[at].y = bad;
            let error = sums(backend, &surface, &seeds).unwrap_err();
            assert!(matches!(error, RvdError::SeedTooFar { seed, .. } if seed == at), "{error}");
        }
        for bad in [f64::NAN, f64::INFINITY] {
            let mut seeds = near.clone();
            seeds[31].z = bad;
            let error = sums(backend, &surface, &seeds).unwrap_err();
            assert!(matches!(error, RvdError::NonFiniteSeed { seed: 31 }), "{error}");
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

/// From afar a whole cluster is at one distance, so that a row ends before it: it must grow until it holds all of it.
#[test]
fn a_cluster_at_one_rounded_distance() {
    let mesh = Shape::Plane.build(50);
    let surface = surface(&mesh);
    let mut seeds = vec![dvec3(-9e5, 0.0, 0.0)];
    seeds.extend((0..600).map(|k| dvec3(9e5, 0.0, 1e-9 * f64::from(k))));
    for (backend, tolerance) in backends() {
        let (got, _) = sums(backend, &surface, &seeds).unwrap();
        let error = (got.area.iter().sum::<f64>() / surface.area() - 1.0).abs();
        // As in `far_from_the_surface`.
        assert!(error < tolerance.max(1e-11 * 9e5), "{}: {error:e}", backend.kind().name());
    }
}

/// The centroid is as far from two seeds as rounding can tell, and the cell of the one that is taken for the nearest
/// does not meet the facet.
#[test]
fn a_first_cell_that_misses_its_facet() {
    let corners = vec![dvec3(9.5367431640625e-7, -0.5, 0.0), dvec3(0.25, -0.25, 0.0), dvec3(0.25, 0.0, -0.25)];
    // The rest of an octahedron, so that the box stays where it is.
    let rest = [DVec3::X, DVec3::Y, DVec3::Z].into_iter().flat_map(|p| [0.5 * p, -0.5 * p]);
    let mesh = TriMesh::new(corners.into_iter().chain(rest).collect(), vec![[0, 1, 2], [3, 5, 7], [4, 6, 8]]).unwrap();
    let surface = surface(&mesh);
    let one = dvec3(-0.4375, -0.1875, -0.1875);
    let seeds = [
        dvec3(0.5, 0.1875, -0.375),
        dvec3(0.125, 0.25, -0.5),
        dvec3(0.25, 0.4375, -0.5),
        dvec3(-0.75, -0.1875, 0.75),
        one,
        one + 2f64.powi(-52) * DVec3::Z,
    ];
    for (backend, _) in backends().into_iter().filter(|(b, _)| b.kind() != BackendKind::Gpu) {
        let (got, _) = sums(backend, &surface, &seeds).unwrap();
        assert!((got.area.iter().sum::<f64>() / surface.area() - 1.0).abs() < 1e-10, "{}", backend.kind().name());
    }
}
