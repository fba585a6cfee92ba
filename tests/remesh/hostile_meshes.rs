//! Promise: a surface that is no manifold, or hardly a surface, is remeshed as an oriented 2-manifold, on every backend; what is no
//! surface is refused by naming the element. The diagrams of such surfaces are in `common/conformance/degenerate.rs`.

use crate::broken::*;
use crate::hostile::{options, remeshed};
use crate::{cases, hostile};
use geometry::mesh::adjacency::Adjacency;
use glam::{DVec3, dvec3};
use tessera::mesh::measure::{Topology, topology};
use tessera::mesh::shapes::Shape;
use tessera::mesh::{MeshError, TriMesh};
use tessera::remesh::{RemeshError, Seeds};
use tessera::rvd::{RvdError, Surface};

fn check(name: &str, mesh: &TriMesh, points: usize) -> Vec<tessera::remesh::Remesh> {
    remeshed(name, mesh, &options(Seeds::Sample { points, seed: 2 }, 2))
}

#[test]
fn edges_and_vertices_with_too_many_facets() {
    for pages in [3, 4, 5] {
        let mesh = book(pages, 6);
        assert_eq!(topology(&mesh).non_manifold_edges, 6);
        check(&format!("book of {pages}"), &mesh, 150);
    }
    let sphere = Shape::Sphere.build(300);
    let touching = touching(&sphere);
    assert_eq!(topology(&touching).non_manifold_vertices, 1);
    check("two spheres that touch", &touching, 200);
}

#[test]
fn facets_turned_over() {
    let sphere = Shape::Sphere.build(600);
    check("all turned over", &turned_over(&sphere, 1), 200);
    for every in [2, 3, 50] {
        for out in check(&format!("one in {every} turned over"), &turned_over(&sphere, every), 200) {
            assert_eq!(topology(&out.mesh), Topology { euler: 2, components: 1, ..Topology::default() }, "{every}");
            assert_eq!(Adjacency::new(&out.mesh).inconsistent_edges, 0);
            let count = out.report.input.reoriented_facets;
            assert!(count == sphere.facets().len().div_ceil(every) || every == 2, "{every}: {count}");
        }
    }
    check("Möbius", &moebius(40, 4), 150);
}

/// Facets that a file has twice, either way round, beside one another or with vertices of their own: several of them tore a remesh
/// open where cells are small beside them.
#[test]
fn facets_that_are_there_twice() {
    let sphere = Shape::Sphere.build(600);
    let n = sphere.positions().len() as u32;
    let again = |which: &[usize], back: bool, own: u32| {
        let more = which.iter().map(|&f| {
            let [a, b, c] = sphere.facets()[f].map(|v| v + own);
            if back { [a, c, b] } else { [a, b, c] }
        });
        let positions = sphere.positions().repeat(if own > 0 { 2 } else { 1 });
        TriMesh::new(positions, sphere.facets().iter().copied().chain(more).collect()).unwrap()
    };
    for (which, back, own) in [(&[100][..], true, 0), (&[0, 1, 2, 3, 60, 61, 62, 300], true, 0), (&[5, 6, 7], false, n)]
    {
        let mesh = again(which, back, own);
        for points in [150, 2500] {
            for out in check(&format!("{} twice, {points}", which.len()), &mesh, points) {
                assert_eq!(topology(&out.mesh), Topology { euler: 2, components: 1, ..Topology::default() });
                let input = &out.report.input;
                assert_eq!((input.coincident_facets, input.topology.non_manifold_edges), (which.len(), 0));
                assert_eq!(out.report.topology_changes.len(), 0);
            }
        }
    }
}

/// A list of triangles whose corners were rounded one by one hangs together.
#[test]
fn corners_that_are_nearly_one() {
    let sphere = Shape::Sphere.build(600);
    let soup = nearly_one(&sphere);
    assert_eq!(topology(&soup).components, sphere.facets().len());
    for out in check("nearly one", &soup, 200) {
        assert_eq!(topology(&out.mesh), Topology { euler: 2, components: 1, ..Topology::default() });
        let input = &out.report.input;
        assert!(input.stitched_vertices > 2 * sphere.positions().len(), "{}", input.stitched_vertices);
        assert_eq!((input.topology.components, out.report.topology_changes.len()), (1, 0));
    }
}

#[test]
fn many_components_and_surfaces_through_each_other() {
    let small = Shape::Sphere.build(80);
    let all = spheres(&small);
    assert_eq!(topology(&all).components, 27);
    check("27 spheres", &all, 600);
    check("27 spheres, too few points", &all, 40);
    check("a sphere and dust", &with_dust(&Shape::Sphere.build(300)), 200);
    let sphere = Shape::Sphere.build(500);
    check("through each other", &join(&[&sphere, &map(&sphere, |p| p + 0.7 * DVec3::X)]), 300);
    let torus = Shape::Torus.build(500);
    check("a torus through itself", &join(&[&torus, &map(&torus, |p| dvec3(p.x, p.z, p.y))]), 300);
}

#[test]
fn vertices_split_at_seams() {
    for shape in [Shape::Sphere, Shape::Torus] {
        let mesh = shape.build(800);
        for out in check(&format!("{shape} as triangles"), &soup(&mesh), 300) {
            assert_eq!(topology(&out.mesh).euler, shape.euler(), "{shape}");
            assert_eq!(topology(&out.mesh).boundary_edges, 0, "{shape}");
        }
    }
}

