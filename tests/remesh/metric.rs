//! Promise: with a metric, edges have about length 1 in it; the result is a manifold of the same topology on the input, with its
//! boundaries and corners, and no facet is turned over.

use geometry::mesh::crossings::crossings;
use glam::{DVec3, dvec3};
use tessera::mesh::closest_point::ClosestPoint;
use tessera::mesh::measure::topology;
use tessera::remesh::{Anisotropy, Refine, Remesh, RemeshError, RemeshOptions, Seeds, Tolerance, remesh};
use tessera::rvd::Parallel;
use tessera::{DensityOptions, DensitySource, Token, TriMesh};

use crate::metrics::{Ground, Wanted, unit_edges};
use crate::rough::Random;

fn options(tensors: Vec<tessera::mesh::tensor::Tensor>, points: Option<usize>) -> RemeshOptions {
    let seeds = points.map_or(Seeds::Implied { seed: 0 }, |points| Seeds::Sample { points, seed: 0 });
    RemeshOptions::new(seeds).with_density(DensityOptions::from_source(DensitySource::Metric(tensors)))
}

fn run(mesh: &TriMesh, wanted: &Wanted, points: Option<usize>) -> Remesh {
    remesh(mesh, &options(wanted.on(mesh), points), &Parallel::new(Some(2)).unwrap(), &mut (), &Token::default()).unwrap()
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

fn cases() -> Vec<(String, Ground, Wanted)> {
    let mut cases = Vec::new();
    for ground in Ground::ALL {
        let (through, tilted) = (dvec3(0.5, 0.5, 0.0), dvec3(0.8, 0.6, 0.0));
        let across = if ground == Ground::Cylinder { DVec3::Z } else { tilted };
        let through = if ground == Ground::Cylinder { 0.5 * DVec3::Z } else { through };
        for aspect in [5.0, 20.0, 40.0] {
            let most = 0.1;
            let wanted = Wanted::Shock { through, across, least: most / aspect, growth: 0.2, most };
            cases.push((format!("{ground:?}, shock {aspect}"), ground, wanted));
        }
        let across = if ground == Ground::Cylinder { DVec3::Z } else { DVec3::Y };
        for aspect in [10.0, 30.0] {
            let most = 0.1;
            let wanted = Wanted::Layer { across, wall: 0.0, least: most / aspect, growth: 8.0, most };
            cases.push((format!("{ground:?}, layer {aspect}"), ground, wanted));
        }
        let (centre, radius) = match ground {
            Ground::Square => (dvec3(0.45, 0.5, 0.0), 0.3),
            Ground::Cylinder => (dvec3(0.3, 0.0, 0.5), 0.25),
            Ground::Wing => (dvec3(0.5, 0.5, 0.05), 0.3),
        };
        for aspect in [5.0, 20.0] {
            let along = 0.05;
            let wanted = Wanted::Ring { centre, radius, least: along / aspect, growth: 0.2, along, most: 0.1 };
            cases.push((format!("{ground:?}, ring {aspect}"), ground, wanted));
        }
        let mut random = Random::new(ground as u64);
        for k in 0..3 {
            cases.push((format!("{ground:?}, waves {k}"), ground, Wanted::random(&mut random)));
        }
    }
    cases
}

#[test]
fn edges_are_unit_edges_of_analytic_metrics() {
    for (name, ground, wanted) in cases() {
        let mesh = ground.mesh(160);
        let done = run(&mesh, &wanted, None);
        let figures = done.report.result.metric.unwrap();
        let exact = unit_edges(&done.mesh, &wanted, 1.0);
        eprintln!("{name}: {} of {:.0}, {exact:.1} %, {figures:?}, {:?}", done.mesh.positions().len(), done.report.density.points_implied.unwrap(), done.report.timings_ms);
        assert_sound(&name, &mesh, &done.mesh);
    }
}
