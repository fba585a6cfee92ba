//! Promise: a vertex far away from all others is data: there is a remesh soon, and the report says so.

use std::time::{Duration, Instant};

use glam::DVec3;
use tessera::mesh::TriMesh;
use tessera::mesh::shapes::Shape;
use tessera::remesh::Remesh;
use tessera::rvd::{Parallel, RvdError, Serial};
use tessera::{Backend, DensityOptions, DensitySource, RemeshError, RemeshOptions, Seeds, Token, remesh};

/// A sphere with some vertices at `distance`.
fn stray(vertices: &[usize], distance: f64) -> TriMesh {
    let sphere = Shape::Sphere.build(320);
    let mut positions = sphere.positions().to_vec();
    for (k, &v) in vertices.iter().enumerate() {
        positions[v] = distance * DVec3::new(0.1 * k as f64, 1.0, 0.0);
    }
    TriMesh::new(positions, sphere.facets().to_vec()).unwrap()
}

fn run(mesh: &TriMesh, options: &RemeshOptions, backend: &dyn Backend) -> Result<Remesh, RemeshError> {
    remesh(mesh, options, backend, &mut (), &Token::with_time_limit(Duration::from_secs(60)))
}

#[test]
fn a_stray_vertex_gives_a_remesh_and_a_note() {
    let parallel = Parallel::new(Some(2)).unwrap();
    let mut whole = 0;
    for (vertices, distance) in [(&[40][..], 1e7), (&[40], 1e11), (&[40, 7, 99], 1e9)] {
        let mesh = stray(vertices, distance);
        let begin = Instant::now();
        let options = RemeshOptions::new(Seeds::Sample { points: 500, seed: 0 });
        let done = run(&mesh, &options, &parallel).unwrap_or_else(|e| panic!("{vertices:?} at {distance:e}: {e}"));
        assert!(begin.elapsed() < Duration::from_secs(50), "{distance:e}: {:?}", begin.elapsed());
        // Where evenly spread points leave nothing but the spikes, both these and the sphere are kept.
        let places = done.mesh.positions();
        let tips = vertices.iter().all(|&v| places.contains(&mesh.positions()[v]));
        let sphere = places.iter().filter(|p| p.length() < 2.0).count() > 50;
        whole += usize::from(tips && sphere);
        let report = done.report;
        assert_eq!(report.input.outlier_vertices, vertices.len(), "at {distance:e}");
        assert!(report.density.facets <= mesh.facets().len() + 64 * 500 + 1000, "{} facets", report.density.facets);
    }
    assert!(whole > 0, "no case came to that");
    // Beside these nothing is left of the others.
    let lost = run(&stray(&[40], 1e20), &RemeshOptions::new(Seeds::Sample { points: 100, seed: 0 }), &parallel);
    assert!(matches!(lost, Ok(_) | Err(RemeshError::Rvd(RvdError::NoArea))), "{:?}", lost.map(|_| ()));
    let usual = run(&Shape::Torus.build(500), &RemeshOptions::new(Seeds::Sample { points: 100, seed: 0 }), &Serial);
    assert_eq!(usual.unwrap().report.input.outlier_vertices, 0);
}

#[test]
fn so_it_does_with_every_density() {
    let parallel = Parallel::new(Some(2)).unwrap();
    let mesh = stray(&[40], 1e7);
    let sizes = DensitySource::Sizes(vec![0.1; mesh.positions().len()]);
    for source in [DensitySource::Curvature, DensitySource::FeatureSize, sizes] {
        let density = DensityOptions::from_source(source);
        let options = RemeshOptions::new(Seeds::Sample { points: 300, seed: 0 }).with_density(density.clone());
        run(&mesh, &options, &parallel).unwrap_or_else(|e| panic!("{density:?}: {e}"));
    }
}
