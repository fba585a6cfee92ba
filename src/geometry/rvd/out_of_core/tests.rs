//! Promise: a surface that is read in windows has the sums of the surface in memory, to the bit, whatever the windows.

#![allow(clippy::unwrap_used)]

use std::fs;
use std::path::Path;
use std::sync::Arc;

use glam::DVec3;

use super::{FacetFile, OutOfCoreError, Plan, Wanted};
use crate::mesh::io::{self, Format};
use crate::mesh::out_of_core::{MeshFile, MeshFileError, Scratch};
use crate::mesh::sample::sample;
use crate::mesh::shapes::Shape;
use crate::mesh::{MeshError, TriMesh};
use crate::rvd::{Backend, CellSums, Parallel, RvdError, Session, SessionOptions, Surface};
use crate::token::Token;

const WANTED: Wanted =
    Wanted { seeds: 300, drawn: true, moves: true, neighbours: 24, threads: 2, limit_bytes: 1 << 40 };

/// A plan with these windows, and so much memory for vertices and for sorting.
fn plan(file: &MeshFile, window_facets: usize, vertex_bytes: u64, sort_bytes: u64) -> Plan {
    Plan { window_facets, vertex_bytes, sort_bytes, ..Plan::new(file, &WANTED).unwrap() }
}

fn sums(session: &mut dyn Session, seeds: &[DVec3]) -> CellSums {
    let mut sums = CellSums::default();
    session.set_seeds(seeds).unwrap();
    session.sums(&mut sums, &Token::default()).unwrap();
    sums
}

/// PLY as others write it: floats, with a property between.
fn single(mesh: &TriMesh) -> Vec<u8> {
    let (vertices, facets) = (mesh.positions().len(), mesh.facets().len());
    let mut out = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {vertices}\nproperty float z\nproperty float x\nproperty uchar q\n\
         property float y\nelement face {facets}\nproperty uchar flags\nproperty list uchar uint vertex_index\nend_header\n"
    )
    .into_bytes();
    for p in mesh.positions() {
        let [x, y, z] = p.as_vec3().to_array().map(f32::to_le_bytes);
        out.extend([&z[..], &x, &[7], &y].concat());
    }
    for facet in mesh.facets() {
        out.extend([9, 3]);
        facet.iter().for_each(|v| out.extend(v.to_le_bytes()));
    }
    out
}

/// The mesh with vertices and facets shuffled, some facets with vertices of their own, some without area, and a vertex that no
/// facet uses.
fn spoilt(mesh: &TriMesh) -> TriMesh {
    let (mut positions, mut facets) = (mesh.positions().to_vec(), mesh.facets().to_vec());
    let n = positions.len();
    for k in (0..facets.len()).step_by(5) {
        for c in 0..3 {
            positions.push(positions[facets[k][c] as usize]);
            facets[k][c] = positions.len() as u32 - 1;
        }
    }
    facets.push([0, 1, 1]);
    facets.push([2, 2, 2]);
    positions.push(DVec3::splat(1e3));
    let all = positions.len();
    // A step that has no factor in common with the counts.
    let step = (all / 2..).find(|s| (2..*s).all(|d| s % d != 0) && all % s != 0).unwrap();
    let new = |v: usize| (v * step) % all;
    let mut shuffled = vec![DVec3::ZERO; all];
    positions.iter().enumerate().for_each(|(v, &p)| shuffled[new(v)] = p);
    let facet = |k: usize| facets[(k * step) % facets.len()].map(|v| new(v as usize) as u32);
    let facets: Vec<[u32; 3]> = match facets.len() % step {
        0 => facets.iter().map(|f| f.map(|v| new(v as usize) as u32)).collect(),
        _ => (0..facets.len()).map(facet).collect(),
    };
    assert!(n < all);
    TriMesh::new(shuffled, facets).unwrap()
}

