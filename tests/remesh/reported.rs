//! Promise: what is no surface, or comes out other than it went in, is said in the report.

use super::rough::{self, Scan};
use glam::DVec3;
use tessera::cvt::{DensityOptions, DensitySource};
use tessera::mesh::TriMesh;
use tessera::mesh::closest_point::ClosestPoint;
use tessera::mesh::measure::topology;
use tessera::mesh::shapes::Shape;
use tessera::remesh::report::{InputKind, LostReason};
use tessera::remesh::{Remesh, RemeshError, RemeshOptions, Seeds, remesh};
use tessera::rvd::Parallel;
use tessera::token::Token;

fn options(points: usize) -> RemeshOptions {
    RemeshOptions::new(Seeds::Sample { points, seed: 3 }).with_newton(10)
}

fn try_run(mesh: &TriMesh, options: &RemeshOptions) -> Result<Remesh, RemeshError> {
    remesh(mesh, options, &Parallel::new(Some(2)).unwrap(), &mut (), &Token::default())
}

fn run(mesh: &TriMesh, options: &RemeshOptions) -> Remesh {
    try_run(mesh, options).unwrap()
}

#[test]
fn a_mesh_of_tetrahedra_is_called_a_volume() {
    for (n, twice, seed) in [(2, false, 1), (4, false, 2), (4, true, 3), (6, true, 4)] {
        let mesh = rough::tetrahedra(n, twice, seed);
        match try_run(&mesh, &options(400)) {
            Ok(out) => {
                let (input, result) = (&out.report.input, &out.report.result);
                assert_eq!(input.kind, InputKind::Volume, "{n} {twice}: {input:?}");
                assert!(2 * input.enclosed_facets > mesh.facets().len() / if twice { 2 } else { 1 }, "{input:?}");
                assert_eq!(input.back_to_back_facets > 0, twice, "{input:?}");
                assert_eq!((result.topology.non_manifold_edges, result.topology.non_manifold_vertices), (0, 0));
            }
            Err(error) => panic!("{n} {twice}: {error}"),
        }
    }
}

#[test]
fn pages_that_meet_in_an_edge_are_told_of() {
    for (pages, points) in [(3, 500), (5, 500), (4, 1500)] {
        let mesh = rough::book(pages, 12, false);
        let out = run(&mesh, &options(points));
        let (input, result) = (&out.report.input, &out.report.result);
        assert_eq!((input.kind, input.back_to_back_facets), (InputKind::NonManifold, 0), "{input:?}");
        assert_eq!(input.enclosed_facets, 0, "{input:?}");
        // Two pages are one sheet, and none loses a facet.
        assert_eq!(
            (input.sheets, result.repair.non_manifold_facets),
            (pages.div_ceil(2), 0),
            "{pages}: {:?}",
            result.repair
        );
        assert_eq!((result.topology.non_manifold_edges, result.topology.non_manifold_vertices), (0, 0));
    }
    let both_sides = try_run(&rough::book(3, 12, true), &options(500));
    assert!(matches!(both_sides, Err(RemeshError::NoThickness)), "{:?}", both_sides.map(|out| out.report.input));
}

/// Fins of two sides on a ball.
#[test]
fn sides_without_thickness_are_counted() {
    let (mut positions, mut facets) = Shape::Sphere.build(2000).into_parts();
    let fins = 20;
    for k in 0..fins {
        let [a, b, _] = facets[61 * k];
        let tip = positions.len() as u32;
        positions.push(1.3 * positions[a as usize]);
        facets.extend([[a, b, tip], [a, tip, b]]);
    }
    let out = run(&TriMesh::new(positions, facets).unwrap(), &options(600));
    let input = &out.report.input;
    assert_eq!((input.kind, input.back_to_back_facets), (InputKind::NonManifold, 2 * fins), "{input:?}");
    let lost = out.report.result.lost.as_ref().unwrap();
    assert!(lost.parts.iter().all(|part| part.reason == LostReason::NonManifold), "{lost:?}");
}

