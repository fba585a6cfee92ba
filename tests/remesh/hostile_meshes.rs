//! Promise: a surface that is no manifold, or hardly a surface, is remeshed as an oriented 2-manifold, on every backend; what is no
//! surface is refused by naming the element. The diagrams of such surfaces are in `common/conformance/degenerate.rs`.

use crate::broken::{book, join, map, moebius, pillow, soup, spheres, with_facets_without_area};
use crate::hostile::{options, remeshed};
use crate::{cases, hostile};
use glam::{DVec3, dvec3};
use tessera::internals::mesh::adjacency::Adjacency;
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
    let top = sphere.positions().iter().copied().fold(DVec3::splat(-2.0), |a, b| if b.z > a.z { b } else { a });
    let touching = join(&[&sphere, &map(&sphere, |p| 2.0 * top - p)]);
    assert_eq!(topology(&touching).non_manifold_vertices, 1);
    check("two spheres that touch", &touching, 200);
}

#[test]
fn facets_turned_over() {
    let sphere = Shape::Sphere.build(600);
    let flip = |every: usize| {
        let facets = sphere.facets().iter().enumerate();
        let facets = facets.map(|(f, &[a, b, c])| if f % every == 0 { [a, c, b] } else { [a, b, c] });
        TriMesh::new(sphere.positions().to_vec(), facets.collect()).unwrap()
    };
    check("all turned over", &flip(1), 200);
    for every in [2, 3, 50] {
        for out in check(&format!("one in {every} turned over"), &flip(every), 200) {
            assert_eq!(topology(&out.mesh), Topology { euler: 2, components: 1, ..Topology::default() }, "{every}");
            assert_eq!(Adjacency::new(&out.mesh).inconsistent_edges(), 0);
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
    let corners = sphere.facets().iter().flatten().enumerate();
    let off = |k: usize| DVec3::new(k as f64, (k * k) as f64, (3 * k) as f64).map(f64::sin);
    let places = corners.map(|(k, &v)| sphere.positions()[v as usize] + 1e-8 * off(k)).collect();
    let facets = (0..sphere.facets().len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect();
    let soup = TriMesh::new(places, facets).unwrap();
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
    // One of them a millionth of the size.
    let dust = map(&small, |p| p * 1e-6 + DVec3::X * 2.0);
    check("a sphere and dust", &join(&[&Shape::Sphere.build(300), &dust]), 200);
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
    // T-shaped: slivers of an altitude of a rounding and of next to nothing between proper facets.
    for altitude in [1e-7, 1e-12, 3e-16, 1e-17] {
        let corners = vec![
            dvec3(0.0, 0.0, 0.0),
            dvec3(1.0, 0.0, 0.0),
            dvec3(0.5, altitude, 0.0),
            dvec3(0.5, 1.0, 0.0),
            dvec3(0.5, -1.0, 0.0),
        ];
        let mesh = TriMesh::new(corners, vec![[0, 1, 2], [2, 1, 3], [0, 2, 3], [1, 0, 4]]).unwrap();
        check(&format!("a sliver of {altitude}"), &mesh, 60);
    }
    let (positions, mut facets) = torus.into_parts();
    facets.extend_from_within(10..30);
    check("facets twice", &TriMesh::new(positions, facets).unwrap(), 200);
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
    for scale in [1e-30, 1e-12, 1e12, 1e30] {
        for boxes in [0.0, 1e6] {
            let mesh = map(&torus, |p| (p + dvec3(1.0, -0.5, 0.25) * 3.0 * boxes) * scale);
            for out in check(&format!("scale {scale}, {boxes} boxes off"), &mesh, 150) {
                assert_eq!(topology(&out.mesh).euler, 0);
                assert!(out.mesh.positions().iter().all(|p| p.is_finite()));
            }
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
    let (mut positions, facets) = torus.into_parts();
    positions.push(DVec3::ONE);
    let mesh = TriMesh::new(positions, facets).unwrap();
    let count = mesh.positions().len();
    let like = |of: &dyn Fn(usize) -> f64| -> Vec<f64> { (0..count).map(of).collect() };
    let ramp = |v: usize| 1.0 + (v % 7) as f64;
    let weights = [
        ("tiny", like(&|v| 1e-300 * ramp(v))),
        ("subnormal", like(&|v| f64::from_bits(1 << (v % 7)))),
        ("huge", like(&|v| 1e307 * ramp(v))),
        ("zero but for one", like(&|v| f64::from(v == 17))),
        ("an unused vertex's is the largest", like(&|v| if v + 1 == count { 1e300 } else { ramp(v) })),
    ];
    for (name, weights) in weights {
        let surface = Surface::new(&mesh, Some(&weights)).unwrap();
        let largest = surface.facets().iter().flatten().map(|&v| surface.weights()[v as usize]).fold(0.0, f64::max);
        assert!(largest > 0.5 && largest <= 1.0, "{name}: {largest}");
        let wish = options(Seeds::Sample { points: 100, seed: 2 }, 2);
        remeshed(name, &mesh, &wish.with_density(Some(weights).into()));
    }
    let refused = |of: &dyn Fn(usize) -> f64| Surface::new(&mesh, Some(&like(of))).unwrap_err();
    let unused = refused(&|v| f64::from(v + 1 == count));
    assert!(matches!(unused, RvdError::BadWeight { value: 0.0, .. }), "{unused}");
    for bad in [-1.0, f64::NAN, f64::INFINITY] {
        assert!(matches!(refused(&|v| if v == 5 { bad } else { 1.0 }), RvdError::BadWeight { vertex: 5, .. }));
    }
    let short = Surface::new(&mesh, Some(&[1.0])).unwrap_err();
    assert!(matches!(short, RvdError::WeightCount { given: 1, .. }), "{short}");
}
