//! Promise: `--metric` takes tensors of every kind of file with the same result, by the numbers of the input's vertices; `measure`
//! measures in it; what is wrong with a file names the vertex.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;
use tessera::mesh::attributes::{Attributes, Scalar};
use tessera::mesh::io::{self, Format};
use tessera::mesh::shapes::Shape;
use tessera::mesh::tensor::Tensor;

fn tessera(folder: &Path, line: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_tessera"));
    command.current_dir(folder).env_remove("RUST_BACKTRACE").args(line.split_whitespace()).output().unwrap()
}

fn said(out: &Output) -> String {
    String::from_utf8_lossy(&out.stderr).into_owned() + &String::from_utf8_lossy(&out.stdout)
}

#[test]
fn every_kind_of_file_has_the_same_result() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let mesh = Shape::Hills.build(800);
    io::write(&at("hills.ply"), &mesh).unwrap();
    // Turned against the axes, so that no two of the six numbers can change places.
    let x = glam::DVec3::new(0.8, 0.6, 0.1).normalize();
    let (y, z) = x.any_orthonormal_pair();
    let of = |p: &glam::DVec3| Tensor::of_lengths([x, y, z], [0.04 + 0.02 * p.x, 0.15, 0.2]);
    let tensors: Vec<Tensor> = mesh.positions().iter().map(of).collect();
    let lines: String = tensors.iter().map(|t| t.0.map(|m| format!("{m:?}")).join(" ") + "\n").collect();
    std::fs::write(at("metric.txt"), format!("# a comment\n{lines}")).unwrap();
    let count = tensors.len();
    let sol = format!("MeshVersionFormatted 2\nDimension 3\nSolAtVertices\n{count}\n1 3\n{lines}End\n");
    std::fs::write(at("metric.sol"), sol).unwrap();
    let header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({count}, 6), }}\n");
    let mut numpy = b"\x93NUMPY\x01\x00".to_vec();
    numpy.extend_from_slice(&(header.len() as u16).to_le_bytes());
    numpy.extend_from_slice(header.as_bytes());
    tensors.iter().flat_map(|t| t.0).for_each(|m| numpy.extend_from_slice(&m.to_le_bytes()));
    std::fs::write(at("metric.npy"), numpy).unwrap();
    let full = |t: &Tensor| {
        let [xx, xy, yy, xz, yz, zz] = t.0;
        [xx, xy, xz, xy, yy, yz, xz, yz, zz]
    };
    let values = tensors.iter().flat_map(full).collect();
    let mut attributes = Attributes::new(&mesh);
    attributes.add_scalar(Scalar { components: 9, ..Scalar::new("any", values) }).unwrap();
    for format in [Format::Vtk, Format::Vtp, Format::Vtu] {
        let (bytes, _) = io::encode_with_attributes(format, &mesh, &attributes).unwrap();
        std::fs::write(at(&format!("metric.{}", format.extension())), bytes).unwrap();
    }
    let mut first: Option<Vec<u8>> = None;
    for file in ["txt", "sol", "npy", "vtk", "vtp", "vtu"] {
        let out =
            tessera(folder.path(), &format!("remesh hills.ply --metric metric.{file} -o out.ply --report out.json"));
        assert!(out.status.success(), "{file}: {}", said(&out));
        assert!(said(&out).contains("% of the edges from 0.71 to 1.41"), "{}", said(&out));
        let result = std::fs::read(at("out.ply")).unwrap();
        assert_eq!(*first.get_or_insert(result.clone()), result, "{file}");
    }
    let report: Value = serde_json::from_slice(&std::fs::read(at("out.json")).unwrap()).unwrap();
    let unit = report["result"]["metric"]["unit_edges_percent"].as_f64().unwrap();
    assert!(unit > 95.0 && report["density"]["source"] == "metric", "{report}");
    let out = tessera(folder.path(), "measure hills.ply out.ply --metric metric.sol --json");
    let measured: Value = serde_json::from_slice(&out.stdout).unwrap();
    assert!((measured["metric"]["unit_edges_percent"].as_f64().unwrap() - unit).abs() < 0.5, "{measured}");
}

#[test]
fn what_is_wrong_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let mesh = Shape::Plane.build(8);
    io::write(&at("in.ply"), &mesh).unwrap();
    io::write(&at("in.stl"), &mesh).unwrap();
    let good = "4 0 4 0 0 4\n".repeat(mesh.positions().len());
    let write = |name: &str, text: &str| std::fs::write(at(name), text).unwrap();
    write("good.txt", &good);
    write("few.txt", "4 0 4 0 0 4\n");
    write("five.txt", &good.replacen("4 0 4 0 0 4", "4 0 4 0 0", 1));
    write("nan.txt", &good.replacen("4 0 4 0 0 4", "4 nan 4 0 0 4", 1));
    write("flat.txt", &good.replacen("4 0 4 0 0 4", "4 0 4 0 0 0", 1));
    write("scalar.sol", "MeshVersionFormatted 2\nDimension 3\nSolAtVertices\n9\n1 1\n1 1 1 1 1 1 1 1 1\nEnd\n");
    for (line, code, words) in [
        ("in.ply --metric few.txt", 65, "1 metric tensors, but the surface has"),
        ("in.ply --metric five.txt", 65, "line 1: not six numbers"),
        ("in.ply --metric nan.txt", 65, "vertex 0 has a number that is not finite"),
        ("in.ply --metric flat.txt", 65, "vertex 0 is not positive definite"),
        ("in.ply --metric scalar.sol", 65, "kind 3"),
        ("in.ply --metric nowhere.sol", 66, "nowhere.sol"),
        ("in.stl --metric good.txt", 2, "--metric"),
        ("in.ply --metric good.txt --gradation 0.3", 2, "--gradation"),
        ("in.ply --metric good.txt --anisotropy auto", 2, "--anisotropy"),
        ("in.ply --metric good.txt --density curvature", 2, "--density"),
        ("in.ply --metric good.txt --max-deviation 1", 2, "--max-deviation"),
    ] {
        let out = tessera(folder.path(), &format!("remesh {line} -o out.ply"));
        assert!(out.status.code() == Some(code) && said(&out).contains(words), "{line}: {}", said(&out));
    }
}