#[test]
fn vertices_in_one_place_are_counted() {
    // Of a soup of tetrahedra, whose parts touch all over.
    let volume = run(&rough::tetrahedra(2, true, 3), &options(400));
    let counted = volume.report.result.coincident_vertices;
    let edges =
        |mesh: &TriMesh| mesh.facets().iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]).collect::<Vec<_>>();
    let joined =
        |i: usize, j: usize| edges(&volume.mesh).iter().any(|e| e.contains(&(i as u32)) && e.contains(&(j as u32)));
    let all = volume.mesh.positions();
    let (low, high) = volume.mesh.bounds();
    let reach = 1e-5 * (high - low).length();
    let found = (0..all.len()).filter(|&i| (0..i).any(|j| all[i].distance(all[j]) <= reach && !joined(i, j))).count();
    // Of several that are in one place, each is near the first; the ends of a chain need not be.
    assert!(counted <= found && (counted > 0) == (found > 0), "{counted} of {found}");
}

#[test]
fn of_a_clean_surface_nothing_is_said() {
    for shape in [Shape::Sphere, Shape::Genus(3), Shape::Plane, Shape::Sheets] {
        let out = run(&shape.build(2000), &options(600));
        let (input, result) = (&out.report.input, &out.report.result);
        assert_eq!(
            (input.kind, input.enclosed_facets, input.back_to_back_facets),
            (InputKind::Surface, 0, 0),
            "{shape}"
        );
        assert_eq!(result.coincident_vertices, 0, "{shape}");
        assert_eq!(result.lost.as_ref().unwrap().count, 0, "{shape}");
    }
}

/// Writes all kinds of surfaces to the folder that `TESSERA_SURFACES` names, for measurements.
#[test]
#[ignore = "writes files"]
fn write_them() {
    let folder = std::path::PathBuf::from(std::env::var_os("TESSERA_SURFACES").unwrap());
    let write = |name: &str, mesh: &TriMesh| {
        println!("{name}: {:?}", topology(mesh));
        tessera::mesh::io::write(&folder.join(name), mesh).unwrap();
    };
    for n in [4, 10] {
        write(&format!("tets{n}.ply"), &rough::tetrahedra(n, false, 1));
        write(&format!("tets{n}twice.ply"), &rough::tetrahedra(n, true, 1));
    }
    for (pages, backs) in [(3, false), (5, false), (4, true)] {
        write(&format!("book{pages}{}.ply", if backs { "b" } else { "" }), &rough::book(pages, 40, backs));
    }
    for thickness in [0.004, 0.01, 0.02] {
        write(&format!("plate{thickness}.ply"), &rough::holed_plate(0.005, thickness));
        write(&format!("crank{thickness}.ply"), &rough::crank(0.004, thickness));
        write(&format!("bowl{thickness}.ply"), &rough::bowl(60, 2.0 * thickness));
    }
    for (k, shape) in [Shape::Genus(2), Shape::Torus, Shape::Sphere, Shape::Hills].into_iter().enumerate() {
        write(&format!("scan{k}.ply"), &Scan::RAW.of(shape, 200_000, k as u64));
        write(&format!("scan{k}small.ply"), &Scan::RAW.of(shape, 30_000, k as u64));
    }
    for (name, mesh) in [("torus", Shape::Torus.build(20_000)), ("sphere", Shape::Sphere.build(100_000))] {
        write(&format!("{name}.ply"), &mesh);
        let lengths = rough::noise(&mesh, 100.0, 1).iter().map(|h| format!("{h}\n")).collect::<String>();
        std::fs::write(folder.join(format!("{name}.sizes")), lengths).unwrap();
    }
}

/// The edge of even triangles of a result.
fn edge(result: &TriMesh) -> f64 {
    (4.0 / 3f64.sqrt() * result.area() / result.facets().len() as f64).sqrt()
}