#[test]
fn facets_without_area_slivers_and_duplicates() {
    let torus = Shape::Torus.build(700);
    let dirty = with_facets_without_area(&torus);
    assert_eq!(dirty.degenerate_count(), 4);
    for out in check("with facets without area", &dirty, 200) {
        assert_eq!(out.report.input.degenerate_facets, 4);
    }
    check("slivers", &Shape::Slivers.build(1500), 300);
    for altitude in ALTITUDES {
        check(&format!("a sliver of {altitude}"), &sliver(altitude), 60);
    }
    check("facets twice", &facets_twice(&torus, 10..30), 200);
}

#[test]
fn a_surface_without_thickness() {
    let mesh = pillow(200);
    for (backend, _) in hostile::backends() {
        for points in [4, 20, 100] {
            match hostile::run(&mesh, &options(Seeds::Sample { points, seed: 2 }, 2), backend) {
                Ok(out) => cases::manifold(out.mesh.facets(), out.mesh.positions().len()).unwrap(),
                Err(error) => {
                    assert!(matches!(error, RemeshError::TooFewSeeds { .. } | RemeshError::NoThickness), "{error}");
                }
            }
        }
    }
}

#[test]
fn two_facets_back_to_back() {
    let corners = vec![DVec3::ZERO, DVec3::X, DVec3::Y];
    let mesh = TriMesh::new(corners, vec![[0, 1, 2], [0, 2, 1]]).unwrap();
    for points in [20, 30, 100] {
        remeshed("two facets", &mesh, &options(Seeds::Sample { points, seed: 2 }, 2));
    }
    // Each of four a side has a cell that goes around the rim to the other side, where its triangles are too.
    let few = options(Seeds::Sample { points: 8, seed: 2 }, 2);
    for (backend, _) in hostile::backends() {
        assert!(matches!(hostile::run(&mesh, &few, backend), Err(RemeshError::NoThickness)));
    }
}

#[test]
fn units_and_offset() {
    let torus = Shape::Torus.build(600);
    for (name, mesh) in units(&torus) {
        for out in check(&name, &mesh, 150) {
            assert_eq!(topology(&out.mesh).euler, 0);
            assert!(out.mesh.positions().iter().all(|p| p.is_finite()));
        }
    }
}

#[test]
fn figures_of_tiny_and_huge_surfaces() {
    let torus = Shape::Torus.build(600);
    let quality = |scale: f64| {
        let mesh = map(&torus, |p| p * scale);
        let wish = options(Seeds::Sample { points: 150, seed: 2 }, 2).with_measure(true);
        let out = hostile::run(&mesh, &wish, &tessera::rvd::Serial).unwrap();
        let report = serde_json::to_string(&out.report).unwrap();
        // A number that is not finite is null. These are null because there is nothing to say.
        let names = report.split(":null").map(|before| before.rsplit('"').nth(1).unwrap_or_default());
        let absent = ["adapter", "deviation_percent", "ended", "reason", "host_peak_bytes"];
        let wrong: Vec<&str> = names.take(report.matches(":null").count()).filter(|n| !absent.contains(n)).collect();
        assert!(wrong.is_empty(), "scale {scale}: {wrong:?}");
        out.report.result.quality.unwrap()
    };
    let want = quality(1.0);
    for scale in [1e-30, 1e30] {
        let got = quality(scale);
        assert!((got.q_min - want.q_min).abs() < 1e-6, "{got:?} {want:?}");
        assert!((got.hausdorff_percent / want.hausdorff_percent - 1.0).abs() < 1e-3, "{got:?} {want:?}");
        assert!((got.rms_percent / want.rms_percent - 1.0).abs() < 1e-3, "{got:?} {want:?}");
    }
}

#[test]
fn so_small_that_numbers_end() {
    for scale in [1e-100, 1e-200, 1e-304, 1e-306, 1e-310, 1e-320, 5e-324] {
        let corners = vec![DVec3::ZERO, DVec3::X * scale, DVec3::Y * scale];
        let mesh = TriMesh::new(corners, vec![[0, 1, 2]]);
        if scale < 1e-305 {
            assert!(matches!(mesh, Err(MeshError::ExtentTooSmall { .. })), "{scale:e}");
            continue;
        }
        Surface::new(&mesh.unwrap(), None).unwrap();
    }
}

#[test]
fn weights_of_any_size() {
    let torus = Shape::Torus.build(500);
    let (mesh, all) = with_extreme_weights(&torus);
    let count = mesh.positions().len();
    for (name, weights) in all {
        let surface = Surface::new(&mesh, Some(&weights)).unwrap();
        let largest = surface.facets().iter().flatten().map(|&v| surface.weights()[v as usize]).fold(0.0, f64::max);
        assert!(largest > 0.5 && largest <= 1.0, "{name}: {largest}");
        let wish = options(Seeds::Sample { points: 100, seed: 2 }, 2);
        remeshed(name, &mesh, &wish.with_density(Some(weights).into()));
    }
    let refused =
        |of: &dyn Fn(usize) -> f64| Surface::new(&mesh, Some(&(0..count).map(of).collect::<Vec<f64>>())).unwrap_err();
    let unused = refused(&|v| f64::from(v + 1 == count));
    assert!(matches!(unused, RvdError::BadWeight { value: 0.0, .. }), "{unused}");
    for bad in [-1.0, f64::NAN, f64::INFINITY] {
        assert!(matches!(refused(&|v| if v == 5 { bad } else { 1.0 }), RvdError::BadWeight { vertex: 5, .. }));
    }
    let short = Surface::new(&mesh, Some(&[1.0])).unwrap_err();
    assert!(matches!(short, RvdError::WeightCount { given: 1, .. }), "{short}");
}