fn compare(path: &Path, format: Format, scratch: &Scratch, name: &str) {
    let mesh = io::read(path).unwrap();
    let surface = Arc::new(Surface::new(&mesh, None).unwrap());
    let backend = Parallel::new(Some(2)).unwrap();
    // Facets with many cells, and cells with many facets.
    let counts = [7, 300, 9 * mesh.facets().len()];
    let mut whole = backend.session(Arc::clone(&surface), SessionOptions::new(counts[2])).unwrap();
    let file = || MeshFile::open(path, format).unwrap();
    let drawn: Vec<DVec3> = sample(&mesh, None, counts[2], 3).iter().map(|p| p.position).collect();
    let vertex_bytes = 3 * file().number_bytes() as u64 + 4;
    for (window, vertices, sort) in [(1, 200, 1 << 16), (700, mesh.positions().len(), 1 << 20), (1 << 20, 77, 1 << 16)]
    {
        let plan = plan(&file(), window, vertices as u64 * vertex_bytes, sort);
        let facets = Arc::new(FacetFile::new(file(), &plan, scratch, &Token::default()).unwrap());
        assert_eq!(facets.frame(), surface.frame(), "{name}");
        assert_eq!((facets.world_area(), facets.degenerate_facets()), (mesh.area(), mesh.degenerate_count()), "{name}");
        assert_eq!(facets.hexagonal_energy(9), surface.hexagonal_energy(9), "{name}");
        assert!(facets.sample(counts[2], 3, &Token::default()).unwrap() == drawn, "{name}: other points");
        let mut windowed = backend.windowed_session(Arc::clone(&facets), SessionOptions::new(counts[2]));
        // The largest number once: most of the time goes to it.
        for &count in if window == 700 { &counts[..] } else { &counts[..2] } {
            let seeds: Vec<DVec3> = drawn[..count].iter().map(|&p| surface.frame().to_unit(p)).collect();
            let (got, want) = (sums(&mut *windowed, &seeds), sums(&mut *whole, &seeds));
            assert!(got == want, "{name}: {count} seeds, windows of {window}");
        }
        // Steps walk the same path.
        let mut paths = [&mut *windowed, &mut *whole].map(|session| {
            let seeds: Vec<DVec3> = drawn[..300].iter().map(|&p| surface.frame().to_unit(p)).collect();
            session.set_seeds(&seeds).unwrap();
            let resident = session.resident().unwrap();
            let mut at = Vec::new();
            for _ in 0..3 {
                resident.evaluate(&Token::default()).unwrap();
                resident.to_centroids().unwrap();
            }
            resident.read(&mut at).unwrap();
            at
        });
        assert!(std::mem::take(&mut paths[0]) == paths[1], "{name}: other steps");
    }
}

#[test]
fn windows_change_no_bit() {
    let folder = tempfile::tempdir().unwrap();
    let scratch = Scratch::new(folder.path());
    for shape in [Shape::Torus, Shape::Block, Shape::Slivers] {
        let mesh = shape.build(600);
        let spoilt = spoilt(&mesh);
        let files = [
            ("plain.ply", io::encode(Format::Ply, &mesh).unwrap()),
            ("spoilt.ply", io::encode(Format::Ply, &spoilt).unwrap()),
            ("single.ply", single(&spoilt)),
            ("alone.stl", io::encode(Format::Stl, &mesh).unwrap()),
        ];
        for (name, bytes) in files {
            let path = folder.path().join(name);
            fs::write(&path, bytes).unwrap();
            compare(&path, Format::of_path(&path).unwrap(), &scratch, &format!("{shape}, {name}"));
        }
    }
}

#[test]
fn a_plan_fits_or_says_what_would() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    fs::write(&path, io::encode(Format::Ply, &Shape::Torus.build(200_000)).unwrap()).unwrap();
    let file = MeshFile::open(&path, Format::Ply).unwrap();
    let wanted = |limit_bytes| Wanted { seeds: 50_000, limit_bytes, ..WANTED };
    let error = Plan::new(&file, &wanted(1 << 20)).unwrap_err();
    let OutOfCoreError::DoesNotFit { needed_bytes, .. } = error else { panic!("{error}") };
    // What is needed suffices, and less does not.
    let least = Plan::new(&file, &wanted(needed_bytes)).unwrap();
    assert_eq!(least.total_bytes, needed_bytes);
    assert!(Plan::new(&file, &wanted(needed_bytes - 1)).is_err());
    let mut windows = usize::MAX;
    for limit in (0..8).map(|k| needed_bytes << k) {
        let plan = Plan::new(&file, &wanted(limit)).unwrap();
        assert!(plan.total_bytes <= limit && plan.windows <= windows, "{plan:?}");
        assert!(plan.windows * plan.window_facets >= file.facets(), "{plan:?}");
        windows = plan.windows;
    }
    assert_eq!(windows, 1);
}