#[test]
fn what_of_a_raw_scan_is_lost_is_named_with_its_place() {
    let mut lost_parts = 0;
    for (shape, seed) in [(Shape::Genus(2), 1), (Shape::Torus, 2), (Shape::Sphere, 3), (Shape::Hills, 4)] {
        let mesh = Scan::RAW.of(shape, 20_000, seed);
        let out = run(&mesh, &options(1_500));
        let result = &out.report.result;
        let lost = result.lost.as_ref().unwrap();
        let tree = ClosestPoint::new(&out.mesh);
        let distance = |p: DVec3| tree.project(p).position.distance(p);
        let (low, high) = mesh.bounds();
        let edge = edge(&out.mesh);
        let far = |f: usize| !mesh.is_degenerate(f) && mesh.corners(f).into_iter().any(|p| distance(p) > edge);
        let size = |f: usize| {
            let [a, b, c] = mesh.corners(f);
            (b - a).cross(c - a).length() / 2.0
        };
        let area: f64 = (0..mesh.facets().len()).filter(|&f| far(f)).map(size).sum();
        let percent = 100.0 * area / out.report.input.area;
        assert!((lost.area_percent - percent).abs() < 1e-6, "{shape}: {percent} % in {lost:?}");
        assert_eq!(lost.count > 0, area > 0.0, "{shape}");
        for part in &lost.parts {
            let away = 100.0 * distance(DVec3::from(part.place)) / (high - low).length();
            assert!((away - part.distance_percent).abs() < 1e-9, "{shape}: {part:?}");
        }
        assert!(lost.parts.is_sorted_by(|a, b| a.area_percent >= b.area_percent), "{lost:?}");
        // Nothing that is not named is farther off.
        if lost.count == 0 {
            let quality = result.quality.as_ref().unwrap();
            assert!(quality.hausdorff_percent / 100.0 * (high - low).length() < 1.5 * edge, "{shape}: {quality:?}");
        }
        lost_parts += lost.count;
        assert_eq!((result.topology.non_manifold_edges, result.topology.non_manifold_vertices), (0, 0));
    }
    assert!(lost_parts > 0, "the test shows nothing");
}

/// Lengths that are drawn for each vertex by itself, on one half of the surface twice as long as on the other.
#[test]
fn lengths_that_are_noise_are_evened_out_and_their_means_stay() {
    for (shape, seed) in [(Shape::Torus, 1), (Shape::Sphere, 2)] {
        let mesh = shape.build(6_000);
        let (low, high) = mesh.bounds();
        let middle = (low.x + high.x) / 2.0;
        let longer = |p: &DVec3| if p.x > middle { 2.0 } else { 1.0 };
        let lengths: Vec<f64> =
            rough::noise(&mesh, 100.0, seed).iter().zip(mesh.positions()).map(|(h, p)| h * longer(p)).collect();
        let density = DensityOptions::from_source(DensitySource::Sizes(lengths));
        let out = run(&mesh, &options(1_000).with_density(density.clone().with_gradation(5.0)));
        let (figures, result) = (&out.report.density, &out.report.result);
        assert!(figures.noise_percent > 5.0 && figures.smoothing_rounds > 0, "{shape}: {figures:?}");
        let right = out.mesh.positions().iter().filter(|p| p.x > middle).count();
        let ratio = (out.mesh.positions().len() - right) as f64 / right as f64;
        assert!((2.5..6.0).contains(&ratio), "{shape}: {ratio}");
        let quality = result.quality.as_ref().unwrap();
        assert!(quality.q_avg > 0.85 && quality.theta_min_deg > 20.0, "{shape}: {quality:?}");
        // What gradation alone makes smooth is taken as before.
        let graded = run(&mesh, &options(1_000).with_density(density));
        assert_eq!((graded.report.density.noise_percent, graded.report.density.smoothing_rounds), (0.0, 0));
    }
}
