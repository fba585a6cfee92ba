//! Promise: what is no surface, or comes out other than it went in, is said in the report.

use super::rough::{self, Scan};
use tessera::mesh::TriMesh;
use tessera::mesh::measure::topology;
use tessera::mesh::shapes::Shape;
use tessera::remesh::report::InputKind;
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
    for (pages, backs) in [(3, false), (5, false), (3, true)] {
        let mesh = rough::book(pages, 12, backs);
        let out = run(&mesh, &options(500));
        let (input, result) = (&out.report.input, &out.report.result);
        assert_eq!(input.kind, InputKind::NonManifold, "{input:?}");
        assert_eq!(input.back_to_back_facets, if backs { mesh.facets().len() } else { 0 }, "{input:?}");
        assert_eq!(input.enclosed_facets, 0, "{input:?}");
        // Pages that were joined lie beside each other now, and nobody is to join them again by accident.
        assert!(result.repair.extra_vertices == 0 || result.coincident_vertices > 0, "{pages} {backs}: {result:?}");
        assert_eq!((result.topology.non_manifold_edges, result.topology.non_manifold_vertices), (0, 0));
    }
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