#[test]
fn what_is_no_surface_in_windows_is_refused_with_its_reason() {
    let folder = tempfile::tempdir().unwrap();
    let scratch = Scratch::new(folder.path());
    let mesh = Shape::Torus.build(500);
    let whole = io::encode(Format::Ply, &mesh).unwrap();
    let at = |bytes: &[u8], name: &str| {
        let path = folder.path().join(name);
        fs::write(&path, bytes).unwrap();
        let file = MeshFile::open(&path, Format::of_path(&path).unwrap())?;
        let plan = plan(&file, 100, 1 << 20, 1 << 16);
        FacetFile::new(file, &plan, &scratch, &Token::default()).map(drop)
    };
    at(&whole, "whole.ply").unwrap();
    let text = b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
        element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
    let not = |error: OutOfCoreError| matches!(error, OutOfCoreError::File(MeshFileError::NotInWindows(_)));
    assert!(not(at(text, "text.ply").unwrap_err()));
    assert!(not(at(b"solid a\nendsolid a\n", "text.stl").unwrap_err()));
    assert!(not(at(b"v 0 0 0\n", "a.obj").unwrap_err()));
    let cut = at(&whole[..whole.len() - 1], "cut.ply").unwrap_err();
    assert!(cut.to_string().contains("cut off"), "{cut}");
    let last = whole.len() - 13;
    let mut quad = whole.clone();
    quad[last] = 4;
    assert!(not(at(&quad, "quad.ply").unwrap_err()));
    let mut beyond = whole.clone();
    beyond[last + 1..last + 5].copy_from_slice(&u32::MAX.to_le_bytes());
    let mesh_error = |error: OutOfCoreError| match error {
        OutOfCoreError::File(MeshFileError::Data(io::DataError::Mesh(error))) => error,
        error => panic!("{error}"),
    };
    assert!(matches!(mesh_error(at(&beyond, "beyond.ply").unwrap_err()), MeshError::IndexOutOfRange { .. }));
    let vertices = whole.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
    let mut nan = whole.clone();
    nan[vertices..vertices + 8].copy_from_slice(&f64::NAN.to_le_bytes());
    assert!(matches!(mesh_error(at(&nan, "nan.ply").unwrap_err()), MeshError::NonFinitePosition { vertex: 0, .. }));
    let mut flat = whole;
    flat[vertices..last - 13 * (mesh.facets().len() - 1)].fill(0);
    assert!(matches!(mesh_error(at(&flat, "flat.ply").unwrap_err()), MeshError::NoArea { .. }));
}

#[test]
fn a_file_that_is_cut_short_and_a_token_end_a_pass() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    fs::write(&path, io::encode(Format::Ply, &Shape::Torus.build(40_000)).unwrap()).unwrap();
    let file = MeshFile::open(&path, Format::Ply).unwrap();
    let (plan, scratch) = (plan(&file, 5000, 1 << 20, 1 << 20), Scratch::new(folder.path()));
    let stopped = Token::default();
    stopped.cancel();
    let again = MeshFile::open(&path, Format::Ply).unwrap();
    let error = FacetFile::new(again, &plan, &scratch, &stopped).unwrap_err();
    assert!(matches!(error, OutOfCoreError::File(MeshFileError::Stopped(_))), "{error}");
    let facets = Arc::new(FacetFile::new(file, &plan, &scratch, &Token::default()).unwrap());
    fs::OpenOptions::new().write(true).open(&path).unwrap().set_len(10_000).unwrap();
    let error = facets.sample(9, 1, &Token::default()).unwrap_err();
    assert!(matches!(error, OutOfCoreError::File(MeshFileError::Read(_))), "{error}");
    // Passes read the scratch file alone.
    let mut session = Parallel::new(Some(2)).unwrap().windowed_session(facets, SessionOptions::new(9));
    sums(&mut *session, &[DVec3::ZERO]);
    assert!(matches!(session.sums(&mut CellSums::default(), &stopped), Err(RvdError::Stopped(_))));
    let pieces = session.pieces(0..9, &mut Default::default(), &Token::default());
    assert!(matches!(pieces, Err(RvdError::NoPieces)));
}
